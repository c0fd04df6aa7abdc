/* tile_sort.h - sorts triangles into UDIM tiles; private to this folder. */
#ifndef BAKE_UDIM_TILE_SORT_H
#define BAKE_UDIM_TILE_SORT_H

#include "libbake/udim/udim.h"

/* Tile i of these has the number BAKE_FIRST_TILE + i. */
enum {
    COLUMNS = 10,
    ROWS = (BAKE_LAST_TILE - BAKE_FIRST_TILE + 1) / COLUMNS,
    TILES = COLUMNS * ROWS
};
_Static_assert(BAKE_FIRST_TILE + TILES - 1 == BAKE_LAST_TILE, "rows of tiles are whole");

/* A mesh, and what is known of its tiles. */
struct bake_tile_sorter {
    struct bsq_ctx *ctx;
    const struct bake_options *options;
    const struct bake_lowmesh *mesh;
    uint64_t begin, end; /* triangles of the mesh to sort */
    bool selected[TILES];
    uint32_t sizes[TILES][2];   /* width and height of each map in texels */
    uint64_t places[TILES];     /* number of triangles; while sorting, place of the next one */
    uint32_t *order;            /* out: triangles by tile; NULL: only count */
    uint64_t flat_triangles;    /* without area in texture space */
    uint64_t outside_triangles; /* partly or wholly outside of the selected tiles */
    uint64_t unused_triangles;  /* wholly outside of them */
    uint64_t stray_triangles;   /* partly or wholly outside of all tiles */
    uint64_t first_stray;
};

/* Creates a sorter of a set's triangles, which knows the tiles that options->tile_ranges selects,
 * and the sizes of all tiles. The options are checked. Free it with bsq_free(). */
int bake_tile_sorter_create(struct bsq_ctx *ctx, const struct bake_options *options,
                            const struct bake_lowmesh *mesh, uint32_t set,
                            struct bake_tile_sorter **out);

/* Counts the triangles of each tile, and all others. With an order, writes each triangle to the
 * place of each selected tile that it is in, those without area to `first_tile`, and those in no
 * selected tile to the places from *rest on, which it advances. Those without area go there too if
 * `first_tile` is TILES. */
int bake_tile_sort(struct bake_tile_sorter *sorter, uint32_t first_tile, uint64_t *rest);

#endif
