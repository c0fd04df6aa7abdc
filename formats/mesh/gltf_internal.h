/* gltf_internal.h - private to the glTF reader: what it keeps of a file.
 *
 * A file's JSON is turned into the tables below when it is opened, and then freed. Everything that
 * they refer to has been checked: indices are in range, and ranges of bytes lie inside of their
 * buffers. The buffers themselves are read in blocks. */
#ifndef FMT_MESH_GLTF_INTERNAL_H
#define FMT_MESH_GLTF_INTERNAL_H

#include <jansson.h>

#include "formats/material/file_extent.h"
#include "formats/mesh/gltf_task.h"
#include "formats/mesh/mesh_format.h"

#define GLTF_NONE UINT32_MAX /* no such index */

/* ---- the document ---- */

/* A file whose JSON is in memory. */
struct gltf_document {
    struct bsq_ctx *ctx;
    struct fmt_input *input;
    struct bsq_file file;
    json_t *root;
    uint64_t json_memory;               /* bytes reserved for it */
    uint64_t json_offset, json_bytes;   /* of the text, in the file */
    uint64_t chunk_offset, chunk_bytes; /* of a GLB file's binary chunk; 0: it has none */
};

/* Parses the JSON of a .gltf or GLB file. The input must be open. Close the document also after a
 * failure. */
int fmt_gltf_open_document(struct bsq_ctx *ctx, struct fmt_input *input, struct gltf_document *out);
void fmt_gltf_close_document(struct gltf_document *document);

/* In the parsed text, base64 data URIs are "data:#OFFSET+SIZE": the place of their base64 text in
 * the file. So images and buffers in a file of text need no memory. Returns false for others. */
bool fmt_gltf_find_data(const char *uri, uint64_t *offset, uint64_t *size);

/* An element of a top-level array, which messages name: "accessors[3]". */
struct gltf_item {
    struct gltf_document *document;
    const char *array; /* the name of a top-level array */
    uint64_t index;
    const json_t *object; /* the element; may be NULL, which has no members */
};

/* Returns element `index` of a top-level array. */
struct gltf_item fmt_gltf_element(struct gltf_document *document, const char *array,
                                  uint64_t index);
uint64_t fmt_gltf_count(const struct gltf_document *document, const char *array);

/* Fails with "FILE: ARRAY[INDEX]: " and the text. Returns BSQ_EDATA. */
int fmt_gltf_fail(const struct gltf_item *item, const char *format, ...)
    __attribute__((format(printf, 2, 3)));

/* Reads a whole number from 0 to `most`. Some programs write 12.0. Returns false if it is none. */
bool fmt_gltf_whole(const json_t *value, uint64_t most, uint64_t *out);
/* Reads a member of `object` that is a whole number from 0 to `most`. If it is missing, *out stays
 * as it is; if it must not be missing, *out is GLTF_REQUIRED before. */
int fmt_gltf_number(const struct gltf_item *item, const json_t *object, const char *key,
                    uint64_t most, uint64_t *out);
#define GLTF_REQUIRED UINT64_MAX

/* As fmt_gltf_number(), for the index of an element of a top-level array. */
int fmt_gltf_index(const struct gltf_item *item, const json_t *object, const char *key,
                   const char *array, uint32_t *out);

/* Reads a member that is an array of `count` finite numbers. If it is missing, `out` stays as it
 * is. */
int fmt_gltf_numbers(const struct gltf_item *item, const json_t *object, const char *key,
                     unsigned count, double *out);

/* Returns a member that is a string, or NULL. */
const char *fmt_gltf_string(const json_t *object, const char *key);

/* Returns an object of object.extensions, or NULL. */
const json_t *fmt_gltf_extension(const json_t *object, const char *name);

/* ---- buffers ---- */

struct gltf_buffer {
    char *path;               /* of another file; NULL: the file itself */
    struct bsq_file file;     /* open while that file is read */
    struct fmt_extent extent; /* of the file */
    bool missing;             /* no data: views are decompressed from other buffers */
};

struct gltf_view {
    uint32_t buffer;       /* GLTF_NONE: gltf_source.decoded */
    uint64_t offset, size; /* in the buffer */
    uint32_t stride;       /* 0: elements follow each other */
};

/* The codes of the file format. */
enum gltf_component {
    GLTF_INT8 = 5120,
    GLTF_UINT8 = 5121,
    GLTF_INT16 = 5122,
    GLTF_UINT16 = 5123,
    GLTF_UINT32 = 5125,
    GLTF_FLOAT = 5126
};

struct gltf_accessor {
    uint32_t view; /* GLTF_NONE: all zero */
    uint64_t offset, count;
    enum gltf_component component;
    uint32_t components; /* of an element: 1 to 4; 0: a matrix, which no mesh has */
    bool normalized, sparse;
};

/* ---- meshes and materials ---- */

/* What primitives use accessors for: attributes of vertices, and the list of indices. */
enum gltf_use { GLTF_POSITION, GLTF_NORMAL, GLTF_TEXCOORD, GLTF_COLOR, GLTF_INDEX, GLTF_USE_COUNT };

struct gltf_primitive {
    uint32_t mode;                      /* 4 triangles, 5 strip, 6 fan */
    uint32_t accessors[GLTF_USE_COUNT]; /* or GLTF_NONE */
    uint32_t material;                  /* or GLTF_NONE */
    uint32_t mesh, number;              /* for messages */
    uint64_t triangles;
    uint64_t base[FMT_MESH_KIND_COUNT]; /* elements of earlier primitives of the mesh */
};

struct gltf_mesh {
    uint32_t first, count;               /* primitives that have triangles */
    uint64_t total[FMT_MESH_KIND_COUNT]; /* elements */
    uint64_t triangles;
    bool named; /* by a node */
};

