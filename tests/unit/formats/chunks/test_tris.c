/* test_tris.c - chunk files: round trips, the bytes of FORMATS.md, damage. */
#include "base/job_files.h"
#include "formats/file_kind.h"
#include "formats/chunks/tris.h"

#include <fcntl.h>
#include <inttypes.h>
#include <setjmp.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>
#include <xxhash.h>
#include <cmocka.h>

#define MAX_VERTICES 70000u

/* ---- a random chunk ---- */

struct sample {
    struct fmt_tris_chunk chunk;
    float positions[MAX_VERTICES][3], texcoords[MAX_VERTICES][2];
    uint32_t normals[MAX_VERTICES], colors[MAX_VERTICES];
    uint32_t triangles[FMT_TRIS_CHUNK_TRIANGLES][3], materials[FMT_TRIS_CHUNK_TRIANGLES];
};

static uint32_t next(uint64_t *seed)
{
    *seed = *seed * 6364136223846793005u + 1442695040888963407u;
    return (uint32_t)(*seed >> 32);
}

static float next_float(uint64_t *seed)
{
    return (float)next(seed) / 4294967296.0f * 20.0f - 10.0f;
}

static void fill(struct sample *s, uint32_t attributes, uint32_t triangles, uint32_t vertices,
                 uint64_t seed)
{
    for (uint32_t v = 0; v < vertices; v++) {
        for (int axis = 0; axis < 3; axis++)
            s->positions[v][axis] = next_float(&seed);
        s->texcoords[v][0] = next_float(&seed);
        s->texcoords[v][1] = next_float(&seed);
        s->normals[v] = next(&seed);
        s->colors[v] = next(&seed);
    }
    uint32_t corner = 0;
    for (uint32_t t = 0; t < triangles; t++) {
        for (int k = 0; k < 3; k++, corner++)
            s->triangles[t][k] = corner < vertices ? corner : next(&seed) % vertices;
        s->materials[t] = next(&seed) % 3 == 0 ? UINT32_MAX : next(&seed) % 2;
    }
    s->chunk = (struct fmt_tris_chunk){
        .triangle_count = triangles,
        .vertex_count = vertices,
        .positions = (const float(*)[3])s->positions,
        .normals = attributes & FMT_TRIS_NORMALS ? s->normals : NULL,
        .texcoords = attributes & FMT_TRIS_TEXCOORDS ? (const float(*)[2])s->texcoords : NULL,
        .colors = attributes & FMT_TRIS_COLORS ? s->colors : NULL,
        .triangles = (const uint32_t(*)[3])s->triangles,
        .materials = attributes & FMT_TRIS_MATERIALS ? s->materials : NULL,
    };
}

/* ---- fixture ---- */

struct fixture {
    char dir[64], path[128];
    struct bsq_ctx *ctx;
    struct sample *samples[2];
};

static int setup(void **state)
{
    struct fixture *f = calloc(1, sizeof *f);
    snprintf(f->dir, sizeof f->dir, "/tmp/test_tris_XXXXXX");
    assert_non_null(mkdtemp(f->dir));
    snprintf(f->path, sizeof f->path, "%s/scan.tris", f->dir);
    struct bsq_ctx_options options = {.memory_bytes = 64 << 20, .threads = 1};
    assert_int_equal(bsq_ctx_create(&options, &f->ctx), 0);
    for (int i = 0; i < 2; i++)
        f->samples[i] = calloc(1, sizeof *f->samples[i]);
    *state = f;
    return 0;
}

static int teardown(void **state)
{
    struct fixture *f = *state;
    assert_int_equal(bsq_memory_used(f->ctx), 0);
    bsq_ctx_destroy(f->ctx);
    for (int i = 0; i < 2; i++)
        free(f->samples[i]);
    unlink(f->path);
    assert_int_equal(rmdir(f->dir), 0);
    free(f);
    return 0;
}

