/* smooth_normals.h - vertex normals for scans that have none. */
#ifndef VOX_SMOOTH_NORMALS_H
#define VOX_SMOOTH_NORMALS_H

#include "formats/tris.h"

struct vox_smooth;

/* Bytes that a vox_smooth takes from the budget for this file. */
uint64_t vox_smooth_bytes(const struct fmt_tris_file *file);

/* The file must outlive *out. */
int vox_smooth_create(struct bsq_ctx *ctx, const struct fmt_tris_file *file,
                      struct vox_smooth **out);
void vox_smooth_destroy(struct vox_smooth *smooth); /* NULL is allowed */

/* Area-weighted smooth normals of a chunk's vertices as if the scan were whole: vertices at the same position are
 * one, whichever chunk they are in. `chunk` is number `index`, decoded; `normals` has one entry a
 * vertex: unit length, or zero at creases (see FMT_TRIS_CREASE_SHARE). The sums run in the order of triangles in
 * the file, so the result does not depend on who asks when. Thread-safe; calls wait for each other. */
int vox_smooth_normals(struct vox_smooth *smooth, uint64_t index,
                       const struct fmt_tris_chunk *chunk, float (*normals)[3]);

#endif
