/* obj_internal.h - private to the OBJ reader: its state and how its blocks share it.
 *
 * A block of an OBJ file begins at a line start and ends at a line end, so it can be parsed without
 * knowing what came before it. What depends on earlier blocks (relative indices, names, line
 * numbers) is resolved when the blocks pass in order. */
#ifndef FMT_MESH_OBJ_INTERNAL_H
#define FMT_MESH_OBJ_INTERNAL_H

#include "formats/mesh/mesh_format.h"

/* Bytes of text of one block. Text and result fit a core's cache, and blocks are large enough that
 * handing them around costs nothing. */
#define OBJ_BLOCK_BYTES ((uint64_t)512 << 10)

/* Encoding of parsed corners. A value below OBJ_RELATIVE_LIMIT is an index from 0 into the file.
 * Any other value except FMT_MESH_NONE is OBJ_RELATIVE_ZERO plus the signed distance from the first
 * element of the block; then block.carry_out has the bit of its kind. Indices have at most 18
 * digits, so the two ranges never meet. */
#define OBJ_RELATIVE_ZERO  ((uint64_t)1 << 62)
#define OBJ_RELATIVE_LIMIT ((uint64_t)1 << 61)

/* What a file has that has no meaning. It is read in the way of other programs, and counted. */
enum {
    OBJ_VERTEX_SIZE = STREAM_FORMAT_ODDITIES, /* vertices of 2 numbers (z is 0) or 5 (two are
                                                 ignored) */
    OBJ_SURFACE,                              /* free-form surfaces and patches */
    OBJ_USEMAP,                               /* textures that the file itself names */
    OBJ_UNKNOWN                               /* statements that are not in the standard */
};

/* Statements that are kept. The text is the name, continuations included. */
enum obj_statement_kind {
    OBJ_USEMTL,
    OBJ_MTLLIB,
    OBJ_OBJECT,        /* o or g */
    OBJ_FIRST_UNKNOWN, /* the whole statement, of the first OBJ_UNKNOWN of the block */
    OBJ_BAD_PAINT      /* a ZBrush comment of colours that has other text */
};

enum { OBJ_MATERIAL_DIGITS = 8 };

/* What the reader keeps of a file: source->data. */
struct obj_file {
    struct bsq_texts materials; /* of usemtl statements */
    /* If the reader numbers faces by object: the number of the material, as OBJ_MATERIAL_DIGITS
     * hexadecimal digits, and the name of the object. */
    struct bsq_texts objects;
    struct bsq_texts libraries; /* paths of material libraries */
    uint64_t *library_lines;    /* that name them first, from 1 */
    uint64_t line_capacity;
    uint64_t previewed; /* libraries that were read before the file */
    /* Of one reading, as far as it has come: */
    uint32_t material;       /* number in `materials` of the last usemtl, or FMT_MESH_NO_MATERIAL */
    uint32_t number;         /* over the scan: that faces have now */
    char *object;            /* the last object that a statement named; NULL: none */
    uint64_t plain_faces;    /* without a material */
    uint64_t known, unknown; /* statements */
    uint64_t first_unknown;  /* line of the first, from 1 */
    char unknown_text[40];   /* its start */
    bool bad_paint;
};

/* ---- obj_parse.c ---- */

/* Parses bytes [begin, begin + size) of slot->bytes, which have STREAM_PADDING bytes after them.
 * Stops after face number slot->last_face, or where the text is wrong. slot->at is the line of that
 * place: from block.first_line, if it is known, or else from 1. block.lines are the line ends.
 * slot->balance counts statements of the standard other than elements and faces. objects: keep o
 * and g statements. Errors: BSQ_ENOMEM, BSQ_EINTR. */
int fmt_obj_parse_text(struct stream_slot *slot, uint64_t begin, uint64_t size, bool objects);

/* ---- obj_material.c ---- */

/* The functions on struct stream_source implement struct fmt_mesh_format. */
int fmt_obj_read_materials(struct stream_source *source, struct fmt_materials *out);
int fmt_obj_preview_materials(struct stream_source *source, struct fmt_materials *out);
const char *fmt_obj_find_object(const struct stream_source *source, uint64_t number,
                                uint32_t *material);

/* Copies the text of a statement: continuations become blanks, trailing blanks go. The caller frees
 * *out with bsq_free(). */
int fmt_obj_statement_text(const struct stream_slot *slot, const struct stream_statement *statement,
                           char **out);

/* Enters the files that the mtllib statement in line `line`, from 1, names. */
int fmt_obj_enter_libraries(struct stream_source *source, uint64_t line, const char *text);

/* ---- mtl.c ---- */

/* Appends the materials of one MTL file. A file that does not exist, or is empty or not a regular
 * file, is a warning, not an error, as scans are often passed on without it. Malformed statements
 * are warnings. place: "scan.obj:1", the line that names the file, for its warnings. Errors:
 * BSQ_EDATA for a warning in a strict job; those of bsq_file_open(). */
int fmt_mtl_read(struct bsq_ctx *ctx, const char *path, const char *place,
                 struct fmt_materials *materials);

#endif
