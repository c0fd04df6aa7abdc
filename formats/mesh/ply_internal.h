/* ply_internal.h - private to the PLY reader: the header of a file, and how the blocks of the
 * reader share it.
 *
 * The format is described by Turk, "The PLY Polygon File Format", 1994. Its header lists elements,
 * such as "vertex", with their number and properties. A property is a number or a list of numbers.
 * Everything else about meshes is custom: ply_header.c knows the names that programs use. */
#ifndef FMT_MESH_PLY_INTERNAL_H
#define FMT_MESH_PLY_INTERNAL_H

#include <string.h>

#include "formats/mesh/mesh_format.h"

/* ---- ply_header.c ---- */

enum ply_encoding { PLY_ASCII, PLY_LITTLE_ENDIAN, PLY_BIG_ENDIAN };

enum ply_type {
    PLY_NO_TYPE, /* the count of a property that is no list */
    PLY_INT8,
    PLY_UINT8,
    PLY_INT16,
    PLY_UINT16,
    PLY_INT32,
    PLY_UINT32,
    PLY_INT64,
    PLY_UINT64,
    PLY_FLOAT32,
    PLY_FLOAT64,
    PLY_TYPE_COUNT
};

/* Bytes of a number of each type. */
extern const uint8_t fmt_ply_type_bytes[PLY_TYPE_COUNT];

static inline bool ply_is_real(enum ply_type type)
{
    return type == PLY_FLOAT32 || type == PLY_FLOAT64;
}

/* What a property means. Properties of a vertex come in groups: x y z, and so on. */
enum ply_role {
    PLY_UNUSED,
    PLY_X,
    PLY_Y,
    PLY_Z,
    PLY_NX,
    PLY_NY,
    PLY_NZ,
    PLY_RED,
    PLY_GREEN,
    PLY_BLUE,
    PLY_S,
    PLY_T,
    PLY_ALPHA,   /* not read */
    PLY_INDICES, /* the list of a face's vertices */
    PLY_CORNER_TEXCOORDS,
    PLY_TEXTURE_NUMBER,
    PLY_ROLE_COUNT
};

struct ply_property {
    char *name;
    enum ply_type type, count_type; /* count_type: PLY_NO_TYPE, or that of a list's length */
    enum ply_role role;
    uint64_t offset; /* in an element, if no list comes before it */
};

enum ply_kind { PLY_OTHER, PLY_VERTICES, PLY_FACES };

struct ply_element {
    char *name;
    enum ply_kind kind;
    uint64_t count;
    uint32_t first_property, property_count;
    uint32_t list_count;
    uint64_t least_bytes; /* of one element in a binary file; all its bytes if it has no lists */
    /* The property with each role; NULL: none. */
    const struct ply_property *role[PLY_ROLE_COUNT];
};

struct ply_header {
    enum ply_encoding encoding;
    char line_end; /* '\n', which "\r" may precede, or '\r' */
    struct ply_element *elements;
    uint32_t element_count;
    struct ply_property *properties;
    uint32_t property_count;
    char **textures; /* file names of comments "TextureFile" */
    uint32_t texture_count;
    uint64_t bytes, lines; /* of the header */
    uint64_t element_capacity, property_capacity, texture_capacity;
};

/* Reads and checks the header of an open input: that it has a mesh and, if the file's size is
 * known, that the file is long enough for the elements that its header counts. Sets the kinds and
 * roles of all elements. Errors: BSQ_EDATA with file, line and text. Free *out with
 * fmt_ply_header_free(), also after a failure. */
int fmt_ply_header_read(struct bsq_ctx *ctx, struct fmt_input *input, struct ply_header *out);
void fmt_ply_header_free(struct bsq_ctx *ctx, struct ply_header *header);

/* Returns the element of this kind, or NULL. */
struct ply_element *fmt_ply_find_element(const struct ply_header *header, enum ply_kind kind);

