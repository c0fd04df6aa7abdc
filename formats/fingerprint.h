/* fingerprint.h - tells whether an input is still the file that a plan was made with. */
#ifndef FMT_FINGERPRINT_H
#define FMT_FINGERPRINT_H

#include "base/file.h"

struct fmt_fingerprint {
    uint64_t bytes;
    char hash[33];                     /* XXH3-128 in hexadecimal digits */
    char identity[BSQ_IDENTITY_BYTES]; /* bsq_identity_text(); "" if the file is not settled */
};

/* Computes the fingerprint of an input: of a chunk file from the checksum of its header, which it
 * opens to check it; of a grid above 64 MiB from both ends, which have checksums of the rest; else
 * from all bytes. Errors: those of bsq_file_open(), bsq_file_read() and fmt_tris_open(). */
int fmt_fingerprint(struct bsq_ctx *ctx, const char *path, struct fmt_fingerprint *out);

/* Sets *same if an input has the size and the content of a fingerprint. Reads it only if it has
 * another identity. Errors: likewise. */
int fmt_is_same(struct bsq_ctx *ctx, const char *path, uint64_t bytes, const char *hash,
                const char *identity, bool *same);

#endif
