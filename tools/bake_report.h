/* bake_report.h - prints the results of bisque-bake. */
#ifndef BAKE_REPORT_H
#define BAKE_REPORT_H

#include "tools/bake_arguments.h"

/* Files of maps are in arrays: MOST_MAPS entries in the order of bake_map_name(), then one for each
 * transfer map. Return the number of entries, and the name of a map that is baked. */
uint32_t bake_path_count(const struct bake_options *bake);
const char *bake_path_name(const struct bake_options *bake, unsigned number);

/* Lets the percentage of progress count the stages of a report, until it is called with NULL. */
void bake_report_watch(struct cli *cli, const struct bake_report *report);

/* Prints what was baked, as lines or as JSON, and warns of many misses or overlaps. paths: the file
 * of each map, with the tokens of tiles; NULL: not baked. */
int bake_report_print(struct cli *cli, const struct bake_arguments *arguments,
                      const struct bake_report *report, char *const *paths);

/* Returns whether more samples missed than --max-missed allows, and says so on standard error. */
bool bake_report_too_many_missed(const struct cli *cli, const struct bake_arguments *arguments,
                                 const struct bake_report *report);

/* Prints the devices that can be used, as lines or as JSON. */
int bake_report_devices(struct cli *cli);

/* Prints the UDIM tiles of the low-poly mesh, as lines or as JSON. */
int bake_report_tiles(struct cli *cli, const struct bake_options *options);

#endif
