/* region.h - collects the triangle pieces of one region, and turns them into the grid's records.
 *
 * A region is 128^3 voxels. Only voxels that were touched take memory: 16^3 brick slots, per brick
 * 8^3 voxel slots, per voxel one record or two. Sums are double, so that a million small pieces in
 * one voxel lose nothing. Not thread-safe: one accumulator a worker, reused for every region.
 *
 * Every fourth piece or so is the first in its voxel, which no processor can foresee. So records
 * are made ready ahead of need, and adding takes no branch for that. */
#ifndef VOX_VOXELIZE_RECORDS_REGION_H
#define VOX_VOXELIZE_RECORDS_REGION_H

#include "formats/grid/nvdb.h"
#include "base/simd/simd.h"
#include "libvoxel/voxelize/records/voxel_color.h"

enum {
    VOX_BRICKS = 4096,      /* 16^3 bricks in a region */
    VOX_BRICK_VOXELS = 512, /* 8^3 */
    VOX_REGION_FULL = 1     /* the accumulator's memory is used up */
};

/* Weight, as an area in voxel faces, of a triangle that has none, or of a piece of one where they
 * share a point alone: enough for a voxel to have a record, too little to change one. */
#define VOX_NO_AREA 1e-20

/* Makes any sum of grain larger than that of area, even times VOX_NO_AREA. */
#define VOX_SHADED 1e40

/* Sums over pieces. */
struct vox_sum {
    double normal[3]; /* of area times normal, whose length, at most 1, is the weight of its
                         direction */
    /* Of area times grain, how much of what planes say is of single triangles: 0 to 1, or
     * VOX_SHADED for a piece whose normal does not go with the plane the centres lie in. */
    double grain;
    double center[3]; /* of area times centroid, from the voxel's centre, in voxels */
    double area;      /* in voxel faces */
};

struct vox_color_sum {
    double rgb[3]; /* of area times colour in linear light */
    double area;   /* of the pieces that have a colour */
};

/* First record of each voxel, 0: not touched. */
typedef uint32_t vox_brick[VOX_BRICK_VOXELS];

struct vox_accumulator {
    struct bsq_ctx *ctx;
    uint32_t brick_of[VOX_BRICKS]; /* 0: none */
    vox_brick *bricks;             /* number 0 is not used, here and below */
    struct vox_sum *sums;
    uint32_t *others; /* of each record: the voxel's second one, 0 where there is none */
    struct vox_color_sum *colors; /* NULL where the scan has none */
    uint32_t brick_count, brick_capacity;
    uint32_t sum_count, sum_capacity;
    uint32_t ready_count; /* records that are zero, or not any more */
};

/* Number of a voxel in the region, of coordinates from 0 to 127: its brick, then its place there.
 */
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

/* Most pieces that are added after one call of vox_accumulator_make_room(). */
enum { VOX_PIECES_AT_ONCE = 64 };

/* Records for VOX_PIECES_AT_ONCE more pieces; false where there is no memory for them. */
bool vox_accumulator_make_ready(struct vox_accumulator *a);
/* Sets *brick to a new brick; false where there is no room. */
bool vox_accumulator_open_brick(struct vox_accumulator *a, uint32_t *brick);

/* Before every VOX_PIECES_AT_ONCE pieces or fewer. Returns 0 or VOX_REGION_FULL. */
static inline int vox_accumulator_make_room(struct vox_accumulator *a)
{
    bool room = a->ready_count - a->sum_count >= VOX_PIECES_AT_ONCE;
    return room || vox_accumulator_make_ready(a) ? 0 : VOX_REGION_FULL;
}

/* A piece in the form of the sums: the members of struct vox_sum and of struct vox_color_sum. */
struct vox_piece_sum {
    struct row normal, center, color;
};

/* The record that a piece belongs to which faces away from the voxel's first one. */
uint32_t vox_accumulator_choose(struct vox_accumulator *a, uint32_t first,
                                const struct vox_sum *piece);

static inline double vox_dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* Whether the cosine between a piece's normal and a record's is below -1/4: the two sides of a wall
 * and of a blade are, those of a box's edge are not. */
LANES_INLINE bool vox_faces_away(struct row normal, double area, const struct vox_sum *sum)
{
    struct row products = row_product(normal, row_load(sum->normal));
    double d = row_number(products, 0) + row_number(products, 1) + row_number(products, 2);
    return __builtin_expect(d < 0.0, 0) &&
           d * d > 0.25 * 0.25 * vox_dot(sum->normal, sum->normal) * area * area;
}

/* Adds one piece, of an area above 0, to a voxel. has_color: whether the accumulator has colours.
 * The order of calls decides which record a piece goes to. Returns 0 or VOX_REGION_FULL, with
 * nothing added. */
LANES_INLINE int vox_accumulator_add(struct vox_accumulator *a, uint32_t voxel,
                                     const struct vox_piece_sum *piece, bool has_color)
{
    uint32_t *brick = &a->brick_of[voxel / VOX_BRICK_VOXELS];
    if (*brick == 0 && !vox_accumulator_open_brick(a, brick))
        return VOX_REGION_FULL;
    uint32_t *slot = &a->bricks[*brick][voxel % VOX_BRICK_VOXELS], number = *slot;
    uint32_t fresh = number == 0, next = a->sum_count + 1;
    number = fresh ? next : number;
    *slot = number;
    a->sum_count += fresh;
    if (vox_faces_away(piece->normal, row_number(piece->center, 3), &a->sums[number])) {
        struct vox_sum in_memory; /* while `piece` itself is in registers */
        row_store(piece->normal, in_memory.normal);
        row_store(piece->center, in_memory.center);
        number = vox_accumulator_choose(a, number, &in_memory);
    }

    struct vox_sum *sum = &a->sums[number];
    row_add(sum->normal, piece->normal);
    row_add(sum->center, piece->center);
    if (has_color)
        row_add(a->colors[number].rgb, piece->color);
    return 0;
}

/* Makes `count` records from the sums with these numbers, without colours and without
 * FMT_NVDB_PLANE_SECOND. */
typedef void vox_make_records_fn(const struct vox_sum *sums, const uint32_t *numbers,
                                 uint64_t count, struct fmt_nvdb_record *records);
BSQ_SIMD_DECLARE(vox_make_records_fn, vox_make_records);

#endif
