/* test_tris_damage.c - damaged chunk files are found, and nothing else is read as one.
 * tests/cli/test_oracle.sh judges files whose checksums are right. */
#include "tris_samples.h"

#include "base/job_files.h"
#include "formats/file_kind.h"
#include "tests/unit/test.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <xxhash.h>

#define FIXTURE_TEST(name) STATE_TEST(name, struct tris_fixture, tris_setup, tris_teardown)

/* Opens the file and loads each chunk; returns the first failure, or 0. */
static int read_all(struct tris_fixture *f)
{
    struct fmt_tris_file *file;
    void *scratch = NULL;
    bsq_clear_error(f->ctx);
    bsq_forget_files(f->ctx); /* tests damage the file again and again */
    int status = fmt_tris_open(f->ctx, tris_path, &file);
    if (status < 0)
        return status;
    status = bsq_alloc(f->ctx, "test", fmt_tris_load_size_max(file) + 1, 1, &scratch);
    for (uint64_t i = 0; status == 0 && i < fmt_tris_get_header(file)->chunk_count; i++) {
        struct fmt_tris_chunk chunk;
        status = fmt_tris_load(file, i, scratch, &chunk);
    }
    bsq_free(f->ctx, scratch);
    if (status == 0 && fmt_tris_get_header(file)->made_normals != 0)
        status = fmt_tris_verify(file, NULL);
    fmt_tris_close(file);
    return status;
}

FIXTURE_TEST(every_truncated_length_is_found)
{
    size_t size;
    tris_fill(f->samples[0], 15, 5, 7, 4);
    tris_fill(f->samples[1], 15, 9, 4, 5);
    tris_write_samples(f, 15, 2);
    uint8_t *bytes = test_read(tris_path, &size);
    for (size_t length = 0; length < size; length++) {
        test_bytes(tris_path, bytes, length);
        assert_int_equal(read_all(f), BSQ_EDATA);
        assert_non_null(strstr(bsq_error(f->ctx), tris_path));
    }
    bytes[size] = 0;
    test_bytes(tris_path, bytes, size + 1);
    assert_int_equal(read_all(f), BSQ_EDATA);
    test_bytes(tris_path, bytes, size);
    assert_int_equal(read_all(f), 0);
    free(bytes);
}

/* The same bytes are written again, and then half of them. Checksums do not tell the first. */
FIXTURE_TEST(a_file_that_changes_is_not_read)
{
    const struct timespec past[2] = {{1000, 0}, {1000, 0}};
    struct fmt_tris_file *file;
    struct fmt_tris_chunk chunk;
    char expected[300];
    void *scratch;
    size_t size;
    tris_fill(f->samples[0], 15, 5, 7, 4);
    tris_write_samples(f, 15, 1);
    assert_int_equal(utimensat(AT_FDCWD, tris_path, past, 0), 0);
    assert_int_equal(fmt_tris_open(f->ctx, tris_path, &file), 0);
    assert_int_equal(bsq_alloc(f->ctx, "chunk", 1, fmt_tris_load_size_max(file) + 8, &scratch), 0);
    assert_int_equal(fmt_tris_load(file, 0, scratch, &chunk), 0);
    uint8_t *bytes = test_read(tris_path, &size);
    for (int cut = 0; cut < 2; cut++) {
        test_bytes(tris_path, bytes, cut ? size / 2 : size);
        bsq_clear_error(f->ctx);
        assert_int_equal(fmt_tris_load(file, 0, scratch, &chunk), BSQ_EIO);
        snprintf(expected, sizeof expected, "%s: was changed while it was read", tris_path);
        assert_string_equal(bsq_error(f->ctx), expected);
    }
    free(bytes);
    bsq_free(f->ctx, scratch);
    fmt_tris_close(file);
}

