/* float_precision.c - see float_precision.h.
 *
 * Rounding moves a position by up to half the spacing of float32 at its distance from the origin.
 * This tilts an edge of length L by up to spacing / L. For edges of 16 spacings and more, normals
 * are wrong by at most about 3 degrees; shorter edges deserve a warning. Scans of ordinary
 * proportions never get one: with a billion triangles on the unit sphere, edges are 1000 spacings
 * long. */
#include "libvoxel/float_precision.h"

#include "base/context.h"

#include <math.h>

static const double least_spacings = 16.0;

/* Returns the distance between neighbouring float32 numbers at the largest coordinate of the
 * bounds. */
static double spacing_at(const float min[3], const float max[3])
{
    float largest = 0.0f;
    for (int axis = 0; axis < 3; axis++)
        largest = fmaxf(largest, fmaxf(fabsf(min[axis]), fabsf(max[axis])));
    return (double)nextafterf(largest, INFINITY) - (double)largest;
}

void vox_precision_choose_origin(const double min[3], const double max[3], double origin[3])
{
    double half = 0.0;
    for (int axis = 0; axis < 3; axis++)
        half = fmax(half, max[axis] / 2 - min[axis] / 2);
    for (int axis = 0; axis < 3; axis++) {
        double centre = min[axis] / 2 + max[axis] / 2;
        origin[axis] = 0.0;
        if (fabs(centre) < 8192.0 || fabs(centre) < 64.0 * half)
            continue;
        /* The origin needs no more digits than the coordinates are likely to have. */
        double step = ldexp(1.0, ilogb(fmax(4.0 * half, fabs(centre) * 0x1p-20)));
        double near = round(centre / step) * step;
        if (isfinite(near))
            origin[axis] = near;
    }
}

uint64_t vox_precision_count_merged(const double (*positions)[3], uint64_t count,
                                    const double origin[3])
{
    uint64_t merged = 0;
    for (uint64_t v = 1; v < count; v++) {
        const double *p = positions[v], *q = positions[v - 1];
        if ((float)(p[0] - origin[0]) != (float)(q[0] - origin[0]) ||
            (float)(p[1] - origin[1]) != (float)(q[1] - origin[1]) ||
            (float)(p[2] - origin[2]) != (float)(q[2] - origin[2]))
            continue;
        merged += p[0] != q[0] || p[1] != q[1] || p[2] != q[2];
    }
    return merged;
}

int vox_precision_warn_merged(struct bsq_ctx *ctx, const char *path, uint64_t merged,
                              const float min[3], const float max[3])
{
    if (merged == 0)
        return 0;
    return bsq_warn_loss(
        ctx,
        "%s: %llu %s fell together with the one before: positions are kept to %.2g of the scan's units, as "
        "32-bit numbers are at its size",
        path, (unsigned long long)merged, merged == 1 ? "vertex" : "vertices",
        spacing_at(min, max));
}

/* Estimates the mean edge of a chunk's triangles: their surface is about as large as its bounds. */
static double precision_edge_of(const struct fmt_tris_chunk_info *chunk)
{
    double square = 0.0;
    for (int axis = 0; axis < 3; axis++) {
        double side = (double)chunk->bounds_max[axis] - (double)chunk->bounds_min[axis];
        square += side * side;
    }
    return sqrt(square / chunk->triangle_count);
}

void vox_precision_warn_grid(struct bsq_ctx *ctx, const char *path,
                             const struct fmt_tris_header *header,
                             const struct fmt_tris_chunk_info *chunks, double h)
{
    uint64_t coarse = 0;
    for (uint64_t i = 0; i < header->chunk_count; i++) {
        double spacing = spacing_at(chunks[i].bounds_min, chunks[i].bounds_max);
        coarse +=
            precision_edge_of(&chunks[i]) < least_spacings * spacing ? chunks[i].triangle_count : 0;
    }
    double spacing = spacing_at(header->bounds_min, header->bounds_max);
    if (2 * coarse > header->triangle_count)
        bsq_warn(
            ctx,
            "%s: positions are kept to %.2g of the scan's units, which is coarse for the edges of %llu of its triangles",
            path, spacing, (unsigned long long)coarse);
    else if (h < least_spacings * spacing)
        bsq_warn(
            ctx,
            "%s: positions are kept to %.2g of the scan's units, which is coarse for voxels of %.2g",
            path, spacing, h);
}
