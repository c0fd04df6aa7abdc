/* disk_estimate.c - see disk_estimate.h. The figures are measured ones; what depends on a file's
 * order is taken at its usual value, so that no scan is refused which would have had room. */
#include "libvoxel/partition/disk_estimate.h"

/* Bytes of a triangle, coded by the indices of one kind. */
#define BYTES_BY_INDEX 2

static uint64_t vertex_bytes(const struct fmt_mesh_estimate *scan)
{
    return 12 + (scan->has_colors ? 4 : 0) + (scan->texcoords > 0 ? 8 : 0) +
           (scan->normals > 0 ? 4 : 0);
}

/* Where columns are in a file: what faces take that do not come last, and triangles in their cells.
 * Scans that have to be joined with values need more, which only shows when they are read. */
static uint64_t faces_and_runs(const struct fmt_mesh_estimate *scan,
                               const struct sort_limits *limits, uint64_t coded)
{
    return (scan->faces_come_last ? 0 : coded) +
           (coded > limits->page_memory ? coded - limits->page_memory : 0);
}

struct space vox_disk_estimate(const struct fmt_mesh_estimate *scan,
                               const struct sort_limits *limits)
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
        space.temp_bytes = columns + faces_and_runs(scan, limits, coded);
    } else {
        uint64_t memory = limits->store_bytes > columns ? limits->store_bytes - columns : 0;
        space.temp_bytes = coded > memory ? coded - memory : 0;
    }
    return space;
}
