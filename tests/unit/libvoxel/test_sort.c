/* Sorting scans: every triangle comes out once, with its attributes, and the file is the same
 * whatever the memory and the threads. Scans are made here as text together with what is expected.
 */
#include "libvoxel/sort_internal.h"
#include "base/octahedral.h"
#include "formats/tris.h"

#include <errno.h>
#include <math.h>
#include <setjmp.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
#include <cmocka.h>

#define MIB ((uint64_t)1 << 20)

/* ---- fixture ---- */

struct fixture {
    char dir[64], obj[96], obj2[96], tris[96];
    struct bsq_ctx *ctx;
    char warning[256];
    unsigned warnings;
    struct vox_sort_report report;
};

static void keep_warning(void *user, const char *line)
{
    struct fixture *f = user;
    snprintf(f->warning, sizeof f->warning, "%s", line);
    f->warnings++;
}

static void open_context(struct fixture *f, uint64_t memory, unsigned threads)
{
    struct bsq_ctx_options options = {.memory_bytes = memory,
                                      .threads = threads,
                                      .tmpdir = f->dir,
                                      .on_warning = keep_warning,
                                      .user = f};
    if (f->ctx) {
        assert_int_equal(bsq_memory_used(f->ctx), 0);
        assert_true(bsq_memory_high(f->ctx) <= bsq_memory_limit(f->ctx));
        bsq_ctx_destroy(f->ctx);
    }
    assert_int_equal(bsq_ctx_create(&options, &f->ctx), 0);
}

static int setup(void **state)
{
    struct fixture *f = calloc(1, sizeof *f);
    snprintf(f->dir, sizeof f->dir, "/tmp/test_sort_XXXXXX");
    assert_non_null(mkdtemp(f->dir));
    snprintf(f->obj, sizeof f->obj, "%s/scan.obj", f->dir);
    snprintf(f->obj2, sizeof f->obj2, "%s/more.obj", f->dir);
    snprintf(f->tris, sizeof f->tris, "%s/scan.tris", f->dir);
    open_context(f, 256 * MIB, 2);
    *state = f;
    return 0;
}

static int teardown(void **state)
{
    struct fixture *f = *state;
    char path[128];
    open_context(f, MIB, 1);
    bsq_ctx_destroy(f->ctx);
    unlink(f->obj);
    unlink(f->obj2);
    unlink(f->tris);
    snprintf(path, sizeof path, "%s/scan.mtl", f->dir);
    unlink(path);
    snprintf(path, sizeof path, "%s/wall.png", f->dir);
    unlink(path);
    assert_int_equal(rmdir(f->dir), 0); /* nothing else may have been left */
    free(f);
    return 0;
}

static void write_text(const char *path, const char *text)
{
    FILE *file = fopen(path, "wb");
    assert_non_null(file);
    assert_true(fputs(text, file) >= 0);
    assert_int_equal(fclose(file), 0);
}

static int sort_files(struct fixture *f, const char *const *paths, uint32_t count)
{
    struct vox_sort_options options = {
        .obj_paths = paths, .obj_count = count, .tris_path = f->tris};
    bsq_clear_error(f->ctx);
    return vox_sort(f->ctx, &options, &f->report);
}

static int sort_text(struct fixture *f, const char *text)
{
    const char *paths[1] = {f->obj};
    write_text(f->obj, text);
    return sort_files(f, paths, 1);
}

static void expect_sorted(struct fixture *f, int status)
{
    if (status < 0)
        fail_msg("status %d: %s", status, bsq_error(f->ctx));
}

/* ---- triangles as a multiset ---- */

struct corner {
    float position[3];
    float texcoord[2];
    uint32_t color, normal;
};

struct triangle {
    struct corner corners[3];
    uint32_t material;
};

struct triangles {
    struct triangle *list;
    size_t count, capacity;
};

static void triangles_add(struct triangles *t, const struct triangle *one)
{
    if (t->count == t->capacity) {
        t->capacity = t->capacity ? 2 * t->capacity : 1024;
        t->list = realloc(t->list, t->capacity * sizeof *t->list);
        assert_non_null(t->list);
    }
    /* The least corner goes first, as the first corner of a triangle means nothing; winding stays.
     */
    int least = 0;
    for (int k = 1; k < 3; k++)
        if (memcmp(&one->corners[k], &one->corners[least], sizeof one->corners[k]) < 0)
            least = k;
    struct triangle *to = &t->list[t->count++];
    for (int k = 0; k < 3; k++)
        to->corners[k] = one->corners[(least + k) % 3];
    to->material = one->material;
}

static int compare_triangles(const void *a, const void *b)
{
    return memcmp(a, b, sizeof(struct triangle));
}

static void expect_same(struct triangles *got, struct triangles *expected)
{
    assert_int_equal(got->count, expected->count);
    qsort(got->list, got->count, sizeof *got->list, compare_triangles);
    qsort(expected->list, expected->count, sizeof *expected->list, compare_triangles);
    assert_memory_equal(got->list, expected->list, got->count * sizeof *got->list);
    free(got->list);
    free(expected->list);
    *got = *expected = (struct triangles){0};
}

/* ---- reading the result ---- */

static void take_chunk(const struct fmt_tris_chunk *chunk, struct triangles *out)
{
    for (uint32_t t = 0; t < chunk->triangle_count; t++) {
        struct triangle one;
        memset(&one, 0, sizeof one);
        for (int k = 0; k < 3; k++) {
            uint32_t v = chunk->triangles[t][k];
            memcpy(one.corners[k].position, chunk->positions[v], 12);
            if (chunk->texcoords)
                memcpy(one.corners[k].texcoord, chunk->texcoords[v], 8);
            if (chunk->colors)
                one.corners[k].color = chunk->colors[v];
            if (chunk->normals)
                one.corners[k].normal = chunk->normals[v];
        }
        one.material = chunk->materials ? chunk->materials[t] : UINT32_MAX;
        triangles_add(out, &one);
    }
}

