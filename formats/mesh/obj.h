/* obj.h - Wavefront OBJ, read as a stream of parsed blocks.
 *
 * fmt_obj_read() cuts the text into blocks at line ends, parses them on all threads into reused
 * buffers and hands them over in file order. Nothing is kept: memory does not grow with the file.
 * Several files are read as one scan; each file's indices count from its own first element.
 *
 * Understood: v with 3, 4, 6 or 7 numbers, vt, vn, f with all four index forms and any number of
 * corners, negative indices, usemtl, mtllib; CRLF, tabs, line continuation, comments, exponents.
 * Other statements (g, o, s, l, p, ...) are skipped. Numbers are rounded like strtod() in the C
 * locale.
 *
 * Of a vertex with more than three numbers, a single fourth is w, which means nothing for polygons
 * and is ignored; six are x y z r g b; seven are x y z r g b a, the form that programs with vertex
 * colours write and most readers take, and a is ignored. */
#ifndef FMT_MESH_OBJ_H
#define FMT_MESH_OBJ_H

#include "base/context.h"
#include "formats/mesh/mtl.h"

#ifdef __cplusplus
extern "C" {
#endif

#define FMT_OBJ_NONE UINT64_MAX /* "this corner has no such index" */

/* usemtl: `material` (see fmt_obj_materials) holds from face `face` of the block on. */
struct fmt_obj_material_change {
    uint64_t face;
    uint32_t material;
};

/* One parsed block. All arrays belong to the reader and live until the callback returns.
 * Bases are counts over the whole scan of what came before this block. */
struct fmt_obj_block {
    uint64_t sequence;
    uint32_t file;        /* number of the input file */
    uint64_t byte_offset; /* of the block in its file */
    uint64_t byte_size;

    uint64_t vertex_count, vertex_base;
    const double (*positions)[3];
    const float (*colors)[3]; /* as written, NULL when no vertex of the block has one;
                                 -1 for those without */
    uint64_t texcoord_count, texcoord_base;
    const double (*texcoords)[2];
    uint64_t normal_count, normal_base;
    const float (*normals)[3]; /* as written, not normalised */

    uint64_t face_count, face_base;
    const uint32_t *face_sizes; /* corners of each face, >= 3 */
    uint64_t corner_count;
    /* Per corner, 0-based over the whole scan; texcoord and normal are FMT_OBJ_NONE where the
     * corner has none, and the arrays NULL where no corner of the block has any. An index may
     * point past what has been read so far: check against the totals at the end. */
    const uint64_t *corner_vertices;
    const uint64_t *corner_texcoords;
    const uint64_t *corner_normals;

    uint64_t material_change_count;
    const struct fmt_obj_material_change *material_changes;
    uint32_t material_at_start; /* in force before the first change; FMT_OBJ_NO_MATERIAL if none */
};
#define FMT_OBJ_NO_MATERIAL UINT32_MAX

struct fmt_obj_totals {
    uint64_t bytes, vertices, texcoords, normals, faces, corners;
    uint64_t skipped_lines; /* statements that are not in the OBJ standard */
    uint64_t short_faces;   /* f with fewer than three corners: skipped */
    bool has_polypaint;     /* comments have ZBrush's colours (#MRGB), which are not read */
};

struct fmt_obj_reader;

/* Opens the files and checks that all can be read. The paths are copied. Errors: BSQ_ENOINPUT. */
int fmt_obj_open(struct bsq_ctx *ctx, const char *const *paths, uint32_t path_count,
                 struct fmt_obj_reader **out);
void fmt_obj_close(struct fmt_obj_reader *reader);

/* Reads everything. on_block is called serially in order; 0 goes on, < 0 stops and is returned.
 * NaN and infinite numbers, malformed numbers and index 0 are BSQ_EDATA with file, line and the
 * offending text. Memory: a few MiB a thread, from the budget. on_block may be NULL (parse only).
 * May be called again: numbers of blocks, faces and materials are the same each time. Progress is
 * the caller's to report; the blocks' byte_size add up to the files. */
int fmt_obj_read(struct fmt_obj_reader *reader,
                 int (*on_block)(void *arg, const struct fmt_obj_block *block), void *arg,
                 struct fmt_obj_totals *totals);

/* More that can be done with a block while it is in memory. */
struct fmt_obj_steps {
    /* As on_block of fmt_obj_read(). */
    int (*on_block)(void *arg, const struct fmt_obj_block *block);
    /* On all threads, in any order, but after on_block of this block and of all before it. No two
     * calls at a time share a `slot`, which is below fmt_obj_max_slots(). */
    int (*follow)(void *arg, const struct fmt_obj_block *block, unsigned slot);
    /* Serially in order, after follow of the same block. */
    int (*finish)(void *arg, const struct fmt_obj_block *block, unsigned slot);
};
/* fmt_obj_read() with all three steps. */
int fmt_obj_read_steps(struct fmt_obj_reader *reader, const struct fmt_obj_steps *steps, void *arg,
                       struct fmt_obj_totals *totals);
unsigned fmt_obj_max_slots(const struct fmt_obj_reader *reader);
/* The same for any context; a slot takes up to FMT_OBJ_SLOT_BYTES, as a rule. */
unsigned fmt_obj_slots_for(uint64_t memory_bytes, unsigned threads);
#define FMT_OBJ_SLOT_BYTES ((uint64_t)4 << 20)

/* What samples of the text say of the whole, within some percent of ordinary scans. */
struct fmt_obj_estimate {
    uint64_t vertices, texcoords, normals, faces, corners;
    bool has_colors;
    bool faces_come_last; /* a single file, and no sample shows elements behind faces */
};
int fmt_obj_estimate(const struct fmt_obj_reader *reader, struct fmt_obj_estimate *out);

/* Names of materials met by usemtl so far, index = material number. Owned by the reader. */
uint32_t fmt_obj_material_count(const struct fmt_obj_reader *reader);
const char *fmt_obj_material_name(const struct fmt_obj_reader *reader, uint32_t material);
/* Paths of the mtllib files named, resolved against the OBJ's directory. Owned by the reader. */
uint32_t fmt_obj_library_count(const struct fmt_obj_reader *reader);
const char *fmt_obj_library_path(const struct fmt_obj_reader *reader, uint32_t library);

/* Describes all materials met, index = material number, each from the libraries of the file that
 * uses it: tiles of a scan may give different materials the same name. A library that is missing
 * is a warning; materials that no library knows keep the defaults of mtl.h. Free *out with
 * fmt_mtl_free(). */
int fmt_obj_read_materials(struct fmt_obj_reader *reader, struct fmt_materials *out);

/* Line number (from 1) of face number `face` of the scan, and its file; found by reading the
 * block again, so for messages only. */
int fmt_obj_locate_face(struct fmt_obj_reader *reader, uint64_t face, const char **path,
                        uint64_t *line);

/* Describes a corner whose index is out of range, with file, line and value:
 * "scan.obj:120: face refers to vertex 99, file has 12". Returns BSQ_EDATA. `kind` is "vertex",
 * "texture coordinate" or "normal"; index as in fmt_obj_block. */
int fmt_obj_fail_index(struct fmt_obj_reader *reader, uint64_t face, const char *kind,
                       uint64_t index);

/* ---- a small mesh, whole ---- */

/* Indexed mesh in memory, triangulated; arrays are from the context's budget. */
struct fmt_mesh {
    uint64_t vertex_count, texcoord_count, normal_count, triangle_count;
    double (*positions)[3];
    double (*texcoords)[2];
    float (*normals)[3]; /* unit length, or zero where the file's was zero */
    /* Three corners a triangle, indices into the arrays above; the arrays are NULL where the file
     * has none at all, entries UINT32_MAX where this corner has none. */
    uint32_t (*vertices)[3];
    uint32_t (*corner_texcoords)[3];
    uint32_t (*corner_normals)[3];
    uint64_t *faces; /* number of the polygon that each triangle came from */
    uint64_t face_count;
};

/* Loads an OBJ whole (at most 2^32 - 2 vertices). Checks all indices. A file without faces is
 * BSQ_EDATA. Free with fmt_mesh_free(). */
int fmt_mesh_load(struct bsq_ctx *ctx, const char *path, struct fmt_mesh *out);
void fmt_mesh_free(struct bsq_ctx *ctx, struct fmt_mesh *mesh);

#ifdef __cplusplus
}
#endif
#endif
