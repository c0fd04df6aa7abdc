/* job_note.h - the note of what a chunk file is made from; private to the sorter. */
#ifndef VOX_JOB_NOTE_H
#define VOX_JOB_NOTE_H

#include "libvoxel/voxel.h"

struct fmt_mesh_reader;

struct job_note {
    struct bsq_ctx *ctx;
    const char *tris_path; /* not owned */
    char *path;            /* of the note; NULL: the job has none */
    char *lines;           /* all but the first; an empty one follows */
    size_t size;           /* bytes of the lines */
};

/* Describes the inputs as they are now, unless the options want no note. Free the note with
 * vox_note_free(), also after failure. Errors: BSQ_ENOINPUT, BSQ_ENOMEM; BSQ_EUSAGE if a job with
 * a pipe is to be resumed. */
int vox_note_open(struct bsq_ctx *ctx, const struct vox_sort_options *options,
                  struct job_note *note);
void vox_note_free(struct job_note *note);

/* Sets *same if the chunk file is complete and was made from the same inputs. Errors: see enum
 * vox_note. */
int vox_note_check(struct job_note *note, enum vox_note how, bool *same);
/* Adds the material libraries that the reader has met. */
int vox_note_add_libraries(struct job_note *note, struct fmt_mesh_reader *reader);
/* Adds a texture whose image is in the chunk file. */
int vox_note_add_image(struct job_note *note, const char *path);
/* Writes the note beside the chunk file, which must be complete. */
int vox_note_write(struct job_note *note);

#endif
