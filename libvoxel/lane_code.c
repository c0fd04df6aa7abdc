/* lane_code.c - two lanes, and the choice between them and more. */
#include "libvoxel/lane_code.h"
#include "libvoxel/accumulate_lanes.h"
#include "libvoxel/record_lanes.h"
#include "libvoxel/ring_lanes.h"

const struct vox_lane_code vox_lane_code_plain = {accumulate_chunk, make_records, add_rings};

const struct vox_lane_code *vox_lane_code(void)
{
#ifdef __x86_64__
    if (__builtin_cpu_supports("avx2"))
        return &vox_lane_code_avx2;
#endif
    return &vox_lane_code_plain;
}
