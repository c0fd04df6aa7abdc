/* exr_internal.h - errors of the EXR writer and reader, and limits of headers; private to this
 * folder. */
#ifndef FMT_IMAGE_EXR_INTERNAL_H
#define FMT_IMAGE_EXR_INTERNAL_H

#include <openexr.h>
#include <stdatomic.h>

#include "base/file.h"

/* User data of OpenEXR's callbacks; the first member of the structures that own a file. */
struct fmt_exr_stream {
    struct bsq_ctx *ctx;
    const char *path;  /* the final name, for messages */
    atomic_int status; /* of the first failure that OpenEXR or a callback recorded; later results of
                        * OpenEXR may be consequences of it */
};

/* Turns a result of OpenEXR into a status. Records an error message, unless a callback has recorded
 * one already. */
int fmt_exr_status(const struct fmt_exr_stream *stream, exr_result_t result);

/* Keeps the status of a failed callback, if it is the first; the callback has recorded the message.
 */
void fmt_exr_set_status(struct fmt_exr_stream *stream, int status);

/* Refuses a header with too much for OpenEXR. A file has one, or one for each part and an empty one
 * at the end. If it is none at all, OpenEXR says what is wrong with it. Errors: BSQ_EDATA; BSQ_EIO.
 */
int fmt_exr_check_header(struct bsq_ctx *ctx, const char *path, const struct bsq_file *file);

#endif
