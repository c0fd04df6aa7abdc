/* exr_header.h - the limits that the header of an OpenEXR file must keep.
 *
 * The libraries that read OpenEXR files sort channels and attributes, which for a small file with
 * very many takes minutes, and they allocate what the header holds outside of the budget. This is
 * checked before they open a file. */
#ifndef FMT_EXR_HEADER_H
#define FMT_EXR_HEADER_H

#include "base/file.h"

struct fmt_exr_header {
    const char *excess;  /* what is too much, for a message after the file's name; NULL: nothing */
    uint8_t compression; /* of the first part, as in the file */
};

/* Walks over a header. If it is none at all, nothing is set: OpenEXR says what is wrong with it.
 * Errors: BSQ_EIO. */
int fmt_exr_header_read(struct bsq_ctx *ctx, const struct bsq_file *file,
                        struct fmt_exr_header *out);

#endif
