/* space_curve.h - numbers the cells of a cube along curves that keep neighbours close together. */
#ifndef BSQ_SPACE_CURVE_H
#define BSQ_SPACE_CURVE_H

#include <stdint.h>

/* ---- the Z-order curve: Morton keys ----
 *
 * A key interleaves the bits of three coordinates. Its highest bit triple is the octant of the
 * cube, with x in the highest bit; the next one is the octant in that octant, and so on. So the
 * first 3 n bits of a key name a cell of a grid of 2^n cells an axis. */

/* Returns the key of a cell with coordinates below 2^21. Spreads the bits of each coordinate so
 * that two zero bits follow each, those of x and y side by side. */
static inline uint64_t bsq_morton_key(const uint32_t cell[3])
{
    typedef uint64_t two __attribute__((vector_size(16)));
    two xy = {cell[0], cell[1]};
    uint64_t z = cell[2];
#define SPREAD(shift, mask)                                                                        \
    xy = (xy | xy << (shift)) & (mask);                                                            \
    z = (z | z << (shift)) & (mask)
    SPREAD(32, 0x001f00000000ffffu);
    SPREAD(16, 0x001f0000ff0000ffu);
    SPREAD(8, 0x100f00f00f00f00fu);
    SPREAD(4, 0x10c30c30c30c30c3u);
    SPREAD(2, 0x1249249249249249u);
#undef SPREAD
    return xy[0] << 2 | xy[1] << 1 | z;
}

/* Returns the same key for coordinates below 32, from a table. */
static inline uint32_t bsq_morton_short_key(const uint32_t cell[3])
{
#define SPREAD2(x) (x), (x) + 1
#define SPREAD4(x) SPREAD2(x), SPREAD2((x) + 8)
#define SPREAD8(x) SPREAD4(x), SPREAD4((x) + 64)
    static const uint16_t spread[32] = {SPREAD8(0), SPREAD8(512), SPREAD8(4096), SPREAD8(4608)};
#undef SPREAD2
#undef SPREAD4
#undef SPREAD8
    return (uint32_t)spread[cell[0]] << 2 | (uint32_t)spread[cell[1]] << 1 | spread[cell[2]];
}

/* ---- Hilbert's curve ---- */

/* Returns the place on Hilbert's curve of a cell with coordinates below 2^bits; bits <= 21. Any two
 * cells that follow each other on the curve share a face. */
uint64_t bsq_hilbert_place(const uint32_t cell[3], unsigned bits);

#endif
