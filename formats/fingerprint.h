/* fingerprint.h - tells whether an input is still the file that a plan was made with. */
#ifndef FMT_FINGERPRINT_H
#define FMT_FINGERPRINT_H

#include "base/file.h"

struct fmt_fingerprint {
    uint64_t bytes;
    char hash[33];                     /* XXH3-128 in hexadecimal digits */
    char identity[BSQ_IDENTITY_BYTES]; /* bsq_identity_text(); "" if the file is not settled */
};

/* Computes the fingerprint of an input from all of its bytes. Of chunk files and grids above 64 MiB
 * it reads both ends only, which hold checksums of all the rest. Errors: those of bsq_file_open()
 * and bsq_file_read(), BSQ_ENOMEM. */
int fmt_fingerprint(struct bsq_ctx *ctx, const char *path, struct fmt_fingerprint *out);

/* Sets *same if an input has the size and the content of a fingerprint. Reads it only if it has
 * another identity. Errors: likewise. */
int fmt_is_same(struct bsq_ctx *ctx, const char *path, uint64_t bytes, const char *hash,
                const char *identity, bool *same);

#endif
