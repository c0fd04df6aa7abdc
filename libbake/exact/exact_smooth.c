/* exact_smooth.c - smooth vertex normals of a chunk, with the bits that the whole scan would give.
 *
 * Vertices at the same position are one vertex, in one chunk or in several. The one-ring of a
 * vertex (base/smooth_normals.h) is summed in the order of the file, whichever chunks its triangles
 * are in. Only normals that hits need are summed, and only chunks whose bounds contain such a
 * vertex are read. */
#include "libbake/exact/exact_scene.h"

#include <math.h>
#include <string.h>

#include "base/sort_array.h"

/* ---- memory ---- */

uint64_t bake_exact_smooth_bytes(uint32_t vertices)
{
    const struct exact_smooth *s = NULL;
    return (uint64_t)bsq_positions_slots(vertices) * sizeof *s->table.slots +
           (uint64_t)vertices * (sizeof *s->positions + sizeof *s->entry_of) +
           ((uint64_t)vertices + 1) * sizeof *s->sums;
}

void bake_exact_smooth_begin(struct exact_slot *slot)
{
    struct exact_smooth *s = &slot->smooth;
    const uint32_t vertices = slot->chunk.vertex_count, slots = bsq_positions_slots(vertices);
    s->sums = slot->smooth_memory;
    s->positions = (float(*)[3])(void *)(s->sums + vertices + 1);
    s->entry_of = (uint32_t *)(void *)(s->positions + vertices);
    s->table =
        (struct bsq_positions){s->entry_of + vertices, slots - 1, (const float(*)[3])s->positions};
    s->count = 0;
    memset(s->sums[0], 0, sizeof *s->sums);
    memset(s->table.slots, 0, slots * sizeof *s->table.slots);
    memset(s->entry_of, 0, vertices * sizeof *s->entry_of);
}

/* ---- vertices by position ---- */

void bake_exact_smooth_need(struct exact_slot *slot, uint32_t vertex)
{
    struct exact_smooth *s = &slot->smooth;
    if (s->entry_of[vertex] != 0)
        return;
    uint32_t *entry = bsq_positions_find(&s->table, slot->chunk.positions[vertex]);
    if (*entry == 0) {
        memcpy(s->positions[s->count], slot->chunk.positions[vertex], sizeof *s->positions);
        *entry = ++s->count;
        memset(s->sums[s->count], 0, sizeof *s->sums);
    }
    s->entry_of[vertex] = *entry;
}

/* ---- sums ---- */

static bool inside(const struct exact_box *box, const float p[3])
{
    bool in = true;
    for (int k = 0; k < 3; k++)
        in &= (p[k] >= box->low[k]) & (p[k] <= box->high[k]);
    return in;
}

/* Adds the triangles of a chunk to the sums. map: scratch, one entry per vertex. */
static void add_chunk(struct exact_smooth *s, enum bsq_scan_normals weights,
                      const struct fmt_tris_chunk *chunk, const struct exact_box *box,
                      uint32_t *map)
{
    if (bsq_positions_match(&s->table, box->low, box->high, chunk->positions, chunk->vertex_count,
                            map))
        bsq_add_one_rings(chunk->positions, chunk->triangles, 0, chunk->triangle_count, map,
                          weights, 1, s->sums);
}

static struct exact_box bounds_of(const struct exact_smooth *s)
{
    struct exact_box box = {{INFINITY, INFINITY, INFINITY}, {-INFINITY, -INFINITY, -INFINITY}};
    for (uint32_t i = 0; i < s->count; i++)
        for (int k = 0; k < 3; k++) {
            const float p = s->positions[i][k];
            box.low[k] = p < box.low[k] ? p : box.low[k];
            box.high[k] = p > box.high[k] ? p : box.high[k];
        }
    return box;
}

/* Checks whether a needed vertex lies within the bounds of a chunk. */
static bool touches_chunk(const struct exact_smooth *s, const struct fmt_tris_chunk_info *chunk)
{
    struct exact_box box;
    memcpy(box.low, chunk->bounds_min, sizeof box.low);
    memcpy(box.high, chunk->bounds_max, sizeof box.high);
    for (uint32_t i = 0; i < s->count; i++)
        if (inside(&box, s->positions[i]))
            return true;
    return false;
}

static int ascending(const void *a, const void *b)
{
    uint32_t x = *(const uint32_t *)a, y = *(const uint32_t *)b;
    return (x > y) - (x < y);
}

int bake_exact_smooth_sum(const struct bake_exact *exact, struct exact_slot *slot,
                          const struct exact_scratch *scratch)
{
    struct exact_smooth *s = &slot->smooth;
    const struct exact_box box = bounds_of(s);
    const uint32_t near = bake_exact_tree_overlapping(&exact->tree, &box, scratch->near);
    bsq_sort(scratch->near, near, sizeof *scratch->near, ascending);
    for (uint32_t i = 0; i < near; i++) {
        const uint32_t number = scratch->near[i];
        if (number == slot->number) {
            /* Also matches vertices that are not needed but share the position of one that is. */
            add_chunk(s, exact->options.normals, &slot->chunk, &box, s->entry_of);
            continue;
        }
        if (!touches_chunk(s, &exact->chunks[number]))
            continue;
        struct fmt_tris_chunk neighbour;
        int status = bsq_check(exact->ctx);
        if (status == 0)
            status = fmt_tris_load(exact->file, number, scratch->neighbour, &neighbour);
        if (status != 0)
            return status;
        add_chunk(s, exact->options.normals, &neighbour, &box, scratch->map);
    }
    return 0;
}
