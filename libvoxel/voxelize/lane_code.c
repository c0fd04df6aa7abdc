/* lane_code.c - two lanes, and the choice between them and more. */
#include "libvoxel/voxelize/lanes/lane_code.h"
#include "libvoxel/voxelize/clip/accumulate_lanes.h"
#include "libvoxel/voxelize/records/record_lanes.h"
#include "libvoxel/voxelize/cache/ring_lanes.h"

static const struct vox_lane_code two_lanes = {accumulate_chunk, make_records, add_rings,
                                               finish_rings};

/* AVX-512 comes with much lower clocks in its first processors; those that have VBMI2 are later. */
const struct vox_lane_code *vox_lane_code_of(unsigned count)
{
#ifdef __x86_64__
    if (count == 8)
        return __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl") &&
                       __builtin_cpu_supports("avx512vbmi2")
                   ? &vox_lane_code_avx512
                   : NULL;
    if (count == 4)
        return __builtin_cpu_supports("avx2") ? &vox_lane_code_avx2 : NULL;
#endif
    return count == 2 ? &two_lanes : NULL;
}

const struct vox_lane_code *vox_lane_code(void)
{
    unsigned count = 8;
    while (!vox_lane_code_of(count))
        count /= 2;
    return vox_lane_code_of(count);
}
