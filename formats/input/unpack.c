/* unpack.c - see unpack.h. */
#include "formats/input/unpack.h"

#include <inttypes.h>
#include <stdio.h>
#include <string.h>

#include "formats/input/utf16.h"

/* Packed bytes that are read at once. Fuzz targets have small files, which take several reads too.
 */
#ifdef FUZZING_BUILD_MODE_UNSAFE_FOR_PRODUCTION
enum { IN_BYTES = 64 };
#else
enum { IN_BYTES = 128 << 10 };
#endif

/* Units of UTF-16 that are converted at once, and the bytes that they may become. */
enum { UNIT_BYTES = 32 << 10, TEXT_BYTES = 3 * UNIT_BYTES / 2 + 2 * UTF16_MAX_BYTES };

/* A stream of text in UTF-16. */
struct text {
    struct utf16 converter;
    uint8_t units[UNIT_BYTES], bytes[TEXT_BYTES];
    uint64_t unit_count; /* bytes of `units` that are not converted yet, from its start */
    uint64_t begin, end; /* of `bytes` that have not been given out yet */
    bool ended;          /* no more units come */
};

struct unpacker {
    struct bsq_ctx *ctx;
    unpack_source *source;
    void *arg;
    enum packing packing;
    const struct unpack_codec *codec; /* NULL: the bytes are not packed */
    void *codec_state;
    uint8_t *in;               /* IN_BYTES */
    uint64_t in_begin, in_end; /* packed bytes that are not unpacked yet */
    uint64_t taken;            /* packed bytes before in_begin, of the whole stream */
    bool started, source_ended;
    bool between; /* at the start of a member, or at the end of the stream */
    /* The first unpacked bytes, which tell whether they are text in UTF-16, and the status after
     * them. */
    uint8_t head[UTF16_HEAD_BYTES];
    uint64_t head_begin, head_end;
    bool head_read;
    int failure;
    struct text *text; /* NULL: bytes are given out as they are */
    char error[160];
};

enum packing fmt_packing_of(const uint8_t *head, uint64_t size)
{
    /* A file that is cut off after some of these bytes is a damaged one. */
    if (size >= 2 && memcmp(head, "\x1f\x8b\x08", size < 3 ? size : 3) == 0)
        return PACKING_GZIP;
    if (size < PACKING_HEAD_BYTES)
        return size >= 2 && memcmp(head, "\x28\xb5\x2f", size) == 0 ? PACKING_ZSTD : PACKING_NONE;
    const uint32_t magic =
        head[0] | (uint32_t)head[1] << 8 | (uint32_t)head[2] << 16 | (uint32_t)head[3] << 24;
    /* A frame, or a frame to be skipped, which pzstd writes first. */
    return magic == 0xfd2fb528 || (magic & 0xfffffff0) == 0x184d2a50 ? PACKING_ZSTD : PACKING_NONE;
}

int fmt_unpack_create(struct bsq_ctx *ctx, unpack_source *source, void *arg, struct unpacker **out)
{
    struct unpacker *u;
    int status = bsq_calloc(ctx, "unpacking", 1, sizeof *u, &u);
    *out = NULL;
    if (status)
        return status;
    *u = (struct unpacker){.ctx = ctx, .source = source, .arg = arg, .between = true};
    status = bsq_alloc(ctx, "unpacking", IN_BYTES, 1, &u->in);
    if (status)
        fmt_unpack_free(u);
    else
        *out = u;
    return status;
}

void fmt_unpack_free(struct unpacker *u)
{
    if (!u)
        return;
    if (u->codec_state)
        u->codec->free(u->ctx, u->codec_state);
    bsq_free(u->ctx, u->text);
    bsq_free(u->ctx, u->in);
    bsq_free(u->ctx, u);
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
    u->source_ended = status == 0 && got == 0;
    return status;
}

/* Fills the buffer with the stream's first bytes and chooses the codec. */
static int start(struct unpacker *u)
{
    int status = 0;
    while (!status && !u->source_ended && u->in_end < PACKING_HEAD_BYTES)
        status = refill(u);
    if (status)
        return status;
    u->packing = fmt_packing_of(u->in, u->in_end);
    u->codec = u->packing == PACKING_GZIP   ? &fmt_gzip_codec
               : u->packing == PACKING_ZSTD ? &fmt_zstd_codec
                                            : NULL;
    u->started = true;
    return u->codec ? u->codec->create(u->ctx, &u->codec_state) : 0;
}

static int copy_plain(struct unpacker *u, uint8_t *buffer, uint64_t size, uint64_t *got)
{
    const uint64_t have = u->in_end - u->in_begin;
    *got = have < size ? have : size;
    memcpy(buffer, u->in + u->in_begin, *got);
    u->in_begin += *got;
    u->taken += *got;
    return 0;
}

static int fail(struct unpacker *u, const char *why)
{
    snprintf(u->error, sizeof u->error, "byte %" PRIu64 ": %s", u->taken, why);
    return BSQ_EDATA;
}

