/* region.h - sums the fragments of one region, and turns the sums into records of the grid.
 *
 * Takes fragments (clip/). Gives the leaves of a region in the layout of fmt_nvdb_append(). A
 * region is 128^3 voxels. Only touched voxels take memory: 16^3 brick cells, 8^3 voxel cells for
 * each brick, one sum for each voxel and class of directions in it. Sums are double, so a million
 * small fragments in one voxel lose nothing. Not thread-safe: each worker has one accumulator and
 * reuses it for every region.
 *
 * The order of fragments changes sums by rounding only
 * (docs/decisions/0010-two-records-for-thin-walls.md).
 *
 * About every fourth fragment is the first in its voxel, which no processor can predict. So sums
 * are cleared ahead of need, and adding takes no branch for that. */
#ifndef VOX_VOXELIZE_RECORDS_REGION_H
#define VOX_VOXELIZE_RECORDS_REGION_H

#include "formats/grid/nvdb.h"
#include "base/simd/simd.h"

enum {
    VOX_BRICKS = 4096,      /* 16^3 bricks in a region */
    VOX_BRICK_VOXELS = 512, /* 8^3 */
    VOX_REGION_FULL = 1     /* the accumulator's memory is used up */
};

/* Area, in voxel faces, of a triangle without an area and of a fragment that only shares a point
 * with its voxel: enough for the voxel to have a record, too little to change one. */
#define VOX_NO_AREA 1e-20

/* Facet-noise weight of inconsistent fragments: any sum with it exceeds the area, even times
 * VOX_NO_AREA. */
#define VOX_INCONSISTENT 1e40

/* Sums over fragments. */
struct vox_sum {
    double normal[3]; /* of area times normal; the normal's length, at most 1, is the weight of its
                         direction */
    /* Of area times facet-noise weight: how much of what planes say belongs to single triangles, 0
     * to 1; VOX_INCONSISTENT if a fragment's normal is inconsistent with its plane. */
    double noise;
    double center[3]; /* of area times centroid, relative to the voxel's centre, in voxels */
    double area;      /* in voxel faces */
};

struct vox_color_sum {
    double rgb[3]; /* of area times colour in linear light */
    double area;   /* of the fragments that have a colour */
};

/* The id of a record, by the algorithm of Boyer & Moore ("MJRTY", 1991) with areas for votes: if
 * one id has more than half of the area of all fragments, it is this one. */
struct vox_vote {
    double area;
    uint32_t id;
};

/* Fragments are summed in classes of directions: the octants of axes that are turned by 45 degrees
 * about (1, 1, 1). So no common direction, such as those of the axes, lies between classes. The
 * rows of the rotation's matrix have these three numbers. */
#define VOX_TURN_0 0.8047378541243649
#define VOX_TURN_1 0.5058793634016805
#define VOX_TURN_2 (-0.3106172175260455)
enum { VOX_CLASSES = 8 };

/* Link to a sum: its number, and above it the class of its normals. 0: none. */
enum { VOX_LINK_CLASS = 29, VOX_LINK_NUMBER = (1 << VOX_LINK_CLASS) - 1 };

/* Link to the first sum of each voxel, 0: not touched. */
typedef uint32_t vox_brick[VOX_BRICK_VOXELS];

struct vox_accumulator {
    struct bsq_ctx *ctx;
    uint32_t brick_of[VOX_BRICKS]; /* number of each brick, 0: none */
    vox_brick *bricks;             /* number 0 is unused, here and below */
    struct vox_sum *sums;
    /* For each sum: link to the next one of its voxel, from the last one to the first; 0: there is
     * only one. After vox_accumulator_settle(), for the first one: number of the voxel's second
     * record, 0: none. */
    uint32_t *others;
    uint32_t *shared;             /* first sums of the voxels that have several */
    struct vox_color_sum *colors; /* NULL: the scan has no colours */
    struct vox_vote *votes;       /* NULL: the grid gets no ids */
    double *channels;       /* of each record channel_words sums of area times value; NULL: none */
    uint32_t channel_words; /* values of further channels */
    double *fragment_channels; /* space for the values of VOX_FRAGMENT_LANES fragments */
    uint32_t brick_count, brick_capacity;
    uint32_t sum_count, sum_capacity, shared_count;
    uint32_t second_count, spare_count; /* second records, sums that others have taken in */
    uint32_t ready_count;               /* records that have been cleared, used or not */
};

