/* zstd_codec.c - unpacks Zstandard files (RFC 8878) with libzstd.
 *
 * libzstd allocates its window itself. So the header of each frame is read here first, and the
 * window is reserved from the budget. */
#include <stdio.h>
#include <string.h>
#include <zstd.h>
#include <zstd_errors.h>

#include "formats/input/unpack.h"

/* Memory of a decoder beside its window: tables, a block of input, and two blocks of output. */
enum { DECODER_BYTES = 640 << 10 };
/* The longest header of a frame, from its magic number on. */
enum { HEADER_BYTES = 18 };

struct zstd {
    struct bsq_ctx *ctx;
    ZSTD_DStream *stream;
    uint64_t reserved;
    bool inside; /* of a frame */
    char why[100];
};

static void destroy(struct bsq_ctx *ctx, void *codec)
{
    struct zstd *zstd = codec;
    ZSTD_freeDStream(zstd->stream);
    bsq_release(ctx, zstd->reserved);
    bsq_free(ctx, zstd);
}

static int reserve(struct zstd *zstd, uint64_t bytes)
{
    if (bytes <= zstd->reserved)
        return 0;
    int status = bsq_reserve(zstd->ctx, "the window of a Zstandard file", bytes - zstd->reserved);
    if (!status)
        zstd->reserved = bytes;
    return status;
}

static int create(struct bsq_ctx *ctx, void **codec)
{
    struct zstd *zstd;
    int status = bsq_calloc(ctx, "unpacking", 1, sizeof *zstd, &zstd);
    if (status)
        return status;
    zstd->ctx = ctx;
    status = reserve(zstd, DECODER_BYTES);
    zstd->stream = status ? NULL : ZSTD_createDStream();
    if (!status && !zstd->stream)
        status = bsq_fail(ctx, BSQ_ENOMEM, "no memory for unpacking");
    /* The window is reserved before it is used, so the budget limits it. */
    if (!status)
        ZSTD_DCtx_setParameter(zstd->stream, ZSTD_d_windowLogMax,
                               ZSTD_dParam_getBounds(ZSTD_d_windowLogMax).upperBound);
    if (status)
        destroy(ctx, zstd);
    else
        *codec = zstd;
    return status;
}

static uint64_t load(const uint8_t *from, unsigned bytes)
{
    uint64_t value = 0;
    for (unsigned i = 0; i < bytes; i++)
        value |= (uint64_t)from[i] << 8 * i;
    return value;
}

/* Returns the window in bytes of the frame whose header begins at `in`; 0 if there are too few
 * bytes to tell, or if it is no frame. */
static uint64_t window_of(const uint8_t *in, uint64_t size)
{
    static const unsigned id_bytes[] = {0, 1, 2, 4};
    if (size < 6 || load(in, 4) != 0xfd2fb528)
        return 0;
    const unsigned descriptor = in[4], content = descriptor >> 6;
    if (!(descriptor >> 5 & 1)) {
        const uint64_t base = (uint64_t)1 << (10 + (in[5] >> 3));
        return base + base / 8 * (in[5] & 7);
    }
    /* A single segment: the window is the content. */
    const unsigned at = 5 + id_bytes[descriptor & 3], bytes = 1u << content;
    if (size < at + bytes)
        return 0;
    return load(in + at, bytes) + (bytes == 2 ? 256 : 0);
}

static enum unpack_state begin_frame(struct zstd *zstd, const struct unpack_span *span,
                                     int *failure)
{
    if (span->in_size < HEADER_BYTES && !span->last)
        return UNPACK_MORE;
    const uint64_t window = window_of(span->in, span->in_size);
    if (window > UINT64_MAX - DECODER_BYTES)
        *failure = bsq_fail(zstd->ctx, BSQ_ENOMEM, "a Zstandard file has a window of 2^64 bytes");
    else
        *failure = reserve(zstd, window + DECODER_BYTES);
    zstd->inside = *failure == 0;
    return *failure ? UNPACK_FAILED : UNPACK_ENDED;
}

static enum unpack_state step(void *codec, struct unpack_span *span, const char **why, int *failure)
{
    struct zstd *zstd = codec;
    if (!zstd->inside) {
        const enum unpack_state state = begin_frame(zstd, span, failure);
        if (state != UNPACK_ENDED)
            return state;
    }
    ZSTD_inBuffer in = {span->in, span->in_size, 0};
    ZSTD_outBuffer out = {span->out, span->out_size, 0};
    const size_t result = ZSTD_decompressStream(zstd->stream, &out, &in);
    span->in += in.pos;
    span->in_size -= in.pos;
    span->out += out.pos;
    span->out_size -= out.pos;
    if (ZSTD_getErrorCode(result) == ZSTD_error_memory_allocation) {
        *failure = bsq_fail(zstd->ctx, BSQ_ENOMEM, "no memory for unpacking");
        return UNPACK_FAILED;
    }
    if (ZSTD_isError(result)) {
        snprintf(zstd->why, sizeof zstd->why, "damaged Zstandard data: %s",
                 ZSTD_getErrorName(result));
        *why = zstd->why;
        return UNPACK_DAMAGED;
    }
    zstd->inside = result != 0;
    return zstd->inside ? UNPACK_MORE : UNPACK_ENDED;
}

const struct unpack_codec fmt_zstd_codec = {
    .name = "Zstandard", .create = create, .free = destroy, .step = step};
