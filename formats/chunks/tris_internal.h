/* tris_internal.h - the bytes of a chunk file: the tables of FORMATS.md, which is normative. */
#ifndef FMT_CHUNKS_TRIS_INTERNAL_H
#define FMT_CHUNKS_TRIS_INTERNAL_H

#include <string.h>

#include "formats/chunks/tris.h"

/* Structures are copied to and from the file as they are. */
_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "the host must be little-endian");

#define TRIS_MAGIC      "BSQTRIS\n"
#define TRIS_ATTRIBUTES 63u /* all that are known */
/* Largest vertex count of a chunk with 16-bit indices. */
#define TRIS_SHORT_VERTICES 65536u
/* The length of a path that means "no texture". */
#define TRIS_NO_PATH UINT32_MAX

struct tris_file_header {
    char magic[8];
    uint32_t version;
    uint32_t attributes;
    uint64_t triangle_count;
    uint64_t chunk_count;
    uint64_t source_faces;
    uint64_t skipped_triangles;
    double origin[3];
    float bounds_min[3];
    float bounds_max[3];
    uint64_t chunks_offset; /* images are before the chunks; made normals, materials and table
                               follow */
    uint64_t materials_offset;
    uint64_t table_offset;
    uint64_t file_bytes;
    uint32_t material_count;
    uint32_t channel_count;
    uint32_t ids;             /* enum fmt_ids */
    uint32_t made_normals;    /* enum bsq_scan_normals, or 0 */
    uint64_t images_checksum; /* of the bytes from the header's end to chunks_offset */
    uint64_t materials_checksum;
    uint64_t table_checksum;
    uint64_t header_checksum; /* of all bytes of the header before this field */
};
_Static_assert(sizeof(struct tris_file_header) == 176, "the header has no padding");

/* What a material, and each of its channels, has first. */
struct tris_source_entry {
    float value[3]; /* of a material: diffuse */
    uint32_t bits;  /* the component of a channel, or flags of a material; see TRIS_WRAP_SHIFT */
    float scale[2], offset[2];
    uint32_t path_bytes; /* of the path, which follows */
};
_Static_assert(sizeof(struct tris_source_entry) == 36, "the entry has no padding");

/* Returns the bytes of a material at least. Its name's length and the name follow the first entry,
 * then there is an entry for each channel. */
static inline uint64_t tris_material_bytes(uint32_t channels)
{
    return sizeof(struct tris_source_entry) * (channels + UINT64_C(1)) + sizeof(uint32_t);
}

/* Flags of a material. From bit TRIS_WRAP_SHIFT on, `bits` says how the image wraps: enum fmt_wrap
 * of u and v, in two bits each; then a bit if it is sRGB. */
enum { TRIS_COLORLESS = 1, TRIS_TINTED = 2, TRIS_WRAP_SHIFT = 8 };

/* Entries of the table are in the file as they are in memory. */
_Static_assert(sizeof(struct fmt_tris_chunk_info) == 104, "the entry has no padding");

/* A record of a sample. Coordinates are in units of 1/65535 of the chunk's bounds. */
struct tris_surfel {
    uint16_t low[3], high[3];
    uint32_t normal;
};
_Static_assert(sizeof(struct tris_surfel) == 16, "the record has no padding");
#define TRIS_SURFEL_RUN 64u /* triangles for which there is a record */
/* In place of a normal, with directions in the lower half: no writer writes such normals. */
#define TRIS_NOT_A_PLANE 0x80000000u

/* Returns the number of records of a chunk's sample. */
static inline uint32_t tris_surfel_count(uint32_t triangles)
{
    return (triangles + TRIS_SURFEL_RUN - 1) / TRIS_SURFEL_RUN;
}

/* Returns its bytes. */
static inline uint64_t tris_sample_bytes(uint32_t triangles)
{
    return tris_surfel_count(triangles) * sizeof(struct tris_surfel);
}

/* Corners and triangles that a record stands for at most. */
enum { TRIS_SURFEL_CORNERS = 24, TRIS_SURFEL_TRIANGLES = 12 };

/* Returns the bytes of the surface of a sample in memory, and of the sample after it. */
static inline uint64_t tris_sample_memory(uint32_t triangles)
{
    return tris_surfel_count(triangles) * UINT64_C(12) *
               (TRIS_SURFEL_CORNERS + TRIS_SURFEL_TRIANGLES) +
           tris_sample_bytes(triangles);
}

/* The attributes of a chunk, in the order of its arrays. */
struct tris_attribute {
    uint32_t flag;     /* of enum fmt_tris_attribute */
    uint32_t bytes;    /* of a value; 0: they are a sample */
    bool of_triangles; /* a value for each triangle; else one for each vertex */
    size_t member;     /* the array's pointer in struct fmt_tris_chunk */
};
enum { TRIS_ATTRIBUTE_COUNT = 6 };
extern const struct tris_attribute fmt_tris_attributes[TRIS_ATTRIBUTE_COUNT];

