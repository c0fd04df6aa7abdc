/* triangulate_internal.h - a block of faces, shared by the files triangulate*.c. */
#ifndef VOX_PARTITION_TRIANGULATE_INTERNAL_H
#define VOX_PARTITION_TRIANGULATE_INTERNAL_H

#include "libvoxel/partition/corner_delta_code.h"
#include "libvoxel/partition/triangulate.h"

/* A block of faces. */
struct faces {
    const struct fmt_mesh_block *block;
    const uint32_t *sizes;                        /* NULL if all faces are triangles */
    const uint64_t *indices[FMT_MESH_KIND_COUNT]; /* of corners; NULL: none has any */
    uint32_t material[2]; /* of triangles with texture coordinates, others */
};

/* Returns the most bytes that a coded triangle of this scan takes: differences of indices take four
 * bytes if there are fewer than 2^31. */
static inline uint32_t coded_triangle_bytes(const struct triangulation_plan *plan, uint32_t kinds)
{
    const struct scan *scan = plan->scan;
    uint64_t most = scan_count(scan, SCAN_POSITIONS) | scan_count(scan, SCAN_TEXCOORDS) |
                    scan_count(scan, SCAN_NORMALS);
    return kinds * (most >> 31 ? CORNER_CODE_MAX : 13);
}

/* ---- triangulate_code.c ---- */

/* Sorts the triangulator's spans by bucket and codes them as runs. */
int vox_triangulate_code_spans(struct triangulator *t, const struct faces *faces);

/* Triangulates a block of triangles that have positions alone and one material. *done: false if the
 * block has no such faces or its triangles have no order; then the result is undefined. */
int vox_triangulate_plain(struct triangulator *t, const struct faces *faces, bool *done);

#endif