/* A mesh in the scene: at a node. */
struct gltf_placement {
    uint32_t mesh;
    bool mirrored; /* corners change their order */
    double matrix[3][4];
    double normal_matrix[3][3];
    uint64_t base[FMT_MESH_KIND_COUNT]; /* elements of earlier placements in the file */
    char *name;                         /* of the object: the node's, or else the mesh's */
    uint64_t object_base;               /* primitives of earlier placements in the file */
};

struct gltf_material {
    struct fmt_material described;
    double color[3];   /* linear; of faces without texture, and a factor of vertex colours */
    uint32_t texcoord; /* number of the set of texture coordinates */
    /* Texture coordinates are uv_matrix * (u, v, 1), with v downwards as in the file. */
    double uv_matrix[2][3];
};

/* What is not read, counted for warnings. */
struct gltf_unread {
    uint64_t points, bare, rest, outside, unplaced, skins, morphs, images, packed_images, instances,
        hidden, other_colors, variants;
};

/* What the reader keeps of a file: source->data. */
struct gltf_source {
    struct bsq_file own; /* the file, unpacked; open while it is read */
    uint64_t size;       /* of it */
    struct gltf_buffer *buffers;
    struct gltf_view *views;
    struct gltf_packed *packed;
    uint64_t view_capacity, packed_capacity;
    uint32_t packed_count;
    struct gltf_buffer decoded; /* temporary: what the compressed arrays are, one after the other */
    struct gltf_accessor *accessors;
    struct gltf_primitive *primitives;
    struct gltf_mesh *meshes;
    struct gltf_material *materials;
    struct gltf_placement *placements;
    uint32_t buffer_count, view_count, accessor_count, primitive_count, mesh_count, material_count;
    uint32_t placement_count;
    uint64_t object_count; /* primitives of all placements */
    uint64_t total[FMT_MESH_KIND_COUNT], triangles;
    uint64_t bytes;  /* of the file and its buffers */
    bool has_colors; /* of vertices, or factors of textures, which vertices get as colours */
    bool has_tangents, uneven_scale;
    struct gltf_unread unread;
};

/* ---- gltf_buffer.c ---- */

/* This and the functions below that take an element read one element of a top-level array into a
 * zeroed structure, which was counted before. A buffer must be zero but for its file. */
int fmt_gltf_read_buffer(const struct gltf_item *item, struct gltf_source *source, void *element);
int fmt_gltf_read_view(const struct gltf_item *item, struct gltf_source *source, void *element);
/* Open and close the other files that a file's buffers are in. */
int fmt_gltf_open_buffers(struct bsq_ctx *ctx, struct gltf_source *source);
int fmt_gltf_close_buffers(struct bsq_ctx *ctx, struct gltf_source *source);
void fmt_gltf_free_buffers(struct bsq_ctx *ctx, struct gltf_source *source);
/* Sets *out to the path of a file that a URI names, and *exists. Returns 1 if it names one; 0 if
 * the URI is of another kind, such as "https:"; or a status. exactly: no file of a similar name is
 * looked for, as fmt_path_find() does. */
int fmt_gltf_uri_path(struct bsq_ctx *ctx, const char *beside, const char *uri, bool exactly,
                      char **out, bool *exists);
/* Finds out how many bytes base64 text stands for: `size` characters from `offset` in the file. */
int fmt_gltf_measure_data(const struct gltf_item *item, uint64_t offset, uint64_t size,
                          uint64_t *out);
/* Reads bytes of a buffer; GLTF_NONE: gltf_source.decoded. Thread-safe. */
int fmt_gltf_read_bytes(struct bsq_ctx *ctx, const struct gltf_source *source, uint32_t buffer,
                        uint64_t offset, void *to, uint64_t size);

/* ---- gltf_packed.c ---- */

/* Reads EXT_meshopt_compression of a view, whose size is known. */
int fmt_gltf_read_packed_view(const struct gltf_item *item, struct gltf_source *source,
                              const json_t *object, struct gltf_view *view);
/* Reads KHR_draco_mesh_compression of a primitive, whose accessors are known. They get views.
 * keys: names of the attributes. */
int fmt_gltf_read_draco(const struct gltf_item *item, struct gltf_source *source,
                        const json_t *object, const char *const keys[GLTF_USE_COUNT],
                        struct gltf_primitive *p);
/* Decompresses everything to a temporary file, unless that is done. */
int fmt_gltf_unpack(struct bsq_ctx *ctx, struct gltf_source *source);

uint32_t fmt_gltf_component_bytes(enum gltf_component component);

int fmt_gltf_read_accessor(const struct gltf_item *item, struct gltf_source *source, void *element);

/* Decodes elements [first, first + count) of an accessor to doubles, components next to each other.
 * *out lies in slot->work until the next call. */
int fmt_gltf_decode(struct stream_slot *slot, uint32_t accessor, uint64_t first, uint64_t count,
                    const double **out);
/* Returns the accessor that a primitive uses for something, or NULL. */
static inline struct gltf_accessor *gltf_accessor_of(const struct gltf_source *source,
                                                     const struct gltf_primitive *p,
                                                     enum gltf_use use)
{
    return p->accessors[use] == GLTF_NONE ? NULL : &source->accessors[p->accessors[use]];
}
/* Returns the bytes from one element of an accessor to the next. */
uint64_t fmt_gltf_stride(const struct gltf_source *source, const struct gltf_accessor *accessor);

/* ---- gltf_scene.c, gltf_material.c ---- */

int fmt_gltf_read_mesh(const struct gltf_item *item, struct gltf_source *source, void *element);
int fmt_gltf_read_scene(struct gltf_document *document, struct gltf_source *source);
int fmt_gltf_read_material(const struct gltf_item *item, struct gltf_source *source, void *element);

#endif
