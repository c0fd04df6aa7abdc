/* ply_internal.h - private to the PLY reader: its state and how its parts share it. */
#ifndef FMT_MESH_PLY_INTERNAL_H
#define FMT_MESH_PLY_INTERNAL_H

#include "formats/mesh/mesh_format.h"
#include "formats/mesh/ply_header.h"

/* What mesh_arrays.face_tags says of a face. */
enum ply_tags {
    PLY_TAGS_NONE,
    PLY_TAGS_TEXTURE, /* number of its texture in the file, or PLY_NO_TAG */
    PLY_TAGS_COLOR    /* its colour: red + 256 green + 65536 blue */
};
#define PLY_NO_TAG UINT32_MAX

/* What the reader keeps of a file: source->data. */
struct ply_source {
    struct ply_header header;
    enum ply_tags tags;
    bool vertex_normals, vertex_texcoords, corner_texcoords;
    /* Colours of faces of all PLY files, in the first one of them. */
    struct mesh_names colors;
};

/* What a file has beside what is common to all formats. */
enum {
    PLY_BAD_TEXCOORDS = STREAM_FORMAT_ODDITIES, /* lists of texture coordinates that do not fit, or
                                                   are not finite, by corner */
    PLY_CLAMPED_COLORS,
    PLY_LOST_TEXTURES /* faces whose texture the file does not name */
};

/* The kind of a part: the number of its element, or one of these. */
enum {
    PLY_PART_REST = UINT32_MAX - 1 /* the bytes after the last element */
};
/* This bit of a kind: a part of the list of one strip, which is longer than parts are. */
#define PLY_PART_PIECE 0x40000000u

/* ---- ply_cut.c ---- */

int fmt_ply_cut(const struct stream_part *before, struct stream_slot *slot);

/* ---- ply_binary.c, ply_text.c: parse parts of elements that are read ---- */

int fmt_ply_parse_binary(const struct ply_element *element, struct stream_slot *slot);
int fmt_ply_parse_text(const struct ply_element *element, struct stream_slot *slot);

/* ---- ply_element.c: what both do ---- */

/* Ensures capacity for all vertices of the part, or for `most_items` items in lists of faces. */
int fmt_ply_reserve(const struct ply_element *element, struct stream_slot *slot,
                    uint64_t most_items);

/* Stores the value of one property of vertex number `vertex` of the part. */
void fmt_ply_store_vertex(struct mesh_arrays *arrays, uint64_t vertex,
                          const struct ply_property *property, double value);
/* Ends a part with this many vertices. What is not finite becomes missing, and is counted. */
void fmt_ply_finish_vertices(const struct ply_element *element, struct stream_slot *slot,
                             uint64_t count);

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

#endif
