/* unpack.c - see unpack.h.
 *
 * ISA-L inflates gzip twice as fast as zlib, and streams, which libdeflate does not
 * (docs/decisions). libzstd allocates its window itself. So the header of each frame is read here
 * first, and the window is reserved from the budget. */
#include "formats/input/unpack.h"

#include "base/bytes.h"
#include <inttypes.h>
#include <isa-l/igzip_lib.h>
#include <stdio.h>
#include <string.h>
#include <zstd.h>
#include <zstd_errors.h>

/* Packed bytes that are read at once. Fuzz targets have small files, which take several reads too.
 */
#ifdef FUZZING_BUILD_MODE_UNSAFE_FOR_PRODUCTION
enum { IN_BYTES = 64 };
#else
enum { IN_BYTES = 128 << 10 };
#endif

enum packing { PACKING_NONE, PACKING_GZIP, PACKING_ZSTD };

struct unpacker {
    struct bsq_ctx *ctx;
    unpack_source *source;
    void *arg;
    enum packing packing;
    struct inflate_state *gzip;
    ZSTD_DStream *zstd;
    uint64_t zstd_bytes;       /* reserved for it */
    uint8_t *in;               /* IN_BYTES */
    uint64_t in_begin, in_end; /* packed bytes that are not unpacked yet */
    uint64_t given;            /* bytes that the source gave */
    bool started, source_ended;
    bool inside; /* a member or frame */

    uint8_t *out; /* `step` bytes */
    uint64_t step;
    char error[160];
};

/* ---- recognising ---- */

static enum packing packing_of(const uint8_t *head, uint64_t size)
{
    /* A file that is cut off after some of these bytes is a damaged one. */
    if (size >= 2 && memcmp(head, "\x1f\x8b\x08", size < 3 ? size : 3) == 0)
        return PACKING_GZIP;
    if (size < UNPACK_HEAD_BYTES)
        return size >= 2 && memcmp(head, "\x28\xb5\x2f", size) == 0 ? PACKING_ZSTD : PACKING_NONE;
    const uint64_t magic = bsq_little(head, 4);
    /* A frame, or a frame to be skipped, which pzstd writes first. */
    return magic == 0xfd2fb528 || (magic & 0xfffffff0) == 0x184d2a50 ? PACKING_ZSTD : PACKING_NONE;
}

bool fmt_unpack_recognise(const uint8_t *head, uint64_t size)
{
    return packing_of(head, size) != PACKING_NONE;
}

/* ---- packed bytes ---- */

static int fail(struct unpacker *u, const char *why, const char *detail)
{
    snprintf(u->error, sizeof u->error, "byte %" PRIu64 ": %s%s",
             u->given - (u->in_end - u->in_begin), why, detail);
    return BSQ_EDATA;
}

/* Moves the packed bytes to the start of the buffer and fills the rest. */
static int refill(struct unpacker *u)
{
    uint64_t have = u->in_end - u->in_begin, got = 0;
    memmove(u->in, u->in + u->in_begin, have);
    u->in_begin = 0;
    u->in_end = have;
    if (u->source_ended || have == IN_BYTES)
        return 0;
    int status = u->source(u->arg, u->in + have, IN_BYTES - have, &got);
    u->in_end += got;
    u->given += got;
    u->source_ended = status == 0 && got == 0;
    return status;
}

static const char *describe_gzip(int result)
{
    switch (result) {
    case ISAL_INCORRECT_CHECKSUM:
        return "damaged: the gzip checksum or length does not match";
    case ISAL_INVALID_WRAPPER:
    case ISAL_UNSUPPORTED_METHOD:
        return "these bytes are no gzip member";
    default:
        return "damaged: the gzip data make no sense";
    }
}

/* Begins a member, if one is there. Zeros after the last member are padding, as of tapes, and are
 * skipped as gzip(1) does. */
