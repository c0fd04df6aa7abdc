/* chunk_content.h - private to the cache: makes a chunk ready to voxelize, in the memory of a slot.
 *
 * This takes two steps, because the normals of one chunk need other chunks as they are in the file.
 */
#ifndef VOX_VOXELIZE_CACHE_CHUNK_CONTENT_H
#define VOX_VOXELIZE_CACHE_CHUNK_CONTENT_H

#include "libvoxel/voxelize/cache/chunk_cache.h"

/* What chunks are made from. */
struct vox_chunk_source {
    const struct fmt_tris_file *file;
    const struct vox_transform *transform;
    struct vox_smooth *smooth; /* NULL: chunks without normals stay without */
};

/* Offsets in bytes in a slot's memory. The chunk as it is in the file comes first. */
struct vox_chunk_layout {
    uint64_t points_at, normals_at, groups_at, vertex_groups_at, inconsistent_at, bytes;
};

/* The mean square of the triangles' first edges, in voxels, and the largest extent of a triangle
 * along an axis, in the scan's units. */
struct vox_triangle_sizes {
    double mean_square;
    float extent;
};

struct vox_chunk_content {
    uint8_t *memory; /* vox_chunks_slot_bytes() */
    struct vox_chunk_layout layout;
    struct vox_chunk chunk;
    struct vox_triangle_sizes sizes;
    const struct vox_box *vertex_groups; /* for chunks that need this one's triangles */
};

/* The first step: loads chunk `number` as it is in the file, and finds the voxels of its groups. */
int vox_chunk_read(const struct vox_chunk_source *from, uint32_t number,
                   struct vox_chunk_content *content);
/* The second step: places vertices in index space, and makes normals and what depends on them. */
int vox_chunk_finish(const struct vox_chunk_source *from, const struct vox_smooth_lender *lender,
                     uint32_t number, struct vox_chunk_content *content);

/* Compute the voxels of each group's bounds; of triangles, return the sizes too. */
struct vox_triangle_sizes vox_triangle_groups(const struct fmt_tris_chunk *chunk,
                                              const struct vox_transform *transform,
                                              struct vox_box *groups);
void vox_vertex_groups(const struct fmt_tris_chunk *chunk, const struct vox_transform *transform,
                       struct vox_box *groups);

/* Triangles, and by vertex number: points in voxels and unit normals. */
struct vox_own_normals {
    const uint32_t (*triangles)[3];
    const double (*points)[4];
    const float (*normals)[4];
};

/* Returns whether the normals of the triangles from begin to end contradict the triangles' planes
 * too much. Blending with the planes would then do more harm than good. */
bool vox_own_normals_inconsistent(const struct vox_own_normals *of, uint32_t begin, uint32_t end);

#endif
