/* plan.h - which voxels a scan touches, and in which order they are made.
 *
 * Takes the header and the chunks of a .tris file. Gives the voxel transform, the boxes of voxels
 * that each chunk touches, and the schedule: the regions of the grid in the order of the grid file,
 * each with the chunks that touch it. */
#ifndef VOX_VOXELIZE_PLAN_PLAN_H
#define VOX_VOXELIZE_PLAN_PLAN_H

#include "formats/chunks/tris.h"

/* ---- the voxel transform ----
 *
 * Voxel (i, j, k) covers [start + i h, start + (i + 1) h) on each axis, half-open, in double. So
 * every point belongs to exactly one voxel, i = floor(((origin + p) - start) / h) as computed in
 * double. A plane on the border of two layers fills only the upper layer.
 *
 * With a resolution the transform starts at the lower bounds of the scan. Voxels are clamped to the
 * scan's extent: a point exactly on the upper bounds belongs to the last voxel. With a given voxel
 * size the transform is aligned to multiples of the size and nothing is clamped: a triangle on an
 * uppermost plane that is a multiple of the size belongs to the voxel above. */

/* Voxels lo to hi, inclusive. */
struct vox_box {
    int32_t lo[3], hi[3];
};

/* Whether any voxel is in both. */
static inline bool vox_boxes_meet(const struct vox_box *a, const struct vox_box *b)
{
    bool apart = false;
    for (int k = 0; k < 3; k++)
        apart |= (a->lo[k] > b->hi[k]) | (a->hi[k] < b->lo[k]);
    return !apart;
}

struct vox_lattice {
    double origin[3];      /* world position of the file's float positions */
    double start[3];       /* world position of the lower corner of voxel (0, 0, 0) */
    double h;              /* edge of a voxel in world units */
    struct vox_box voxels; /* all that the scan may touch */
};

/* Lattice of a scan for a resolution (voxels along the longest side) or, where that is 0, a voxel
 * size. Errors: BSQ_EUSAGE with the values where the size is no positive number or an index would
 * leave +-2^30; BSQ_EDATA where the scan has no extent to divide, or one too small or large for
 * voxels whose size and its inverse are float32. */
int vox_lattice_init(struct bsq_ctx *ctx, const struct fmt_tris_header *header, const char *path,
                     uint32_t resolution, double voxel_size, struct vox_lattice *out);

/* Lattice coordinate of a file position on one axis; its floor, clamped to voxels, is the voxel. */
static inline double vox_lattice_coordinate(const struct vox_lattice *lattice, float p, int axis)
{
    return ((lattice->origin[axis] + (double)p) - lattice->start[axis]) / lattice->h;
}

/* Voxels that the positions between two corners may touch. */
struct vox_box vox_lattice_box(const struct vox_lattice *lattice, const float min[3],
                               const float max[3]);

/* ---- chunk boxes ---- */

/* A run of a chunk's triangles. */
struct vox_part {
    struct vox_box box;
    uint32_t chunk;
};

/* *parts: of all chunks, whose bounds are in boxes, in ascending order; to be freed with
 * bsq_free(). Chunks that reach across many regions are read and cut into runs that do not, or that
 * are one triangle, while all takes no more than `bytes`. */
int vox_parts_create(struct bsq_ctx *ctx, const struct fmt_tris_file *file,
                     const struct vox_lattice *lattice, const struct vox_box *boxes, uint64_t bytes,
                     struct vox_part **parts, uint64_t *count);

/* ---- the schedule ----
 *
 * Not thread-safe. Its memory is one entry for each chunk box, whatever the size of the grid. */

enum { VOX_REGION_LOG2 = 7, VOX_REGION_SIZE = 1 << VOX_REGION_LOG2 };

/* A region's place in the order of fmt_nvdb_append(): by 4096^3 tile, then inside the tile. */
struct vox_region_key {
    uint64_t tile;
    uint32_t region;
};
#define VOX_REGION_KEY_NEVER ((struct vox_region_key){UINT64_MAX, UINT32_MAX})

static inline bool vox_region_before(struct vox_region_key a, struct vox_region_key b)
{
    return a.tile != b.tile ? a.tile < b.tile : a.region < b.region;
}

/* Index of the region's first voxel. */
void vox_region_origin(struct vox_region_key key, int32_t origin[3]);

/* The first region that a box of voxels touches. */
struct vox_region_key vox_region_first(const struct vox_box *box);

struct vox_schedule;

/* parts: in ascending order of chunks; stays the caller's and must outlive the schedule. */
int vox_schedule_create(struct bsq_ctx *ctx, const struct vox_part *parts, uint64_t part_count,
                        struct vox_schedule **out);
void vox_schedule_destroy(struct vox_schedule *schedule); /* NULL is allowed */

/* Bytes that a part takes in a schedule. */
uint64_t vox_schedule_entry_bytes(void);

/* The next region, false at the end. */
bool vox_schedule_next(struct vox_schedule *schedule, struct vox_region_key *key);
/* The next chunk of that region, in ascending order, false after the last one. after: the region
 * that those of its parts which touch this one touch next, VOX_REGION_KEY_NEVER where there is
 * none. */
bool vox_schedule_chunk(struct vox_schedule *schedule, uint32_t *chunk,
                        struct vox_region_key *after);

#endif
