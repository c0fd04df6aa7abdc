/* bake_tiles.h - reads sizes and UDIM tiles from the command line of bisque-bake. */
#ifndef BAKE_TILES_H
#define BAKE_TILES_H

#include "libbake/bake.h"
#include "tools/cli.h"

/* Parses "2048", "4096x2048" or "1001=4096,1002=512x256,*=2048", where * stands for all other
 * tiles. Free options->tile_sizes with free(). */
int bake_parse_sizes(struct cli *cli, const char *text, struct bake_options *options);

/* Parses "1001-1003,1011". Free options->tile_ranges with free(). */
int bake_parse_tiles(struct cli *cli, const char *text, struct bake_options *options);

#endif