/* Bounds must be exactly those of the chunk's triangles. */
static void expect_bounds(const struct fmt_tris_chunk *chunk,
                          const struct fmt_tris_chunk_info *info)
{
    float low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
    for (uint32_t t = 0; t < chunk->triangle_count; t++)
        for (int k = 0; k < 3; k++)
            for (int axis = 0; axis < 3; axis++) {
                float p = chunk->positions[chunk->triangles[t][k]][axis];
                low[axis] = fminf(low[axis], p);
                high[axis] = fmaxf(high[axis], p);
            }
    assert_memory_equal(low, info->bounds_min, sizeof low);
    assert_memory_equal(high, info->bounds_max, sizeof high);
}

/* Reads the sorted file whole; header (may be NULL) is copied without its materials. */
static void read_sorted(struct fixture *f, struct triangles *out, struct fmt_tris_header *header)
{
    struct fmt_tris_file *file;
    void *scratch;
    if (fmt_tris_open(f->ctx, f->tris, &file) < 0)
        fail_msg("%s", bsq_error(f->ctx));
    const struct fmt_tris_header *h = fmt_tris_get_header(file);
    const struct fmt_tris_chunk_info *infos = fmt_tris_chunks(file);
    assert_int_equal(bsq_alloc(f->ctx, "test", fmt_tris_load_size_max(file) + 1, 1, &scratch), 0);
    for (uint64_t i = 0; i < h->chunk_count; i++) {
        struct fmt_tris_chunk chunk;
        if (fmt_tris_load(file, i, scratch, &chunk) < 0)
            fail_msg("%s", bsq_error(f->ctx));
        expect_bounds(&chunk, &infos[i]);
        if (i + 1 < h->chunk_count)
            assert_true(chunk.triangle_count >= FMT_TRIS_CHUNK_TRIANGLES / 2);
        if (out)
            take_chunk(&chunk, out);
    }
    assert_int_equal(h->triangle_count, f->report.triangles);
    assert_int_equal(h->chunk_count, f->report.chunks);
    assert_int_equal(h->source_faces, f->report.faces);
    assert_int_equal(h->skipped_triangles, f->report.degenerate_triangles);
    if (header) {
        *header = *h;
        header->materials = NULL;
    }
    bsq_free(f->ctx, scratch);
    fmt_tris_close(file);
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

/* ---- random scans ---- */

static uint32_t next(uint64_t *seed)
{
    *seed = *seed * 6364136223846793005u + 1442695040888963407u;
    return (uint32_t)(*seed >> 32);
}

enum { WITH_COLORS = 1, WITH_NORMALS = 2, SHUFFLED = 4 };

/* A bumpy grid of n x n quads, two triangles each; vertices are numbered row by row. */
struct grid {
    uint32_t n;
    double (*positions)[3];
    uint8_t (*colors)[3];
};

static void make_grid(struct grid *g, uint32_t n, uint64_t seed)
{
    g->n = n;
    g->positions = malloc((size_t)(n + 1) * (n + 1) * sizeof *g->positions);
    g->colors = malloc((size_t)(n + 1) * (n + 1) * sizeof *g->colors);
    for (uint32_t y = 0; y <= n; y++)
        for (uint32_t x = 0; x <= n; x++) {
            size_t v = (size_t)y * (n + 1) + x;
            g->positions[v][0] = x + next(&seed) % 1000 / 4000.0;
            g->positions[v][1] = y + next(&seed) % 1000 / 4000.0;
            g->positions[v][2] = next(&seed) % 1000 / 100.0 + 0.01;
            for (int i = 0; i < 3; i++)
                g->colors[v][i] = (uint8_t)next(&seed);
        }
}

static void free_grid(struct grid *g)
{
    free(g->positions);
    free(g->colors);
}

static void quad_corner(const struct grid *g, uint32_t quad, int half, size_t v[3])
{
    size_t a = (size_t)(quad / g->n) * (g->n + 1) + quad % g->n, d = a + g->n + 1;
    v[0] = half ? a + 1 : a;
    v[1] = half ? d + 1 : a + 1;
    v[2] = d;
}

static void write_grid(const struct grid *g, const char *path, unsigned flags, uint64_t seed)
{
    FILE *file = fopen(path, "wb");
    const uint32_t quads = g->n * g->n;
    uint32_t *order = malloc(quads * sizeof *order);
    for (size_t v = 0; v < (size_t)(g->n + 1) * (g->n + 1); v++) {
        fprintf(file, "v %.5f %.5f %.5f", g->positions[v][0], g->positions[v][1],
                g->positions[v][2]);
        if (flags & WITH_COLORS)
            fprintf(file, " %.4f %.4f %.4f", g->colors[v][0] / 255.0, g->colors[v][1] / 255.0,
                    g->colors[v][2] / 255.0);
        fputc('\n', file);
    }
    for (uint32_t i = 0; i < quads; i++)
        order[i] = i;
    for (uint32_t i = quads - 1; flags & SHUFFLED && i > 0; i--) {
        uint32_t other = next(&seed) % (i + 1), kept = order[i];
        order[i] = order[other];
        order[other] = kept;
    }
    if (flags & WITH_NORMALS)
        fputs("vn 0 0 1\nvn 0 1 0\nvn 0 0 0\n", file);
    for (uint32_t i = 0; i < quads; i++)
        for (int half = 0; half < 2; half++) {
            size_t v[3];
            quad_corner(g, order[i], half, v);
            if (flags & WITH_NORMALS)
                fprintf(file, "f %zu//1 %zu//2 %zu\n", v[0] + 1, v[1] + 1, v[2] + 1);
            else
                fprintf(file, "f %zu %zu %zu\n", v[0] + 1, v[1] + 1, v[2] + 1);
        }
    free(order);
    assert_int_equal(fclose(file), 0);
}

static uint32_t pack_cross(const float p[3][3])
{
    double u[3], v[3], n[3];
    for (int i = 0; i < 3; i++) {
        u[i] = (double)p[1][i] - p[0][i];
        v[i] = (double)p[2][i] - p[0][i];
    }
    n[0] = u[1] * v[2] - u[2] * v[1];
    n[1] = u[2] * v[0] - u[0] * v[2];
    n[2] = u[0] * v[1] - u[1] * v[0];
    double length = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
    return bsq_oct_pack(
        bsq_v3((float)(n[0] / length), (float)(n[1] / length), (float)(n[2] / length)));
}

/* Face normals are compared for angle elsewhere, here only their presence: they are masked out. */
static void expect_grid(const struct grid *g, unsigned flags, struct triangles *out)
{
    for (uint32_t quad = 0; quad < g->n * g->n; quad++)
        for (int half = 0; half < 2; half++) {
            struct triangle one;
            size_t v[3];
            memset(&one, 0, sizeof one);
            quad_corner(g, quad, half, v);
            for (int k = 0; k < 3; k++) {
                struct corner *c = &one.corners[k];
                for (int axis = 0; axis < 3; axis++)
                    c->position[axis] = (float)g->positions[v[k]][axis];
                if (flags & WITH_COLORS)
                    c->color = 0xff000000u | (uint32_t)g->colors[v[k]][2] << 16 |
                               (uint32_t)g->colors[v[k]][1] << 8 | g->colors[v[k]][0];
            }
            if (flags & WITH_NORMALS) {
                one.corners[0].normal = bsq_oct_pack(bsq_v3(0, 0, 1));
                one.corners[1].normal = bsq_oct_pack(bsq_v3(0, 1, 0));
            }
            one.material = UINT32_MAX;
            triangles_add(out, &one);
        }
}

/* Third corners of expect_grid() lack a normal and have their triangle's. */
static void check_face_normals(struct triangles *t)
{
    const uint32_t up = bsq_oct_pack(bsq_v3(0, 0, 1)), along = bsq_oct_pack(bsq_v3(0, 1, 0));
    for (size_t i = 0; i < t->count; i++) {
        struct triangle one = t->list[i];
        float p[3][3];
        for (int k = 0; k < 3; k++)
            memcpy(p[k], one.corners[k].position, 12);
        struct bsq_vec3 expected = bsq_oct_unpack(pack_cross((const float(*)[3])p));
        for (int k = 0; k < 3; k++)
            if (one.corners[k].normal != up && one.corners[k].normal != along) {
                struct bsq_vec3 n = bsq_oct_unpack(one.corners[k].normal);
                assert_true(bsq_dot3(n, expected) > 0.999999f);
                one.corners[k].normal = 0;
            }
        t->count--;
        struct triangles place = {t->list + i, 0, 1};
        triangles_add(&place, &one);
        t->count++;
    }
}

/* ---- every triangle, once ---- */

static void every_triangle_of_a_grid_comes_out_once(void **state)
{
    struct fixture *f = *state;
    const char *paths[1] = {f->obj};
    for (unsigned flags = 0; flags < 8; flags++) {
        struct grid g;
        struct triangles got = {0}, expected = {0};
        make_grid(&g, 150, 11 + flags);
        write_grid(&g, f->obj, flags, 5);
        expect_sorted(f, sort_files(f, paths, 1));
        assert_int_equal(f->report.triangles, 2 * 150 * 150);
        assert_int_equal(f->report.faces, 2 * 150 * 150);
        assert_int_equal(f->report.vertices, 151 * 151);
        assert_int_equal(f->report.unused_vertices, 0);
        assert_int_equal(f->report.has_colors, (flags & WITH_COLORS) != 0);
        assert_int_equal(f->report.has_normals, (flags & WITH_NORMALS) != 0);
        read_sorted(f, &got, NULL);
        expect_grid(&g, flags, &expected);
        if (flags & WITH_NORMALS)
            check_face_normals(&got);
        expect_same(&got, &expected);
        free_grid(&g);
    }
}

/* Corners of their own for every triangle, anywhere in a cube: no neighbours, all cells in use. */
static void every_triangle_of_a_soup_comes_out_once(void **state)
{
    struct fixture *f = *state;
    const char *paths[1] = {f->obj};
    struct triangles got = {0}, expected = {0};
    uint64_t seed = 77;
    FILE *file = fopen(f->obj, "wb");
    for (uint32_t t = 0; t < 90000; t++) {
        struct triangle one;
        memset(&one, 0, sizeof one);
        for (int k = 0; k < 3; k++) {
            for (int axis = 0; axis < 3; axis++)
                one.corners[k].position[axis] = (float)(next(&seed) % 100000) / 64.0f - 700.0f;
            fprintf(file, "v %.9g %.9g %.9g\n", one.corners[k].position[0],
                    one.corners[k].position[1], one.corners[k].position[2]);
        }
        fputs("f -3 -2 -1\n", file);
        one.material = UINT32_MAX;
        triangles_add(&expected, &one);
    }
    fclose(file);
    expect_sorted(f, sort_files(f, paths, 1));
    read_sorted(f, &got, NULL);
    expect_same(&got, &expected);
}

/* ---- the same bytes, whatever the memory and the threads ---- */

struct reference {
    uint8_t *bytes;
    size_t size;
};

static void expect_same_file(struct fixture *f, struct reference *reference)
{
    size_t size;
    uint8_t *bytes = read_bytes(f->tris, &size);
    if (!reference->bytes) {
        *reference = (struct reference){bytes, size};
        return;
    }
    assert_int_equal(size, reference->size);
    assert_memory_equal(bytes, reference->bytes, size);
    free(bytes);
}

static void budgets_and_threads_do_not_change_the_file(void **state)
{
    struct fixture *f = *state;
    const char *paths[1] = {f->obj};
    static const unsigned threads[] = {1, 2, 5};
    struct reference reference = {0};
    struct grid g;
    make_grid(&g, 320, 3);
    write_grid(&g, f->obj, SHUFFLED | WITH_COLORS, 8);
    for (int t = 0; t < 3; t++)
        for (int b = 0; b < 3; b++) {
            uint64_t least = vox_memory_min(threads[t]);
            open_context(f, b == 0 ? least : b == 1 ? 2 * least : 1024 * MIB, threads[t]);
            expect_sorted(f, sort_files(f, paths, 1));
            expect_same_file(f, &reference);
        }
    free(reference.bytes);
    free_grid(&g);
}

/* Limits so small that every part of the sorter goes to files, one after the other and all
 * together. */
static void spilling_does_not_change_the_file(void **state)
{
    struct fixture *f = *state;
    static const unsigned kinds[] = {SHUFFLED | WITH_COLORS | WITH_NORMALS, SHUFFLED, 0};
    const char *paths[1] = {f->obj};
    static const uint32_t sizes[] = {320, 190, 190};
    for (int k = 0; k < 3; k++) {
        struct reference reference = {0};
        struct grid g;
        make_grid(&g, sizes[k], 4);
        write_grid(&g, f->obj, kinds[k], 9);
        for (unsigned variant = 0; variant < 11; variant++) {
            struct sort_limits limits;
            struct vox_sort_options options = {
                .obj_paths = paths, .obj_count = 1, .tris_path = f->tris};
            open_context(f, 128 * MIB, variant % 2 ? 2 : 3);
            sort_limits_for(128 * MIB, 2, &limits);
            /* Faces are kept and scattered later, or else scattered as they are read. */
            if (variant == 1 || variant == 3 || variant == 8 || variant == 9)
                limits.direct_memory = 0;
            if (variant == 10)
                limits.direct_memory = 1;
            if (variant == 1 || variant == 8)
                limits.store_bytes = g.n > 200 ? 3 * MIB : 3 * MIB / 2; /* faces */
            if (variant == 2 || variant == 8)
                limits.column_bytes = 0; /* vertices */
            if (variant == 3 || variant == 8)
                limits.page_memory = 0; /* cells */
            if (variant == 4 || variant == 8)
                limits.batch_triangles = 70000; /* cells are divided */
            if (variant == 5)
                limits.index_bytes = 5;
            if (variant == 6)
                limits.cell_levels = 1, limits.page_bytes = 100;
            if (variant == 7)
                limits.column_bytes = g.n > 200 ? 800 << 10 : 700 << 10; /* some columns */
            if (variant >= 7)
                limits.join_bytes = 100000; /* many buckets */
            expect_sorted(f, sort_with_limits(f->ctx, &options, &limits, &f->report));
            assert_int_equal(f->report.triangles, 2 * g.n * g.n);
            assert_int_equal(f->report.unused_vertices, 0);
            if (variant != 4) /* small parts of cells stay in memory */
                assert_int_equal(f->report.temp_bytes > 0,
                                 (variant >= 1 && variant <= 3) || variant == 7 ||
                                     variant == 8 || variant == 10);
            expect_same_file(f, &reference);
        }
        free(reference.bytes);
        free_grid(&g);
    }
}

/* A vertex behind the faces moves the cube around the scan, and the samples that the reader takes do
 * not show it. */
static void vertices_behind_faces_are_found_late(void **state)
{
    struct fixture *f = *state;
    const char *paths[1] = {f->obj};
    struct reference reference = {0};
    struct grid g;
    make_grid(&g, 190, 4);
    for (int late = 0; late < 3; late++) {
        write_grid(&g, f->obj, 0, 9);
        FILE *file = fopen(f->obj, "ab");
        for (int i = 0; i < 40000; i++) /* the last sample ends before what comes next */
            fputs("f 1 2 3\n", file);
        fputs(late == 0 ? "f 36482 1 2\nv 9 9 9\n" : "v 9 9 9\nf 36482 1 2\n", file);
        for (int i = 0; i < 400; i++)
            fputs("f 1 2 3\n", file);
        fclose(file);
        struct sort_limits limits;
        struct vox_sort_options options = {
            .obj_paths = paths, .obj_count = 1, .tris_path = f->tris};
        sort_limits_for(256 * MIB, 2, &limits);
        if (late == 2)
            limits.direct_memory = 0;
        expect_sorted(f, sort_with_limits(f->ctx, &options, &limits, &f->report));
        assert_int_equal(f->report.triangles, 2 * g.n * g.n + 40401);
        assert_int_equal(f->report.vertices, (g.n + 1) * (g.n + 1) + 1);
        if (late > 0)
            expect_same_file(f, &reference);
    }
    free(reference.bytes);
    free_grid(&g);
}

/* More triangles than a batch with one centroid: only their order in the scan tells them apart. */
static void many_triangles_in_one_place_are_sorted(void **state)
{
    struct fixture *f = *state;
    const char *paths[1] = {f->obj};
    struct reference reference = {0};
    FILE *file = fopen(f->obj, "wb");
    fputs("v -1 -1 0\nv 1 0 0\nv 0 1 0\nv 100 100 100\nv 101 100 100\nv 100 101 100\nf 4 5 6\n",
          file);
    for (int i = 0; i < 140000; i++)
        fputs("f 1 2 3\n", file);
    fclose(file);
    for (int small = 0; small < 2; small++) {
        struct sort_limits limits;
        struct vox_sort_options options = {
            .obj_paths = paths, .obj_count = 1, .tris_path = f->tris};
        sort_limits_for(256 * MIB, 2, &limits);
        if (small)
            limits.batch_triangles = 70000;
        expect_sorted(f, sort_with_limits(f->ctx, &options, &limits, &f->report));
        assert_int_equal(f->report.triangles, 140001);
        assert_int_equal(f->report.chunks, 4); /* nothing to choose from: 3 x 32768 and the rest */
        expect_same_file(f, &reference);
        read_sorted(f, NULL, NULL);
    }
    free(reference.bytes);
}

/* ---- order ---- */

/* Interleaves by the definition, bit by bit. */
static uint64_t naive_key(const double centre[3], const float low[3], double side)
{
    uint64_t key = 0;
    for (int bit = 20; bit >= 0; bit--)
        for (int axis = 0; axis < 3; axis++) {
            double cell = floor((centre[axis] - low[axis]) / side * 2097152.0);
            uint64_t c = (uint64_t)fmin(fmax(cell, 0.0), 2097151.0);
            key = key << 1 | (c >> bit & 1);
        }
    return key;
}

/* Neighbours may be swapped where the division above rounds another way, which moves a key by one.
 */
static void triangles_are_in_morton_order(void **state)
{
    struct fixture *f = *state;
    const char *paths[1] = {f->obj};
    struct grid g;
    struct triangles got = {0};
    struct fmt_tris_header header;
    make_grid(&g, 250, 5);
    write_grid(&g, f->obj, SHUFFLED, 6);
    expect_sorted(f, sort_files(f, paths, 1));
    read_sorted(f, &got, &header);
    assert_true(header.chunk_count > 1);
    double side = 0;
    for (int axis = 0; axis < 3; axis++)
        side = fmax(side, (double)header.bounds_max[axis] - header.bounds_min[axis]);
    uint64_t before = 0;
    for (size_t i = 0; i < got.count; i++) {
        double centre[3];
        for (int axis = 0; axis < 3; axis++)
            centre[axis] =
                ((double)got.list[i].corners[0].position[axis] +
                 got.list[i].corners[1].position[axis] + got.list[i].corners[2].position[axis]) /
                3.0;
        uint64_t key = naive_key(centre, header.bounds_min, side);
        assert_true((key >> 9) + 1 >= before >> 9);
        before = key;
    }
    free(got.list);
    free_grid(&g);
}

static void ordinary_meshes_take_14_bytes_a_triangle(void **state)
{
    struct fixture *f = *state;
    const char *paths[1] = {f->obj};
    struct grid g;
    make_grid(&g, 400, 5);
    write_grid(&g, f->obj, 0, 6);
    expect_sorted(f, sort_files(f, paths, 1));
    assert_true(f->report.tris_bytes <= 14 * f->report.triangles);
    assert_true(f->report.tris_bytes >= 12 * f->report.triangles);
    free_grid(&g);
}

/* ---- what is left out ---- */

static void triangles_without_area_are_counted(void **state)
{
    struct fixture *f = *state;
    struct triangles got = {0};
    expect_sorted(f, sort_text(f, "v 0 0 0\nv 1 0 0\nv 2 0 0\nv 0 1 0\nv 0 1 0\nv 9 9 9\n"
                                  "v 0.1 0.1 0.1\nv 0.2 0.2 0.2\nv 0.3 0.3 0.3\nv -0 1 0\n"
                                  "f 1 2 4\n"   /* fine */
                                  "f 1 2 3\n"   /* collinear */
                                  "f 1 1 4\n"   /* repeated vertex */
                                  "f 2 4 5\n"   /* repeated position */
                                  "f 2 4 10\n"  /* the same with a negative zero */
                                  "f 1 2 4 5\n" /* one half without area */
                                  "f 1 2\n"));
    assert_int_equal(f->report.triangles, 2);
    assert_int_equal(f->report.degenerate_triangles, 5);
    assert_int_equal(f->report.short_faces, 1);
    assert_int_equal(f->report.faces, 6);
    assert_int_equal(f->report.unused_vertices, 4); /* 6 to 9 */
    read_sorted(f, &got, NULL);
    free(got.list);
}

static void tiny_triangles_are_kept(void **state)
{
    struct fixture *f = *state;
    expect_sorted(f, sort_text(f, "v 0 0 0\nv 1e-30 0 0\nv 0 1e-30 0\nf 1 2 3\n"
                                  "v 1000 0 0\nv 1000.0001 0 0\nv 1000 1000 0\nf 4 5 6\n"));
    assert_int_equal(f->report.triangles, 2);
    assert_int_equal(f->report.degenerate_triangles, 0);
}

/* ---- polygons ---- */

static double total_area(const struct triangles *t)
{
    double area = 0;
    for (size_t i = 0; i < t->count; i++) {
        const struct corner *c = t->list[i].corners;
        double ux = (double)c[1].position[0] - c[0].position[0];
        double uy = (double)c[1].position[1] - c[0].position[1];
        double vx = (double)c[2].position[0] - c[0].position[0];
        double vy = (double)c[2].position[1] - c[0].position[1];
        double part = (ux * vy - uy * vx) / 2;
        assert_true(part > 0); /* no triangle is turned over */
        area += part;
    }
    return area;
}

static void concave_polygons_keep_their_area(void **state)
{
    struct fixture *f = *state;
    struct triangles got = {0};
    /* An L of area 3 and an arrow of area 1, in files between triangles. */
    expect_sorted(f, sort_text(f, "v 0 0 0\nv 2 0 0\nv 2 1 0\nv 1 1 0\nv 1 2 0\nv 0 2 0\n"
                                  "v 4 0 0\nv 6 0 0\nv 5 0.5 0\nv 5 2 0\n"
                                  "f 1 2 3\nf 1 2 3 4 5 6\nf 7 8 10\nf 7 9 8 10\n"));
    assert_int_equal(f->report.faces, 4);
    (void)got;
    read_sorted(f, &got, NULL);
    assert_int_equal(got.count + f->report.degenerate_triangles, 1 + 4 + 1 + 2);
    free(got.list);
}

/* A polygon with more corners than a group of faces may have. */
static void a_polygon_of_any_size_is_split(void **state)
{
    struct fixture *f = *state;
    const char *paths[1] = {f->obj};
    struct triangles got = {0};
    const int n = 70000;
    FILE *file = fopen(f->obj, "wb");
    for (int i = 0; i < n; i++)
        fprintf(file, "v %.7f %.7f 0\n", 10 * cos(2 * M_PI * i / n), 10 * sin(2 * M_PI * i / n));
    fputs("f 1 2 3\nf", file);
    for (int i = 0; i < n; i++)
        fprintf(file, " %d", i + 1);
    fputs("\nf 1 2 3\n", file);
    fclose(file);
    expect_sorted(f, sort_files(f, paths, 1));
    assert_int_equal(f->report.triangles + f->report.degenerate_triangles, n - 2 + 2);
    read_sorted(f, &got, NULL);
    assert_true(fabs(total_area(&got) - M_PI * 100) < 1e-3);
    free(got.list);
}

/* ---- colours ---- */

static uint32_t color_at(const struct triangles *t, float x, float y)
{
    for (size_t i = 0; i < t->count; i++)
        for (int k = 0; k < 3; k++)
            if (t->list[i].corners[k].position[0] == x && t->list[i].corners[k].position[1] == y)
                return t->list[i].corners[k].color;
    fail_msg("no corner at %g %g", x, y);
    return 0;
}

static void colors_are_of_zero_to_one_or_of_bytes(void **state)
{
    struct fixture *f = *state;
    struct triangles got = {0};
    expect_sorted(f, sort_text(f, "v 0 0 0 0 0.5 1\nv 1 0 0 1 1 1\nv 0 1 0\nf 1 2 3\n"));
    read_sorted(f, &got, NULL);
    assert_int_equal(color_at(&got, 0, 0), 0xffff8000u);
    assert_int_equal(color_at(&got, 0, 1), 0xffffffffu); /* none given */
    assert_int_equal(f->warnings, 0);
    got.count = 0;
    expect_sorted(f, sort_text(f, "v 0 0 0 0 127 255\nv 1 0 0 1 300 3\nv 0 1 0 -5 0 0\nf 1 2 3\n"));
    read_sorted(f, &got, NULL);
    assert_int_equal(color_at(&got, 0, 0), 0xffff7f00u);
    assert_int_equal(color_at(&got, 1, 0), 0xff03ff01u);
    assert_int_equal(color_at(&got, 0, 1), 0xff000000u);
    assert_int_equal(f->warnings, 1);
    assert_non_null(strstr(f->warning, "2 vertices"));
    free(got.list);
}

static void colors_of_a_later_file_do_not_shift(void **state)
{
    struct fixture *f = *state;
    const char *paths[2] = {f->obj, f->obj2};
    struct triangles got = {0};
    write_text(f->obj, "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
    write_text(f->obj2, "v 5 0 0 1 0 0\nv 6 0 0 0 1 0\nv 5 1 0 0 0 1\nf 1 2 -1\n");
    expect_sorted(f, sort_files(f, paths, 2));
    assert_int_equal(f->report.triangles, 2);
    read_sorted(f, &got, NULL);
    assert_int_equal(color_at(&got, 0, 0), 0xffffffffu);
    assert_int_equal(color_at(&got, 5, 0), 0xff0000ffu);
    assert_int_equal(color_at(&got, 6, 0), 0xff00ff00u);
    assert_int_equal(color_at(&got, 5, 1), 0xffff0000u);
    free(got.list);
}

/* ---- places far from zero ---- */

static void georeferenced_scans_keep_their_detail(void **state)
{
    struct fixture *f = *state;
    struct triangles got = {0};
    struct fmt_tris_header header;
    static const double corners[3][3] = {{500000.123, 5400000.456, 112.001},
                                         {500000.124, 5400000.456, 112.002},
                                         {500001.123, 5400003.457, 113.003}};
    char text[512];
    int length = 0;
    for (int k = 0; k < 3; k++)
        length += snprintf(text + length, sizeof text - (size_t)length, "v %.3f %.3f %.3f\n",
                           corners[k][0], corners[k][1], corners[k][2]);
    snprintf(text + length, sizeof text - (size_t)length, "f 1 2 3\n");
    expect_sorted(f, sort_text(f, text));
    read_sorted(f, &got, &header);
    assert_int_equal(got.count, 1);
    for (int axis = 0; axis < 3; axis++) {
        assert_true(header.origin[axis] == f->report.origin[axis]);
        for (int k = 0; k < 3; k++) {
            double nearest = INFINITY;
            for (int j = 0; j < 3; j++)
                nearest = fmin(nearest, fabs(header.origin[axis] +
                                             (double)got.list[0].corners[j].position[axis] -
                                             corners[k][axis]));
            assert_true(nearest < 1e-5); /* z has no origin */
        }
    }
    assert_true(header.origin[0] == 500000.0); /* of a scan of about 3 */
    assert_true(header.origin[2] == 0.0);
    free(got.list);
}

static void ordinary_scans_have_no_origin(void **state)
{
    struct fixture *f = *state;
    expect_sorted(f, sort_text(f, "v 9000 0 0\nv 9500 0 0\nv 9000 500 0\nf 1 2 3\n"));
    assert_true(f->report.origin[0] == 0.0); /* far, but not for its size */
    expect_sorted(f, sort_text(f, "v 8000 0 0\nv 8001 0 0\nv 8000 1 0\nf 1 2 3\n"));
    assert_true(f->report.origin[0] == 0.0); /* near enough; this may be a patch of a scan around 0 */
}

/* ---- materials ---- */

static void write_library(struct fixture *f, const char *text)
{
    char path[128];
    snprintf(path, sizeof path, "%s/scan.mtl", f->dir);
    write_text(path, text);
}

static void write_texture(struct fixture *f)
{
    char path[128];
    snprintf(path, sizeof path, "%s/wall.png", f->dir);
    write_text(path, "only its name matters here");
}

static const char materials_obj[] =
    "mtllib scan.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 5 0 0\nv 6 0 0\nv 5 1 0\n"
    "vt 0.25 0.75\nvt 0.5 0.5\n"
    "f 1 2 3\nusemtl wall\nf 1/1 2/2 3/1\nf 4 5 6\nusemtl red\nf 4/1 5/1 6/1\nf 4 5 6\n"
    "usemtl unknown\nf 1/1 2/1 3/1\n";

static unsigned count_material(const struct triangles *t, uint32_t material)
{
    unsigned count = 0;
    for (size_t i = 0; i < t->count; i++)
        count += t->list[i].material == material;
    return count;
}

static void materials_come_from_the_library(void **state)
{
    struct fixture *f = *state;
    struct triangles got = {0};
    struct fmt_tris_header header;
    struct fmt_tris_file *file;
    write_texture(f);
    write_library(f, "newmtl red\nKd 1 0 0\nnewmtl wall\nKd 0.5 0.5 0.5\nmap_Kd wall.png\n"
                     "newmtl unused\nmap_Kd missing.png\n");
    expect_sorted(f, sort_text(f, materials_obj));
    assert_true(f->report.has_texcoords);
    read_sorted(f, &got, &header);
    assert_int_equal(header.attributes, FMT_TRIS_TEXCOORDS | FMT_TRIS_MATERIALS);
    assert_int_equal(header.material_count, 3);
    assert_int_equal(count_material(&got, UINT32_MAX), 2); /* before usemtl, and unknown */
    assert_int_equal(count_material(&got, 0), 1);          /* wall with its texture */
    assert_int_equal(count_material(&got, 1), 1);          /* wall without */
    assert_int_equal(count_material(&got, 2), 2);          /* red */
    for (size_t i = 0; i < got.count; i++)
        if (got.list[i].material == 0)
            for (int k = 0; k < 3; k++) {
                const struct corner *c = &got.list[i].corners[k];
                assert_true(c->texcoord[0] == (c->position[0] == 1.0f ? 0.5f : 0.25f));
            }
    assert_int_equal(fmt_tris_open(f->ctx, f->tris, &file), 0);
    const struct fmt_tris_material *m = fmt_tris_get_header(file)->materials;
    assert_int_equal(m[0].texture_path[0], '/');
    assert_non_null(strstr(m[0].texture_path, "/wall.png"));
    assert_null(m[1].texture_path);
    assert_true(m[1].diffuse[0] == 0.5f);
    assert_true(m[2].diffuse[0] == 1.0f && m[2].diffuse[1] == 0.0f);
    fmt_tris_close(file);
    free(got.list);
}

/* Scans are often passed on without their images: shapes and diffuse colours are still worth
 * having. */
static void a_missing_texture_leaves_the_diffuse_colour(void **state)
{
    struct fixture *f = *state;
    struct triangles got = {0};
    struct fmt_tris_header header;
    write_library(f, "newmtl wall\nKd 0.5 0.5 0.5\nmap_Kd gone.png\n");
    expect_sorted(f, sort_text(f, materials_obj));
    read_sorted(f, &got, &header);
    assert_int_equal(header.attributes, FMT_TRIS_MATERIALS);
    assert_int_equal(header.material_count, 1);
    assert_int_equal(count_material(&got, 0), 2);
    free(got.list);
}

static void without_materials_texture_coordinates_go(void **state)
{
    struct fixture *f = *state;
    struct fmt_tris_header header;
    expect_sorted(f, sort_text(f, "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1 2/1 3/1\n"));
    assert_false(f->report.has_texcoords);
    read_sorted(f, NULL, &header);
    assert_int_equal(header.attributes, 0);
}

static void one_texture_can_be_given_for_all(void **state)
{
    struct fixture *f = *state;
    const char *paths[1] = {f->obj};
    char texture[128];
    struct triangles got = {0};
    struct vox_sort_options options = {
        .obj_paths = paths, .obj_count = 1, .tris_path = f->tris, .texture_path = texture};
    snprintf(texture, sizeof texture, "%s/wall.png", f->dir);
    write_texture(f);
    write_text(f->obj, "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0.5 0\nf 1/1 2/1 3/1\nusemtl a\n"
                       "f 1/1 3/1 2/1\nf 1 2 3\nf 1/1 2/1 3\n");
    expect_sorted(f, vox_sort(f->ctx, &options, &f->report));
    read_sorted(f, &got, NULL);
    assert_int_equal(count_material(&got, 0), 2);
    assert_int_equal(count_material(&got, UINT32_MAX), 2);
    free(got.list);
    strcpy(texture, "/nowhere/at all.png");
    assert_int_equal(vox_sort(f->ctx, &options, &f->report), BSQ_ENOINPUT);
    assert_non_null(strstr(bsq_error(f->ctx), texture));
}

/* ---- bad input ---- */

static void indices_out_of_range_are_located(void **state)
{
    struct fixture *f = *state;
    static const struct {
        const char *text, *message;
    } cases[] = {
        {"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf 1 2 9\nf 1 2 99\n", ":5: face refers to vertex 9"},
        {"v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1 2/2 3/1\n", ":5: "},
        {"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1//1 2//1 3//1\n", ":4: "},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        assert_int_equal(sort_text(f, cases[i].text), BSQ_EDATA);
        if (!strstr(bsq_error(f->ctx), cases[i].message))
            fail_msg("\"%s\" is not in \"%s\"", cases[i].message, bsq_error(f->ctx));
        assert_non_null(strstr(bsq_error(f->ctx), f->obj));
        assert_int_not_equal(access(f->tris, F_OK), 0);
    }
}

static void scans_without_faces_are_refused(void **state)
{
    struct fixture *f = *state;
    static const char *const texts[] = {"", "v 0 0 0\n", "v 0 0 0\nv 1 0 0\nf 1 2\n"};
    for (int i = 0; i < 3; i++) {
        assert_int_equal(sort_text(f, texts[i]), BSQ_EDATA);
        assert_non_null(strstr(bsq_error(f->ctx), f->obj));
    }
}

static void positions_beyond_float_are_refused(void **state)
{
    struct fixture *f = *state;
    assert_int_equal(sort_text(f, "v 0 0 0\nv 1 0 0\nv 0 1e200 0\nf 1 2 3\n"), BSQ_EDATA);
    assert_non_null(strstr(bsq_error(f->ctx), "1e+200"));
}

/* Nothing but degenerate triangles: a file without chunks. */
static void a_scan_without_area_is_refused(void **state)
{
    struct fixture *f = *state;
    assert_int_equal(sort_text(f, "v 1 2 3\nf 1 1 1\n"), BSQ_EDATA);
    assert_non_null(strstr(bsq_error(f->ctx), "the scan's only triangle has no area"));
    assert_int_equal(sort_text(f, "v 1 2 3\nf 1 1 1\nf 1 1 1\n"), BSQ_EDATA);
    assert_non_null(strstr(bsq_error(f->ctx), "none of the scan's 2 triangles has an area"));
    assert_int_not_equal(access(f->tris, F_OK), 0);
}

static void too_little_memory_is_refused(void **state)
{
    struct fixture *f = *state;
    open_context(f, vox_memory_min(2) - 1, 2);
    assert_int_equal(sort_text(f, "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"), BSQ_EUSAGE);
    open_context(f, 64 * MIB, 2);
    expect_sorted(f, sort_text(f, "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"));
}

/* Any allocation may be the one that fails: that is an error, and nothing is left behind. */
static void memory_may_run_out_anywhere(void **state)
{
    struct fixture *f = *state;
    const char *paths[1] = {f->obj};
    struct grid g;
    struct vox_sort_options options = {.obj_paths = paths, .obj_count = 1, .tris_path = f->tris};
    unsigned failures = 0;
    make_grid(&g, 60, 5);
    write_grid(&g, f->obj, WITH_COLORS | WITH_NORMALS, 6);
    for (unsigned spilled = 0; spilled < 2; spilled++)
        for (uint64_t memory = 1000; memory < 80 * MIB; memory += memory / 5) {
            struct sort_limits limits;
            sort_limits_for(128 * MIB, 2, &limits);
            if (spilled)
                limits.column_bytes = limits.page_memory = 0;
            open_context(f, memory, 2);
            int status = sort_with_limits(f->ctx, &options, &limits, &f->report);
            failures += status < 0;
            assert_true(status == 0 || status == BSQ_ENOMEM);
            assert_int_equal(bsq_memory_used(f->ctx), 0);
            assert_int_equal(access(f->tris, F_OK) == 0, status == 0);
            unlink(f->tris);
        }
    assert_true(failures > 40);
    free_grid(&g);
}

static void an_unwritable_place_is_refused(void **state)
{
    struct fixture *f = *state;
    const char *paths[1] = {f->obj};
    struct vox_sort_options options = {
        .obj_paths = paths, .obj_count = 1, .tris_path = "/nowhere/at/all.tris"};
    write_text(f->obj, "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
    assert_int_equal(vox_sort(f->ctx, &options, &f->report), BSQ_ECANTCREAT);
}

static void an_interrupt_stops_and_leaves_nothing(void **state)
{
    struct fixture *f = *state;
    const char *paths[1] = {f->obj};
    struct vox_sort_options options = {.obj_paths = paths, .obj_count = 1, .tris_path = f->tris};
    write_text(f->obj, "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
    bsq_interrupt(f->ctx);
    assert_int_equal(vox_sort(f->ctx, &options, &f->report), BSQ_EINTR);
    assert_int_not_equal(access(f->tris, F_OK), 0);
}

static void parsing_alone_counts(void **state)
{
    struct fixture *f = *state;
    const char *paths[1] = {f->obj};
    write_text(f->obj, "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 3\nf 1 2 4 3\n");
    assert_int_equal(vox_parse_only(f->ctx, paths, 1, &f->report), 0);
    assert_int_equal(f->report.vertices, 4);
    assert_int_equal(f->report.faces, 2);
    assert_int_equal(f->report.triangles, 3);
}

int main(void)
{
#define TEST(name) cmocka_unit_test_setup_teardown(name, setup, teardown)
    const struct CMUnitTest tests[] = {
        TEST(every_triangle_of_a_grid_comes_out_once),
        TEST(every_triangle_of_a_soup_comes_out_once),
        TEST(budgets_and_threads_do_not_change_the_file),
        TEST(spilling_does_not_change_the_file),
        TEST(vertices_behind_faces_are_found_late),
        TEST(many_triangles_in_one_place_are_sorted),
        TEST(triangles_are_in_morton_order),
        TEST(ordinary_meshes_take_14_bytes_a_triangle),
        TEST(triangles_without_area_are_counted),
        TEST(tiny_triangles_are_kept),
        TEST(concave_polygons_keep_their_area),
        TEST(a_polygon_of_any_size_is_split),
        TEST(colors_are_of_zero_to_one_or_of_bytes),
        TEST(colors_of_a_later_file_do_not_shift),
        TEST(georeferenced_scans_keep_their_detail),
        TEST(ordinary_scans_have_no_origin),
        TEST(materials_come_from_the_library),
        TEST(a_missing_texture_leaves_the_diffuse_colour),
        TEST(without_materials_texture_coordinates_go),
        TEST(one_texture_can_be_given_for_all),
        TEST(indices_out_of_range_are_located),
        TEST(scans_without_faces_are_refused),
        TEST(positions_beyond_float_are_refused),
        TEST(a_scan_without_area_is_refused),
        TEST(too_little_memory_is_refused),
        TEST(memory_may_run_out_anywhere),
        TEST(an_unwritable_place_is_refused),
        TEST(an_interrupt_stops_and_leaves_nothing),
        TEST(parsing_alone_counts),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
