/* lane_code_avx2.c - four lanes; compiled for processors that have AVX2. */
#include "libvoxel/voxelize/lanes/lane_code.h"

#ifdef __AVX2__
#include "libvoxel/voxelize/clip/accumulate_lanes.h"
#include "libvoxel/voxelize/records/record_lanes.h"
#include "libvoxel/voxelize/cache/ring_lanes.h"

const struct vox_lane_code vox_lane_code_avx2 = {accumulate_chunk, make_records, add_rings,
                                                 finish_rings};
#endif
