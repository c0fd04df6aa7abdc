/* ray_patches.h - what the files that trace a map's samples as batches of rays share; private to
 * them. */
#ifndef BAKE_SURFACE_RAY_PATCHES_H
#define BAKE_SURFACE_RAY_PATCHES_H

#include "base/simd/simd.h"
#include "libbake/surface/surface.h"

struct patch {
    uint32_t index; /* number of the patch in the raster */
    /* In a sweep the first and the last chunk that the rays may cross, of those that they have not
     * met. Otherwise the place on the curve, and 0. */
    uint32_t first, last;
    float low[3], high[3]; /* what the rays cross, in the index space */
};

struct tracing {
    struct bsq_ctx *ctx;
    enum bsq_simd simd;
    const struct bake_surface *surface;
    const struct bake_patches *patches;
    const uint32_t *object_of;         /* of each triangle; NULL: not needed */
    double units_a_length;             /* of the surface, a world unit: 1 for triangles alone */
    struct bake_patch_workers workers; /* with sums for a row of squares, see square_side() */
    struct patch *order;
    uint32_t patch_count;
    struct bake_exact_sweep *sweep;         /* NULL: each batch meets all chunks */
    struct bake_footprint *footprint_table; /* of each triangle; NULL: not needed */
    /* The current batch: the patches in the first `taken` seats. Each has space for seat_rays. */
    uint32_t seat_count, taken;
    uint32_t next;            /* order[next] is the first patch that had no seat yet */
    uint32_t waiting;         /* seats from the first on whose patches an earlier batch has begun */
    struct patch *seated;     /* of each seat */
    uint32_t (*exchanges)[2]; /* pairs of seats */
    uint64_t seat_rays;
    struct bake_ray *rays;
    struct bake_hit *hits;
    struct bake_hit *next_hits; /* beside these hits, for `confidence`; else NULL */
    float *reaches;
    uint32_t *footprints, *objects;
    float *channels; /* of each hit: values of transfer maps; NULL: there are none */
    /* For maps of secondary rays; else NULL. */
    struct bake_look *look;
    struct bk_share *shares;
    struct bk_surroundings *surroundings;
};

/* Returns the side in texels of the squares by which the samples of a patch are numbered. Rays of a
 * square meet fewer triangles of the scan than those of a line. */
static inline uint32_t square_side(const struct tracing *tracing)
{
    const uint32_t n = tracing->patches->params->samples;
    return (3 + n) / n;
}

/* Returns the next multiple of a bundle's rays. Each square begins a bundle. */
static inline uint64_t next_bundle(uint64_t ray)
{
    return (ray + BAKE_RAY_BUNDLE - 1) / BAKE_RAY_BUNDLE * BAKE_RAY_BUNDLE;
}

/* Returns the number of values that transfer maps have of a hit. */
static inline uint64_t transfer_floats(const struct tracing *tracing)
{
    return (uint64_t)BK_TRANSFER_VALUES * bk_transfers(tracing->patches->params->maps);
}

/* What a worker does with a patch; `arg` is a struct tracing. */
typedef int bake_patch_step_fn(void *arg, uint64_t index, unsigned worker);

/* Sets low and high of order[index] to the ways of its rays, up to rounding. */
BSQ_SIMD_DECLARE(bake_patch_step_fn, bake_bound_patch);
/* Writes the rays of the patch in a seat, number `index` of those that do not wait. The rest have
 * no direction. */
BSQ_SIMD_DECLARE(bake_patch_step_fn, bake_cast_patch);
/* Sums and resolves such a patch, and writes it to the image. */
BSQ_SIMD_DECLARE(bake_patch_step_fn, bake_resolve_patch);

#endif