static void write_sample_file(struct fixture *f, uint32_t attributes, uint32_t chunk_count)
{
    struct fmt_tris_material materials[2] = {
        {.texture_path = (char *)"/a dir/wall.png", .diffuse = {0.25f, 0.5f, 0.75f}},
        {.diffuse = {1.0f, 0.0f, 0.5f}}};
    struct fmt_tris_header header = {
        .attributes = attributes,
        .source_faces = 77,
        .origin = {512000.0, -1024.0, 0.0},
        .material_count = 2,
        .materials = materials,
    };
    struct fmt_tris_writer *writer;
    assert_int_equal(fmt_tris_create(f->ctx, f->path, &header, &writer), 0);
    fmt_tris_skip(writer, 2);
    fmt_tris_skip(writer, 3);
    for (uint32_t i = 0; i < chunk_count; i++) {
        const struct fmt_tris_chunk *chunk = &f->samples[i]->chunk;
        uint64_t size,
            bound = fmt_tris_encoded_bound(attributes, chunk->triangle_count, chunk->vertex_count);
        struct fmt_tris_chunk_info info;
        void *buffer;
        assert_int_equal(bsq_alloc(f->ctx, "test", bound, 1, &buffer), 0);
        assert_int_equal(fmt_tris_encode(f->ctx, attributes, chunk, buffer, &size, &info), 0);
        assert_true(size <= bound);
        assert_int_equal(fmt_tris_append(writer, buffer, size, &info), 0);
        bsq_free(f->ctx, buffer);
    }
    uint64_t written = fmt_tris_written(writer);
    assert_true(written > 0);
    assert_int_equal(fmt_tris_commit(writer), 0);
}

static uint8_t *read_bytes(const char *path, size_t *size)
{
    FILE *file = fopen(path, "rb");
    assert_non_null(file);
    fseek(file, 0, SEEK_END);
    *size = (size_t)ftell(file);
    rewind(file);
    uint8_t *bytes = malloc(*size + 1);
    assert_int_equal(fread(bytes, 1, *size, file), *size);
    fclose(file);
    return bytes;
}

static void write_bytes(const char *path, const void *bytes, size_t size)
{
    FILE *file = fopen(path, "wb");
    assert_non_null(file);
    assert_int_equal(fwrite(bytes, 1, size, file), size);
    assert_int_equal(fclose(file), 0);
}

/* ---- round trips ---- */

static void expect_array(const void *got, const void *expected, size_t bytes)
{
    if (!expected)
        assert_null(got);
    else
        assert_memory_equal(got, expected, bytes);
}

static void expect_bounds(const struct fmt_tris_chunk *chunk,
                          const struct fmt_tris_chunk_info *info)
{
    for (int axis = 0; axis < 3; axis++) {
        float low = chunk->positions[0][axis], high = low;
        for (uint32_t v = 1; v < chunk->vertex_count; v++) {
            if (chunk->positions[v][axis] < low)
                low = chunk->positions[v][axis];
            if (chunk->positions[v][axis] > high)
                high = chunk->positions[v][axis];
        }
        assert_true(info->bounds_min[axis] == low && info->bounds_max[axis] == high);
    }
}

