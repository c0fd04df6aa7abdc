/* nvdb_stream.c - sections of a grid file that grow through a buffer in a temporary file. */
#include <string.h>
#include <xxhash.h>

#include "formats/grid/nvdb_writer_internal.h"

int fmt_nvdb_stream_open(struct bsq_ctx *ctx, const char *beside, const char *what,
                         struct nvdb_stream *stream)
{
    *stream = (struct nvdb_stream){.ctx = ctx, .file = BSQ_FILE_CLOSED};
    int status = bsq_alloc(ctx, "grid section buffer", NVDB_STREAM_BYTES, 1, &stream->buffer);
    if (status)
        return status;
    stream->written = XXH3_createState();
    stream->read = XXH3_createState();
    if (!stream->written || !stream->read)
        return bsq_fail(ctx, BSQ_ENOMEM, "no memory for a checksum");
    XXH3_64bits_reset(stream->written);
    XXH3_64bits_reset(stream->read);
    return bsq_file_temp(ctx, beside, what, &stream->file);
}

void fmt_nvdb_stream_close(struct nvdb_stream *stream)
{
    if (!stream->ctx)
        return;
    bsq_file_close(stream->ctx, &stream->file);
    bsq_free(stream->ctx, stream->buffer);
    XXH3_freeState(stream->written);
    XXH3_freeState(stream->read);
    *stream = (struct nvdb_stream){0};
}

/* Hashes the buffer while it is in the cache, and appends it to the file. */
static int stream_flush(struct nvdb_stream *stream)
{
    if (stream->fill == 0)
        return 0;
    XXH3_64bits_update(stream->written, stream->buffer, (size_t)stream->fill);
    int status = bsq_file_append(stream->ctx, &stream->file, stream->buffer, stream->fill);
    stream->size += stream->fill;
    stream->fill = 0;
    return status;
}

int fmt_nvdb_stream_reserve(struct nvdb_stream *stream, uint64_t size, void *out)
{
    assert(size <= NVDB_STREAM_BYTES);
    if (stream->fill + size > NVDB_STREAM_BYTES) {
        int status = stream_flush(stream);
        if (status)
            return status;
    }
    *(void **)out = stream->buffer + stream->fill;
    return 0;
}

int fmt_nvdb_stream_end(struct nvdb_stream *stream)
{
    int status = stream_flush(stream);
    bsq_free(stream->ctx, stream->buffer);
    stream->buffer = NULL;
    return status;
}

int fmt_nvdb_stream_put(struct nvdb_stream *stream, const void *bytes, uint64_t size)
{
    int status = 0;
    for (uint64_t done = 0; done < size && status == 0;) {
        const uint64_t left = size - done;
        const uint64_t n = left < NVDB_STREAM_BYTES ? left : NVDB_STREAM_BYTES;
        void *to;
        status = fmt_nvdb_stream_reserve(stream, n, &to);
        if (status)
            break;
        memcpy(to, (const uint8_t *)bytes + done, n);
        stream->fill += n;
        done += n;
    }
    return status;
}
