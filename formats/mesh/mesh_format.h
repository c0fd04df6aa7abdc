/* mesh_format.h - private to formats/mesh: what a mesh format implements, and the registry.
 *
 * A format is one source file that defines a `struct fmt_mesh_format`, and one row below.
 *
 * A reader delivers blocks in file order, each of at most about FMT_MESH_SLOT_BYTES. They are the
 * same for each reading, any budget and any number of threads. Their byte_size add up to the files.
 * A block and its arrays are memory of the reader that its caller may change in on_block: the
 * reader uses none of it after that, and no two arrays overlap.
 * The reader calls bsq_check() for each block. A reader without threads uses slot 0 only. */
#ifndef FMT_MESH_FORMAT_H
#define FMT_MESH_FORMAT_H

#include "formats/input/input.h"
#include "formats/mesh/mesh_reader.h"

/* Where a face is, for messages. */
struct fmt_mesh_place {
    const char *path;    /* owned by the reader */
    uint64_t line;       /* from 1; 0: the format has none */
    uint64_t byte;       /* of the file, from 0; 0: unknown, then messages count faces */
    uint64_t first_face; /* then: the face of the scan that is the first of the file */
    bool from_zero;      /* the file counts elements from 0, and not from 1 */
    /* By kind: elements of the scan in files before the face's file, and in the face's file. With
     * one file, base is 0. */
    uint64_t base[FMT_MESH_KIND_COUNT], count[FMT_MESH_KIND_COUNT];
};

/* open, close, read, estimate, read_materials, preview_materials and dependency do what
 * mesh_reader.h says about fmt_mesh_open() and so on. Only recognise, resembles,
 * read_materials, preview_materials and dependency may be NULL. */
struct fmt_mesh_format {
    const char *name;   /* for messages: "OBJ" */
    const char *suffix; /* of file names, with its point, in any case: ".obj". Blanks separate
                           several. */
    bool single;        /* a reader takes one input; several inputs have a reader each */
    /* Returns true if the first bytes of a file show this format beyond doubt. `head` is the first
     * FMT_MESH_HEAD_BYTES, or the whole file if it is shorter; no zero follows it. */
    bool (*recognise)(const char *head, size_t size);
    /* Returns true if they may be of this format. Asked if no format recognises them, the suffix
     * tells nothing, and they are of no other known kind. */
    bool (*resembles)(const char *head, size_t size);
    /* Sets *out to a structure that begins with a struct fmt_mesh_reader, and sets its ctx. The
     * inputs live longer than the reader. They may be packed, or pipes, so a reader opens them with
     * fmt_input_open() and knows their size only if fmt_input_size() does. */
    int (*open)(struct bsq_ctx *ctx, struct fmt_input *const *inputs, uint32_t input_count,
                struct fmt_mesh_reader **out);
    void (*close)(struct fmt_mesh_reader *reader);
    /* For each block calls steps->on_block, unless it is NULL, and then, if steps->follow is not
     * NULL, steps->follow and steps->finish. A reader without threads calls them one after the
     * other with slot 0. `totals` is never NULL and zero at first. */
    int (*read)(struct fmt_mesh_reader *reader, const struct fmt_mesh_steps *steps, void *arg,
                struct fmt_mesh_totals *totals);
    int (*estimate)(const struct fmt_mesh_reader *reader, struct fmt_mesh_estimate *out);
    /* Finds a face that has been read. */
    int (*locate_face)(struct fmt_mesh_reader *reader, uint64_t face, struct fmt_mesh_place *out);
    /* NULL: the format has no materials. */
    int (*read_materials)(struct fmt_mesh_reader *reader, struct fmt_materials *out);
    int (*preview_materials)(struct fmt_mesh_reader *reader, struct fmt_materials *out);
    /* NULL: the format refers to no other files. */
    const char *(*dependency)(const struct fmt_mesh_reader *reader, uint32_t index);
};

/* The start of every reader. */
struct fmt_mesh_reader {
    struct bsq_ctx *ctx;
    bool objects; /* set by fmt_mesh_use_objects() */
    /* Set by fmt_mesh_open_inputs(). */
    const struct fmt_mesh_format *format;
    struct fmt_input **inputs; /* owned */
    uint32_t input_count;
    struct fmt_mesh_placement *placements; /* of the inputs; owned; NULL: all stay in place */
};

/* Copies a material under another name. Free *out as fmt_materials_free() does. */
int fmt_material_copy(struct bsq_ctx *ctx, const struct fmt_material *from, const char *name,
                      struct fmt_material *out);
/* Gives a material copies of channels. */
int fmt_channels_copy(struct bsq_ctx *ctx, const struct fmt_material_channel *from, uint32_t count,
                      struct fmt_material *out);
void fmt_channels_free(struct bsq_ctx *ctx, struct fmt_material_channel *list, uint32_t count);

/* ---- mesh_place.c ---- */

/* Copies the placements, unless all leave their meshes as they are. */
int fmt_mesh_keep_placements(struct fmt_mesh_reader *reader,
                             const struct fmt_mesh_placement *placements);
/* Reads as fmt_mesh_read_steps() does, and places each block before steps->on_block. */
int fmt_mesh_read_placed(struct fmt_mesh_reader *reader, const struct fmt_mesh_steps *steps,
                         void *arg, struct fmt_mesh_totals *totals);

/* ---- mesh_mixed.c ---- */

/* Opens inputs that need several readers; formats: of each input. Implements `open`. */
int fmt_mesh_open_mixed(struct bsq_ctx *ctx, struct fmt_input *const *inputs,
                        const struct fmt_mesh_format *const *formats, uint32_t input_count,
                        struct fmt_mesh_reader **out);
extern const struct fmt_mesh_format fmt_mixed_format; /* of such a reader; not in the registry */

/* The registry. The first row also reads files that no row recognises. */
#define FMT_MESH_FORMATS(ROW)                                                                      \
    ROW(fmt_obj_format)                                                                            \
    ROW(fmt_ply_format) ROW(fmt_stl_format) ROW(fmt_gltf_format) ROW(fmt_scene_format)

#define FMT_MESH_DECLARE(format) extern const struct fmt_mesh_format format;
FMT_MESH_FORMATS(FMT_MESH_DECLARE)
#undef FMT_MESH_DECLARE

#endif
