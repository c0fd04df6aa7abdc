/* exr_internal.h - errors of the EXR writer and reader; private to this folder. */
#ifndef FMT_IMAGE_EXR_INTERNAL_H
#define FMT_IMAGE_EXR_INTERNAL_H

#include <openexr.h>
#include <stdatomic.h>

#include "base/context.h"

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

#endif
