/* probes.h - points of the low-poly mesh and rays from them to the scan; private to this folder. */
#ifndef BAKE_FIT_PROBES_H
#define BAKE_FIT_PROBES_H

#include "libbake/fit/fit.h"

/* Points of the mesh; those of a pose, and all if lengths are given and thickness is not baked.
 * These come in runs, which cross few chunks of the scan. All points are in the order of the curve
 * through the scan. */
enum { PROBES = 16384, FEW = 1024, RUN = 64 };

/* Shares of the size of the mesh or the scan, whichever is smaller: what is near, the distance that
 * all larger ones count as. */
#define NEAR 0.02
#define FAR  0.05

/* A point of the mesh. */
struct probe {
    double at[3]; /* relative to the surface's translation, world units */
    float normal[3], reach;
    uint32_t object;
    double t;       /* of the hit of its ray; INFINITY: none */
    uint64_t order; /* index on the curve through the scan, then number */
};

/* How well a pose fits. */
struct score {
    double near;     /* share of the points that have a surface near them */
    double far;      /* share of those that have none up to FAR */
    double distance; /* mean, as a share of the size */
};

/* The mesh turned, scaled or shifted. */
struct pose {
    struct bake_transform transform;
    unsigned turn;
    bool mirrored; /* along x, before the turn */
    bool other_scale, unit, shifted;
    struct score score;
};

struct fit {
    const struct bake_surface *surface;
    const struct bake_lowmesh *mesh;
    const struct bake_options *options;
    double scan_size, low_size; /* diagonals */
    bool measured;              /* lengths are chosen, by all probes */
    uint32_t count;             /* of probes, rays and hits: PROBES or FEW */
    struct probe *probes;
    struct bake_ray *rays;
    struct bake_hit *hits;
    uint32_t *objects; /* of rays; NULL: all see all scans */
    float *reaches;    /* of rays */
    float *distances;
    struct pose *poses; /* other ones in which the mesh may fit; only while they are judged */
    uint32_t pose_count;
    struct score score; /* of the mesh as it is */
};

/* Names the scan in messages. */
const char *bake_fit_scan(const struct fit *fit);

/* Spreads the probes over the triangles in equal steps of area. */
void bake_fit_spread(const struct fit *fit);

/* Writes ray number `index`, from a probe that a pose moves; NULL: as it is. */
void bake_fit_set_ray(const struct fit *fit, const struct probe *probe, const struct pose *pose,
                      uint64_t index);

/* Traces rays over a range of distances, as many at a time as memory allows. inverted: surfaces
 * must face the other way. Nothing is said of hits on a scan that has changed. Errors: those of
 * bake_surface_trace() and bake_surface_check(). */
int bake_fit_trace(const struct fit *fit, uint64_t count, double from, double to, bool inverted);

/* Scores the hits of rays from `first` on, of a mesh of this size. */
struct score bake_fit_score(const struct fit *fit, uint64_t first, uint64_t count, double size);

/* Looks for what is wrong if the mesh is not near the scan: it would fit in another pose, or inside
 * out. Warns, or fails with BSQ_EDATA. *fits: nothing was said of it. */
int bake_fit_judge(struct fit *fit, bool *fits);

#endif
