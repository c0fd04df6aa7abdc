/* farm_options.h - the options of a bake as JSON, and the paths in a plan; private to this room. */
#ifndef BAKE_FARM_FARM_OPTIONS_H
#define BAKE_FARM_FARM_OPTIONS_H

#include <jansson.h>

#include "libbake/farm/farm.h"

/* Returns the options as a JSON object; paths are relative to the plan's directory where possible.
 * NULL if there is no memory. */
json_t *bake_farm_options_to_json(const struct bake_options *options, const char *plan_path);

/* Reads such an object. Free what *out points to with bake_farm_options_free(), also after a
 * failure. Errors: BSQ_EDATA. */
int bake_farm_options_from_json(struct bsq_ctx *ctx, const char *plan_path, const json_t *json,
                                struct bake_options *out);
void bake_farm_options_free(struct bake_options *options);

/* Returns how a plan names a file: a path below the plan's directory, and one that was given
 * relative to the current directory, becomes relative to the plan's directory; others stay as they
 * are. The caller frees it. NULL if there is no memory. */
char *bake_farm_path_in_plan(const char *plan_path, const char *path);

/* Returns the path that a name in a plan stands for. Rules for paths (base/path_map.h) apply to
 * absolute ones. The caller frees it. NULL if there is no
 * memory. */
char *bake_farm_path_from_plan(struct bsq_ctx *ctx, const char *plan_path, const char *name);

#endif