static inline uint64_t tris_values_bytes(const struct tris_attribute *attribute, uint32_t triangles,
                                         uint32_t vertices)
{
    return attribute->bytes == 0
               ? tris_sample_bytes(triangles)
               : attribute->bytes * (uint64_t)(attribute->of_triangles ? triangles : vertices);
}

/* Offsets of the arrays of a chunk, from its first byte; attributes it lacks take no bytes. */
struct tris_layout {
    uint64_t values[TRIS_ATTRIBUTE_COUNT], triangles; /* positions are first */
    uint64_t end;                                     /* of the triangles */
    uint64_t bytes;                                   /* end, rounded up to 8 */
    bool short_indices;
};

struct fmt_tris_file {
    struct bsq_ctx *ctx;
    struct bsq_file file;
    struct fmt_tris_header header;
    struct fmt_tris_chunk_info *chunks;
    bool own;                        /* a writer reads back what it just wrote, and trusts it */
    uint8_t *tail;                   /* materials and table as in the file; freed after opening */
    char *paths;                     /* all texture paths and names, each with a terminator */
    struct fmt_tris_source *sources; /* of all materials; NULL: there are none */
    char **images;                   /* names of embedded images, as parts of this file; owned */
    uint64_t image_count, image_capacity;
    uint64_t chunks_offset, images_checksum; /* of the header, like the next one */
    uint64_t checksum;
    uint64_t load_size_max, normals_size_max;
};

/* A texture that lies in the file. */
struct tris_image {
    const char *path; /* of the material */
    char *name;       /* of the part of this file, which stands for it */
};

struct fmt_tris_writer {
    struct bsq_ctx *ctx;
    struct bsq_output *output;
    bool temporary; /* the output is a temporary file */
    struct tris_file_header header;
    char *materials; /* as in the file */
    uint64_t materials_bytes, materials_capacity;
    struct fmt_tris_chunk_info *table;
    uint64_t table_capacity;
    struct tris_image *images; /* that were embedded */
    uint64_t image_count, image_capacity;
};

/* ---- tris_load.c ---- */

/* Reads bytes of the file as it was when it was opened. */
int fmt_tris_read_unchanged(const struct fmt_tris_file *file, void *to, uint64_t bytes,
                            uint64_t offset);
/* Reports damage of a chunk of an open file; returns BSQ_EDATA. */
int fmt_tris_damaged_chunk(const struct fmt_tris_file *file, uint64_t index, const char *what);

/* ---- tris_sample.c ---- */

/* Writes the sample of a chunk with these bounds to `out`. Four bytes after the positions are read,
 * too. */
void fmt_tris_make_sample(const struct fmt_tris_chunk *chunk,
                          const struct fmt_tris_chunk_info *info, uint8_t *out);
/* Returns whether the records of a sample are as FORMATS.md says. */
bool fmt_tris_sample_valid(const void *sample, uint32_t triangles);

/* ---- tris_open.c ---- */

/* Reports damage of an open file; returns BSQ_EDATA. */
int fmt_tris_damaged(const struct fmt_tris_file *file, const char *what);

/* Computes the layout of a chunk; nothing overflows, whatever the counts. */
static inline struct tris_layout tris_chunk_layout(uint32_t attributes, uint32_t triangle_count,
                                                   uint32_t vertex_count)
{
    uint64_t nv = vertex_count, nt = triangle_count;
    struct tris_layout l = {.short_indices = vertex_count <= TRIS_SHORT_VERTICES,
                            .triangles = 12 * nv};
    for (int i = 0; i < TRIS_ATTRIBUTE_COUNT; i++) {
        const struct tris_attribute *attribute = &fmt_tris_attributes[i];
        l.values[i] = l.triangles;
        if (attributes & attribute->flag)
            l.triangles += tris_values_bytes(attribute, triangle_count, vertex_count);
    }
    l.end = l.triangles + (l.short_indices ? 6 : 12) * nt;
    l.bytes = bsq_align_up(l.end, 8);
    return l;
}

/* Returns the bytes of a chunk in memory: its indices are widened there. Its sample fits, too. */
static inline uint64_t tris_load_size(uint32_t attributes, const struct fmt_tris_chunk_info *info)
{
    struct tris_layout l = tris_chunk_layout(attributes, info->triangle_count, info->vertex_count);
    const uint64_t all = bsq_align_up(l.triangles + 12 * (uint64_t)info->triangle_count, 8);
    const uint64_t sample = bsq_align_up(tris_sample_memory(info->triangle_count), 8);
    return attributes & FMT_TRIS_SAMPLES && sample > all ? sample : all;
}

#endif