/* A bit of each byte: checksums cover all bits of a byte alike. */
FIXTURE_TEST(flipped_bits_of_every_byte_are_found)
{
    for (int made = 0; made < 2; made++) {
        size_t size;
        tris_fill(f->samples[0], 15, 5, 7, 4);
        tris_fill(f->samples[1], 15, 3, 4, 5);
        bsq_forget_files(f->ctx);
        if (!made)
            tris_write_samples(f, 15, 2);
        uint8_t *bytes = made ? tris_write_normals(f, &size) : test_read(tris_path, &size);
        for (size_t at = 0; at < size; at++) {
            bytes[at] ^= (uint8_t)(1u << at % 8);
            test_bytes(tris_path, bytes, size);
            assert_int_equal(read_all(f), BSQ_EDATA);
            bytes[at] ^= (uint8_t)(1u << at % 8);
        }
        free(bytes);
    }
}

static void set_sum(uint8_t *bytes, size_t at, size_t begin, size_t end)
{
    const uint64_t sum = XXH3_64bits(bytes + begin, end - begin);
    memcpy(bytes + at, &sum, sizeof sum);
}

/* Writes a file of one chunk with a sample, and returns its bytes. turned: its vertices take their
 * heights from each other. */
static uint8_t *write_one(struct tris_fixture *f, bool turned, size_t *size)
{
    enum { VERTICES = 3000 };
    float(*positions)[3] = f->samples[0]->positions;
    tris_fill(f->samples[0], 0, 2048, VERTICES, 4);
    for (uint32_t v = 0; turned && v < VERTICES / 2; v++) {
        const float z = positions[v][2];
        positions[v][2] = positions[VERTICES - 1 - v][2];
        positions[VERTICES - 1 - v][2] = z;
    }
    tris_write_samples(f, FMT_TRIS_SAMPLES, 1);
    return test_read(tris_path, size);
}

/* A chunk takes the place of another one that has the same counts and bounds, in the same file or
 * in that of another scan. So does its sample. */
FIXTURE_TEST(a_chunk_in_the_place_of_another_is_found)
{
    struct fmt_tris_chunk sample;
    struct fmt_tris_file *file;
    void *scratch;
    size_t size, size_b;
    bool found;
    uint8_t *a = write_one(f, false, &size), *b = write_one(f, true, &size_b);
    const size_t end = tris_u64_at(a, 104);
    assert_int_equal(size, size_b);
    assert_memory_equal(a + end, b + end, tris_u64_at(a, 112) + 56 - end);
    assert_int_equal(read_all(f), 0);
    memcpy(b + 176, a + 176, end - 176);
    test_bytes(tris_path, b, size);
    assert_int_equal(read_all(f), BSQ_EDATA);
    assert_non_null(strstr(bsq_error(f->ctx), "chunk 0: the checksum does not match"));
    bsq_forget_files(f->ctx);
    bsq_clear_error(f->ctx);
    assert_int_equal(fmt_tris_open(f->ctx, tris_path, &file), 0);
    assert_int_equal(bsq_alloc(f->ctx, "test", fmt_tris_load_size(file, 0), 1, &scratch), 0);
    assert_int_equal(fmt_tris_load_sample(file, 0, scratch, &sample, &found), BSQ_EDATA);
    assert_non_null(strstr(bsq_error(f->ctx), "the checksum of a sample does not match"));
    bsq_free(f->ctx, scratch);
    fmt_tris_close(file);
    free(a);
    free(b);
}

/* Corrects the checksums of changed bytes, as a faulty or hostile writer would. The first chunk is
 * taken for the only one. */
static void sign(uint8_t *bytes, size_t size)
{
    const size_t materials = tris_u64_at(bytes, 104), table = tris_u64_at(bytes, 112);
    if (table < size)
        set_sum(bytes, table + 56, 176, materials);
    set_sum(bytes, 152, materials, table);
    set_sum(bytes, 160, table, size);
    set_sum(bytes, 168, 0, 168);
}

/* With wrong sizes in header or table but correct checksums, a reader must not allocate more than a
 * few times the size of the file. */
