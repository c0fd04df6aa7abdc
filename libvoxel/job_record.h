/* job_record.h - adds what the sorter learns to a job's record; private to the sorter. */
#ifndef VOX_JOB_RECORD_H
#define VOX_JOB_RECORD_H

#include "libvoxel/voxel.h"

struct fmt_mesh_reader;

/* Adds the material libraries that the reader has met. */
int vox_job_add_dependencies(struct vox_job *job, const struct fmt_mesh_reader *reader);

#endif
