/* voxelize_report.h - the state and results of a job of bisque-voxelize, and their report. */
#ifndef VOXELIZE_REPORT_H
#define VOXELIZE_REPORT_H

#include "tools/voxelize_arguments.h"

struct voxelize_job {
    struct cli *cli;
    struct voxelize_arguments *arguments;
    struct cli_scans scans;          /* the inputs */
    const char *tris_path;           /* of the chunk file */
    bool temporary_tris;             /* the sorted meshes are temporary: no file has them alone */
    bool joins;                      /* chunk files become one, at tris_path */
    struct vox_temp_tris *temp_tris; /* the chunk file that this job writes, or NULL; owned */
    struct vox_sort_report sort;
    struct vox_voxelize_report grid;
};

/* Prints what is in files, for --info (voxelize_info.c). */
int voxelize_info_print(struct cli *cli, const char *const *paths, uint32_t count);

/* Prints the results, as lines or as JSON. */
int voxelize_report_print(const struct voxelize_job *job);

#endif
