/* nvdb_stream.c - a section of a .nvdb file that grows in a temporary file.
 *
 * Bytes are hashed a buffer at a time while they are still in the cache. */
#include <xxhash.h>

#include "formats/grid/nvdb_writer_internal.h"

int fmt_nvdb_stream_open(struct bsq_ctx *ctx, const char *beside, const char *what, bool hashed,
                         struct nvdb_stream *stream)
{
    *stream = (struct nvdb_stream){.ctx = ctx, .file = BSQ_FILE_CLOSED};
    int status = bsq_alloc(ctx, "grid section buffer", NVDB_STREAM_BYTES, 1, &stream->buffer);
    if (status)
        return status;
    if (hashed) {
        stream->hash = XXH3_createState();
        if (!stream->hash)
            return bsq_fail(ctx, BSQ_ENOMEM, "no memory for a checksum");
        XXH3_64bits_reset(stream->hash);
    }
    return bsq_file_temp(ctx, beside, what, &stream->file);
}

void fmt_nvdb_stream_close(struct nvdb_stream *stream)
{
    if (!stream->ctx)
        return;
    bsq_file_close(stream->ctx, &stream->file);
    bsq_free(stream->ctx, stream->buffer);
    XXH3_freeState(stream->hash);
    *stream = (struct nvdb_stream){0};
}

int fmt_nvdb_stream_room(struct nvdb_stream *stream, uint64_t size, void *out)
{
    assert(size <= NVDB_STREAM_BYTES);
    if (stream->fill + size > NVDB_STREAM_BYTES) {
        int status = fmt_nvdb_stream_flush(stream);
        if (status)
            return status;
    }
    *(void **)out = stream->buffer + stream->fill;
    return 0;
}

int fmt_nvdb_stream_flush(struct nvdb_stream *stream)
{
    if (stream->fill == 0)
        return 0;
    if (stream->hash)
        XXH3_64bits_update(stream->hash, stream->buffer, (size_t)stream->fill);
    int status = bsq_file_append(stream->ctx, &stream->file, stream->buffer, stream->fill);
    stream->fill = 0;
    return status;
}

int fmt_nvdb_stream_end(struct nvdb_stream *stream)
{
    int status = fmt_nvdb_stream_flush(stream);
    bsq_free(stream->ctx, stream->buffer);
    stream->buffer = NULL;
    return status;
}

uint64_t fmt_nvdb_stream_size(const struct nvdb_stream *stream)
{
    return stream->file.size + stream->fill;
}