static void expect_file(struct fixture *f, uint32_t chunk_count)
{
    struct fmt_tris_file *file;
    enum fmt_kind kind;
    assert_int_equal(fmt_recognise(f->ctx, f->path, &kind), 0);
    assert_int_equal(kind, FMT_KIND_TRIS);
    assert_int_equal(fmt_tris_open(f->ctx, f->path, &file), 0);
    const struct fmt_tris_header *h = fmt_tris_get_header(file);
    const struct fmt_tris_chunk_info *infos = fmt_tris_chunks(file);
    assert_int_equal(h->chunk_count, chunk_count);
    assert_int_equal(h->source_faces, 77);
    assert_int_equal(h->skipped_triangles, 5);
    assert_true(h->origin[0] == 512000.0 && h->origin[1] == -1024.0 && h->origin[2] == 0.0);
    assert_int_equal(h->material_count, 2);
    assert_string_equal(h->materials[0].texture_path, "/a dir/wall.png");
    assert_true(h->materials[0].diffuse[2] == 0.75f);
    assert_null(h->materials[1].texture_path);
    assert_true(h->materials[1].diffuse[0] == 1.0f);
    uint64_t triangles = 0;
    for (uint32_t i = 0; i < chunk_count; i++) {
        const struct fmt_tris_chunk *e = &f->samples[i]->chunk;
        struct fmt_tris_chunk got;
        void *scratch;
        uint64_t bytes = fmt_tris_load_size(file, i);
        assert_true(bytes <= fmt_tris_load_size_max(file));
        assert_int_equal(bsq_alloc(f->ctx, "test", bytes, 1, &scratch), 0);
        assert_int_equal(fmt_tris_load(file, i, scratch, &got), 0);
        assert_int_equal(infos[i].first_triangle, triangles);
        assert_int_equal(got.triangle_count, e->triangle_count);
        assert_int_equal(got.vertex_count, e->vertex_count);
        expect_array(got.positions, e->positions, 12 * (size_t)e->vertex_count);
        expect_array(got.normals, e->normals, 4 * (size_t)e->vertex_count);
        expect_array(got.texcoords, e->texcoords, 8 * (size_t)e->vertex_count);
        expect_array(got.colors, e->colors, 4 * (size_t)e->vertex_count);
        expect_array(got.triangles, e->triangles, 12 * (size_t)e->triangle_count);
        expect_array(got.materials, e->materials, 4 * (size_t)e->triangle_count);
        expect_bounds(e, &infos[i]);
        triangles += e->triangle_count;
        bsq_free(f->ctx, scratch);
    }
    assert_int_equal(h->triangle_count, triangles);
    fmt_tris_close(file);
}

static void every_set_of_attributes_comes_back(void **state)
{
    struct fixture *f = *state;
    for (uint32_t attributes = 0; attributes < 16; attributes++) {
        fill(f->samples[0], attributes, 101 + attributes, 57 + attributes, 1 + attributes);
        fill(f->samples[1], attributes, 1, 3, 100 + attributes);
        write_sample_file(f, attributes, 2);
        expect_file(f, 2);
    }
}

/* 16 bits can number at most 65536 vertices. */
static void large_chunks_come_back(void **state)
{
    struct fixture *f = *state;
    size_t sizes[2];
    for (uint32_t i = 0; i < 2; i++) {
        fill(f->samples[0], 0, FMT_TRIS_CHUNK_TRIANGLES, 65536 + i, 9);
        write_sample_file(f, 0, 1);
        expect_file(f, 1);
        free(read_bytes(f->path, &sizes[i]));
    }
    assert_true(sizes[1] - sizes[0] > 6 * 65536);
    fill(f->samples[0], 15, FMT_TRIS_CHUNK_TRIANGLES, MAX_VERTICES, 10);
    write_sample_file(f, 15, 1);
    expect_file(f, 1);
}

static void a_file_without_chunks_is_valid(void **state)
{
    struct fixture *f = *state;
    write_sample_file(f, 0, 0);
    expect_file(f, 0);
}

/* ---- bytes at the offsets of FORMATS.md ---- */

static uint64_t u64_at(const uint8_t *bytes, size_t at)
{
    uint64_t value = 0;
    for (int i = 7; i >= 0; i--)
        value = value << 8 | bytes[at + (size_t)i];
    return value;
}

static uint32_t u32_at(const uint8_t *bytes, size_t at)
{
    return (uint32_t)(bytes[at] | bytes[at + 1] << 8 | bytes[at + 2] << 16) |
           (uint32_t)bytes[at + 3] << 24;
}

static float f32_at(const uint8_t *bytes, size_t at)
{
    uint32_t bits = u32_at(bytes, at);
    float value;
    memcpy(&value, &bits, 4);
    return value;
}

