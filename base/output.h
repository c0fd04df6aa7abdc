/* output.h - output files that appear whole or not at all.
 *
 * The file is written under a temporary name in the directory of its final name, checked, synced
 * and renamed by bsq_output_commit(). bsq_output_discard() removes it; so does process exit through
 * a caught signal, since tools turn signals into bsq_interrupt() and unwind. */
#ifndef BSQ_OUTPUT_H
#define BSQ_OUTPUT_H

#include "base/file.h"

#ifdef __cplusplus
extern "C" {
#endif

struct bsq_output;

/* Errors: BSQ_ECANTCREAT where the directory is missing or not writable. */
int bsq_output_open(struct bsq_ctx *ctx, const char *path, struct bsq_output **out);

/* Appends, or writes at an offset. Errors: BSQ_EIO. bsq_output_write_at is thread-safe for disjoint
 * ranges; it does not move the append position. */
int bsq_output_write(struct bsq_output *output, const void *buffer, uint64_t size);
int bsq_output_write_at(struct bsq_output *output, const void *buffer, uint64_t size,
                        uint64_t offset);

/* Appends `size` bytes of `from` starting at `offset`, inside the kernel where it can. */
int bsq_output_copy(struct bsq_output *output, const struct bsq_file *from, uint64_t offset,
                    uint64_t size);

/* Position of the next bsq_output_write(), and pads with zeros up to a multiple of `alignment`. */
uint64_t bsq_output_tell(const struct bsq_output *output);
int bsq_output_align(struct bsq_output *output, uint64_t alignment);

/* For libraries that write by descriptor or by name: both refer to the temporary file. */
int bsq_output_fd(const struct bsq_output *output);
const char *bsq_output_temp_path(const struct bsq_output *output);

/* Syncs and renames to the final name; frees the output in any case. */
int bsq_output_commit(struct bsq_output *output);
/* Removes the temporary file and frees the output; NULL is allowed. */
void bsq_output_discard(struct bsq_output *output);

#ifdef __cplusplus
}
#endif
#endif
