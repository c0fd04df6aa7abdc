/* gzip_codec.c - unpacks gzip files (RFC 1952) with ISA-L, which checks CRC and length.
 *
 * ISA-L inflates twice as fast as zlib, and streams, which libdeflate does not (docs/decisions).
 * Zeros after the last member are padding, as of tapes, and are skipped as gzip(1) does. */
#include <isa-l/igzip_lib.h>

#include "formats/input/unpack.h"

struct gzip {
    struct inflate_state inflate;
    bool inside; /* of a member */
};

static int create(struct bsq_ctx *ctx, void **codec)
{
    return bsq_calloc(ctx, "unpacking", 1, sizeof(struct gzip), codec);
}

static void destroy(struct bsq_ctx *ctx, void *codec)
{
    bsq_free(ctx, codec);
}

static void skip_zeros(struct unpack_span *span)
{
    while (span->in_size > 0 && *span->in == 0) {
        span->in++;
        span->in_size--;
    }
}

/* Returns whether the bytes can be the start of a member, also if there is only one. */
static bool begins_member(const struct unpack_span *span)
{
    return span->in[0] == 0x1f && (span->in_size < 2 || span->in[1] == 0x8b);
}

static const char *describe(int result)
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

static enum unpack_state step(void *codec, struct unpack_span *span, const char **why, int *failure)
{
    struct gzip *gzip = codec;
    struct inflate_state *inflate = &gzip->inflate;
    (void)failure;
    if (!gzip->inside) {
        skip_zeros(span);
        if (span->in_size == 0)
            return UNPACK_ENDED;
        if (!begins_member(span)) {
            *why = "bytes after the packed data that are no gzip member";
            return UNPACK_DAMAGED;
        }
        isal_inflate_init(inflate);
        inflate->crc_flag = ISAL_GZIP;
        gzip->inside = true;
    }
    inflate->next_in = (uint8_t *)span->in;
    inflate->avail_in = (uint32_t)span->in_size;
    inflate->next_out = span->out;
    inflate->avail_out = span->out_size < UINT32_MAX ? (uint32_t)span->out_size : UINT32_MAX;
    const uint32_t space = inflate->avail_out;
    const int result = isal_inflate(inflate);
    span->in = inflate->next_in;
    span->in_size = inflate->avail_in;
    span->out += space - inflate->avail_out;
    span->out_size -= space - inflate->avail_out;
    if (result < 0) {
        *why = describe(result);
        return UNPACK_DAMAGED;
    }
    gzip->inside = inflate->block_state != ISAL_BLOCK_FINISH;
    return gzip->inside ? UNPACK_MORE : UNPACK_ENDED;
}

const struct unpack_codec fmt_gzip_codec = {
    .name = "gzip", .create = create, .free = destroy, .step = step};
