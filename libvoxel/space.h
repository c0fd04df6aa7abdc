/* space.h - private to the sorter: what it will need on disk. */
#ifndef VOX_SPACE_H
#define VOX_SPACE_H

#include "formats/obj.h"
#include "libvoxel/sort_internal.h"

struct space {
    uint64_t output_bytes; /* of the chunk file */
    uint64_t temp_bytes;
};

/* For a scan of this size, as a rule: faces that refer to vertices in their order or nearly so.
 * Others need more, and end when the disk is full; so no scan is refused that has room. */
struct space space_for(const struct fmt_obj_estimate *scan, const struct sort_limits *limits);

#endif
