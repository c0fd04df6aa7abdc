/* test_tris_damage.c - damaged chunk files are found, and nothing else is read as one. */
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

FIXTURE_TEST(every_flipped_bit_is_found)
{
    size_t size;
    tris_fill(f->samples[0], 15, 5, 7, 4);
    tris_fill(f->samples[1], 15, 3, 4, 5);
    tris_write_samples(f, 15, 2);
    uint8_t *bytes = test_read(tris_path, &size);
    for (size_t bit = 0; bit < 8 * size; bit++) {
        bytes[bit / 8] ^= (uint8_t)(1u << bit % 8);
        test_bytes(tris_path, bytes, size);
        assert_int_equal(read_all(f), BSQ_EDATA);
        bytes[bit / 8] ^= (uint8_t)(1u << bit % 8);
    }
    free(bytes);
}

/* Corrects the checksums of changed bytes, as a faulty or hostile writer would. */
static void sign(uint8_t *bytes, size_t size)
{
    size_t materials = tris_u64_at(bytes, 96), table = tris_u64_at(bytes, 104);
    uint64_t sums[3] = {XXH3_64bits(bytes + 160, materials - 160),
                        XXH3_64bits(bytes + materials, table - materials),
                        XXH3_64bits(bytes + table, size - table)};
    memcpy(bytes + 152, &sums[0], 8);
    memcpy(bytes + 128, &sums[1], 8);
    memcpy(bytes + 136, &sums[2], 8);
    uint64_t header = XXH3_64bits(bytes, 144);
    memcpy(bytes + 144, &header, 8);
}

/* Makes the checksums of a file without chunks right. */
static void sign_materials(uint8_t *bytes, size_t size)
{
    uint64_t sum = XXH3_64bits(bytes + 152, size - 152);
    memcpy(bytes + 128, &sum, 8);
    sum = XXH3_64bits(bytes, 144);
    memcpy(bytes + 144, &sum, 8);
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
    const size_t table = tris_u64_at(good, 104);
    for (size_t at = 8; at < size; at = at + 4 == 152 ? table : at + 4)
        for (size_t i = 0; i < sizeof values / sizeof *values; i++) {
            memcpy(bytes, good, size);
            memcpy(bytes + at, &values[i], 4);
            if (at < 96 || at >= 112)
                sign(bytes, size);
            uint64_t sum = XXH3_64bits(bytes, 144);
            memcpy(bytes + 144, &sum, 8);
            test_bytes(tris_path, bytes, size);
            read_all(f);
        }
    assert_true(size < 1024);
    assert_true(bsq_memory_high(f->ctx) < 16384);
    free(bytes);
    free(good);
}

/* Three triangles with 16-bit indices end six bytes before the end of the chunk. */
FIXTURE_TEST(padding_is_zero)
{
    size_t size;
    tris_fill(f->samples[0], 0, 3, 4, 5);
    tris_write_samples(f, 0, 1);
    uint8_t *bytes = test_read(tris_path, &size);
    const size_t end = tris_u64_at(bytes, 96);
    for (size_t at = end - 6; at < end; at++) {
        assert_int_equal(bytes[at], 0);
        bytes[at] = 64;
        sign(bytes, size);
        test_bytes(tris_path, bytes, size);
        assert_int_equal(read_all(f), BSQ_EDATA);
        assert_non_null(strstr(bsq_error(f->ctx), "its padding is not zero"));
        bytes[at] = 0;
    }
    free(bytes);
}

/* A path of two bytes leaves six bytes of padding after the materials. */
FIXTURE_TEST(padding_of_materials_is_zero)
{
    struct fmt_tris_material material = {.texture_path = (char *)"/a"};
    const struct fmt_tris_header header = {.material_count = 1, .materials = &material};
    struct fmt_tris_writer *writer;
    size_t size;
    assert_int_equal(fmt_tris_create(f->ctx, tris_path, &header, &writer), 0);
    assert_int_equal(fmt_tris_commit(writer, NULL), 0);
    uint8_t *bytes = test_read(tris_path, &size);
    assert_int_equal(read_all(f), 0);
    for (size_t at = size - 6; at < size; at++) {
        assert_int_equal(bytes[at], 0);
        bytes[at] = 1;
        sign_materials(bytes, size);
        test_bytes(tris_path, bytes, size);
        assert_int_equal(read_all(f), BSQ_EDATA);
        assert_non_null(strstr(bsq_error(f->ctx), "after the materials is not zero"));
        bytes[at] = 0;
    }
    free(bytes);
}

