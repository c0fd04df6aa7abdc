/* schedule.c - merges the sequences of regions of all chunk boxes.
 *
 * A box touches the regions that it overlaps, and the successor of a region in that sequence can be
 * computed. A heap with one entry for each box, keyed by (next region, box), yields the regions in
 * order and the chunks of each in ascending order. No list of pairs exists, and empty space costs
 * nothing however large the grid is. */
#include "libvoxel/voxelize/plan/plan.h"

/* A cube has 32^3 regions. Cube numbers are below 2^18 in magnitude. As 19-bit two's complement
 * they sort like the unsigned keys of the grid's root: first 0 and up, then the negative ones. */
enum { CUBE_LOG2 = 5, CUBE_BITS = 19 };

struct entry {
    vox_region_key key;
    uint64_t box;
};

struct vox_schedule {
    struct bsq_ctx *ctx;
    const struct vox_chunk_box *boxes;
    struct entry *heap;
    vox_region_key *keys; /* of each box: its next region */
    uint64_t count, box_count;
    vox_region_key current;
};

/* ---- keys ---- */

static vox_region_key make_key(const int32_t region[3])
{
    const uint32_t cube_mask = (1u << CUBE_BITS) - 1, in_cube = (1u << CUBE_LOG2) - 1;
    vox_region_key key = 0;
    for (int a = 0; a < 3; a++)
        key = key << CUBE_BITS | ((uint32_t)(region[a] >> CUBE_LOG2) & cube_mask);
    for (int a = 0; a < 3; a++)
        key = key << CUBE_LOG2 | ((uint32_t)region[a] & in_cube);
    return key;
}

static void split_key(vox_region_key key, int32_t region[3])
{
    uint32_t places = (uint32_t)key & ((1u << 3 * CUBE_LOG2) - 1);
    uint64_t cubes = (uint64_t)(key >> 3 * CUBE_LOG2);
    for (int a = 2; a >= 0; a--) {
        uint32_t bits = (uint32_t)cubes & ((1u << CUBE_BITS) - 1);
        int32_t cube = (int32_t)bits - (bits >> (CUBE_BITS - 1) ? 1 << CUBE_BITS : 0);
        region[a] = cube * (1 << CUBE_LOG2) + (int32_t)(places & ((1u << CUBE_LOG2) - 1));
        cubes >>= CUBE_BITS;
        places >>= CUBE_LOG2;
    }
}

void vox_region_origin(vox_region_key key, int32_t origin[3])
{
    split_key(key, origin);
    for (int a = 0; a < 3; a++)
        origin[a] *= VOX_REGION_SIZE;
}

double vox_region_count(const struct vox_box *box)
{
    double regions = 1.0;
    for (int a = 0; a < 3; a++)
        regions *= (box->hi[a] >> VOX_REGION_LOG2) - (box->lo[a] >> VOX_REGION_LOG2) + 1;
    return regions;
}

/* ---- the sequence of one box ---- */

static int32_t region_of(int32_t voxel)
{
    return voxel >> VOX_REGION_LOG2;
}

static int32_t schedule_cube_of(int32_t region)
{
    return region >> CUBE_LOG2;
}

static int32_t max32(int32_t a, int32_t b)
{
    return a > b ? a : b;
}

static int32_t first_cube(int32_t lo, int32_t hi)
{
    return lo < 0 && hi >= 0 ? 0 : lo;
}

/* Advances to the cube after `cube` among lo to hi, in the order of the keys. Returns false after
 * the last one. */
static bool next_cube(int32_t lo, int32_t hi, int32_t *cube)
{
    if (*cube == hi && hi >= 0 && lo < 0) {
        *cube = lo;
        return true;
    }
    if (*cube == hi || *cube == -1)
        return false;
    ++*cube;
    return true;
}

/* Returns the first region of the box in a cube, on one axis. */
static int32_t enter_cube(const struct vox_box *box, int axis, int32_t cube)
{
    return max32(region_of(box->lo[axis]), cube * (1 << CUBE_LOG2));
}

vox_region_key vox_region_first(const struct vox_box *box)
{
    int32_t region[3];
    for (int a = 0; a < 3; a++)
        region[a] = enter_cube(box, a,
                               first_cube(schedule_cube_of(region_of(box->lo[a])),
                                          schedule_cube_of(region_of(box->hi[a]))));
    return make_key(region);
}

