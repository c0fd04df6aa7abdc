/* scan.h - private to the sorter: a scan as it was read, in columns and compact faces. */
#ifndef VOX_READ_SCAN_H
#define VOX_READ_SCAN_H

#include "formats/mesh/mesh_reader.h"
#include "formats/chunks/tris.h"
#include "libvoxel/read/attribute_stream.h"
#include "libvoxel/read/face_store.h"
#include "libvoxel/sort_limits.h"

/* Marks a normal without direction in the file; bsq_oct_pack() never yields it. */
#define SCAN_NO_NORMAL 0x80008000u
/* Of vertices without colour in a scan that has colours elsewhere. */
#define SCAN_DEFAULT_COLOR 0xffffffffu

/* Vertices have two columns, the others one. */
enum scan_column {
    SCAN_POSITIONS, /* float[3], relative to the origin */
    SCAN_COLORS,    /* RGBA8 sRGB; empty, or as long as the positions */
    SCAN_TEXCOORDS, /* float[2] */
    SCAN_NORMALS,   /* octahedral, or SCAN_NO_NORMAL */
    SCAN_COLUMN_COUNT
};

struct scan {
    struct bsq_ctx *ctx;
    const struct sort_limits *limits;
    const char *const *paths;
    struct column columns[SCAN_COLUMN_COUNT];
    struct face_store faces;
    double origin[3];
    float bounds_min[3], bounds_max[3]; /* of all vertices; valid if there are any */
    bool origin_known, has_colors, has_normals;
    float color_scale;        /* file's value to 0..255 */
    uint64_t clamped_colors;  /* vertices */
    uint64_t merged_vertices; /* see float_precision.h */
    struct fmt_mesh_totals totals;

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

/* Add what one block says, in the order of the file. */
int vox_scan_add_elements(struct scan *scan, const struct fmt_mesh_block *block);
/* Touches memory that columns will fill next; from any thread. */
void vox_scan_touch_ahead(struct scan *scan);
int vox_scan_add_faces(struct scan *scan, const struct fmt_mesh_block *block);
/* Both, for fmt_mesh_read(); struct scan is `arg`. */
int vox_scan_add_block(void *arg, const struct fmt_mesh_block *block);
/* Nothing follows in the columns, which can be read from then on; a second call does nothing. */
int vox_scan_finish_columns(struct scan *scan);
/* Call after the last block. Checks all indices; the first one out of range is the error. */
int vox_scan_finish(struct scan *scan, struct fmt_mesh_reader *reader);

/* Reads the MTL files and decides on attributes and materials. */
int vox_scan_find_materials(struct scan *scan, struct fmt_mesh_reader *reader,
                            const char *texture_path);

/* The sorted file has this column's attribute. Known after vox_scan_find_materials(). */
static inline bool scan_keeps(const struct scan *scan, enum scan_column column)
{
    static const uint32_t attributes[SCAN_COLUMN_COUNT] = {0, FMT_TRIS_COLORS, FMT_TRIS_TEXCOORDS,
                                                           FMT_TRIS_NORMALS};
    return column == SCAN_POSITIONS || (scan->attributes & attributes[column]) != 0;
}

static inline uint64_t scan_count(const struct scan *scan, enum scan_column column)
{
    return column_count(&scan->columns[column]);
}

/* Kind of the indices by which corners name the column's elements. */
static inline enum face_kind scan_kind_of(enum scan_column column)
{
    return column == SCAN_TEXCOORDS ? FACE_TEXCOORD
           : column == SCAN_NORMALS ? FACE_NORMAL
                                    : FACE_VERTEX;
}

/* The column that all indices of this kind name elements of. */
static inline enum scan_column scan_column_of(enum face_kind kind)
{
    return kind == FACE_TEXCOORD ? SCAN_TEXCOORDS
           : kind == FACE_NORMAL ? SCAN_NORMALS
                                 : SCAN_POSITIONS;
}

#endif
