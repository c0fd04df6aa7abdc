/* job_record.h - the record of what a chunk file is made from; private to the sorter. */
#ifndef VOX_JOB_RECORD_H
#define VOX_JOB_RECORD_H

#include "libvoxel/voxel.h"

struct fmt_mesh_reader;

struct job_record {
    struct bsq_ctx *ctx;
    const char *tris_path; /* not owned */
    char *path;            /* of the record; NULL: the job has none */
    char *lines;           /* all but the first; an empty one follows */
    size_t size;           /* bytes of the lines */
};

/* Describes the inputs as they are now, unless the options want no record. Free the record with
 * vox_record_free(), also after failure. Errors: BSQ_ENOINPUT, BSQ_ENOMEM; BSQ_EUSAGE if a job with
 * a pipe is to be resumed. */
int vox_record_open(struct bsq_ctx *ctx, const struct vox_sort_options *options,
                    struct job_record *record);
void vox_record_free(struct job_record *record);

/* Sets *same if the chunk file is complete and was made from the same inputs. Errors: see enum
 * vox_record. */
int vox_record_check(struct job_record *record, enum vox_record how, bool *same);
/* Adds the material libraries that the reader has met. */
int vox_record_add_libraries(struct job_record *record, struct fmt_mesh_reader *reader);
/* Adds a texture whose image is in the chunk file. */
int vox_record_add_image(struct job_record *record, const char *path);
/* Writes the record beside the chunk file, which must be complete. */
int vox_record_write(struct job_record *record);

#endif