/* Returns the number of a voxel with coordinates from 0 to 127 in the region: its brick, then its
 * place in the brick. */
static inline uint32_t vox_voxel_number(uint32_t x, uint32_t y, uint32_t z)
{
    return (x >> 3) << 17 | (y >> 3) << 13 | (z >> 3) << 9 | (x & 7) << 6 | (y & 7) << 3 | (z & 7);
}

struct vox_records {
    uint64_t count, capacity, channel_capacity;
    struct fmt_nvdb_record *records;
    float *channels; /* values of further channels, channel_words for each record */
};

/* Finished voxels in the layout of fmt_nvdb_append(). */
struct vox_leaves {
    struct bsq_ctx *ctx;
    uint32_t leaf_count, channel_words;
    uint64_t clamped_colors; /* records whose colour was outside of 0 to 1 in linear light */
    uint16_t *ids;
    uint64_t (*masks)[8];
    uint64_t id_capacity, mask_capacity;
    struct vox_records sides[2]; /* the first records of voxels, and the second ones */
};

enum { VOX_COLOR_STEPS = 4096 };

/* Tables that convert between 8-bit sRGB and linear light (IEC 61966-2-1), and replace pow() by a
 * search: a coarse table gives a code that is not too high, and the exact boundaries do the rest.
 */
struct vox_color_tables {
    double to_linear[256];
    double boundary[255]; /* linear value of the sRGB value halfway between codes i and i + 1 */
    uint8_t start[VOX_COLOR_STEPS + 1]; /* code of the linear value i / VOX_COLOR_STEPS */
};

void vox_color_tables_init(struct vox_color_tables *tables);

/* Optional sums of an accumulator: flags, plus VOX_SUM_CHANNEL_VALUE for each value of further
 * channels. */
enum { VOX_SUM_COLORS = 1, VOX_SUM_IDS = 2, VOX_SUM_CHANNEL_VALUE = 4 };

/* Most fragments whose channel values are buffered. */
enum { VOX_FRAGMENT_LANES = 8 };

/* Returns the fewest bytes an accumulator with these sums works with: the voxels of one brick. */
uint64_t vox_accumulator_bytes_min(unsigned sums);
/* Creates an empty accumulator of about `bytes`. */
int vox_accumulator_create(struct bsq_ctx *ctx, uint64_t bytes, unsigned sums,
                           struct vox_accumulator **out);
void vox_accumulator_destroy(struct vox_accumulator *a); /* NULL is allowed */

/* Empties the accumulator. */
void vox_accumulator_clear(struct vox_accumulator *a);

/* Makes one or two records of the sums of each voxel. Called once, after all fragments are added.
 */
void vox_accumulator_settle(struct vox_accumulator *a);

/* Returns the bytes that `leaves` takes after the voxels are appended. */
uint64_t vox_accumulator_result_bytes(const struct vox_accumulator *a,
                                      const struct vox_leaves *leaves);
/* Appends the settled voxels to `leaves`, whose ids must all be below those of this accumulator.
 * Fails only if memory runs out. */
int vox_accumulator_finish(const struct vox_accumulator *a, const struct vox_color_tables *tables,
                           struct vox_leaves *leaves);

void vox_leaves_init(struct vox_leaves *leaves, struct bsq_ctx *ctx);
void vox_leaves_clear(struct vox_leaves *leaves);
/* Frees the memory and leaves them empty. */
void vox_leaves_free(struct vox_leaves *leaves);

/* ---- adding, inline because it runs once for every fragment ---- */

/* Most fragments to add after one call of vox_accumulator_reserve(). */
enum { VOX_FRAGMENTS_AT_ONCE = 64 };

/* Clears the next records. Returns false if there are fewer than VOX_FRAGMENTS_AT_ONCE left. */
bool vox_accumulator_clear_next(struct vox_accumulator *a);
/* Sets *brick to a new brick. Returns false if all are used. */
bool vox_accumulator_open_brick(struct vox_accumulator *a, uint32_t *brick);

/* Makes records ready for up to VOX_FRAGMENTS_AT_ONCE fragments. Returns 0 or VOX_REGION_FULL. */
static inline int vox_accumulator_reserve(struct vox_accumulator *a)
{
    bool enough = a->ready_count - a->sum_count >= VOX_FRAGMENTS_AT_ONCE;
    return enough || vox_accumulator_clear_next(a) ? 0 : VOX_REGION_FULL;
}

