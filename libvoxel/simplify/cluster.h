/* cluster.h - a first reduction of meshes that are far finer than the result.
 *
 * Vertices of a cell of a grid that are connected inside it become one vertex, where their quadrics
 * are least. Unlike clustering by cells alone (Lindstrom, "Out-of-Core Simplification of Large
 * Polygonal Models", 2000), this keeps the topology: clusters that would change it, or fold the
 * surface, stay as they are. */
#ifndef VOX_CLUSTER_H
#define VOX_CLUSTER_H

#include "libvoxel/simplify/mesh.h"

/* Joins vertices of a welded mesh with quadrics, to about `share` of them, and compacts the mesh.
 * Vertices stay at open borders, at edges with more than two triangles and between materials. The
 * result depends on the mesh and the share alone. Errors: BSQ_ENOMEM, BSQ_EINTR. */
int vox_cluster(struct bsq_ctx *ctx, double share, struct vox_mesh *mesh);

#endif
