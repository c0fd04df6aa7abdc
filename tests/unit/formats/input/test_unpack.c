/* test_unpack.c - gzip and Zstandard streams: members side by side in pieces of every size, every
 * truncation, every damaged byte, and how much memory they may ask for. */
#include "formats/input/unpack.h"
#include "tests/unit/formats/input/packing.h"
#include "tests/unit/test.h"

/* A stream that is given in pieces of `piece` bytes. */
struct stream {
    const uint8_t *data;
    size_t size, at, piece;
};

static int give(void *arg, void *buffer, uint64_t size, uint64_t *got)
{
    struct stream *s = arg;
    *got = s->size - s->at;
    *got = *got < s->piece ? *got : s->piece;
    *got = *got < size ? *got : size;
    memcpy(buffer, s->data + s->at, *got);
    s->at += *got;
    return 0;
}

/* Unpacks all, at most `most` bytes, in steps. Returns the status; *size: the bytes unpacked. */
static int unpack(struct bsq_ctx *ctx, const uint8_t *data, size_t data_size, size_t piece,
                  size_t step, uint8_t *out, size_t most, size_t *size, char error[200])
{
    struct stream stream = {data, data_size, 0, piece};
    struct unpacker *unpacker;
    int status = fmt_unpack_create(ctx, give, &stream, step, &unpacker);
    *size = 0;
    error[0] = '\0';
    if (status)
        return status;
    for (status = 1; status > 0 && *size < most;) {
        const uint8_t *bytes;
        uint64_t got;
        status = fmt_unpack_next(unpacker, &bytes, &got);
        got = got < most - *size ? got : most - *size;
        memcpy(out + *size, bytes, got);
        *size += got;
    }
    status = status > 0 ? 0 : status;
    snprintf(error, 200, "%s", fmt_unpack_error(unpacker));
    fmt_unpack_free(unpacker);
    return status;
}

/* Text like that of a mesh, so that it packs well but not trivially. */
static void make_text(uint8_t *text, size_t size)
{
    uint32_t state = 7;
    for (size_t at = 0; at < size;) {
        char line[64];
        state = state * 1664525 + 1013904223;
        int length = snprintf(line, sizeof line, "v %u.%u 0.25 %u\n", state >> 28,
                              state >> 8 & 0xfff, state >> 20 & 15);
        size_t count = size - at < (size_t)length ? size - at : (size_t)length;
        memcpy(text + at, line, count);
        at += count;
    }
}

enum { TEXT = 60000 };

static void make_gzip(struct packed *p, const uint8_t *text)
{
    pack_gzip(p, text, 20000, 9);
    pack_gzip(p, text, 0, 6);
    pack_gzip(p, text + 20000, 30000, 0);
    pack_gzip(p, text + 50000, TEXT - 50000, 1);
    pack_bytes(p, "\0\0\0\0\0\0\0", 7); /* as tapes leave them */
}

static void make_zstd(struct packed *p, const uint8_t *text)
{
    pack_bytes(p, "\x50\x2a\x4d\x18\x04\0\0\0skip", 12);
    pack_zstd(p, text, 20000, 0);
    pack_zstd(p, text, 0, 0);
    pack_zstd(p, text + 20000, TEXT - 20000, 10);
}

static void (*const makers[])(struct packed *, const uint8_t *) = {make_gzip, make_zstd};

static struct bsq_ctx *make_context(uint64_t memory)
{
    struct bsq_ctx *ctx = test_context(1, memory);
    return ctx;
}

TEST(test_members_side_by_side_in_any_pieces)
{
    static uint8_t text[TEXT], out[TEXT + 1];
    static const size_t pieces[] = {1, 2, 3, 5, 17, 255, 4096, 1 << 20};
    static const size_t steps[] = {1, 7, 1000, TEXT + 1};
    char error[200];
    struct bsq_ctx *ctx = make_context(64 << 20);
    make_text(text, TEXT);
    for (int kind = 0; kind < 2; kind++) {
        struct packed p = {0};
        makers[kind](&p, text);
        for (size_t i = 0; i < sizeof pieces / sizeof *pieces; i++)
            for (size_t k = 0; k < sizeof steps / sizeof *steps; k++) {
                size_t size;
                assert_int_equal(
                    unpack(ctx, p.data, p.size, pieces[i], steps[k], out, TEXT + 1, &size, error),
                    0);
                assert_int_equal(size, TEXT);
                assert_memory_equal(out, text, TEXT);
            }
        free(p.data);
    }
    test_context_end(ctx);
}

