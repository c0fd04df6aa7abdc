/* lane_code_avx512.c - eight lanes; compiled for processors that have AVX-512. */
#include "libvoxel/voxelize/lanes/lane_code.h"

#ifdef __AVX512DQ__
#include "libvoxel/voxelize/clip/accumulate_lanes.h"
#include "libvoxel/voxelize/records/record_lanes.h"
#include "libvoxel/voxelize/cache/ring_lanes.h"

const struct vox_lane_code vox_lane_code_avx512 = {accumulate_chunk, make_records, add_rings,
                                                   finish_rings};
#endif
