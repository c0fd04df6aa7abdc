/* raster_index.h - what a raster keeps; shared by the files that make, fill and export it.
 */
#ifndef BAKE_RASTER_RASTER_INDEX_H
#define BAKE_RASTER_RASTER_INDEX_H

#include "libbake/raster/raster.h"
#include "libbake/raster/raster_spans.h"

struct bake_raster {
    struct bsq_ctx *ctx;
    const struct bake_lowmesh *mesh;
    struct bake_raster_options options;
    struct raster_lattice lattice;
    uint32_t tile_columns, tile_rows;
    uint32_t tile_count;    /* of tiles that a triangle touches */
    uint32_t *tile_numbers; /* their places: row * tile_columns + column */
    uint64_t *starts;       /* of their lists in `triangles`; tile_count + 1 of them */
    uint32_t *triangles;
};

/* Snaps a triangle of the mesh; false where it can cover no sample. */
static inline bool raster_snap_triangle(const struct bake_raster *raster, uint64_t triangle,
                                        struct raster_triangle *out)
{
    return bake_raster_snap(&raster->lattice, (const float(*)[2])raster->mesh->texcoords[triangle],
                            out) &&
           bake_raster_has_area(out);
}

#endif
