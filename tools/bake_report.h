/* bake_report.h - prints the results of bisque-bake. */
#ifndef BAKE_REPORT_H
#define BAKE_REPORT_H

#include "tools/bake_arguments.h"

/* Lets the percentage of progress count the stages of a report, until it is called with NULL. */
void bake_report_watch(struct cli *cli, const struct bake_report *report);

/* Prints what was baked, as lines or as JSON, and warns of many misses or overlaps. */
int bake_report_print(struct cli *cli, const struct bake_arguments *arguments,
                      struct bake_report *report);

/* Prints what a part of a bake gave. */
int bake_report_print_part(struct cli *cli, const struct bake_arguments *arguments,
                           const struct bake_report *report);

/* Returns whether more samples missed than --max-missed allows, and says so on standard error. */
bool bake_report_too_many_missed(const struct cli *cli, const struct bake_arguments *arguments,
                                 const struct bake_report *report);

/* Notes the files of --reference, which no output may replace. */
int bake_report_note_references(struct cli *cli, const char *folder);

/* Prints the devices that can be used, as lines or as JSON. */
int bake_report_devices(struct cli *cli);

/* Prints the UDIM tiles of the low-poly mesh, as lines or as JSON. */
int bake_report_tiles(struct cli *cli, const struct bake_options *options);

#endif
