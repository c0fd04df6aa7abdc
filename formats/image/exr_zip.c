/* exr_zip.c - packs chunks with libdeflate, as OpenEXR 3.2 and later do. OpenEXR 3.1 uses zlib,
 * which takes three times as long.
 *
 * OpenEXR's compression ZIP puts bytes of even offsets before those of odd offsets, and replaces
 * each byte by its difference from the one before. The result becomes a zlib stream (RFC 1950).
 * libdeflate makes the same bytes on every processor. */
#include "formats/image/exr_zip.h"

#include <libdeflate.h>

enum {
    LEVEL = 1, /* level 4 takes 1.5 to 2 times as long for 1 to 3 % of the size */
    COMPRESSOR_BYTES = 208 << 10, /* libdeflate 1.14 allocates 203 KB for one of this level */
    OFFSET = 128                  /* added to differences, so that small ones have similar values */
};

int fmt_exr_zip_create(struct bsq_ctx *ctx, uint64_t chunk_bytes, struct fmt_exr_zip *zip)
{
    int status = bsq_reserve(ctx, "EXR compression", COMPRESSOR_BYTES);
    if (status < 0)
        return status;
    zip->reserved_bytes = COMPRESSOR_BYTES;
    status = bsq_alloc(ctx, "EXR compression", chunk_bytes, 1, &zip->ordered);
    if (status == 0)
        status = bsq_alloc(ctx, "EXR compression", chunk_bytes, 1, &zip->packed);
    if (status < 0)
        return status;
    zip->compressor = libdeflate_alloc_compressor(LEVEL);
    return zip->compressor
               ? 0
               : bsq_fail(ctx, BSQ_ENOMEM, "the system has no memory left for EXR compression");
}

/* Separates even and odd bytes and takes differences. */
static void order(const uint8_t *chunk, size_t size, uint8_t *out)
{
    uint8_t *even = out, *odd = out + (size + 1) / 2;
    const size_t pairs = size / 2;
    for (size_t i = 0; i < pairs; ++i) {
        even[i] = chunk[2 * i];
        odd[i] = chunk[2 * i + 1];
    }
    if (size % 2 != 0)
        even[pairs] = chunk[size - 1];
    for (size_t i = size - 1; i > 0; --i)
        out[i] = (uint8_t)(out[i] - out[i - 1] + OFFSET);
}

size_t fmt_exr_zip_pack(struct fmt_exr_zip *zip, const uint8_t *chunk, size_t size)
{
    if (size == 0)
        return 0;
    order(chunk, size, zip->ordered);
    return libdeflate_zlib_compress(zip->compressor, zip->ordered, size, zip->packed, size - 1);
}

void fmt_exr_zip_free(struct bsq_ctx *ctx, struct fmt_exr_zip *zip)
{
    libdeflate_free_compressor(zip->compressor);
    bsq_free(ctx, zip->ordered);
    bsq_free(ctx, zip->packed);
    bsq_release(ctx, zip->reserved_bytes);
    *zip = (struct fmt_exr_zip){0};
}