static int begin_member(struct unpacker *u)
{
    while (u->in_begin < u->in_end && u->in[u->in_begin] == 0)
        u->in_begin++;
    const uint8_t *in = u->in + u->in_begin;
    const uint64_t have = u->in_end - u->in_begin;
    if (have == 0)
        return 0;
    if (in[0] != 0x1f || (have > 1 && in[1] != 0x8b))
        return fail(u, "bytes after the packed data that are no gzip member", "");
    isal_inflate_init(u->gzip);
    u->gzip->crc_flag = ISAL_GZIP;
    u->inside = true;
    return 0;
}

static int step_gzip(struct unpacker *u, uint8_t *out, uint64_t size, uint64_t *got)
{
    struct inflate_state *gzip = u->gzip;
    const uint32_t space = size < UINT32_MAX ? (uint32_t)size : UINT32_MAX;
    int status = u->inside ? 0 : begin_member(u);
    if (!u->inside)
        return status;
    gzip->next_in = u->in + u->in_begin;
    gzip->avail_in = (uint32_t)(u->in_end - u->in_begin);
    gzip->next_out = out;
    gzip->avail_out = space;
    const int result = isal_inflate(gzip); /* checks CRC and length, too */
    u->in_begin = u->in_end - gzip->avail_in;
    *got = space - gzip->avail_out;
    if (result < 0)
        return fail(u, describe_gzip(result), "");
    u->inside = gzip->block_state != ISAL_BLOCK_FINISH;
    return 0;
}

/* Memory of a Zstandard decoder beside its window: tables, a block of input, and two blocks of
 * output. */
enum { DECODER_BYTES = 640 << 10 };
/* The longest header of a frame, from its magic number on. */
enum { FRAME_HEADER_BYTES = 18 };

/* Returns the window in bytes of the frame whose header begins at `in`; 0 if there are too few
 * bytes to tell, or if it is no frame. */
static uint64_t window_of(const uint8_t *in, uint64_t size)
{
    static const unsigned id_bytes[] = {0, 1, 2, 4};
    if (size < 6 || bsq_little(in, 4) != 0xfd2fb528)
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
    return bsq_little(in + at, bytes) + (bytes == 2 ? 256 : 0);
}

static int reserve_zstd(struct unpacker *u, uint64_t bytes)
{
    if (bytes <= u->zstd_bytes)
        return 0;
    int status = bsq_reserve(u->ctx, "the window of a Zstandard file", bytes - u->zstd_bytes);
    u->zstd_bytes = status == 0 ? bytes : u->zstd_bytes;
    return status;
}

/* Begins a frame, if its header is there. */
static int begin_frame(struct unpacker *u)
{
    const uint64_t have = u->in_end - u->in_begin;
    if (have == 0 || (have < FRAME_HEADER_BYTES && !u->source_ended))
        return 0;
    const uint64_t window = window_of(u->in + u->in_begin, have);
    if (window > UINT64_MAX - DECODER_BYTES)
        return bsq_fail(u->ctx, BSQ_ENOMEM, "a Zstandard file has a window of 2^64 bytes");
    int status = reserve_zstd(u, window + DECODER_BYTES);
    u->inside = status == 0;
    return status;
}

static int step_zstd(struct unpacker *u, uint8_t *out, uint64_t size, uint64_t *got)
{
    int status = u->inside ? 0 : begin_frame(u);
    if (!u->inside)
        return status;
    ZSTD_inBuffer from = {u->in, u->in_end, u->in_begin};
    ZSTD_outBuffer to = {out, size, 0};
    const size_t result = ZSTD_decompressStream(u->zstd, &to, &from);
    u->in_begin = from.pos;
    *got = to.pos;
    if (ZSTD_getErrorCode(result) == ZSTD_error_memory_allocation)
        return bsq_fail(u->ctx, BSQ_ENOMEM, "no memory for unpacking");
    if (ZSTD_isError(result))
        return fail(u, "damaged Zstandard data: ", ZSTD_getErrorName(result));
    u->inside = result != 0;
    return 0;
}

