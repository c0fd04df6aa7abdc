/* exact_smooth_lanes.c - sums the vertex normals that the hits in a chunk need.
 *
 * They have the bits that the whole scan would give. Vertices at the same position are one vertex,
 * in one chunk or in several. The one-ring of a vertex (base/geometry/smooth_normals.h) is summed
 * in the order of the file, whichever chunks its triangles are in. Only normals that hits need are
 * summed, and only chunks whose bounds contain such a vertex are read: three times if some of these
 * vertices may be creases. Most of these chunks are in memory (exact_kept.c). */
#include "libbake/exact/exact_scene.h"

#include <math.h>
#include <string.h>

#include "base/sort_array.h"

enum { PARTS = BSQ_RING_UNITS, ROWS = EXACT_RING_ROWS };

/* An entry that was not looked up; each byte of it. */
#define UNKNOWN UINT32_MAX
enum { UNKNOWN_BYTE = 0xff };

enum step { STEP_SUM, STEP_FARTHEST, STEP_SIDES };

/* Returns the entry of a position, or 0. */
static inline uint32_t exact_smooth_find_entry(const struct exact_smooth *s,
                                               const float position[3])
{
    const uint32_t hash = bsq_position_hash(position);
    const uint64_t bits = exact_filter_bits(hash);
    return (*exact_filter_word(s, hash) & bits) == bits
               ? *bsq_positions_find_hashed(&s->table, position, hash)
               : 0;
}

/* Does a step for triangles of a chunk. map: the entries of its vertices. */
static void exact_smooth_add_chunk(const struct exact_smooth *s, enum step step,
                                   enum bsq_scan_normals weights,
                                   const struct fmt_tris_chunk *chunk, uint32_t begin, uint32_t end,
                                   const uint32_t *map)
{
    if (step == STEP_SUM)
        bsq_add_one_rings(chunk->positions, chunk->triangles, begin, end, map, weights, PARTS,
                          s->sums);
    else if (step == STEP_FARTHEST)
        bsq_find_farthest(chunk->positions, chunk->triangles, begin, end, map, s->crease_of, PARTS,
                          (const double(*)[4])s->sums, s->creases);
    else
        bsq_add_sides(chunk->positions, chunk->triangles, begin, end, map, s->crease_of, PARTS,
                      (const double(*)[4])s->creases, s->sums, s->seconds);
}

/* Returns whether a step needs the vertex at position i. */
static bool is_needed(const struct exact_smooth *s, enum step step, uint32_t i)
{
    return step == STEP_SUM || s->crease_of[i + 1] != 0;
}

static bool exact_smooth_overlap(const struct exact_box *a, const struct exact_box *b)
{
    bool both = true;
    for (int k = 0; k < 3; k++)
        both &= (a->low[k] <= b->high[k]) & (a->high[k] >= b->low[k]);
    return both;
}

/* Returns whether a box overlaps any of `count` others. */
static bool overlaps_any(const struct exact_box *box, const struct exact_box *others,
                         uint32_t count)
{
    bool any = false;
    for (uint32_t i = 0; i < count && !any; i++)
        any = exact_smooth_overlap(box, &others[i]);
    return any;
}

/* Sets the bounds of groups of needed positions. Returns those of all. */
static struct exact_box set_groups(const struct exact_smooth *s)
{
    struct exact_box all = EXACT_EMPTY_BOX;
    for (uint32_t i = 0; i < s->count; i++) {
        struct exact_box *group = &s->groups[i / EXACT_GROUP];
        if (i % EXACT_GROUP == 0)
            *group = EXACT_EMPTY_BOX;
        exact_box_grow(group, s->positions[i], s->positions[i]);
    }
    for (uint32_t g = 0; g < exact_groups(s->count); g++)
        exact_box_grow(&all, s->groups[g].low, s->groups[g].high);
    return all;
}

/* Sets shared[] to the bounds of the vertices of each group that a step needs and that lie within
 * the bounds of a chunk, and *all to those of all groups. Returns the number of groups that have
 * any. */
