/* test_tris.c - chunk files: round trips and the bytes of FORMATS.md. */
#include "tris_samples.h"

#include "formats/file_kind.h"
#include "tests/unit/test.h"

#include <math.h>
#include <xxhash.h>

#define FIXTURE_TEST(name) STATE_TEST(name, struct tris_fixture, tris_setup, tris_teardown)

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

static void expect_file(struct tris_fixture *f, uint32_t chunk_count)
{
    struct fmt_tris_file *file;
    enum fmt_kind kind;
    assert_int_equal(fmt_recognise(f->ctx, tris_path, &kind), 0);
    assert_int_equal(kind, FMT_KIND_TRIS);
    assert_int_equal(fmt_tris_open(f->ctx, tris_path, &file), 0);
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
        expect_array(got.fine_colors, e->fine_colors, 4 * (size_t)e->vertex_count);
        expect_array(got.triangles, e->triangles, 12 * (size_t)e->triangle_count);
        expect_array(got.materials, e->materials, 4 * (size_t)e->triangle_count);
        expect_bounds(e, &infos[i]);
        triangles += e->triangle_count;
        bsq_free(f->ctx, scratch);
    }
    assert_int_equal(h->triangle_count, triangles);
    fmt_tris_close(file);
}

FIXTURE_TEST(every_set_of_attributes_comes_back)
{
    for (uint32_t attributes = 0; attributes < 64; attributes++) {
        if (attributes & FMT_TRIS_FINE_COLORS && !(attributes & FMT_TRIS_COLORS))
            continue;
        tris_fill(f->samples[0], attributes, 101 + attributes, 57 + attributes, 1 + attributes);
        tris_fill(f->samples[1], attributes, 1, 3, 100 + attributes);
        tris_write_samples(f, attributes, 2);
        expect_file(f, 2);
    }
}

/* 16 bits can number at most 65536 vertices. */
FIXTURE_TEST(large_chunks_come_back)
{
    size_t sizes[2];
    for (uint32_t i = 0; i < 2; i++) {
        tris_fill(f->samples[0], 0, FMT_TRIS_CHUNK_TRIANGLES, 65536 + i, 9);
        tris_write_samples(f, 0, 1);
        expect_file(f, 1);
        free(test_read(tris_path, &sizes[i]));
    }
    assert_true(sizes[1] - sizes[0] > 6 * 65536);
    tris_fill(f->samples[0], 15, FMT_TRIS_CHUNK_TRIANGLES, MAX_VERTICES, 10);
    tris_write_samples(f, 15, 1);
    expect_file(f, 1);
}

/* Returns how far the nearest triangle of a sample that looks up is from a point, along z. */
static float height_above(const struct fmt_tris_chunk *sample, const float p[3])
{
    float nearest = INFINITY;
    for (uint32_t t = 0; t < sample->triangle_count; t++) {
        const uint32_t *v = sample->triangles[t];
        double area[3], z = 0;
        for (int k = 0; k < 3; k++) {
            const float *a = sample->positions[v[(k + 1) % 3]],
                        *b = sample->positions[v[(k + 2) % 3]];
            area[k] = (double)(a[0] - p[0]) * (double)(b[1] - p[1]) -
                      (double)(b[0] - p[0]) * (double)(a[1] - p[1]);
            z += area[k] * (double)sample->positions[v[k]][2];
        }
        const double sum = area[0] + area[1] + area[2];
        if (area[0] < 0 || area[1] < 0 || area[2] < 0 || sum <= 0)
            continue;
        const float height = (float)(z / sum) - p[2];
        nearest = fabsf(height) < fabsf(nearest) ? height : nearest;
    }
    return nearest;
}

/* Triangles of a wave and, below it, of a floor that looks down, in turns: each patch has both if
 * the wall between them is thin. Far from them stands a tower. */
