/* limits.h - how far the surface may go while edges collapse.
 *
 * Points of the old mesh belong to triangles of the new one. A change around a vertex is allowed if
 * each point of the triangles that go is within its limit of one that is made (Klein, Liebich and
 * Strasser, "Mesh Reduction with Error Control", 1996), and if these are near the old mesh where
 * they may stick out. What lies between the points is not looked at: who measures the result
 * tightens limits where that was too little, and collapses anew. */
#ifndef VOX_LIMITS_H
#define VOX_LIMITS_H

#include "libvoxel/simplify/closest.h"
#include "libvoxel/simplify/rings.h"

enum { VOX_LIMITS_MOST = 64 /* triangles that a change may make */ };

struct vox_limits {
    struct bsq_ctx *ctx;
    const struct vox_mesh *mesh; /* the old one, the caller's */
    double most;                 /* the largest limit */
    struct vox_closest tree;     /* of the old mesh */
    float *shares;               /* of points, vertices and middles of triangles: of that limit */
    uint32_t *owners;            /* of points: the triangles that they belong to */
    uint32_t *owners_then;       /* and those after the change that was asked for last */
    uint32_t *first, *next;      /* lists of each triangle's points */
    uint32_t changed[2 * VOX_LIMITS_MOST]; /* triangles that go then */
    unsigned changed_count;
};

/* Begins with equal limits. The caller calls vox_limits_free() even after a failure. Errors:
 * BSQ_ENOMEM. */
int vox_limits_begin(struct bsq_ctx *ctx, const struct vox_mesh *mesh, double most,
                     struct vox_limits *limits);
void vox_limits_free(struct vox_limits *limits);

/* Gives all points back to their own triangles, before a copy of the mesh collapses. */
void vox_limits_restart(struct vox_limits *limits);

/* Returns whether (u, v) may collapse to p; v is VOX_NONE: whether u may move there. */
bool vox_limits_allow(struct vox_limits *limits, struct vox_rings *r, uint32_t u, uint32_t v,
                      const float p[3]);

/* Hands points over, as the change that was allowed last is made. */
void vox_limits_change(struct vox_limits *limits);

/* Sets owners to the numbers that triangles get by vox_rings_compact(). */
void vox_limits_number(struct vox_limits *limits, const struct vox_rings *r);

/* Multiplies the limits of points that belong to marked triangles by `share`, and those of points
 * in triangles beside these by the mean of `share` and 1. mesh: the result of the collapses. */
void vox_limits_tighten(struct vox_limits *limits, const struct vox_mesh *mesh,
                        const _Atomic uint8_t *marks, float share);

#endif
