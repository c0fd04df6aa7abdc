/* polygon_fans.h - splits polygons whose vertices were in a file when they were partitioned.
 *
 * Such a polygon is in each bucket that has one of its corners, as a fan of triangles around its
 * first corner. When a batch has gathered the positions, the fan becomes the polygon's triangles,
 * and the bucket keeps those that are its own. */
#ifndef VOX_PARTITION_POLYGON_FANS_H
#define VOX_PARTITION_POLYGON_FANS_H

#include "libvoxel/partition/partition.h"
#include "libvoxel/chunk/gather_window.h"

/* The polygon in hand; each thread has its own. */
struct fan_buffer {
    uint8_t *corners;
    double (*positions)[3];
    uint32_t *triangles, *scratch;
};

uint64_t vox_fan_buffer_bytes(const struct record_layout *layout);
/* Free with vox_fan_buffer_free(), also after failure. */
int vox_fan_buffer_init(struct fan_buffer *room, struct bsq_ctx *ctx,
                        const struct record_layout *layout);
void vox_fan_buffer_free(struct fan_buffer *room, struct bsq_ctx *ctx);

/* Turns the fans among the records of whole runs of this bucket into triangles, and leaves out
 * those that belong to other buckets. Returns how many records there are then. Indices are the
 * scan's, and their vertices were fetched. */
uint64_t vox_fans_triangulate(const struct gather_window *window, struct fan_buffer *room,
                              const struct morton_cube *cube, uint32_t levels, uint32_t bucket,
                              uint8_t *records, uint64_t count);

#endif
