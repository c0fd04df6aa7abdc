/* job_record.h - adds what the sorter learns to a job's record; private to the sorter. */
#ifndef VOX_JOB_RECORD_H
#define VOX_JOB_RECORD_H

#include "libvoxel/voxel.h"

struct fmt_mesh_reader;

/* Adds what the reader has met: material libraries, and what came through pipes. */
int vox_job_add_inputs(struct vox_job *job, struct fmt_mesh_reader *reader);

#endif
