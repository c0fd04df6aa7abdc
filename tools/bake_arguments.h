/* bake_arguments.h - what the command line of bisque-bake says. */
#ifndef BAKE_ARGUMENTS_H
#define BAKE_ARGUMENTS_H

#include "libbake/bake.h"
#include "tools/cli.h"

struct bake_arguments {
    struct bake_options bake;
    bool list_devices;
    char **files; /* to verify */
    int file_count;
    int sample_option; /* that chose bake.sample_type; 0: none did */
};

/* Bits of bake_options.maps. */
enum { MOST_MAPS = 32 };

/* Reads the command line. Returns as cli_parse_options() does. */
int bake_arguments_parse(struct cli *cli, struct bake_arguments *arguments, int argc, char **argv);

#endif
