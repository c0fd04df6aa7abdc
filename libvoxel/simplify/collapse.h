/* collapse.h - edge collapse of a mesh in memory, for the last phase.
 *
 * An edge collapses into one vertex, at the place where the volume between the triangles before and
 * after is least, under the constraint that the enclosed volume stays (Lindstrom and Turk, "Fast
 * and Memory Efficient Polygonal Simplification", 1998). Of the scan, only the way is remembered
 * that the surface has gone from it; where that is long, edges collapse later. Vertices of open
 * borders move along their border only. */
#ifndef VOX_COLLAPSE_H
#define VOX_COLLAPSE_H

#include "libvoxel/simplify/mesh.h"

/* Collapses edges of a welded mesh, cheapest first, until `target` triangles are left or no edge
 * can collapse. Then compacts the mesh. Counts triangles as progress of the context. The result
 * depends on the mesh and the target alone. Errors: BSQ_ENOMEM, BSQ_EINTR. */
int vox_collapse(struct bsq_ctx *ctx, uint32_t target, struct vox_mesh *mesh);

#endif
