/* scan.h - the public header of this folder: a scan's vertices as attribute streams, and its
 * materials.
 *
 * Takes batches of mesh files in order. Gives positions, colours, texture coordinates and
 * normals as streams of equal elements, in memory or in temporary files; the bounds and the origin;
 * the attributes that the chunk file keeps; and the table of materials. Faces are not kept, only
 * checked: partition/ takes them batch by batch. */
#ifndef VOX_READ_SCAN_H
#define VOX_READ_SCAN_H

#include "base/text.h"
#include "formats/mesh/mesh_reader.h"
#include "formats/chunks/tris.h"
#include "libvoxel/read/attribute_stream.h"
#include "libvoxel/sort_limits.h"

/* Marks a normal without direction in the file; bsq_oct_pack() never yields it. */
#define SCAN_NO_NORMAL 0x80008000u
/* Colour of vertices without one in a scan that has colours elsewhere. */
#define SCAN_DEFAULT_COLOR 0xffffffffu

/* Vertices have two streams, the others one. */
enum scan_stream {
    SCAN_POSITIONS, /* float[3], relative to the origin */
    SCAN_COLORS,    /* see vox_scan_scale_colors(); as long as the positions if has_colors is set */
    SCAN_FINE_COLORS, /* see fmt_tris_fine_color(); as long as they are or, if all are 0, empty */
    SCAN_TEXCOORDS,   /* float[2] */
    SCAN_NORMALS,     /* octahedral, or SCAN_NO_NORMAL */
    SCAN_STREAM_COUNT
};

/* An index that names no element of the scan. */
struct scan_bad_index {
    bool found;
    enum fmt_mesh_kind kind;
    uint64_t face, index;
};

/* Elements of one kind that the file has no finite numbers for: a bit for each element. There are
 * no bits if nothing is missing, as in nearly all scans. */
struct scan_missing {
    uint64_t *bits;
    uint64_t words, capacity; /* of 64 bits */
};

/* What became of a file's ZBrush polypaint. */
enum scan_paint { SCAN_PAINT_NONE, SCAN_PAINT_USED, SCAN_PAINT_LOST };

/* What one of a scan's files has. */
struct scan_file {
    uint64_t ends[FMT_MESH_KIND_COUNT];         /* elements of this and of all earlier files */
    uint64_t bytes;                             /* unpacked */
    bool has_colors;                            /* of vertices, in their own lines */
    bool has_faces, has_normals, has_texcoords; /* some corner has one */
    uint64_t colorless_faces;                   /* with a vertex without a colour */
    bool has_material_colors; /* faces use a material with a colour, but without a texture; set by
                                 vox_scan_find_materials() */
    enum scan_paint paint;    /* late colours */
    /* Of vertex colours in batches that do not say their scale: the largest component, whether one
     * is no whole number, and the vertices with one out of 0 to 1, out of 0 to 255. */
    float largest_color;
    bool broken_colors;
    uint64_t clamped_colors[2];
};

/* What faces with a material have. */
struct scan_material_use {
    uint32_t file; /* that uses it; UINT32_MAX: none */
    uint64_t faces;
    uint64_t bare_faces; /* with a corner that has no texture coordinate */
};

/* Facts about the faces of one batch. */
struct scan_face_check {
    struct fmt_mesh_batch faces; /* the batch, without faces and indices that name nothing */
    uint32_t max_size;           /* corners of the largest face, at least 3 */
    bool lacks_texcoord, has_normals, has_texcoords;
    uint64_t colorless;              /* faces with a vertex without a colour */
    struct scan_bad_index bad_index; /* the first one of a vertex */
    /* By kind: faces left out for lack of a position, and corners that refer to a texture
     * coordinate or normal that the file does not have. */
    struct fmt_mesh_loss lost[FMT_MESH_KIND_COUNT];
};

/* A texture that is checked. */
struct scan_texture {
    /* The first and the latest material that names it, NULL if the options do, and the number of
     * further ones; where the first one is. Valid while it is checked. */
    const struct fmt_material *first, *latest;
    uint64_t others;
    const char *place; /* as in struct fmt_material_channel */
    bool good;         /* it can be used */
    bool alpha;        /* and has an alpha channel */
};

/* The textures that have been checked. All zero at first. */
struct scan_textures {
    struct bsq_tally tally;
    struct bsq_texts paths;
    struct scan_texture *list; /* one for each path */
    uint64_t count, capacity;
    uint64_t checked; /* the first of these */
    /* Channels whose textures are checked too; only_channels: no others are. */
    const struct vox_channel *channels;
    uint32_t channel_count;
    bool only_channels;
};