/* Unpacks what is in memory. */
static int step(struct unpacker *u, uint8_t *buffer, uint64_t size, uint64_t *got)
{
    struct unpack_span span = {.in = u->in + u->in_begin,
                               .in_size = u->in_end - u->in_begin,
                               .last = u->source_ended,
                               .out = buffer,
                               .out_size = size};
    const char *why = "";
    int failure = 0;
    if (u->between && span.in_size == 0)
        return 0;
    const enum unpack_state state = u->codec->step(u->codec_state, &span, &why, &failure);
    const uint64_t used = u->in_end - u->in_begin - span.in_size;
    *got = size - span.out_size;
    u->in_begin += used;
    u->taken += used;
    u->between = state == UNPACK_ENDED;
    if (state == UNPACK_FAILED)
        return failure;
    if (state == UNPACK_DAMAGED)
        return fail(u, why);
    if (used > 0 || *got > 0 || u->between)
        return 0;
    /* Nothing more can come: the stream ends in the middle of a member. */
    if (u->source_ended)
        return fail(u, "truncated: the packed data end too early");
    return u->in_end - u->in_begin == IN_BYTES ? fail(u, "damaged: the packed data make no sense")
                                               : 0;
}

/* Unpacks the next bytes of any kind, as fmt_unpack_read() does. */
static int read_bytes(struct unpacker *u, void *buffer, uint64_t size, uint64_t *got)
{
    int status = u->started ? 0 : start(u);
    *got = 0;
    while (!status && *got < size) {
        uint64_t more = 0;
        const uint64_t before = u->in_end - u->in_begin;
        uint8_t *to = (uint8_t *)buffer + *got;
        status = u->codec ? step(u, to, size - *got, &more) : copy_plain(u, to, size - *got, &more);
        *got += more;
        if (status || more > 0)
            continue;
        if (u->source_ended && u->in_end == u->in_begin && (u->between || !u->codec))
            break;
        /* The codec may have gone on to the next member without giving bytes. */
        if (u->in_end - u->in_begin == before || before == 0)
            status = refill(u);
        if (!status)
            status = bsq_check(u->ctx);
    }
    return status;
}

/* ---- text ---- */

/* Reads the first bytes and decides whether they are text in UTF-16. */
static int read_head(struct unpacker *u)
{
    u->head_read = true;
    u->failure = read_bytes(u, u->head, sizeof u->head, &u->head_end);
    if (u->failure && u->failure != BSQ_EDATA)
        return u->failure;
    if (!fmt_utf16_recognise(u->head, u->head_end))
        return 0;
    int status = bsq_calloc(u->ctx, "text in UTF-16", 1, sizeof *u->text, &u->text);
    if (status)
        return status;
    u->text->converter.big_endian = u->head[0] == 0xfe;
    memcpy(u->text->units, u->head, u->head_end);
    u->text->unit_count = u->head_end;
    return 0;
}

/* Fills text->bytes. Keeps what is wrong in u->failure until all bytes before it are given out. */
static void convert(struct unpacker *u)
{
    struct text *t = u->text;
    uint64_t more = 0, used;
    if (!u->failure && !t->ended) {
        const uint64_t space = UNIT_BYTES - t->unit_count;
        u->failure = read_bytes(u, t->units + t->unit_count, space, &more);
        t->unit_count += more;
        t->ended = !u->failure && more < space;
    }
    fmt_utf16_convert(&t->converter, t->units, t->unit_count, t->ended, t->bytes, TEXT_BYTES, &used,
                      &t->end);
    t->begin = 0;
    t->unit_count -= used;
    memmove(t->units, t->units + used, t->unit_count);
    if (t->ended && t->unit_count > 0)
        u->failure = fail(u, "truncated: text in UTF-16 ends in the middle of a character");
}

static int read_text(struct unpacker *u, uint8_t *buffer, uint64_t size, uint64_t *got)
{
    struct text *t = u->text;
    while (*got < size) {
        if (t->begin == t->end && !u->failure && !t->ended)
            convert(u);
        if (t->begin == t->end)
            return u->failure;
        const uint64_t have = t->end - t->begin, wanted = size - *got;
        const uint64_t count = have < wanted ? have : wanted;
        memcpy(buffer + *got, t->bytes + t->begin, count);
        t->begin += count;
        *got += count;
    }
    return 0;
}

int fmt_unpack_read(struct unpacker *u, void *buffer, uint64_t size, uint64_t *got)
{
    uint64_t more = 0;
    *got = 0;
    int status = u->head_read ? 0 : read_head(u);
    if (status)
        return status;
    if (u->text)
        return read_text(u, buffer, size, got);
    for (; *got < size && u->head_begin < u->head_end; ++*got)
        ((uint8_t *)buffer)[*got] = u->head[u->head_begin++];
    if (*got == size || u->failure)
        return *got == size ? 0 : u->failure;
    status = read_bytes(u, (uint8_t *)buffer + *got, size - *got, &more);
    *got += more;
    return status;
}

const char *fmt_unpack_error(const struct unpacker *u)
{
    return u->error;
}

uint64_t fmt_unpack_taken(const struct unpacker *u)
{
    return u->taken;
}

enum packing fmt_unpack_packing(const struct unpacker *u)
{
    return u->packing;
}
