/* positions.h - vertices that are one where their positions are: a table that finds them.
 *
 * Scans repeat vertices, at seams of texture space and in every chunk that touches them. Normals as if the scan were whole
 * (libvoxel/smooth_normals.c, libbake/exact_smooth.c) need to know which of them are the same. */
#ifndef BSQ_POSITIONS_H
#define BSQ_POSITIONS_H

#include <stdbool.h>
#include <stdint.h>
#include <string.h>

/* Open addressing. The positions may grow behind those that are in the table. */
struct bsq_positions {
    uint32_t *slots; /* number of a position + 1, 0: free */
    uint32_t mask;   /* number of slots - 1 */
    const float (*positions)[3];
};

/* Slots for so many positions; at most half of them are in use. */
static inline uint32_t bsq_positions_slots(uint32_t positions)
{
    uint32_t slots = 16;
    while (slots / 2 < positions)
        slots *= 2;
    return slots;
}

/* Both zeros are equal positions. */
static inline uint32_t bsq_position_hash(const float p[3])
{
    uint32_t bits[3];
    for (int a = 0; a < 3; a++) {
        float value = p[a] + 0.0f;
        memcpy(&bits[a], &value, sizeof value);
    }
    uint64_t h = (bits[0] | (uint64_t)bits[1] << 32) * UINT64_C(0x9e3779b97f4a7c15);
    h = (h ^ h >> 29 ^ bits[2]) * UINT64_C(0xbf58476d1ce4e5b9);
    return (uint32_t)(h ^ h >> 32);
}

/* Slot of the position, or the free one where it belongs. */
static inline uint32_t *bsq_positions_find(const struct bsq_positions *table, const float p[3])
{
    uint32_t at = bsq_position_hash(p) & table->mask;
    for (; table->slots[at] != 0; at = (at + 1) & table->mask) {
        const float *q = table->positions[table->slots[at] - 1];
        if (q[0] == p[0] && q[1] == p[1] && q[2] == p[2])
            break;
    }
    return &table->slots[at];
}

/* numbers[i]: of positions[i] in the table + 1, or 0; bounds are those of what is in the table. Whether there is any. */
static inline bool bsq_positions_match(const struct bsq_positions *table, const float min[3], const float max[3],
                                       const float (*positions)[3], uint32_t count, uint32_t *numbers)
{
    uint32_t any = 0;
    for (uint32_t i = 0; i < count; i++) {
        const float *p = positions[i];
        bool inside = true;
        for (int a = 0; a < 3; a++)
            inside &= (p[a] >= min[a]) & (p[a] <= max[a]);
        numbers[i] = inside ? *bsq_positions_find(table, p) : 0;
        any |= numbers[i];
    }
    return any != 0;
}

#endif
