/* tris.h - the chunk file: a scan's triangles in spatially sorted, indexed chunks.
 * FORMATS.md has the bytes. A chunk can be read alone; chunk order and content depend on the
 * scan alone, not on budget or threads. */
#ifndef FMT_CHUNKS_TRIS_H
#define FMT_CHUNKS_TRIS_H

#include "base/output.h"

#ifdef __cplusplus
extern "C" {
#endif

enum fmt_tris_attribute {
    FMT_TRIS_NORMALS = 1,   /* octahedral, see base/octahedral.h */
    FMT_TRIS_TEXCOORDS = 2, /* two float32 */
    FMT_TRIS_COLORS = 4,    /* RGBA8, sRGB, R in the low byte */
    FMT_TRIS_MATERIALS = 8  /* one uint32 a triangle, UINT32_MAX: none */
};

/* Largest chunk; keeps indices at 16 bits for ordinary meshes. */
#define FMT_TRIS_CHUNK_TRIANGLES 65536u

struct fmt_tris_material {
    char *texture_path; /* absolute, or NULL */
    float diffuse[3];   /* sRGB 0..1; used where there is no texture */
};

struct fmt_tris_header {
    uint32_t attributes; /* of enum fmt_tris_attribute */
    uint64_t triangle_count;
    uint64_t chunk_count;
    uint64_t source_faces;              /* polygons of the input */
    uint64_t skipped_triangles;         /* degenerate ones that were left out */
    double origin[3];                   /* world = origin + float32 position */
    float bounds_min[3], bounds_max[3]; /* of all triangles, relative to origin */
    uint32_t material_count;
    struct fmt_tris_material *materials;
};

/* What the chunk table says of a chunk. */
struct fmt_tris_chunk_info {
    uint64_t offset, size_bytes;
    uint64_t first_triangle; /* number of its first triangle in the file's order */
    uint32_t triangle_count, vertex_count;
    float bounds_min[3], bounds_max[3]; /* of its triangles, relative to origin */
};

/* One chunk in memory. Unused attributes are NULL. */
struct fmt_tris_chunk {
    uint32_t triangle_count, vertex_count;
    const float (*positions)[3];
    const uint32_t *normals;
    const float (*texcoords)[2];
    const uint32_t *colors;
    const uint32_t (*triangles)[3]; /* vertex numbers in the chunk */
    const uint32_t *materials;      /* per triangle */
};

/* ---- writing ---- */
struct fmt_tris_writer;

/* Starts a file; materials are copied. Of the header's counts only source_faces is looked at. */
int fmt_tris_create(struct bsq_ctx *ctx, const char *path, const struct fmt_tris_header *header,
                    struct fmt_tris_writer **out);
/* Upper limit of an encoded chunk's size. */
uint64_t fmt_tris_encoded_bound(uint32_t attributes, uint32_t triangle_count,
                                uint32_t vertex_count);
/* Encodes into `buffer` and sets *size; thread-safe, so that workers can do it. Computes bounds. */
int fmt_tris_encode(struct bsq_ctx *ctx, uint32_t attributes, const struct fmt_tris_chunk *chunk,
                    void *buffer, uint64_t *size, struct fmt_tris_chunk_info *info);
/* Appends an encoded chunk; serial, in order. Sets offset and first_triangle itself. */
int fmt_tris_append(struct fmt_tris_writer *writer, const void *encoded, uint64_t size,
                    const struct fmt_tris_chunk_info *info);
/* Counts triangles that were left out. */
void fmt_tris_skip(struct fmt_tris_writer *writer, uint64_t triangles);
/* Writes table and header (counts and bounds from the chunks), syncs, renames. Frees the writer. */
int fmt_tris_commit(struct fmt_tris_writer *writer);
void fmt_tris_discard(struct fmt_tris_writer *writer); /* NULL is allowed */
/* The same for chunks that only this process needs: a temporary file, see bsq_file_temp(), that is
 * handed over in *out when it is complete. */
int fmt_tris_create_temp(struct bsq_ctx *ctx, const char *beside,
                         const struct fmt_tris_header *header, struct fmt_tris_writer **out);
int fmt_tris_keep_temp(struct fmt_tris_writer *writer, struct bsq_file *out);
/* Total bytes written so far. */
uint64_t fmt_tris_written(const struct fmt_tris_writer *writer);

/* ---- reading ---- */
struct fmt_tris_file;

/* Opens and checks header and chunk table (sizes against the file before anything is allocated).
 * Errors: BSQ_ENOINPUT, BSQ_EDATA naming what is wrong, the version where it is unknown. */
int fmt_tris_open(struct bsq_ctx *ctx, const char *path, struct fmt_tris_file **out);
/* From fmt_tris_keep_temp(); *temp may be closed at any time afterwards. */
int fmt_tris_open_temp(struct bsq_ctx *ctx, const struct bsq_file *temp,
                       struct fmt_tris_file **out);
void fmt_tris_close(struct fmt_tris_file *file);
const struct fmt_tris_header *fmt_tris_get_header(const struct fmt_tris_file *file);
/* chunk_count entries, owned by the file. */
const struct fmt_tris_chunk_info *fmt_tris_chunks(const struct fmt_tris_file *file);
/* Bytes of scratch that fmt_tris_load needs for chunk `index`, and for the largest chunk. */
uint64_t fmt_tris_load_size(const struct fmt_tris_file *file, uint64_t index);
uint64_t fmt_tris_load_size_max(const struct fmt_tris_file *file);
/* Reads and decodes a chunk into `scratch` (8-byte aligned), verifies its checksum and that every
 * index is in range; *out points into scratch. Thread-safe for distinct scratch. */
int fmt_tris_load(const struct fmt_tris_file *file, uint64_t index, void *scratch,
                  struct fmt_tris_chunk *out);
/* Checks everything that FORMATS.md says of the file beyond what opening it does: loads every
 * chunk, on all threads where the budget has room for a chunk each, and holds it against its entry
 * in the table. *vertices (may be NULL) is the sum of the chunks' vertices. Errors: BSQ_EDATA
 * naming the chunk and what is wrong with it. */
int fmt_tris_verify(const struct fmt_tris_file *file, uint64_t *vertices);

#ifdef __cplusplus
}
#endif
#endif
