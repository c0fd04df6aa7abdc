/* file_kind.h - says what a file is, by its first bytes. A mesh format without a magic number is
 * recognised by the suffix of the file's name. */
#ifndef FMT_FILE_KIND_H
#define FMT_FILE_KIND_H

#include "base/context.h"

#ifdef __cplusplus
extern "C" {
#endif

enum fmt_kind {
    FMT_KIND_OTHER,
    FMT_KIND_MESH, /* a format of mesh/mesh_reader.h */
    FMT_KIND_TRIS, /* chunk file, see chunks/tris.h */
    FMT_KIND_NVDB, /* NanoVDB file, see grid/nvdb.h; not always a grid of Bisque */
    FMT_KIND_VDB,  /* OpenVDB file */
    FMT_KIND_PIPE  /* FIFO, or "-" for standard input, which can be read only once */
};

/* Recognises a file. Errors: BSQ_ENOINPUT, BSQ_EIO. */
int fmt_recognise(struct bsq_ctx *ctx, const char *path, enum fmt_kind *out);

/* Recognises a file that must be a chunk file or a NanoVDB file; BSQ_EDATA if it is neither. */
int fmt_recognise_scan(struct bsq_ctx *ctx, const char *path, enum fmt_kind *out);

#ifdef __cplusplus
}
#endif
#endif
