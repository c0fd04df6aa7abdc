/* voxel.h - stage 1: a scan of any size becomes a chunk file and a voxel grid.
 *
 *   vox_sort()      OBJ files -> scan.tris   (triangles in spatially sorted chunks)
 *   vox_voxelize()  scan.tris -> scan.nvdb   (sparse grid of surface voxels)
 *
 * Both stay within the context's memory budget and give the same bytes for any budget and number of
 * threads. */
#ifndef VOX_VOXEL_H
#define VOX_VOXEL_H

#include "base/context.h"

#ifdef __cplusplus
extern "C" {
#endif

struct bsq_file; /* base/file.h */
struct vox_job;

struct vox_sort_options {
    const char *const *obj_paths; /* read as one scan */
    uint32_t obj_count;
    const char
        *texture_path; /* image for every face with texture coordinates; NULL: from the MTL files */
    const char *tris_path; /* output */
    /* NULL, or where to put the chunks instead: a temporary file, to be closed by the caller with
     * bsq_file_close(). tris_path then only says beside what. */
    struct bsq_file *tris_file;
    struct vox_job *job; /* to be told of the material libraries that were read; may be NULL */
};

struct vox_sort_report {
    uint64_t bytes_read, vertices, faces, triangles;
    uint64_t degenerate_triangles; /* zero area: left out */
    uint64_t short_faces;          /* fewer than three corners: left out */
    uint64_t unused_vertices;
    uint64_t skipped_lines; /* statements that OBJ does not define */
    uint64_t chunks, tris_bytes, temp_bytes;
    double origin[3];
    bool has_normals, has_texcoords, has_colors;
    double seconds_read, seconds_sort;
};

/* Reads OBJ files and writes the chunk file. Errors: those of the reader; BSQ_EDATA where there are
 * no triangles with an area; BSQ_EUSAGE where the budget is below vox_memory_min(). */
int vox_sort(struct bsq_ctx *ctx, const struct vox_sort_options *options,
             struct vox_sort_report *report);

/* ---- going on after an interruption ----
 *
 * A job that has sorted its scan can go on with the chunk file. What this was made from is recorded
 * beside it, in tris_path.job, from when it is complete until the job is finished:
 *
 *   vox_job_open(), vox_job_resume(); unless sorted: vox_sort(), vox_job_record(); vox_voxelize(),
 * vox_job_finish()
 *
 * One thread at a time. */

/* Looks at the inputs as they are now. The options are copied. Errors: BSQ_ENOINPUT. */
int vox_job_open(struct bsq_ctx *ctx, const struct vox_sort_options *options, struct vox_job **out);
void vox_job_close(struct vox_job *job); /* NULL is allowed */

/* *sorted: the chunk file is there, complete, and what vox_sort() would write. Without a record, or
 * where the chunk file is not the one that it is about, false. Errors: BSQ_EDATA where an input has
 * changed since, or a program of another version or from other sources made it; BSQ_EUSAGE where
 * inputs or texture are others. The line says which. */
int vox_job_resume(struct vox_job *job, bool *sorted);

/* Writes the record, after vox_sort(); none where an input has changed meanwhile, which is a
 * warning. */
int vox_job_record(struct vox_job *job);

/* Removes the record. NULL is allowed. */
void vox_job_finish(struct vox_job *job);

/* Smallest budget in bytes that vox_sort and vox_voxelize work with, for this number of threads. */
uint64_t vox_memory_min(unsigned threads);

/* Parses without keeping anything; for measuring the reader. */
int vox_parse_only(struct bsq_ctx *ctx, const char *const *obj_paths, uint32_t obj_count,
                   struct vox_sort_report *report);

/* Normals of a scan that has none of its own. Where its edges are shorter than 0.7 voxels both are
 * the same, as a voxel averages over several triangles. */
enum vox_scan_normals {
    VOX_NORMALS_SMOOTH, /* interpolated between vertices; each is the area-weighted mean around it
                         */
    VOX_NORMALS_FLAT    /* those of the triangles */
};

enum vox_grid_type { VOX_GRID_MASK, VOX_GRID_ONINDEX };

struct vox_voxelize_options {
    const char *tris_path;
    const struct bsq_file *tris_file; /* NULL, or that of vox_sort(), read instead of tris_path */
    const char *grid_path;            /* output */
    uint32_t resolution;              /* voxels along the longest side; 0: use voxel_size */
    double voxel_size; /* world units; the lattice is then aligned to its multiples */
    enum vox_grid_type grid_type;
    enum vox_scan_normals scan_normals; /* of a scan without normals */
    const char *vdb_path;               /* OpenVDB export, or NULL */
};

struct vox_voxelize_report {
    uint64_t triangles, voxels, second_records, leaves, lowers, uppers, grid_bytes;
    double voxel_size;
    int32_t index_min[3], index_max[3];
    bool has_color;
    double seconds;
};

/* A voxel is set where a triangle touches its half-open box, as the box-triangle separating-axis
 * test (Akenine-Moeller, "Fast 3D Triangle-Box Overlap Testing", 2001; Schwarz & Seidel, "Fast
 * Parallel Surface and Solid Voxelization on GPUs", 2010) says that a triangle touches it. Its
 * record is the mean over the clipped triangle pieces inside it, weighted by area. */
int vox_voxelize(struct bsq_ctx *ctx, const struct vox_voxelize_options *options,
                 struct vox_voxelize_report *report);

/* 0 where OpenVDB files can be written, else the status and error of what is missing.
 * vox_voxelize() asks too; this is for those who have other work to do before. */
int vox_check_export(struct bsq_ctx *ctx);

#ifdef __cplusplus
}
#endif
#endif
