/* native.h - the kernel on native threads, compiled for several sets of instructions. All
 * of them give the same bits. */
#ifndef BAKE_DEVICE_NATIVE_NATIVE_H
#define BAKE_DEVICE_NATIVE_NATIVE_H

#include "libbake/device/device.h"

struct bk_grid;

/* The arrays of a mapped file as the kernel takes them; valid while it is open. */
void bake_native_grid(const struct fmt_nvdb_grid *grid, const struct bk_params *params,
                      struct bk_grid *out);

/* Texels are taken in squares of this side: what they share of the grid stays in the first cache.
 */
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

/* The code for 4, 8 or 16 lanes; NULL where this processor cannot run it. */
bake_native_tile *bake_native_code(unsigned lanes);

#endif
