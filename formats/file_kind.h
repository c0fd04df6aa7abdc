/* file_kind.h - says what a file is, by its first bytes, and verifies a whole chunk file or grid
 * file. A mesh format without a magic number is recognised by the suffix of the file's name. */
#ifndef FMT_FILE_KIND_H
#define FMT_FILE_KIND_H

#include "formats/chunks/tris.h"
#include "formats/grid/nvdb.h"

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

struct fmt_verify_report {
    enum fmt_kind kind; /* FMT_KIND_TRIS or FMT_KIND_NVDB */
    uint32_t version;   /* of the chunk file, or of the grid's record "bisque" */
    uint64_t file_bytes, triangles;
    uint64_t chunks, vertices; /* chunk file only */
    enum fmt_nvdb_type type;   /* this and all below: grid only */
    uint32_t nanovdb_version[3];
    uint64_t voxels, second_records;
    double voxel_size;
    bool has_color;
};

/* Recognises a file by its content, reads it whole, and checks everything that FORMATS.md requires:
 * versions, checksums, structure. Memory: a chunk for each thread and 112 bytes for each chunk's
 * entry; of a grid, a few pages of its map at a time. Errors: BSQ_ENOINPUT; BSQ_EDATA with one line
 * that says what is wrong and where, or what the file is instead. */
int fmt_verify(struct bsq_ctx *ctx, const char *path, struct fmt_verify_report *report);

#ifdef __cplusplus
}
#endif
#endif
