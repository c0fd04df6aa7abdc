/* lane_code_avx2.c - four lanes; compiled for processors that have AVX2. */
#include "libvoxel/lane_code.h"

#ifdef __AVX2__
#include "libvoxel/accumulate_lanes.h"
#include "libvoxel/record_lanes.h"
#include "libvoxel/ring_lanes.h"

const struct vox_lane_code vox_lane_code_avx2 = {accumulate_chunk, make_records, add_rings, finish_rings};
#endif
