/* bake_arguments.h - reads the command line of bisque-bake. */
#ifndef BAKE_ARGUMENTS_H
#define BAKE_ARGUMENTS_H

#include "libbake/bake.h"
#include "tools/bake_transfers.h"
#include "tools/cli_tasks.h"

struct bake_arguments {
    struct bake_options bake;
    struct bake_transfers transfers;
    bool list_devices, list_tiles;
    struct cli_tasks farm;
    uint64_t given;          /* bit i: option CLI_TASKS_END + i */
    int bake_option;         /* the last option that is about the bake itself; 0: none */
    const char *task_device; /* --device, which tasks of a plan may have too; NULL: not given */
    char **files;            /* the inputs, as given */
    int file_count;
    char *suffixes;     /* of names to match, with a zero between them; NULL: not given */
    const char **paths; /* the inputs: scans, then low-poly meshes */
    int sample_option;  /* the option that chose bake.sample_type; 0: none */
};

enum { MOST_MAPS = BAKE_MAX_MAPS };

/* Reads the command line. Free *arguments with bake_arguments_free(), also after a failure. Returns
 * what cli_parse_options() returns. */
int bake_arguments_parse(struct cli *cli, struct bake_arguments *arguments, int argc, char **argv);
/* Returns whether a long option that is about the bake itself, such as "size", was given. */
bool bake_arguments_has(const struct bake_arguments *arguments, const char *name);
/* Finds out which of the inputs are scans (.nvdb, .tris) and which are low-poly meshes. Two files
 * are a scan and a mesh, in this order. Errors: BSQ_EUSAGE, and those of fmt_recognise(). */
int bake_arguments_sort_inputs(struct cli *cli, struct bake_arguments *arguments);
void bake_arguments_free(struct bake_arguments *arguments);

#endif
