/* spool.h - private to formats/input: a thread that unpacks a stream into a temporary file. */
#ifndef FMT_INPUT_SPOOL_H
#define FMT_INPUT_SPOOL_H

#include "base/file.h"

struct spool;

/* Starts the thread. The bytes come from the open file `file`, or from the pipe `pipe_fd` if `file`
 * is NULL; both stay the caller's and must stay open. `path` is for messages. Errors:
 * BSQ_ECANTCREAT if there can be no temporary file; BSQ_ENOMEM. */
int fmt_spool_start(struct bsq_ctx *ctx, const char *path, const char *beside,
                    const struct bsq_file *file, int pipe_fd, struct spool **out);
/* Stops the thread, waits for it and frees the spool; NULL is allowed. */
void fmt_spool_stop(struct spool *spool);

/* Waits until `end` bytes are there or all have come. *size: all bytes if they have come, else
 * UINT64_MAX. Thread-safe. */
int fmt_spool_reach(struct spool *spool, uint64_t end, uint64_t *size);
/* Reads bytes. Waits for them. Errors: BSQ_EIO if a file that was unpacked twice has other bytes
 * than before; those of fmt_spool_reach(). Thread-safe. */
int fmt_spool_read(struct spool *spool, void *buffer, uint64_t size, uint64_t offset);
/* Keeps all unpacked bytes, earlier and later ones, so that fmt_spool_duplicate() can open them.
 * Without this a file's bytes may be unpacked again when a reader goes back. Thread-safe. */
void fmt_spool_keep(struct spool *spool);

/* Opens the temporary file once more, under the name of the path. All bytes were kept and have
 * come. Errors: BSQ_ENOINPUT. */
int fmt_spool_duplicate(const struct spool *spool, struct bsq_file *out);

/* Returns the bytes of all if they have come, else UINT64_MAX. */
uint64_t fmt_spool_size(struct spool *spool);
/* Gives the number of packed bytes and their XXH3 hash. Returns false if they have not all come. */
bool fmt_spool_given(struct spool *spool, uint64_t *bytes, uint64_t *hash);

#endif
