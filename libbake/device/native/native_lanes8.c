/* native_lanes8.c - the kernel eight samples at a time. The build compiles this file for AVX2;
 * native.c calls it where the processor has that. */
#if defined(__x86_64__)
#define BK_WIDTH    8
#define NATIVE_TILE bake_native_tile_8
#include "libbake/device/native/native_tile.h"
#else
typedef int native_lanes8_is_for_x86;
#endif
