/* exact_smooth.c - notes which vertex normals the hits in a chunk need. */
#include "libbake/exact/exact_scene.h"

#include <string.h>

enum { ROWS = EXACT_RING_ROWS };

static uint32_t filter_words(uint32_t positions)
{
    return (bsq_positions_slots(positions) + 63) / 64;
}

uint64_t bake_exact_smooth_bytes(uint32_t vertices)
{
    const struct exact_smooth *s = NULL;
    return (uint64_t)bsq_positions_slots(vertices) * sizeof *s->table.slots +
           filter_words(vertices) * sizeof *s->filter +
           (uint64_t)vertices * (sizeof *s->positions + sizeof *s->entry_of) +
           exact_groups(vertices) * (sizeof *s->groups + sizeof *s->shared) +
           ((uint64_t)vertices + 1) *
               (2 * ROWS * sizeof *s->sums + sizeof *s->creases + sizeof *s->crease_of);
}

void bake_exact_smooth_begin(struct exact_slot *slot)
{
    struct exact_smooth *s = &slot->smooth;
    const uint32_t vertices = slot->chunk.tris.vertex_count, slots = bsq_positions_slots(vertices);
    s->sums = slot->smooth_memory;
    s->seconds = s->sums + ROWS * ((uint64_t)vertices + 1);
    s->creases = s->seconds + ROWS * ((uint64_t)vertices + 1);
    s->filter = (uint64_t *)(void *)(s->creases + vertices + 1);
    s->positions = (float(*)[3])(void *)(s->filter + filter_words(vertices));
    s->groups = (struct exact_box *)(void *)(s->positions + vertices);
    s->shared = s->groups + exact_groups(vertices);
    s->crease_of = (uint32_t *)(void *)(s->shared + exact_groups(vertices));
    s->entry_of = s->crease_of + vertices + 1;
    s->table =
        (struct bsq_positions){s->entry_of + vertices, slots - 1, (const float(*)[3])s->positions};
    s->count = 0;
    memset(s->sums[0], 0, ROWS * sizeof *s->sums);
    memset(s->table.slots, 0, slots * sizeof *s->table.slots);
    memset(s->filter, 0, filter_words(vertices) * sizeof *s->filter);
    memset(s->entry_of, 0, vertices * sizeof *s->entry_of);
}

void bake_exact_smooth_need(struct exact_slot *slot, uint32_t vertex)
{
    struct exact_smooth *s = &slot->smooth;
    if (s->entry_of[vertex] != 0)
        return;
    const uint32_t hash = bsq_position_hash(slot->chunk.tris.positions[vertex]);
    uint32_t *entry =
        bsq_positions_find_hashed(&s->table, slot->chunk.tris.positions[vertex], hash);
    if (*entry == 0) {
        memcpy(s->positions[s->count], slot->chunk.tris.positions[vertex], sizeof *s->positions);
        *entry = ++s->count;
        *exact_filter_word(s, hash) |= exact_filter_bits(hash);
        memset(s->sums[ROWS * s->count], 0, ROWS * sizeof *s->sums);
    }
    s->entry_of[vertex] = *entry;
}
