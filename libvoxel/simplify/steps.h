/* steps.h - the steps of simplifying a scan, in their order. */
#ifndef VOX_SIMPLIFY_STEPS_H
#define VOX_SIMPLIFY_STEPS_H

#include "formats/chunks/tris.h"
#include "libvoxel/simplify/groups.h"
#include "libvoxel/voxel.h"

/* ---- groups.c: from the chunks of a scan to a few triangles ----
 *
 * Neighbouring chunks form groups. Each group is a mesh whose edges collapse while the vertices of
 * its border stay, so that it still fits its neighbours. The results form groups again, whose inner
 * borders are free now, until few enough triangles are left. */

/* Makes a level of about `target` triangles, or of all triangles of the scan if it has no more.
 * Groups and results depend on the scan and the target alone, not on memory or threads. `beside`:
 * an output, for temporary files. The caller frees *level, also after failure. Errors:
 * BSQ_ENOMEM, BSQ_EIO, BSQ_EDATA, BSQ_EINTR. */
int vox_reduce_chunks(struct bsq_ctx *ctx, const struct fmt_tris_file *file, uint64_t target,
                      const char *beside, struct vox_level *level);

/* ---- cluster.c: a first reduction of meshes that are far finer than the result ----
 *
 * Vertices of a cell of a grid that are connected inside it become one vertex, where their quadrics
 * are least. Unlike clustering by cells alone (Lindstrom, "Out-of-Core Simplification of Large
 * Polygonal Models", 2000), this keeps the topology: clusters that would change it, or fold the
 * surface, stay as they are. */

/* Joins vertices of a welded mesh with quadrics, to about `share` of them, and compacts the mesh.
 * Vertices stay at open borders and at edges with more than two triangles. The
 * result depends on the mesh and the share alone. Errors: BSQ_ENOMEM, BSQ_EINTR. */
int vox_cluster(struct bsq_ctx *ctx, double share, struct vox_mesh *mesh);

/* ---- thin.c: fast edge collapse, far from the result ----
 *
 * Each vertex carries the quadric of all scan triangles that it stands for (Garland and Heckbert,
 * "Surface Simplification Using Quadric Error Metrics", 1997), weighted by their area. There is no
 * heap: passes over all vertices collapse what is cheaper than a threshold, which grows. */

/* Collapses edges of a welded mesh with quadrics until it has at most `target` triangles, or until
 * little more can collapse. Vertices of open borders stay. Then compacts the mesh. The result
 * depends on the mesh and the target alone. Errors: BSQ_ENOMEM, BSQ_EINTR. */
int vox_thin(struct bsq_ctx *ctx, uint32_t target, struct vox_mesh *mesh);

/* ---- collapse.c: edge collapse of a mesh in memory, for the last phase ----
 *
 * An edge collapses into one vertex, at the place where the volume between the triangles before and
 * after is least, under the constraint that the enclosed volume stays (Lindstrom and Turk, "Fast
 * and Memory Efficient Polygonal Simplification", 1998). Of the scan, only the way is remembered
 * that the surface has gone from it; where that is long, edges collapse later. Vertices of open
 * borders move along their border only. At last all vertices move to where they fit the mesh
 * before the collapses best, see fit.h. */

struct vox_limits; /* limits.h */

/* What the last phase took away, beside edges. */
struct vox_removed {
    uint64_t pieces, triangles; /* pieces that were small, and their triangles when they went */
    uint64_t handles;           /* cut through: also tunnels, and necks between two parts */
    double cost;                /* of the last edge */
};

/* Collapses edges of a welded mesh, cheapest first, until `target` triangles are left or no edge
 * can collapse. Small pieces and narrow handles go when that costs no more; *removed counts them.
 * Then fits and compacts the mesh. limits: NULL, or of a mesh that this one is a copy of; they hold
 * for each step, and then pieces and handles stay and no folds are made. locked: NULL, or of
 * vertices: 1 for those that stay, and their pieces with them. Counts triangles as progress of the
 * context. The result depends on the mesh, the target, the limits and what is locked alone. Errors:
 * BSQ_ENOMEM, BSQ_EINTR. */
int vox_collapse(struct bsq_ctx *ctx, uint32_t target, struct vox_limits *limits,
                 const uint8_t *locked, struct vox_mesh *mesh, struct vox_removed *removed);

/* ---- regions.c: the last phase of meshes that do not fit in memory ---- */

/* Replaces a level by one of `target` triangles, or a few less. Collapses edges region by region,
 * each of about `limit` triangles, in three passes with borders at other places, so that none stay.
 * Regions and results depend on the arguments alone. *removed receives the sums.
 * Errors: BSQ_ENOMEM, BSQ_EIO, BSQ_ECANTCREAT, BSQ_EDATA, BSQ_EINTR. */
int vox_collapse_regions(struct vox_level *level, uint64_t target, uint64_t limit,
                         struct vox_removed *removed);

/* ---- measure.c: how far a low-poly mesh is from its scan, both ways ---- */

/* Triangles of a mesh that the scan is too far from, or that are too far from it. */
struct vox_marks {
    double limit;
    _Atomic uint8_t *triangles; /* of the mesh: receive 1, or stay as they are */
};

/* Measures the distance of each point of the scan from the closest point of the mesh, and of the
 * mesh from the scan. Maxima are bounds, means are by area. Reads the scan twice, chunk by chunk,
 * and then the chunks around triangles that are still open. marks: NULL, or triangles are marked
 * where a bound is above the limit, and maxima mean nothing: if none is, no point is farther. Also
 * sets the distances of boxes. at_once: a mesh of more than twice as many triangles is measured
 * region by region without marks; distances above 16 times the mean edge may be larger then.
 * Errors: BSQ_ENOMEM, BSQ_EIO, BSQ_EDATA, BSQ_EINTR. */
int vox_measure(struct bsq_ctx *ctx, const struct fmt_tris_file *file, const struct vox_mesh *mesh,
                struct vox_marks *marks, struct vox_measured_box *boxes, uint32_t box_count,
                uint32_t at_once, struct vox_distances *scan_to_mesh,
                struct vox_distances *mesh_to_scan);

#endif
