/* Tests sorting: each triangle comes out once, with its attributes, and the file has the same bytes
 * for any memory budget and any number of threads. */
#include "sort_grid.h"
#include "tests/unit/test.h"

#define FIXTURE_TEST(name) STATE_TEST(name, struct sort_fixture, sort_set_up, sort_tear_down)

/* ---- every triangle, once ---- */

FIXTURE_TEST(every_triangle_of_a_grid_comes_out_once)
{
    for (unsigned flags = 0; flags < 8; flags++) {
        struct sort_grid g;
        struct sorted_triangles got = {0}, expected = {0};
        sort_grid_make(&g, 150, 11 + flags);
        sort_grid_write(&g, "scan.obj", flags, 5);
        expect_sorted(f, sort_scan(f));
        assert_int_equal(f->report.triangles, 2 * 150 * 150);
        assert_int_equal(f->report.faces, 2 * 150 * 150);
        assert_int_equal(f->report.vertices, 151 * 151);
        assert_int_equal(f->report.has_colors, (flags & GRID_COLORS) != 0);
        assert_int_equal(f->report.has_normals, (flags & GRID_NORMALS) != 0);
        read_sorted(f, &got, NULL);
        sort_grid_expect(&g, flags, &expected);
        if (flags & GRID_NORMALS)
            sort_grid_check_face_normals(&got);
        expect_same_triangles(&got, &expected);
        sort_grid_free(&g);
    }
}

/* Each triangle has its own corners, anywhere in a cube: no neighbours, and all buckets in use. */
FIXTURE_TEST(every_triangle_of_a_soup_comes_out_once)
{
    struct sorted_triangles got = {0}, expected = {0};
    uint64_t seed = 77;
    FILE *file = fopen("scan.obj", "wb");
    for (uint32_t t = 0; t < 90000; t++) {
        struct sorted_triangle one;
        memset(&one, 0, sizeof one);
        for (int k = 0; k < 3; k++) {
            for (int axis = 0; axis < 3; axis++)
                one.corners[k].position[axis] =
                    (float)(sort_random(&seed) % 100000) / 64.0f - 700.0f;
            fprintf(file, "v %.9g %.9g %.9g\n", one.corners[k].position[0],
                    one.corners[k].position[1], one.corners[k].position[2]);
        }
        fputs("f -3 -2 -1\n", file);
        one.material = UINT32_MAX;
        sorted_add(&expected, &one);
    }
    fclose(file);
    expect_sorted(f, sort_scan(f));
    read_sorted(f, &got, NULL);
    expect_same_triangles(&got, &expected);
}

/* ---- the same bytes for any memory and threads ---- */

struct reference {
    uint8_t *bytes;
    size_t size;
};

static void expect_same_file(struct reference *reference)
{
    size_t size;
    uint8_t *bytes = test_read("scan.tris", &size);
    if (!reference->bytes) {
        *reference = (struct reference){bytes, size};
        return;
    }
    assert_int_equal(size, reference->size);
    assert_memory_equal(bytes, reference->bytes, size);
    free(bytes);
}

/* Writes triangles without area between random vertices of a grid. */
static void append_flat_triangles(const char *path, const struct sort_grid *g, uint32_t count)
{
    uint64_t seed = 31;
    FILE *file = fopen(path, "ab");
    assert_non_null(file);
    for (uint32_t i = 0; i < count; i++) {
        uint32_t v = (uint32_t)(sort_random(&seed) % (g->n * g->n)) + 1,
                 w = v + (uint32_t)(sort_random(&seed) % g->n);
        fprintf(file, "f %u %u %u\n", v, i % 2 ? w : v, v);
    }
    assert_int_equal(fclose(file), 0);
}

