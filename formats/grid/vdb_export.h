/* vdb_export.h - exports a grid as an OpenVDB file for Blender, Houdini and others: a mask grid
 * "surface", a Vec3f grid "N" (unit normals) and, where the grid has colour, a Vec3f grid "Cd"
 * (linear RGB). C++ shim over OpenVDB. */
#ifndef FMT_GRID_VDB_EXPORT_H
#define FMT_GRID_VDB_EXPORT_H

#include "formats/grid/nvdb.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Writes `path` (whole or not at all). OpenVDB holds all grids in memory, about 13 KiB for each
 * 8x8x8 leaf (half of that without colour); that is reserved from the budget, and BSQ_ENOMEM says
 * how much is needed. The normal and colour of a voxel are those of its first record. The same grid
 * gives the same bytes. */
int fmt_vdb_export(struct bsq_ctx *ctx, const struct fmt_nvdb_grid *grid, const char *path);

/* 0 where exporting is possible, else the status and error of what is missing. */
int fmt_vdb_check(struct bsq_ctx *ctx);

#ifdef __cplusplus
}
#endif
#endif
