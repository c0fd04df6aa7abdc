/* verify.h - is this file whole, and what is it? For files of either kind that Bisque reads again.
 */
#ifndef FMT_VERIFY_H
#define FMT_VERIFY_H

#include "formats/grid/nvdb.h"
#include "formats/chunks/tris.h"

#ifdef __cplusplus
extern "C" {
#endif

enum fmt_verify_kind { FMT_VERIFY_TRIS, FMT_VERIFY_NVDB };

struct fmt_verify_report {
    enum fmt_verify_kind kind;
    uint32_t version; /* of the chunk file, or of the "bisque" record */
    uint64_t file_bytes, triangles;
    uint64_t chunks, vertices; /* .tris */
    enum fmt_nvdb_type type;   /* .nvdb, from here on */
    uint32_t nanovdb_version[3];
    uint64_t voxels, second_records;
    double voxel_size;
    bool has_color;
};

/* Reads the whole file, told by its first bytes, and checks all that FORMATS.md says of it:
 * versions, checksums, structure. Memory: a chunk a thread and 112 bytes for each chunk's entry, or
 * pages of the mapped grid, which are given back; never the whole file. Errors: BSQ_ENOINPUT;
 * BSQ_EDATA with one line that says what is wrong and where, or what the file is instead. */
int fmt_verify(struct bsq_ctx *ctx, const char *path, struct fmt_verify_report *report);

#ifdef __cplusplus
}
#endif
#endif
