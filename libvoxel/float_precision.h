/* float_precision.h - chooses the origin of 32-bit positions, and warns if rounding them loses
 * detail. */
#ifndef VOX_FLOAT_PRECISION_H
#define VOX_FLOAT_PRECISION_H

#include "formats/chunks/tris.h"

/* Chooses the origin from the bounds of a part of a scan, for each axis. It is 0 in ordinary scans,
 * whose part may be any small patch. In geo-referenced scans it is near the bounds' centre: if that
 * is at least 8192, and 64 times their half size, away from 0. Such an origin is a multiple of a
 * power of two, so that it is subtracted exactly. */
void vox_precision_choose_origin(const double min[3], const double max[3], double origin[3]);

/* Returns how many vertices differ from the previous vertex in the file, but not as float32. */
uint64_t vox_precision_count_merged(const double (*positions)[3], uint64_t count,
                                    const double origin[3]);

/* Warns if vertices were merged. min, max: bounds of the stored positions. */
int vox_precision_warn_merged(struct bsq_ctx *ctx, const char *path, uint64_t merged,
                              const float min[3], const float max[3]);

/* Warns if voxels of edge h, or most triangles, are so small that rounding tilts their normals. */
void vox_precision_warn_grid(struct bsq_ctx *ctx, const char *path,
                             const struct fmt_tris_header *header,
                             const struct fmt_tris_chunk_info *chunks, double h);

#endif
