/* obj_block.h - private to the OBJ reader: parses one block of text, independently of all others.
 *
 * A block begins at a line start and ends at a line end, so it can be parsed without knowing what
 * came before it. What depends on earlier blocks (relative indices, bases) stays encoded in the
 * corners; obj_reader.c resolves it when the blocks pass in order. */
#ifndef FMT_MESH_OBJ_BLOCK_H
#define FMT_MESH_OBJ_BLOCK_H

#include "formats/mesh/mesh_reader.h"

/* Encoding of parsed corners. A value below OBJ_RELATIVE_LIMIT is an index from 0 into the file.
 * Any other value except FMT_MESH_NONE is OBJ_RELATIVE_ZERO plus the signed distance from the first
 * element of the block. Indices have at most 18 digits, so the two ranges never meet. */
#define OBJ_RELATIVE_ZERO  ((uint64_t)1 << 62)
#define OBJ_RELATIVE_LIMIT ((uint64_t)1 << 61)

/* What a file has that has no meaning. It is read in the way of other programs, and counted. */
enum obj_oddity {
    OBJ_NO_POSITION, /* vertices with a coordinate that is not finite */
    OBJ_NO_TEXCOORD, /* texture coordinates that are not finite, or have no number */
    OBJ_NO_NORMAL,   /* normals that are not finite, or have fewer than three numbers */
    OBJ_NO_COLOR,    /* vertex colours that are not finite */
    OBJ_VERTEX_SIZE, /* vertices of 2 numbers (z is 0) or 5 (two are ignored) */
    OBJ_SURFACE,     /* free-form surfaces and patches */
    OBJ_USEMAP,      /* textures that the file itself names */
    OBJ_UNKNOWN,     /* statements that are not in the standard */
    OBJ_ODDITY_COUNT
};

struct obj_odd_lines {
    uint64_t count, first; /* line of the first, from 0 */
};

enum obj_statement_kind { OBJ_USEMTL, OBJ_MTLLIB, OBJ_OBJECT };

/* A usemtl, mtllib, o or g statement; its name is text[offset, offset + size), continuations
 * included. */
struct obj_statement {
    enum obj_statement_kind kind;
    uint64_t face; /* number of faces of the block before it */
    uint64_t line; /* from 0 */
    uint64_t offset, size;
};

/* Reused buffers and the result of parsing into them. All zero at first. */
struct obj_block {
    char *buffer; /* holds the text */
    uint64_t buffer_capacity;
    const char *text; /* `size` bytes, then line ends and zeros, see fmt_obj_block_set_text() */
    uint64_t size;

    double (*positions)[3];
    float (*colors)[3];
    double (*texcoords)[2];
    float (*normals)[3];
    uint64_t count[FMT_MESH_KIND_COUNT];
    uint64_t position_capacity, color_capacity, texcoord_capacity, normal_capacity;
    bool has_colors;
    uint32_t
        *paint; /* ZBrush's colours, which comments hold, as late_colors of struct fmt_mesh_block */
    uint64_t paint_count, paint_capacity;
    bool bad_paint; /* such a comment has other text than colours */

    uint32_t *face_sizes;
    uint64_t *corners[FMT_MESH_KIND_COUNT];
    uint64_t face_count, corner_count;
    uint64_t face_capacity, corner_capacity[FMT_MESH_KIND_COUNT];
    bool has_corners[FMT_MESH_KIND_COUNT]; /* some corner of the block has an index of this kind */
    bool relative[FMT_MESH_KIND_COUNT];    /* some index of this kind is relative */

    bool objects; /* set by the caller: keep o and g statements */
    struct obj_statement *statements;
    uint64_t statement_count, statement_capacity;

    uint64_t lines;         /* line ends passed; if parsing stopped early, those before the stop */
    uint64_t known_lines;   /* statements of the OBJ standard other than elements and faces */
    char first_unknown[40]; /* beginning of the first statement that is not in the standard */
    uint64_t short_faces;
    struct obj_odd_lines odd[OBJ_ODDITY_COUNT];

    bool failed; /* the text is wrong in line `lines`; everything before it is valid */
    char error[160];
};

/* Ensures buffer capacity for `size` bytes of text and for what must follow it. */
int fmt_obj_block_reserve_text(struct bsq_ctx *ctx, struct obj_block *block, uint64_t size);
/* Makes bytes [begin, end) of the buffer the text, and writes what must follow it. */
void fmt_obj_block_set_text(struct obj_block *block, uint64_t begin, uint64_t end);

/* Parses block->text. at_file_start: a byte order mark may come first. Stops after face number
 * `last_face` (UINT64_MAX: never); `lines` is then the line of that face. Wrong text sets
 * block->failed and is not a failure here: blocks are parsed out of order, and only the first error
 * of the file is reported. Errors: BSQ_ENOMEM. */
int fmt_obj_block_parse(struct bsq_ctx *ctx, struct obj_block *block, bool at_file_start,
                        uint64_t last_face);

void fmt_obj_block_free(struct bsq_ctx *ctx, struct obj_block *block);

#endif
