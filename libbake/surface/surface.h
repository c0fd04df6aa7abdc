/* surface.h - the surface that rays are traced against. Takes a scan file, either a voxel grid or
 * the triangles of a chunk file; gives hits of rays. The caller need not know which of the two it
 * is, nor that a surface may consist of several scans. Maps are traced tile by tile: on a grid by
 * bake_trace_grid_tiles(), which gives the rays to a device, and on triangles by
 * bake_exact_trace_tiles(). */
#ifndef BAKE_SURFACE_SURFACE_H
#define BAKE_SURFACE_SURFACE_H

#include "libbake/device/device.h"
#include "libbake/exact/exact.h"
#include "libbake/lowpoly/lowpoly.h"
#include "libbake/maps/maps.h"

struct bake_surface {
    struct bsq_ctx *ctx;
    /* The scans, if there are several. Then there are neither triangles nor a grid here, and the
     * other members are those of all scans. */
    struct bake_surface *parts;
    uint32_t part_count;
    const char *path;          /* of the scan */
    const char **joined;       /* all paths, if several chunk files are one scan; else NULL */
    struct bake_exact *exact;  /* the triangles; NULL: the surface is a grid */
    struct fmt_nvdb_grid grid; /* open if `exact` is NULL */
    uint32_t *transfer_words;  /* grid.transfers */
    bool has_color;
    enum bsq_ids ids;                /* of several scans: BSQ_IDS_NONE unless they agree */
    double scan_min[3], scan_max[3]; /* world */
    /* Index space, where rays are: (world - translation) / unit. For triangles, unit is 1. */
    double translation[3], unit;
    /* Size of a voxel, or for triangles 1/2048 of the longest side of the scan; world units. */
    double detail;
};

/* Opens the scans of the options; the content of each file decides which kind of surface it is. The
 * surface of several scans has the index space of one of them; the order of the scans does not
 * matter. Chunk files that can be one scan (bake_exact_can_join()) are one, unless the options
 * match names. *out must not be moved. Errors: those of fmt_nvdb_open(), bake_check_grid() and
 * bake_exact_open(); BSQ_EUSAGE for options that do not apply to this kind of surface. */
int bake_surface_open(struct bsq_ctx *ctx, const struct bake_options *options,
                      struct bake_surface *out);
void bake_surface_close(struct bake_surface *surface); /* a zeroed surface is allowed */

/* Checks the file of a grid: returns BSQ_EIO if it has been truncated or written to since it was
 * opened, so that hits cannot be trusted. Thread-safe. */
int bake_surface_check(const struct bake_surface *surface);
/* Returns what an open scan can give. */
struct bake_scan_facts bake_surface_facts(const struct bake_surface *surface);
/* Returns the cause of a job's status: that of bake_surface_check() if it fails, else `status`. For
 * the end of a job, see bsq_map_explain(). */
int bake_surface_explain(const struct bake_surface *surface, int status);

/* Makes later hits carry colours, if the scan has any. Call it at most once, not from parallel
 * work. Errors: those of bake_exact_use_color(). */
int bake_surface_use_color(struct bake_surface *surface);

/* Calls fn for the name of each channel that an open scan, or each of several, has, but not for
 * that of its normal map. Warns of channels that only some of several scans have. A status below 0
 * ends the list and is returned. Errors: BSQ_ENOMEM; BSQ_EDATA in a strict job. */
int bake_surface_list_channels(const struct bake_surface *surface,
                               int (*fn)(void *arg, const char *name), void *arg);

/* Makes later hits of maps carry the channels of transfer maps, if there are any. The options must
 * live until bake_surface_close(). Call it at most once, not from parallel work. Errors: those of
 * bake_exact_use_transfers(); BSQ_EDATA for a grid without a channel; BSQ_EUSAGE for a texture of
 * several scans. */
int bake_surface_use_transfers(struct bake_surface *surface, const struct bake_options *options);

/* Makes later hits have normals with the scan's normal map: the image of the options, or those that
 * chunk files keep. Call it at most once, not from parallel work. Errors: those of
 * bake_exact_use_normal_map(); BSQ_EUSAGE for an image and a grid, or several scans. */
int bake_surface_use_normal_map(struct bake_surface *surface, const struct bake_options *options);

/* Makes later hits carry ids, if `use` is set and the scan has any; otherwise devices do not get
 * the channel. Call it at most once, not from parallel work. Errors: BSQ_ENOMEM. */
