/* secondary.h - secondary rays, in batches: the maps ao, bent and thickness of triangles, and of
 * several scans. (The kernel sends the rays of a single grid itself.)
 *
 * Takes viewpoints on the surface. Gives their rays, which are those of bk_secondary.h, and says
 * how to keep what is known of each ray while one part of the surface after the other is traced. A
 * ray is hidden if any part hides it, and as long as its nearest hit is far. So the order of parts
 * does not matter. */
#ifndef BAKE_SECONDARY_SECONDARY_H
#define BAKE_SECONDARY_SECONDARY_H

#include <stdbool.h>

#include "base/context.h"
#include "libbake/kernel/bk_types.h"

/* A viewpoint on the surface, in the index space of what is traced. */
struct bake_viewpoint {
    float open_from[3];  /* where open rays start: above the surface */
    float solid_from[3]; /* where rays into the solid start: on it */
    float normal[3];     /* unit, away from the solid */
    float facet[3];      /* unit normal of the triangle, on that side; zero: there is none */
    bool reversed;       /* the scan's own normal points into the solid */
    bk_share share;      /* of its texel's directions */
};

/* Gives viewpoint `index`; returns false if no rays start there. Thread-safe. */
typedef bool bake_viewpoint_fn(const void *arg, uint64_t index, struct bake_viewpoint *out);

struct bake_viewpoints {
    bake_viewpoint_fn *get;
    const void *arg;
    uint64_t count;
    double unit;       /* of their index space, in world units */
    uint64_t progress; /* what all of them add to the context's progress */
};

/* Computes ray `number` of a viewpoint: an open one, or one into the solid. params: maps and counts
 * of rays. direction: unit. */
void bake_viewpoint_ray(const struct bk_params *params, const struct bake_viewpoint *viewpoint,
                        bool open, uint32_t number, float origin[3], float direction[3]);

/* What is known of the rays of `capacity` viewpoints. surface_look.c makes it and sums it up. */
struct bake_ray_states {
    uint32_t opens, solids;  /* rays of a viewpoint */
    uint32_t words, lengths; /* entries below for a viewpoint */
    uint64_t capacity;
    uint64_t *hidden; /* a bit for each open ray, if any hit will do */
    float *distances; /* of nearest hits, world units: open rays if they fall off, rays into the
                         solid */
};

/* Return the state of a viewpoint: its bits, and the distances of its open rays or of those into
 * the solid. */
static inline uint64_t *bake_hidden_rays(const struct bake_ray_states *states, uint64_t index)
{
    return states->hidden + index * states->words;
}
static inline float *bake_ray_distances(const struct bake_ray_states *states, uint64_t index,
                                        bool open)
{
    return states->distances + index * states->lengths +
           (open || states->words > 0 ? 0 : states->opens);
}

#endif