/* Sets limits so small that each part of the sorter uses files, one at a time and all together. */
FIXTURE_TEST(spilling_does_not_change_the_file)
{
    static const unsigned kinds[] = {GRID_SHUFFLED | GRID_COLORS | GRID_NORMALS, GRID_SHUFFLED, 0};
    static const uint32_t sizes[] = {320, 190, 190};
    for (int k = 0; k < 3; k++) {
        struct reference reference = {0};
        struct sort_grid g;
        sort_grid_make(&g, sizes[k], 4);
        sort_grid_write(&g, "scan.obj", kinds[k], 9);
        append_flat_triangles("scan.obj", &g, 3000);
        for (unsigned variant = 0; variant < 12; variant++) {
            struct sort_limits limits;
            struct vox_sort_options options = sort_scan_obj();
            sort_open_context(f, 128 * MIB, variant % 2 ? 2 : 3);
            vox_sort_limits_for(128 * MIB, 2, &limits);
            limits.two_passes = variant % 3 == 1;
            if (variant == 2 || variant == 8 || variant == 9 || variant == 11)
                limits.stream_bytes = 0;
            if (variant == 3 || variant == 8 || variant == 10)
                limits.page_memory = limits.max_page_memory = 0;
            if (variant == 4 || variant == 8 || variant >= 11)
                limits.batch_triangles = 70000; /* buckets are divided */
            if (variant == 5)
                limits.index_bytes = 5;
            if (variant == 6)
                limits.bucket_levels = 1, limits.page_bytes = 100;
            if (variant == 7)
                limits.stream_bytes = g.n > 200 ? 800 << 10 : 700 << 10; /* some streams */
            if (variant == 9)
                limits.vertex_bucket_bytes = (uint64_t)(g.n + 1) * (g.n + 1);
            bsq_forget_files(f->ctx);
            expect_sorted(f, vox_sort_with_limits(f->ctx, &options, &limits, &f->report));
            assert_int_equal(f->report.triangles, 2 * g.n * g.n);
            assert_int_equal(f->report.degenerate_triangles, 3000);
            if (variant != 4) /* small parts of buckets stay in memory */
                assert_int_equal(f->report.temp_bytes > 0,
                                 variant == 2 || variant == 3 || variant >= 7);
            expect_same_file(&reference);
        }
        free(reference.bytes);
        sort_grid_free(&g);
    }
}

/* A scan whose vertices are in rows has small buckets with a byte of memory for each vertex, so no
 * bucket is divided in further temporary files. */
FIXTURE_TEST(buckets_stay_small_with_a_byte_for_each_vertex)
{
    struct vox_sort_options options = sort_scan_obj();
    struct sort_limits limits;
    struct sort_grid g;
    sort_grid_make(&g, 1000, 4);
    sort_grid_write(&g, "scan.obj", 0, 9);
    sort_open_context(f, 128 * MIB, 2);
    vox_sort_limits_for(128 * MIB, 2, &limits);
    options.scan_normals = BSQ_SCAN_NORMALS_FLAT; /* creases have temporary files of their own */
    limits.stream_bytes = 0;
    limits.page_memory = limits.max_page_memory = MIB;
    limits.vertex_bucket_bytes = 1001 * 1001;
    limits.batch_triangles = FMT_TRIS_CHUNK_TRIANGLES + 2 * 50000; /* half a bucket of two levels */
    expect_sorted(f, vox_sort_with_limits(f->ctx, &options, &limits, &f->report));
    assert_int_equal(f->report.triangles, 2 * g.n * g.n);
    assert_in_range(f->report.temp_bytes, 1, 12 * f->report.triangles);
    sort_grid_free(&g);
}

/* A vertex after the faces changes the bounds of the scan. The reader's samples miss it, so the
 * scan is read again in two passes. */
FIXTURE_TEST(vertices_after_faces_are_found_late)
{
    struct reference reference = {0};
    struct sort_grid g;
    sort_grid_make(&g, 190, 4);
    for (int late = 0; late < 3; late++) {
        sort_grid_write(&g, "scan.obj", 0, 9);
        FILE *file = fopen("scan.obj", "ab");
        for (int i = 0; i < 40000; i++) /* the last sample ends before the next line */
            fputs("f 1 2 3\n", file);
        fputs(late == 0 ? "f 36482 1 2\nv 9 9 9\n" : "v 9 9 9\nf 36482 1 2\n", file);
        for (int i = 0; i < 400; i++)
            fputs("f 1 2 3\n", file);
        fclose(file);
        struct sort_limits limits;
        struct vox_sort_options options = sort_scan_obj();
        vox_sort_limits_for(256 * MIB, 2, &limits);
        limits.two_passes = late == 2;
        bsq_forget_files(f->ctx);
        expect_sorted(f, vox_sort_with_limits(f->ctx, &options, &limits, &f->report));
        assert_int_equal(f->report.triangles, 2 * g.n * g.n + 40401);
        assert_int_equal(f->report.vertices, (g.n + 1) * (g.n + 1) + 1);
        if (late > 0)
            expect_same_file(&reference);
    }
    free(reference.bytes);
    sort_grid_free(&g);
}

/* More triangles than a batch holds have the same first corner, so they keep the scan's order. */
FIXTURE_TEST(many_triangles_in_one_place_are_sorted)
{
    struct reference reference = {0};
    FILE *file = fopen("scan.obj", "wb");
    fputs("v -1 -1 0\nv 1 0 0\nv 0 1 0\nv 100 100 100\nv 101 100 100\nv 100 101 100\nf 4 5 6\n",
          file);
    for (int i = 0; i < 140000; i++)
        fputs("f 1 2 3\n", file);
    fclose(file);
    for (int small = 0; small < 2; small++) {
        struct sort_limits limits;
        struct vox_sort_options options = sort_scan_obj();
        vox_sort_limits_for(256 * MIB, 2, &limits);
        if (small)
            limits.batch_triangles = 70000;
        bsq_forget_files(f->ctx);
        expect_sorted(f, vox_sort_with_limits(f->ctx, &options, &limits, &f->report));
        assert_int_equal(f->report.triangles, 140001);
        assert_int_equal(f->report.chunks,
                         4); /* all keys are equal: 3 x 32768 triangles and the rest */
        expect_same_file(&reference);
        read_sorted(f, NULL, NULL);
    }
    free(reference.bytes);
}

