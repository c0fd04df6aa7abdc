/* farm_json.h - structures with tables of rows as JSON; private to this folder. */
#ifndef BAKE_FARM_FARM_JSON_H
#define BAKE_FARM_FARM_JSON_H

#include <jansson.h>

#include "base/options.h"

/* Where structures are written to or read from. */
struct bake_farm_names {
    struct bsq_ctx *ctx;
    const char *plan_path; /* names of files are relative to its directory where possible */
    bool failed;           /* a text was not UTF-8, as JSON must be: this is reported */
};

/* A structure, or some of its members. */
struct bake_farm_table {
    const struct bsq_option *rows;
    size_t count;
};
#define BAKE_FARM_TABLE(rows)                                                                      \
    (struct bake_farm_table)                                                                       \
    {                                                                                              \
        rows, sizeof rows / sizeof *rows                                                           \
    }

/* Returns a structure as a JSON object; NULL if there is no memory, or after names->failed. */
json_t *bake_farm_to_json(struct bake_farm_names *names, struct bake_farm_table table,
                          const void *from);

/* Reads such an object into a structure of zeros. Free it with bake_farm_clear(), also after a
 * failure. Errors: BSQ_EDATA, BSQ_ENOMEM. */
int bake_farm_from_json(const struct bake_farm_names *names, struct bake_farm_table table,
                        const json_t *json, void *to);

/* Frees the texts and lists that a structure has. */
void bake_farm_clear(struct bsq_ctx *ctx, struct bake_farm_table table, void *of);

#endif
