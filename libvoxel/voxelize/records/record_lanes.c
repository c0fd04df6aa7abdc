/* record_lanes.c - turns the sums of voxels into records of the grid, several side by side. */
#define SIMD_FLOATS LANE_COUNT
#include "libvoxel/voxelize/records/region.h"

/* Rounds to the nearest integer, ties to even, for |x| < 2^22. */
LANES_INLINE float_ints record_round_floats(floats x)
{
    const int32_t bits = 0x4b400000; /* of 1.5 * 2^23 */
    return (float_ints)(x + 12582912.0f) - bits;
}

/* Rounds to the nearest integer, ties to even, for |x| < 2^51. */
LANES_INLINE lane_ints record_round(doubles x)
{
    const int64_t bits = INT64_C(0x4338000000000000); /* of 1.5 * 2^52 */
    return (lane_ints)(x + 6755399441055744.0) - bits;
}

/* Returns 1 - magnitude with the sign of `like`; both zeros count as positive. */
LANES_INLINE floats record_fold(floats magnitude, floats like)
{
    return (floats)((float_ints)(1.0f - magnitude) ^ ((like < 0.0f) & INT32_MIN));
}

/* Computes bsq_oct_pack() of unit vectors. */
LANES_INLINE float_ints record_pack_normal(const doubles unit[3])
{
    floats x = __builtin_convertvector(unit[0], floats);
    floats y = __builtin_convertvector(unit[1], floats);
    floats z = __builtin_convertvector(unit[2], floats);
    floats sum = floats_abs(x) + floats_abs(y) + floats_abs(z);
    x /= sum;
    y /= sum;
    floats folded_x = record_fold(floats_abs(y), x);
    floats folded_y = record_fold(floats_abs(x), y);
    float_ints below = z < 0.0f;
    float_ints u = record_round_floats(floats_select(below, folded_x, x) * 32767.0f);
    float_ints v = record_round_floats(floats_select(below, folded_y, y) * 32767.0f);
    return (u & 0xffff) | v << 16;
}

LANES_INLINE void record_make(const struct vox_sum *const from[LANE_COUNT], float_ints *normal,
                              lane_ints *plane)
{
    doubles sum[8], n[3];
    const double *half[2][LANE_COUNT];
    for (int l = 0; l < LANE_COUNT; l++) {
        half[0][l] = from[l]->normal;
        half[1][l] = from[l]->center;
    }
    lanes_gather_four(half[0], sum);
    lanes_gather_four(half[1], sum + 4);
    doubles length = lanes_sqrt(sum[0] * sum[0] + sum[1] * sum[1] + sum[2] * sum[2]), area = sum[7];
    /* Quotients of several numbers take most of the time, so each divisor is inverted once. */
    const doubles by_length = 1.0 / length, by_area = 1.0 / area;
    lane_mask has = lanes_less(lanes_all(0.0), length);
    for (int k = 0; k < 3; k++)
        n[k] = lanes_select(has, sum[k] * by_length, lanes_all(k == 2));
    *normal = record_pack_normal(n);

    /* No plane that meets the voxel is farther from its centre than half a diagonal. */
    doubles d = (n[0] * sum[4] + n[1] * sum[5] + n[2] * sum[6]) * by_area;
    d = lanes_min(lanes_max(d, lanes_all(-0.87)), lanes_all(0.87));
    doubles coverage = lanes_min(length * by_area, lanes_all(1.0));
    lane_mask inconsistent = lanes_less(2.0 * area, sum[3]);
    doubles noise = lanes_keep(~inconsistent, lanes_min(sum[3] * by_area, lanes_all(1.0)));
    *plane = lanes_set_bits(inconsistent, record_round(d * 32767.0) & 0xffff,
                            lanes_all_bits(FMT_NVDB_PLANE_INCONSISTENT)) |
             record_round(coverage * 255.0) << 16 |
             record_round(noise * FMT_NVDB_FACET_NOISE_MAX) << FMT_NVDB_FACET_NOISE_SHIFT;
}

void BSQ_SIMD_NAME(vox_make_records)(const struct vox_sum *sums, const uint32_t *numbers,
                                     uint64_t count, struct fmt_nvdb_record *records)
{
    for (uint64_t done = 0; done < count; done += LANE_COUNT) {
        const struct vox_sum *from[LANE_COUNT];
        float_ints normal;
        lane_ints plane;
        for (uint64_t l = 0; l < LANE_COUNT; l++)
            from[l] = &sums[numbers[done + l < count ? done + l : done]];
        record_make(from, &normal, &plane);
        for (uint64_t l = 0; l < LANE_COUNT && done + l < count; l++) {
            records[done + l].normal = (uint32_t)normal[l];
            records[done + l].plane = (uint32_t)plane[l];
            records[done + l].color = records[done + l].id = 0;
        }
    }
}
