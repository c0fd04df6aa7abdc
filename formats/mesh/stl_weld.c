/* stl_weld.c - finds equal vertices of one part, with a hash table of their positions. */
#include "formats/mesh/stl_internal.h"

#include <math.h>
#include <string.h>

/* A vertex whose place is taken this often is not welded: files could be made whose vertices all
 * have one place. Later stages match vertices by position. */
enum { MOST_PROBES = 256 };

/* The table: entries are numbers of vertices + 1; 0: empty. At most half of them are used. */
struct weld {
    uint64_t mask;
    uint32_t slots[];
};

int fmt_stl_begin_weld(struct stream_slot *slot, uint64_t most)
{
    struct mesh_arrays *a = &slot->arrays;
    uint64_t entries = 1024;
    int status;
    while (entries < 2 * most)
        entries *= 2;
    if (most > UINT32_MAX / 2)
        return bsq_fail(slot->ctx, BSQ_ENOMEM, "a part of an STL file has too many vertices");
    BSQ_TRY(FMT_RESERVE(slot->ctx, sizeof(struct weld) + entries * sizeof(uint32_t), slot->work,
                        slot->work_capacity));
    BSQ_TRY(FMT_RESERVE(slot->ctx, most, a->positions, a->position_capacity));
    if (a->has_colors)
        BSQ_TRY(FMT_RESERVE(slot->ctx, most, a->colors, a->color_capacity));
    struct weld *weld = (struct weld *)(void *)slot->work;
    weld->mask = entries - 1;
    memset(weld->slots, 0, entries * sizeof(uint32_t));
done:
    return status;
}

static uint64_t hash_position(const double position[3])
{
    uint64_t bits[3], hash = 0;
    memcpy(bits, position, sizeof bits);
    for (int i = 0; i < 3; i++) {
        hash = (hash ^ bits[i]) * 0x9e3779b97f4a7c15u;
        hash ^= hash >> 32;
    }
    return hash;
}

/* Compares bit by bit, so that 0 and -0 stay different. */
static bool is_same(const struct mesh_arrays *a, uint64_t vertex, const double position[3],
                    const float *color)
{
    /* NOLINTBEGIN(bugprone-suspicious-memory-comparison): see above */
    return memcmp(a->positions[vertex], position, sizeof a->positions[vertex]) == 0 &&
           (!color || memcmp(a->colors[vertex], color, sizeof a->colors[vertex]) == 0);
    /* NOLINTEND(bugprone-suspicious-memory-comparison) */
}

uint64_t fmt_stl_weld(struct stream_slot *slot, const double position[3], const float *color)
{
    struct weld *weld = (struct weld *)(void *)slot->work;
    struct mesh_arrays *a = &slot->arrays;
    uint64_t i = hash_position(position) & weld->mask;
    for (int probes = 0; probes < MOST_PROBES && weld->slots[i] != 0; probes++) {
        if (is_same(a, weld->slots[i] - 1, position, color))
            return weld->slots[i] - 1;
        i = (i + 1) & weld->mask;
    }
    const uint64_t vertex = a->count[FMT_MESH_VERTEX]++;
    slot->odd[STREAM_NO_POSITION].count += isnan(position[0]);
    if (weld->slots[i] == 0)
        weld->slots[i] = (uint32_t)vertex + 1;
    memcpy(a->positions[vertex], position, sizeof a->positions[vertex]);
    if (color)
        memcpy(a->colors[vertex], color, sizeof a->colors[vertex]);
    return vertex;
}
