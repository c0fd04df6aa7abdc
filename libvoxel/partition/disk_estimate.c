/* disk_estimate.c - see partition.h. The bytes per triangle are measured on ordinary scans, whose
 * faces refer to vertices nearly in their order. */
#include "libvoxel/partition/partition.h"

/* Bytes of a triangle's delta-coded indices, for one kind of index. */
#define BYTES_BY_INDEX 2

static uint64_t vertex_bytes(const struct fmt_mesh_estimate *scan)
{
    return 12 + (scan->has_colors ? 4 : 0) + (scan->texcoords > 0 ? 8 : 0) +
           (scan->normals > 0 ? 4 : 0);
}

struct disk_space vox_disk_estimate(const struct fmt_mesh_estimate *scan,
                                    const struct sort_limits *limits)
{
    const uint64_t triangles =
        scan->corners > 2 * scan->faces ? scan->corners - 2 * scan->faces : 0;
    const uint64_t kinds = 1u + (scan->texcoords > 0) + (scan->normals > 0);
    const uint64_t streams =
        scan->vertices * (scan->has_colors ? 16 : 12) + 8 * scan->texcoords + 4 * scan->normals;
    const uint64_t coded = BYTES_BY_INDEX * kinds * triangles;
    const bool spilled = streams > limits->stream_bytes;
    /* Pages may use the memory that streams do not need. */
    const uint64_t pages = limits->page_memory + (spilled ? 0 : limits->stream_bytes - streams);
    const uint64_t runs = coded > pages ? coded - pages : 0;
    return (struct disk_space){
        .output_bytes = 6 * triangles + scan->vertices * vertex_bytes(scan),
        .temp_bytes = (spilled ? streams : 0) + runs,
    };
}