FIXTURE_TEST(sizes_are_compared_with_the_file)
{
    static const uint32_t values[] = {UINT32_MAX, INT32_MAX, 1u << 31, 65536, 4096};
    size_t size;
    tris_fill(f->samples[0], 15, 5, 7, 4);
    tris_fill(f->samples[1], 15, 9, 4, 5);
    tris_write_samples(f, 15, 2);
    uint8_t *good = test_read(tris_path, &size), *bytes = malloc(size);
    const size_t table = tris_u64_at(good, 112);
    for (size_t at = 8; at < size; at = at + 4 == 176 ? table : at + 4)
        for (size_t i = 0; i < sizeof values / sizeof *values; i++) {
            memcpy(bytes, good, size);
            memcpy(bytes + at, &values[i], 4);
            if (at < 104 || at >= 120)
                sign(bytes, size);
            set_sum(bytes, 168, 0, 168);
            test_bytes(tris_path, bytes, size);
            read_all(f);
        }
    assert_true(size < 1024);
    assert_true(bsq_memory_high(f->ctx) < 16384);
    free(bytes);
    free(good);
}

/* Numbers of the header that no writer of this version writes, though checksums are right. */
FIXTURE_TEST(headers_of_other_writers_are_refused)
{
    static const struct {
        size_t at;
        uint32_t value;
        const char *message;
    } cases[] = {
        {8, 1, ": version 1 of chunk files is no longer read: sort the scan again with bisque"},
        {8, 6, ": version 6 of chunk files is no longer read: sort the scan again with bisque"},
        {8, 8, "chunk file of version 8, this program reads version 7"},
        {8, 0, "chunk file of version 0, this program reads version 7"},
        {8, 0x07000000, "big-endian"},
        {12, 32, "unknown attributes"}, /* fine colours without colours */
        {128, 1, "another length"},     /* one of two materials */
        {140, 1, "unknown normals"},    /* made ones beside the scan's own */
    };
    size_t size;
    tris_fill(f->samples[0], 15, 5, 7, 4);
    tris_write_samples(f, 15, 1);
    uint8_t *good = test_read(tris_path, &size), *bytes = malloc(size);
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        memcpy(bytes, good, size);
        memcpy(bytes + cases[i].at, &cases[i].value, 4);
        sign(bytes, size);
        test_bytes(tris_path, bytes, size);
        assert_int_equal(read_all(f), BSQ_EDATA);
        if (!strstr(bsq_error(f->ctx), cases[i].message))
            fail_msg("\"%s\" is not in \"%s\"", cases[i].message, bsq_error(f->ctx));
    }
    free(bytes);
    free(good);
}

/* A file that ends within the first bytes is a damaged one, also an empty one. */
FIXTURE_TEST(short_files_are_damaged)
{
    for (uint64_t size = 0; size <= 8; size++) {
        test_bytes(tris_path, "BSQTRIS\n", size);
        assert_int_equal(read_all(f), BSQ_EDATA);
        assert_non_null(strstr(bsq_error(f->ctx), "damaged chunk file: the header is cut off"));
        bsq_clear_error(f->ctx);
    }
    assert_true(fmt_tris_recognise("A.TRIS", "BSQ", 3));
    assert_false(fmt_tris_recognise("a.obj", "BSQ", 3));
    assert_false(fmt_tris_recognise("a.tris", "BQS", 3));
    assert_true(fmt_tris_recognise("a.obj", "BSQTRIS\nmore", 12));
}

FIXTURE_TEST(other_files_are_refused)
{
    enum fmt_kind kind;
    test_bytes(tris_path, "v 0 0 0\n", 8);
    assert_int_equal(fmt_recognise(f->ctx, tris_path, &kind), 0);
    assert_int_equal(kind, FMT_KIND_OTHER);
    assert_int_equal(read_all(f), BSQ_EDATA);
    assert_non_null(strstr(bsq_error(f->ctx), "not a chunk file"));
    unlink(tris_path);
    bsq_clear_error(f->ctx);
    assert_int_equal(fmt_recognise(f->ctx, tris_path, &kind), BSQ_ENOINPUT);
    assert_int_equal(kind, FMT_KIND_OTHER);
    assert_int_equal(read_all(f), BSQ_ENOINPUT);
}

RUN_TESTS(NULL, NULL)
