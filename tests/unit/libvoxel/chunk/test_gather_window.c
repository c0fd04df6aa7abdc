/* Tests gather windows: the elements that tuples refer to are read from files and renumbered, and
 * tuples get their old indices back. */
#include "libvoxel/chunk/gather_window.h"
#include "libvoxel/partition/triangulate.h"

#include "tests/unit/libvoxel/sort_grid.h"
#include "tests/unit/test.h"

#define VERTICES  100003u
#define TEXCOORDS 40000u
#define NORMALS   64u /* a whole word of marks */
#define MOST      3000u

struct fixture {
    struct bsq_ctx *ctx;
    struct sort_limits limits;
    struct scan scan;
};

/* Computes an element's bytes from its stream and index. */
static void make_element(enum scan_stream stream, uint64_t index, uint32_t bytes, uint8_t *to)
{
    uint64_t seed = index * SCAN_STREAM_COUNT + stream + 1;
    for (uint32_t i = 0; i < bytes; i++)
        to[i] = (uint8_t)(sort_random(&seed) >> 8);
}

static void fill_stream(struct scan *scan, enum scan_stream number, uint64_t count, bool spilled)
{
    struct attribute_stream *stream = &scan->streams[number];
    for (uint64_t i = 0; i < count; i++) {
        uint8_t *at;
        uint64_t capacity;
        assert_int_equal(vox_spill_reserve(&stream->spill, &at, &capacity), 0);
        make_element(number, i, stream->element_bytes, at);
        vox_spill_advance(&stream->spill, stream->element_bytes);
    }
    if (spilled)
        assert_int_equal(vox_spill_spill(&stream->spill), 0);
    assert_int_equal(vox_spill_finish(&stream->spill), 0);
}

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

/* ---- tuples ---- */

/* Makes tuples with indices in a few clusters, the first or last element, or none. */
static uint64_t random_index(const struct scan *scan, enum fmt_mesh_kind kind, uint64_t *seed)
{
    const uint64_t count = scan_count(scan, scan_stream_of(kind));
    uint32_t choice = sort_random(seed) % 64;
    if (count == 0)
        return FMT_MESH_NONE;
    if (choice == 0)
        return 0;
    if (choice == 1)
        return count - 1;
    if (choice < 4 && kind != FMT_MESH_VERTEX)
        return FMT_MESH_NONE;
    return choice < 8 ? sort_random(seed) % count
                      : (choice * 7919 + sort_random(seed) % 300) % count;
}

static void make_tuples(const struct scan *scan, const struct tuple_layout *layout, uint32_t count,
                        uint64_t seed, uint8_t *tuples)
{
    for (uint32_t c = 0; c < 3 * count; c++)
        for (int kind = 0; kind < FMT_MESH_KIND_COUNT; kind++)
            tuple_store(tuples + c / 3 * layout->bytes + c % 3 * layout->corner_bytes +
                            layout->index_at[kind],
                        random_index(scan, kind, &seed), layout->index_bytes[kind]);
}

/* Checks that each corner has the same element in the view as in the scan. The view has each
 * element once, in the order of the scan. */
static void expect_view(const struct gather_window *w, const uint8_t *old, const uint8_t *numbered,
                        uint32_t count)
{
    const struct tuple_layout *layout = w->layout;
    for (int kind = 0; kind < FMT_MESH_KIND_COUNT; kind++) {
        const uint32_t width = layout->index_bytes[kind];
        const uint64_t all = scan_count(w->scan, scan_stream_of(kind));
        for (uint32_t c = 0; width > 0 && c < 3 * count; c++) {
            uint64_t at =
                c / 3 * layout->bytes + c % 3 * layout->corner_bytes + layout->index_at[kind];
            uint64_t before = tuple_load(old + at, width), now = tuple_load(numbered + at, width);
            if (before >= all) {
                assert_int_equal(now, before);
                continue;
            }
            for (int i = 0; i < SCAN_STREAM_COUNT; i++) {
                const struct attribute_stream *stream = &w->view.streams[i];
                uint8_t expected[12];
                if ((int)scan_kind_of(i) != kind || !scan_keeps(w->scan, i))
                    continue;
                make_element(i, before, stream->element_bytes, expected);
                assert_true(now < stream_count(stream));
                assert_memory_equal(stream_at(stream, now, stream->element_bytes), expected,
                                    stream->element_bytes);
            }
        }
    }
}

/* Counts the tuples' different vertices and checks that `used` has exactly these. */
static void expect_used(const struct gather_window *w, const uint8_t *tuples, uint32_t count,
                        const used_word *used)
{
    static bool seen[VERTICES];
    uint64_t different = 0;
    memset(seen, 0, sizeof seen);
    for (uint32_t c = 0; c < 3 * count; c++) {
        uint64_t v = tuple_vertex_index(w->layout, tuples + c / 3 * w->layout->bytes +
                                                       c % 3 * w->layout->corner_bytes);
        different += !seen[v];
        seen[v] = true;
        assert_true(used[v / 64] >> v % 64 & 1);
    }
    assert_int_equal(used_count(used, VERTICES), different);
    if (w->kinds[FMT_MESH_VERTEX].active)
        assert_int_equal(stream_count(&w->view.streams[SCAN_POSITIONS]), different);
}

