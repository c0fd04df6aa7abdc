/* tris.h - the chunk file: the triangles of a high-poly mesh in spatially sorted, indexed chunks.
 *
 * Takes chunks in order and writes them; gives header, chunk table and single chunks of a file. The
 * order and content of chunks depend only on the mesh, not on memory budget or threads. The bytes
 * are in FORMATS.md. */
#ifndef FMT_CHUNKS_TRIS_H
#define FMT_CHUNKS_TRIS_H

#include "formats/material/channels.h"
#include "base/output.h"

enum fmt_tris_attribute {
    FMT_TRIS_NORMALS = 1,     /* octahedral, see base/geometry/vec.h */
    FMT_TRIS_TEXCOORDS = 2,   /* two float32 */
    FMT_TRIS_COLORS = 4,      /* RGBA8, sRGB, R in the low byte */
    FMT_TRIS_MATERIALS = 8,   /* one uint32 a triangle, UINT32_MAX: none */
    FMT_TRIS_SAMPLES = 16,    /* coarse surfaces, see fmt_tris_load_sample() */
    FMT_TRIS_FINE_COLORS = 32 /* what the 8 bits of colours leave, see fmt_tris_fine_color() */
};

/* Fine colours have, for each component, what its 8 bits leave, in 1/1024 of their steps: a signed
 * number of 10 bits, that of red in the lowest ones. */

/* Returns this number for component k, -512 to 511. */
static inline int32_t fmt_tris_color_rest(uint32_t fine, int k)
{
    return (int32_t)(fine << (22 - 10 * k)) >> 22;
}

/* Packs the number of component k; one that is too large becomes the largest. */
static inline uint32_t fmt_tris_pack_rest(int32_t rest, int k)
{
    return ((uint32_t)(rest < 511 ? rest : 511) & 1023) << 10 * k;
}

/* Returns component k of a colour, sRGB-encoded: 0 to 1, or out of it by 1/510 at most. */
static inline double fmt_tris_fine_color(uint32_t color, uint32_t fine, int k)
{
    return ((color >> 8 * k & 255) + fmt_tris_color_rest(fine, k) / 1024.0) / 255.0;
}

#define FMT_TRIS_VERSION 7u /* the only one that is read */

/* Scans of at least this many faces get samples. In smaller ones, a sample would be too coarse for
 * a map, and reading all of it takes no time. */
#define FMT_TRIS_SAMPLED_FACES (UINT64_C(1) << 24)

/* Triangles of the largest chunk; small enough for 16-bit indices in ordinary meshes. */
#define FMT_TRIS_CHUNK_TRIANGLES 65536u

/* A channel of a material. All zero: the value is 0. */
struct fmt_tris_source {
    char *texture_path; /* absolute, or NULL: the value is used */
    /* Of colours, linear light; a single value three times. It is the factor of a texture, see
     * struct fmt_channel, but for FMT_CHANNEL_CUTOUT. */
    float value[3];
    uint32_t component; /* of the texture, see FMT_CHANNEL_ALPHA, for channels with one value */
    struct fmt_uv uv;
};

struct fmt_tris_material {
    char *texture_path;              /* absolute, or NULL */
    struct fmt_uv uv;                /* of this texture */
    struct fmt_tris_source *sources; /* one for each channel of the header; NULL: there are none */
    float diffuse[3];                /* sRGB 0...1; used if there is no texture */
    bool colorless;                  /* `diffuse` is no colour of the scan */
    bool tinted;                     /* colours of vertices multiply this texture */
    char *name;                      /* by which ids tell triangles apart; NULL: "" */
};

struct fmt_tris_header {
    uint32_t attributes; /* of enum fmt_tris_attribute */
    uint64_t triangle_count;
    uint64_t chunk_count;
    uint64_t source_faces;              /* polygons of the input */
    uint64_t skipped_triangles;         /* degenerate triangles that were left out */
    double origin[3];                   /* world = origin + float32 position */
    float bounds_min[3], bounds_max[3]; /* of all triangles, relative to origin */
    uint32_t material_count;
    struct fmt_tris_material *materials;
    /* By name: that of a triangle's material, or "" without one. By colour: of the vertices. */
    enum fmt_ids ids;
    enum bsq_scan_normals
        made_normals; /* weights of the normals that were made; 0: there are none */
    uint32_t channel_count;
    char **channels;    /* names, see formats/material/channels.h */
    bool embeds_images; /* for a writer: copy those images of textures that are single files */
};

/* Returns the number of a channel, or UINT32_MAX. */
uint32_t fmt_tris_find_channel(const struct fmt_tris_header *header, const char *name);

