/* region.h - collects the triangle pieces of one region, and turns them into the grid's records.
 *
 * A region is 128^3 voxels. Only voxels that were touched take memory: 16^3 brick slots, per brick
 * 8^3 voxel slots, per voxel one record or two. Sums are double, so that a million small pieces in
 * one voxel lose nothing. Not thread-safe: one accumulator a worker, reused for every region. */
#ifndef VOX_REGION_H
#define VOX_REGION_H

#include "formats/nvdb.h"
#include "libvoxel/voxel_color.h"

enum {
    VOX_BRICKS = 4096,      /* 16^3 bricks in a region */
    VOX_BRICK_VOXELS = 512, /* 8^3 */
    VOX_REGION_FULL = 1     /* the accumulator's memory is used up */
};

/* Weight, as an area in voxel faces, of a piece that has none: enough for a voxel to have a record,
 * too little to change one. */
#define VOX_NO_AREA 1e-20

/* Sums over pieces; a piece alone has the same form. */
struct vox_sum {
    double normal[3]; /* of area times normal, whose length, at most 1, is the weight of its direction */
    double area;      /* in voxel faces */
    double center[3]; /* of area times centroid, from the voxel's centre, in voxels */
    double shaded;    /* area of pieces whose normal does not go with the plane the centres lie in */
};

struct vox_color_sum {
    double rgb[3]; /* of area times colour in linear light */
    double area;   /* of the pieces that have a colour */
};

struct vox_brick {
    uint64_t mask[8];               /* bits of the voxels that were touched */
    uint32_t sum[VOX_BRICK_VOXELS]; /* first record of each voxel, 0: not touched */
};

struct vox_accumulator {
    struct bsq_ctx *ctx;
    uint32_t brick_of[VOX_BRICKS]; /* 0: none */
    struct vox_brick *bricks;      /* number 0 is not used, here and below */
    struct vox_sum *sums;
    uint32_t *others; /* of each record: the voxel's second one, 0 where there is none */
    struct vox_color_sum *colors; /* NULL where the scan has none */
    uint32_t brick_count, brick_capacity;
    uint32_t sum_count, sum_capacity;
};

/* Number of a voxel in the region, of coordinates from 0 to 127: its brick, then its place there. */
static inline uint32_t vox_voxel_number(uint32_t x, uint32_t y, uint32_t z)
{
    return (x >> 3) << 17 | (y >> 3) << 13 | (z >> 3) << 9 | (x & 7) << 6 | (y & 7) << 3 | (z & 7);
}

/* Finished voxels in the layout of fmt_nvdb_append(). */
struct vox_leaves {
    struct bsq_ctx *ctx;
    uint32_t leaf_count;
    uint64_t record_count, second_count;
    uint16_t *ids;
    uint64_t (*masks)[8];
    struct fmt_nvdb_record *records, *second;
    uint64_t id_capacity, mask_capacity, record_capacity, second_capacity;
    uint32_t voxel_min[3], voxel_max[3]; /* in the region; min > max where there are none */
};

/* Fewest bytes an accumulator works with: the voxels of one brick. */
uint64_t vox_accumulator_bytes_min(bool has_color);
/* Most bytes it can make use of. */
uint64_t vox_accumulator_bytes_max(bool has_color);
/* An empty accumulator of about `bytes`. */
int vox_accumulator_create(struct bsq_ctx *ctx, uint64_t bytes, bool has_color,
                           struct vox_accumulator **out);
void vox_accumulator_destroy(struct vox_accumulator *a); /* NULL is allowed */

/* Forgets all voxels. */
void vox_accumulator_clear(struct vox_accumulator *a);

/* Adds one piece, of an area above 0, to a voxel; defined below. `color` is not looked at where the
 * accumulator has none. The order of calls decides which record a piece goes to. Returns 0 or
 * VOX_REGION_FULL, with nothing added. */
static inline int vox_accumulator_add(struct vox_accumulator *a, uint32_t voxel,
                                      const struct vox_sum *piece,
                                      const struct vox_color_sum *color);

/* Bytes that `leaves` takes with the voxels appended. */
uint64_t vox_accumulator_result_bytes(const struct vox_accumulator *a,
                                      const struct vox_leaves *leaves);
/* Appends the voxels to `leaves`, whose ids must all be below those of this accumulator. */
int vox_accumulator_finish(const struct vox_accumulator *a, const struct vox_color_tables *tables,
                           struct vox_leaves *leaves);

void vox_leaves_init(struct vox_leaves *leaves, struct bsq_ctx *ctx);
void vox_leaves_clear(struct vox_leaves *leaves);
/* Gives the memory back, and leaves them empty. */
void vox_leaves_free(struct vox_leaves *leaves);

/* ---- adding, inline because it runs once for every piece of every triangle ---- */

/* Number of a new record, 0 where there is no room. */
uint32_t vox_accumulator_open(struct vox_accumulator *a);
/* Sets *brick to a new brick; false where there is no room. */
bool vox_accumulator_open_brick(struct vox_accumulator *a, uint32_t *brick);
/* Brings the sums of a voxel nearer that a piece will be added to. */
static inline void vox_accumulator_expect(const struct vox_accumulator *a, uint32_t voxel)
{
    const struct vox_brick *brick = &a->bricks[a->brick_of[voxel / VOX_BRICK_VOXELS]];
    __builtin_prefetch(&a->sums[brick->sum[voxel % VOX_BRICK_VOXELS]], 1);
}

/* The record that a piece belongs to which faces away from the voxel's first one; 0 where a new one
 * is needed and there is no room. */
uint32_t vox_accumulator_choose(struct vox_accumulator *a, uint32_t first,
                                const struct vox_sum *piece);

static inline double vox_dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* The members of the structures above come in fours. */
typedef double vox_four __attribute__((vector_size(32), aligned(8), may_alias));
static inline void vox_add_four(double *to, const double *from)
{
    *(vox_four *)to += *(const vox_four *)from;
}

/* Whether the cosine between a piece's normal and a record's is below -1/4: the two sides of a wall
 * and of a blade are, those of a box's edge are not. */
static inline bool vox_faces_away(const struct vox_sum *piece, const struct vox_sum *sum)
{
    double d = vox_dot(piece->normal, sum->normal);
    return d < 0.0 && d * d > 0.25 * 0.25 * vox_dot(sum->normal, sum->normal) * piece->area *
                                  piece->area;
}

static inline int vox_accumulator_add(struct vox_accumulator *a, uint32_t voxel,
                                      const struct vox_sum *piece,
                                      const struct vox_color_sum *color)
{
    uint32_t *brick = &a->brick_of[voxel / VOX_BRICK_VOXELS];
    if (*brick == 0 && !vox_accumulator_open_brick(a, brick))
        return VOX_REGION_FULL;
    uint32_t *slot = &a->bricks[*brick].sum[voxel % VOX_BRICK_VOXELS];
    uint32_t number = *slot;
    if (number == 0) {
        number = *slot = vox_accumulator_open(a);
        a->bricks[*brick].mask[voxel >> 6 & 7] |= (uint64_t)(number != 0) << (voxel & 63);
    } else if (vox_faces_away(piece, &a->sums[number])) {
        number = vox_accumulator_choose(a, number, piece);
    }
    if (number == 0)
        return VOX_REGION_FULL;

    vox_add_four(a->sums[number].normal, piece->normal);
    vox_add_four(a->sums[number].center, piece->center);
    if (a->colors)
        vox_add_four(a->colors[number].rgb, color->rgb);
    return 0;
}

#endif
