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

/* Names of maps, in the order of outputs and reports. */
enum { BAKE_MAP_KINDS = 3 };
extern const struct bake_map_name {
    enum bake_map map;
    const char *name;
} bake_map_names[BAKE_MAP_KINDS];

/* All that can be checked without looking at a file. Returns as cli_parse_options() does. */
int bake_arguments_parse(struct cli *cli, struct bake_arguments *arguments, int argc, char **argv);

#endif
