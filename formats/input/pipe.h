/* pipe.h - private to formats/input: reads pipes without being deaf to interruptions. */
#ifndef FMT_INPUT_PIPE_H
#define FMT_INPUT_PIPE_H

#include <stdatomic.h>

#include "base/context.h"

/* Opens a FIFO, or standard input for "-". Does not wait for a writer. Errors: BSQ_ENOINPUT. */
int fmt_pipe_open(struct bsq_ctx *ctx, const char *path, int *fd);

/* Reads up to `size` bytes, at least one; *got is 0 only at the end. Waits for them until the
 * context is interrupted or *stop is set (NULL: never); then returns BSQ_EINTR. Errors: BSQ_EIO. */
int fmt_pipe_read(struct bsq_ctx *ctx, const char *path, int fd, const atomic_bool *stop,
                  void *buffer, uint64_t size, uint64_t *got);

#endif
