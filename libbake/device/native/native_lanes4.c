/* native_lanes4.c - the kernel four samples at a time, for any processor. */
#define BK_WIDTH    4
#define NATIVE_TILE bake_native_tile_4
#include "libbake/device/native/native_tile.h"
