/* bake_transfers.h - transfer maps and their textures on the command line of bisque-bake. */
#ifndef BAKE_TRANSFERS_H
#define BAKE_TRANSFERS_H

#include "libbake/bake.h"
#include "tools/cli.h"

/* What the options name. All zero at first; free it with bake_transfers_free(). */
struct bake_transfers {
    struct bake_transfer *maps;     /* of --maps transfer:NAME; the names are owned */
    struct bake_transfer *textures; /* of --texture NAME=FILE; likewise */
    uint32_t map_count, texture_count;
    bool mask_opacity; /* the mask is multiplied by the scan's opacity */
};

/* Returns the name in a word "transfer:NAME" of --maps; NULL if it is another word. */
const char *bake_transfer_name(const char *word);
/* Adds a transfer map. */
int bake_add_transfer(struct cli *cli, struct bake_transfers *transfers, const char *name);
/* Adds a transfer map for each channel of the options' scans that has none yet, also to the
 * options.
 */
int bake_add_channels(struct cli *cli, struct bake_transfers *transfers,
                      struct bake_options *options);
/* Parses "NAME=FILE". The file's name must live as long as *transfers. */
int bake_parse_texture(struct cli *cli, struct bake_transfers *transfers, const char *text);
/* Gives the maps their textures, and the options the maps. */
int bake_use_transfers(struct cli *cli, struct bake_transfers *transfers,
                       struct bake_options *options);
void bake_transfers_free(struct bake_transfers *transfers);

#endif
