/* mesh_reader.h - reads meshes of any format as a stream of batches, or whole when they are small.
 *
 * Takes paths of mesh files; gives batches of attribute streams and faces, in file order. Each
 * format is one row of the registry (mesh_format.h): a file's first bytes choose it, then its
 * suffix. A file that neither names is read as OBJ. Callers never learn which format a mesh has.
 *
 * Several files are read as one scan, also if they have several formats. Files may be packed by
 * gzip or Zstandard (formats/input). Nothing is kept: memory does not grow with the files. */
#ifndef FMT_MESH_READER_H
#define FMT_MESH_READER_H

#include "formats/material/material.h"
#include "base/context.h"

#define FMT_MESH_NONE        UINT64_MAX /* this corner has no such index */
#define FMT_MESH_NO_MATERIAL UINT32_MAX
/* This or a larger index refers to a texture coordinate or normal before the first of its file. */
#define FMT_MESH_BEFORE (((uint64_t)1 << 61) - 1)

/* What the indices of a face refer to. */
enum fmt_mesh_kind { FMT_MESH_VERTEX, FMT_MESH_TEXCOORD, FMT_MESH_NORMAL, FMT_MESH_KIND_COUNT };

/* "vertex", "texture coordinate", "normal" */
extern const char *const fmt_mesh_kind_names[FMT_MESH_KIND_COUNT];

/* From face `face` of the batch on, faces have material number `material`. */
struct fmt_mesh_material_change {
    uint64_t face;
    uint32_t material;
};

/* One batch. The arrays belong to the reader and live until the last step for this batch returns.
 * The second step may change those of faces. Bases count the elements of all earlier batches of the
 * scan. */
struct fmt_mesh_batch {
    uint64_t sequence;
    uint32_t file; /* number of the input file */
    uint64_t byte_size;

    uint64_t vertex_count, vertex_base;
    const double (*positions)[3];
    /* Positions and texture coordinates of the batch that are not finite in the file. All their
     * numbers are NaN; all others are finite. */
    uint64_t missing_positions, missing_texcoords;
    const float (*colors)[3]; /* sRGB as written, -1 for a vertex without colour; NULL: no vertex
                                 of the batch has one */
    float color_white; /* value of full intensity in `colors`; 0: 1 or 255, not known which */
    bool fine_colors;  /* some of `colors` need more than 8 bits */
    /* Colours of vertices of this or earlier batches, RGBA8 sRGB; the first is for vertex number
     * late_color_base of the scan. To be used if there is one for each vertex of the scan and
     * unread_colors of the totals is NULL. */
    const uint32_t *late_colors;
    uint64_t late_color_count, late_color_base;
    uint64_t texcoord_count, texcoord_base;
    const double (*texcoords)[2];
    uint64_t normal_count, normal_base;
    const float (*normals)[3]; /* as written, not normalised; 0, 0, 0 if not finite */

    uint64_t face_count, face_base;
    uint32_t *face_sizes; /* corners of each face, >= 3 */
    uint64_t corner_count;
    /* Per corner, 0-based over the whole scan. FMT_MESH_NONE: the corner has no texture coordinate
     * or normal. NULL: no corner of the batch has any. An index may refer to an element of a later
     * batch, or to none at all: check it against the totals at the end. */
    uint64_t *corner_vertices, *corner_texcoords, *corner_normals;
    uint64_t vertex_bound; /* above all of corner_vertices; UINT64_MAX: not known */

    uint64_t material_change_count;
    struct fmt_mesh_material_change *material_changes;
    uint32_t material_at_start; /* before the first change; FMT_MESH_NO_MATERIAL if none */
};

/* Returns whether one of `count` indices of corners is not FMT_MESH_NONE. */
static inline bool fmt_mesh_any_index(const uint64_t *indices, uint64_t count)
{
    for (uint64_t i = 0; indices && i < count; i++)
        if (indices[i] != FMT_MESH_NONE)
            return true;
    return false;
}

struct fmt_mesh_totals {
    uint64_t bytes, vertices, texcoords, normals, faces, corners;
    uint32_t materials;     /* that faces refer to */
    uint64_t skipped_lines; /* statements that the format does not define, skipped */
    uint64_t short_faces;   /* faces with fewer than three corners, skipped */
    bool has_tangents;      /* the file has tangents, which are not read */
    bool uneven_scale;      /* a node scales by factors that differ by axis */
    bool split_vertices;    /* the format repeats a vertex for each of its texture coordinates */
    bool flat_normals;      /* by the format's definition, faces without normals are flat */
    /* Says which colours of the file are not read and what the user can do; NULL if there are none.
     * Static storage. */
    const char *unread_colors;
};

struct fmt_mesh_reader;

