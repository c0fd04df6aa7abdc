/* chunk_content.h - private to the cache: makes a chunk ready to voxelize, in the memory of a slot.
 */
#ifndef VOX_VOXELIZE_CACHE_CHUNK_CONTENT_H
#define VOX_VOXELIZE_CACHE_CHUNK_CONTENT_H

#include "libvoxel/voxelize/cache/chunk_cache.h"

/* What chunks are made from. */
struct vox_chunk_source {
    const struct fmt_tris_file *file;
    const struct vox_transform *transform;
    bool smooth; /* see vox_chunks_create() */
};

/* Offsets in bytes in a slot's memory. The chunk as it is in the file comes first, then its made
 * normals. */
struct vox_chunk_layout {
    uint64_t made_at, points_at, normals_at, groups_at, inconsistent_at, bytes;
};

struct vox_chunk_content {
    uint8_t *memory; /* vox_chunks_slot_bytes() */
    struct vox_chunk_layout layout;
    struct vox_chunk chunk;
    double mean_square; /* of the triangles' first edges, in voxels */
};

/* Loads chunk `number`, finds the voxels of its groups, places its vertices in index space, and
 * makes what depends on normals. Errors: those of fmt_tris_load(). */
int vox_chunk_make(const struct vox_chunk_source *from, uint32_t number,
                   struct vox_chunk_content *content);

/* Computes the voxels of each group's bounds, and returns the mean square of the triangles' first
 * edges, in voxels. */
double vox_triangle_groups(const struct fmt_tris_chunk *chunk,
                           const struct vox_transform *transform, struct vox_box *groups);

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