static void fill_wave(struct tris_sample *s, float wall)
{
    enum { SIDE = 64 };
    uint32_t triangles = 0, vertices = 0;
    for (uint32_t side = 0; side < 2; side++)
        for (uint32_t i = 0; i < (SIDE + 1) * (SIDE + 1); i++, vertices++) {
            float *at = s->positions[vertices];
            at[0] = (float)(i % (SIDE + 1));
            at[1] = (float)(i / (SIDE + 1));
            at[2] = side == 0 ? sinf(0.2f * at[0]) : -1 - wall;
            if (side == 0 && i == (SIDE + 1) * 20 + 20)
                at[2] = 30;
        }
    for (uint32_t i = 0; i < SIDE * SIDE; i++)
        for (uint32_t side = 0; side < 2; side++) {
            const uint32_t block = i / 16, a = side * (SIDE + 1) * (SIDE + 1) +
                                               (block / 16 * 4 + i % 16 / 4) * (SIDE + 1) +
                                               block % 16 * 4 + i % 4;
            const uint32_t b = a + 1, c = a + SIDE + 2, d = a + SIDE + 1;
            const uint32_t two[2][3] = {{a, side ? c : b, side ? b : c},
                                        {a, side ? d : c, side ? c : d}};
            memcpy(s->triangles[triangles], two, sizeof two);
            triangles += 2;
        }
    s->chunk = (struct fmt_tris_chunk){.triangle_count = triangles,
                                       .vertex_count = vertices,
                                       .positions = (const float(*)[3])s->positions,
                                       .triangles = (const uint32_t(*)[3])s->triangles};
}

/* A sample has no gaps, is near the triangles, and keeps what stands out. */
FIXTURE_TEST(samples_stand_for_their_triangles)
{
    struct fmt_tris_file *file;
    struct fmt_tris_chunk sample;
    void *scratch;
    bool found = false;
    for (int thin = 0; thin < 2; thin++) {
        struct tris_sample *s = f->samples[0];
        float highest = 0;
        fill_wave(s, thin ? 1 : 40);
        tris_write_samples(f, FMT_TRIS_SAMPLES, 1);
        assert_int_equal(fmt_tris_open(f->ctx, tris_path, &file), 0);
        assert_int_equal(fmt_tris_verify(file, NULL), 0);
        assert_int_equal(bsq_alloc(f->ctx, "test", fmt_tris_load_size(file, 0), 1, &scratch), 0);
        assert_int_equal(fmt_tris_load_sample(file, 0, scratch, &sample, &found), 0);
        assert_true(found && sample.triangle_count < s->chunk.triangle_count / 8);
        for (uint32_t v = 0; v < 65 * 65; v++)
            if (s->positions[v][2] < 2) {
                const float p[3] = {0.01f + 0.999f * s->positions[v][0],
                                    0.013f + 0.999f * s->positions[v][1], s->positions[v][2]};
                const bool by_tower = hypotf(p[0] - 20, p[1] - 20) < 13;
                assert_true(fabsf(height_above(&sample, p)) < (by_tower ? 32 : 2));
            }
        for (uint32_t v = 0; v < sample.vertex_count; v++)
            highest = fmaxf(highest, sample.positions[v][2]);
        assert_true(highest > 5);
        bsq_free(f->ctx, scratch);
        fmt_tris_close(file);
    }
}

FIXTURE_TEST(a_file_without_chunks_is_valid)
{
    tris_write_samples(f, 0, 0);
    expect_file(f, 0);
}

/* ---- bytes at the offsets of FORMATS.md ---- */

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

