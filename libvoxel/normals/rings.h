/* rings.h - one-rings and their creases (base/geometry/smooth_normals.h), for each instruction set;
 * private to this folder. */
#ifndef VOX_NORMALS_RINGS_H
#define VOX_NORMALS_RINGS_H

#include "base/geometry/smooth_normals.h"

/* Triangles and the sums of the one-rings at their corners; number 0 is for corners that have
 * none. */
struct vox_rings {
    const float (*positions)[3]; /* at least four bytes can be read after the last one */
    const uint32_t (*triangles)[3];
    const uint32_t *ring_of; /* by vertex: the number of its one-ring, from 1 on, or 0 */
    double (*sums)[4];
    /* Creases: their number by one-ring, 0: none; directions, and sums of both sides, by their
     * number. */
    uint32_t *crease_of;
    double (*creases)[4], (*firsts)[4], (*seconds)[4];
};

/* A pass over the first `count` triangles. */
enum vox_ring_step {
    VOX_RING_SUM,      /* bsq_add_one_rings() */
    VOX_RING_FARTHEST, /* bsq_find_farthest() */
    VOX_RING_SIDES     /* bsq_add_sides() */
};
typedef void vox_rings_add_fn(const struct vox_rings *rings, enum vox_ring_step step,
                              enum bsq_scan_normals weights, uint32_t count);
BSQ_SIMD_DECLARE(vox_rings_add_fn, vox_rings_add);

/* Packs the normals of `count` one-rings, and the rises of the surface above their vertices
 * (base/geometry/vertex_normal.h). */
typedef void vox_rings_pack_fn(const double (*sums)[4], const uint32_t *ring_of, uint32_t count,
                               uint64_t *normals);
BSQ_SIMD_DECLARE(vox_rings_pack_fn, vox_rings_pack);

/* Numbers the one-rings from `begin` up to `end` that may be creases, until there are `most`: none
 * by angle, as in Blender. Sets *count to their number, and returns where it ended. */
static inline uint64_t vox_rings_number_creases(const struct vox_rings *rings,
                                                enum bsq_scan_normals weights, uint64_t begin,
                                                uint64_t end, uint32_t most, uint32_t *count)
{
    *count = 0;
    for (; begin < end && *count < most; begin++) {
        rings->crease_of[begin] = 0;
        if (weights == BSQ_SCAN_NORMALS_ANGLE ||
            !bsq_may_fold(rings->sums[begin * BSQ_RING_ROWS + 1]))
            continue;
        rings->crease_of[begin] = ++*count;
        memcpy(rings->creases[*count], (const double[4]){[3] = INFINITY}, sizeof *rings->creases);
    }
    return begin;
}

/* Divides the one-rings that fold from `begin` up to `end`, after VOX_RING_FARTHEST. Returns
 * whether there are any. */
static inline bool vox_rings_divide(const struct vox_rings *rings, uint64_t begin, uint64_t end)
{
    bool any = false;
    for (uint64_t ring = begin; ring < end; ring++) {
        uint32_t *crease = &rings->crease_of[ring];
        if (*crease == 0)
            continue;
        const uint64_t at = *crease * (uint64_t)BSQ_RING_ROWS;
        memset(rings->firsts[at], 0, BSQ_RING_ROWS * sizeof *rings->firsts);
        memset(rings->seconds[at], 0, BSQ_RING_ROWS * sizeof *rings->seconds);
        if (!bsq_divide_ring(rings->sums[ring * BSQ_RING_ROWS], rings->creases[*crease]))
            *crease = 0;
        any |= *crease != 0;
    }
    return any;
}

/* Decides which of the divided one-rings from `begin` up to `end` are creases, after
 * VOX_RING_SIDES. Their sums become those of the first side. Sides that fold have no normal. */
static inline void vox_rings_decide(const struct vox_rings *rings, uint64_t begin, uint64_t end)
{
    for (uint64_t ring = begin; ring < end; ring++) {
        uint32_t *crease = &rings->crease_of[ring];
        double(*sides[])[4] = {&rings->firsts[*crease * (uint64_t)BSQ_RING_ROWS],
                               &rings->seconds[*crease * (uint64_t)BSQ_RING_ROWS]};
        if (*crease == 0)
            continue;
        if (!bsq_is_crease((const double(*)[4])sides[0], (const double(*)[4])sides[1])) {
            *crease = 0;
            continue;
        }
        for (int i = 0; i < 2; i++)
            if (!bsq_is_smooth(sqrt(bsq_row_dot(*sides[i], *sides[i])), (*sides[i])[3]))
                memset(sides[i], 0, sizeof *sides[i]);
        memcpy(&rings->sums[ring * BSQ_RING_ROWS], sides[0], BSQ_RING_ROWS * sizeof *sides[0]);
    }
}

#endif
