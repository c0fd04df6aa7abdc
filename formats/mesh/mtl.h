/* mtl.h - reads the diffuse colour (Kd), its texture (map_Kd) and further channels of each material
 * of Wavefront MTL files; private to the OBJ reader. */
#ifndef FMT_MESH_MTL_H
#define FMT_MESH_MTL_H

#include "formats/mesh/mesh_reader.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Appends the materials of one MTL file. A file that does not exist, or is empty or not a regular
 * file, is a warning, not an error, as scans are often passed on without it. Malformed statements
 * are warnings. place: "scan.obj:1", the line that names the file, for its warnings. again: the
 * file was read before, so there are no warnings. Errors: BSQ_EDATA for a warning in a strict job;
 * those of bsq_file_open(). */
int fmt_mtl_read(struct bsq_ctx *ctx, const char *path, const char *place, bool again,
                 struct fmt_materials *materials);

#ifdef __cplusplus
}
#endif
#endif