/* Opens the files and checks that all can be read. The paths are copied. Errors: BSQ_ENOINPUT;
 * BSQ_EDATA for a file of a kind that is known but not read. */
int fmt_mesh_open(struct bsq_ctx *ctx, const char *const *paths, uint32_t path_count,
                  struct fmt_mesh_reader **out);
void fmt_mesh_close(struct fmt_mesh_reader *reader); /* NULL is allowed */

/* What is read as one scan. */
struct fmt_mesh_inputs {
    const char *const *paths;
    const struct bsq_source *const *sources; /* one for each path, or NULL; NULL: all are files */
    uint32_t path_count;
    const struct bsq_placement *placements; /* one for each path, or NULL */
    /* An output path, in whose directory packed files and pipes are unpacked into temporary files,
     * if the context has no directory for them. NULL: ".". */
    const char *beside;
    bool pipes; /* FIFOs, and "-" for standard input, are allowed; they are read once */
};
/* Opens as fmt_mesh_open() does. */
int fmt_mesh_open_inputs(struct bsq_ctx *ctx, const struct fmt_mesh_inputs *inputs,
                         struct fmt_mesh_reader **out);
/* Returns the name of a file's format: "OBJ". */
const char *fmt_mesh_format_name(const struct fmt_mesh_reader *reader, uint32_t file);
/* Returns the bytes of all files; 0 if some of them are packed, or pipes. */
uint64_t fmt_mesh_bytes(const struct fmt_mesh_reader *reader);

/* Returns true if a format of the registry recognises the file by its first bytes or its name.
 * `size` may be less than FMT_MESH_HEAD_BYTES only if the file is shorter. */
bool fmt_mesh_recognise(const char *path, const char *head, size_t size);
#define FMT_MESH_HEAD_BYTES 512
/* Returns the length of a path without the suffix of a packed file: ".gz" or ".zst". */
size_t fmt_mesh_unpacked_length(const char *path);

/* Reads everything. on_batch is called serially in order; it returns 0 to go on, or a negative
 * status, which stops and is returned. Numbers that are malformed are BSQ_EDATA with file, line and
 * the offending text. What is unknown, missing in the file or not finite is counted; the first
 * reading warns of it at its end, with the line of the first. Memory: see fmt_mesh_max_slots().
 * on_batch may be NULL (parse only). May be called again: batches, faces and materials have the
 * same numbers each time. The caller reports progress; the batches' byte_size add up to the files,
 * because bytes that yield nothing belong to a batch too. */
int fmt_mesh_read(struct fmt_mesh_reader *reader,
                  int (*on_batch)(void *arg, const struct fmt_mesh_batch *batch), void *arg,
                  struct fmt_mesh_totals *totals);

/* What a caller does with each batch while it is in memory. */
struct fmt_mesh_steps {
    /* As on_batch of fmt_mesh_read(). */
    int (*on_batch)(void *arg, const struct fmt_mesh_batch *batch);
    /* Called on all threads, in any order, but after on_batch of this batch and of all earlier
     * ones. No two calls at a time share a `slot`, which is below fmt_mesh_max_slots(). May be
     * NULL. */
    int (*follow)(void *arg, const struct fmt_mesh_batch *batch, unsigned slot);
    /* Called serially in order, after follow of the same batch. NULL exactly if follow is. */
    int (*finish)(void *arg, const struct fmt_mesh_batch *batch, unsigned slot);
};
/* Reads as fmt_mesh_read() does, with all three steps. */
int fmt_mesh_read_steps(struct fmt_mesh_reader *reader, const struct fmt_mesh_steps *steps,
                        void *arg, struct fmt_mesh_totals *totals);
/* Returns how many batches a reader holds at most. A batch takes up to 4 MiB, as a rule. */
unsigned fmt_mesh_max_slots(const struct fmt_mesh_reader *reader);

/* What samples of the files tell of a scan. */
struct fmt_mesh_hints {
    bool has_texcoords;
    bool faces_come_last; /* a single file, in which probably no elements follow faces */
};
/* Looks at samples of the files, without reading all of them; of a packed file, or a pipe, only at
 * the start. */
int fmt_mesh_look(const struct fmt_mesh_reader *reader, struct fmt_mesh_hints *out);

/* ---- materials ---- */

/* Gives each pair of material and object a material number of its own in the batches that follow.
 * An object of an OBJ file begins at an "o" or "g" statement and has its name. In glTF files
 * it is a node with a mesh. Call it before the first reading. Does nothing for formats without
 * objects. */
void fmt_mesh_use_objects(struct fmt_mesh_reader *reader);

/* Describes all materials that the batches read so far refer to; their index in the list is the
 * material number. A file of materials that is missing is a warning. Free *out with
 * fmt_materials_free(). */
