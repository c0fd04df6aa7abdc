/** @file
 * Says what a file is, by its first bytes, and verifies a whole chunk file or grid file. A mesh
 * format without a magic number is recognised by the suffix of the file's name. */
#ifndef FMT_FILE_KIND_H
#define FMT_FILE_KIND_H

#include "base/context.h"

#ifdef __cplusplus
extern "C" {
#endif

/** What a file is. */
enum fmt_kind {
    FMT_KIND_OTHER, /**< None of these. */
    FMT_KIND_MESH,  /**< A mesh in one of the formats that are read. */
    FMT_KIND_TRIS,  /**< A chunk file. */
    FMT_KIND_NVDB,  /**< A NanoVDB file; not always a grid of Bisque. */
    FMT_KIND_VDB,   /**< An OpenVDB file. */
    FMT_KIND_PIPE   /**< A FIFO, or "-" for standard input, which can be read only once. */
};

/** Recognises a file. Errors: BSQ_ENOINPUT, BSQ_EIO. */
int fmt_recognise(struct bsq_ctx *ctx, const char *path, enum fmt_kind *out);

/** Recognises a file that must be a chunk file or a NanoVDB file; BSQ_EDATA if it is neither. */
int fmt_recognise_scan(struct bsq_ctx *ctx, const char *path, enum fmt_kind *out);

/** What fmt_verify() found. */
struct fmt_verify_report {
    size_t size;             /**< Of the structure, see bsq_clear_report(). */
    enum fmt_kind kind;      /**< FMT_KIND_TRIS or FMT_KIND_NVDB. */
    uint32_t version;        /**< Of the chunk file, or of the grid's trailer. */
    uint64_t file_bytes;     /**< Size of the file. */
    uint64_t triangles;      /**< Triangles of the scan. */
    uint64_t chunks;         /**< Chunk file only, like the next one. */
    uint64_t vertices;       /**< Vertices of all chunks; those of several chunks count again. */
    uint64_t voxels;         /**< Occupied voxels. Grid only, like all below. */
    uint64_t second_records; /**< Voxels with a second surface. */
    double voxel_size;       /**< Edge of a voxel in the scan's units. */
    bool has_color;          /**< The voxels have colours. */
};

/** Recognises a file by its content, reads it whole, and checks everything that FORMATS.md
 * requires: versions, checksums, structure. Memory: a chunk for each thread and 144 bytes for each
 * chunk's entry; of a grid, a few pages of its map at a time. Errors: BSQ_ENOINPUT; BSQ_EDATA with
 * one line that says what is wrong and where, or what the file is instead. */
int fmt_verify(struct bsq_ctx *ctx, const char *path, struct fmt_verify_report *report);

#ifdef __cplusplus
}
#endif
#endif
