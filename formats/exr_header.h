/* exr_header.h - the limits that the header of an OpenEXR file must keep.
 *
 * The libraries that read OpenEXR files sort channels and attributes, which for a small file with
 * very many takes minutes, and they allocate what the header holds outside of the budget. This is
 * checked before they open a file. */
#ifndef FMT_EXR_HEADER_H
#define FMT_EXR_HEADER_H

#include "base/file.h"

/* Sets *out to what is too much in a header, for a message after the file's name. Sets it to NULL
 * if nothing is, or if this is no header at all: OpenEXR says what is wrong with it. Errors:
 * BSQ_EIO. */
int fmt_exr_header_excess(struct bsq_ctx *ctx, const struct bsq_file *file, const char **out);

#endif
