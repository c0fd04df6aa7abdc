/* output_internal.h - private to base: an output, its final name, and what a file that is replaced
 * leaves to its successor; temporary files with a name, and those that a killed job left. */
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
    uint64_t expected;             /* a file with fewer bytes may not be kept */
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

/* ---- temporary files (temp.c) ----
 *
 * Most temporary files never have a name: the kernel removes them with the process. A name is
 * needed for the moment in which an output gets its final name, and on file systems without
 * O_TMPFILE. It is ".NAME.XXXXXXCCCCCC.tmp": six random letters, and six that are a checksum of
 * NAME and these. NAME is shortened so that the whole stays below NAME_MAX.
 *
 * Its owner holds flock(2) on the file, so a file that can be locked has no owner any more.
 * Functions that return int return 0 or an errno, and leave nothing behind on failure. */

/* Opens a file without a name in a directory. `linkable`: only if bsq_temp_link() can name it. */
int bsq_temp_unnamed(const char *directory, mode_t mode, int linkable, int *fd);

/* Returns whether an error means that the file system, or a layer above it, has no files without a
 * name. */
bool bsq_temp_lacks_unnamed(int error);

/* Creates a locked file with a name. Free *path with free(). */
int bsq_temp_named(const char *directory, const char *name, mode_t mode, char **path, int *fd);

/* Removes a temporary file. Tries twice; a file that stays is a warning, and left to the next job.
 */
void bsq_temp_remove(struct bsq_ctx *ctx, const char *path);

/* Gives an unnamed file a name and locks it. Free *path with free(). */
int bsq_temp_link(int fd, const char *directory, const char *name, char **path);

/* Removes the files of this name that no process owns, as far as possible. A file stays if its
 * owner lives or the file system has no locks. A job reads each directory once, so files that come
 * later stay for the next job. Thread-safe. Returns ENOMEM if the names do not fit in memory or in
 * the budget. */
int bsq_temp_sweep(struct bsq_ctx *ctx, const char *directory, const char *name);

/* Returns whether a path is a name of the open file. */
bool bsq_temp_names_file(const char *path, int fd);

#endif
