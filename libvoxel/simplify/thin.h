/* thin.h - fast edge collapse for meshes with many more triangles than the result will have.
 *
 * Each vertex carries the quadric of all scan triangles that it stands for (Garland and Heckbert,
 * "Surface Simplification Using Quadric Error Metrics", 1997), weighted by their area. There is no
 * heap: passes over all vertices collapse what is cheaper than a threshold, which grows. */
#ifndef VOX_THIN_H
#define VOX_THIN_H

#include "libvoxel/simplify/mesh.h"

/* Collapses edges of a welded mesh with quadrics until it has at most `target` triangles, or until
 * little more can collapse. Vertices of open borders stay. Then compacts the mesh. The result
 * depends on the mesh and the target alone. Errors: BSQ_ENOMEM, BSQ_EINTR. */
int vox_thin(struct bsq_ctx *ctx, uint32_t target, struct vox_mesh *mesh);

#endif
