/* float_precision.h - private: what 32-bit positions lose of a scan, and warnings where that is
 * detail. */
#ifndef VOX_FLOAT_PRECISION_H
#define VOX_FLOAT_PRECISION_H

#include "formats/chunks/tris.h"

/* Distance between neighbouring float32 numbers at the largest coordinate of these bounds. */
double vox_precision_spacing(const float min[3], const float max[3]);

/* Origin for a scan of which a part has these bounds, on each axis: 0 for ordinary scans, whose
 * part may be a small patch anywhere; near the bounds' centre where that is 8192 or more and 64
 * times their half size away from 0, as in geo-referenced scans. Then it is a multiple of a power
 * of two, so that it is subtracted exactly. */
void vox_precision_choose_origin(const double min[3], const double max[3], double origin[3]);

/* Number of vertices that differ from the one before in the file and do not once stored. */
uint64_t vox_precision_count_merged(const double (*positions)[3], uint64_t count,
                                    const double origin[3]);

/* Warns where vertices were merged. bounds: of the stored positions. */
void vox_precision_warn_merged(struct bsq_ctx *ctx, const char *path, uint64_t merged,
                               const float min[3], const float max[3]);

/* Warns where voxels of edge h, or most of the triangles, are so small that rounded positions bend
 * their normals. */
void vox_precision_warn_grid(struct bsq_ctx *ctx, const char *path,
                             const struct fmt_tris_header *header,
                             const struct fmt_tris_chunk_info *chunks, double h);

#endif
