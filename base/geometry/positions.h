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
    uint32_t *cells; /* number of a position + 1; 0: free */
    uint32_t mask;   /* number of cells - 1 */
    const float (*positions)[3];
};

/* Returns the number of cells for that number of positions. At most a quarter of them are in use:
 * most positions that are looked up are not in the table, and each cell in use that they meet costs
 * a look at its position. */
static inline uint32_t bsq_positions_cells(uint32_t positions)
{
    uint32_t cells = 16;
    while (cells / 4 < positions)
        cells *= 2;
    return cells;
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

/* Returns the cell of a position with this hash, or the free cell for it. */
static inline uint32_t *bsq_positions_find_hashed(const struct bsq_positions *table,
                                                  const float p[3], uint32_t hash)
{
    uint32_t at = hash & table->mask;
    for (; table->cells[at] != 0; at = (at + 1) & table->mask) {
        const float *q = table->positions[table->cells[at] - 1];
        if ((q[0] == p[0]) & (q[1] == p[1]) & (q[2] == p[2]))
            break;
    }
    return &table->cells[at];
}

static inline uint32_t *bsq_positions_find(const struct bsq_positions *table, const float p[3])
{
    return bsq_positions_find_hashed(table, p, bsq_position_hash(p));
}

#endif
