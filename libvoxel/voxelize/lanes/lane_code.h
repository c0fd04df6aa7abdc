/* lane_code.h - private to voxelizing: what is done to many triangles or voxels side by side.
 *
 * The same source is compiled for several kinds of instructions; results are the same. */
#ifndef VOX_VOXELIZE_LANES_LANE_CODE_H
#define VOX_VOXELIZE_LANES_LANE_CODE_H

#include "libvoxel/voxelize/clip/accumulate.h"

/* Sums over the triangles around a vertex. */
struct vox_ring {
    double area_vector[3], area; /* twice */
    double moment[3]; /* three times area times the centroid's distance from the vertex */
    double unused;
};

struct vox_lane_code {
    /* As vox_accumulate_chunk(). */
    int (*accumulate_chunk)(const struct vox_accumulation *what, uint64_t *counted);
    /* Makes `count` records from the sums with these numbers, without colours and without
     * FMT_NVDB_PLANE_SECOND. */
    void (*make_records)(const struct vox_sum *sums, const uint32_t *numbers, uint64_t count,
                         struct fmt_nvdb_record *records);
    /* Adds the chunk's triangles from begin to end to the rings around their corners, whose numbers
     * are those of the vertices. Ring 0 takes what is not wanted; triangles that have no other are
     * left out. */
    void (*add_rings)(const struct fmt_tris_chunk *chunk, uint32_t begin, uint32_t end,
                      const uint32_t *ring_of, struct vox_ring *rings);
    /* The normals of so many vertices from their rings, see vox_smooth_normals(); h: size of a
     * voxel. */
    void (*finish_rings)(const struct vox_ring *rings, const uint32_t *ring_of, uint32_t count,
                         double h, float (*normals)[4]);
};

#ifdef __x86_64__
extern const struct vox_lane_code vox_lane_code_avx2, vox_lane_code_avx512;
#endif

/* The code for 2, 4 or 8 lanes; NULL where this processor cannot run it. */
const struct vox_lane_code *vox_lane_code_of(unsigned count);

/* The best that the processor can run. */
const struct vox_lane_code *vox_lane_code(void);

#endif
