/* block.h - triangles on their way to the sums, and their pieces. */
#ifndef VOX_BLOCK_H
#define VOX_BLOCK_H

#include "libvoxel/accumulate.h"

enum { BLOCK_TRIANGLES = 256, BLOCK_SAMPLES = 3072 };

/* Triangles by the planes that cut them, two bits an axis; the last kind is cut by more, or has a
 * texture. */
enum { KIND_LARGE = 64, KIND_COUNT };

struct block_triangle {
    int32_t low[4];        /* lowest cell, in the lattice; and 0 */
    uint32_t number;       /* in the chunk */
    uint16_t first, count; /* of its samples */
    uint8_t kind;
    bool inside; /* all its cells are in the window */
    bool alone;  /* to be divided by itself */
};

struct vox_block {
    uint32_t triangle_count, sample_count;
    struct block_triangle triangles[BLOCK_TRIANGLES];
    uint16_t order[BLOCK_TRIANGLES]; /* by kind */
    /* The last takes what is not wanted. */
    struct vox_sum samples[BLOCK_SAMPLES + 1];
    uint8_t cells[BLOCK_SAMPLES + 1]; /* from the lowest of the triangle, two bits an axis */
    uint32_t voxels[BLOCK_SAMPLES];   /* of the samples in the order of triangles, in the region */
    uint16_t places[BLOCK_SAMPLES];   /* where these samples are */
    struct vox_color_sum colors[];    /* of the samples, where the scan has colour */
};

#endif