int bake_surface_use_ids(struct bake_surface *surface, bool use);
/* Lists the names that the ids of all scans stand for: sorted, each once, allocated with malloc().
 * Adds to the report's ids, which the caller frees also after a failure. Errors: BSQ_ENOMEM,
 * BSQ_EIO. */
int bake_surface_report_ids(const struct bake_surface *surface, struct bake_report *report);

struct bake_surface_rays {
    const struct bake_exact_ray *rays; /* index space */
    struct bake_exact_hit *hits;       /* out; `count` entries; a grid's hits have triangle 0 */
    uint64_t count;
    double t_min, t_max; /* world units, as the hits' t */
    const float *starts; /* distances, in world units, before which rays have no hits, at least
                            t_min; saves steps through grids. NULL: none are known */
    bool distances_only, facing_origin; /* as in struct bake_exact_batch */
    /* Of several scans, a ray hits part p if sees[part_count * object + p] is set, for the object
     * in objects[] of the ray. NULL: all rays hit all scans. */
    const uint32_t *objects;
    const bool *sees;
};
/* Traces any number of rays on all threads. params: used for grids only. Must not be called from
 * parallel work. Errors: those of bake_exact_trace(). */
int bake_surface_trace(const struct bake_surface *surface, const struct bk_params *params,
                       const struct bake_surface_rays *rays);

/* Calls visit() for each group of 16^3 blocks of 8^3 voxels of the surface's grids; bit
 * x << 8 | y << 4 | z of `mask` is set if that block is occupied. origin: of the group's lowest
 * corner, unit: the size of a voxel; both in world units. The surface must have no triangles. */
typedef void bake_surface_visit(void *arg, const double origin[3], double unit,
                                const uint64_t mask[BAKE_MASK_WORDS]);
void bake_surface_each_block(const struct bake_surface *surface, bake_surface_visit *visit,
                             void *arg);

struct bake_places;
struct bake_ray_states;

/* Traces the rays of all places against one scan, and notes in their states what it adds to other
 * scans; adds to *chunk_loads. params: maps, counts and lengths of rays. Must not be called from
 * parallel work. Errors: those of bake_exact_look_from() and bake_surface_check(). */
int bake_surface_look(const struct bake_surface *surface, const struct bk_params *params,
                      const struct bake_places *places, struct bake_ray_states *states,
                      uint64_t *chunk_loads);

/* Returns the distance above a hit at which open rays start, so that one scan does not hide itself;
 * world units. */
double bake_surface_lift(const struct bake_surface *surface);

/* Returns whether some of the surface are triangles. */
bool bake_surface_has_triangles(const struct bake_surface *surface);

/* Returns the number of rays, with their hits, that a caller should hold at a time, at least 1. */
uint64_t bake_surface_capacity(const struct bake_surface *surface);

/* ---- ray lengths ---- */

/* Chooses ray lengths in world units, along the low-poly mesh's normals (front) and against them
 * (back):
 *   1. Casts 16384 rays from points spread evenly over the low-poly mesh, both ways along its
 *      normals, up to a tenth of the diagonal of the scan's bounds.
 *   2. Takes the 99.9th percentile of the distances of the hits on either side.
 *   3. Returns one and a half times that percentile plus two details (struct bake_surface).
 * sees: as in struct bake_surface_rays, for mesh->object_of, or NULL.
 * If fewer than one ray in a hundred hits, both are a twentieth of the diagonal. Deterministic.
 * Errors: BSQ_ENOMEM, and those of bake_surface_trace(). */
int bake_measure_distances(const struct bake_surface *surface, const struct bk_params *params,
                           const struct bake_lowmesh *mesh, const bool *sees, double *front,
                           double *back);

/* ---- maps ---- */

struct bake_grid_tiles {
    struct bake_tiles tiles;
    struct bake_device *device;
    const struct bake_surface *surface; /* that the device traces; checked after every tile */
    const struct bake_plan *plan;       /* NULL: the device holds the grid */
};

/* Traces and resolves all tiles of a map into its image. Adds to the report what
 * bake_tile_workers_end() adds. Errors: those of the device, bake_surface_check() and
 * bake_image_write(). */
int bake_trace_grid_tiles(struct bsq_ctx *ctx, const struct bake_grid_tiles *grid,
                          struct bake_report *report);

#endif
