/* packing.c - see packing.h. */
#include "tests/unit/fixture.h"
#include "tests/unit/formats/input/packing.h"

#include <zlib.h>
#include <zstd.h>

/* Makes space for `more` bytes at the end. */
static uint8_t *grow(struct packed *to, size_t more)
{
    to->data = realloc(to->data, to->size + more + 1);
    assert_non_null(to->data);
    return to->data + to->size;
}

void pack_bytes(struct packed *to, const void *from, size_t size)
{
    memcpy(grow(to, size), from, size);
    to->size += size;
}

void pack_gzip(struct packed *to, const void *from, size_t size, int level)
{
    z_stream z = {0};
    assert_int_equal(deflateInit2(&z, level, Z_DEFLATED, 15 + 16, 8, Z_DEFAULT_STRATEGY), Z_OK);
    size_t most = deflateBound(&z, size);
    z.next_out = grow(to, most);
    z.avail_out = (unsigned)most;
    z.next_in = (uint8_t *)from;
    z.avail_in = (unsigned)size;
    assert_int_equal(deflate(&z, Z_FINISH), Z_STREAM_END);
    to->size += most - z.avail_out;
    deflateEnd(&z);
}

void pack_zstd(struct packed *to, const void *from, size_t size, int window_log)
{
    ZSTD_CCtx *z = ZSTD_createCCtx();
    ZSTD_CCtx_setParameter(z, ZSTD_c_checksumFlag, 1);
    ZSTD_CCtx_setParameter(z, ZSTD_c_contentSizeFlag, 0);
    ZSTD_CCtx_setParameter(z, ZSTD_c_windowLog, window_log);
    size_t most = ZSTD_compressBound(size);
    ZSTD_outBuffer out = {grow(to, most), most, 0};
    ZSTD_inBuffer in = {from, size, 0};
    /* In two steps: a compressor that knows the size lowers the window to it. */
    ZSTD_compressStream2(z, &out, &in, ZSTD_e_continue);
    while (ZSTD_compressStream2(z, &out, &in, ZSTD_e_end) != 0)
        assert_true(out.pos < most);
    to->size += out.pos;
    ZSTD_freeCCtx(z);
}
