/* fit.h - moves the vertices of a mesh whose edges have collapsed nearer to what it was before.
 *
 * Lindstrom and Turk's places are best for one collapse each. Points of the old mesh, each with its
 * closest point of the new one, tell where all vertices lie best together (Hoppe, DeRose, Duchamp,
 * McDonald and Stuetzle, "Mesh Optimization", 1993). Only distances across the surface count, so
 * that vertices can slide along it (Chen and Medioni, "Object Modelling by Registration of Multiple
 * Range Images", 1992). */
#ifndef VOX_FIT_H
#define VOX_FIT_H

#include "libvoxel/simplify/limits.h"

/* What vox_fit() takes of the collapses before it. */
struct vox_fit_from {
    const float (*positions)[3]; /* of the old mesh's vertices; its triangles are in rings.mesh */
    uint32_t *into;              /* sets of vertices that are one now, for vox_find_root() */
    const float *drifts;         /* of vertices: about how far the surface there has gone */
    struct vox_limits *limits;   /* NULL, or how far it may go */
};

/* Moves vertices so that the squared distances of the old mesh become less, and that none is far
 * from it. Vertices of borders move little, locked ones not at all. Makes no folds. The result
 * depends on the meshes alone. Errors: BSQ_ENOMEM, BSQ_EINTR. */
int vox_fit(struct vox_rings *r, const struct vox_fit_from *from);

#endif
