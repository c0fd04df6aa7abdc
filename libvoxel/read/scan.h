/* scan.h - the door of this room: a scan's vertices as attribute streams, and its materials.
 *
 * Takes blocks of mesh files in order. Gives positions, colours, texture coordinates and
 * normals as streams of equal elements, in memory or in temporary files; the bounds and the origin;
 * the attributes that the chunk file keeps; and the table of materials. Faces are not kept, only
 * checked: partition/ takes them block by block. */
#ifndef VOX_READ_SCAN_H
#define VOX_READ_SCAN_H

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
    SCAN_COLORS,    /* RGBA8 sRGB; empty, or as long as the positions */
    SCAN_TEXCOORDS, /* float[2] */
    SCAN_NORMALS,   /* octahedral, or SCAN_NO_NORMAL */
    SCAN_STREAM_COUNT
};

/* An index that names no element of the scan. */
struct scan_bad_index {
    bool found;
    enum fmt_mesh_kind kind;
    uint64_t face, index;
};

/* Facts about the faces of one block. */
struct scan_face_check {
    uint32_t max_size; /* corners of the largest face, at least 3 */
    bool lacks_texcoord, has_normals;
    struct scan_bad_index bad_index; /* the first one */
};

struct scan {
    struct bsq_ctx *ctx;
    const struct sort_limits *limits;
    const char *const *paths;
    struct attribute_stream streams[SCAN_STREAM_COUNT];
    double origin[3];
    float bounds_min[3], bounds_max[3]; /* of all vertices; valid if there are any */
    bool origin_known, has_colors;
    float color_scale;        /* to 0..255, of blocks that do not say it; 0: not known yet */
    uint64_t clamped_colors;  /* vertices */
    uint64_t merged_vertices; /* see float_precision.h */
    struct fmt_mesh_totals totals;

    /* Of all faces. */
    uint32_t max_face_size;
    bool lacks_texcoord; /* some corner has none */
    bool has_normals;    /* some corner has one */
    struct scan_bad_index bad_index;

    /* Filled by vox_scan_find_materials(). */
    uint32_t attributes; /* of enum fmt_tris_attribute */
    uint32_t material_count;
    struct fmt_tris_material *materials;
    /* For usemtl number i: material of triangles with texture coordinates at 2 i, of those without
     * at 2 i + 1; the last pair is for faces before any usemtl. UINT32_MAX: none. */
    uint32_t *material_map;
    uint32_t usemtl_count;
};

void vox_scan_init(struct scan *scan, struct bsq_ctx *ctx, const struct sort_limits *limits,
                   const char *const *scan_paths, const char *tris_path);
void vox_scan_free(struct scan *scan);

/* Appends a block's elements to the streams. Serial, in the order of the file. */
int vox_scan_add_elements(struct scan *scan, const struct fmt_mesh_block *block);
/* Prefaults memory that streams will fill next. From any thread. */
void vox_scan_prefault(struct scan *scan);
/* Ends appending: the streams can be read from then on. A second call does nothing. */
int vox_scan_finish_streams(struct scan *scan);

/* Returns the bytes that streams have in memory. */
uint64_t vox_scan_stream_memory(const struct scan *scan);

/* Checks a block's faces after all elements are known. From any thread. */
void vox_scan_check_faces(const struct scan *scan, const struct fmt_mesh_block *block,
                          struct scan_face_check *out);
/* Adds the result to the scan. Serial, in the order of the file. */
void vox_scan_note_faces(struct scan *scan, const struct scan_face_check *check);

/* Ends reading: reports warnings. Errors: BSQ_EDATA if an index is out of range or there are no
 * faces. */
int vox_scan_finish(struct scan *scan, struct fmt_mesh_reader *reader);

/* Reads the MTL files and decides on attributes and materials. texture_path: an image for all faces
 * instead, or NULL. */
int vox_scan_find_materials(struct scan *scan, struct fmt_mesh_reader *reader,
                            const char *texture_path);

/* Returns whether the chunk file has this stream's attribute, after vox_scan_find_materials(). */
static inline bool scan_keeps(const struct scan *scan, enum scan_stream stream)
{
    static const uint32_t attributes[SCAN_STREAM_COUNT] = {0, FMT_TRIS_COLORS, FMT_TRIS_TEXCOORDS,
                                                           FMT_TRIS_NORMALS};
    return stream == SCAN_POSITIONS || (scan->attributes & attributes[stream]) != 0;
}

static inline uint64_t scan_count(const struct scan *scan, enum scan_stream stream)
{
    return stream_count(&scan->streams[stream]);
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
