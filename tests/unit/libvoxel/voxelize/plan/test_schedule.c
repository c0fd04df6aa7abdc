/* Compares the schedule of regions with a list of all pairs, sorted by the definition of the grid
 * file's order. */
#include "libvoxel/voxelize/plan/plan.h"
#include "tests/unit/libvoxel/scan_fixture.h"
#include "tests/unit/test.h"

struct pair {
    int32_t origin[3];
    uint32_t chunk;
};

/* Root keys hold origin / 4096 as unsigned numbers, x first. Inside a tile regions are sorted by x,
 * y, z. */
static int compare_pairs(const void *a, const void *b)
{
    const struct pair *p = a, *q = b;
    for (int axis = 0; axis < 3; axis++) {
        uint32_t x = (uint32_t)p->origin[axis] >> 12, y = (uint32_t)q->origin[axis] >> 12;
        if (x != y)
            return x < y ? -1 : 1;
    }
    for (int axis = 0; axis < 3; axis++)
        if (p->origin[axis] != q->origin[axis])
            return p->origin[axis] < q->origin[axis] ? -1 : 1;
    return p->chunk < q->chunk ? -1 : p->chunk > q->chunk;
}

static int32_t down_to_region(int32_t voxel)
{
    int32_t rest = voxel % 128;
    return voxel - (rest < 0 ? rest + 128 : rest);
}

static uint64_t list_pairs(const struct vox_chunk_box *boxes, uint32_t count, struct pair *pairs,
                           uint64_t room)
{
    uint64_t n = 0, distinct = 0;
    for (uint32_t i = 0; i < count; i++) {
        const struct vox_box *b = &boxes[i].box;
        for (int32_t x = down_to_region(b->lo[0]); x <= b->hi[0]; x += 128)
            for (int32_t y = down_to_region(b->lo[1]); y <= b->hi[1]; y += 128)
                for (int32_t z = down_to_region(b->lo[2]); z <= b->hi[2]; z += 128, n++) {
                    assert_true(n < room);
                    pairs[n] = (struct pair){{x, y, z}, boxes[i].chunk};
                }
    }
    qsort(pairs, n, sizeof *pairs, compare_pairs);
    for (uint64_t i = 0; i < n; i++)
        if (i == 0 || compare_pairs(&pairs[i], &pairs[i - 1]) != 0)
            pairs[distinct++] = pairs[i];
    return distinct;
}

/* Checks that the schedule yields the pairs of the list, and each chunk in the region announced. */
static void check_schedule(const struct vox_chunk_box *boxes, uint32_t count)
{
    const uint64_t room = 2000000;
    struct pair *pairs = calloc(room, sizeof *pairs);
    assert_non_null(pairs);
    uint64_t n = list_pairs(boxes, count, pairs, room), at = 0;

    struct vox_schedule *schedule;
    struct bsq_ctx *ctx = test_context(1, 1 << 20);
    assert_int_equal(vox_schedule_create(ctx, boxes, count, &schedule), 0);
    vox_region_key key, after, due[20];
    uint32_t chunk;
    assert_true(count <= 20);
    for (uint32_t i = 0; i < count; i++)
        due[i] = VOX_REGION_KEY_NEVER;
    for (uint32_t i = 0; i < count; i++) {
        vox_region_key first = vox_region_first(&boxes[i].box);
        if (first < due[boxes[i].chunk])
            due[boxes[i].chunk] = first;
    }
    while (vox_schedule_next(schedule, &key)) {
        int32_t origin[3];
        vox_region_origin(key, origin);
        uint64_t first = at;
        while (vox_schedule_chunk(schedule, &chunk, &after)) {
            assert_true(at < n);
            assert_memory_equal(origin, pairs[at].origin, sizeof origin);
            assert_int_equal(chunk, pairs[at].chunk);
            assert_true(key < after);
            assert_true(key == due[chunk]);
            due[chunk] = after;
            at++;
        }
        assert_true(at > first);
    }
    assert_int_equal(at, n);
    for (uint32_t i = 0; i < count; i++)
        assert_true(due[i] == VOX_REGION_KEY_NEVER);
    vox_schedule_destroy(schedule);
    bsq_ctx_destroy(ctx);
    free(pairs);
}