struct scan {
    struct bsq_ctx *ctx;
    const struct sort_limits *limits;
    const char *const *paths;
    uint32_t path_count;
    struct attribute_stream streams[SCAN_STREAM_COUNT];
    double origin[3];
    float bounds_min[3], bounds_max[3]; /* of all vertices; valid if there are any */
    bool origin_given;                  /* by the caller */
    bool origin_known, has_colors;
    float batch_scale;        /* factor from the colours of the batch that is appended to 0..255;
                                 0: it is not known yet */
    uint64_t clamped_colors;  /* vertices */
    uint64_t merged_vertices; /* see float_precision.h */
    struct scan_missing missing[FMT_MESH_KIND_COUNT]; /* of vertices and texture coordinates */
    /* Vertices without a colour, in files with others that have one in their own line. */
    struct scan_missing missing_colors;
    struct fmt_mesh_totals totals;
    struct scan_file *files; /* one for each path. vox_scan_check_faces() reads the entry of its
                                batch on other threads, while batches without elements are added. */
    uint64_t file_count;     /* up to the last one that had a batch so far; at the end all */
    /* By the readers' number of a material, up to the last one that was used so far. */
    struct scan_material_use *material_uses;
    uint64_t material_use_count, material_use_capacity;
    struct scan_material_use without_material; /* of faces without one; `file` is not used */

    /* Of all faces. */
    bool lacks_texcoord; /* some corner has none */
    bool has_normals;    /* some corner has one */
    struct scan_bad_index bad_index;
    struct fmt_mesh_loss lost[FMT_MESH_KIND_COUNT]; /* as in struct scan_face_check */

    const struct vox_channel *channels; /* to keep; set after vox_scan_init() */
    uint32_t channel_count;
    struct vox_channel
        *found_optional; /* `channels` without optional ones that nothing has; owned */
    bool tells_unkept;   /* see struct vox_sort_options; set after vox_scan_init() */

    /* Filled by vox_scan_find_materials(). */
    uint32_t attributes; /* of enum fmt_tris_attribute */
    enum fmt_ids ids;
    uint32_t material_count;
    struct fmt_tris_material *materials;
    bool double_sided;    /* some faces have a material that is seen from behind too */
    bool lost_colors;     /* all textures of colour are missing, and there are no other colours */
    bool *found_channels; /* of each channel: some material has it */
    uint32_t
        unkept; /* bits by fmt_channel_at(): materials have it, and the scan does not keep it */
    /* For usemtl number i: material of triangles with texture coordinates at 2 i, of those without
     * at 2 i + 1; the last pair is for faces before any usemtl. UINT32_MAX: none. */
    uint32_t *material_map;
    uint32_t usemtl_count;
};

/* Makes an empty scan of `path_count` files. Free it with vox_scan_free(), also after a failure.
 * Errors: BSQ_ENOMEM. */
int vox_scan_init(struct scan *scan, struct bsq_ctx *ctx, const struct sort_limits *limits,
                  const char *const *scan_paths, uint32_t path_count, const char *tris_path);
void vox_scan_free(struct scan *scan);

/* Returns whether a batch has vertices, texture coordinates, normals or late colours. */
bool vox_scan_has_elements(const struct fmt_mesh_batch *batch);
/* Appends a batch's elements to the streams. Serial, in the order of the file. Errors:
 * BSQ_ENOMEM, BSQ_EIO, BSQ_EDATA. */
int vox_scan_add_elements(struct scan *scan, const struct fmt_mesh_batch *batch);
/* Turns colours of the vertices from `first` on, as the stream has them, into RGBA8 sRGB in place,
 * and the fine colours beside them, unless `fine` is NULL. Those whose scale was known when they
 * were read are such colours. Call vox_scan_finish() before. */
void vox_scan_scale_colors(const struct scan *scan, uint64_t first, uint64_t count,
                           uint32_t *colors, uint32_t *fine);
/* Prefaults memory that streams will fill next. From any thread. */
void vox_scan_prefault(struct scan *scan);
/* Ends appending: the streams can be read from then on. A second call does nothing. */
int vox_scan_finish_streams(struct scan *scan);

/* Returns the bytes that streams have in memory. */
uint64_t vox_scan_stream_memory(const struct scan *scan);

/* Checks a batch's faces after all elements are known. Faces and indices whose elements do not
 * exist are removed from the batch's arrays. From any thread. */
void vox_scan_check_faces(const struct scan *scan, const struct fmt_mesh_batch *batch,
                          struct scan_face_check *out);
/* Returns the bytes that notes on missing elements take. */
uint64_t vox_scan_missing_memory(const struct scan *scan);
/* Adds the result to the scan. Serial, in the order of the file. Errors: BSQ_ENOMEM. */
int vox_scan_note_faces(struct scan *scan, const struct scan_face_check *check);

/* Ends reading: completes the list of files and reports warnings. Errors: BSQ_EDATA if the index of
 * a vertex is out of range, if more than 1 % of the faces are left out, or if there are no faces.
 */
int vox_scan_finish(struct scan *scan, struct fmt_mesh_reader *reader);

