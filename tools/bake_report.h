/* bake_report.h - what bisque-bake prints. */
#ifndef BAKE_REPORT_H
#define BAKE_REPORT_H

#include "tools/bake_arguments.h"

/* What was baked, as lines or as JSON, and a warning where many rays missed. `paths`
 * has the file of each map, in the order of bake_map_name(); NULL: the map was not baked. */
int bake_report_print(struct cli *cli, const struct bake_arguments *arguments,
                      const struct bake_report *report, char *const *paths);

/* The devices that can be used. */
int bake_report_devices(struct cli *cli);

#endif
