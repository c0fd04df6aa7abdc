/* groups.h - from the chunks of a scan to a mesh that fits in memory.
 *
 * Neighbouring chunks form groups. Each group is a mesh whose edges collapse while the vertices of
 * its border stay, so that it still fits its neighbours. The results form groups again, whose inner
 * borders are free now, until few enough triangles are left. */
#ifndef VOX_SIMPLIFY_GROUPS_H
#define VOX_SIMPLIFY_GROUPS_H

#include "formats/chunks/tris.h"
#include "libvoxel/simplify/mesh.h"

/* Makes a welded mesh of about `target` triangles, or of all triangles of the scan if it has no
 * more. Groups and results depend on the scan and the target alone, not on memory or threads.
 * `beside`: an output, for temporary files. materials: the mesh has them, those of equal names as
 * the first of these, and vertices between them stay. The caller frees *mesh. Errors: BSQ_ENOMEM,
 * BSQ_EIO, BSQ_EDATA, BSQ_EINTR. */
int vox_reduce_chunks(struct bsq_ctx *ctx, const struct fmt_tris_file *file, uint64_t target,
                      const char *beside, bool materials, struct vox_mesh *mesh);

#endif
