/* bk_types.h - what host and kernel share. 32-bit scalars only, explicit padding; sizes are
 * asserted. Lengths and positions are in index space: voxels of the grid, voxel (i, j, k) spans i -
 * 0.5 .. i + 0.5, as the grid file's transform has it (its centre is the integer point). */
#ifndef BAKE_KERNEL_BK_TYPES_H
#define BAKE_KERNEL_BK_TYPES_H

#include "bk_compat.h"

#define BK_NO_TRIANGLE 0xffffffffu

/* The skew of a sample whose ray runs along the normal of its triangle; 0: along the direction that
 * is interpolated. */
#define BK_SKEW_ONE 65535u

/* Rays with coordinates of this size or more are not traced, and none is longer. */
#define BK_FAR 1.0e9f

/* A triangle of the low-poly mesh, ready to be sampled. A sample at map position (x, y), in texels
 * from the map's top left, has barycentric weights w1 = b1[0] (x - x0) + b1[1] (y - y0) + b1[2], w2
 * alike, w0 = 1 - w1 - w2. */
typedef struct bk_triangle {
    float x0, y0;
    float b1[3], b2[3];
    float position[3][3];  /* index space */
    float direction[3][3]; /* of rays, outwards: unit; BK_CAGE: the way to the cage's corner */
    float reach[3];        /* without BK_CAGE: where rays start, see struct bk_start; voxels */
    float normal[3][3];    /* unit, per corner */
    float tangent[3][4];   /* MikkTSpace: unit xyz, w = sign of the bitangent */
} bk_triangle;

enum {
    BK_OBJECT_SPACE = 1, /* normals stay in object space */
    BK_NEAREST = 2,      /* no blending over neighbours */
    BK_TWO_SIDED = 4,    /* surfaces that face away count too */
    BK_HAS_COLOR = 8,
    BK_CAGE = 16,         /* rays start at a cage */
    BK_OPEN_FALLOFF = 32, /* a surface hides less, the farther away it is */
    BK_HAS_IDS = 64,
    BK_SKEW = 128 /* samples have skews */
};

/* The directions of a sample's rays: `seed` turns those of its texel, and the texel's N x N samples
 * take turns, by the number `first`. */
typedef struct bk_share {
    bk_uint seed, first;
} bk_share;

/* Job-wide parameters. */
typedef struct bk_params {
    bk_uint flags;
    bk_uint maps;        /* selected ones, see BK_MAPS */
    bk_uint samples;     /* N: N x N samples a texel */
    float unit;          /* side of a voxel in the mesh's units */
    float front, back;   /* ray lengths in voxels; BK_CAGE: `front` is that of the longest */
    bk_int index_min[3]; /* bounds of the grid's active voxels, inclusive */
    bk_int index_max[3];
    bk_uint upper_count, lower_count, leaf_count;
    bk_uint root_tile_count; /* root tiles */
    bk_uint second_base_low,
        second_base_high; /* 1 + voxel count: number of the first second record */
    /* Byte distances in the file, low word first: from the root to the upper nodes, from those to
     * the lower nodes, from those to the leaves. A child's number follows from its byte offset. */
    bk_uint upper_offset[2], lower_offset[2], leaf_offset[2];
    bk_uint second_count; /* second records */
    /* Secondary rays, see bk_secondary.h. */
    bk_uint open_rays, thickness_rays; /* a sample */
    float open_limit, thickness_limit; /* lengths in voxels */
    float coarse;     /* in voxels: from here on, an occupied voxel ends a secondary ray */
    float open_sine2; /* squared sine of half of the cone's angle */
    /* Words from the array of colours to those of ids and of further channels, low word first. */
    bk_uint id_offset[2], channel_offset[2];
    bk_uint channel_words; /* of further channels, a record */
} bk_params;

/* One patch of the map. sample_triangles holds height * N rows of width * N entries, row 0 at the
 * top: the triangle that the sample lies in, or BK_NO_TRIANGLE. With BK_SKEW, as many entries
 * follow: the skew of each sample, 0 to BK_SKEW_ONE. Sample (i, j) of a patch lies at map position
 * (x + (i + 0.5) / N, y + (j + 0.5) / N). */
typedef struct bk_patch {
    bk_uint x, y, width, height; /* texels */
} bk_patch;

/* What a launch does with samples. */
enum {
    BK_ADD,      /* traces them and adds them to their texels */
    BK_POINTS,   /* traces them and stores their viewpoints */
    BK_ADD_FOUND /* traces them again, and adds them with what the rays from the viewpoints found */
};

/* Samples of a patch that launches trace together: lines first_line to end_line - 1 of the samples
 * of each texel in these rows and columns. Stored viewpoints are in the order of rows, columns,
 * lines and samples. */
typedef struct bk_batch {
    bk_uint first_row, end_row, first_column, end_column, first_line, end_line;
} bk_batch;

/* Single rays of a launch, from t_min to t_max in voxels along their directions. */
typedef struct bk_single_rays {
    float t_min, t_max;
    bk_uint count;
    bk_uint columns; /* of work items */
} bk_single_rays;

/* A single ray: origin and direction. What it hits: t, BK_NOTHING if nothing, and the normal. */
enum { BK_RAY_FLOATS = 6, BK_HIT_FLOATS = 4 };
#define BK_NOTHING (2.0f * BK_FAR)

#endif
