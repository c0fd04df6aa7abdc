/* Tests the tables of the buckets of vertices. tests/unit/libvoxel/test_sort.c and
 * test_sort_polygons.c compare files that were sorted through gather windows. */
#include "libvoxel/partition/partition.h"
#include "libvoxel/partition/vertex_buckets.h"

#include "tests/unit/libvoxel/sort_grid.h"
#include "tests/unit/test.h"

struct fixture {
    struct bsq_ctx *ctx;
    struct sort_limits limits;
    struct scan scan;
};

static int set_up(void **state)
{
    const struct bsq_ctx_options options = {
        .memory_bytes = 128 * MIB, .threads = 3, .tmpdir = "/tmp"};
    static const char *const paths[] = {"scan.obj"};
    struct fixture *f = calloc(1, sizeof *f);
    assert_int_equal(bsq_ctx_create(&options, &f->ctx), 0);
    vox_sort_limits_for(128 * MIB, 3, &f->limits);
    assert_int_equal(vox_scan_init(&f->scan, f->ctx, &f->limits, paths, 1, "/tmp/scan.tris"), 0);
    *state = f;
    return 0;
}

static int tear_down(void **state)
{
    struct fixture *f = *state;
    vox_scan_free(&f->scan);
    test_context_end(f->ctx);
    free(f);
    return 0;
}
#define FIXTURE_TEST(name) STATE_TEST(name, struct fixture, set_up, tear_down)

/* Compares a table with the keys of the vertices. */
static void expect_buckets(struct fixture *f, const struct morton_cube *cube,
                           const struct vertex_buckets *buckets)
{
    static bool seen[1u << 3 * VERTEX_BUCKET_WIDE_LEVELS];
    uint32_t occupied = 0;
    memset(seen, 0, sizeof seen);
    for (uint64_t v = 0; v < scan_count(&f->scan, SCAN_POSITIONS); v++) {
        float p[3];
        assert_int_equal(stream_read(&f->scan.streams[SCAN_POSITIONS], v, 1, p), 0);
        const uint64_t bucket =
            morton_point_key(cube, p) >> (MORTON_KEY_BITS - 3 * buckets->levels);
        assert_int_equal(vertex_bucket(buckets, v), bucket);
        occupied += !seen[bucket];
        seen[bucket] = true;
    }
    assert_int_equal(buckets->occupied[buckets->levels], occupied);
}

/* How the vertices of a row follow each other. */
enum row { ROW_SLOW, ROW_FAST, ROW_NONE, ROW_COUNT };

static void fill_rows(struct fixture *f, enum row row, uint32_t vertices)
{
    struct attribute_stream *stream = &f->scan.streams[SCAN_POSITIONS];
    uint64_t seed = 5;
    for (uint32_t v = 0; v < vertices; v++) {
        const uint32_t length = row == ROW_SLOW ? 10000 : 200;
        float p[3] = {(float)(v % length) * 1000 / (float)length, (float)(v / length * 3),
                      (float)(v / 5000 * 100)};
        uint8_t *at;
        uint64_t capacity;
        for (int axis = 0; row == ROW_NONE && axis < 3; axis++)
            p[axis] = (float)(sort_random(&seed) % 1001);
        assert_int_equal(vox_stream_reserve(stream, &at, &capacity), 0);
        memcpy(at, p, 12);
        assert_int_equal(vox_stream_advance(stream, 1), 0);
    }
    assert_int_equal(vox_stream_evict(stream), 0);
    assert_int_equal(vox_stream_finish(stream), 0);
}

/* Tables of runs, of two bytes a vertex and of one, of each number of levels, and all made coarser.
 * A table that does not fit is not made. */
FIXTURE_TEST(buckets_of_vertices_are_those_of_their_keys)
{
    const float low[3] = {0, 0, 0}, high[3] = {1000, 500, 800};
    const struct morton_cube cube = morton_cube_over(low, high);
    const uint32_t count = 30000;
    static const uint32_t bytes[] = {5, 2, 1, 0}; /* for each vertex */
    for (enum row row = 0; row < ROW_COUNT; row++) {
        fill_rows(f, row, count);
        for (uint32_t levels = 1; levels <= VERTEX_BUCKET_WIDE_LEVELS; levels++)
            for (uint32_t i = 0; i < 4; i++) {
                struct vertex_buckets buckets;
                assert_int_equal(vox_vertex_buckets_make(&f->scan, &cube, levels,
                                                         (uint64_t)bytes[i] * count, &buckets),
                                 0);
                assert_int_equal(buckets.levels == 0, bytes[i] == 0);
                assert_true(buckets.bytes <= (uint64_t)bytes[i] * count || bytes[i] == 0);
                if (levels == 5 && bytes[i] == 5) {
                    assert_int_equal(buckets.runs != NULL, row == ROW_SLOW);
                    assert_int_equal(buckets.have_order, row == ROW_SLOW);
                }
                if (levels > 2 && bytes[i] == 1 && row == ROW_NONE)
                    assert_true(buckets.narrow && buckets.levels == 2);
                for (uint32_t coarse = buckets.levels; coarse > 0; coarse--) {
                    vox_vertex_buckets_coarsen(&f->scan, &buckets, coarse);
                    expect_buckets(f, &cube, &buckets);
                }
                vox_vertex_buckets_free(&f->scan, &buckets);
            }
        static const char *const paths[] = {"scan.obj"};
        vox_scan_free(&f->scan);
        assert_int_equal(vox_scan_init(&f->scan, f->ctx, &f->limits, paths, 1, "/tmp/scan.tris"),
                         0);
    }
}

RUN_TESTS(NULL, NULL)