/* A chunk's entry in the chunk table. */
struct fmt_tris_chunk_info {
    uint64_t offset, size_bytes;
    uint64_t first_triangle; /* number of its first triangle in the file */
    uint32_t triangle_count, vertex_count;
    float bounds_min[3], bounds_max[3]; /* of its triangles, relative to origin */
    uint64_t checksum;                  /* of its bytes */
    uint64_t sample_checksum;           /* of its sample's bytes; 0: it has none */
    /* Of the section of normals, all 0 without one. */
    uint64_t normals_offset, creases_offset;
    uint64_t normals_checksum; /* of the bytes of its normals and of its creases */
    uint32_t crease_count, reserved;
};

/* A vertex whose triangles have two sides, each with a normal. */
struct fmt_tris_crease {
    uint32_t vertex, reserved;
    uint64_t second; /* the normal of the second side; that of the first is the vertex's */
};

/* Vertex normals of a chunk that were made from triangles (base/geometry/vertex_normal.h). Those at
 * creases hold for triangles whose plane they are closer to than 45 degrees. */
struct fmt_tris_normals {
    const uint64_t *vertices;
    const struct fmt_tris_crease *creases; /* by vertex */
    uint32_t crease_count;
};

/* A chunk in memory. Attributes that the file does not have are NULL. */
struct fmt_tris_chunk {
    uint32_t triangle_count, vertex_count;
    const float (*positions)[3]; /* at least four bytes can be read after the last one */
    const uint32_t *normals;
    const float (*texcoords)[2];
    const uint32_t *colors, *fine_colors;
    const uint32_t (*triangles)[3]; /* numbers of vertices in the chunk */
    const uint32_t *materials;      /* one a triangle */
    const void *samples;            /* as in the file; encoding makes them itself */
};

/* Returns whether any of the scan's triangles has a colour: a vertex has, or a material. */
bool fmt_tris_has_color(const struct fmt_tris_header *header);

/* Recognises a chunk file of any version by its first bytes. `size` may be less than 8 only if the
 * file is shorter: then it is one that is cut off, if they fit and its name ends in ".tris". */
bool fmt_tris_recognise(const char *path, const char *first, uint64_t size);

struct fmt_tris_file;

/* ---- writing ---- */
struct fmt_tris_writer;

/* Starts a file. Copies attributes, origin, materials, ids, channels and source_faces from the
 * header; the chunks give the other counts and the bounds. Errors: BSQ_EUSAGE for a path of 4 GiB;
 * BSQ_ECANTCREAT, BSQ_EIO, BSQ_ENOMEM. */
int fmt_tris_create(struct bsq_ctx *ctx, const char *path, const struct fmt_tris_header *header,
                    struct fmt_tris_writer **out);
/* Returns the size of an encoded chunk in bytes. */
uint64_t fmt_tris_encoded_bound(uint32_t attributes, uint32_t triangle_count,
                                uint32_t vertex_count);
/* Encodes a chunk into `buffer`; sets *size and, except for its offset and first triangle, *info.
 * Thread-safe, so that workers can encode. */
int fmt_tris_encode(struct bsq_ctx *ctx, uint32_t attributes, const struct fmt_tris_chunk *chunk,
                    void *buffer, uint64_t *size, struct fmt_tris_chunk_info *info);
/* Appends an encoded chunk, and its entry to the table. Only one thread may call this at a time, in
 * the order of the chunks. Ignores the offset and first triangle of *info. */
int fmt_tris_append(struct fmt_tris_writer *writer, const void *encoded, uint64_t size,
                    const struct fmt_tris_chunk_info *info);
/* Counts triangles that were left out. */
void fmt_tris_skip(struct fmt_tris_writer *writer, uint64_t triangles);
/* Starts a temporary file (bsq_file_temp()) instead, for chunks that only this process needs. */
int fmt_tris_create_temp(struct bsq_ctx *ctx, const char *beside,
                         const struct fmt_tris_header *header, struct fmt_tris_writer **out);
/* Writes materials, table and header, syncs and renames the file; frees the writer in any case.
 * *out receives the complete file for reading; the caller closes it. It stays the file of this
 * writer if another job replaces it. `out` may be NULL, unless the file is temporary. */
int fmt_tris_commit(struct fmt_tris_writer *writer, struct bsq_file *out);
void fmt_tris_discard(struct fmt_tris_writer *writer); /* NULL is allowed */

/* ---- writing made normals ---- */

/* Starts the section of normals, made with these weights, after the last chunk. *out has the chunks
 * for fmt_tris_load(); close it before the writer. A file whose section fails is of no use. Errors:
 * BSQ_ENOMEM, BSQ_EIO. */
int fmt_tris_normals_begin(struct fmt_tris_writer *writer, enum bsq_scan_normals weights,
                           struct fmt_tris_file **out);
/* Write, and read back, the normals of a chunk's vertices. Thread-safe. */
int fmt_tris_normals_put(struct fmt_tris_writer *writer, uint64_t chunk, const uint64_t *normals);
int fmt_tris_normals_get(const struct fmt_tris_file *file, uint64_t chunk, uint64_t *normals);
/* Returns the checksum of the normals of vertices and of the creases, which follow them in memory.
 */
