/* ray.h - rays, what they hit, and secondary rays in batches: what all surfaces take and give,
 * whether they are grids or triangles. */
#ifndef BAKE_RAY_RAY_H
#define BAKE_RAY_RAY_H

#include <math.h>
#include <stdbool.h>
#include <stdint.h>

#include "libbake/kernel/bk_line.h"
#include "libbake/kernel/bk_secondary.h"

/* ---- rays ---- */

struct bake_ray {
    float origin[3];    /* relative to the scan's origin */
    float direction[3]; /* unit; zero: the ray hits nothing */
};

#define BAKE_NO_HIT UINT64_MAX
struct bake_hit {
    double t;          /* signed distance along the direction */
    uint64_t triangle; /* number in the file; BAKE_NO_HIT: no hit */
    float normal[3];   /* unit, object space; of a surface that faces away: turned round */
    float color[3];    /* linear RGB */
    uint32_t id;       /* as in struct bk_map_hit; 0 without ids */
    float facet[3];    /* unit normal of the triangle, on the side that counts as its front; of a
                          grid: zero, or of a hit with a wall the normal around which rays start */
    bool reversed;     /* that side is the scan's back */
    uint8_t crowded;   /* of a grid: bk_viewpoint.crowded */
    uint32_t scan;     /* of several scans: the one that was hit */
};

/* The distance between neighbouring rays, by which textures are filtered: the steps of the rays'
 * origins along the rows and along the columns of the map. */
struct bake_footprint {
    float step[2][3];
};

/* Rays of a batch with numbers from a multiple of this on are traced together. They should be
 * neighbours; rays without a direction may fill the rest. */
enum { BAKE_RAY_BUNDLE = 16 };

struct bake_ray_batch {
    const struct bake_ray *rays;
    const uint32_t *objects; /* of each ray, by which it sees some scans only; NULL: it sees all */
    struct bake_hit *hits;   /* out */
    uint64_t count;          /* of rays and hits; below 2^32 */
    double t_min, t_max;     /* range of the hits' t */
    const float *reaches;    /* of each ray, see bk_ray_cost(); NULL: 0 */
    bool from_reach;         /* hits with a larger t than the reach do not count */
    double gap;              /* hits nearer to t = 0 do not count */
    bool best;               /* blends on grids also if the options ask for the nearest voxel */
    bool distances_only;     /* do not evaluate normals and colours */
    bool sampled;            /* rays meet samples of chunks, coarse surfaces, if there are any */
    /* Surfaces must face the ray's origin, as for a camera. Otherwise they must face its end, as
     * for rays along the low-poly mesh's normals. */
    bool facing_origin;
    /* For each ray the index of its footprint in the table. NULL: textures are not filtered. */
    const uint32_t *footprints;
    const struct bake_footprint *footprint_table;
    /* Out: the channels of each hit, three values for each transfer; NULL: they are not wanted.
     * Undefined for rays that hit nothing. */
    float *channels;
    uint64_t progress;              /* what the whole batch adds to the context's progress */
    struct bake_exact_sweep *sweep; /* NULL: the rays meet all chunks */
    /* Of a sweep: only chunks [first_chunk, end_chunk) are met. The first `continued` rays bring
     * along their hits in other chunks. */
    uint32_t first_chunk, end_chunk;
    uint64_t continued;
};

/* ---- secondary rays ---- */

/* Gives viewpoint `index`, in the index space of what is traced; returns false if no rays start
 * there. Thread-safe. */
typedef bool bake_viewpoint_fn(const void *arg, uint64_t index, bk_viewpoint *out);

struct bake_viewpoints {
    bake_viewpoint_fn *get;
    const void *arg;
    uint64_t count;
    double unit;       /* of their index space, in world units */
    uint64_t progress; /* what all of them add to the context's progress */
};

/* What is known of the rays of `capacity` viewpoints, while one part of the surface after the other
 * is traced. A ray is hidden if any part hides it, and as long as its nearest hit is far. So the
 * order of parts does not matter. surface_look.c makes it and sums it up. */
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

/* Notes that a ray of a viewpoint met something at a distance, in world units. */
static inline void bake_note_hit(const struct bake_ray_states *states, uint64_t viewpoint,
                                 bool open, uint32_t ray, float distance)
{
    float *nearest = bake_ray_distances(states, viewpoint, open) + ray;
    if (open && states->words > 0)
        bake_hidden_rays(states, viewpoint)[ray / 64] |= UINT64_C(1) << ray % 64;
    else
        *nearest = fminf(*nearest, distance);
}

#endif
