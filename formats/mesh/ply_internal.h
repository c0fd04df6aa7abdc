/* ply_internal.h - private to the PLY reader: its state and how its parts share it. */
#ifndef FMT_MESH_PLY_INTERNAL_H
#define FMT_MESH_PLY_INTERNAL_H

#include "formats/mesh/mesh_stream.h"
#include "formats/mesh/ply_header.h"

/* What mesh_arrays.face_tags says of a face. */
enum ply_tags {
    PLY_TAGS_NONE,
    PLY_TAGS_TEXTURE, /* number of its texture in the file, or PLY_NO_TAG */
    PLY_TAGS_COLOR    /* its colour: red + 256 green + 65536 blue */
};
#define PLY_NO_TAG UINT32_MAX

struct ply_source {
    struct ply_header header;
    enum ply_tags tags;
    uint32_t texture_base; /* textures of earlier files */
    bool vertex_normals, vertex_texcoords, corner_texcoords;
};

/* Colours of faces in order of first appearance; `slots` is an open-addressing hash table of
 * number + 1. */
struct ply_colors {
    uint32_t *list, *slots;
    uint64_t count, capacity, slot_count;
};

struct ply_reader {
    struct stream_reader stream; /* must be first */
    struct ply_source *files;
    uint32_t texture_count; /* of all files */
    struct ply_colors colors;
    /* Of one reading. */
    uint64_t bad_normals, bad_colors, bad_texcoords, missing_positions, missing_texcoords,
        clamped_colors;
    uint64_t lost_textures, lost_texture_at; /* as in struct stream_slot, of all files */
    uint32_t lost_texture_file;              /* that has the first */
    bool read_before;                        /* what there is to warn of is known */
};

/* The kind of a part: the number of its element, or one of these. */
enum {
    PLY_PART_REST = UINT32_MAX - 1 /* the bytes after the last element */
};
/* This bit of a kind: a part of the list of one strip, which is longer than parts are. */
#define PLY_PART_PIECE 0x40000000u

static inline const struct ply_source *ply_source_of(const struct stream_reader *reader,
                                                     const struct stream_slot *slot)
{
    return &((const struct ply_reader *)reader)->files[slot->part.source];
}

/* ---- ply_cut.c ---- */

int fmt_ply_cut(struct stream_reader *reader, const struct stream_part *before,
                struct stream_slot *slot);

/* ---- ply_binary.c, ply_text.c: parse parts of elements that are read ---- */

int fmt_ply_parse_binary(struct bsq_ctx *ctx, const struct ply_source *source,
                         const struct ply_element *element, struct stream_slot *slot);
int fmt_ply_parse_text(struct bsq_ctx *ctx, const struct ply_source *source,
                       const struct ply_element *element, struct stream_slot *slot);

/* ---- ply_element.c: what both do ---- */

/* Ensures capacity for all vertices of the part, or for `most_items` items in lists of faces. */
int fmt_ply_reserve(struct bsq_ctx *ctx, const struct ply_source *source,
                    const struct ply_element *element, struct stream_slot *slot,
                    uint64_t most_items);

/* Stores the value of one property of vertex number `vertex` of the part. */
void fmt_ply_store_vertex(struct mesh_arrays *arrays, uint64_t vertex,
                          const struct ply_property *property, double value);
/* Ends a part with this many vertices. What is not finite becomes missing, and is counted. */
void fmt_ply_finish_vertices(const struct ply_source *source, const struct ply_element *element,
                             struct stream_slot *slot, uint64_t count);

/* A face while it is read. Its indices are stored after the last corner, its texture coordinates
 * after the last texture coordinate. */
struct ply_face {
    uint64_t size;      /* indices */
    uint64_t texcoords; /* numbers in its list of texture coordinates */
    int64_t texture;
    double color[3]; /* 0 to 255 */
    bool clamped;    /* a colour was not in this range */
    uint64_t at;     /* line or byte */
};

/* Starts a face: without indices, with the first texture. */
static inline struct ply_face ply_face_at(uint64_t at)
{
    return (struct ply_face){.at = at};
}

/* Adds one index. Returns false, with slot->error set, if no file can have it. */
bool fmt_ply_add_index(struct stream_slot *slot, struct ply_face *face, int64_t index);
/* Stores the number at position `i` of the face's list of texture coordinates. */
void fmt_ply_add_texcoord(struct stream_slot *slot, uint64_t i, double value);
/* Stores a number that decides the face's material. */
void fmt_ply_set_material(struct ply_face *face, const struct ply_property *property, double value);
/* Ends a face. Returns false if parsing must stop: at an error, or after slot->last_face. */
bool fmt_ply_finish_face(const struct ply_source *source, struct stream_slot *slot,
                         const struct ply_face *face);

/* The state of a strip: the last two indices, and how many there are since it began or began anew.
 * From two on, only whether the number is odd counts. */
struct ply_strip {
    uint64_t last[2];
    uint32_t run;
};
/* Continues a strip with one index; negative: it begins anew. Adds the triangle. Returns false if
 * parsing must stop. */
bool fmt_ply_add_to_strip(const struct ply_source *source, struct stream_slot *slot,
                          struct ply_strip *strip, int64_t index, uint64_t at);

/* ---- ply_material.c ---- */

/* Turns face_tags into changes of material. Serial, in order. */
int fmt_ply_find_materials(struct ply_reader *reader, const struct ply_source *source,
                           struct mesh_arrays *arrays);
int fmt_ply_read_materials(struct fmt_mesh_reader *reader, struct fmt_materials *out);
void fmt_ply_colors_free(struct bsq_ctx *ctx, struct ply_colors *colors);

#endif