/* Checks the textures that the files name near their start, or only the one at `texture_path`,
 * unless it is NULL. To be called before reading. has_texcoords: else no texture matters. A bad
 * texture is a warning if a material names it. Errors: BSQ_EDATA and BSQ_ENOINPUT for a bad texture
 * at texture_path and in a strict job; those of fmt_textures_open(). Free *textures with
 * vox_textures_free(). */
int vox_textures_preview(struct bsq_ctx *ctx, struct fmt_mesh_reader *reader,
                         const char *texture_path, bool has_texcoords,
                         struct scan_textures *textures);
/* Notes the textures of materials as inputs, and checks those that have not been checked yet:
 * decodes them once. Materials lose those that cannot be used. */
int vox_textures_check(struct bsq_ctx *ctx, struct fmt_materials *materials, bool has_texcoords,
                       struct scan_textures *textures);
/* Checks alike a texture of the options, which must be good. */
int vox_textures_check_image(struct bsq_ctx *ctx, const char *path, struct scan_textures *textures);
/* If the scan keeps opacity, makes the alpha channels of colour textures the opacity of their
 * materials, unless a material has another texture of opacity. path: the colour texture of all
 * materials; NULL: their own ones. They were checked. */
int vox_textures_use_alpha(struct scan *scan, const struct scan_textures *textures,
                           const char *path, struct fmt_materials *materials);
void vox_textures_free(struct bsq_ctx *ctx, struct scan_textures *textures);

/* Reads the MTL files and decides on attributes and materials. texture_path: an image for all faces
 * instead, or NULL. ids: those to keep; by name, each material has its name. Errors: BSQ_EDATA for
 * ids by colour of a scan without colours. */
int vox_scan_find_materials(struct scan *scan, struct fmt_mesh_reader *reader,
                            const char *texture_path, struct scan_textures *textures,
                            enum fmt_ids ids);

/* Returns the path of a texture that the chunk file will need, or NULL. in_tiles: one that is
 * several files. */
const char *vox_scan_find_texture(const struct scan *scan, bool in_tiles);

/* Warns of files without faces, and of attributes that some files have and others lack, in a scan
 * of several files. Called after vox_scan_find_materials(). */
int vox_scan_compare_files(struct scan *scan, const char *texture_path);
/* Warns of faces at vertices without a colour in a file with other, coloured vertices, if colours
 * of materials are lost by that. Called after vox_scan_find_materials(). */
int vox_scan_warn_colorless(const struct scan *scan);
/* Returns the number of elements in a file and in all earlier ones, of a kind of index. */
static inline uint64_t scan_file_end(const struct scan *scan, uint32_t file,
                                     enum fmt_mesh_kind kind)
{
    return scan->files[file].ends[kind];
}

/* Returns the attributes of the scan's chunk file. */
static inline uint32_t scan_stored_attributes(const struct scan *scan)
{
    const bool sampled = scan->totals.faces >= FMT_TRIS_SAMPLED_FACES;
    return scan->attributes | (sampled ? (uint32_t)FMT_TRIS_SAMPLES : 0);
}

/* Returns whether the chunk file has this stream's attribute, after vox_scan_find_materials(). */
static inline bool scan_keeps(const struct scan *scan, enum scan_stream stream)
{
    static const uint32_t attributes[SCAN_STREAM_COUNT] = {0, FMT_TRIS_COLORS, FMT_TRIS_FINE_COLORS,
                                                           FMT_TRIS_TEXCOORDS, FMT_TRIS_NORMALS};
    return stream == SCAN_POSITIONS || (scan->attributes & attributes[stream]) != 0;
}

/* Returns whether an element is missing. Any number may be asked for. */
static inline bool scan_is_missing(const struct scan_missing *missing, uint64_t index)
{
    return index / 64 < missing->words && missing->bits[index / 64] >> index % 64 & 1;
}

/* Returns whether a vertex has this colour: three times -1 stands for none. */
static inline bool scan_color_given(const float color[3])
{
    return color[0] != -1.0f || color[1] != -1.0f || color[2] != -1.0f;
}

static inline uint64_t scan_count(const struct scan *scan, enum scan_stream stream)
{
    return scan->streams[stream].count;
}

/* Returns the kind of index that names elements of the stream. */
static inline enum fmt_mesh_kind scan_kind_of(enum scan_stream stream)
{
    return stream == SCAN_TEXCOORDS ? FMT_MESH_TEXCOORD
           : stream == SCAN_NORMALS ? FMT_MESH_NORMAL
                                    : FMT_MESH_VERTEX;
}

/* Returns a stream whose elements indices of this kind name. */
static inline enum scan_stream scan_stream_of(enum fmt_mesh_kind kind)
{
    return kind == FMT_MESH_TEXCOORD ? SCAN_TEXCOORDS
           : kind == FMT_MESH_NORMAL ? SCAN_NORMALS
                                     : SCAN_POSITIONS;
}

#endif
