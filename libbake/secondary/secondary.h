/* secondary.h - secondary rays, in batches: the maps ao, bent and thickness of triangles, and of
 * several scans. (The kernel sends the rays of a single grid itself.)
 *
 * Takes viewpoints on the surface, whose rays are those of bk_secondary.h, and says
 * how to keep what is known of each ray while one part of the surface after the other is traced. A
 * ray is hidden if any part hides it, and as long as its nearest hit is far. So the order of parts
 * does not matter. */
#ifndef BAKE_SECONDARY_SECONDARY_H
#define BAKE_SECONDARY_SECONDARY_H

#include <stdbool.h>

#include "base/context.h"

struct bk_viewpoint;

/* Gives viewpoint `index`, in the index space of what is traced; returns false if no rays start
 * there. Thread-safe. */
typedef bool bake_viewpoint_fn(const void *arg, uint64_t index, struct bk_viewpoint *out);

struct bake_viewpoints {
    bake_viewpoint_fn *get;
    const void *arg;
    uint64_t count;
    double unit;       /* of their index space, in world units */
    uint64_t progress; /* what all of them add to the context's progress */
};

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
