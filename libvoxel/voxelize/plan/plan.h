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

/* A box of voxels from lo to hi, inclusive. */
struct vox_box {
    int32_t lo[3], hi[3];
};

/* Returns whether the boxes share a voxel. */
static inline bool vox_boxes_meet(const struct vox_box *a, const struct vox_box *b)
{
    bool apart = false;
    for (int k = 0; k < 3; k++)
        apart |= (a->lo[k] > b->hi[k]) | (a->hi[k] < b->lo[k]);
    return !apart;
}

struct vox_transform {
    double origin[3];      /* world position of the file's float positions */
    double start[3];       /* world position of the lower corner of voxel (0, 0, 0) */
    double h;              /* edge of a voxel in world units */
    struct vox_box voxels; /* every voxel that the scan may touch */
};

/* Places the voxels over a scan: by resolution (voxels along the longest side), or by voxel size if
 * the resolution is 0. Errors: BSQ_EUSAGE with the values if the size is not a positive number or
 * an index would leave +-2^30; BSQ_EDATA if the scan has no extent to divide, or needs voxels whose
 * size or its inverse is not a normal float32. */
int vox_transform_init(struct bsq_ctx *ctx, const struct fmt_tris_header *header, const char *path,
                       uint32_t resolution, double voxel_size, struct vox_transform *out);

/* Returns the index-space coordinate of a file position on one axis. Its floor, clamped to the
 * voxels of the transform, is the voxel. */
static inline double vox_transform_coordinate(const struct vox_transform *transform, float p,
                                              int axis)
{
    return ((transform->origin[axis] + (double)p) - transform->start[axis]) / transform->h;
}

/* Returns the voxels that positions between two corners may touch. */
struct vox_box vox_transform_box(const struct vox_transform *transform, const float min[3],
                                 const float max[3]);

/* ---- chunk boxes ----
 *
 * The bounds of a chunk can reach across much empty space: around an outlier, or in a scan of few
 * triangles. Visiting every region inside such bounds would take too long. Chunk boxes hold the
 * triangles of a chunk more closely. */

/* Bounds of consecutive triangles of a chunk, in voxels. */
struct vox_chunk_box {
    struct vox_box box;
    uint32_t chunk;
};

/* Creates the boxes of chunks in ascending order of chunks; free them with bsq_free(). Chunks that
 * reach across many regions are read and cut into boxes that do not, or that hold one triangle. The
 * boxes and their schedule take at most `bytes`, unless one box a chunk needs more. */
int vox_chunk_boxes_create(struct bsq_ctx *ctx, const struct fmt_tris_file *file,
                           const struct vox_transform *transform, uint64_t bytes,
                           struct vox_chunk_box **boxes, uint64_t *count);

/* ---- the schedule ----
 *
 * Not thread-safe. Its memory is one entry for each chunk box, whatever the size of the grid. */

enum { VOX_REGION_LOG2 = 7, VOX_REGION_SIZE = 1 << VOX_REGION_LOG2 };

/* A region's place in the order of fmt_nvdb_append(): by tile of 4096^3 voxels, then inside the
 * tile. */
typedef unsigned __int128 vox_region_key;
#define VOX_REGION_KEY_NEVER (~(vox_region_key)0)

/* Sets the index of the region's first voxel. */
void vox_region_origin(vox_region_key key, int32_t origin[3]);

/* Returns the number of regions that a box of voxels touches; it may be inexact above 2^53. */
double vox_region_count(const struct vox_box *box);

/* Returns the first region that a box of voxels touches. */
vox_region_key vox_region_first(const struct vox_box *box);

struct vox_schedule;

/* Creates a schedule. boxes: in ascending order of chunks. The caller keeps them until the schedule
 * is destroyed. */
int vox_schedule_create(struct bsq_ctx *ctx, const struct vox_chunk_box *boxes, uint64_t box_count,
                        struct vox_schedule **out);
void vox_schedule_destroy(struct vox_schedule *schedule); /* NULL is allowed */

/* Returns the bytes that a schedule takes for each chunk box. */
uint64_t vox_schedule_entry_bytes(void);

/* Starts the next region. Returns false at the end. */
bool vox_schedule_next(struct vox_schedule *schedule, vox_region_key *key);
/* Gives the next chunk of that region, in ascending order. Returns false after the last one. after:
 * the next region that the chunk's boxes touch, VOX_REGION_KEY_NEVER if there is none. */
bool vox_schedule_chunk(struct vox_schedule *schedule, uint32_t *chunk, vox_region_key *after);

#endif
