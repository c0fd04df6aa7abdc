/* exr_common.c - errors and memory of the EXR writer and reader. */
#include "formats/image/exr_internal.h"

/* EXR_ERR_READ_IO is bad data: the file ends too early. Callbacks record failures of the disk. */
static int status_of(exr_result_t result)
{
    switch (result) {
    case EXR_ERR_SUCCESS:
        return BSQ_OK;
    case EXR_ERR_OUT_OF_MEMORY:
        return BSQ_ENOMEM;
    case EXR_ERR_WRITE_IO:
    case EXR_ERR_FILE_ACCESS:
        return BSQ_EIO;
    default:
        return BSQ_EDATA;
    }
}

int fmt_exr_status(const struct fmt_exr_stream *stream, exr_result_t result)
{
    if (result == EXR_ERR_SUCCESS)
        return BSQ_OK;
    int described = atomic_load(&stream->status);
    if (described < 0)
        return described;
    return bsq_fail(stream->ctx, status_of(result), "%s: %s", stream->path,
                    exr_get_default_error_message(result));
}

void fmt_exr_set_status(struct fmt_exr_stream *stream, int status)
{
    int none = 0;
    if (status < 0)
        atomic_compare_exchange_strong(&stream->status, &none, status);
}

void fmt_exr_on_error(exr_const_context_t file, exr_result_t result, const char *message)
{
    void *user = NULL;
    if (result == EXR_ERR_CORRUPT_CHUNK) /* the caller may try again, and describes it */
        return;
    if (!file || exr_get_user_data(file, &user) != EXR_ERR_SUCCESS || !user)
        return;
    struct fmt_exr_stream *stream = user;
    fmt_exr_set_status(stream, status_of(result));
    bsq_fail(stream->ctx, status_of(result), "%s: %s", stream->path, message);
}

uint64_t fmt_exr_coding_bytes(uint64_t chunk_bytes)
{
    return 3 * chunk_bytes + chunk_bytes / 50 + 4096;
}
