/* bake_unused.h - warns of options that a bake does not use. */
#ifndef BAKE_UNUSED_H
#define BAKE_UNUSED_H

#include "tools/bake_arguments.h"

/* Warns of each option that was given and has no effect on the maps of this bake, and names what it
 * needs. Call it when bake_find_maps() has set the maps. Errors: those of bake_inspect_scan(). */
int bake_warn_unused(struct cli *cli, const struct bake_arguments *arguments);

#endif