static void bytes_are_those_of_the_specification(void **state)
{
    struct fixture *f = *state;
    struct sample *s = f->samples[0];
    size_t size;
    fill(s, 15, 5, 7, 4);
    write_sample_file(f, 15, 1);
    uint8_t *b = read_bytes(f->path, &size);
    assert_memory_equal(b, "\x42\x53\x51\x54\x52\x49\x53\x0a", 8);
    assert_int_equal(u32_at(b, 8), 1);
    assert_int_equal(u32_at(b, 12), 15);
    assert_int_equal(u64_at(b, 16), 5);
    assert_int_equal(u64_at(b, 24), 1);
    assert_int_equal(u64_at(b, 32), 77);
    assert_int_equal(u64_at(b, 40), 5);
    assert_int_equal(u64_at(b, 48), 0x411f400000000000u); /* 512000.0 */
    size_t chunk_bytes = 16 + 7 * (12 + 4 + 8 + 4) + 5 * 4 + 5 * 6;
    chunk_bytes += (8 - chunk_bytes % 8) % 8;
    size_t materials = 152 + chunk_bytes, table = materials + 16 + 15 + 16;
    table += (8 - table % 8) % 8;
    assert_int_equal(u64_at(b, 96), materials);
    assert_int_equal(u64_at(b, 104), table);
    assert_int_equal(u64_at(b, 112), size);
    assert_int_equal(size, table + 56);
    assert_int_equal(u32_at(b, 120), 2);
    assert_int_equal(u32_at(b, 124), 0);
    assert_true(u64_at(b, 128) == XXH3_64bits(b + materials, table - materials));
    assert_true(u64_at(b, 136) == XXH3_64bits(b + table, 56));
    assert_true(u64_at(b, 144) == XXH3_64bits(b, 144));
    assert_true(u64_at(b, 152) == XXH3_64bits(b + 160, chunk_bytes - 8));
    assert_int_equal(u32_at(b, 160), 5);
    assert_int_equal(u32_at(b, 164), 7);
    for (uint32_t v = 0; v < 7; v++) {
        for (size_t axis = 0; axis < 3; axis++)
            assert_true(f32_at(b, 168 + 12 * v + 4 * axis) == s->positions[v][axis]);
        assert_int_equal(u32_at(b, 252 + 4 * v), s->normals[v]);
        assert_true(f32_at(b, 280 + 8 * v) == s->texcoords[v][0]);
        assert_true(f32_at(b, 284 + 8 * v) == s->texcoords[v][1]);
        assert_int_equal(u32_at(b, 336 + 4 * v), s->colors[v]);
    }
    for (uint32_t t = 0; t < 5; t++) {
        assert_int_equal(u32_at(b, 364 + 4 * t), s->materials[t]);
        for (size_t k = 0; k < 3; k++)
            assert_int_equal(b[384 + 6 * t + 2 * k] | b[385 + 6 * t + 2 * k] << 8,
                             s->triangles[t][k]);
    }
    assert_true(f32_at(b, materials + 4) == 0.5f);
    assert_int_equal(u32_at(b, materials + 12), 15);
    assert_memory_equal(b + materials + 16, "/a dir/wall.png", 15);
    assert_int_equal(u32_at(b, materials + 31 + 12), 0xffffffffu);
    assert_int_equal(u64_at(b, table), 152);
    assert_int_equal(u64_at(b, table + 8), chunk_bytes);
    assert_int_equal(u64_at(b, table + 16), 0);
    assert_int_equal(u32_at(b, table + 24), 5);
    assert_int_equal(u32_at(b, table + 28), 7);
    free(b);
}

/* ---- damage ---- */

