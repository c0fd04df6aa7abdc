/* fingerprint.h - tells whether an input has the content that it had elsewhere. */
#ifndef FMT_FINGERPRINT_H
#define FMT_FINGERPRINT_H

#include "base/file.h"

/* XXH3-128 in hexadecimal digits, and a zero. */
enum { FMT_FINGERPRINT_BYTES = 33 };

/* Computes the fingerprint of an input: of a chunk file from the checksum of its header, which it
 * opens to check it; of a grid above 64 MiB from both ends, which have checksums of the rest; else
 * from all bytes. Errors: those of bsq_file_open(), bsq_file_read() and fmt_tris_open(). */
int fmt_fingerprint(struct bsq_ctx *ctx, const char *path, char out[FMT_FINGERPRINT_BYTES]);

#endif
