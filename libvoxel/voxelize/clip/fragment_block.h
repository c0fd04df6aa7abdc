/* fragment_block.h - a block of triangles and their fragments, on the way to the sums. */
#ifndef VOX_VOXELIZE_CLIP_FRAGMENT_BLOCK_H
#define VOX_VOXELIZE_CLIP_FRAGMENT_BLOCK_H

#include "libvoxel/voxelize/clip/accumulate.h"

enum {
    BLOCK_TRIANGLES = 256,
    BLOCK_FRAGMENTS = 3072,
    BLOCK_LANES_MAX = 8,
    BLOCK_RUN_FACTS = 1 << 16, /* factor of the offset of facts in an entry of `run` */
    BLOCK_RUN_STEP = 8,
    BLOCK_NOWHERE = BLOCK_FRAGMENTS + BLOCK_LANES_MAX
};

/* Kinds of triangles, by the number of voxel planes that cut them: two bits for each axis. The last
 * kind is cut by more planes, or has a texture. */
enum { KIND_LARGE = 64, KIND_COUNT };

struct block_triangle {
    int32_t low[4];        /* lowest voxel of the grid that the bounds touch; and 0 */
    uint32_t number;       /* in the chunk */
    uint16_t first, count; /* of its fragments */
    uint8_t kind;
    bool alone; /* to be clipped alone, by clip.h */
};

/* What the fragments of a triangle share, in rows of four (shade_lanes.h). */
enum block_row {
    ROW_CORNER, /* first corner, relative to the centre of the lowest voxel; 1 */
    ROW_EDGE1,  /* vector from there to the second corner; 0 */
    ROW_EDGE2,  /* and to the third corner; 0 */
    ROW_FLAT,   /* unit normal of the triangle's plane; its facet-noise weight */
    ROW_NORMAL, /* normal at the first corner; 0 */
    ROW_TURN1,  /* change to the second corner; 0 */
    ROW_TURN2,  /* change to the third corner; 0 */
    ROW_NOISE,  /* 0; facet-noise weight, or VOX_INCONSISTENT if plane and normals are inconsistent
                 */
    ROW_COLOR,  /* colour at the first corner, 1; all 0 without a colour */
    ROW_COLOR_CHANGE1, /* change to the second corner; 0 */
    ROW_COLOR_CHANGE2, /* change to the third corner; 0 */
    ROW_COUNT
};

struct block_facts {
    double row[ROW_COUNT][4];
};

/* Bit of a fragment's lane: the fragment has the triangle's own normal, because those of the
 * corners cancel. */
enum { FRAGMENT_FLAT = 64 };

/* A fragment, in the form from which its sums are sums of products. */
struct block_fragment {
    double area;      /* in voxel faces */
    double moment[2]; /* area times weight of the second and of the third corner at the centroid */
    uint32_t voxel;   /* number in the region; above VOX_LINK_CLASS the class of its triangle */
    uint8_t cell;     /* place in shade_cells: relative to the lowest voxel of the triangle, 4 times
                         two bits for each axis */
    uint8_t lane;     /* of the triangle, while several are divided side by side; FRAGMENT_FLAT */
    uint16_t place;   /* of the fragment in the block */
    double normal_weight; /* factor of area times interpolated normal in the sum of normals */
    double center_weight; /* and in the sum of centroids */
    double unused[2];     /* a fragment fills a cache line */
};

struct vox_fragment_block {
    uint32_t triangle_count, fragment_count;
    struct block_triangle triangles[BLOCK_TRIANGLES];
    uint16_t order[BLOCK_TRIANGLES]; /* places of triangles, by kind */
    /* Fragments in the order in which they are added: offset of the triangle's facts times
     * BLOCK_RUN_FACTS, plus offset of the fragment, both in doubles from the start of the block. */
    uint32_t run[BLOCK_FRAGMENTS + BLOCK_RUN_STEP];
    _Alignas(64) struct block_facts facts[BLOCK_TRIANGLES];
    /* At the end: fragments of a triangle that is clipped alone, and one that takes what is not
     * wanted. */
    _Alignas(64) struct block_fragment fragments[BLOCK_NOWHERE + 1];
};

/* ---- accumulate.c ---- */

/* Sets the colours, in linear light, at the corners of a triangle without a texture. Returns false
 * if the triangle has no colour. */
bool vox_shade_corners(const struct vox_shading *shading, const struct fmt_tris_chunk *chunk,
                       uint32_t triangle, double rgb[3][3]);

/* Set what a fragment of a material with textures has from them: its colour in linear light, its
 * further channels, and the texel of its normal map; NULL: not wanted. Errors: those of
 * fmt_shade_attribute(). */
int vox_shade_textures(const struct fmt_shading *scan,
                       const struct fmt_shading_footprint *footprint, double *rgb, double *channels,
                       float *texel);

#endif
