/* distance_lanes.h - what measuring does to several points at once. */
#ifndef VOX_SIMPLIFY_DISTANCE_LANES_H
#define VOX_SIMPLIFY_DISTANCE_LANES_H

#include <string.h>

#include "base/geometry/vec.h"
#include "libvoxel/simplify/closest.h"

/* A triangle is a needle if its height above its longest side is at most a thousandth of that side.
 * This is the square of that ratio. */
static const double vox_needle_area = 1e-6;

/* Points that are looked for together, and a box around them. */
struct vox_batch {
    unsigned count;
    double points[3][VOX_CLOSEST_BATCH];
    double *squares;
    double owners[VOX_CLOSEST_BATCH]; /* numbers of the closest triangles; below 0: none yet */
    double most;                      /* the largest of squares */
    float low[3], high[3];
};

/* What the distance of a point from a triangle is made of. */
struct vox_plane {
    double corners[3][3], edges[3][3], outwards[3][3], normal[3];
    double squares[3], area;               /* of edges, and of the normal */
    double inverse_edges[3], inverse_area; /* of these; 0 for 0 */
    double safe; /* factor of bounds, for rounding; 0: a needle, whose normal is not exact */
};

/* Sets all but the inverses. */
static inline void vox_set_plane(const float *const corners[3], struct vox_plane *out)
{
    double longest = 0;
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++) {
            out->corners[i][k] = (double)corners[i][k];
            out->edges[i][k] = (double)corners[(i + 1) % 3][k] - (double)corners[i][k];
        }
    bsq_crossd(out->edges[0], out->edges[1], out->normal);
    out->area = bsq_dotd(out->normal, out->normal);
    for (int i = 0; i < 3; i++) {
        out->squares[i] = bsq_dotd(out->edges[i], out->edges[i]);
        bsq_crossd(out->edges[i], out->normal, out->outwards[i]);
        longest = out->squares[i] > longest ? out->squares[i] : longest;
    }
    out->safe = out->area > vox_needle_area * longest * longest ? 1 - 1e-9 : 0;
}

static inline void vox_set_inverses(struct vox_plane *plane)
{
    plane->inverse_area = plane->area > 0 ? 1 / plane->area : 0;
    for (int i = 0; i < 3; i++)
        plane->inverse_edges[i] = plane->squares[i] > 0 ? 1 / plane->squares[i] : 0;
}

/* Returns the squared distance of a point from the edges of a triangle. */
static inline double vox_edge_square(const struct vox_plane *plane, double px, double py, double pz)
{
    double least = INFINITY;
    for (int k = 0; k < 3; k++) {
        const double *c = plane->corners[k], *e = plane->edges[k];
        const double x = px - c[0], y = py - c[1], z = pz - c[2];
        double along = (x * e[0] + y * e[1] + z * e[2]) * plane->inverse_edges[k];
        along = along > 0 ? along : 0;
        along = along < 1 ? along : 1;
        const double dx = x - along * e[0], dy = y - along * e[1], dz = z - along * e[2];
        const double square = dx * dx + dy * dy + dz * dz;
        least = square < least ? square : least;
    }
    return least;
}

/* Lowers the squares of a batch to those of a triangle, which has this number. */
typedef void vox_try_triangle_fn(const float *const corners[3], double number, struct vox_batch *b);
BSQ_SIMD_DECLARE(vox_try_triangle_fn, vox_try_triangle);

/* A box; the fourth numbers are anything. */
typedef float vox_four __attribute__((vector_size(16)));
typedef int32_t vox_four_mask __attribute__((vector_size(16)));
struct vox_fours {
    vox_four low, high;
};

static inline void vox_grow_box(struct vox_fours *box, vox_four low, vox_four high)
{
    const vox_four_mask less = low<box->low, more = high> box->high;
    box->low = (vox_four)((less & (vox_four_mask)low) | (~less & (vox_four_mask)box->low));
    box->high = (vox_four)((more & (vox_four_mask)high) | (~more & (vox_four_mask)box->high));
}

/* Grows a box by a position of a chunk, after which four bytes can be read. */
static inline void vox_grow_by_position(struct vox_fours *box, const float position[3])
{
    vox_four at;
    memcpy(&at, position, sizeof at);
    vox_grow_box(box, at, at);
}

static const struct vox_fours vox_no_box = {{INFINITY, INFINITY, INFINITY, INFINITY},
                                            {-INFINITY, -INFINITY, -INFINITY, -INFINITY}};

enum { VOX_BLOCK_TRIANGLES = 64, VOX_BLOCK_VERTICES = 3 * VOX_BLOCK_TRIANGLES };
/* Where a vertex is, as seen from a triangle: beyond which of its edges, too high, and on which
 * side of two lines through its middle. */
enum { VOX_BEYOND_ALL = 7, VOX_TOO_HIGH = 8, VOX_ABOVE_LINE = 16, VOX_RIGHT_OF_LINE = 32 };

struct vox_cover;

/* Triangles of a chunk that follow each other, and their vertices. */
struct vox_cover_block {
    const struct vox_cover *cover;
    unsigned triangle_count, vertex_count;
    uint8_t triangles[VOX_BLOCK_TRIANGLES][3];
    double points[3][VOX_BLOCK_VERTICES];
    uint64_t hashes[2][VOX_BLOCK_VERTICES];
    struct vox_fours box;
};

/* A block as seen from a triangle. Coordinates along the first two edges' outward normals are
 * affine ones in its plane. */
struct vox_cover_view {
    double across[2][VOX_BLOCK_VERTICES], heights[VOX_BLOCK_VERTICES];
    int64_t codes[VOX_BLOCK_VERTICES];
    double middle;     /* both coordinates of the triangle's middle */
    double unit;       /* what heights are multiples of */
    double seen[3][2]; /* corners of what the triangle sees */
};

/* Sets where the vertices of a block are. A triangle sees what is inside its edges by more than a
 * margin. Returns false if it is a needle, or sees nothing. */
typedef bool vox_view_block_fn(const struct vox_cover_block *block, const float *const corners[3],
                               double height, double margin, struct vox_cover_view *view);
BSQ_SIMD_DECLARE(vox_view_block_fn, vox_view_block);

#endif
