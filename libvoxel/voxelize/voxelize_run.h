/* voxelize_run.h - makes the regions of a grid from chunk files: all of them, or those of a task.
 */
#ifndef VOX_VOXELIZE_VOXELIZE_RUN_H
#define VOX_VOXELIZE_VOXELIZE_RUN_H

#include "formats/grid/nvdb.h"
#include "libvoxel/voxel.h"
#include "libvoxel/voxelize/region_work.h"

/* Takes the voxels of regions, as fmt_nvdb_append() does. */
struct vox_sink {
    int (*append)(void *arg, const struct fmt_nvdb_region *region);
    void *arg;
};

struct vox_run {
    const struct vox_voxelize_options *options;
    struct bsq_ctx *ctx;
    struct fmt_tris_file *file;
    const struct fmt_tris_header *header;
    struct vox_shared shared;
    struct vox_smooth *smooth;           /* NULL: the scan has normals, or is to be flat */
    struct vox_box *bounds;              /* voxels of each chunk's bounds */
    const struct vox_box_filter *filter; /* which regions are made; NULL: all */
    struct vox_chunk_box *boxes;         /* of the chunks that touch these */
    uint64_t box_count;
    uint64_t expected_triangles; /* for the progress */
    double expected_regions;     /* at most; for the division of work */
    struct vox_schedule *schedule;
    struct vox_sink sink;
    struct vox_worker *own; /* one for each worker */
    struct vox_unit *units; /* the pipeline's slots */
    unsigned workers, unit_count;
    uint32_t slabs;                     /* units that each region is cut into */
    uint32_t next_slab;                 /* next slab of the region in production */
    struct vox_unit current;            /* the region in production: its origin and chunks */
    int32_t index_min[3], index_max[3]; /* of voxels that the sink got; min > max: none */
    bool gate_open;
};

/* Opens the input and places the voxels. Close the run also after a failure; zeros are allowed. The
 * options must outlive it. */
int vox_run_open(struct bsq_ctx *ctx, const struct vox_voxelize_options *options,
                 struct vox_run *run);

/* Finds the boxes of chunks in the regions that a filter wants; NULL: in all. Only these regions
 * are made. The filter must outlive the run. */
int vox_run_find_boxes(struct vox_run *run, const struct vox_box_filter *filter);
void vox_run_close(struct vox_run *run);

/* Returns the 32-bit numbers of a record: normal and plane, colour, id, further channels. */
unsigned vox_run_channels(const struct vox_run *run);

/* Refuses a grid that does not fit on its disk or in the format, and warns of lost precision. */
int vox_run_check_grid(struct vox_run *run);

/* Makes the regions that boxes touch and the filter wants, and hands their voxels to the sink in
 * the grid's order. Errors: those of reading, and of the sink. */
int vox_run_regions(struct vox_run *run, const struct vox_sink *sink);

/* ---- the grid file ---- */

/* Starts the grid of a run. */
int vox_grid_create(const struct vox_run *run, struct fmt_nvdb_writer **out);

/* Completes the grid, whose writer it frees in any case, exports it as OpenVDB if that is asked
 * for, gives the files their names, and fills in the report except for the time. */
int vox_grid_commit(const struct vox_run *run, struct fmt_nvdb_writer *writer,
                    struct vox_voxelize_report *report);

/* Notes the outputs. Errors: those of bsq_note_output() and vox_check_export(). */
int vox_grid_note_outputs(struct bsq_ctx *ctx, const struct vox_voxelize_options *options);

#endif
