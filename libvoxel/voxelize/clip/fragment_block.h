/* fragment_block.h - triangles on their way to the sums, and their pieces. */
#ifndef VOX_VOXELIZE_CLIP_FRAGMENT_BLOCK_H
#define VOX_VOXELIZE_CLIP_FRAGMENT_BLOCK_H

#include "libvoxel/voxelize/clip/accumulate.h"

enum {
    BLOCK_TRIANGLES = 256,
    BLOCK_PIECES = 3072,
    BLOCK_LANES_MAX = 8,
    BLOCK_RUN_TRIANGLE = 1 << 16, /* in a run, what a triangle's place is multiplied with */
    BLOCK_RUN_STEP = 8,
    BLOCK_NOWHERE = BLOCK_PIECES + BLOCK_LANES_MAX
};

/* Triangles by the planes that cut them, two bits an axis; the last kind is cut by more, or has a
 * texture. */
enum { KIND_LARGE = 64, KIND_COUNT };

struct block_triangle {
    int32_t low[4];        /* lowest cell, in the lattice; and 0 */
    uint32_t number;       /* in the chunk */
    uint16_t first, count; /* of its pieces */
    uint8_t kind;
    bool alone; /* to be divided by itself */
};

/* What the pieces of a triangle have in common, in rows of four (shade_lanes.h). */
enum block_row {
    ROW_CORNER,        /* first corner from the centre of the lowest cell, 1 */
    ROW_EDGE1,         /* from there to the second, 0 */
    ROW_EDGE2,         /* and to the third, 0 */
    ROW_FLAT,          /* unit normal of the triangle's plane, its grain */
    ROW_NORMAL,        /* at the first corner, 0 */
    ROW_TURN1,         /* from there to that at the second, 0 */
    ROW_TURN2,         /* and to that at the third, 0 */
    ROW_GRAIN,         /* 0; grain, or VOX_SHADED where the plane is not that of the normals */
    ROW_COLOR,         /* at the first corner, 1; or all 0 */
    ROW_COLOR_CHANGE1, /* from there to that at the second, 0 */
    ROW_COLOR_CHANGE2, /* and to that at the third, 0 */
    ROW_COUNT
};

struct block_facts {
    double row[ROW_COUNT][4];
};

/* Bit of a piece's cell: it has the triangle's own normal, as those of the corners cancel. */
enum { PIECE_FLAT = 64 };

/* A piece, in a form of which its sums are sums of products. */
struct block_piece {
    double area;      /* in voxel faces */
    double moment[2]; /* area times weight of the second and third corner at the centroid */
    uint32_t voxel;   /* in the region */
    uint8_t cell;     /* from the lowest of the triangle, two bits an axis; PIECE_FLAT */
    uint8_t lane;     /* of the triangle, while several are divided */
    uint16_t place;   /* of the piece in the block */
    double
        normal_weight; /* how much of area times interpolated normal goes to the sum of normals */
    double center_weight; /* and to that of centres */
    double unused[2];     /* a piece has a cache line */
};

struct vox_block {
    uint32_t triangle_count, piece_count;
    struct block_triangle triangles[BLOCK_TRIANGLES];
    uint16_t order[BLOCK_TRIANGLES]; /* by kind */
    /* Pieces in the order in which they are added, and the places of their triangles. */
    uint32_t run[BLOCK_PIECES + BLOCK_RUN_STEP];
    _Alignas(64) struct block_facts facts[BLOCK_TRIANGLES];
    /* Behind are pieces of a triangle that is divided by itself, and one that is not wanted. */
    _Alignas(64) struct block_piece pieces[BLOCK_NOWHERE + 1];
};

#endif
