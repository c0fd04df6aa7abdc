/* exr_zip.h - packs chunks of EXR files with the compression ZIP; private to this folder. */
#ifndef FMT_IMAGE_EXR_ZIP_H
#define FMT_IMAGE_EXR_ZIP_H

#include <stddef.h>
#include <stdint.h>

#include "base/context.h"

/* Working memory for one chunk at a time. */
struct fmt_exr_zip {
    struct libdeflate_compressor *compressor;
    uint8_t *ordered, *packed; /* a chunk each */
    uint64_t reserved_bytes;   /* of the compressor */
};

/* Makes working memory for chunks of up to chunk_bytes. fmt_exr_zip_free() frees it, also after a
 * failure. Returns 0 or a negative status. */
int fmt_exr_zip_create(struct bsq_ctx *ctx, uint64_t chunk_bytes, struct fmt_exr_zip *zip);

/* Packs a chunk of `size` bytes into zip->packed, where it stays until the next call. Returns its
 * packed bytes, or 0 if they would not be fewer than `size`. */
size_t fmt_exr_zip_pack(struct fmt_exr_zip *zip, const uint8_t *chunk, size_t size);

/* Frees what fmt_exr_zip_create() made. A structure of zeros is allowed. */
void fmt_exr_zip_free(struct bsq_ctx *ctx, struct fmt_exr_zip *zip);

#endif
