/* exact.h - rays against the scan's own triangles, out of core.
 *
 * Rays are given in batches. They are binned to the chunks that they cross; each of those chunks is
 * loaded, gets a tree of boxes and finds the nearest hit of its rays; a second pass over the chunks
 * that won hits evaluates normals and colours there. Results do not depend on chunks, threads or
 * memory: the hit with the smallest (|t|, t < 0, triangle number) wins, all three computed alike
 * whatever the order. */
#ifndef BAKE_EXACT_EXACT_H
#define BAKE_EXACT_EXACT_H

#include "base/context.h"
#include "libbake/bake.h"

struct bake_exact;

struct bake_exact_options {
    const char *path; /* chunk file */
    enum bsq_scan_normals normals;
    bool two_sided;
};

struct bake_exact_info {
    double origin[3];                /* world = origin + position */
    double scan_min[3], scan_max[3]; /* world */
    uint64_t triangle_count;
    bool has_color;
};

/* Opens the scan. Errors: as fmt_tris_open(), BSQ_ENOMEM. */
int bake_exact_open(struct bsq_ctx *ctx, const struct bake_exact_options *options,
                    struct bake_exact **out);
void bake_exact_close(struct bake_exact *exact); /* NULL is allowed */
const struct bake_exact_info *bake_exact_get_info(const struct bake_exact *exact);

/* Opens the scan's textures, if it has any, and evaluates colours from now on. Not from parallel
 * work. Errors: as fmt_textures_open(). */
int bake_exact_use_color(struct bake_exact *exact);

/* ---- rays ---- */

/* Position relative to the scan's origin; unit direction, or zero: no ray. */
struct bake_exact_ray {
    float origin[3], direction[3];
};

#define BAKE_EXACT_NONE UINT64_MAX
struct bake_exact_hit {
    double t;          /* signed distance along the direction */
    uint64_t triangle; /* number in the file; BAKE_EXACT_NONE: nothing was hit */
    float normal[3];   /* unit, object space */
    float color[3];    /* linear RGB */
};

/* How far from each other a texture's samples are: steps between neighbouring rays' origins, along
 * the map's rows and columns, in the scan's units. */
struct bake_exact_footprint {
    float step[2][3];
};

struct bake_exact_batch {
    const struct bake_exact_ray *rays;
    struct bake_exact_hit *hits; /* out */
    uint64_t count;              /* below 2^32 */
    double t_min, t_max;         /* hits lie within */
    bool distances_only;         /* no normals and colours */
    bool against; /* surfaces face the ray's origin (a camera's rays), not its end (a low mesh's) */
    /* Filters textures: entry of the table for each ray; NULL: none. */
    const uint32_t *footprints;
    const struct bake_exact_footprint *footprint_table;
    uint64_t progress; /* units to add to the context's progress in all */
};

/* Number of rays that fit a batch with what is left of the budget, from which the caller takes the
 * rays, hits and footprints themselves. At least 1. */
uint64_t bake_exact_capacity(const struct bake_exact *exact);

/* Traces a batch on all threads; not from parallel work. Errors: BSQ_EDATA for a damaged chunk,
 * BSQ_ENOMEM, BSQ_EINTR. */
int bake_exact_trace(struct bake_exact *exact, const struct bake_exact_batch *batch);

/* Whether footprints are used. */
bool bake_exact_wants_footprints(const struct bake_exact *exact);

#endif