static void run_window(struct fixture *f, const struct tuple_layout *layout)
{
    struct gather_window window;
    uint64_t bytes = layout->bytes * (uint64_t)MOST + TUPLE_SLACK, before = bsq_memory_used(f->ctx);
    uint8_t *tuples = calloc(bytes, 1), *numbered = calloc(bytes, 1);
    assert_int_equal(vox_gather_open(&window, &f->scan, layout, MOST), 0);
    assert_true(bsq_memory_used(f->ctx) - before <= vox_gather_bytes(&f->scan, 3) +
                                                        MOST * vox_gather_triangle_bytes(&f->scan) +
                                                        8 * 4096);
    for (uint64_t round = 0; round < 4; round++) {
        static used_word used[VERTICES / 64 + 1];
        const uint32_t count = round == 0 ? 1 : round == 3 ? MOST : 500;
        memset((void *)used, 0, sizeof used);
        make_tuples(&f->scan, layout, count, round + 3, tuples);
        memcpy(numbered, tuples, bytes);
        vox_gather_clear(&window);
        vox_gather_mark(&window, tuples, count / 2);
        vox_gather_mark(&window, tuples + count / 2 * layout->bytes, count - count / 2);
        assert_int_equal(vox_gather_fetch(&window, used), 0);
        if (window.kinds[FMT_MESH_VERTEX].active)
            expect_used(&window, tuples, count, used);
        for (uint32_t t = 0; t < count; t++) {
            uint64_t v = tuple_vertex_index(layout, tuples + t * layout->bytes);
            uint8_t expected[12];
            make_element(SCAN_POSITIONS, v, 12, expected);
            assert_memory_equal(gather_position(&window, v), expected, 12);
        }
        vox_gather_number(&window, numbered, count);
        expect_view(&window, tuples, numbered, count);
        vox_gather_restore(&window, numbered, count);
        assert_memory_equal(numbered, tuples, bytes);
    }
    vox_gather_close(&window);
    free(numbered);
    free(tuples);
}

FIXTURE_TEST(positions_alone_come_from_a_file)
{
    struct tuple_layout layout;
    fill_stream(&f->scan, SCAN_POSITIONS, VERTICES, true);
    vox_tuple_layout_for(&f->scan, &layout);
    assert_true(layout.plain && layout.gathered && layout.bytes == 12);
    run_window(f, &layout);
    f->limits.index_bytes = 5;
    vox_tuple_layout_for(&f->scan, &layout);
    assert_true(!layout.plain && layout.bytes == 15);
    run_window(f, &layout);
}

/* Tries each combination of streams in files. */
FIXTURE_TEST(columns_in_memory_stay_there)
{
    for (unsigned spilled = 1; spilled < 1 << SCAN_STREAM_COUNT; spilled++) {
        static const uint64_t counts[SCAN_STREAM_COUNT] = {VERTICES, VERTICES, TEXCOORDS, NORMALS};
        struct tuple_layout layout;
        for (int i = 0; i < SCAN_STREAM_COUNT; i++)
            fill_stream(&f->scan, i, counts[i], spilled >> i & 1);
        f->scan.attributes = FMT_TRIS_COLORS | FMT_TRIS_TEXCOORDS | FMT_TRIS_NORMALS;
        f->scan.material_count = 300; /* two bytes after the corners */
        vox_tuple_layout_for(&f->scan, &layout);
        assert_true(layout.gathered && !layout.plain);
        run_window(f, &layout);
        f->scan.material_count = 0;
        vox_scan_free(&f->scan);
        static const char *const paths[] = {"scan.obj"};
        assert_int_equal(vox_scan_init(&f->scan, f->ctx, &f->limits, paths, 1, "/tmp/scan.tris"),
                         0);
    }
}

/* ---- buckets of vertices ---- */

/* Compares a table with the keys of the vertices. */
static void expect_buckets(struct fixture *f, const struct morton_cube *cube,
                           const struct vertex_buckets *buckets)
{
    static bool seen[1u << 3 * VERTEX_BUCKET_WIDE_LEVELS];
    uint32_t occupied = 0;
    memset(seen, 0, sizeof seen);
    for (uint64_t v = 0; v < stream_count(&f->scan.streams[SCAN_POSITIONS]); v++) {
        float p[3];
        assert_int_equal(vox_spill_read(&f->scan.streams[SCAN_POSITIONS].spill, 12 * v, 12, p), 0);
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
    struct spill_buffer *spill = &f->scan.streams[SCAN_POSITIONS].spill;
    uint64_t seed = 5;
    for (uint32_t v = 0; v < vertices; v++) {
        const uint32_t length = row == ROW_SLOW ? 10000 : 200;
        float p[3] = {(float)(v % length) * 1000 / (float)length, (float)(v / length * 3),
                      (float)(v / 5000 * 100)};
        uint8_t *at;
        uint64_t capacity;
        for (int axis = 0; row == ROW_NONE && axis < 3; axis++)
            p[axis] = (float)(sort_random(&seed) % 1001);
        assert_int_equal(vox_spill_reserve(spill, &at, &capacity), 0);
        memcpy(at, p, 12);
        vox_spill_advance(spill, 12);
    }
    assert_int_equal(vox_spill_spill(spill), 0);
    assert_int_equal(vox_spill_finish(spill), 0);
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