FIXTURE_TEST(bytes_are_those_of_the_specification)
{
    struct tris_sample *s = f->samples[0];
    size_t size;
    tris_fill(s, 15, 5, 7, 4);
    tris_write_samples(f, 15, 1);
    uint8_t *b = test_read(tris_path, &size);
    assert_memory_equal(b, "\x42\x53\x51\x54\x52\x49\x53\x0a", 8);
    assert_int_equal(u32_at(b, 8), 7);
    assert_int_equal(u32_at(b, 12), 15);
    assert_int_equal(tris_u64_at(b, 16), 5);
    assert_int_equal(tris_u64_at(b, 24), 1);
    assert_int_equal(tris_u64_at(b, 32), 77);
    assert_int_equal(tris_u64_at(b, 40), 5);
    assert_int_equal(tris_u64_at(b, 48), 0x411f400000000000u); /* 512000.0 */
    size_t chunk_bytes = 7 * (12 + 4 + 8 + 4) + 5 * 4 + 5 * 6;
    chunk_bytes += (8 - chunk_bytes % 8) % 8;
    size_t materials = 176 + chunk_bytes, table = materials + 36 + 15 + 4 + 36 + 4;
    table += (8 - table % 8) % 8;
    assert_int_equal(tris_u64_at(b, 96), 176);
    assert_int_equal(tris_u64_at(b, 104), materials);
    assert_int_equal(tris_u64_at(b, 112), table);
    assert_int_equal(tris_u64_at(b, 120), size);
    assert_int_equal(size, table + 104);
    assert_int_equal(u32_at(b, 128), 2);
    assert_int_equal(u32_at(b, 132), 0);
    assert_int_equal(tris_u64_at(b, 136), 0);
    assert_true(tris_u64_at(b, 144) == XXH3_64bits(b, 0));
    assert_true(tris_u64_at(b, 152) == XXH3_64bits(b + materials, table - materials));
    assert_true(tris_u64_at(b, 160) == XXH3_64bits(b + table, 104));
    assert_true(tris_u64_at(b, 168) == XXH3_64bits(b, 168));
    for (uint32_t v = 0; v < 7; v++) {
        for (size_t axis = 0; axis < 3; axis++)
            assert_true(f32_at(b, 176 + 12 * v + 4 * axis) == s->positions[v][axis]);
        assert_int_equal(u32_at(b, 260 + 4 * v), s->normals[v]);
        assert_true(f32_at(b, 288 + 8 * v) == s->texcoords[v][0]);
        assert_true(f32_at(b, 292 + 8 * v) == s->texcoords[v][1]);
        assert_int_equal(u32_at(b, 344 + 4 * v), s->colors[v]);
    }
    for (uint32_t t = 0; t < 5; t++) {
        assert_int_equal(u32_at(b, 372 + 4 * t), s->materials[t]);
        for (size_t k = 0; k < 3; k++)
            assert_int_equal(b[392 + 6 * t + 2 * k] | b[393 + 6 * t + 2 * k] << 8,
                             s->triangles[t][k]);
    }
    assert_true(f32_at(b, materials + 4) == 0.5f);
    assert_true(f32_at(b, materials + 16) == 1 && f32_at(b, materials + 24) == 0);
    assert_int_equal(u32_at(b, materials + 32), 15);
    assert_memory_equal(b + materials + 36, "/a dir/wall.png", 15);
    assert_int_equal(u32_at(b, materials + 51), 0);
    assert_int_equal(u32_at(b, materials + 55 + 32), 0xffffffffu);
    assert_int_equal(tris_u64_at(b, table), 176);
    assert_int_equal(tris_u64_at(b, table + 8), chunk_bytes);
    assert_int_equal(tris_u64_at(b, table + 16), 0);
    assert_int_equal(u32_at(b, table + 24), 5);
    assert_int_equal(u32_at(b, table + 28), 7);
    assert_true(tris_u64_at(b, table + 56) == XXH3_64bits(b + 176, chunk_bytes));
    for (size_t at = 64; at < 104; at += 8)
        assert_int_equal(tris_u64_at(b, table + at), 0);
    free(b);
}

FIXTURE_TEST(bytes_of_made_normals_are_those_of_the_specification)
{
    size_t size;
    uint8_t *b = tris_write_normals(f, &size);
    const size_t chunks = tris_u64_at(b, 96), materials = tris_u64_at(b, 104),
                 table = tris_u64_at(b, 112), first = tris_u64_at(b, table + 72);
    assert_int_equal(u32_at(b, 140), BSQ_SCAN_NORMALS_ANGLE);
    assert_int_equal(first, chunks + tris_u64_at(b, table + 8) + tris_u64_at(b, table + 104 + 8));
    assert_int_equal(tris_u64_at(b, table + 104 + 72), first + 8 * 7);
    assert_int_equal(tris_u64_at(b, table + 80), first + 8 * 7 + 8 * 9);
    assert_int_equal(tris_u64_at(b, table + 104 + 80), first + 8 * 7 + 8 * 9);
    assert_int_equal(u32_at(b, table + 96), 0);
    assert_int_equal(u32_at(b, table + 104 + 96), 2);
    assert_int_equal(materials, first + 8 * (7 + 9) + 2 * 16);
    for (uint32_t v = 0; v < 7; v++)
        assert_true(tris_u64_at(b, first + 8 * v) == tris_made_normal(0, v));
    const size_t creases = first + 8 * (7 + 9);
    assert_int_equal(u32_at(b, creases), 1);
    assert_int_equal(u32_at(b, creases + 4), 0);
    assert_true(tris_u64_at(b, creases + 8) == tris_made_normal(2, 1));
    assert_int_equal(u32_at(b, creases + 16), 8);
    /* Those of the second chunk's vertices and its creases follow each other here. */
    assert_true(tris_u64_at(b, table + 88) == XXH3_64bits(b + first, 8 * 7));
    assert_true(tris_u64_at(b, table + 104 + 88) == XXH3_64bits(b + first + 8 * 7, 8 * 9 + 2 * 16));
    struct fmt_tris_file *file;
    struct fmt_tris_normals normals;
    uint64_t scratch[64];
    assert_int_equal(fmt_tris_open(f->ctx, tris_path, &file), 0);
    assert_int_equal(fmt_tris_get_header(file)->made_normals, BSQ_SCAN_NORMALS_ANGLE);
    assert_int_equal(fmt_tris_normals_size_max(file), 8 * 9 + 2 * 16);
    assert_int_equal(fmt_tris_verify(file, NULL), 0);
    assert_int_equal(fmt_tris_load_normals(file, 1, scratch, &normals), 0);
    assert_int_equal(normals.crease_count, 2);
    assert_true(normals.vertices[3] == tris_made_normal(1, 3));
    assert_int_equal(normals.creases[1].vertex, 8);
    fmt_tris_close(file);
    free(b);
}

