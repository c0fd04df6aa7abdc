/* scan_normals_check.h - whether the normals of a scan file are consistent with its triangles. */
#ifndef VOX_VOXELIZE_CACHE_SCAN_NORMALS_CHECK_H
#define VOX_VOXELIZE_CACHE_SCAN_NORMALS_CHECK_H

#include <stdbool.h>
#include <stdint.h>

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
