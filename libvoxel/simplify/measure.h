/* measure.h - how far a low-poly mesh is from its scan, both ways. */
#ifndef VOX_MEASURE_H
#define VOX_MEASURE_H

#include "formats/chunks/tris.h"
#include "libvoxel/simplify/mesh.h"
#include "libvoxel/voxel.h"

/* Measures the distance of each vertex of the scan from the closest point of the mesh, and of the
 * mesh's vertices, and points spread evenly over its area, from the closest point of the scan.
 * Means are by area. Reads the scan twice, chunk by chunk. Stops as soon as a distance of the first
 * kind is above `enough`; then the figures of that kind are those so far, and the others 0. Errors:
 * BSQ_ENOMEM, BSQ_EIO, BSQ_EDATA, BSQ_EINTR. */
int vox_measure(struct bsq_ctx *ctx, const struct fmt_tris_file *file, const struct vox_mesh *mesh,
                double enough, struct vox_distances *scan_to_mesh,
                struct vox_distances *mesh_to_scan);

#endif
