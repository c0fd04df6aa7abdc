/* morton.h - Morton (Z-order) keys of points: three coordinates of 21 bits, interleaved.
 *
 * The highest bit triple of a key is the octant of the cube, the next one the octant in it, and so
 * on; the first 3 n bits of a key name the cell of a grid of 2^n cells an axis. */
#ifndef VOX_MORTON_H
#define VOX_MORTON_H

#include <stdint.h>

#define MORTON_AXIS_BITS 21
#define MORTON_KEY_BITS  63

/* Spreads the low 21 bits so that two zero bits follow each. */
static inline uint64_t morton_spread(uint64_t x)
{
    x = (x | x << 32) & 0x001f00000000ffffu;
    x = (x | x << 16) & 0x001f0000ff0000ffu;
    x = (x | x << 8) & 0x100f00f00f00f00fu;
    x = (x | x << 4) & 0x10c30c30c30c30c3u;
    return (x | x << 2) & 0x1249249249249249u;
}

static inline uint64_t morton_key(const uint32_t cell[3])
{
    return morton_spread(cell[0]) << 2 | morton_spread(cell[1]) << 1 | morton_spread(cell[2]);
}

/* The same of coordinates below 32. */
static inline uint32_t morton_short_spread(uint32_t x)
{
    x = (x | x << 8) & 0x100fu;
    x = (x | x << 4) & 0x10c3u;
    return (x | x << 2) & 0x1249u;
}

static inline uint32_t morton_short_key(const uint32_t cell[3])
{
    return morton_short_spread(cell[0]) << 2 | morton_short_spread(cell[1]) << 1 |
           morton_short_spread(cell[2]);
}

/* A cube with 2^21 cells an axis over the bounds of a scan. */
struct morton_cube {
    double min[3];
    double scale; /* cells per unit of length; 0 where the bounds are a point */
};

/* max >= min */
static inline struct morton_cube morton_cube_over(const float min[3], const float max[3])
{
    struct morton_cube cube = {{min[0], min[1], min[2]}, 0.0};
    double side = 0.0;
    for (int axis = 0; axis < 3; axis++)
        if ((double)max[axis] - min[axis] > side)
            side = (double)max[axis] - min[axis];
    if (side > 0.0)
        cube.scale = (double)(1u << MORTON_AXIS_BITS) / side;
    return cube;
}

/* Cells of a triangle's centroid. Points outside of the cube count as on its border. */
static inline void morton_cells(const struct morton_cube *cube, const float *a, const float *b,
                                const float *c, uint32_t cell[3])
{
    const double last = (double)((1u << MORTON_AXIS_BITS) - 1);
    for (int axis = 0; axis < 3; axis++) {
        double centre = ((double)a[axis] + b[axis] + c[axis]) * (1.0 / 3.0);
        double at = (centre - cube->min[axis]) * cube->scale;
        at = at < 0.0 ? 0.0 : at;
        at = at > last ? last : at;
        cell[axis] = (uint32_t)(int32_t)at;
    }
}

#endif