FIXTURE_TEST(names_of_ids_come_back)
{
    static const char *const names[] = {"body", "", "gl\xc3\xa4s"};
    struct fmt_tris_file *file;
    size_t size;
    uint8_t *bytes = tris_write_ids(f, &size);
    assert_int_equal(fmt_tris_open(f->ctx, tris_path, &file), 0);
    const struct fmt_tris_header *h = fmt_tris_get_header(file);
    assert_int_equal(h->ids, FMT_IDS_OBJECT);
    assert_int_equal(h->material_count, 3);
    for (int i = 0; i < 3; i++) {
        assert_string_equal(h->materials[i].name, names[i]);
        assert_int_equal(h->materials[i].colorless, i == 1);
        assert_int_equal(h->materials[i].texture_path != NULL, i == 0);
    }
    fmt_tris_close(file);
    free(bytes);
}

FIXTURE_TEST(channels_come_back)
{
    struct fmt_tris_file *file;
    size_t size;
    uint8_t *bytes = tris_write_channels(f, &size);
    assert_int_equal(fmt_tris_open(f->ctx, tris_path, &file), 0);
    const struct fmt_tris_header *h = fmt_tris_get_header(file);
    assert_int_equal(h->ids, FMT_IDS_NONE);
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
    fmt_tris_close(file);
    free(bytes);
}

FIXTURE_TEST(factors_and_wrap_modes_come_back)
{
    char *channels[] = {(char *)"roughness"};
    for (int i = 0; i < 6; i++) {
        struct fmt_tris_source source = {.texture_path = (char *)"/r.png", .value = {1, 1, 1}};
        struct fmt_tris_material material = {
            .sources = &source, .texture_path = (char *)"/a.png", .colorless = i == 4};
        const struct fmt_tris_header header = {
            .material_count = 1, .materials = &material, .channel_count = 1, .channels = channels};
        struct fmt_tris_writer *writer;
        struct fmt_tris_file *file;
        source.value[1] = i == 1 ? 0.5f : 1;
        source.uv.wrap[1] = i == 2 ? FMT_WRAP_MIRROR : FMT_WRAP_REPEAT;
        material.uv.wrap[0] = i == 3 ? FMT_WRAP_CLAMP : FMT_WRAP_REPEAT;
        material.tinted = i == 4;
        material.uv.srgb = i == 5;
        assert_int_equal(fmt_tris_create(f->ctx, tris_path, &header, &writer), 0);
        assert_int_equal(fmt_tris_commit(writer, NULL), 0);
        assert_int_equal(fmt_tris_open(f->ctx, tris_path, &file), 0);
        const struct fmt_tris_material *m = fmt_tris_get_header(file)->materials;
        assert_true(m->sources->value[0] == 1 && m->sources->value[1] == source.value[1]);
        assert_memory_equal(m->sources->uv.wrap, source.uv.wrap, 2);
        assert_memory_equal(m->uv.wrap, material.uv.wrap, 2);
        assert_int_equal(m->tinted, material.tinted);
        assert_true(m->uv.srgb == material.uv.srgb && !m->sources->uv.srgb);
        assert_int_equal(m->colorless, material.colorless);
        fmt_tris_close(file);
    }
}

FIXTURE_TEST(nothing_remains_of_a_discarded_file)
{
    struct fmt_tris_header header = {.attributes = 0};
    struct fmt_tris_writer *writer;
    assert_int_equal(fmt_tris_create(f->ctx, tris_path, &header, &writer), 0);
    fmt_tris_discard(writer);
    assert_int_not_equal(access(tris_path, F_OK), 0);
    fmt_tris_discard(NULL);
}

RUN_TESTS(NULL, NULL)