static uint32_t find_shared(const struct exact_smooth *s, enum step step,
                            const struct fmt_tris_chunk_info *chunk, struct exact_box *all)
{
    uint32_t inside[EXACT_GROUP], count = 0;
    struct exact_box box = EXACT_EMPTY_BOX;
    *all = EXACT_EMPTY_BOX;
    exact_box_grow(&box, chunk->bounds_min, chunk->bounds_max);
    for (uint32_t g = 0; g < exact_groups(s->count); g++) {
        const uint32_t first = g * EXACT_GROUP, left = s->count - first;
        if (!exact_smooth_overlap(&box, &s->groups[g]))
            continue;
        const uint32_t found =
            bsq_positions_inside(box.low, box.high, (const float(*)[3])s->positions + first,
                                 left < EXACT_GROUP ? left : EXACT_GROUP, inside);
        bool any = false;
        struct exact_box shared = EXACT_EMPTY_BOX;
        for (uint32_t i = 0; i < found; i++)
            if (is_needed(s, step, first + inside[i])) {
                const float *p = s->positions[first + inside[i]];
                exact_box_grow(&shared, p, p);
                any = true;
            }
        if (any)
            s->shared[count++] = shared;
        exact_box_grow(all, shared.low, shared.high);
    }
    return count;
}

static int ascending(const void *a, const void *b)
{
    uint32_t x = *(const uint32_t *)a, y = *(const uint32_t *)b;
    return (x > y) - (x < y);
}

void BSQ_SIMD_NAME(bake_exact_smooth_find_near)(const struct bake_exact *exact,
                                                struct exact_slot *slot)
{
    const struct exact_box box = set_groups(&slot->smooth);
    const uint32_t found = bake_exact_tree_overlapping(&exact->tree, &box, slot->near);
    struct exact_box shared;
    slot->near_count = 0;
    for (uint32_t i = 0; i < found; i++)
        if (slot->near[i] == slot->number ||
            find_shared(&slot->smooth, STEP_SUM, &exact->chunks[slot->near[i]], &shared) > 0)
            slot->near[slot->near_count++] = slot->near[i];
    bsq_sort(slot->near, slot->near_count, sizeof *slot->near, ascending);
}

/* Gets a chunk: that of a slot of the wave, one that is kept, or into the scratch. Fails as
 * fmt_tris_load() does. */
static int get_neighbour(const struct exact_summing *of, uint32_t number, struct exact_chunk *out)
{
    const struct exact_chunk *kept = bake_exact_kept_find(of->kept, number);
    for (uint32_t i = 0; i < of->wave_count && !kept; i++)
        if (of->wave[i].number == number && of->wave[i].loaded)
            kept = &of->wave[i].chunk;
    if (kept) {
        *out = *kept;
        return 0;
    }
    const int status = bake_exact_load(of->exact, number, of->scratch->neighbour, out);
    if (status == 0)
        bake_exact_set_groups(of->exact, of->scratch->neighbour, out);
    return status;
}

/* Finds the needed vertices among the corners of triangles. map: UNKNOWN for each vertex that was
 * not looked up before. */
static void match_corners(const struct exact_smooth *s, const struct fmt_tris_chunk *chunk,
                          uint32_t begin, uint32_t end, const struct exact_box *box, uint32_t *map)
{
    const uint32_t *corners = chunk->triangles[0];
    for (uint32_t i = 3 * begin; i < 3 * end; i++) {
        const uint32_t v = corners[i];
        const float *p = chunk->positions[v];
        if (map[v] != UNKNOWN)
            continue;
        bool in = true;
        for (int k = 0; k < 3; k++)
            in &= (p[k] >= box->low[k]) & (p[k] <= box->high[k]);
        map[v] = in ? exact_smooth_find_entry(s, p) : 0;
    }
}