/* Fills the buffer with the stream's first bytes and makes the decoder. */
static int unpack_start(struct unpacker *u)
{
    while (!u->source_ended && u->in_end < UNPACK_HEAD_BYTES)
        BSQ_PASS(refill(u));
    u->packing = packing_of(u->in, u->in_end);
    u->started = true;
    if (u->packing == PACKING_GZIP)
        BSQ_PASS(BSQ_CALLOC(u->ctx, "unpacking", 1, &u->gzip));
    if (u->packing != PACKING_ZSTD)
        return 0;
    BSQ_PASS(reserve_zstd(u, DECODER_BYTES));
    u->zstd = ZSTD_createDStream();
    if (!u->zstd)
        return bsq_fail(u->ctx, BSQ_ENOMEM, "no memory for unpacking");
    /* The window is reserved before it is used, so the budget limits it. */
    ZSTD_DCtx_setParameter(u->zstd, ZSTD_d_windowLogMax,
                           ZSTD_dParam_getBounds(ZSTD_d_windowLogMax).upperBound);
    return 0;
}

static int copy_plain(struct unpacker *u, uint8_t *out, uint64_t size, uint64_t *got)
{
    const uint64_t have = u->in_end - u->in_begin;
    *got = have < size ? have : size;
    memcpy(out, u->in + u->in_begin, *got);
    u->in_begin += *got;
    return 0;
}

/* Unpacks what is in memory. */
static int step(struct unpacker *u, uint8_t *out, uint64_t size, uint64_t *got)
{
    const uint64_t before = u->in_begin;
    int status = u->packing == PACKING_GZIP   ? step_gzip(u, out, size, got)
                 : u->packing == PACKING_ZSTD ? step_zstd(u, out, size, got)
                                              : copy_plain(u, out, size, got);
    if (status || u->in_begin > before || *got > 0 || !u->inside)
        return status;
    /* Nothing more can come: the stream ends in the middle of a member. */
    if (u->source_ended)
        return fail(u, "truncated: the packed data end too early", "");
    return u->in_end - u->in_begin == IN_BYTES
               ? fail(u, "damaged: the packed data make no sense", "")
               : 0;
}

/* Unpacks `size` bytes; *got < size only at the end or after a failure. */
static int unpack_read_bytes(struct unpacker *u, uint8_t *out, uint64_t size, uint64_t *got)
{
    int status = u->started ? 0 : unpack_start(u);
    *got = 0;
    while (!status && *got < size) {
        uint64_t more = 0;
        const uint64_t before = u->in_begin;
        status = step(u, out + *got, size - *got, &more);
        *got += more;
        if (status || more > 0)
            continue;
        if (u->source_ended && u->in_end == u->in_begin && !u->inside)
            break;
        /* The decoder may have gone on to the next member without giving bytes. */
        if (u->in_begin == before)
            status = refill(u);
        if (!status)
            status = bsq_check(u->ctx);
    }
    return status;
}

int fmt_unpack_next(struct unpacker *u, const uint8_t **bytes, uint64_t *size)
{
    *bytes = u->out;
    BSQ_PASS(unpack_read_bytes(u, u->out, u->step, size));
    return *size == u->step;
}

/* ---- all ---- */

int fmt_unpack_create(struct bsq_ctx *ctx, unpack_source *source, void *arg, uint64_t step_bytes,
                      struct unpacker **out)
{
    struct unpacker *u;
    int status;
    *out = NULL;
    BSQ_PASS(BSQ_CALLOC(ctx, "unpacking", 1, &u));
    *u = (struct unpacker){.ctx = ctx, .source = source, .arg = arg, .step = step_bytes};
    BSQ_TRY(bsq_alloc(ctx, "unpacking", IN_BYTES, 1, &u->in));
    BSQ_TRY(bsq_alloc(ctx, "unpacking", step_bytes, 1, &u->out));
    *out = u;
done:
    if (status < 0)
        fmt_unpack_free(u);
    return status;
}

void fmt_unpack_free(struct unpacker *u)
{
    if (!u)
        return;
    ZSTD_freeDStream(u->zstd);
    bsq_release(u->ctx, u->zstd_bytes);
    BSQ_FREE(u->ctx, u->gzip, u->out, u->in, u);
}

const char *fmt_unpack_error(const struct unpacker *u)
{
    return u->error;
}
