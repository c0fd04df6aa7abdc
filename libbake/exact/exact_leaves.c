/* exact_leaves.c - see exact_leaves.h. */
#include "libbake/exact/exact_leaves.h"

#include <string.h>

#include "base/geometry/middles.h"
#include "libbake/kernel/bk_meet.h"

/* Devices read the same bytes. */
_Static_assert(sizeof(struct exact_box8) == BK_NODE_SIZE * sizeof(bk_float4), "see bk_meet.h");
_Static_assert(sizeof(struct exact_leaf) == BK_LEAF_SIZE * sizeof(bk_float4), "see bk_meet.h");
_Static_assert(sizeof(bk_chunk) == BSQ_ALIGNMENT, "see bk_meet.h");
_Static_assert(BSQ_ALIGNMENT == BK_CHUNK_UNIT * sizeof(bk_float4), "see bk_meet.h");
_Static_assert((int)BK_CHUNK_LEVELS == (int)EXACT_TREE_LEVELS, "see bk_meet.h");

static uint64_t tree_bytes(uint32_t triangles)
{
    return bake_exact_tree_bytes(exact_runs(triangles));
}

uint64_t bake_exact_leaves_bytes(uint32_t triangles)
{
    return tree_bytes(triangles) +
           bsq_align_up(exact_runs(triangles) * sizeof(struct exact_leaf), BSQ_ALIGNMENT);
}

static uint64_t middles_bytes(uint32_t triangles)
{
    return bsq_align_up(triangles * sizeof(struct bsq_middle), BSQ_ALIGNMENT);
}

uint64_t bake_exact_leaves_scratch_bytes(uint32_t triangles)
{
    return middles_bytes(triangles) +
           bsq_align_up(exact_runs(triangles) * sizeof(struct exact_box), BSQ_ALIGNMENT);
}

/* ---- order ---- */

static int longest_axis(const struct bsq_middle *middles, uint32_t count)
{
    struct exact_box box = EXACT_EMPTY_BOX;
    int axis = 0;
    for (uint32_t i = 0; i < count; i++)
        exact_box_grow(&box, middles[i].at, middles[i].at);
    for (int k = 1; k < 3; k++)
        axis = box.high[k] - box.low[k] > box.high[axis] - box.low[axis] ? k : axis;
    return axis;
}

/* Orders triangles so that each 8, 64, 512 and so on, as the tree's nodes have them, are close
 * together: halves them across the longest side. */
static void sort_middles(struct bsq_middle *middles, uint32_t count)
{
    while (count > EXACT_RUN) {
        uint32_t part = EXACT_RUN; /* of a child of the node that holds all of them */
        while (part < (count + 7) / 8)
            part *= 8;
        const uint32_t parts = (count + part - 1) / part, first = parts / 2 * part;
        bsq_select_middles(middles, count, first, longest_axis(middles, count));
        sort_middles(middles, first);
        middles += first;
        count -= first;
    }
}

/* ---- leaves ---- */

struct exact_box bake_exact_leaf_set(const struct fmt_tris_chunk *chunk,
                                     const struct bsq_middle *order, uint32_t run, bool sided,
                                     struct exact_leaf *out)
{
    struct exact_box box = EXACT_EMPTY_BOX;
    out->backwards = 0;
    for (uint32_t i = 0; i < EXACT_RUN; i++) {
        const uint32_t left = chunk->triangle_count - EXACT_RUN * run,
                       place = EXACT_RUN * run + (i < left ? i : left - 1),
                       triangle = order ? order[place].number : place;
        if (sided)
            out->backwards |= (uint32_t)bake_exact_wound_backwards(chunk, triangle) << i;
        for (int corner = 0; corner < 3; corner++) {
            const float *at = chunk->positions[chunk->triangles[triangle][corner]];
            exact_box_grow(&box, at, at);
            for (int k = 0; k < 3; k++)
                out->corners[corner][k][i] = at[k];
        }
    }
    return box;
}

void bake_exact_leaves_build(const struct fmt_tris_chunk *chunk, bool sorted, bool sided,
                             void *memory, void *scratch, struct exact_leaves *out)
{
    const uint32_t count = chunk->triangle_count;
    struct bsq_middle *middles = scratch;
    struct exact_box *boxes = (struct exact_box *)(void *)((char *)scratch + middles_bytes(count));
    out->leaves = (struct exact_leaf *)(void *)((char *)memory + tree_bytes(count));
    for (uint32_t t = 0; t < count; t++) {
        four_floats low, high;
        exact_triangle_bounds(chunk, t, &low, &high);
        low += high;
        memcpy(middles[t].at, &low, sizeof middles[t].at);
        middles[t].number = t;
    }
    if (sorted)
        sort_middles(middles, count);
    for (uint32_t r = 0; r < exact_runs(count); r++)
        boxes[r] = bake_exact_leaf_set(chunk, middles, r, sided, &out->leaves[r]);
    bake_exact_tree_build(&out->tree, exact_runs(count), boxes, memory);
}

/* ---- areas ---- */

static uint64_t records_bytes(uint32_t chunks)
{
    return (chunks + UINT64_C(1)) * sizeof(bk_chunk);
}

uint64_t bake_exact_table_bytes(uint32_t chunks)
{
    return records_bytes(chunks) + bake_exact_tree_bytes(chunks);
}

/* Describes a tree in an area. Returns where the next one begins. */
static uint64_t set_record(const struct exact_tree *tree, uint64_t at, bk_chunk *out)
{
    const uint64_t leaves = at + bake_exact_tree_bytes(tree->count);
    *out = (bk_chunk){.nodes = (bk_uint)(at / BSQ_ALIGNMENT),
                      .leaves = (bk_uint)(leaves / BSQ_ALIGNMENT),
                      .levels = tree->levels};
    memcpy(out->first, tree->first, sizeof out->first);
    return leaves + bsq_align_up(tree->count * sizeof(struct exact_leaf), BSQ_ALIGNMENT);
}

void bake_exact_table_set(const struct exact_group *group, uint32_t chunks, void *table)
{
    uint64_t at = records_bytes(chunks);
    bk_chunk *records = table;
    set_record(&group->tree, at, records);
    memcpy((char *)table + at, group->tree.nodes, bake_exact_tree_bytes(chunks));
    at = bake_exact_table_bytes(chunks);
    for (uint32_t c = 0; c < chunks; c++)
        at = set_record(&group->chunks[c].tree, at, &records[1 + c]);
}
