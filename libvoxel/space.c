/* space.c - see space.h. The figures are measured ones; what depends on a file's order is taken at
 * its usual value, so that no scan is refused which would have had room. */
#include "libvoxel/space.h"

/* Bytes of a triangle, coded by the indices of one kind, or by the values of its new corners. */
#define BYTES_BY_INDEX     2
#define VALUES_BY_TRIANGLE 1

static uint64_t vertex_bytes(const struct fmt_obj_estimate *scan)
{
    return 12 + (scan->has_colors ? 4 : 0) + (scan->texcoords > 0 ? 8 : 0) +
           (scan->normals > 0 ? 4 : 0);
}

/* All faces are triangles, as far as samples show. */
static bool are_triangles(const struct fmt_obj_estimate *scan)
{
    return scan->corners <= 3 * scan->faces + scan->faces / 64;
}

/* Where columns are in a file: what faces take as they are read, and triangles in their cells. Triangles alone are scattered
 * by index, at once where faces come last; others are joined with values. */
static uint64_t faces_and_runs(const struct fmt_obj_estimate *scan, const struct sort_limits *limits, uint64_t coded,
                               uint64_t values)
{
    const bool by_index = are_triangles(scan);
    uint64_t runs = by_index ? coded : values, faces = by_index && scan->faces_come_last ? 0 : coded;
    return faces + (runs > limits->page_memory ? runs - limits->page_memory : 0);
}

struct space space_for(const struct fmt_obj_estimate *scan, const struct sort_limits *limits)
{
    const uint64_t triangles =
        scan->corners > 2 * scan->faces ? scan->corners - 2 * scan->faces : 0;
    const uint64_t kinds = 1u + (scan->texcoords > 0) + (scan->normals > 0);
    const uint64_t columns =
        scan->vertices * (scan->has_colors ? 16 : 12) + 8 * scan->texcoords + 4 * scan->normals;
    struct space space = {
        .output_bytes = 6 * triangles + scan->vertices * vertex_bytes(scan),
    };
    const uint64_t coded = BYTES_BY_INDEX * kinds * triangles;
    if (columns > limits->column_bytes) {
        space.temp_bytes = columns + faces_and_runs(scan, limits, coded, VALUES_BY_TRIANGLE * vertex_bytes(scan) * triangles);
    } else {
        uint64_t memory = limits->store_bytes > columns ? limits->store_bytes - columns : 0;
        space.temp_bytes = coded > memory ? coded - memory : 0;
    }
    return space;
}