uint64_t fmt_tris_normals_checksum(const uint64_t *normals, uint32_t vertex_count,
                                   uint32_t crease_count);
/* Completes a chunk after its last fmt_tris_normals_put(): appends its creases, and sets its entry
 * of the table. Call it for all chunks in their order, one at a time. */
int fmt_tris_normals_finish(struct fmt_tris_writer *writer, uint64_t chunk,
                            const struct fmt_tris_crease *creases, uint32_t crease_count,
                            uint64_t checksum);

/* ---- reading ---- */

/* Opens a file; checks header, materials and chunk table, and all sizes before memory is allocated.
 * Errors: BSQ_ENOINPUT; BSQ_EDATA naming what is wrong, and the version if it is unknown. */
int fmt_tris_open(struct bsq_ctx *ctx, const char *path, struct fmt_tris_file **out);
/* Opens a file of fmt_tris_commit(); the caller may close *temp at any time after that. */
int fmt_tris_open_temp(struct bsq_ctx *ctx, const struct bsq_file *temp,
                       struct fmt_tris_file **out);
/* Returns the name of weights, AREA to MAX, as options have it; NULL of others. */
const char *fmt_tris_normals_text(enum bsq_scan_normals weights);
/* Returns whether images of textures lie in the file. */
bool fmt_tris_has_images(const struct fmt_tris_file *file);
/* Closes the file, but keeps what its header and table say. */
void fmt_tris_release(struct fmt_tris_file *file);
void fmt_tris_close(struct fmt_tris_file *file);
const struct fmt_tris_header *fmt_tris_get_header(const struct fmt_tris_file *file);
/* Returns the checksum of a file's header, which covers those of all other parts. So files
 * with the same one have the same bytes, unless one is damaged. */
uint64_t fmt_tris_checksum(const struct fmt_tris_file *file);
/* Returns the chunk table: chunk_count entries, owned by the file. */
const struct fmt_tris_chunk_info *fmt_tris_chunks(const struct fmt_tris_file *file);
/* Return the bytes of scratch that fmt_tris_load() needs for a chunk, and for the largest chunk. */
uint64_t fmt_tris_load_size(const struct fmt_tris_file *file, uint64_t index);
uint64_t fmt_tris_load_size_max(const struct fmt_tris_file *file);
/* Lets the system read a chunk ahead that is loaded soon. Thread-safe. */
void fmt_tris_read_ahead(const struct fmt_tris_file *file, uint64_t index);
/* Reads and decodes a chunk into `scratch` (8-byte aligned); *out points into it. Checks what a
 * caller relies on: checksum, padding, indices, material numbers, and that positions are inside the
 * chunk's bounds and texture coordinates finite. Thread-safe for distinct scratch. Errors:
 * BSQ_EDATA; BSQ_EIO, also if the file was changed since it was opened. */
int fmt_tris_load(const struct fmt_tris_file *file, uint64_t index, void *scratch,
                  struct fmt_tris_chunk *out);
/* Reads the sample of a chunk instead, a fortieth of its bytes or less: a coarse surface that
 * stands for its triangles, of fewer triangles than the chunk. It has positions and triangles only,
 * which face as those of the chunk do. *found: false if the chunk has no sample. `scratch` and
 * errors are those of fmt_tris_load(). */
int fmt_tris_load_sample(const struct fmt_tris_file *file, uint64_t index, void *scratch,
                         struct fmt_tris_chunk *out, bool *found);
/* Return the bytes of scratch that fmt_tris_load_normals() needs for a chunk, and for any chunk. */
static inline uint64_t fmt_tris_normals_size(const struct fmt_tris_chunk_info *info)
{
    return info->vertex_count * sizeof(uint64_t) +
           info->crease_count * sizeof(struct fmt_tris_crease);
}
uint64_t fmt_tris_normals_size_max(const struct fmt_tris_file *file);
/* Reads the made normals of a chunk into `scratch` (8-byte aligned), to which *out points. Checks
 * checksum and vertex numbers. The file must have such normals. Thread-safe for distinct scratch.
 * Errors: those of fmt_tris_load(). */
int fmt_tris_load_normals(const struct fmt_tris_file *file, uint64_t index, void *scratch,
                          struct fmt_tris_normals *out);
/* Checks all of FORMATS.md that fmt_tris_open() does not: loads each chunk and compares it with its
 * entry in the table. Uses all threads if the budget has space for a chunk for each, else one.
 * *vertices (may be NULL) is the sum of all chunks' vertex counts. Errors: BSQ_EDATA naming the
 * chunk and what is wrong. */
int fmt_tris_verify(const struct fmt_tris_file *file, uint64_t *vertices);

#endif
