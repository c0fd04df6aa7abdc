/* rings.h - one-rings and their creases (base/geometry/smooth_normals.h), for each instruction set;
 * private to this folder. */
#ifndef VOX_NORMALS_RINGS_H
#define VOX_NORMALS_RINGS_H

#include "base/geometry/smooth_normals.h"

/* The sums of one-rings. */
struct vox_rings {
    double (*sums)[4], (*units)[4];
    /* Creases: their number by one-ring, 0: none; and by their number, from 1 on: the one-ring, the
     * direction, the sums of both sides, and what tells creases from noise. */
    uint32_t *crease_of, *crease_rings;
    double (*creases)[4], (*firsts)[4], (*seconds)[4], (*spreads)[4];
};

/* A pass over triangles. */
enum vox_ring_step {
    VOX_RING_SUM,      /* bsq_add_one_rings() */
    VOX_RING_FARTHEST, /* bsq_find_farthest() */
    VOX_RING_SIDES     /* bsq_add_sides() */
};
/* of: the one-rings of the triangles' corners. */
typedef void vox_rings_add_fn(const struct vox_rings *rings, enum vox_ring_step step,
                              enum bsq_scan_normals weights, const float (*positions)[3],
                              const uint32_t (*triangles)[3], const uint32_t (*of)[3],
                              uint32_t count);
BSQ_SIMD_DECLARE(vox_rings_add_fn, vox_rings_add);

/* Packs the normals of the one-rings of `count` vertices, and the rises of the surface above them
 * (base/geometry/vertex_normal.h). */
typedef void vox_rings_pack_fn(const double (*sums)[4], const uint32_t *ring_of, uint32_t count,
                               uint64_t *normals);
BSQ_SIMD_DECLARE(vox_rings_pack_fn, vox_rings_pack);

/* What the sums of a one-ring tell. */
enum {
    VOX_RING_OPEN = 1, /* it is not closed in its chunk */
    VOX_RING_FOLDS = 2 /* it may be a crease */
};

/* Returns VOX_RING_FOLDS if a one-ring with this row of `units` may be a crease, else 0: by angle,
 * none is, as in Blender. */
static inline uint8_t vox_ring_folds(enum bsq_scan_normals weights, const double units[4])
{
    return (weights != BSQ_SCAN_NORMALS_ANGLE) & bsq_may_fold(units) ? VOX_RING_FOLDS : 0;
}

/* Clears the sums of one-rings from `first` on. */
static inline void vox_rings_clear(const struct vox_rings *rings, uint64_t first, uint64_t count)
{
    memset(rings->sums[first * BSQ_RING_ROWS], 0, count * BSQ_RING_ROWS * sizeof *rings->sums);
    memset(rings->units[first], 0, count * sizeof *rings->units);
}

/* Numbers the one-rings that may be creases among those from `begin` up to `end`, until there are
 * `most`. flags: by one-ring. Sets *count to their number, and returns where it ended. */
static inline uint32_t vox_rings_number_creases(const struct vox_rings *rings, const uint8_t *flags,
                                                uint32_t begin, uint32_t end, uint32_t most,
                                                uint32_t *count)
{
    *count = 0;
    for (; begin < end && *count < most; begin++) {
        if (!(flags[begin] & VOX_RING_FOLDS))
            continue;
        rings->crease_of[begin] = ++*count;
        rings->crease_rings[*count] = begin;
        memcpy(rings->creases[*count], (const double[4]){[3] = INFINITY}, sizeof *rings->creases);
    }
    return begin;
}

/* Divides the one-rings that fold, after VOX_RING_FARTHEST. Returns whether there are any. */
static inline bool vox_rings_divide(const struct vox_rings *rings, uint32_t count)
{
    bool any = false;
    for (uint32_t crease = 1; crease <= count; crease++) {
        const uint64_t at = crease * (uint64_t)BSQ_RING_ROWS, ring = rings->crease_rings[crease];
        memset(rings->firsts[at], 0, BSQ_RING_ROWS * sizeof *rings->firsts);
        memset(rings->seconds[at], 0, BSQ_RING_ROWS * sizeof *rings->seconds);
        memset(rings->spreads[at], 0, BSQ_RING_ROWS * sizeof *rings->spreads);
        if (bsq_divide_ring(rings->sums[ring * BSQ_RING_ROWS], rings->creases[crease]))
            any = true;
        else
            rings->crease_of[ring] = 0;
    }
    return any;
}

/* Decides which of the divided one-rings are creases, after VOX_RING_SIDES. Sides that fold have no
 * normal. */
static inline void vox_rings_decide(const struct vox_rings *rings, uint32_t count)
{
    for (uint32_t crease = 1; crease <= count; crease++) {
        const uint64_t at = crease * (uint64_t)BSQ_RING_ROWS;
        double *sides[] = {rings->firsts[at], rings->seconds[at]};
        uint32_t *number = &rings->crease_of[rings->crease_rings[crease]];
        if (*number == 0)
            continue;
        if (!bsq_is_crease(sides[0], sides[1], (const double(*)[4])rings->spreads[at]))
            *number = 0;
        for (int i = 0; i < 2; i++)
            if (!bsq_is_smooth(sqrt(bsq_row_dot(sides[i], sides[i])), sides[i][3]))
                memset(sides[i], 0, BSQ_RING_ROWS * sizeof *rings->firsts);
    }
}

#endif
