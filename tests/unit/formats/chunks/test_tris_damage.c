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

FIXTURE_TEST(every_flipped_bit_is_found)
{
    for (int made = 0; made < 2; made++) {
        size_t size;
        tris_fill(f->samples[0], 15, 5, 7, 4);
        tris_fill(f->samples[1], 15, 3, 4, 5);
        bsq_forget_files(f->ctx);
        if (!made)
            tris_write_samples(f, 15, 2);
        uint8_t *bytes = made ? tris_write_normals(f, &size) : test_read(tris_path, &size);
        for (size_t bit = 0; bit < 8 * size; bit++) {
            bytes[bit / 8] ^= (uint8_t)(1u << bit % 8);
            test_bytes(tris_path, bytes, size);
            assert_int_equal(read_all(f), BSQ_EDATA);
            bytes[bit / 8] ^= (uint8_t)(1u << bit % 8);
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

/* Three triangles with 16-bit indices end six bytes before the end of the chunk. */
FIXTURE_TEST(padding_is_zero)
{
    size_t size;
    tris_fill(f->samples[0], 0, 3, 4, 5);
    tris_write_samples(f, 0, 1);
    uint8_t *bytes = test_read(tris_path, &size);
    const size_t end = tris_u64_at(bytes, 104);
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

/* A path of two bytes leaves six bytes of padding after the materials, which have 42. */
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
        sign(bytes, size);
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
                          const struct damage *cases, size_t count)
{
    uint8_t *changed = malloc(size);
    for (size_t i = 0; i < count; i++) {
        memcpy(changed, bytes, size);
        memcpy(changed + cases[i].at, &cases[i].value, 4);
        sign(changed, size);
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
        {136, 4, "unknown ids"},
        {188, 4, "unknown flags"},
        {188, 3 << 8, "unknown flags"},  /* how it wraps along u */
        {188, 3 << 10, "unknown flags"}, /* along v */
        {188, 1 << 13, "unknown flags"},
        {218, 3, "cut off"},
        {218, 0xffffffff, "name is cut off"},
        {222, 0x00646f62, "name is cut off"}, /* a zero byte in it */
        {128, 2, "another length"},
        {128, 4, "too many materials"},
    };
    size_t size;
    uint8_t *bytes = tris_write_ids(f, &size);
    assert_int_equal(read_all(f), 0);
    expect_damage(f, bytes, size, cases, sizeof cases / sizeof *cases);
    free(bytes);
}

FIXTURE_TEST(damaged_channels_are_found)
{
    static const struct damage cases[] = {
        {132, 1, "not absolute"}, /* the second name is taken for a material */
        {132, 3, "too many materials or channels"},
        {132, 0xffffffff, "too many materials or channels"},
        {176, 0xffffffff, "the name of a channel"},
        {180, 0x52, "the name of a channel"},
        {212, 0x7fc00000, "not finite"},  /* the scale of the first material */
        {236, 0x7f800000, "not finite"},  /* the value of its first channel */
        {248, 5, "unknown flags"},        /* its component */
        {252, 0x7fc00000, "not finite"},  /* its scale */
        {304, 100000, "path is cut off"}, /* of its second channel */
    };
    size_t size;
    uint8_t *bytes = tris_write_channels(f, &size);
    assert_int_equal(read_all(f), 0);
    expect_damage(f, bytes, size, cases, sizeof cases / sizeof *cases);
    free(bytes);
}

FIXTURE_TEST(values_out_of_range_are_found)
{
    static const struct damage cases[] = {
        {8, 1, ": version 1 of chunk files is no longer read: sort the scan again with bisque"},
        {8, 6, ": version 6 of chunk files is no longer read: sort the scan again with bisque"},
        {8, 8, "chunk file of version 8, this program reads version 7"},
        {8, 0, "chunk file of version 0, this program reads version 7"},
        {8, 0x07000000, "big-endian"},
        {12, 127, "unknown attributes"},
        {12, 32, "unknown attributes"}, /* fine colours without colours */
        {24, 0x10000000, "another length"},
        {60, 0x7ff80000, "the origin is not finite"},
        {72, 0x7fc00000, "bounds"},
        {96, 168, "parts of the file overlap"},
        {96, 180, "parts of the file overlap"},
        {96, 184, "entry 0 of the table"},
        {128, 3, "too many materials"},
        {128, 0xfffffffe, "too many materials"},
        {140, 1, "unknown normals"}, /* made ones beside the scan's own */
        {140, 4, "unknown normals"},
        {176, 0x7fc00000, "outside of the bounds"},
        {176, 0x7f800000, "outside of the bounds"},
        {176, 0x42c80000, "outside of the bounds"},
        {288, 0x7f800000, "texture coordinate is not finite"},
        {372, 2, "material number"},
        {392, 7, "an index is out of range"},
    };
    size_t size;
    tris_fill(f->samples[0], 15, 5, 7, 4);
    tris_write_samples(f, 15, 1);
    uint8_t *bytes = test_read(tris_path, &size);
    expect_damage(f, bytes, size, cases, sizeof cases / sizeof *cases);
    /* A table entry that claims more triangles than a chunk may have, and one with a checksum of a
     * sample that there is not. */
    const size_t table = tris_u64_at(bytes, 112);
    const struct damage entries[] = {{table + 24, UINT32_MAX, "entry 0 of the table"},
                                     {table + 64, 1, "entry 0 of the table"},
                                     {table + 72, 1, "the places of normals"},
                                     {table + 96, 1, "the places of normals"}};
    expect_damage(f, bytes, size, entries, 4);
    free(bytes);
}

/* Damaged normals are found, and so are those of a faulty writer, whose checksums are right. */
FIXTURE_TEST(made_normals_are_checked)
{
    size_t size;
    uint8_t *bytes = tris_write_normals(f, &size);
    const size_t table = tris_u64_at(bytes, 112), second = table + 104,
                 normals = tris_u64_at(bytes, second + 72),
                 creases = tris_u64_at(bytes, second + 80), end = creases + 32;
    const struct damage places[] = {{table + 72, (uint32_t)normals, "the places of normals"},
                                    {second + 80, (uint32_t)normals, "the places of normals"},
                                    {second + 96, 3, "does not cover the file"},
                                    {second + 96, 10, "the places of normals"},
                                    {second + 100, 1, "the places of normals"},
                                    {140, 0, "the places of normals"}};
    expect_damage(f, bytes, size, places, sizeof places / sizeof *places);
    const struct {
        size_t at;
        uint32_t value;
        const char *message;
    } cases[] = {{creases, 9, "creases are not in order"},
                 {creases, 8, "creases are not in order"},
                 {creases + 4, 1, "creases are not in order"},
                 {normals, 1u << 22, "a made normal is not valid"},
                 {normals + 4, 0xfff00000, "a made normal is not valid"},
                 {creases + 12, 0xfff00000, "a made normal is not valid"}};
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++)
        for (int right = 0; right < 2; right++) {
            uint8_t *changed = malloc(size);
            memcpy(changed, bytes, size);
            memcpy(changed + cases[i].at, &cases[i].value, 4);
            if (right)
                set_sum(changed, second + 88, normals, end);
            set_sum(changed, 160, table, size);
            set_sum(changed, 168, 0, 168);
            test_bytes(tris_path, changed, size);
            assert_int_equal(read_all(f), BSQ_EDATA);
            const char *message =
                right ? cases[i].message : "chunk 1: the checksum of its normals does not match";
            if (!strstr(bsq_error(f->ctx), message))
                fail_msg("\"%s\" is not in \"%s\"", message, bsq_error(f->ctx));
            free(changed);
        }
    free(bytes);
}

/* A faulty writer's samples have right checksums. */
FIXTURE_TEST(records_of_samples_are_checked)
{
    static const struct {
        size_t at; /* in the sample */
        uint16_t upper, value;
        const char *message;
    } cases[] = {{0, 0, 1, NULL},
                 {6, 0, 0, "a record of its sample is not valid"},       /* high is below low */
                 {12, 0, 0x8000, "a record of its sample is not valid"}, /* in a normal */
                 {12, 0x8000, 63, NULL},                                 /* directions */
                 {12, 0x8000, 64, "a record of its sample is not valid"},
                 {31 * 16, 0, 1, "a record of its sample is not valid"}}; /* after the last one */
    const size_t sample = 176 + 12 * 3000, end = sample + 32 * 16;
    size_t size;
    uint8_t *bytes = write_one(f, false, &size);
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        const uint16_t record[8] = {1, 2, 3, 4, 5, 6, 0, cases[i].upper};
        struct fmt_tris_file *file;
        memset(bytes + sample, 0, end - sample);
        memcpy(bytes + sample, record, sizeof record);
        memcpy(bytes + sample + cases[i].at, &cases[i].value, sizeof cases[i].value);
        set_sum(bytes, tris_u64_at(bytes, 112) + 64, sample, end);
        sign(bytes, size);
        test_bytes(tris_path, bytes, size);
        bsq_clear_error(f->ctx);
        bsq_forget_files(f->ctx);
        assert_int_equal(fmt_tris_open(f->ctx, tris_path, &file), 0);
        assert_int_equal(fmt_tris_verify(file, NULL), cases[i].message ? BSQ_EDATA : 0);
        assert_true(!cases[i].message || strstr(bsq_error(f->ctx), cases[i].message));
        fmt_tris_close(file);
    }
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
