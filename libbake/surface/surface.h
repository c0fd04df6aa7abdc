/* surface.h - the surface that rays are traced against. Takes the scans of a bake, voxel grids or
 * triangles of chunk files; gives hits of rays, and traced maps. The caller need not know of what
 * kind the scans are, nor how many there are. */
#ifndef BAKE_SURFACE_SURFACE_H
#define BAKE_SURFACE_SURFACE_H

#include "libbake/device/device.h"
#include "libbake/exact/exact.h"
#include "libbake/lowpoly/lowpoly.h"
#include "libbake/maps/maps.h"
#include "libbake/ray/ray.h"

/* One scan. */
struct bake_scan {
    struct bsq_ctx *ctx;
    const char *path;
    struct bake_exact *exact;  /* the triangles; NULL: the scan is a grid */
    struct fmt_nvdb_grid grid; /* open if `exact` is NULL */
    uint32_t *transfer_words;  /* grid.transfers */
    char *const *channels;     /* names of further channels */
    char **own_channels;       /* their memory if the scan is a grid */
    uint32_t channel_count;
    bool has_color;
    enum fmt_ids ids;
    double scan_min[3], scan_max[3]; /* world */
    /* Index space, where rays are: (world - translation) / unit. For triangles, unit is 1. */
    double translation[3], unit;
    /* Size of a voxel, or for triangles 1/2048 of the longest side of the scan; world units. */
    double detail;
    struct bk_params params; /* of rays in its index space */
};

/* All scans of a bake. */
struct bake_surface {
    struct bsq_ctx *ctx;
    struct bake_scan *scans;
    uint32_t scan_count;
    bool grids, triangles;           /* there are such scans */
    bool has_color;                  /* all scans have */
    enum fmt_ids ids;                /* FMT_IDS_NONE unless all scans agree */
    double scan_min[3], scan_max[3]; /* world */
    double translation[3], unit;     /* of the index space in which rays are given */
    double detail;                   /* the coarsest */
    struct bk_params params;         /* of rays in its index space */
    double front, back;              /* ray lengths of maps, world units */
    /* Objects of the low-poly mesh, and the rays from them, see scan s if sees[scan_count * object
     * + s] is set. NULL: all see all. The caller's. */
    const bool *sees;
};

/* Returns whether ray `index` sees a scan. objects: of each ray; NULL: all rays see all scans. */
static inline bool bake_surface_sees(const struct bake_surface *surface, const uint32_t *objects,
                                     uint64_t index, uint32_t scan)
{
    return !objects || surface->sees[(uint64_t)surface->scan_count * objects[index] + scan];
}

/* Opens the scans of the options; the content of each file decides of which kind it is. The
 * surface's index space does not depend on the order of the scans. Several scans are traced on the
 * processor. *out must not be moved while it is open. Errors: those of fmt_nvdb_open(),
 * bake_check_grid() and bake_exact_open(); BSQ_EUSAGE for options that do not apply to these scans.
 */
int bake_surface_open(struct bsq_ctx *ctx, const struct bake_options *options,
                      struct bake_surface *out);
void bake_surface_close(struct bake_surface *surface); /* a zeroed surface is allowed */

/* Sets the parameters of rays for a selection of maps, but not the lengths of the first rays. */
void bake_surface_set_params(struct bake_surface *surface, const struct bake_options *options,
                             uint32_t maps);
/* Sets the lengths of the first rays, in world units. */
void bake_surface_set_lengths(struct bake_surface *surface, double front, double back);

/* Returns how many chunks of the scans were loaded so far, counted again each time. */
uint64_t bake_surface_loads(const struct bake_surface *surface);

/* Checks the files of grids: returns BSQ_EIO if one has been truncated or written to since it was
 * opened, so that hits cannot be trusted. Thread-safe. */
int bake_surface_check(const struct bake_surface *surface);
/* Returns the cause of a job's status: that of bake_surface_check() if it fails, else `status`. For
 * the end of a job, see bsq_map_explain(). */
int bake_surface_explain(const struct bake_surface *surface, int status);

