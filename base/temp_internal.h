/* temp_internal.h - private to base: temporary files with a name, and those that a killed job left.
 *
 * Most temporary files never have a name: the kernel removes them with the process. A name is
 * needed for the moment in which an output gets its final name, and on file systems without
 * O_TMPFILE. It is ".NAME.XXXXXXCCCCCC.tmp": six random letters, and six that are a checksum of
 * NAME and these. NAME is shortened so that the whole stays below NAME_MAX.
 *
 * Its owner holds flock(2) on the file, so a file that can be locked has no owner any more. It also
 * has an extended attribute as a mark. Functions that return int return 0 or an errno, and leave
 * nothing behind on failure. */
#ifndef BSQ_TEMP_INTERNAL_H
#define BSQ_TEMP_INTERNAL_H

#include <stdbool.h>
#include <sys/types.h>

struct bsq_ctx;

/* Opens a file without a name in a directory. `linkable`: only if bsq_temp_link() can name it. */
int bsq_temp_unnamed(const char *directory, mode_t mode, int linkable, int *fd);

/* Creates a locked file with a name. Free *path with free(). */
int bsq_temp_named(const char *directory, const char *name, mode_t mode, char **path, int *fd);

/* Gives an unnamed file a name and locks it. Free *path with free(). */
int bsq_temp_link(int fd, const char *directory, const char *name, char **path);

/* Removes the files of this name that no process owns, as far as possible. A file stays if its
 * owner lives or the file system has no locks; and if it has no mark, unless it is empty (its owner
 * was about to mark it) or the file system has no extended attributes. A job reads each directory
 * once, so files that come later stay for the next job. Thread-safe. Returns ENOMEM if the names do
 * not fit in memory or in the budget. */
int bsq_temp_sweep(struct bsq_ctx *ctx, const char *directory, const char *name);

/* Marks a file, for the time in which it has a temporary name. Returns false if it cannot be marked
 * but the file system has attributes. */
bool bsq_temp_mark_path(const char *path);
void bsq_temp_unmark_path(const char *path);
void bsq_temp_unmark(int fd);

/* Returns whether a path is a name of the open file. */
bool bsq_temp_names_file(const char *path, int fd);

#endif
