/* schedule.h - which regions of the grid a scan touches, in the grid file's order, and which chunks
 * touch each.
 *
 * A region is 128^3 voxels, a lower node of the grid. Memory is a few bytes a part of a chunk,
 * whatever the size of the grid. Not thread-safe. */
#ifndef VOX_VOXELIZE_PLAN_SCHEDULE_H
#define VOX_VOXELIZE_PLAN_SCHEDULE_H

#include "libvoxel/voxelize/plan/chunk_boxes.h"

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
