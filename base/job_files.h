/* job_files.h - the files that a job reads and writes.
 *
 * A context knows each input by its path. It holds every later opening to what the first one found,
 * and refuses an output that is an input, whatever names the two have. bsq_file_open() and
 * bsq_output_open() note their files. bsq_note_input() notes a file before it is opened, or one
 * that other code opens. */
#ifndef BSQ_JOB_FILES_H
#define BSQ_JOB_FILES_H

#include "base/file.h"

/* Notes an output, which need not exist. Thread-safe. Errors: BSQ_EUSAGE, which names both files,
 * if the job reads this file; BSQ_ENOMEM. */
int bsq_note_output(struct bsq_ctx *ctx, const char *path);

/* An input that was noted. */
struct bsq_noted_input {
    char *path, *role;         /* owned; the role is "" if nobody said what it is */
    bool opened;               /* by bsq_file_open() */
    bool own;                  /* this job wrote it before */
    struct bsq_identity found; /* when it was opened first */
};

/* Sets *out to input number *next, and adds 1 to *next. Inputs keep their order. Returns 1; 0 after
 * the last one. Free *out with bsq_noted_input_free(). Errors: BSQ_ENOMEM. */
int bsq_next_input(struct bsq_ctx *ctx, uint64_t *next, struct bsq_noted_input *out);
void bsq_noted_input_free(struct bsq_noted_input *input);

/* Notes that the output that was noted under this path has its final name now, and that later
 * openings may find another file. */
void bsq_note_written(struct bsq_ctx *ctx, const char *path);

#endif