/* A number that replaces one of the file, whose checksums are made right, and what is said of it.
 */
struct damage {
    size_t at;
    uint32_t value;
    const char *message;
};

static void expect_damage(struct tris_fixture *f, const uint8_t *bytes, size_t size,
                          const struct damage *cases, size_t count,
                          void (*make_right)(uint8_t *bytes, size_t size))
{
    uint8_t *changed = malloc(size);
    for (size_t i = 0; i < count; i++) {
        memcpy(changed, bytes, size);
        memcpy(changed + cases[i].at, &cases[i].value, 4);
        make_right(changed, size);
        test_bytes(tris_path, changed, size);
        assert_int_equal(read_all(f), BSQ_EDATA);
        if (!strstr(bsq_error(f->ctx), cases[i].message))
            fail_msg("\"%s\" is not in \"%s\"", cases[i].message, bsq_error(f->ctx));
    }
    free(changed);
}

FIXTURE_TEST(damaged_names_of_ids_are_found)
{
    static const struct damage cases[] = {
        {152, 0, "unknown ids"},
        {152, 4, "unknown ids"},
        {156, 1, "unknown ids"},
        {182, 2, "unknown flags"},
        {186, 3, "cut off"},
        {186, 0xffffffff, "name is cut off"},
        {190, 0x00646f62, "name is cut off"}, /* a zero byte in it */
        {120, 2, "another length"},
        {120, 4, "cut off"},
    };
    size_t size;
    uint8_t *bytes = tris_write_ids(f, &size);
    assert_int_equal(read_all(f), 0);
    expect_damage(f, bytes, size, cases, sizeof cases / sizeof *cases, sign_materials);
    free(bytes);
}

FIXTURE_TEST(damaged_channels_are_found)
{
    static const struct damage cases[] = {
        {8, 2, "unknown ids"},
        {152, 4, "unknown ids"},
        {160, 3, "channel"},
        {160, 0xffffffff, "channels are cut off"},
        {164, 1, "channels are cut off"},
        {168, 0xffffffff, "the name of a channel"},
        {172, 0x52, "the name of a channel"},
        {212, 0x7fc00000, "coordinates are not finite"},
        {228, 0x7f800000, "a channel of a material has a wrong value"},
        {240, 5, "a channel of a material has a wrong value"},
        {244, 0x7fc00000, "a channel of a material has a wrong value"},
        {260, 100, "path is cut off"},
    };
    size_t size;
    uint8_t *bytes = tris_write_channels(f, &size);
    assert_int_equal(read_all(f), 0);
    expect_damage(f, bytes, size, cases, sizeof cases / sizeof *cases, sign_materials);
    free(bytes);
}

FIXTURE_TEST(values_out_of_range_are_found)
{
    static const struct damage cases[] = {
        {8, 6, "unknown ids"},
        {8, 7, "version 7"},
        {12, 63, "unknown attributes"},
        {24, 0x10000000, "another length"},
        {60, 0x7ff80000, "the origin is not finite"},
        {72, 0x7fc00000, "bounds"},
        {120, 3, "materials are cut off"},
        {120, 0xfffffffe, "too many materials"},
        {160, 6, "counts are not those of the table"},
        {168, 0x7fc00000, "outside of the bounds"},
        {168, 0x7f800000, "outside of the bounds"},
        {168, 0x42c80000, "outside of the bounds"},
        {280, 0x7f800000, "texture coordinate is not finite"},
        {364, 2, "material number"},
        {384, 7, "an index is out of range"},
    };
    size_t size;
    tris_fill(f->samples[0], 15, 5, 7, 4);
    tris_write_samples(f, 15, 1);
    uint8_t *bytes = test_read(tris_path, &size);
    expect_damage(f, bytes, size, cases, sizeof cases / sizeof *cases, sign);
    /* A table entry that claims more triangles than a chunk may have. */
    const struct damage entry = {tris_u64_at(bytes, 104) + 24, UINT32_MAX, "entry 0 of the table"};
    expect_damage(f, bytes, size, &entry, 1, sign);
    free(bytes);
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