static vox_region_key region_after(const struct vox_box *box, vox_region_key key)
{
    int32_t region[3];
    split_key(key, region);
    for (int a = 2; a >= 0; a--) {
        int32_t cube = schedule_cube_of(region[a]);
        if (region[a] < region_of(box->hi[a]) && schedule_cube_of(region[a] + 1) == cube) {
            region[a]++;
            return make_key(region);
        }
        region[a] = enter_cube(box, a, cube);
    }
    for (int a = 2; a >= 0; a--) {
        int32_t lo = schedule_cube_of(region_of(box->lo[a])),
                hi = schedule_cube_of(region_of(box->hi[a]));
        int32_t cube = schedule_cube_of(region[a]);
        if (next_cube(lo, hi, &cube)) {
            region[a] = enter_cube(box, a, cube);
            return make_key(region);
        }
        region[a] = enter_cube(box, a, first_cube(lo, hi));
    }
    return VOX_REGION_KEY_NEVER;
}

/* ---- the heap ---- */

static bool entry_before(const struct entry *a, const struct entry *b)
{
    return a->key != b->key ? a->key < b->key : a->box < b->box;
}

/* Puts `entry` into the hole at `at` and moves smaller children up. */
static void schedule_sift_down(struct vox_schedule *s, uint64_t at, struct entry entry)
{
    for (uint64_t child; (child = 2 * at + 1) < s->count; at = child) {
        if (child + 1 < s->count && entry_before(&s->heap[child + 1], &s->heap[child]))
            child++;
        if (!entry_before(&s->heap[child], &entry))
            break;
        s->heap[at] = s->heap[child];
    }
    s->heap[at] = entry;
}

uint64_t vox_schedule_entry_bytes(void)
{
    return sizeof(struct entry) + sizeof(vox_region_key);
}

int vox_schedule_create(struct bsq_ctx *ctx, const struct vox_chunk_box *boxes, uint64_t box_count,
                        struct vox_schedule **out)
{
    struct vox_schedule *s;
    int status;
    *out = NULL;
    BSQ_TRY(BSQ_CALLOC(ctx, "region schedule", 1, &s));
    *s = (struct vox_schedule){.ctx = ctx, .boxes = boxes, .box_count = box_count};
    BSQ_TRY(BSQ_ALLOC(ctx, "region schedule", box_count + 1, &s->heap));
    BSQ_TRY(BSQ_ALLOC(ctx, "region schedule", box_count + 1, &s->keys));
    for (uint64_t i = 0; i < box_count; i++) {
        s->keys[i] = vox_region_first(&boxes[i].box);
        s->heap[s->count++] = (struct entry){s->keys[i], i};
    }
    for (uint64_t i = s->count / 2; i-- > 0;)
        schedule_sift_down(s, i, s->heap[i]);
    *out = s;
    return 0;
done:
    vox_schedule_destroy(s);
    return status;
}

void vox_schedule_destroy(struct vox_schedule *s)
{
    if (!s)
        return;
    BSQ_FREE(s->ctx, s->heap, s->keys, s);
}

bool vox_schedule_next(struct vox_schedule *s, vox_region_key *key)
{
    if (s->count == 0)
        return false;
    *key = s->current = s->heap[0].key;
    return true;
}

/* Moves the first box of the heap to its next region. */
static void schedule_advance(struct vox_schedule *s)
{
    struct entry entry = s->heap[0];
    const struct vox_box *box = &s->boxes[entry.box].box;
    entry.key = s->keys[entry.box] = region_after(box, entry.key);
    if (entry.key == VOX_REGION_KEY_NEVER)
        entry = s->heap[--s->count];
    if (s->count > 0)
        schedule_sift_down(s, 0, entry);
}

/* Returns the next region of the chunk that box `i` belongs to. */
static vox_region_key next_of_chunk(const struct vox_schedule *s, uint64_t i)
{
    const uint32_t chunk = s->boxes[i].chunk;
    vox_region_key next = VOX_REGION_KEY_NEVER;
    while (i > 0 && s->boxes[i - 1].chunk == chunk)
        i--;
    for (; i < s->box_count && s->boxes[i].chunk == chunk; i++)
        if (s->keys[i] < next)
            next = s->keys[i];
    return next;
}

bool vox_schedule_chunk(struct vox_schedule *s, uint32_t *chunk, vox_region_key *after)
{
    if (s->count == 0 || s->current < s->heap[0].key)
        return false;
    const uint64_t box = s->heap[0].box;
    *chunk = s->boxes[box].chunk;
    while (s->count > 0 && s->heap[0].key <= s->current && s->boxes[s->heap[0].box].chunk == *chunk)
        schedule_advance(s);
    *after = next_of_chunk(s, box);
    return true;
}
