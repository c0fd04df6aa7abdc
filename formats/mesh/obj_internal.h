/* obj_internal.h - private to the OBJ reader: its state and how its parts share it. */
#ifndef FMT_MESH_OBJ_INTERNAL_H
#define FMT_MESH_OBJ_INTERNAL_H

#include "formats/mesh/mesh_format.h"
#include "formats/mesh/obj_block.h"

/* Bytes of text of one block. It is the same for any budget and number of threads, as callers see
 * the blocks. Text and result fit a core's cache, and blocks are large enough that handing them
 * around costs nothing. */
#define OBJ_BLOCK_BYTES ((uint64_t)512 << 10)

struct obj_source {
    struct fmt_input *input; /* open from the produce of its first block to the emit of its last */
    const char *path;        /* of the input */
    bool open;
    /* Number of elements in earlier files, and in this file as far as it has been read. */
    uint64_t base[FMT_MESH_KIND_COUNT], count[FMT_MESH_KIND_COUNT];
    uint64_t lines;
    uint64_t paint;       /* colours in ZBrush's comments, as far as the file has been read */
    bool bad_paint;       /* such a comment has other text than colours */
    uint64_t plain_faces; /* without a material, as far as the file has been read */
};

/* The place of a block that has faces. */
struct obj_place {
    uint32_t source;
    uint64_t block; /* number of OBJ_BLOCK_BYTES in the file */
    uint64_t face_base, first_line;
};

struct obj_name {
    char *text;
    uint32_t source; /* the file that contains it */
    uint64_t line;   /* of a library: that names it first, from 1 */
};

/* Names in order of first appearance; `slots` is an open-addressing hash table of number + 1. */
struct obj_names {
    struct obj_name *list;
    uint64_t count, capacity;
    uint32_t *slots;
    uint64_t slot_count;
};

/* Odd lines of all files; the first one is line `line`, from 1, of file `source`. */
struct obj_odd_place {
    uint64_t count, line;
    uint32_t source;
};

struct obj_reader {
    struct fmt_mesh_reader base;
    struct obj_source *sources;
    uint32_t source_count;
    struct obj_place *places;
    uint64_t place_count, place_capacity;
    struct obj_names materials, libraries;
    struct obj_odd_place odd[OBJ_ODDITY_COUNT]; /* of the current reading */
    bool read_before;                           /* the files were read to their end */
    bool has_colors;                            /* of vertices, in any file that was read */
    bool warns; /* of materials without colours: set by a preview, cleared by the first warning */
    uint64_t previewed; /* libraries that were read before the files */
    /* If the reader numbers faces by object too: the object's name, and as its `source` the number
     * of the material. Blocks have numbers of this table instead of `materials`. */
    struct obj_names parts;
};

/* Returns the table whose numbers blocks have as materials. */
static inline const struct obj_names *fmt_obj_numbers(const struct obj_reader *reader)
{
    return reader->base.objects ? &reader->parts : &reader->materials;
}

/* ---- obj_text.c ---- */

/* Loads the lines that begin in bytes [index, index + 1) * OBJ_BLOCK_BYTES of an open input into
 * block->text; there may be none. *offset: where they begin in the file. */
int fmt_obj_text_load(struct bsq_ctx *ctx, struct fmt_input *input, uint64_t index,
                      struct obj_block *block, uint64_t *offset);

/* ---- obj_sample.c ---- */

/* This and the other functions on struct fmt_mesh_reader implement struct fmt_mesh_format. */
int fmt_obj_estimate(const struct fmt_mesh_reader *reader, struct fmt_mesh_estimate *out);

/* ---- obj_locate.c ---- */

int fmt_obj_locate_face(struct fmt_mesh_reader *reader, uint64_t face, struct fmt_mesh_place *out);

/* Reports a relative vertex index that points before the start of the file: at corner number
 * `corner` of `block`, which is block number `index` of the source. Returns BSQ_EDATA. */
int fmt_obj_fail_relative(struct obj_reader *reader, const struct obj_source *source,
                          const struct obj_block *block, uint64_t index, uint64_t corner);

/* ---- obj_material.c ---- */

int fmt_obj_read_materials(struct fmt_mesh_reader *reader, struct fmt_materials *out);
int fmt_obj_preview_materials(struct fmt_mesh_reader *reader, struct fmt_materials *out);
const char *fmt_obj_dependency(const struct fmt_mesh_reader *reader, uint32_t index);

/* Sets *number to the number of `name` in the file `source`; enters the name if it is new. */
int fmt_obj_names_enter(struct bsq_ctx *ctx, struct obj_names *names, uint32_t source,
                        const char *name, uint32_t *number);
void fmt_obj_names_free(struct bsq_ctx *ctx, struct obj_names *names);

/* Copies the text of a statement: continuations become blanks, trailing blanks go. The caller frees
 * *out with bsq_free(). */
int fmt_obj_statement_text(struct bsq_ctx *ctx, const struct obj_block *block,
                           const struct obj_statement *statement, char **out);

/* Enters the files that the mtllib statement in line `line`, from 1, names. */
int fmt_obj_enter_libraries(struct obj_reader *reader, uint32_t source, uint64_t line,
                            const char *text);

#endif
