/* smooth_normals.h - vertex normals for scans that have none, and groups of a chunk's items. */
#ifndef VOX_VOXELIZE_CACHE_SMOOTH_NORMALS_H
#define VOX_VOXELIZE_CACHE_SMOOTH_NORMALS_H

#include "base/geometry/smooth_normals.h"
#include "libvoxel/voxelize/plan/plan.h"

/* ---- groups ----
 *
 * Triangles of a chunk follow each other in space, and vertices are numbered in the order in which
 * triangles use them, so groups of either have small bounds. Code that needs only part of a chunk
 * skips the other groups. */

enum { VOX_GROUP_TRIANGLES = 64, VOX_GROUP_VERTICES = 64 };

static inline uint32_t vox_group_count(uint32_t count, uint32_t group)
{
    return (count + group - 1) / group;
}

/* Returns the index of the first item of the next group, for a group that starts at `begin` out of
 * `count` items. */
static inline uint32_t vox_group_end(uint32_t begin, uint32_t count, uint32_t group)
{
    return count - begin < group ? count : begin + group;
}

/* ---- smooth normals ---- */

struct vox_smooth;

/* Allocates workspaces for up to `calls` >= 1 calls at a time: as many as `bytes` allow, but at
 * least one. weights: of the triangles around a vertex, not BSQ_SCAN_NORMALS_FLAT. The file must
 * outlive *out. */
int vox_smooth_create(struct bsq_ctx *ctx, const struct fmt_tris_file *file,
                      enum bsq_scan_normals weights, unsigned calls, uint64_t bytes,
                      struct vox_smooth **out);
void vox_smooth_destroy(struct vox_smooth *smooth); /* NULL is allowed */
enum bsq_scan_normals vox_smooth_weights(const struct vox_smooth *smooth);

/* A decoded chunk, and the bounds of its groups; NULL: unknown. */
struct vox_loan {
    const struct fmt_tris_chunk *chunk; /* NULL: the caller has to read it */
    const struct vox_box *triangle_groups, *vertex_groups;
};

/* Source of decoded chunks. lend: sets *out; a negative status ends the work. take_back: returns a
 * chunk that was lent. */
struct vox_smooth_lender {
    void *arg;
    int (*lend)(void *arg, uint32_t index, struct vox_loan *out);
    void (*take_back)(void *arg, uint32_t index);
};

/* A chunk that needs normals. */
struct vox_smooth_chunk {
    uint32_t index;
    struct vox_loan decoded;
    /* Creases are looked for at corners of triangles that extend farther than this along an axis,
     * in the scan's units; below 0, at all. INFINITY: no normal stands for the triangles at a
     * crease, and only weights decide what is one. */
    float crease_extent;
};

/* Computes smooth normals of a chunk's vertices as if the scan were whole: vertices at the same
 * position are one, whichever chunk they are in. normals: one entry for each vertex: a unit normal,
 * or zero if no normal stands for its triangles, and a height in voxels: how far above the vertex,
 * along its normal, the surface lies that the interpolated normals describe. points: one for each
 * vertex; the fourth number gets the same for the second side of a crease
 * (base/geometry/smooth_normals.h), packed, and is 0 elsewhere. *has_seconds: whether there are
 * any; else `points` is unchanged. Sums run in the order of triangles in the file, so results do
 * not depend on the order of calls. Thread-safe; waits while no workspace is free. */
int vox_smooth_normals(struct vox_smooth *smooth, const struct vox_smooth_lender *lender,
                       const struct vox_smooth_chunk *chunk, const struct vox_transform *transform,
                       float (*normals)[4], double (*points)[4], bool *has_seconds);

/* Packs the normal and height of a second side into a number from 0 up to 2^-8; 0 for none. A point
 * in index space has place for it, and floors to 0 there. Normals are packed as in a chunk file,
 * heights are cut to 12 significant bits. */
double vox_second_pack(const float second[4]);
void vox_second_unpack(double packed, float second[4]);

/* ---- private to the cache: one-rings, for each instruction set ---- */

/* Parts and rows of the sums, see base/geometry/smooth_normals.h. */
enum { VOX_RING_PARTS = BSQ_RING_MOMENT, VOX_RING_ROWS = 2 };

/* bsq_add_one_rings() of a chunk's triangles. */
typedef void vox_add_one_rings_fn(const struct fmt_tris_chunk *chunk, uint32_t begin, uint32_t end,
                                  const uint32_t *ring_of, enum bsq_scan_normals weights,
                                  double (*rings)[4]);
BSQ_SIMD_DECLARE(vox_add_one_rings_fn, vox_add_one_rings);

/* Creases, as base/geometry/smooth_normals.h describes them. */
struct vox_creases {
    uint32_t *crease_of; /* by one-ring */
    double (*creases)[4];
    double (*seconds)[4]; /* one-rings of second sides */
};

/* bsq_find_farthest(), or with `sides` bsq_add_sides(), of a chunk's triangles. */
typedef void vox_divide_one_rings_fn(const struct fmt_tris_chunk *chunk, uint32_t begin,
                                     uint32_t end, const uint32_t *ring_of, bool sides,
                                     double (*rings)[4], const struct vox_creases *creases);
BSQ_SIMD_DECLARE(vox_divide_one_rings_fn, vox_divide_one_rings);

/* Sets the normals of `count` vertices from their one-rings, see vox_smooth_normals(). h: edge of a
 * voxel. */
typedef void vox_finish_one_rings_fn(const double (*rings)[4], const uint32_t *ring_of,
                                     uint32_t count, double h, float (*normals)[4]);
BSQ_SIMD_DECLARE(vox_finish_one_rings_fn, vox_finish_one_rings);

#endif
