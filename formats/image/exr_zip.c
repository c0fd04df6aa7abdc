/* exr_zip.c - packs chunks with libdeflate, as OpenEXR 3.2 and later do. OpenEXR 3.1 uses zlib,
 * which takes three times as long.
 *
 * OpenEXR's compression ZIP puts bytes of even offsets before those of odd offsets, and replaces
 * each byte by its difference from the one before. The result becomes a zlib stream (RFC 1950).
 * libdeflate makes the same bytes on every processor.
 *
 * Even offsets hold the low bytes of samples. In maps of 32-bit floats they are often noise, which
 * takes the longest to pack and does not get smaller. Then the stream begins with stored blocks
 * (RFC 1951, section 3.2.4) of that half, and compressed blocks of the other half follow. */
#include "formats/image/exr_zip.h"

#include <libdeflate.h>
#include <stdbool.h>
#include <string.h>

enum {
    LEVEL = 1, /* level 4 takes 1.5 to 2 times as long for 1 to 3 % of the size */
    COMPRESSOR_BYTES = 208 << 10, /* libdeflate 1.14 allocates 203 KB for one of this level */
    OFFSET = 128,                 /* added to differences, so that small ones have similar values */
    STORED_BYTES = 65535,         /* of the largest stored block */
    BLOCK_HEADER_BYTES = 5,       /* of a stored block */
    STREAM_BYTES = 2 + 4,         /* of a zlib stream: its header and its checksum */
    /* Halves that are tested for noise have at least this size. In shorter ones there are too few
     * samples for a histogram, and little time is lost. */
    TESTED_BYTES = 16384,
    COUNTED_STEP = 5, /* each fifth byte is counted; odd, to count all bytes of samples */
    TRIED_PART = 8    /* each eighth part is packed to find repetitions: two rows of 16 */
};

/* Deflate with a window of 32 KiB, packed fast; a multiple of 31. */
static const uint8_t zlib_header[2] = {0x78, 0x01};

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

/* Checks that compression would save less than about 1/16 of the bytes. The probability that two
 * bytes are equal bounds the gain of Huffman codes: the entropy is at least -log2 of it (Renyi
 * 1961). The limit 3/2 * 2^-8 stands for 7.4 of 8 bits. A trial finds repetitions. */
static bool is_noise(struct fmt_exr_zip *zip, const uint8_t *bytes, size_t size)
{
    if (size < TESTED_BYTES)
        return false;
    uint64_t counts[256] = {0}, equal = 0;
    for (size_t i = 0; i < size; i += COUNTED_STEP)
        counts[bytes[i]]++;
    for (int i = 0; i < 256; i++)
        equal += counts[i] * counts[i];
    const uint64_t counted = (size + COUNTED_STEP - 1) / COUNTED_STEP;
    if (equal > counted * counted / 512 * 3)
        return false;
    const size_t tried = size / TRIED_PART;
    return libdeflate_deflate_compress(zip->compressor, bytes, tried, zip->packed,
                                       tried - tried / 16) == 0;
}

/* Writes stored blocks, none of which is the stream's last. Returns the end of what it wrote. */
static uint8_t *store(const uint8_t *bytes, size_t size, uint8_t *out)
{
    while (size > 0) {
        const size_t n = size < STORED_BYTES ? size : STORED_BYTES;
        const uint8_t header[BLOCK_HEADER_BYTES] = {0, (uint8_t)n, (uint8_t)(n >> 8), (uint8_t)~n,
                                                    (uint8_t)(~n >> 8)};
        memcpy(out, header, sizeof header);
        memcpy(out + sizeof header, bytes, n);
        out += sizeof header + n;
        bytes += n;
        size -= n;
    }
    return out;
}

/* Packs zip->ordered as fmt_exr_zip_pack() does; the first `stored` bytes become stored blocks. */
static size_t pack_after_stored(struct fmt_exr_zip *zip, size_t stored, size_t size)
{
    const size_t blocks = (stored + STORED_BYTES - 1) / STORED_BYTES;
    const size_t fixed = stored + blocks * BLOCK_HEADER_BYTES + STREAM_BYTES;
    if (fixed >= size)
        return 0;
    memcpy(zip->packed, zlib_header, sizeof zlib_header);
    uint8_t *out = store(zip->ordered, stored, zip->packed + sizeof zlib_header);
    size_t packed = libdeflate_deflate_compress(zip->compressor, zip->ordered + stored,
                                                size - stored, out, size - 1 - fixed);
    if (packed == 0)
        return 0;
    const uint32_t sum = libdeflate_adler32(1, zip->ordered, size);
    const uint8_t checksum[4] = {(uint8_t)(sum >> 24), (uint8_t)(sum >> 16), (uint8_t)(sum >> 8),
                                 (uint8_t)sum};
    memcpy(out + packed, checksum, sizeof checksum);
    return fixed + packed;
}

size_t fmt_exr_zip_pack(struct fmt_exr_zip *zip, const uint8_t *chunk, size_t size)
{
    if (size == 0)
        return 0;
    order(chunk, size, zip->ordered);
    const size_t half = (size + 1) / 2;
    if (is_noise(zip, zip->ordered, half))
        return pack_after_stored(zip, half, size);
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