/* Does a step for the triangles of a neighbour. Fails as fmt_tris_load() does. */
static int add_neighbour(const struct exact_summing *of, enum step step, uint32_t number)
{
    const struct exact_smooth *s = &of->slot->smooth;
    uint32_t *map = of->scratch->map;
    struct exact_chunk near;
    struct exact_box box;
    int status = bsq_check(of->exact->ctx);
    const uint32_t shared =
        status == 0 ? find_shared(s, step, &of->exact->chunks[number], &box) : 0;
    if (shared == 0)
        return status;
    status = get_neighbour(of, number, &near);
    if (status < 0)
        return status;
    const uint32_t count = near.tris.triangle_count;
    memset(map, UNKNOWN_BYTE, near.tris.vertex_count * sizeof *map);
    for (uint32_t begin = 0; begin < count; begin += EXACT_GROUP) {
        const uint32_t end = count - begin < EXACT_GROUP ? count : begin + EXACT_GROUP;
        const struct exact_box *group = &near.groups[begin / EXACT_GROUP];
        if (!exact_smooth_overlap(&box, group) || !overlaps_any(group, s->shared, shared))
            continue;
        match_corners(s, &near.tris, begin, end, &box, map);
        exact_smooth_add_chunk(s, step, of->exact->options.normals, &near.tris, begin, end, map);
    }
    return 0;
}

/* Finds the vertices that are not needed but share the position of one that is. */
static void match_own(const struct exact_smooth *s, const struct fmt_tris_chunk *own)
{
    for (uint32_t v = 0; v < own->vertex_count; v++)
        if (s->entry_of[v] == 0)
            s->entry_of[v] = exact_smooth_find_entry(s, own->positions[v]);
}

/* Does a step for the triangles of all chunks near the needed vertices, in the order of the file.
 */
static int exact_smooth_run_step(const struct exact_summing *of, enum step step)
{
    const struct exact_slot *slot = of->slot;
    const struct exact_smooth *s = &slot->smooth;
    const struct fmt_tris_chunk *own = &slot->chunk.tris;
    int status = 0;
    for (uint32_t i = 0; i < slot->near_count && status == 0; i++) {
        if (slot->near[i] != slot->number) {
            status = add_neighbour(of, step, slot->near[i]);
            continue;
        }
        if (step == STEP_SUM)
            match_own(s, own);
        exact_smooth_add_chunk(s, step, of->exact->options.normals, own, 0, own->triangle_count,
                               s->entry_of);
    }
    return status;
}

/* Numbers the one-rings that may be creases. Returns whether there are any. */
static bool begin_creases(const struct exact_smooth *s)
{
    bool any = false;
    s->crease_of[0] = 0;
    for (uint32_t i = 1; i <= s->count; i++) {
        s->crease_of[i] = bsq_may_fold(s->sums[ROWS * i + 1]) ? i : 0;
        any |= s->crease_of[i] != 0;
        memcpy(s->creases[i], (const double[4]){[3] = INFINITY}, sizeof *s->creases);
    }
    return any;
}

/* Divides one-rings. Returns whether there are any. */
static bool exact_smooth_divide_rings(const struct exact_smooth *s)
{
    bool any = false;
    for (uint32_t i = 1; i <= s->count; i++) {
        if (s->crease_of[i] != 0 && !bsq_divide_ring(&s->sums[ROWS * i], PARTS, s->creases[i]))
            s->crease_of[i] = 0;
        any |= s->crease_of[i] != 0;
        memset(s->seconds[ROWS * i], 0, ROWS * sizeof *s->seconds);
    }
    return any;
}

int BSQ_SIMD_NAME(bake_exact_smooth_sum)(const struct exact_summing *of)
{
    const struct exact_smooth *s = &of->slot->smooth;
    int status = exact_smooth_run_step(of, STEP_SUM);
    if (status == 0 && begin_creases(s))
        status = exact_smooth_run_step(of, STEP_FARTHEST);
    else
        return status;
    if (status == 0 && exact_smooth_divide_rings(s))
        status = exact_smooth_run_step(of, STEP_SIDES);
    return status;
}
