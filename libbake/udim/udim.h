/* udim.h - UDIM tiles, the unit squares of texture space that have maps of their own. Takes the
 * low-poly mesh and the bake's options; gives the tiles in use, with the triangles of each side by
 * side in the mesh.
 *
 * Each set of the mesh has tiles of its own. Tile 1001 + u + 10 v is the square from (u, v), u from
 * 0 to 9, v from 0 on. A triangle belongs to each tile that it overlaps by more than half a texel.
 */
#ifndef BAKE_UDIM_UDIM_H
#define BAKE_UDIM_UDIM_H

#include "libbake/bake.h"
#include "libbake/lowpoly/lowpoly.h"

struct bake_udim_tile {
    uint32_t number;
    uint32_t set;          /* of the mesh, 0 if it has none */
    uint64_t first, count; /* its triangles in the mesh, after bake_udim_arrange() */
};

struct bake_udim {
    struct bake_udim_tile *tiles; /* to bake, by set and number; at least one */
    uint32_t count;
    uint64_t capacity;
    uint64_t outside_triangles; /* partly or wholly outside of these tiles */
    uint64_t unused_triangles;  /* wholly outside; bake_udim_arrange() puts them last */
};

/* Finds the tiles to bake: those that triangles lie in, of which options->tiles selects some.
 * Triangles without area in texture space belong to the first tile of their set. A set of such
 * triangles only is in tile 1001. Free *out with bake_udim_free(). Errors: BSQ_EUSAGE if there are
 * several tiles and the output's name has no token for them, if triangles lie outside of all tiles
 * while no tiles are selected, or if no triangle is in a selected range or in a tile with a size of
 * its own; BSQ_ENOMEM, BSQ_EINTR. */
int bake_udim_find(struct bsq_ctx *ctx, const struct bake_options *options,
                   const struct bake_lowmesh *mesh, struct bake_udim *out);
void bake_udim_free(struct bsq_ctx *ctx, struct bake_udim *udim); /* zeroed: allowed */

/* Sorts the mesh's triangles by tile. A triangle in several tiles gets a copy for each. Texture
 * coordinates become relative to the tile. A mesh in tile 1001 alone stays as it is. Errors:
 * BSQ_EDATA for too many triangles, BSQ_ENOMEM, BSQ_EINTR. */
int bake_udim_arrange(struct bsq_ctx *ctx, const struct bake_options *options,
                      struct bake_udim *udim, struct bake_lowmesh *mesh);

/* Returns a tile's column u and row v. */
uint32_t bake_udim_column(uint32_t number);
uint32_t bake_udim_row(uint32_t number);

/* Finds the size of the maps of a tile in texels. */
void bake_tile_size_of(const struct bake_options *options, uint32_t tile, uint32_t *width,
                       uint32_t *height);

/* Returns the side of a mean texel of the tiles in world units, or 0 if charts have no area. */
double bake_udim_texel(const struct bake_options *options, const struct bake_lowmesh *mesh,
                       const struct bake_udim *udim);

/* ---- names of map files ---- */

/* Replace tokens of an output path: "<MAP>" by the name of a map; "<OBJECT>" and "<MATERIAL>" by
 * names, in which characters that could lead to another folder become '_' (NULL keeps a token);
 * "<UDIM>" and "<UVTILE>" for a tile. Return a path that the caller frees; NULL if there is no
 * memory. */
char *bake_map_path(const char *path, const char *name);
char *bake_object_path(const char *path, const char *object, const char *material);
char *bake_tile_path(const char *path, uint32_t tile);

#endif
