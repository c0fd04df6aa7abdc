/* page.h - the pages of --report. */
#ifndef PAGE_H
#define PAGE_H

#include "libbake/compare.h"
#include "libbake/bake.h"
#include "tools/cli.h"

/* Completes a page with what the program prints as JSON, the command, the options and the warnings.
 * Takes over `root`; NULL means that there was no memory for it. */
int page_end(struct cli *cli, struct bake_page *page, json_t *root,
             const struct cli_table *options);

/* Returns the word for what maps were compared as. */
const char *page_kind_name(enum bake_compare_kind kind);

/* Returns a comparison as JSON, also for the page; NULL: no memory. */
json_t *page_comparison_json(const struct bake_compare_options *options,
                             const struct bake_compare_report *report);

#endif
