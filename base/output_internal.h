/* output_internal.h - private to base: an output, its final name, and what a file that is replaced
 * leaves to its successor. */
#ifndef BSQ_OUTPUT_INTERNAL_H
#define BSQ_OUTPUT_INTERNAL_H

#include <stdatomic.h>
#include <sys/types.h>

#include "base/output.h"

struct bsq_output {
    struct bsq_ctx *ctx;
    char *path;      /* final name, symbolic links followed; or a name for messages only */
    char *noted;     /* the path under which the job knows it */
    char *directory; /* of both names; NULL: the file gets no final name */
    char *temp_path; /* NULL: the file has no name */
    mode_t old_mode; /* of the file that was there at the start; 0: none */
    bool created;    /* the file has its final name, which no file had before */
    bool exchanged;  /* the file has its final name, and temp_path is the file that it replaced */
    int fd, directory_fd; /* -1: not open */
    uint64_t position;
    atomic_uint_least64_t written; /* bytes, counted at each write */
    uint64_t expected;             /* a file of which fewer bytes were written may not be kept */
    uint64_t sent;                 /* bytes whose writing to the disk was started */
    atomic_bool synced;            /* all is on the disk, and nothing was written after that */
    atomic_int status;             /* first failure; an output that has one cannot be committed */
};

/* Records that writing failed, so that the output cannot be committed. Returns BSQ_EIO. */
int bsq_output_fail_write(struct bsq_output *output, int error);

/* Gives the new file the mode, owner, group and access list of the file that it is going to
 * replace, as far as the process may. Whoever could not read the old file cannot read the new one.
 * Does nothing if there was and is no such file. Returns 0 or an errno. */
int bsq_keep_access(const struct bsq_output *output);

#endif
