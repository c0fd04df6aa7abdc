/* mesh_check.h - shared by the fuzz targets of mesh readers. */
#ifndef FUZZ_MESH_CHECK_H
#define FUZZ_MESH_CHECK_H

#include "base/context.h"

/* A fuzz_use: loads a mesh file whole; checks that positions are finite and indices are in range.
 */
int fuzz_mesh(struct bsq_ctx *ctx, const char *const *paths, uint32_t count);

#endif
