/* raster.h - rasterises the charts of a low-poly mesh. Takes its triangles in texture space; gives,
 * patch by patch, the triangle that each sample of the map lies in, and the triangles as the kernel
 * reads them. */
#ifndef BAKE_RASTER_RASTER_H
#define BAKE_RASTER_RASTER_H

#include "formats/texture/texture.h"
#include "libbake/kernel/bk_types.h"
#include "libbake/lowpoly/lowpoly.h"

/* Blocks of a map, squares of texels in row order, of which a job bakes some. Those at the right
 * and lower border may be smaller. */
struct bake_blocks {
    uint32_t side; /* texels; sides of patches divide it */
    uint32_t columns, rows;
    uint32_t count;         /* blocks to bake */
    const uint32_t *places; /* for each block: its number among those to bake, or BAKE_NO_PLACE */
};
#define BAKE_NO_PLACE UINT32_MAX

/* Converts the place of a texel in the map to the place in an image that holds the blocks to bake
 * one below the other. The texel must lie in such a block. */
void bake_blocks_to_image(const struct bake_blocks *blocks, uint32_t *x, uint32_t *y);

/* The triangles of a mesh in texture space, indexed by patch. */
struct bake_raster;

struct bake_raster_options {
    uint32_t width, height; /* of the map in texels */
    uint32_t samples;       /* N, for N x N samples a texel */
    uint32_t patch_side; /* side in texels; patches at the right and lower border may be smaller */
    uint64_t first, count; /* triangles of the mesh to rasterise */
    const struct bake_blocks
        *blocks; /* makes patches in these blocks only; NULL: in all of the map */
    /* Grey images in the texture space of tiles, which turn rays: white is 1, along the normal of
     * the triangle. NULL: there are none. skew_number: of the tile's. */
    struct fmt_textures *skew;
    uint32_t skew_number;
};

struct bake_raster_report {
    uint64_t degenerate_triangles; /* without area in texture space */
};

/* Sorts triangles into patches, in time linear in the triangles and the patches that they overlap.
 * mesh and options->blocks must outlive *out; free *out with bake_raster_free(). Errors: BSQ_EUSAGE
 * for a map that is empty or too large, BSQ_EDATA for too many triangles, BSQ_ENOMEM, BSQ_EINTR. */
int bake_raster_create(struct bsq_ctx *ctx, const struct bake_lowmesh *mesh,
                       const struct bake_raster_options *options, struct bake_raster_report *report,
                       struct bake_raster **out);
void bake_raster_free(struct bake_raster *raster); /* NULL is allowed */

/* Return the number of patches, and the place of a patch in texels. Patches are in row order,
 * without those that no triangle overlaps and those outside of options->blocks. */
uint32_t bake_raster_patch_count(const struct bake_raster *raster);
struct bk_patch bake_raster_patch(const struct bake_raster *raster, uint32_t index);

/* Returns the entries that bake_raster_fill() writes for a texel. */
static inline uint64_t bake_raster_texel_entries(const struct bk_params *params)
{
    return (uint64_t)params->samples * params->samples * (params->flags & BK_SKEW ? 2 : 1);
}

/* Writes the triangle of each sample of a patch, or BK_NO_TRIANGLE: height * N rows of width * N
 * entries. With a skew map, the skews follow as struct bk_patch has them; they are 0 without a
 * triangle. If triangles overlap, the first one in the mesh takes the sample; *overlaps is set to
 * the number of samples inside more than one triangle. A sample on an edge that two triangles share
 * belongs to exactly one of them (top-left rule on exact fixed-point coordinates). Thread-safe.
 * Errors: BSQ_EINTR, and those of fmt_texture_sample(). */
int bake_raster_fill(const struct bake_raster *raster, uint32_t index, uint32_t *sample_triangles,
                     uint64_t *overlaps);

/* Writes the rasterised triangles in the kernel's form, with positions (world - translation) /
 * voxel_size, to their entries of `out`, which has one for each triangle of the mesh. Triangles
 * without area in texture space, to which no sample refers, are zeroed. */
void bake_raster_kernel_triangles(const struct bake_raster *raster, const double translation[3],
                                  double voxel_size, struct bk_triangle *out);

#endif