/* Opens the file and loads each chunk; returns the first failure, or 0. */
static int read_all(struct fixture *f)
{
    struct fmt_tris_file *file;
    void *scratch = NULL;
    bsq_clear_error(f->ctx);
    bsq_forget_files(f->ctx); /* tests damage the file again and again */
    int status = fmt_tris_open(f->ctx, f->path, &file);
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

static void every_truncated_length_is_found(void **state)
{
    struct fixture *f = *state;
    size_t size;
    fill(f->samples[0], 15, 5, 7, 4);
    fill(f->samples[1], 15, 9, 4, 5);
    write_sample_file(f, 15, 2);
    uint8_t *bytes = read_bytes(f->path, &size);
    for (size_t length = 0; length < size; length++) {
        write_bytes(f->path, bytes, length);
        assert_int_equal(read_all(f), BSQ_EDATA);
        assert_non_null(strstr(bsq_error(f->ctx), f->path));
    }
    bytes[size] = 0;
    write_bytes(f->path, bytes, size + 1);
    assert_int_equal(read_all(f), BSQ_EDATA);
    write_bytes(f->path, bytes, size);
    assert_int_equal(read_all(f), 0);
    free(bytes);
}

/* The same bytes are written again, and then half of them. Checksums do not tell the first. */
static void a_file_that_changes_is_not_read(void **state)
{
    struct fixture *f = *state;
    const struct timespec past[2] = {{1000, 0}, {1000, 0}};
    struct fmt_tris_file *file;
    struct fmt_tris_chunk chunk;
    char expected[300];
    void *scratch;
    size_t size;
    fill(f->samples[0], 15, 5, 7, 4);
    write_sample_file(f, 15, 1);
    assert_int_equal(utimensat(AT_FDCWD, f->path, past, 0), 0);
    assert_int_equal(fmt_tris_open(f->ctx, f->path, &file), 0);
    assert_int_equal(bsq_alloc(f->ctx, "chunk", 1, fmt_tris_load_size_max(file) + 8, &scratch), 0);
    assert_int_equal(fmt_tris_load(file, 0, scratch, &chunk), 0);
    uint8_t *bytes = read_bytes(f->path, &size);
    for (int cut = 0; cut < 2; cut++) {
        write_bytes(f->path, bytes, cut ? size / 2 : size);
        bsq_clear_error(f->ctx);
        assert_int_equal(fmt_tris_load(file, 0, scratch, &chunk), BSQ_EIO);
        snprintf(expected, sizeof expected, "%s: was changed while it was read", f->path);
        assert_string_equal(bsq_error(f->ctx), expected);
    }
    free(bytes);
    bsq_free(f->ctx, scratch);
    fmt_tris_close(file);
}

static void every_flipped_bit_is_found(void **state)
{
    struct fixture *f = *state;
    size_t size;
    fill(f->samples[0], 15, 5, 7, 4);
    fill(f->samples[1], 15, 3, 4, 5);
    write_sample_file(f, 15, 2);
    uint8_t *bytes = read_bytes(f->path, &size);
    for (size_t bit = 0; bit < 8 * size; bit++) {
        bytes[bit / 8] ^= (uint8_t)(1u << bit % 8);
        write_bytes(f->path, bytes, size);
        assert_int_equal(read_all(f), BSQ_EDATA);
        bytes[bit / 8] ^= (uint8_t)(1u << bit % 8);
    }
    free(bytes);
}

/* Corrects the checksums of changed bytes, as a faulty or hostile writer would. */
static void sign(uint8_t *bytes, size_t size)
{
    size_t materials = u64_at(bytes, 96), table = u64_at(bytes, 104);
    uint64_t sums[3] = {XXH3_64bits(bytes + 160, materials - 160),
                        XXH3_64bits(bytes + materials, table - materials),
                        XXH3_64bits(bytes + table, size - table)};
    memcpy(bytes + 152, &sums[0], 8);
    memcpy(bytes + 128, &sums[1], 8);
    memcpy(bytes + 136, &sums[2], 8);
    uint64_t header = XXH3_64bits(bytes, 144);
    memcpy(bytes + 144, &header, 8);
}

/* With wrong sizes in header or table but correct checksums, a reader must not allocate more than a
 * few times the size of the file. */
static void sizes_are_compared_with_the_file(void **state)
{
    static const uint32_t values[] = {UINT32_MAX, INT32_MAX, 1u << 31, 65536, 4096};
    struct fixture *f = *state;
    size_t size;
    fill(f->samples[0], 15, 5, 7, 4);
    fill(f->samples[1], 15, 9, 4, 5);
    write_sample_file(f, 15, 2);
    uint8_t *good = read_bytes(f->path, &size), *bytes = malloc(size);
    const size_t table = u64_at(good, 104);
    for (size_t at = 8; at < size; at = at + 4 == 152 ? table : at + 4)
        for (size_t i = 0; i < sizeof values / sizeof *values; i++) {
            memcpy(bytes, good, size);
            memcpy(bytes + at, &values[i], 4);
            if (at < 96 || at >= 112)
                sign(bytes, size);
            uint64_t sum = XXH3_64bits(bytes, 144);
            memcpy(bytes + 144, &sum, 8);
            write_bytes(f->path, bytes, size);
            read_all(f);
        }
    assert_true(size < 1024);
    assert_true(bsq_memory_high(f->ctx) < 16384);
    free(bytes);
    free(good);
}

/* Three triangles with 16-bit indices end six bytes before the end of the chunk. */
static void padding_is_zero(void **state)
{
    struct fixture *f = *state;
    size_t size;
    fill(f->samples[0], 0, 3, 4, 5);
    write_sample_file(f, 0, 1);
    uint8_t *bytes = read_bytes(f->path, &size);
    const size_t end = u64_at(bytes, 96);
    for (size_t at = end - 6; at < end; at++) {
        assert_int_equal(bytes[at], 0);
        bytes[at] = 64;
        sign(bytes, size);
        write_bytes(f->path, bytes, size);
        assert_int_equal(read_all(f), BSQ_EDATA);
        assert_non_null(strstr(bsq_error(f->ctx), "its padding is not zero"));
        bytes[at] = 0;
    }
    free(bytes);
}

/* A path of two bytes leaves six bytes of padding after the materials. */
static void padding_of_materials_is_zero(void **state)
{
    struct fixture *f = *state;
    struct fmt_tris_material material = {.texture_path = (char *)"/a"};
    const struct fmt_tris_header header = {.material_count = 1, .materials = &material};
    struct fmt_tris_writer *writer;
    size_t size;
    assert_int_equal(fmt_tris_create(f->ctx, f->path, &header, &writer), 0);
    assert_int_equal(fmt_tris_commit(writer), 0);
    uint8_t *bytes = read_bytes(f->path, &size);
    assert_int_equal(read_all(f), 0);
    for (size_t at = size - 6; at < size; at++) {
        assert_int_equal(bytes[at], 0);
        bytes[at] = 1;
        uint64_t sum = XXH3_64bits(bytes + 152, size - 152);
        memcpy(bytes + 128, &sum, 8);
        sum = XXH3_64bits(bytes, 144);
        memcpy(bytes + 144, &sum, 8);
        write_bytes(f->path, bytes, size);
        assert_int_equal(read_all(f), BSQ_EDATA);
        assert_non_null(strstr(bsq_error(f->ctx), "after the materials is not zero"));
        bytes[at] = 0;
    }
    free(bytes);
}

/* Makes the checksums of a file without chunks right. */
static void sign_materials(uint8_t *bytes, size_t size)
{
    uint64_t sum = XXH3_64bits(bytes + 152, size - 152);
    memcpy(bytes + 128, &sum, 8);
    sum = XXH3_64bits(bytes, 144);
    memcpy(bytes + 144, &sum, 8);
}

/* Writes a file without chunks that has ids by object, and returns its bytes. */
static uint8_t *write_ids(struct fixture *f, size_t *size)
{
    struct fmt_tris_material materials[] = {
        {.texture_path = (char *)"/a.png", .name = (char *)"body"},
        {.colorless = true, .name = NULL},
        {.diffuse = {0.5f, 0, 1}, .name = (char *)"gl\xc3\xa4s"}};
    const struct fmt_tris_header header = {
        .material_count = 3, .materials = materials, .ids = BSQ_IDS_OBJECT};
    struct fmt_tris_writer *writer;
    assert_int_equal(fmt_tris_create(f->ctx, f->path, &header, &writer), 0);
    assert_int_equal(fmt_tris_commit(writer), 0);
    return read_bytes(f->path, size);
}

static void names_of_ids_come_back(void **state)
{
    static const char *const names[] = {"body", "", "gl\xc3\xa4s"};
    struct fixture *f = *state;
    struct fmt_tris_file *file;
    size_t size;
    uint8_t *bytes = write_ids(f, &size);
    assert_int_equal(bytes[8], 2);
    assert_int_equal(fmt_tris_open(f->ctx, f->path, &file), 0);
    const struct fmt_tris_header *h = fmt_tris_get_header(file);
    assert_int_equal(h->ids, BSQ_IDS_OBJECT);
    assert_int_equal(h->material_count, 3);
    for (int i = 0; i < 3; i++) {
        assert_string_equal(h->materials[i].name, names[i]);
        assert_int_equal(h->materials[i].colorless, i == 1);
        assert_int_equal(h->materials[i].texture_path != NULL, i == 0);
    }
    fmt_tris_close(file);
    free(bytes);
}

static void damaged_names_of_ids_are_found(void **state)
{
    static const struct {
        uint64_t at;
        uint32_t value;
        const char *message;
    } cases[] = {
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
    struct fixture *f = *state;
    size_t size;
    uint8_t *bytes = write_ids(f, &size), *changed = malloc(size);
    assert_int_equal(read_all(f), 0);
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        memcpy(changed, bytes, size);
        memcpy(changed + cases[i].at, &cases[i].value, 4);
        sign_materials(changed, size);
        write_bytes(f->path, changed, size);
        assert_int_equal(read_all(f), BSQ_EDATA);
        if (!strstr(bsq_error(f->ctx), cases[i].message))
            fail_msg("\"%s\" is not in \"%s\"", cases[i].message, bsq_error(f->ctx));
    }
    free(changed);
    free(bytes);
}

/* Writes a file without chunks that has two channels, and returns its bytes. */
static uint8_t *write_channels(struct fixture *f, size_t *size)
{
    struct fmt_tris_source sources[] = {
        {.value = {0.25f, 0.25f, 0.25f}},
        {.texture_path = (char *)"/e.png",
         .component = 2,
         .uv = {.moves = true, .scale = {2, 1}, .offset = {0, -0.5f}}},
        {.texture_path = (char *)"/r.png"},
        {.value = {1, 2, 3}}};
    struct fmt_tris_material materials[] = {
        {.sources = sources}, {.sources = sources + 2, .texture_path = (char *)"/a.png"}};
    char *channels[] = {(char *)"roughness", (char *)"b_2"};
    const struct fmt_tris_header header = {
        .material_count = 2, .materials = materials, .channel_count = 2, .channels = channels};
    struct fmt_tris_writer *writer;
    assert_int_equal(fmt_tris_create(f->ctx, f->path, &header, &writer), 0);
    assert_int_equal(fmt_tris_commit(writer), 0);
    return read_bytes(f->path, size);
}

static void channels_come_back(void **state)
{
    struct fixture *f = *state;
    struct fmt_tris_file *file;
    size_t size;
    uint8_t *bytes = write_channels(f, &size);
    assert_int_equal(bytes[8], 3);
    assert_int_equal(fmt_tris_open(f->ctx, f->path, &file), 0);
    const struct fmt_tris_header *h = fmt_tris_get_header(file);
    assert_int_equal(h->ids, BSQ_IDS_NONE);
    assert_int_equal(fmt_tris_find_channel(h, "b_2"), 1);
    assert_int_equal(fmt_tris_find_channel(h, "b"), UINT32_MAX);
    const struct fmt_tris_source *first = h->materials[0].sources,
                                 *second = h->materials[1].sources;
    assert_true(first[0].value[0] == 0.25f && !first[0].texture_path && !first[0].uv.moves);
    assert_string_equal(first[1].texture_path, "/e.png");
    assert_int_equal(first[1].component, 2);
    assert_true(first[1].uv.moves && first[1].uv.scale[0] == 2 && first[1].uv.offset[1] == -0.5f);
    assert_string_equal(second[0].texture_path, "/r.png");
    assert_true(second[1].value[2] == 3);
    assert_int_equal(fmt_tris_require_channel(file, "roughness"), 0);
    assert_int_equal(fmt_tris_require_channel(file, "gloss"), BSQ_EDATA);
    assert_non_null(strstr(bsq_error(f->ctx), "bisque-voxelize --channels gloss"));
    fmt_tris_close(file);
    free(bytes);
}

static void damaged_channels_are_found(void **state)
{
    static const struct {
        uint64_t at;
        uint32_t value;
        const char *message;
    } cases[] = {
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
    struct fixture *f = *state;
    size_t size;
    uint8_t *bytes = write_channels(f, &size), *changed = malloc(size);
    assert_int_equal(read_all(f), 0);
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        memcpy(changed, bytes, size);
        memcpy(changed + cases[i].at, &cases[i].value, 4);
        sign_materials(changed, size);
        write_bytes(f->path, changed, size);
        assert_int_equal(read_all(f), BSQ_EDATA);
        if (!strstr(bsq_error(f->ctx), cases[i].message))
            fail_msg("\"%s\" is not in \"%s\"", cases[i].message, bsq_error(f->ctx));
    }
    free(changed);
    free(bytes);
}

static void values_out_of_range_are_found(void **state)
{
    static const struct {
        size_t at;
        uint32_t value;
        const char *message;
    } cases[] = {
        {8, 4, "version 4"},
        {12, 31, "unknown attributes"},
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
    struct fixture *f = *state;
    size_t size;
    fill(f->samples[0], 15, 5, 7, 4);
    write_sample_file(f, 15, 1);
    uint8_t *bytes = read_bytes(f->path, &size), *changed = malloc(size);
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        memcpy(changed, bytes, size);
        memcpy(changed + cases[i].at, &cases[i].value, 4);
        sign(changed, size);
        write_bytes(f->path, changed, size);
        assert_int_equal(read_all(f), BSQ_EDATA);
        if (!strstr(bsq_error(f->ctx), cases[i].message))
            fail_msg("\"%s\" is not in \"%s\"", cases[i].message, bsq_error(f->ctx));
    }
    /* A table entry that claims more triangles than a chunk may have. */
    memcpy(changed, bytes, size);
    memset(changed + u64_at(bytes, 104) + 24, 0xff, 4);
    sign(changed, size);
    write_bytes(f->path, changed, size);
    assert_int_equal(read_all(f), BSQ_EDATA);
    assert_non_null(strstr(bsq_error(f->ctx), "entry 0 of the table"));
    free(changed);
    free(bytes);
}

static void other_files_are_refused(void **state)
{
    struct fixture *f = *state;
    enum fmt_kind kind;
    write_bytes(f->path, "v 0 0 0\n", 8);
    assert_int_equal(fmt_recognise(f->ctx, f->path, &kind), 0);
    assert_int_equal(kind, FMT_KIND_OTHER);
    assert_int_equal(read_all(f), BSQ_EDATA);
    assert_non_null(strstr(bsq_error(f->ctx), "not a chunk file"));
    unlink(f->path);
    bsq_clear_error(f->ctx);
    assert_int_equal(fmt_recognise(f->ctx, f->path, &kind), BSQ_ENOINPUT);
    assert_int_equal(kind, FMT_KIND_OTHER);
    assert_int_equal(read_all(f), BSQ_ENOINPUT);
}

static void nothing_remains_of_a_discarded_file(void **state)
{
    struct fixture *f = *state;
    struct fmt_tris_header header = {.attributes = 0};
    struct fmt_tris_writer *writer;
    assert_int_equal(fmt_tris_create(f->ctx, f->path, &header, &writer), 0);
    fmt_tris_discard(writer);
    assert_int_not_equal(access(f->path, F_OK), 0);
    fmt_tris_discard(NULL);
}

int main(void)
{
#define TEST(name) cmocka_unit_test_setup_teardown(name, setup, teardown)
    const struct CMUnitTest tests[] = {
        TEST(every_set_of_attributes_comes_back),
        TEST(large_chunks_come_back),
        TEST(a_file_without_chunks_is_valid),
        TEST(bytes_are_those_of_the_specification),
        TEST(every_truncated_length_is_found),
        TEST(a_file_that_changes_is_not_read),
        TEST(every_flipped_bit_is_found),
        TEST(sizes_are_compared_with_the_file),
        TEST(padding_is_zero),
        TEST(padding_of_materials_is_zero),
        TEST(names_of_ids_come_back),
        TEST(damaged_names_of_ids_are_found),
        TEST(channels_come_back),
        TEST(damaged_channels_are_found),
        TEST(values_out_of_range_are_found),
        TEST(other_files_are_refused),
        TEST(nothing_remains_of_a_discarded_file),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
