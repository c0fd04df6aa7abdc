/* surface.h - what rays are cast against: a voxel grid, or the scan's own triangles. */
#ifndef BAKE_SURFACE_SURFACE_H
#define BAKE_SURFACE_SURFACE_H

#include "libbake/device/device.h"
#include "libbake/exact/exact.h"
#include "libbake/lowpoly/lowpoly.h"

struct bake_surface {
    struct bsq_ctx *ctx;
    struct bake_exact *exact;  /* NULL: a grid */
    struct fmt_nvdb_grid grid; /* open where exact is NULL */
    bool has_color;            /* the scan has */
    double scan_min[3], scan_max[3];
    /* Rays are in index space: (world - translation) / unit; voxels, or the scan's own units. */
    double translation[3], unit;
    double
        detail; /* in world units: a voxel, or where there are none, one of 2048 along the scan */
};

/* Opens the scan by what the file holds. options: of the whole job. *out must stay where it is.
 * Errors: those of fmt_nvdb_open(), bake_check_grid() and bake_exact_open(); BSQ_EUSAGE for options
 * that the kind of file does not know. */
int bake_surface_open(struct bsq_ctx *ctx, const struct bake_options *options,
                      struct bake_surface *out);
void bake_surface_close(struct bake_surface *surface); /* a zeroed one is allowed */

/* BSQ_EIO where the file of a grid has shrunk or was written to since it was opened, so that what
 * was traced cannot be relied on. Thread-safe. */
int bake_surface_check(const struct bake_surface *surface);

/* Hits have colours from now on, if the scan has. Once at most; not from parallel work. */
int bake_surface_use_color(struct bake_surface *surface);

/* Traces rays on all threads, in any number. Limits and the hits' t are in world units; hits of a
 * grid have triangle 0. params are for grids. Not from parallel work. */
struct bake_surface_rays {
    const struct bake_exact_ray *rays; /* index space */
    struct bake_exact_hit *hits;
    uint64_t count;
    double t_min, t_max;
    bool distances_only, against; /* as in struct bake_exact_batch */
};
int bake_surface_trace(const struct bake_surface *surface, const struct bk_params *params,
                       const struct bake_surface_rays *rays);

/* Number of rays that can comfortably be held at a time. */
uint64_t bake_surface_capacity(const struct bake_surface *surface);

/* ---- ray lengths ---- */

/* Chooses ray lengths in world units, along the low-poly mesh's normals (front) and against them
 * (back):
 *   1. Casts 16384 rays from points spread evenly over the low-poly mesh, both ways along its
 *      normals, up to a tenth of the diagonal of the scan's bounds.
 *   2. Takes the 99.9th percentile of the distances of the hits on either side.
 *   3. Returns one and a half times that percentile plus two details (struct bake_surface).
 * If fewer than one ray in a hundred hits, both are a twentieth of the diagonal. Deterministic.
 * Errors: BSQ_ENOMEM, and those of bake_surface_trace(). */
int bake_measure_distances(const struct bake_surface *surface, const struct bk_params *params,
                           const struct bake_lowmesh *mesh, double *front, double *back);

#endif
