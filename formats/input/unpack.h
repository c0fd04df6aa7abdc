/* unpack.h - private to formats/input: unpacks a stream of bytes that gzip or Zstandard packed, and
 * turns text in UTF-16 into UTF-8 (utf16.h).
 *
 * Members of a gzip file, and frames of a Zstandard file, may lie side by side; their contents
 * follow each other. */
#ifndef FMT_INPUT_UNPACK_H
#define FMT_INPUT_UNPACK_H

#include "base/context.h"

enum packing { PACKING_NONE, PACKING_GZIP, PACKING_ZSTD };

/* Returns how a file is packed, by its first bytes: PACKING_HEAD_BYTES, or all if it has fewer. */
enum packing fmt_packing_of(const uint8_t *head, uint64_t size);
#define PACKING_HEAD_BYTES 4

/* Gives the next packed bytes, at most `size`; *got is 0 only at the end. */
typedef int unpack_source(void *arg, void *buffer, uint64_t size, uint64_t *got);

struct unpacker;

/* `arg` must live as long as the unpacker. Errors: BSQ_ENOMEM. */
int fmt_unpack_create(struct bsq_ctx *ctx, unpack_source *source, void *arg, struct unpacker **out);
void fmt_unpack_free(struct unpacker *unpacker); /* NULL is allowed */

/* Unpacks the next bytes; *got < size only at the end. For damage returns BSQ_EDATA and describes
 * it in fmt_unpack_error(), but not in the context: whoever wants these bytes reports it. Errors:
 * BSQ_ENOMEM, also for a file that needs a larger window than the budget allows; those of the
 * source. */
int fmt_unpack_read(struct unpacker *unpacker, void *buffer, uint64_t size, uint64_t *got);
const char *fmt_unpack_error(const struct unpacker *unpacker);
/* Returns the packed bytes whose contents were returned so far, within some KiB. */
uint64_t fmt_unpack_taken(const struct unpacker *unpacker);
/* Returns how the stream is packed, in any text, after the first fmt_unpack_read(). */
enum packing fmt_unpack_packing(const struct unpacker *unpacker);

/* ---- codecs ---- */

/* Packed bytes that are in memory, and the space for unpacked ones. */
struct unpack_span {
    const uint8_t *in;
    uint64_t in_size;
    bool last; /* no bytes follow those at `in` */
    uint8_t *out;
    uint64_t out_size;
};

enum unpack_state {
    UNPACK_MORE,    /* needs more packed bytes or more space */
    UNPACK_ENDED,   /* a member has ended; the next packed byte, if any, begins another one */
    UNPACK_DAMAGED, /* *why says what is wrong at the first byte of span->in */
    UNPACK_FAILED   /* the status is in *failure */
};

/* Unpacks one kind of packed stream. */
struct unpack_codec {
    const char *name; /* "gzip" */
    int (*create)(struct bsq_ctx *ctx, void **codec);
    void (*free)(struct bsq_ctx *ctx, void *codec);
    /* Unpacks as much as possible and advances the span. */
    enum unpack_state (*step)(void *codec, struct unpack_span *span, const char **why,
                              int *failure);
};

extern const struct unpack_codec fmt_gzip_codec, fmt_zstd_codec;

#endif
