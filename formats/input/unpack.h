/* unpack.h - private to formats/input: unpacks a stream of bytes that gzip (RFC 1952) or Zstandard
 * (RFC 8878) packed.
 *
 * Members of a gzip file, and frames of a Zstandard file, may lie side by side; their contents
 * follow each other. The first bytes tell how a stream is packed; other bytes stay as they are. */
#ifndef FMT_INPUT_UNPACK_H
#define FMT_INPUT_UNPACK_H

#include "base/context.h"

/* Returns whether a file is packed, by its first UNPACK_HEAD_BYTES bytes, or
 * all if it has fewer. */
bool fmt_unpack_recognise(const uint8_t *head, uint64_t size);
#define UNPACK_HEAD_BYTES 4

/* Gives the next bytes of the stream, at most `size`; *got is 0 only at the end. */
typedef int unpack_source(void *arg, void *buffer, uint64_t size, uint64_t *got);

struct unpacker;

/* `arg` must live as long as the unpacker, which unpacks `step` bytes at a time.
 * Errors: BSQ_ENOMEM. */
int fmt_unpack_create(struct bsq_ctx *ctx, unpack_source *source, void *arg, uint64_t step,
                      struct unpacker **out);
void fmt_unpack_free(struct unpacker *unpacker); /* NULL is allowed */

/* Unpacks the next bytes, which stay at *bytes until the next call; *size of them, also after a
 * failure. Returns 1; 0 if these are the last. For damage returns BSQ_EDATA and describes it in
 * fmt_unpack_error(), but not in the context: whoever wants these bytes reports it. Errors:
 * BSQ_ENOMEM, also for a file that needs a larger window than the budget allows; those of the
 * source. */
int fmt_unpack_next(struct unpacker *unpacker, const uint8_t **bytes, uint64_t *size);
const char *fmt_unpack_error(const struct unpacker *unpacker);

#endif