/* Calls fn for the name of each channel that all scans have, but not for that of a normal map.
 * Warns of channels that only some of several scans have. A status below 0 ends the list and is
 * returned. Errors: BSQ_ENOMEM; BSQ_EDATA in a strict job. */
int bake_surface_list_channels(const struct bake_surface *surface,
                               int (*fn)(void *arg, const char *name), void *arg);

/* Makes later hits carry what maps need: colours and ids if `maps` has their bits and the scans
 * have any, the channels of transfer maps, and normals with the scan's normal map, which is the
 * image of the options or that of chunk files. Devices do not get what is not needed. The options
 * must live until bake_surface_close(). Call it at most once, not from parallel work. Errors: those
 * of bake_exact_use(); BSQ_EDATA for a grid without a channel; BSQ_EUSAGE for an image and a grid,
 * or several scans. */
int bake_surface_use(struct bake_surface *surface, const struct bake_options *options,
                     uint32_t maps);
/* Lists the names that the ids of all scans stand for: sorted, each once, allocated with malloc().
 * Adds to the report's ids, which the caller frees also after a failure. Errors: BSQ_ENOMEM,
 * BSQ_EIO. */
int bake_surface_report_ids(const struct bake_surface *surface, struct bake_report *report);

/* ---- rays ---- */

/* Traces rays on all threads, of which there should be bake_surface_capacity() at most. Rays are in
 * the surface's index space; t_min and t_max are in world units, as the hits' t. A grid's hits have
 * triangle 0. Must not be called from parallel work. Errors: those of bake_exact_trace();
 * BSQ_ENOMEM. */
int bake_surface_trace(const struct bake_surface *surface, const struct bake_ray_batch *batch);

/* Returns the number of rays, with their hits, that a caller should hold at a time, at least 1.
 * more_bytes: what else the caller allocates for each. */
uint64_t bake_surface_capacity(const struct bake_surface *surface, uint64_t more_bytes);

/* Returns the place of a point of the index space on a Hilbert curve through the scans; 33 bits.
 * Batches of rays that follow the curve cross few chunks. */
uint64_t bake_surface_curve_index(const struct bake_surface *surface, const float point[3]);

/* ---- secondary rays ---- */

/* Hits from which secondary rays start. */
struct bake_look_hits {
    const struct bake_ray *rays;   /* surface's index space */
    const struct bake_hit *hits;   /* of these rays; hits of nothing are allowed */
    const struct bk_share *shares; /* of their texels' directions */
    const uint32_t *objects;       /* as in struct bake_ray_batch */
    uint64_t count;
    uint64_t progress; /* what all of them add to the context's progress */
};

struct bake_look;
struct bk_surroundings;

/* Prepares secondary rays: takes up to half of what is left of the budget, for the state of rays
 * from at most `most` hits at a time and for the chunks of a scan of triangles. Free *out with
 * bake_look_free(). Errors: BSQ_ENOMEM. */
int bake_look_create(const struct bake_surface *surface, uint64_t most, struct bake_look **out);
void bake_look_free(struct bake_look *look); /* NULL is allowed */

/* Traces secondary rays as bk_secondary.h describes through all scans that the objects see, and
 * writes what they found, with lengths in the surface's index space, to out[], an entry for each
 * hit. Results depend on neither memory nor threads nor the order of scans. Must not be called from
 * parallel work. Errors: those of bake_exact_look_from() and bake_surface_check(). */
int bake_look_around(struct bake_look *look, const struct bake_look_hits *hits,
                     struct bk_surroundings *out);

/* ---- maps ---- */

/* Trace and resolve all patches of a map into its image: on a device, of the only scan, a grid; or
 * in batches of rays, on the processor. patches->triangles are in the surface's index space,
 * patches->params are the surface's. object_of: of each triangle; NULL unless surface->sees is set.
 * Add to the report what bake_patch_workers_end() adds. Errors: those of the device,
 * bake_surface_trace() and bake_image_write(). */
int bake_trace_grid_patches(const struct bake_surface *surface, struct bake_device *device,
                            const struct bake_patches *patches, struct bake_report *report);
int bake_trace_ray_patches(const struct bake_surface *surface, const struct bake_patches *patches,
                           const uint32_t *object_of, struct bake_report *report);

#endif
