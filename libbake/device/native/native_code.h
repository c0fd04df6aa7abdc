/* native_code.h - the kernel compiled for several instruction sets; all give the same bits. */
#ifndef BAKE_DEVICE_NATIVE_NATIVE_CODE_H
#define BAKE_DEVICE_NATIVE_NATIVE_CODE_H

#include "base/simd/simd.h"
#include "libbake/device/scene/scene.h"
#include "libbake/ray/ray.h"

/* Side in texels of the squares that a patch is traced in: what they share of the grid stays in the
 * first-level cache. */
enum { BAKE_NATIVE_SQUARE = 8 };

struct bake_tree;
struct bake_tree_stream;

/* What secondary rays go through; all NULL: there are none. */
struct bake_native_memory {
    const struct bake_tree *tree;
    struct bake_tree_stream *stream;
    float *results; /* of the rays of BAKE_NATIVE_HITS hits */
};

enum { BAKE_NATIVE_HITS = 16 }; /* the largest BK_WIDTH of any instruction set */

/* Traces rows first_row to end_row - 1 of a patch on the calling thread, as the kernel does on
 * other devices. sample_triangles and texels hold the whole patch, which has width * height texels
 * of bk_texel_floats(params->maps) floats. */
typedef void bake_native_patch_fn(const struct bk_grid *grid, const struct bk_params *params,
                                  const struct bk_triangle *triangles, const struct bk_patch *patch,
                                  uint32_t first_row, uint32_t end_row,
                                  const uint32_t *sample_triangles,
                                  const struct bake_native_memory *memory, float *texels);
BSQ_SIMD_DECLARE(bake_native_patch_fn, bake_native_patch);

/* Does what bake_trace_rays() does. */
typedef void bake_native_rays_fn(const struct bk_grid *grid, const struct bk_params *params,
                                 double unit, const struct bake_ray_batch *batch, uint64_t begin,
                                 uint64_t end);
BSQ_SIMD_DECLARE(bake_native_rays_fn, bake_native_rays);

#endif
