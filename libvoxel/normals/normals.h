/* normals.h - the public header of this folder: makes the vertex normals of a chunk file.
 *
 * Takes chunks; gives the section of normals of their file (formats/FORMATS.md). */
#ifndef VOX_NORMALS_NORMALS_H
#define VOX_NORMALS_NORMALS_H

#include "formats/chunks/tris.h"

/* Writes the normals of all chunks after the last one, by base/geometry/smooth_normals.h, as if the
 * scan were one mesh: vertices at the same position are one. Only a vertex around which the
 * triangles of its chunk are closed is not looked for in other chunks. weights: AREA, ANGLE or MAX.
 * beside: an output path, next to which temporary files may be. The bytes do not depend on memory
 * and threads. Errors: those of fmt_tris_load(); BSQ_ENOMEM, BSQ_ECANTCREAT, BSQ_EIO, BSQ_EINTR. */
int vox_write_normals(struct bsq_ctx *ctx, struct fmt_tris_writer *writer,
                      enum bsq_scan_normals weights, const char *beside);

#endif
