/* farm.h - a grid as tasks: the plan, and the part that each task makes.
 *
 * In: the options of a grid, and the regions that its scan touches. Out: a plan file, which says
 * which task makes which regions, and part files, which hold the voxels of regions in the grid's
 * order. FORMATS.md describes both files.
 *
 * Tasks get regions along Hilbert's curve, so that the regions of a task share most of the chunks
 * that they need. A plan has only the places where the curve is cut. */
#ifndef VOX_FARM_FARM_H
#define VOX_FARM_FARM_H

#include "formats/farm/farm.h"
#include "formats/grid/nvdb.h"
#include "libvoxel/voxel.h"

struct vox_farm_plan {
    struct fmt_farm_plan base;
    struct vox_voxelize_options options; /* part_paths are the inputs; tris_path is the first */
    double start[3], voxel_size;         /* of the grid: world position of voxel (0, 0, 0) */
    int32_t first_region[3];     /* lowest region on each axis, from which the curve counts */
    uint32_t curve_bits;         /* of a coordinate on the curve */
    uint32_t curve_shift;        /* regions in a cell of the curve: 2^curve_shift on each axis */
    uint64_t *cuts;              /* task i has places from cuts[i] on and below cuts[i + 1] */
    struct vox_task_cost *costs; /* one a task */
};

/* Returns the values of further channels in a record. */
uint32_t vox_channel_values(const struct vox_voxelize_options *options);

/* Makes a plan for the voxels from lo to hi, in which no task has regions. Free *out with
 * vox_farm_plan_free(). Errors: BSQ_EUSAGE for a number of tasks that no plan can have; BSQ_ENOMEM.
 */
int vox_farm_plan_create(struct bsq_ctx *ctx, const char *path,
                         const struct vox_voxelize_options *options, uint32_t task_count,
                         const int32_t lo[3], const int32_t hi[3], struct vox_farm_plan **out);
void vox_farm_plan_free(struct vox_farm_plan *plan); /* NULL is allowed */

/* Write and read a plan file, as fmt_farm_plan_write() and fmt_farm_plan_read() do. */
int vox_farm_plan_write(struct vox_farm_plan *plan, bool *kept);
int vox_farm_plan_read(struct bsq_ctx *ctx, const char *path, struct vox_farm_plan **out);

/* ---- dividing ---- */

/* A region and the work in it. */
struct vox_farm_region {
    uint64_t place; /* on the curve */
    double work;    /* in triangles */
};

/* Returns where the region with this first voxel lies on the curve. */
uint64_t vox_farm_place(const struct vox_farm_plan *plan, const int32_t origin[3]);

/* Returns the task that makes the region with this first voxel. */
uint32_t vox_farm_task_of(const struct vox_farm_plan *plan, const int32_t origin[3]);

/* Cuts the curve so that all tasks have about as much work, and sets their regions and triangles.
 * Sorts the regions, of which there is at least one. */
void vox_farm_divide(struct vox_farm_plan *plan, struct vox_farm_region *regions, uint64_t count);

/* ---- parts ---- */

/* What a part holds. */
struct vox_part_totals {
    uint64_t regions, tiles, leaves, voxels, second_records; /* tiles: of 4096^3 voxels */
    int32_t index_min[3], index_max[3];                      /* of voxels; min > max: none */
};

/* Writes a part to an output. */
struct vox_part_writer;

/* Begins the part of a task, whose records have normal and plane, colours and ids as said here, and
 * the channels of the plan's options. Free *out with vox_part_free(). Errors: BSQ_EIO, BSQ_ENOMEM.
 */
int vox_part_begin(const struct vox_farm_plan *plan, uint32_t task, bool has_color, bool has_ids,
                   struct bsq_output *output, struct vox_part_writer **out);
/* Appends voxels as fmt_nvdb_append() does; arg: the writer. */
int vox_part_append(void *arg, const struct fmt_nvdb_region *region);
/* Completes the part. totals: of index_min and index_max only; the rest is filled in. */
int vox_part_end(struct vox_part_writer *writer, struct vox_part_totals *totals);
void vox_part_free(struct vox_part_writer *writer); /* NULL is allowed */

/* Checks all of a task's part. Errors: BSQ_ENOINPUT; BSQ_EDATA. */
int vox_part_check(const struct vox_farm_plan *plan, uint32_t task);

/* The voxels of all parts, in the order of the grid. */
struct vox_parts;

/* Opens the parts of all tasks and checks all but their voxels. Free *out with vox_parts_close(),
 * also after a failure. Errors: BSQ_ENOINPUT, which names the missing parts; BSQ_EDATA. */
int vox_parts_open(const struct vox_farm_plan *plan, bool has_color, bool has_ids,
                   struct vox_part_totals *totals, struct vox_parts **out);
void vox_parts_close(struct vox_parts *parts); /* NULL is allowed */

/* Hands all voxels to `append`, and checks them. Errors: BSQ_EDATA, those of append. */
int vox_parts_read(struct vox_parts *parts,
                   int (*append)(void *arg, const struct fmt_nvdb_region *region), void *arg);

#endif
