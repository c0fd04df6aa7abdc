/* fingerprint.h - tells whether an input has the content that it had elsewhere. */
#ifndef FMT_FINGERPRINT_H
#define FMT_FINGERPRINT_H

#include <xxhash.h>

#include "base/file.h"

/* XXH3-128 in hexadecimal digits, and a zero. */
enum { FMT_FINGERPRINT_BYTES = 33 };

/* Computes the fingerprint of an input: of a chunk file from the checksum of its header, which it
 * opens to check it; of a grid above 64 MiB from both ends, which have checksums of the rest; else
 * from all bytes. Errors: those of bsq_file_open(), bsq_file_read() and fmt_tris_open(). */
int fmt_fingerprint(struct bsq_ctx *ctx, const char *path, char out[FMT_FINGERPRINT_BYTES]);
/* Computes the fingerprint of the first `size` bytes of an open file. */
int fmt_fingerprint_bytes(struct bsq_ctx *ctx, const struct bsq_file *file, uint64_t size,
                          char out[FMT_FINGERPRINT_BYTES]);

/* Begins a fingerprint of what XXH3_128bits_update() adds; writes it, and frees the state. */
int fmt_fingerprint_begin(struct bsq_ctx *ctx, XXH3_state_t **out);
void fmt_fingerprint_end(XXH3_state_t *state, char out[FMT_FINGERPRINT_BYTES]);

#endif
