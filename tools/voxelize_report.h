/* voxelize_report.h - what bisque-voxelize did, and how it says so. */
#ifndef VOXELIZE_REPORT_H
#define VOXELIZE_REPORT_H

#include "tools/voxelize_arguments.h"

struct voxelize_job {
    struct cli *cli;
    const struct voxelize_arguments *arguments;
    bool sorted_input;               /* the input is a chunk file */
    bool resumed;                    /* the chunk file was there already, see --resume */
    struct vox_job *record;          /* of a job that can be resumed, or NULL */
    char *tris_path;                 /* owned; of the chunk file that is read in the end */
    bool temporary_tris;             /* the chunk file has no name: tris_path is that of none */
    struct vox_temp_tris *temp_tris; /* that chunk file, or NULL; owned */
    struct vox_sort_report sort;
    struct vox_voxelize_report grid;
};

/* As lines or as JSON. */
int voxelize_report_print(const struct voxelize_job *job);

#endif
