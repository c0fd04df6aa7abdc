/* raster_index.h - the triangles of each tile; private to this folder. */
#ifndef BAKE_RASTER_RASTER_INDEX_H
#define BAKE_RASTER_RASTER_INDEX_H

#include "libbake/raster/raster.h"
#include "libbake/raster/raster_spans.h"

struct bake_raster {
    struct bsq_ctx *ctx;
    const struct bake_lowmesh *mesh;
    struct bake_raster_options options;
    struct sample_grid grid;
    uint32_t tile_columns, tile_rows;
    uint32_t tile_count;    /* tiles that a triangle overlaps */
    uint32_t *tile_numbers; /* of each of them: row * tile_columns + column */
    uint64_t *starts;       /* tile_count + 1; where the list of each begins in `triangles` */
    uint32_t *triangles;
};

/* Snaps a triangle of the mesh to the sample grid. Returns false if it can cover no sample. */
static inline bool raster_snap_triangle(const struct bake_raster *raster, uint64_t triangle,
                                        struct raster_triangle *out)
{
    return bake_raster_snap(&raster->grid, (const float(*)[2])raster->mesh->texcoords[triangle],
                            out) &&
           bake_raster_has_area(out);
}

#endif
