/* collapse.h - edge collapse of a mesh in memory.
 *
 * An edge collapses into one vertex, at the place where the error is least. Two measures of the
 * error are in use:
 *
 * - VOX_COLLAPSE_CARRIED: each vertex carries the quadric of all scan triangles that it stands for
 *   (Garland and Heckbert, "Surface Simplification Using Quadric Error Metrics", 1997), weighted by
 *   their area. Fast; quadrics of two meshes add up where these are joined.
 * - VOX_COLLAPSE_MEMORYLESS: the error is the volume between the triangles before and after the
 *   collapse, under the constraint that the enclosed volume stays (Lindstrom and Turk, "Fast and
 *   Memory Efficient Polygonal Simplification", 1998). About three times as slow, with a quarter
 *   less error in the end.
 *
 * Meshes stay manifold where they are: a collapse that would make an edge with three triangles, or
 * fold a triangle over, is refused. Vertices of open borders move along their border only, and
 * vertices at edges with three triangles or more stay. */
#ifndef VOX_COLLAPSE_H
#define VOX_COLLAPSE_H

#include "base/context.h"

/* v A v + 2 b v + c, with A as xx, xy, xz, yy, yz, zz. */
struct vox_quadric {
    double a[6], b[3], c;
};

/* A mesh whose vertices are welded: no two have the same position. The owner frees it with
 * vox_mesh_free(). */
struct vox_mesh {
    uint32_t vertex_count, triangle_count;
    float (*positions)[3];
    uint32_t (*triangles)[3];
    struct vox_quadric *quadrics; /* of vertices; NULL: not carried */
};

enum vox_collapse_measure { VOX_COLLAPSE_CARRIED, VOX_COLLAPSE_MEMORYLESS };

struct vox_collapse_options {
    uint32_t target; /* stop at that many triangles */
    enum vox_collapse_measure measure;
    bool lock_borders; /* vertices at edges with one triangle stay */
    bool progress;     /* count collapsed triangles as progress of the context */
};

/* Allocates arrays for a mesh in *mesh. Errors: BSQ_ENOMEM; then *mesh is empty. */
int vox_mesh_allocate(struct bsq_ctx *ctx, uint32_t vertices, uint32_t triangles, bool quadrics,
                      struct vox_mesh *mesh);
void vox_mesh_free(struct bsq_ctx *ctx, struct vox_mesh *mesh);

/* Welds vertices of equal positions and adds up their quadrics; leaves out triangles with two equal
 * corners, and all but one of triangles with the same three corners. Errors: BSQ_ENOMEM. */
int vox_mesh_weld(struct bsq_ctx *ctx, struct vox_mesh *mesh);

/* Sets the quadric of each vertex to the sum over its triangles. */
void vox_mesh_set_quadrics(struct vox_mesh *mesh);

/* Collapses edges of a welded mesh, cheapest first, until the target is reached or no edge can
 * collapse. Then compacts the mesh. The result depends on the mesh and the options alone. Uses
 * vox_collapse_bytes() of memory. Errors: BSQ_ENOMEM, BSQ_EINTR. */
int vox_collapse(struct bsq_ctx *ctx, const struct vox_collapse_options *options,
                 struct vox_mesh *mesh);

/* Returns the bytes that a mesh and its collapse take at most. */
uint64_t vox_collapse_bytes(uint64_t vertices, uint64_t triangles, bool quadrics);

#endif
