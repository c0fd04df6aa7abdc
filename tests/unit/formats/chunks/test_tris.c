/* test_tris.c - chunk files come back as they were written. tests/cli/test_formats.sh and
 * test_oracle.sh read their bytes by FORMATS.md alone. */
#include "tris_samples.h"

#include "formats/file_kind.h"
#include "tests/unit/test.h"

#include <math.h>

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