int fmt_mesh_read_materials(struct fmt_mesh_reader *reader, struct fmt_materials *out);
/* Describes, before any reading, the materials in files that are named near the start of the mesh
 * files, whether faces use them or not. Their number has no meaning. Problems in these files are
 * warned of here, and not again by fmt_mesh_read_materials(). */
int fmt_mesh_preview_materials(struct fmt_mesh_reader *reader, struct fmt_materials *out);

/* ---- messages about faces ---- */

/* Returns in *out where a face is that has been read, for messages: "scan.obj:120",
 * "scan.ply: byte 99" or "scan.stl: face 12". Free it with bsq_free(). Reads the face's batch
 * again.
 */
int fmt_mesh_location_text(struct fmt_mesh_reader *reader, uint64_t face, char **out);

/* Occurrences of something, and the first face of the scan that has it. All zero at first. */
struct fmt_mesh_loss {
    uint64_t count, face;
};

/* Counts occurrences after those before; `face` has the first of them. */
static inline void fmt_mesh_add_loss(struct fmt_mesh_loss *loss, uint64_t count, uint64_t face)
{
    loss->face = loss->count > 0 ? loss->face : face;
    loss->count += count;
}

/* Reports that some of the scan's `faces` have a vertex without a position and are left out, if
 * kind is FMT_MESH_VERTEX, or that some corners refer to a texture coordinate or normal that their
 * file does not have. It is a warning of lost data, or BSQ_EDATA if more than 1 % of the faces are
 * left out: the file is damaged, or not what was meant. */
int fmt_mesh_report_loss(struct fmt_mesh_reader *reader, enum fmt_mesh_kind kind,
                         const struct fmt_mesh_loss *loss, uint64_t faces);

/* Returns whether no index but FMT_MESH_NONE is `end` or more. Indices and ends are below 2^62, so
 * the sign of the difference tells; FMT_MESH_NONE wraps to `end`. */
bool fmt_mesh_all_below(const uint64_t *indices, uint64_t count, uint64_t end);
/* Returns whether all vertex indices of a batch are below `end`. If not, sets the first face of the
 * scan that has another one, and this index. */
bool fmt_mesh_check_vertices(const struct fmt_mesh_batch *batch, uint64_t end, uint64_t *face,
                             uint64_t *index);

/* Describes a corner whose index is out of range, with file, line and value:
 * "scan.obj:120: face refers to vertex 99, file has 12". Returns BSQ_EDATA. `face` and `index` are
 * numbers over the whole scan. Reads the face's batch again. */
int fmt_mesh_fail_index(struct fmt_mesh_reader *reader, uint64_t face, enum fmt_mesh_kind kind,
                        uint64_t index);

/* Reports that a scan has no faces, and whether it has points instead. Returns BSQ_EDATA. */
int fmt_mesh_fail_no_faces(struct bsq_ctx *ctx, const char *path,
                           const struct fmt_mesh_totals *totals);

/* ---- a small mesh, whole ---- */

/* Indexed mesh in memory, triangulated; arrays are from the context's budget. */
struct fmt_mesh {
    uint64_t vertex_count, texcoord_count, normal_count, triangle_count;
    double (*positions)[3]; /* finite for all triangles */
    double (*texcoords)[2];
    float (*normals)[3]; /* unit length, or zero if the file's was zero or not finite */
    /* Three corners a triangle, indices into the arrays above. An array is NULL if the file has no
     * such index at all, an entry UINT32_MAX if this corner has none. */
    uint32_t (*vertices)[3];
    uint32_t (*corner_texcoords)[3];
    uint32_t (*corner_normals)[3];
    uint64_t *faces;     /* number of the polygon that each triangle came from */
    uint64_t *face_keys; /* of each polygon: a hash of its vertices in order */
    uint64_t face_count;
    bool has_tangents, uneven_scale, split_vertices,
        flat_normals; /* as in struct fmt_mesh_totals */
    /* If they are wanted: the materials with their objects, and the number of each polygon's, or
     * FMT_MESH_NO_MATERIAL. */
    struct fmt_materials materials;
    uint32_t *face_materials;
};

/* Loads a mesh whole (at most 2^32 - 2 vertices). Checks all indices. named: with the names of its
 * materials and objects. A file without faces is BSQ_EDATA. Free with fmt_mesh_free(). */
int fmt_mesh_load(struct bsq_ctx *ctx, const char *path, bool named, struct fmt_mesh *out);
void fmt_mesh_free(struct bsq_ctx *ctx, struct fmt_mesh *mesh);

/* Describes what is wrong with polygon number `face` of a loaded mesh, with file and line, for
 * which it reads the file again: "low.obj:12: face has no texture coordinates", of which "has no
 * texture coordinates" is `what`. Returns BSQ_EDATA. */
int fmt_mesh_fail_face(struct bsq_ctx *ctx, const char *path, uint64_t face, const char *what);

#endif
