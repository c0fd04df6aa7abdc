/* output.h - output files that appear whole or not at all, alone or in groups.
 *
 * The file is written without a name in the directory of its final name. On file systems without
 * unnamed files it has a temporary name, ".NAME.XXXXXXXXXXXX.tmp". bsq_output_commit() syncs it and
 * gives it its final name in one step. A process that ends before that leaves nothing, or a
 * temporary name that the next bsq_output_open() of this output removes. Several jobs may write to
 * one directory, and even to the same output, at the same time.
 *
 * A file that replaces another one gets its mode, and its owner, group and access list if the
 * process may set them. Symbolic links are followed, also to a file that does not exist yet. */
#ifndef BSQ_OUTPUT_H
#define BSQ_OUTPUT_H

#include "base/file.h"

#ifdef __cplusplus
extern "C" {
#endif

struct bsq_output;

/* Creates an output. Errors: BSQ_ECANTCREAT if the directory is missing or not writable, or if the
 * name belongs to something that a regular file cannot replace, or is "-". */
int bsq_output_open(struct bsq_ctx *ctx, const char *path, struct bsq_output **out);

/* Creates a temporary file, as bsq_file_temp() does, that is written as an output.
 * bsq_output_keep_temp() turns it into *out and frees the output in any case. */
int bsq_output_open_temp(struct bsq_ctx *ctx, const char *beside, const char *what,
                         struct bsq_output **out);
int bsq_output_keep_temp(struct bsq_output *output, struct bsq_file *out);

/* Reserves disk space for a file of `size` bytes (> 0) if the file system can: a full disk is
 * noticed at once, and writing takes less time. At least `size` bytes must be written before the
 * file is synced, committed or kept; otherwise that is BSQ_EBUG. Errors: BSQ_EIO, BSQ_EINTR. */
int bsq_output_expect(struct bsq_output *output, uint64_t size);

/* Appends, or writes at an offset. bsq_output_write_at() is thread-safe for disjoint ranges and
 * does not move the append position. Errors: BSQ_EIO. */
int bsq_output_write(struct bsq_output *output, const void *buffer, uint64_t size);
int bsq_output_write_at(struct bsq_output *output, const void *buffer, uint64_t size,
                        uint64_t offset);

/* Returns the position of the next bsq_output_write(). */
uint64_t bsq_output_tell(const struct bsq_output *output);

/* Leaves `size` bytes of space before the next bsq_output_write(), for bsq_output_write_at(). */
void bsq_output_skip(struct bsq_output *output, uint64_t size);

/* Opens what was written so far for reading, while the file has no final name yet. */
int bsq_output_read(struct bsq_output *output, struct bsq_file *out);

/* Syncs everything to the disk. Errors: BSQ_EIO, BSQ_EINTR. */
int bsq_output_sync(struct bsq_output *output);
/* Syncs what is not synced yet and gives the file its final name; frees the output in any case.
 * Errors: BSQ_EIO, BSQ_EINTR, BSQ_ECANTCREAT. */
int bsq_output_commit(struct bsq_output *output);
/* Removes the file and frees the output; NULL is allowed. */
void bsq_output_discard(struct bsq_output *output);

/* Outputs of one job, which appear all or not at all. Zeros are an empty group. */
struct bsq_output_group {
    struct bsq_output **list;
    unsigned count;
};

/* Adds a complete output, which belongs to the group from now on; on failure it is discarded.
 * Errors: BSQ_ENOMEM. */
int bsq_output_group_add(struct bsq_output_group *group, struct bsq_output *output);
/* Syncs all outputs, then gives all their final names; empties the group in any case. If a name
 * cannot be given, those before it are taken back. Only a process that is killed between two
 * renames leaves some outputs new and some as before. Errors: as bsq_output_commit(). */
int bsq_output_group_commit(struct bsq_output_group *group);
/* Discards all outputs; an empty group is allowed. */
void bsq_output_group_discard(struct bsq_output_group *group);

#ifdef __cplusplus
}
#endif
#endif
