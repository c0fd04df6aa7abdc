/* verify.h - checks a whole chunk file or grid file, and says what it contains. */
#ifndef FMT_VERIFY_H
#define FMT_VERIFY_H

#include "formats/chunks/tris.h"
#include "formats/grid/nvdb.h"

#ifdef __cplusplus
extern "C" {
#endif

enum fmt_verify_kind { FMT_VERIFY_TRIS, FMT_VERIFY_NVDB };

struct fmt_verify_report {
    enum fmt_verify_kind kind;
    uint32_t version; /* of the chunk file, or of the grid's record "bisque" */
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
