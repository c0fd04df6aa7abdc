#include "tris_samples.h"
#include "tests/unit/fixture.h"

static uint32_t next(uint64_t *seed)
{
    *seed = *seed * 6364136223846793005u + 1442695040888963407u;
    return (uint32_t)(*seed >> 32);
}

static float next_float(uint64_t *seed)
{
    return (float)next(seed) / 4294967296.0f * 20.0f - 10.0f;
}

void tris_fill(struct tris_sample *s, uint32_t attributes, uint32_t triangles, uint32_t vertices,
               uint64_t seed)
{
    for (uint32_t v = 0; v < vertices; v++) {
        for (int axis = 0; axis < 3; axis++)
            s->positions[v][axis] = next_float(&seed);
        s->texcoords[v][0] = next_float(&seed);
        s->texcoords[v][1] = next_float(&seed);
        s->normals[v] = next(&seed);
        s->colors[v] = next(&seed);
        s->fine_colors[v] = ~s->colors[v];
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
        .fine_colors = attributes & FMT_TRIS_FINE_COLORS ? s->fine_colors : NULL,
        .triangles = (const uint32_t(*)[3])s->triangles,
        .materials = attributes & FMT_TRIS_MATERIALS ? s->materials : NULL,
    };
}

int tris_setup(void **state)
{
    struct tris_fixture *f = calloc(1, sizeof *f);
    f->ctx = test_context(1, 64 << 20);
    for (int i = 0; i < 2; i++)
        f->samples[i] = calloc(1, sizeof *f->samples[i]);
    *state = f;
    return 0;
}

int tris_teardown(void **state)
{
    struct tris_fixture *f = *state;
    test_context_end(f->ctx);
    for (int i = 0; i < 2; i++)
        free(f->samples[i]);
    unlink(tris_path);
    free(f);
    return 0;
}

uint64_t tris_made_normal(uint64_t chunk, uint64_t vertex)
{
    const uint64_t coordinate = 2097152 + 1000 * vertex;
    return coordinate | coordinate << 22 | (0x3f800 + chunk) << 44;
}

/* Writes the section of tris_write_normals(). */
static void write_normals(struct fmt_tris_writer *writer)
{
    struct fmt_tris_file *file;
    assert_int_equal(fmt_tris_normals_begin(writer, BSQ_SCAN_NORMALS_ANGLE, &file), 0);
    for (uint64_t c = 0; c < 2; c++) {
        const uint32_t vertices = 7 + 2 * (uint32_t)c, count = 2 * (uint32_t)c;
        uint64_t normals[9 + 4];
        const struct fmt_tris_crease creases[2] = {{1, 0, tris_made_normal(2, 1)},
                                                   {8, 0, tris_made_normal(2, 8)}};
        for (uint32_t v = 0; v < vertices; v++)
            normals[v] = tris_made_normal(c, v);
        memcpy(normals + vertices, creases, count * sizeof *creases);
        assert_int_equal(fmt_tris_normals_put(writer, c, normals), 0);
        assert_int_equal(
            fmt_tris_normals_finish(writer, c, creases, count,
                                    fmt_tris_normals_checksum(normals, vertices, count)),
            0);
    }
    fmt_tris_close(file);
}

/* Writes the first samples of a fixture. normals: with made ones. */
static void write_samples(struct tris_fixture *f, uint32_t attributes, uint32_t chunk_count,
                          bool normals)
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
    assert_int_equal(fmt_tris_create(f->ctx, tris_path, &header, &writer), 0);
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
    if (normals)
        write_normals(writer);
    assert_int_equal(fmt_tris_commit(writer, NULL), 0);
}

void tris_write_samples(struct tris_fixture *f, uint32_t attributes, uint32_t chunk_count)
{
    write_samples(f, attributes, chunk_count, false);
}

uint8_t *tris_write_normals(struct tris_fixture *f, size_t *size)
{
    tris_fill(f->samples[0], 0, 5, 7, 4);
    tris_fill(f->samples[1], 0, 8, 9, 5);
    write_samples(f, 0, 2, true);
    return test_read(tris_path, size);
}

uint64_t tris_u64_at(const uint8_t *bytes, size_t at)
{
    uint64_t value = 0;
    for (int i = 7; i >= 0; i--)
        value = value << 8 | bytes[at + (size_t)i];
    return value;
}
