/* file_kind.h - what a file is, by its first bytes. Some mesh formats have none of their own: there
 * the suffix of the name decides. */
#ifndef FMT_FILE_KIND_H
#define FMT_FILE_KIND_H

#include "base/context.h"

#ifdef __cplusplus
extern "C" {
#endif

enum fmt_kind { FMT_KIND_OTHER, FMT_KIND_MESH, FMT_KIND_TRIS, FMT_KIND_NVDB, FMT_KIND_VDB };

/* Errors: BSQ_ENOINPUT, BSQ_EIO. */
int fmt_recognise(struct bsq_ctx *ctx, const char *path, enum fmt_kind *out);

/* The same for a file that has to be a chunk file or a NanoVDB grid: BSQ_EDATA where it is neither.
 */
int fmt_recognise_scan(struct bsq_ctx *ctx, const char *path, enum fmt_kind *out);

#ifdef __cplusplus
}
#endif
#endif
