/* job.h - the steps of a bake, in their order. Takes options; gives map files and a report.
 *
 * bake_run() takes all of the steps; libbake/farm takes them apart to divide a bake into
 * tasks. Steps end at the first failure. */
#ifndef BAKE_JOB_JOB_H
#define BAKE_JOB_JOB_H

#include "libbake/asset/asset.h"
#include "libbake/bake.h"
#include "libbake/curvature/curvature.h"
#include "libbake/filter/filter.h"
#include "libbake/preview/preview.h"
#include "libbake/skew/skew.h"

/* The maps of one UDIM tile. */
struct bake_tile {
    struct bake_udim_tile udim;
    const char *object, *material; /* that have maps of their own, or NULL */
    struct bake_options options;   /* the job's, with the size and output path of this tile */
    uint32_t maps;
    char *output_path;
    char *beside;        /* the path of one map; temporary files go to its directory */
    uint32_t patch_side; /* of the raster, in texels */
    bool kept;           /* its maps are there already: they are not written */
    bool in_blocks;      /* bakes `blocks` only, into an image of them */
    struct bake_blocks blocks;
    struct bake_skew_image skew;
    struct bake_raster *raster;
    struct bake_image *image;
    struct bake_map_files *files;
    struct bake_thumbnail normal, color, missed; /* `texels` is NULL if there is none */
};

/* A bake. */
struct bake_work {
    struct bsq_ctx *ctx;
    const struct bake_options *options;
    struct bake_report *report;
    uint32_t maps;
    struct bake_surface surface;
    struct bake_lowmesh mesh;
    struct bake_udim udim;
    struct bake_tile *tiles;       /* one for each tile of `udim` */
    struct fmt_textures *skew;     /* of these tiles; NULL: there is none */
    struct bake_job traced;        /* what the device traces, if there is one */
    bool *sees;                    /* that of the surface */
    struct bk_triangle *triangles; /* of the tiles to bake, the first ones of the mesh */
    uint32_t triangle_count;
    struct bake_seen *seen;        /* NULL: nobody asks */
    char *scan_names;              /* of several scans, for the maps' headers; NULL: there is one */
    struct bake_measures measures; /* over all tiles */
    struct bake_curvature_counts curvature; /* over those that were traced */
    struct bake_device *device;             /* NULL: triangles or several scans are traced */
    struct bake_preview_tile *preview_tiles;
    struct bsq_output *preview; /* complete; NULL: there is none yet */
    double preview_from;        /* where its first view is, in degrees around */
    struct bake_asset *asset;   /* NULL: there is none */
    bool keeps_preview;         /* it is there already, or another process renders it */
};

/* Begins and ends a job. The report must be empty; a job that failed frees it. */
int bake_begin_job(struct bsq_ctx *ctx, const struct bake_options *options,
                   struct bake_report *report, struct bake_work **out);
int bake_end_job(struct bake_work *job, int status); /* returns the status, explained */

/* ---- inputs ---- */

/* Opens the scan and the low-poly mesh, chooses the maps and finds the tiles. */
int bake_open_inputs(struct bake_work *job);
/* Sets the parameters of rays, for which it measures distances if they are not given, and checks
 * whether the meshes fit: see bake_fit(). */
int bake_set_params(struct bake_work *job);

/* ---- costs ---- */

/* Sets what baking `texels` of `all` texels with a surface needs. part_bytes must be set. */
void bake_expect_cost(const struct bake_work *job, uint64_t texels, uint64_t all,
                      struct bake_task_cost *cost);
/* Sets the rays and the seconds that the report expects. The triangles must be prepared. */
void bake_expect_work(const struct bake_work *job);

/* ---- tracing ---- */

/* Sorts the triangles of the low-poly mesh by tile and rasterises them. */
int bake_prepare_triangles(struct bake_work *job);
/* Opens the device that traces, if there is a single grid. seconds: what one core is expected to
 * take, by which a device is chosen if the user names none. */
int bake_open_device(struct bake_work *job, double seconds);
/* Traces all tiles that have rasters. */
int bake_trace_maps(struct bake_work *job);
/* Fails with BSQ_EDATA and a reason if no ray of the report hit. */
int bake_check_hits(struct bake_work *job);
/* Chooses the radius in which curvature is measured. */
void bake_choose_radius(struct bake_work *job);
/* Replaces positions and normals in the images by the curvature there, and counts. */
int bake_trace_curvature(struct bake_work *job);
/* Warns of texels whose curvature is unknown, as a radius larger than the scan makes all. Errors:
 * BSQ_EDATA in a strict job. */
int bake_warn_of_radius(struct bsq_ctx *ctx, const struct bake_curvature_counts *counts,
                        double radius);
/* Frees what is needed for tracing only; may be called twice. */
void bake_end_tracing(struct bake_work *job);

/* ---- outputs ---- */

/* Checks before the work that all files of tiles that are not kept, the preview and the plan (NULL:
 * none is written) can be created, are no inputs and have different names. Errors: BSQ_EUSAGE,
 * BSQ_ECANTCREAT, BSQ_ENOMEM. */
int bake_check_outputs(struct bake_work *job, const char *plan);
/* Prepares for the files, which are created when they are written. */
int bake_open_outputs(struct bake_work *job);
/* Returns the side of thumbnails for the preview, so that those of one map in all tiles take at
 * most an eighth of what is left in the budget. */
uint32_t bake_preview_texture_side(const struct bake_work *job);
/* Encodes and writes the maps of a tile, and frees its image. The measures of all tiles must be
 * known. limited: see bake_map_files_write(). */
int bake_write_tile(struct bake_work *job, struct bake_tile *tile, uint32_t side,
                    uint64_t *limited);
/* Creates the image of a tile, which takes at most `memory_bytes`, or is in a temporary file.
 * Errors: those of bake_image_create(). */
int bake_tile_create_image(struct bsq_ctx *ctx, struct bake_tile *tile, uint64_t memory_bytes);
/* Encodes and writes all maps under temporary names. */
int bake_write_maps(struct bake_work *job);
/* Writes the GLB file, if one is asked for. */
int bake_write_asset(struct bake_work *job);
/* Renders and writes the preview, if one is asked for. */
int bake_write_preview(struct bake_work *job);
/* Gives all outputs their names. */
int bake_commit_outputs(struct bake_work *job);

#endif
