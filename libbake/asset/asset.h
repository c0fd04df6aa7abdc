/* asset.h - the low-poly mesh and its maps in one file that viewers and engines open.
 *
 * Takes the mesh as baked and, band by band, the rows of its maps; gives a GLB file. Normals and
 * tangents are those that the maps were baked with. Its images are 8-bit PNG: the base colour from
 * `color`, with the transfer map `opacity` as its alpha; the normal texture from `normal`; the
 * emissive texture from the transfer map `emission`; and one image with the transfer maps
 * `occlusion`, or else `ao`, `roughness` and `metallic`. They wait in temporary files. */
#ifndef BAKE_ASSET_ASSET_H
#define BAKE_ASSET_ASSET_H

#include "libbake/lowpoly/lowpoly.h"
#include "libbake/maps/maps.h"
#include "libbake/udim/udim.h"

struct bake_asset;

enum { BAKE_ASSET_IMAGES = 4 }; /* most images of a tile */

/* Creates the file under a temporary name, for the maps of `tiles` UDIM tiles. Errors: BSQ_EUSAGE
 * for normals in object space, BSQ_ECANTCREAT, BSQ_ENOMEM. */
int bake_asset_open(struct bsq_ctx *ctx, const struct bake_options *options, uint32_t tiles,
                    struct bake_asset **out);
/* Begins the images of a tile, whose files will give them their rows, and completes them when the
 * files are written. options: those of the tile; image: its values. */
int bake_asset_begin_tile(struct bake_asset *asset, uint32_t tile,
                          const struct bake_options *options, uint32_t maps,
                          struct bake_image *image, struct bake_map_files *files);
int bake_asset_end_tile(struct bake_asset *asset, uint32_t tile);
/* Writes the file. The mesh is as bake_udim_arrange() left it. Errors: BSQ_EDATA for a file of
 * 4 GiB or too many vertices, BSQ_EIO, BSQ_ENOMEM, BSQ_EINTR. */
int bake_asset_write(struct bake_asset *asset, const struct bake_lowmesh *mesh,
                     const struct bake_udim *udim);
/* Frees the asset. *out: the complete output, for the caller to commit. */
void bake_asset_hand_over(struct bake_asset *asset, struct bsq_output **out);
void bake_asset_discard(struct bake_asset *asset); /* NULL is allowed */

#endif
