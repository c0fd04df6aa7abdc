/* file_info.h - describes what is in a mesh, a chunk file or a grid, for people and scripts. */
#ifndef FMT_FILE_INFO_H
#define FMT_FILE_INFO_H

#include <jansson.h>

#include "base/context.h"

/* Sets *out to a description of a file, for the caller to free with json_decref(): an object whose
 * members bisque-voxelize --info prints. Reads meshes whole, and of other files only what is
 * needed. Errors: those of reading. */
int fmt_describe(struct bsq_ctx *ctx, const char *path, json_t **out);

#endif
