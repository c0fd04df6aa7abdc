/* bake_arguments.h - reads the command line of bisque-bake. */
#ifndef BAKE_ARGUMENTS_H
#define BAKE_ARGUMENTS_H

#include "libbake/bake.h"
#include "tools/cli.h"

/* A list of transfer maps. */
struct bake_transfers {
    struct bake_transfer *maps;
    uint32_t count;
};

struct bake_arguments {
    struct bake_options bake;
    bool given[BAKE_MOST_OPTION_ROWS]; /* by rows of bake_option_rows() */
    struct bake_transfers transfers;
    struct bake_transfers textures; /* of --texture NAME=FILE */
    struct bake_pack *packs;
    const char *channels;   /* of the scans, for presets: ",roughness,metallic," */
    const char *new_folder; /* a folder that was made, and goes if it stays empty; or NULL */
    bool mask_opacity;      /* the mask is multiplied by the scan's opacity */
    bool list_devices, list_tiles;
    char **files; /* the inputs, as given */
    int file_count;
    const char **paths; /* the inputs: scans, then low-poly meshes */
};

/* Reads the command line. Returns what cli_parse() returns. */
int bake_arguments_parse(struct cli *cli, struct bake_arguments *arguments, int argc, char **argv);
/* Finds out which of the inputs are scans (.nvdb, .tris) and which are low-poly meshes. Two files
 * are a scan and a mesh, in this order. Errors: BSQ_EUSAGE, and those of fmt_recognise(). */
int bake_arguments_sort_inputs(struct cli *cli, struct bake_arguments *arguments);
/* Returns the table of the bake's options, with the arguments' values. */
struct cli_table bake_arguments_table(const struct bake_arguments *arguments);
/* Completes the options by what the scans have, see bake_inspect(). */
int bake_arguments_complete(struct cli *cli, struct bake_arguments *arguments);

/* ---- parts of these, for bake_arguments.c ---- */

/* Takes the value of --maps, --pack or --texture. arg: the arguments. */
int bake_maps_take(struct cli *cli, void *arg, const struct bsq_option *row, const char *text);
/* Completes the maps when all options are read. */
int bake_maps_finish(struct cli *cli, struct bake_arguments *arguments);
/* Prints the list of maps for --help. */
void bake_maps_print(void);

#endif
