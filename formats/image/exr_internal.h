/* exr_internal.h - what the EXR writer and reader share. */
#ifndef FMT_IMAGE_EXR_INTERNAL_H
#define FMT_IMAGE_EXR_INTERNAL_H

#include <openexr.h>
#include <stdatomic.h>

#include "base/context.h"

/* What OpenEXR's callbacks get as user data. It stands first in the structures that own a file. */
struct fmt_exr_stream {
    struct bsq_ctx *ctx;
    const char *path;  /* the final name, for messages */
    atomic_int status; /* of the first failure that OpenEXR or a callback described; what OpenEXR
                        * returns may be a consequence */
};

/* Turns a result of OpenEXR into a status. When reading, the library has described the failure
 * through fmt_exr_on_error() already; this describes results that came without. */
int fmt_exr_status(const struct fmt_exr_stream *stream, exr_result_t result);

/* For callbacks that read or write: keeps a failure, which is described already. */
void fmt_exr_set_status(struct fmt_exr_stream *stream, int status);

/* Error callback of a file that is read: records the message with the file's name, except for
 * EXR_ERR_CORRUPT_CHUNK. */
void fmt_exr_on_error(exr_const_context_t file, exr_result_t result, const char *message);

/* Memory that one chunk's coding takes inside OpenEXR: packed, compressed, scratch. */
uint64_t fmt_exr_coding_bytes(uint64_t chunk_bytes);

#endif