/* A fragment in the form of the sums: the members of struct vox_sum and struct vox_color_sum. */
struct vox_fragment_sum {
    struct row normal, center, color;
    uint32_t id;
    const double *channels; /* values; not read without has_channels */
};

/* Returns the number of the voxel's sum for this class. first_link: link to its first sum, which
 * has another class. */
uint32_t vox_accumulator_find(struct vox_accumulator *a, uint32_t first_link, uint32_t class_bits);

static inline double vox_dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* Returns the class of a normal, above VOX_LINK_CLASS. */
LANES_INLINE uint32_t vox_class_bits(struct row normal)
{
    struct row next = row_rotate(normal);
    struct row turned = row_sum(row_sum(row_times(VOX_TURN_0, normal), row_times(VOX_TURN_1, next)),
                                row_times(VOX_TURN_2, row_rotate(next)));
    return row_signs(turned) << VOX_LINK_CLASS;
}

/* Adds an area's vote. */
static inline void vox_vote(struct vox_vote *vote, uint32_t id, double area)
{
    if (vote->id == id || vote->area == 0.0) {
        vote->id = id;
        vote->area += area;
    } else if (area > vote->area) {
        vote->id = id;
        vote->area = area - vote->area;
    } else {
        vote->area -= area;
    }
}

static inline void vox_add_channels(struct vox_accumulator *a, uint32_t number,
                                    const double *values, double area)
{
    double *sums = a->channels + (uint64_t)number * a->channel_words;
    for (uint32_t i = 0; i < a->channel_words; i++)
        sums[i] += area * values[i];
}

/* Sets *number to the sum that takes a fragment. class_and_voxel: its voxel, and the class of its
 * direction above VOX_LINK_CLASS. Returns false if there is no brick left. Called before the
 * fragment is shaded, so that its rows need not be kept across the call that few fragments make. */
LANES_INLINE bool vox_accumulator_sum(struct vox_accumulator *a, uint32_t class_and_voxel,
                                      uint32_t *number)
{
    const uint32_t voxel = class_and_voxel & VOX_LINK_NUMBER;
    uint32_t *brick = &a->brick_of[voxel / VOX_BRICK_VOXELS];
    if (*brick == 0 && !vox_accumulator_open_brick(a, brick))
        return false;
    uint32_t *cell = &a->bricks[*brick][voxel % VOX_BRICK_VOXELS], link = *cell;
    const uint32_t next = a->sum_count + 1,
                   class_bits = class_and_voxel & ~(uint32_t)VOX_LINK_NUMBER;
    const uint32_t fresh = (uint32_t)(((uint64_t)link - 1) >> 32); /* no branch: all ones or 0 */
    link |= (next | class_bits) & fresh;
    *cell = link;
    a->sum_count -= fresh;
    *number = link & VOX_LINK_NUMBER;
    if (__builtin_expect((link ^ class_and_voxel) > VOX_LINK_NUMBER, 0)) {
        const uint32_t other = a->others[*number];
        *number = other != 0 && (other ^ class_and_voxel) <= VOX_LINK_NUMBER
                      ? other & VOX_LINK_NUMBER
                      : vox_accumulator_find(a, link, class_bits);
    }
    return true;
}

/* Adds one fragment, of an area above 0, to a sum. has_color, has_ids, has_channels: whether the
 * accumulator has colours, ids and further channels. */
LANES_INLINE void vox_accumulator_add(struct vox_accumulator *a, uint32_t number,
                                      const struct vox_fragment_sum *fragment, bool has_color,
                                      bool has_ids, bool has_channels)
{
    struct vox_sum *sum = &a->sums[number];
    row_add(sum->normal, fragment->normal);
    row_add(sum->center, fragment->center);
    if (has_color)
        row_add(a->colors[number].rgb, fragment->color);
    if (has_ids)
        vox_vote(&a->votes[number], fragment->id, row_number(fragment->center, 3));
    if (has_channels)
        vox_add_channels(a, number, fragment->channels, row_number(fragment->center, 3));
}

/* Makes `count` records from the sums with these numbers, without colours, ids and
 * FMT_NVDB_PLANE_SECOND. */
typedef void vox_make_records_fn(const struct vox_sum *sums, const uint32_t *numbers,
                                 uint64_t count, struct fmt_nvdb_record *records);
BSQ_SIMD_DECLARE(vox_make_records_fn, vox_make_records);

#endif
