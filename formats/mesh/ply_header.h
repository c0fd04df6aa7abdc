/* ply_header.h - private to the PLY reader: the header of a PLY file.
 *
 * The format is described by Turk, "The PLY Polygon File Format", 1994. Its header lists elements,
 * such as "vertex", with their number and properties. A property is a number or a list of numbers.
 * Everything else about meshes is custom: this file knows the names that programs use. */
#ifndef FMT_MESH_PLY_HEADER_H
#define FMT_MESH_PLY_HEADER_H

#include "formats/input/input.h"

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

/* What a property means. Those of a vertex come in groups: x y z, and so on. */
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
    PLY_INDICES, /* the list of a face's vertices, or of a strip's */
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

enum ply_kind { PLY_OTHER, PLY_VERTICES, PLY_FACES, PLY_STRIPS };

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

/* Reads and checks the header of an open input. Errors: BSQ_EDATA with file, line and text. Free
 * *out with fmt_ply_header_free(), also after a failure. */
int fmt_ply_header_read(struct bsq_ctx *ctx, struct fmt_input *input, struct ply_header *out);
void fmt_ply_header_free(struct bsq_ctx *ctx, struct ply_header *header);

/* Returns true if the element has properties with all roles from `first` to `last`. */
static inline bool ply_has_roles(const struct ply_element *element, enum ply_role first,
                                 enum ply_role last)
{
    for (int role = (int)first; role <= (int)last; role++)
        if (!element->role[role])
            return false;
    return true;
}

/* Returns the element of this kind, or NULL. */
const struct ply_element *fmt_ply_find_element(const struct ply_header *header, enum ply_kind kind);

#endif
