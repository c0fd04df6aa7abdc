/* distance_lanes.c - see distance_lanes.h. Its loops have no branches, so that compilers turn them
 * into vectors. */
#include "libvoxel/simplify/distance_lanes.h"

/* The distance is that from the plane, for points above the inside, or that from an edge. The way
 * beyond an edge's line and the height above the plane bound the latter, so edges are looked at for
 * few points. The first
 * loop has no branches, so that points are computed side by side. */
void BSQ_SIMD_NAME(vox_try_triangle)(const float *const corners[3], double number,
                                     struct vox_batch *b)
{
    double bounds[VOX_CLOSEST_BATCH], inverse_outwards[3], least_gain = 0;
    struct vox_plane plane;
    vox_set_plane(corners, &plane);
    vox_set_inverses(&plane);
    for (int k = 0; k < 3; k++)
        inverse_outwards[k] = plane.inverse_edges[k] * plane.inverse_area;
    const double flat = plane.area > 0 ? -1 : 1;
    for (unsigned i = 0; i < b->count; i++) {
        double outside = flat, height = 0, way = 0;
        for (int k = 0; k < 3; k++) {
            const double *c = plane.corners[k], *out = plane.outwards[k];
            const double x = b->points[0][i] - c[0], y = b->points[1][i] - c[1],
                         z = b->points[2][i] - c[2];
            const double beyond = x * out[0] + y * out[1] + z * out[2];
            const double square = beyond > 0 ? beyond * beyond * inverse_outwards[k] : 0;
            way = square > way ? square : way;
            outside = beyond > outside ? beyond : outside;
            height = x * plane.normal[0] + y * plane.normal[1] + z * plane.normal[2];
        }
        const double above = height * height * plane.inverse_area;
        const double inside = outside <= 0 ? above : INFINITY;
        const double bound = outside <= 0 ? INFINITY : (above + way) * plane.safe;
        const double square = b->squares[i];
        b->squares[i] = inside < square ? inside : square;
        b->owners[i] = inside < square ? number : b->owners[i];
        bounds[i] = bound - square;
        least_gain = bounds[i] < least_gain ? bounds[i] : least_gain;
    }
    if (!(least_gain < 0))
        return;
    for (unsigned i = 0; i < b->count; i++) {
        if (!(bounds[i] < 0))
            continue;
        const double square =
            vox_edge_square(&plane, b->points[0][i], b->points[1][i], b->points[2][i]);
        if (!(square < b->squares[i]))
            continue;
        b->squares[i] = square;
        b->owners[i] = number;
    }
}

bool BSQ_SIMD_NAME(vox_view_block)(const struct vox_cover_block *block,
                                   const float *const corners[3], double height, double margin,
                                   struct vox_cover_view *view)
{
    double from[3], edges[3][3], outwards[3][3], normal[3], beyond[3], longest = 0;
    int64_t outside = VOX_BEYOND_ALL;
    for (int i = 0; i < 3; i++) {
        from[i] = (double)corners[0][i];
        for (int k = 0; k < 3; k++)
            edges[i][k] = (double)corners[(i + 1) % 3][k] - (double)corners[i][k];
        longest = fmax(longest, bsq_dotd(edges[i], edges[i]));
    }
    bsq_crossd(edges[0], edges[1], normal);
    for (int i = 0; i < 3; i++)
        bsq_crossd(edges[i], normal, outwards[i]);
    const double area = bsq_dotd(normal, normal), unit = sqrt(area), limit = height * unit,
                 offset = bsq_dotd(edges[0], outwards[1]), middle = area / -3;
    if (!(area > 1e-12 * longest * longest))
        return false;
    for (int i = 0; i < 3; i++)
        beyond[i] = -margin * unit * sqrt(bsq_dotd(edges[i], edges[i]));
    const double corners_seen[3][2] = {{beyond[0], -area - beyond[0] - beyond[2]},
                                       {beyond[0], beyond[1]},
                                       {-area - beyond[1] - beyond[2], beyond[1]}};
    memcpy(view->seen, corners_seen, sizeof view->seen);
    view->middle = middle;
    view->unit = unit;
    for (uint32_t i = 0; i < block->vertex_count; i++) {
        const double x = block->points[0][i] - from[0], y = block->points[1][i] - from[1],
                     z = block->points[2][i] - from[2];
        const double a = x * outwards[0][0] + y * outwards[0][1] + z * outwards[0][2],
                     b = x * outwards[1][0] + y * outwards[1][1] + z * outwards[1][2] - offset,
                     c = x * outwards[2][0] + y * outwards[2][1] + z * outwards[2][2],
                     h = fabs(x * normal[0] + y * normal[1] + z * normal[2]);
        const int64_t code = (a > beyond[0] ? 1 : 0) | (b > beyond[1] ? 2 : 0) |
                             (c > beyond[2] ? 4 : 0) | (h > limit ? VOX_TOO_HIGH : 0) |
                             (b > middle ? VOX_ABOVE_LINE : 0) |
                             (a > middle ? VOX_RIGHT_OF_LINE : 0);
        view->across[0][i] = a;
        view->across[1][i] = b;
        view->heights[i] = h;
        view->codes[i] = code;
        outside &= code;
    }
    return outside == 0;
}