/* boxes_of_chunk: number of boxes of each chunk */
static void check_random_boxes(uint32_t boxes_of_chunk)
{
    uint64_t seed = 4711;
    print_message("seed %llu\n", (unsigned long long)seed);
    static const double spreads[] = {100.0, 5000.0, 20000.0, 1000000000.0};
    static const double sizes[] = {300.0, 1500.0, 6000.0, 4000.0};
    for (int k = 0; k < 4; k++)
        for (int round = 0; round < 10; round++) {
            struct vox_chunk_box boxes[20];
            for (uint32_t i = 0; i < 20; i++) {
                boxes[i].chunk = i / boxes_of_chunk;
                for (int a = 0; a < 3; a++) {
                    double at = spreads[k] * (2.0 * scan_random(&seed) - 1.0);
                    boxes[i].box.lo[a] = (int32_t)at;
                    boxes[i].box.hi[a] = (int32_t)(at + sizes[k] * scan_random(&seed)) + 1;
                }
            }
            check_schedule(boxes, 20);
        }
}

TEST(test_random_boxes)
{
    check_random_boxes(1);
}

/* A region gets a chunk once, however many of its boxes touch it. */
TEST(test_boxes_of_one_chunk)
{
    check_random_boxes(20);
    check_random_boxes(3);
}

TEST(test_ends_of_the_index)
{
    const int32_t end = 1 << 30;
    struct vox_chunk_box boxes[2] = {
        {{{-end, -end, -end}, {-end + 200, -end, -end}}, 0},
        {{{end - 200, end - 1, end - 1}, {end - 1, end - 1, end - 1}}, 1},
    };
    check_schedule(boxes, 2);
}

TEST(test_no_chunks)
{
    struct vox_chunk_box none = {{{0, 0, 0}, {0, 0, 0}}, 0};
    check_schedule(&none, 0);
}

/* As many chunks as 10^10 triangles have at most, side by side on a plane. Each region gets the
 * chunks that touch it, within the memory of an entry for each. */
TEST(test_ten_billion_triangles)
{
    enum { SIDE = 553, CHUNK_VOXELS = 47, COUNT = SIDE * SIDE };
    struct vox_chunk_box *boxes = calloc(COUNT, sizeof *boxes);
    double expected = 0.0, visits = 0.0;
    assert_non_null(boxes);
    assert_true(COUNT >= UINT64_C(10000000000) / (FMT_TRIS_CHUNK_TRIANGLES / 2));
    for (uint32_t i = 0; i < COUNT; i++) {
        const int32_t x = (int32_t)(i % SIDE) * CHUNK_VOXELS,
                      y = (int32_t)(i / SIDE) * CHUNK_VOXELS;
        boxes[i] =
            (struct vox_chunk_box){{{x, y, 0}, {x + CHUNK_VOXELS - 1, y + CHUNK_VOXELS - 1, 0}}, i};
        expected += vox_region_count(&boxes[i].box);
    }
    struct vox_schedule *schedule;
    struct bsq_ctx *ctx = test_context(1, COUNT * vox_schedule_entry_bytes() + 4096);
    assert_int_equal(vox_schedule_create(ctx, boxes, COUNT, &schedule), 0);
    vox_region_key key, after, before = 0;
    for (uint32_t chunk; vox_schedule_next(schedule, &key); before = key) {
        assert_true(key > before || visits == 0.0);
        while (vox_schedule_chunk(schedule, &chunk, &after))
            visits += 1.0;
    }
    assert_true(visits == expected);
    vox_schedule_destroy(schedule);
    bsq_ctx_destroy(ctx);
    free(boxes);
}

RUN_TESTS(NULL, NULL)
