/* native_lanes16.c - the kernel sixteen samples at a time. The build compiles this file for
 * AVX-512; native.c calls it where the processor has that. */
#if defined(__x86_64__)
#define BK_WIDTH    16
#define NATIVE_TILE bake_native_tile_16
#include "libbake/device/native/native_tile.h"
#else
typedef int native_lanes16_is_for_x86;
#endif