/* ---- order ---- */

/* Interleaves bit by bit, as the definition says. */
static uint64_t naive_key(const float point[3], const struct fmt_tris_header *header)
{
    uint64_t key = 0;
    double side = 0;
    for (int axis = 0; axis < 3; axis++)
        side = fmax(side, (double)header->bounds_max[axis] - header->bounds_min[axis]);
    for (int bit = 20; bit >= 0; bit--)
        for (int axis = 0; axis < 3; axis++) {
            double cell =
                floor(((double)point[axis] - header->bounds_min[axis]) / side * 2097152.0);
            uint64_t c = (uint64_t)fmin(fmax(cell, 0.0), 2097151.0);
            key = key << 1 | (c >> bit & 1);
        }
    return key;
}

/* Checks the order of first corners. The division above may round in another way, which moves a key
 * by one. So neighbours may be swapped. */
static void expect_morton_order(const struct fmt_tris_chunk *chunk,
                                const struct fmt_tris_header *header, uint64_t *before)
{
    for (uint32_t t = 0; t < chunk->triangle_count; t++) {
        uint64_t key = naive_key(chunk->positions[chunk->triangles[t][0]], header);
        assert_true((key >> 9) + 1 >= *before >> 9);
        *before = key;
    }
}

FIXTURE_TEST(triangles_are_in_morton_order)
{
    struct sort_grid g;
    struct fmt_tris_file *file;
    struct fmt_tris_chunk chunk;
    uint64_t before = 0;
    sort_grid_make(&g, 250, 5);
    sort_grid_write(&g, "scan.obj", GRID_SHUFFLED, 6);
    expect_sorted(f, sort_scan(f));
    assert_int_equal(fmt_tris_open(f->ctx, "scan.tris", &file), 0);
    const struct fmt_tris_header *header = fmt_tris_get_header(file);
    assert_true(header->chunk_count > 1);
    void *scratch = malloc(fmt_tris_load_size_max(file));
    assert_non_null(scratch);
    for (uint64_t i = 0; i < header->chunk_count; i++) {
        assert_int_equal(fmt_tris_load(file, i, scratch, &chunk), 0);
        expect_morton_order(&chunk, header, &before);
    }
    free(scratch);
    fmt_tris_close(file);
    sort_grid_free(&g);
}

/* Without normals; those take 8 bytes more for each vertex, and 16 at creases. */
FIXTURE_TEST(ordinary_meshes_take_14_bytes_a_triangle)
{
    struct vox_sort_options options = sort_scan_obj();
    struct sort_limits limits;
    struct sort_grid g;
    uint64_t bytes[2];
    sort_grid_make(&g, 400, 5);
    sort_grid_write(&g, "scan.obj", 0, 6);
    for (int smooth = 0; smooth < 2; smooth++) {
        sort_open_context(f, 128 * MIB, 2);
        bsq_forget_files(f->ctx);
        vox_sort_limits_for(128 * MIB, 2, &limits);
        options.scan_normals = smooth ? BSQ_SCAN_NORMALS_SMOOTH : BSQ_SCAN_NORMALS_FLAT;
        expect_sorted(f, vox_sort_with_limits(f->ctx, &options, &limits, &f->report));
        bytes[smooth] = f->report.tris_bytes;
    }
    assert_true(bytes[0] <= 14 * f->report.triangles);
    assert_true(bytes[0] >= 12 * f->report.triangles);
    assert_true(bytes[1] - bytes[0] >= 8 * 401 * 401);
    assert_true(bytes[1] - bytes[0] <= 25 * 401 * 401);
    sort_grid_free(&g);
}

/* ---- triangles that are left out ---- */

FIXTURE_TEST(triangles_without_area_are_counted)
{
    struct sorted_triangles got = {0};
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
    read_sorted(f, &got, NULL);
    free(got.list);
}

FIXTURE_TEST(tiny_triangles_are_kept)
{
    expect_sorted(f, sort_text(f, "v 0 0 0\nv 1e-30 0 0\nv 0 1e-30 0\nf 1 2 3\n"
                                  "v 1000 0 0\nv 1000.0001 0 0\nv 1000 1000 0\nf 4 5 6\n"));
    assert_int_equal(f->report.triangles, 2);
    assert_int_equal(f->report.degenerate_triangles, 0);
}

RUN_TESTS(NULL, NULL)
