/* job.h - the steps of a bake, in their order. Takes options; gives map files and a report.
 *
 * bake_run() takes all of the steps. In a bake in parts, each part traces its own share of the
 * texels, and a last job takes all texels from the parts' files instead of tracing. A texel does
 * not depend on its part. Steps end at the first failure. */
#ifndef BAKE_JOB_JOB_H
#define BAKE_JOB_JOB_H

#include "libbake/asset/asset.h"
#include "libbake/bake.h"
#include "libbake/curvature/curvature.h"
#include "libbake/filter/filter.h"
#include "libbake/preview/preview.h"

/* What the header of a part's file says, see FORMATS.md. All but the counts must be those of the
 * bake. */
enum bake_part_text {
    BAKE_PART_VERSION,
    BAKE_PART_NUMBER,
    BAKE_PART_TILE,
    BAKE_PART_INPUTS,
    BAKE_PART_OPTIONS,
    BAKE_PART_COUNTS,
    BAKE_PART_TEXTS,
    BAKE_PART_TEXT = 160 /* bytes of a text */
};
struct bake_part_texts {
    char of[BAKE_PART_TEXTS][BAKE_PART_TEXT];
};

/* The maps of one UDIM tile. */
struct bake_tile {
    struct bake_udim_tile udim;
    const char *object, *material; /* that have maps of their own, or NULL */
    struct bake_options options;   /* the job's, with the size and output path of this tile */
    uint32_t maps;
    char *output_path;
    char *beside;        /* the path of one map; temporary files go to its directory */
    uint32_t patch_side; /* of the raster, in texels */
    bool skipped;        /* its maps are not written */
    bool in_blocks;      /* bakes `blocks` only, into an image of them */
    struct bake_blocks blocks;
    uint32_t *shares; /* for each block: the part that bakes it, from 0 on; NULL: there are none */
    struct bake_raster *raster;
    struct bake_image *image;
    struct bake_map_files *files;
    struct bake_thumbnail normal, color, missed; /* `texels` is NULL if there is none */
};

/* A bake. */
struct bake_job {
    struct bsq_ctx *ctx;
    const struct bake_options *options;
    struct bake_report *report;
    uint32_t maps;
    struct bake_surface surface;
    struct bake_lowmesh mesh;
    struct bake_udim udim;
    struct bake_tile *tiles;       /* one for each tile of `udim` */
    struct fmt_textures *skew;     /* of these tiles; NULL: there is none */
    struct bake_scene traced;      /* what the device traces, if there is one */
    bool *sees;                    /* that of the surface */
    struct bk_triangle *triangles; /* of the tiles to bake, the first ones of the mesh */
    uint32_t triangle_count;
    char *scan_names;              /* of several scans, for the maps' headers; NULL: there is one */
    struct bake_measures measures; /* over all tiles */
    struct bake_curvature_counts curvature; /* over those that were traced */
    struct bake_device *device; /* NULL: the processor traces triangles or several scans */
    struct bake_preview_tile *preview_tiles;
    struct bsq_output *preview; /* complete; NULL: there is none yet */
    struct bake_preview_views preview_views;
    struct bake_asset *asset;        /* NULL: there is none */
    struct bake_part_texts identity; /* of a bake in parts: those that all files share */
    uint64_t texels, part_texels;    /* that triangles cover; of the job's part */
};

/* ---- inputs ---- */

/* Opens the scan and the low-poly mesh, chooses the maps and finds the tiles. */
int bake_open_inputs(struct bake_job *job);
/* Notes the tiles that are not skipped and their sizes in the report. */
int bake_note_tiles(struct bake_job *job);
/* Sets the parameters of rays, for which it measures distances if they are not given, and checks
 * whether the meshes fit: see bake_fit(). */
int bake_set_params(struct bake_job *job);

/* ---- costs ---- */

/* Returns whether all cores together are expected to finish before a fast GPU, which must first be
 * opened and be given the grid or the chunks. There is a single scan. texels: how many are baked.
 */
bool bake_expect_processor_first(const struct bake_job *job, uint64_t texels);
/* Sets the rays and the seconds that the report expects. The triangles must be prepared. Returns
 * the texels that they cover. */
uint64_t bake_expect_work(const struct bake_job *job);

/* ---- tracing ---- */

/* Sorts the triangles of the low-poly mesh by tile; then rasterises those of tiles that have blocks
 * to bake, or are baked as a whole. */
int bake_arrange_triangles(struct bake_job *job);
int bake_rasterise(struct bake_job *job);
/* Opens the device that traces, unless there are several scans and some are grids. If the user
 * names none, it is the one that is expected to finish first. texels: how many are baked. */
int bake_open_device(struct bake_job *job, uint64_t texels);
/* Traces all tiles that have rasters. */
int bake_trace_maps(struct bake_job *job);
/* Fails with BSQ_EDATA and a reason if no ray of the report hit. */
int bake_check_hits(struct bake_job *job);
/* Chooses the radius in which curvature is measured. */
void bake_choose_radius(struct bake_job *job);
/* Replaces positions and normals in the images by the curvature there, and counts. */
int bake_trace_curvature(struct bake_job *job);
/* Warns of texels whose curvature is unknown, as a radius larger than the scan makes all. Errors:
 * BSQ_EDATA in a strict job. */
int bake_warn_of_radius(struct bsq_ctx *ctx, const struct bake_curvature_counts *counts,
                        double radius);
/* Tells the report what the device did, and frees what is needed for tracing only; may be called
 * twice. */
void bake_end_tracing(struct bake_job *job);

/* ---- parts ---- */

/* Divides the texels of all tiles among options->parts, and counts triangles without area. Arranges
 * the triangles. Depends on inputs and options only. */
int bake_divide(struct bake_job *job);
/* Makes a tile bake the blocks of the job's part. Errors: BSQ_ENOMEM; BSQ_EUSAGE if these are too
 * many. */
int bake_take_share(struct bake_job *job, struct bake_tile *tile);
/* Bakes options->part, after the inputs are opened, and writes its files, unless they are there
 * already: then report->done is set. */
int bake_run_part(struct bake_job *job);
/* Takes the texels, statistics and counts of all tiles from the files of all parts, after the
 * parameters are set. Images of skipped tiles are freed. Errors: BSQ_ENOINPUT, which names missing
 * parts; BSQ_EDATA for damaged and foreign ones. */
int bake_take_parts(struct bake_job *job);

/* ---- outputs ---- */

/* Checks before the work that the preview and all files of tiles that are not skipped can be
 * created, are no inputs and have different names. Errors: BSQ_EUSAGE, BSQ_ECANTCREAT, BSQ_ENOMEM.
 */
int bake_check_outputs(struct bake_job *job);
/* Prepares for the files, which are created when they are written. */
int bake_open_outputs(struct bake_job *job);
/* Creates the image of a tile, which takes at most `memory_bytes`, or is in a temporary file.
 * objects: with a value more for the object of each texel. Errors: those of bake_image_create(). */
int bake_tile_create_image(struct bsq_ctx *ctx, struct bake_tile *tile, bool objects,
                           uint64_t memory_bytes);
/* Measures the values of all tiles, since they share the ranges of the maps. */
int bake_measure_maps(struct bake_job *job);
/* Encodes and writes all maps under temporary names. */
int bake_write_maps(struct bake_job *job);
/* Writes the GLB file, if one is asked for. */
int bake_write_asset(struct bake_job *job);
/* Renders and writes the preview, if one is asked for. */
int bake_write_preview(struct bake_job *job);
/* Gives all outputs their names. */
int bake_commit_outputs(struct bake_job *job);

#endif
