/* page.c - see page.h. */
#include "tools/page.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* Returns a list of all options of the help: name and value; null for values that the program took
 * apart. */
static json_t *options_json(const struct cli_table *table)
{
    json_t *list = json_array();
    for (const struct bsq_option *row = table->rows; row < table->rows + table->count; row++) {
        char name[CLI_TEXT], text[BSQ_OPTION_TEXT_BYTES];
        if (!row->name || !row->help)
            continue;
        snprintf(name, sizeof name, "--%s%s%s", row->name, row->key ? " " : "",
                 row->key ? row->key : "");
        cli_json_append(
            &list,
            json_pack("[s, o]", name, cli_json_text(bsq_option_text(row, table->options, text))));
    }
    return list;
}

int page_end(struct cli *cli, struct bake_page *page, json_t *root, const struct cli_table *options)
{
    json_t *all = cli_complete_json(cli, root);
    cli_json_set(&all, "command", json_incref(cli->command));
    cli_json_set(&all, "warnings", json_incref(cli->warnings));
    cli_json_set(&all, "options", options_json(options));
    char *text = all ? json_dumps(all, JSON_ENSURE_ASCII | JSON_REAL_PRECISION(15)) : NULL;
    const int status = text ? bake_page_finish(page, text)
                            : bsq_fail(cli->ctx, BSQ_ENOMEM, "out of memory for the report");
    free(text);
    json_decref(all);
    return status;
}

/* ---- comparisons ---- */

const char *page_kind_name(enum bake_compare_kind kind)
{
    static const char *const names[] = {"auto", "normal", "color", "data"};
    return names[kind];
}

/* JSON has no infinite numbers: they become null. */
static json_t *number_json(double value)
{
    return isfinite(value) ? json_real(value) : json_null();
}

json_t *page_comparison_json(const struct bake_compare_options *options,
                             const struct bake_compare_report *report)
{
    json_t *root = json_pack(
        "{s:o, s:o, s:s, s:s, s:i, s:i, s:I, s:I, s:I, s:I, s:I, s:I, s:f, s:o, s:o, s:o, s:o,"
        " s:o, s:o, s:f, s:i, s:i, s:f, s:f}",
        "a_path", cli_json_text(options->a_path), "b_path", cli_json_text(options->b_path), "type",
        page_kind_name(report->kind), "unit", bake_compare_unit(report->kind), "width",
        (int)report->width, "height", (int)report->height, CLI_COUNT(report, compared),
        CLI_COUNT(report, not_finite), CLI_COUNT(report, not_finite_a),
        CLI_COUNT(report, not_finite_b), CLI_COUNT(report, only_a), CLI_COUNT(report, only_b),
        CLI_VALUE(report, agreement), "mean", number_json(report->mean), "rms",
        number_json(report->rms), "median", number_json(report->median), "p95",
        number_json(report->p95), "p99", number_json(report->p99), "max", number_json(report->max),
        CLI_VALUE(report, scale), "max_x", (int)report->max_x, "max_y", (int)report->max_y,
        "share_above_1", report->above_1, "share_above_5", report->above_5);
    if (root && report->kind == BAKE_COMPARE_COLOR)
        json_object_set_new(root, "psnr", number_json(report->psnr));
    if (root && report->kind == BAKE_COMPARE_DATA) {
        json_object_set_new(root, "relative_mean", number_json(report->relative_mean));
        json_object_set_new(root, "relative_max", number_json(report->relative_max));
    }
    return root;
}
