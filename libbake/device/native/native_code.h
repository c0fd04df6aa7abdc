/* native_code.h - the kernel compiled for several instruction sets; all give the same bits. */
#ifndef BAKE_DEVICE_NATIVE_NATIVE_CODE_H
#define BAKE_DEVICE_NATIVE_NATIVE_CODE_H

#include "libbake/device/job/job.h"

/* Side in texels of the squares that a tile is traced in: what they share of the grid stays in the
 * first-level cache. */
enum { BAKE_NATIVE_SQUARE = 8 };

/* Traces a tile on the calling thread: sample_triangles in, width * height texels out. */
typedef void bake_native_tile(const struct bk_grid *grid, const struct bk_params *params,
                              const struct bk_triangle *triangles, const struct bk_tile *tile,
                              const uint32_t *sample_triangles, struct bk_texel *texels);

bake_native_tile bake_native_tile_4; /* four lanes, for any processor */
#if defined(__x86_64__)
bake_native_tile bake_native_tile_8;  /* eight lanes, AVX2 */
bake_native_tile bake_native_tile_16; /* sixteen lanes, AVX-512 */
#endif

/* Returns the code for 4, 8 or 16 lanes; NULL if this processor cannot run it. */
bake_native_tile *bake_native_code(unsigned lanes);

#endif
