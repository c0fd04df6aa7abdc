/* farm_options.h - the options of a bake as JSON; private to this folder. */
#ifndef BAKE_FARM_FARM_OPTIONS_H
#define BAKE_FARM_FARM_OPTIONS_H

#include "libbake/farm/farm.h"

/* Returns the options as a JSON object; paths are relative to the plan's directory where possible.
 * NULL if there is no memory. */
json_t *bake_farm_options_to_json(const struct bake_options *options, const char *plan_path);

/* Reads such an object. Free what *out points to with bake_farm_options_free(), also after a
 * failure. Errors: BSQ_EDATA. */
int bake_farm_options_from_json(struct bsq_ctx *ctx, const char *plan_path, const json_t *json,
                                struct bake_options *out);
void bake_farm_options_free(struct bake_options *options);

#endif
