/* positions.h - a table that finds vertices by their exact position.
 *
 * Scans repeat vertices, at seams of texture space and in every chunk that touches them. Smooth
 * normals that do not depend on the chunks (smooth_normals.h) need to know which vertices are the
 * same. */
#ifndef BSQ_POSITIONS_H
#define BSQ_POSITIONS_H

#include <stdbool.h>
#include <stdint.h>
#include <string.h>

/* A hash table with open addressing. More positions may follow those that are in the table. */
struct bsq_positions {
    uint32_t *slots; /* number of a position + 1; 0: free */
    uint32_t mask;   /* number of slots - 1 */
    const float (*positions)[3];
};

/* Returns the number of slots for that number of positions. At most a quarter of them are in use:
 * most positions that are looked up are not in the table, and each slot in use that they meet costs
 * a look at its position. */
static inline uint32_t bsq_positions_slots(uint32_t positions)
{
    uint32_t slots = 16;
    while (slots / 4 < positions)
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

/* Returns the slot of a position with this hash, or the free slot for it. */
static inline uint32_t *bsq_positions_find_hashed(const struct bsq_positions *table,
                                                  const float p[3], uint32_t hash)
{
    uint32_t at = hash & table->mask;
    for (; table->slots[at] != 0; at = (at + 1) & table->mask) {
        const float *q = table->positions[table->slots[at] - 1];
        if ((q[0] == p[0]) & (q[1] == p[1]) & (q[2] == p[2]))
            break;
    }
    return &table->slots[at];
}

static inline uint32_t *bsq_positions_find(const struct bsq_positions *table, const float p[3])
{
    return bsq_positions_find_hashed(table, p, bsq_position_hash(p));
}

/* Positions that are looked up together, so that the table's slots are prefetched. */
enum { BSQ_POSITIONS_BATCH = 64 };

typedef float bsq_four_floats __attribute__((vector_size(16)));
typedef int32_t bsq_four_masks __attribute__((vector_size(16)));

/* Writes the indices of those positions of a batch that lie inside the bounds. Returns their
 * number. Four positions at a time are three vectors. */
static inline uint32_t bsq_positions_inside(const float min[3], const float max[3],
                                            const float (*positions)[3], uint32_t count,
                                            uint32_t inside[BSQ_POSITIONS_BATCH])
{
    const bsq_four_floats low[3] = {{min[0], min[1], min[2], min[0]},
                                    {min[1], min[2], min[0], min[1]},
                                    {min[2], min[0], min[1], min[2]}};
    const bsq_four_floats high[3] = {{max[0], max[1], max[2], max[0]},
                                     {max[1], max[2], max[0], max[1]},
                                     {max[2], max[0], max[1], max[2]}};
    uint32_t found = 0;
    for (uint32_t i = 0; i < count; i += 4) {
        uint32_t left = count - i < 4 ? count - i : 4;
        bsq_four_floats numbers[3] = {{0.0f}};
        int32_t within[12];
        if (left == 4)
            memcpy(numbers, positions[i], sizeof numbers);
        else
            memcpy(numbers, positions[i], left * sizeof *positions);
        for (int k = 0; k < 3; k++) {
            bsq_four_masks four = (numbers[k] >= low[k]) & (numbers[k] <= high[k]);
            memcpy(&within[4 * k], &four, sizeof four);
        }
        for (uint32_t k = 0; k < left; k++) {
            inside[found] = i + k;
            found += (uint32_t)(within[3 * k] & within[3 * k + 1] & within[3 * k + 2] & 1);
        }
    }
    return found;
}

/* Sets numbers[i] to the number of positions[i] in the table + 1, or 0. The bounds are those of the
 * positions in the table. Returns true if any was found. */
static inline bool bsq_positions_match(const struct bsq_positions *table, const float min[3],
                                       const float max[3], const float (*positions)[3],
                                       uint32_t count, uint32_t *numbers)
{
    uint32_t any = 0;
    for (uint32_t done = 0; done < count; done += BSQ_POSITIONS_BATCH) {
        uint32_t batch = count - done < BSQ_POSITIONS_BATCH ? count - done : BSQ_POSITIONS_BATCH;
        uint32_t inside[BSQ_POSITIONS_BATCH], hashes[BSQ_POSITIONS_BATCH];
        uint32_t found = bsq_positions_inside(min, max, positions + done, batch, inside);
        memset(numbers + done, 0, batch * sizeof *numbers);
        for (uint32_t i = 0; i < found; i++) {
            hashes[i] = bsq_position_hash(positions[done + inside[i]]);
            __builtin_prefetch(&table->slots[hashes[i] & table->mask]);
        }
        for (uint32_t i = 0; i < found; i++) {
            uint32_t at = done + inside[i];
            numbers[at] = *bsq_positions_find_hashed(table, positions[at], hashes[i]);
            any |= numbers[at];
        }
    }
    return any != 0;
}

#endif