/* A stream that is cut off is an error, unless the cut is between two members. */
TEST(test_every_truncation)
{
    static uint8_t text[300], out[301];
    char error[200];
    struct bsq_ctx *ctx = make_context(64 << 20);
    make_text(text, sizeof text);
    for (int kind = 0; kind < 2; kind++) {
        struct packed p = {0};
        void (*const pack)(struct packed *, const void *, size_t, int) =
            kind == 0 ? pack_gzip : pack_zstd;
        pack(&p, text, 200, kind == 0 ? 6 : 0);
        const size_t border = p.size;
        pack(&p, text + 200, 100, kind == 0 ? 6 : 0);
        for (size_t cut = 4; cut < p.size; cut++) {
            size_t size;
            int status = unpack(ctx, p.data, cut, 100, 64, out, sizeof out, &size, error);
            assert_int_equal(status, cut == border ? 0 : BSQ_EDATA);
            assert_true(size <= sizeof text && memcmp(out, text, size) == 0);
            if (cut != border)
                assert_non_null(strstr(error, "byte "));
        }
        free(p.data);
    }
    assert_string_equal(bsq_error(ctx), "");
    bsq_ctx_destroy(ctx);
}

/* Damage never changes what is read: it is found, or was in a byte that does not matter. */
TEST(test_every_flipped_bit)
{
    static uint8_t text[400], out[4096];
    char error[200];
    struct bsq_ctx *ctx = make_context(64 << 20);
    make_text(text, sizeof text);
    for (int kind = 0; kind < 2; kind++) {
        struct packed p = {0};
        unsigned found = 0;
        (kind == 0 ? pack_gzip : pack_zstd)(&p, text, sizeof text, kind == 0 ? 6 : 0);
        for (size_t bit = 8 * 4; bit < 8 * p.size; bit++) {
            size_t size;
            p.data[bit / 8] ^= (uint8_t)(1u << bit % 8);
            int status = unpack(ctx, p.data, p.size, 1000, 512, out, sizeof out, &size, error);
            p.data[bit / 8] ^= (uint8_t)(1u << bit % 8);
            bsq_clear_error(ctx);
            if (status == 0)
                assert_true(size == sizeof text && memcmp(out, text, size) == 0);
            found += status != 0;
        }
        assert_true(found > 8 * (p.size - 24)); /* all but the time and such */
        free(p.data);
    }
    test_context_end(ctx);
}

TEST(test_bytes_after_the_last_member)
{
    static uint8_t out[100];
    char error[200];
    size_t size;
    struct bsq_ctx *ctx = make_context(64 << 20);
    struct packed gzip = {0}, zstd = {0};
    pack_gzip(&gzip, "v 0 0 0\n", 8, 6);
    const size_t end = gzip.size;
    pack_bytes(&gzip, "\0rubbish that is no member", 26);
    assert_int_equal(unpack(ctx, gzip.data, gzip.size, 9, 100, out, 100, &size, error), BSQ_EDATA);
    assert_non_null(strstr(error, "bytes after the packed data that are no gzip member"));
    assert_true(strtoul(error + 5, NULL, 10) > end);
    pack_zstd(&zstd, "v 0 0 0\n", 8, 0);
    pack_bytes(&zstd, "rubbish", 7);
    assert_int_equal(unpack(ctx, zstd.data, zstd.size, 9, 100, out, 100, &size, error), BSQ_EDATA);
    assert_non_null(strstr(error, "damaged Zstandard data"));
    free(gzip.data);
    free(zstd.data);
    bsq_ctx_destroy(ctx);
}

/* A header can ask for a window of gigabytes. The budget limits it before memory is touched. */
TEST(test_windows_are_reserved)
{
    static uint8_t text[TEXT], out[TEXT + 1];
    char error[200];
    size_t size;
    struct packed p = {0};
    make_text(text, TEXT);
    pack_zstd(&p, text, TEXT, 27);
    struct bsq_ctx *ctx = make_context(16 << 20);
    assert_int_equal(unpack(ctx, p.data, p.size, 1 << 20, 4096, out, TEXT + 1, &size, error),
                     BSQ_ENOMEM);
    assert_non_null(strstr(bsq_error(ctx), "the window of a Zstandard file"));
    test_context_end(ctx);
    ctx = make_context(256 << 20);
    assert_int_equal(unpack(ctx, p.data, p.size, 1 << 20, 4096, out, TEXT + 1, &size, error), 0);
    assert_memory_equal(out, text, TEXT);
    assert_true(bsq_memory_high(ctx) > 128 << 20);
    test_context_end(ctx);
    free(p.data);
}

RUN_TESTS(NULL, NULL)
