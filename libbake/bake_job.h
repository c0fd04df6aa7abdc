/* bake_job.h - what the files of a bake share; private to libbake/. bake.c runs a job,
 * bake_inputs.c opens its inputs, bake_trace.c traces its maps and bake_outputs.c writes them.
 * bake_farm.c divides it into tasks, and bake_costs.c estimates what these need. */
#ifndef BAKE_BAKE_JOB_H
#define BAKE_BAKE_JOB_H

#include "libbake/bake.h"
#include "libbake/curvature/curvature.h"
#include "libbake/preview/preview.h"
#include "libbake/tile_bake.h"

struct bake_run {
    struct bsq_ctx *ctx;
    const struct bake_options *options;
    struct bake_report *report;
    uint32_t maps;
    struct bake_surface surface;
    struct bake_lowmesh mesh;
    struct bake_udim udim;
    struct bake_tile *tiles;       /* one for each tile of `udim` */
    struct bake_skew *skew;        /* of these tiles; NULL: there is none */
    struct bake_job traced;        /* what the device traces, if there is one */
    bool *sees;                    /* that of the surface */
    struct bk_triangle *triangles; /* of the tiles to bake, the first ones of the mesh */
    uint32_t triangle_count;
    char *scan_names;              /* of several scans, for the maps' headers; NULL: there is one */
    struct bake_measures measures; /* over all tiles */
    struct bake_curvature_counts curvature; /* over those that were traced */
    struct bake_device *device;             /* NULL: triangles or several scans are traced */
    struct bake_preview_tile *preview_tiles;
    struct bake_preview_file *preview_file;
};

/* Begins and ends a job. The report must be empty; a job that failed frees it. */
int bake_begin_job(struct bsq_ctx *ctx, const struct bake_options *options,
                   struct bake_report *report, struct bake_run **out);
int bake_end_job(struct bake_run *job, int status); /* returns the status, explained */

/* ---- inputs ---- */

/* Opens the scan and the low-poly mesh, chooses the maps and finds the tiles. */
int bake_open_inputs(struct bake_run *job);
/* Sets the parameters of rays, for which it measures distances if they are not given. */
int bake_set_params(struct bake_run *job);

/* Finds out which scans each object sees, by their names. Errors: BSQ_EUSAGE, with the names, if an
 * object sees none, or if none sees a scan. */
int bake_match_names(struct bake_run *job);

/* ---- tracing ---- */

/* Sorts the triangles of the low-poly mesh by tile and rasterises them. */
int bake_prepare_triangles(struct bake_run *job);
/* Opens the device that traces, if there is a single grid. */
int bake_open_device(struct bake_run *job);
/* Traces all tiles that have rasters. */
int bake_trace_maps(struct bake_run *job);
/* Fails with BSQ_EDATA and a reason if no ray of the report hit. */
int bake_check_hits(struct bake_run *job);
/* Chooses the radius in which curvature is measured. */
void bake_choose_radius(struct bake_run *job);
/* Replaces positions and normals in the images by the curvature there, and counts. */
int bake_trace_curvature(struct bake_run *job);
/* Warns of texels whose curvature is unknown, as a radius larger than the scan makes all. Errors:
 * BSQ_EDATA in a strict job. */
int bake_warn_of_radius(struct bsq_ctx *ctx, const struct bake_curvature_counts *counts,
                        double radius);
/* Frees what is needed for tracing only; may be called twice. */
void bake_end_tracing(struct bake_run *job);

/* ---- tasks ---- */

/* Sets what each task of a plan needs. The plan must have its tiles, blocks and texels. */
void bake_expect_costs(const struct bake_run *job, struct bake_farm_plan *plan);

/* ---- outputs ---- */

/* Checks the files of all tiles before the work, and creates those of the first and the preview's.
 * Those of other tiles are created when they are written. */
int bake_open_outputs(struct bake_run *job);
/* Encodes and writes all maps under temporary names. */
int bake_write_maps(struct bake_run *job);
/* Renders and writes the preview, if one is asked for. */
int bake_write_preview(struct bake_run *job);
/* Gives all outputs their names. */
int bake_commit_outputs(struct bake_run *job);

#endif
