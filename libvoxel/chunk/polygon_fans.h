/* polygon_fans.h - triangulates polygons whose positions were in a file when they were partitioned.
 *
 * Such a polygon is a fan of triangles around its first corner, in each bucket that has one of its
 * corners. After a batch has gathered the positions, the polygon is triangulated. Each bucket keeps
 * the triangles whose first corner it has. */
#ifndef VOX_CHUNK_POLYGON_FANS_H
#define VOX_CHUNK_POLYGON_FANS_H

#include "libvoxel/partition/partition.h"
#include "libvoxel/chunk/gather_window.h"

/* Buffers for one polygon. Each thread has its own. */
struct fan_buffer {
    uint8_t *corners;
    double (*positions)[3];
    uint32_t *triangles;
    void *scratch;
};

uint64_t vox_fan_buffer_bytes(const struct record_layout *layout);
/* Allocates the buffers. Free them with vox_fan_buffer_free(), also after failure. */
int vox_fan_buffer_init(struct fan_buffer *buffer, struct bsq_ctx *ctx,
                        const struct record_layout *layout);
void vox_fan_buffer_free(struct fan_buffer *buffer, struct bsq_ctx *ctx);

/* Replaces the fans among records of this bucket by their triangles, without those of other
 * buckets, and updates *count. The records are whole runs with the scan's indices, and the window
 * has fetched their vertices. Errors: BSQ_EINTR. */
int vox_fans_triangulate(struct bsq_ctx *ctx, const struct gather_window *window,
                         struct fan_buffer *buffer, const struct morton_cube *cube, uint32_t levels,
                         uint32_t bucket, uint8_t *records, uint64_t *count);

#endif
