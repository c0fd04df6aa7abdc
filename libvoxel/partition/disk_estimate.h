/* disk_estimate.h - private to the sorter: what it will need on disk. */
#ifndef VOX_PARTITION_DISK_ESTIMATE_H
#define VOX_PARTITION_DISK_ESTIMATE_H

#include "formats/mesh/mesh_reader.h"
#include "libvoxel/sort_limits.h"

struct space {
    uint64_t output_bytes; /* of the chunk file */
    uint64_t temp_bytes;
};

/* For a scan of this size, as a rule: faces that refer to vertices in their order or nearly so.
 * Others need more, and end when the disk is full; so no scan is refused that has room. */
struct space vox_disk_estimate(const struct fmt_mesh_estimate *scan,
                               const struct sort_limits *limits);

#endif
