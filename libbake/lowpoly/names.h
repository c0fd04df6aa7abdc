/* names.h - numbers for distinct names; private to this folder. */
#ifndef BAKE_LOWPOLY_NAMES_H
#define BAKE_LOWPOLY_NAMES_H

#include "libbake/lowpoly/lowpoly.h"

/* Names in order of first appearance. All zero at first. */
struct bake_name_table {
    struct bake_names names;
    uint64_t capacity;
    uint32_t *slots; /* open-addressing hash table of number + 1 */
    uint64_t slot_count;
};

/* Sets *number to the number of a name; enters it if it is new. Errors: BSQ_ENOMEM, BSQ_EDATA. */
int bake_names_enter(struct bsq_ctx *ctx, struct bake_name_table *table, const char *name,
                     uint32_t *number);

/* Frees the table but not the names. */
void bake_name_table_free(struct bsq_ctx *ctx, struct bake_name_table *table);
void bake_names_free(struct bsq_ctx *ctx, struct bake_names *names);

#endif