/* Warns of elements and properties that are not read. */
void fmt_ply_warn_unread(struct bsq_ctx *ctx, const char *path, const struct ply_header *header);

/* ---- binary numbers of any type and byte order ---- */

/* Returns the 1, 2, 4 or 8 bytes at `from`. swap: in reverse order. */
static inline uint64_t ply_bits(const uint8_t *from, uint32_t bytes, bool swap)
{
    uint16_t two;
    uint32_t four;
    uint64_t eight;
    switch (bytes) {
    case 1:
        return *from;
    case 2:
        memcpy(&two, from, sizeof two);
        return swap ? __builtin_bswap16(two) : two;
    case 4:
        memcpy(&four, from, sizeof four);
        return swap ? __builtin_bswap32(four) : four;
    default:
        memcpy(&eight, from, sizeof eight);
        return swap ? __builtin_bswap64(eight) : eight;
    }
}

/* Returns an integer. Values of PLY_UINT64 above INT64_MAX become INT64_MAX, which is out of range
 * for whatever a file counts. */
static inline int64_t ply_integer(const uint8_t *from, enum ply_type type, bool swap)
{
    switch (type) {
    case PLY_INT8:
        return (int8_t)*from;
    case PLY_UINT8:
        return *from;
    case PLY_INT16:
        return (int16_t)ply_bits(from, 2, swap);
    case PLY_UINT16:
        return (uint16_t)ply_bits(from, 2, swap);
    case PLY_INT32:
        return (int32_t)ply_bits(from, 4, swap);
    case PLY_UINT32:
        return (uint32_t)ply_bits(from, 4, swap);
    case PLY_INT64:
        return (int64_t)ply_bits(from, 8, swap);
    default: {
        uint64_t bits = ply_bits(from, 8, swap);
        return bits > INT64_MAX ? INT64_MAX : (int64_t)bits;
    }
    }
}

/* Returns a number of any type. */
static inline double ply_real(const uint8_t *from, enum ply_type type, bool swap)
{
    float single;
    double number;
    if (type == PLY_FLOAT32) {
        uint32_t bits = (uint32_t)ply_bits(from, 4, swap);
        memcpy(&single, &bits, sizeof single);
        return single;
    }
    if (type == PLY_FLOAT64) {
        uint64_t bits = ply_bits(from, 8, swap);
        memcpy(&number, &bits, sizeof number);
        return number;
    }
    return (double)ply_integer(from, type, swap);
}

/* ---- the reader ---- */

/* What mesh_arrays.face_tags says of a face. */
enum ply_tags {
    PLY_TAGS_NONE,
    PLY_TAGS_TEXTURE, /* number of its texture in the file, or PLY_NO_TAG */
    PLY_TAGS_COLOR    /* its colour: red + 256 green + 65536 blue */
};
#define PLY_NO_TAG UINT32_MAX

enum { PLY_CACHED_COLORS = 4096 };

/* What the reader keeps of a file: source->data. */
struct ply_source {
    struct ply_header header;
    enum ply_tags tags;
    bool vertex_normals, vertex_texcoords, corner_texcoords;
    /* Colours of faces of all PLY files, in the first one of them: "#ff0000". */
    struct bsq_texts colors;
    /* A cache of them: a colour, and its number + 1. */
    struct {
        uint32_t color, entry;
    } cached[PLY_CACHED_COLORS];
};

/* What a file has beside what is common to all formats. */
enum {
    PLY_BAD_TEXCOORDS = STREAM_FORMAT_ODDITIES, /* lists of texture coordinates that do not fit, by
                                                   corner */
    PLY_CLAMPED_COLORS,
    PLY_LOST_TEXTURES /* faces whose texture the file does not name */
};

/* The kind of a block: the number of its element, or this: the bytes after the last element. */
#define PLY_BLOCK_REST (UINT32_MAX - 1)

/* ---- ply_parse.c ---- */

/* Parses a loaded block of an element that is read. */
int fmt_ply_parse(const struct ply_element *element, struct stream_slot *slot);

#endif
