/* names.c - see names.h. */
#include "base/xxh3.h"
#include "libbake/lowpoly/names.h"

#include <assert.h>
#include <string.h>

/* Returns the slot that holds the name, or the empty slot for it. */
static uint32_t *find_slot(const struct bake_name_table *table, const char *name)
{
    uint64_t i = XXH3_64bits(name, strlen(name)) & (table->slot_count - 1);
    for (;; i = (i + 1) & (table->slot_count - 1)) {
        uint32_t *slot = &table->slots[i];
        if (*slot == 0 || strcmp(table->names.list[*slot - 1], name) == 0)
            return slot;
    }
}

/* Keeps the table at most half full. */
static int make_slots(struct bsq_ctx *ctx, struct bake_name_table *table)
{
    if (table->slot_count > 2 * (uint64_t)table->names.count)
        return 0;
    const uint64_t slot_count = table->slot_count ? 4 * table->slot_count : 64;
    uint32_t *slots;
    int status = bsq_calloc(ctx, "names", slot_count, sizeof *slots, &slots);
    if (status < 0)
        return status;
    bsq_free(ctx, table->slots);
    table->slots = slots;
    table->slot_count = slot_count;
    for (uint32_t i = 0; i < table->names.count; i++)
        *find_slot(table, table->names.list[i]) = i + 1;
    return 0;
}

int bake_names_enter(struct bsq_ctx *ctx, struct bake_name_table *table, const char *name,
                     uint32_t *number)
{
    struct bake_names *names = &table->names;
    int status = make_slots(ctx, table);
    if (status < 0)
        return status;
    uint32_t *slot = find_slot(table, name);
    if (*slot == 0) {
        char *copy = NULL;
        if (names->count == UINT32_MAX / 2)
            return bsq_fail(ctx, BSQ_EDATA, "more than %u names of objects", UINT32_MAX / 2);
        status = bsq_grow(ctx, "names", names->count + UINT64_C(1), sizeof *names->list,
                          &names->list, &table->capacity);
        if (status == 0)
            status = bsq_alloc(ctx, "names", strlen(name) + 1, 1, &copy);
        if (status < 0)
            return status;
        assert(copy);
        names->list[names->count++] = strcpy(copy, name);
        *slot = names->count;
    }
    *number = *slot - 1;
    return 0;
}

void bake_name_table_free(struct bsq_ctx *ctx, struct bake_name_table *table)
{
    bsq_free(ctx, table->slots);
    table->slots = NULL;
    table->slot_count = 0;
}

void bake_names_free(struct bsq_ctx *ctx, struct bake_names *names)
{
    for (uint32_t i = 0; i < names->count; i++)
        bsq_free(ctx, names->list[i]);
    bsq_free(ctx, names->list);
    *names = (struct bake_names){0};
}
