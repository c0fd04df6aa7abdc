/* text_table.c - see text_table.h. */
#include <errno.h>
#include <assert.h>
#include <stdlib.h>
#include <string.h>

#include "base/text_table.h"

int bsq_text_copy(struct bsq_ctx *ctx, const char *text, char **out)
{
    *out = NULL;
    if (!text)
        return 0;
    const size_t size = strlen(text) + 1;
    int status = bsq_alloc(ctx, "names", size, 1, out);
    if (status == 0)
        memcpy(*out, text, size);
    return status;
}

enum { FIRST_CAPACITY = 32 };

static int fail_memory(struct bsq_ctx *ctx)
{
    return bsq_fail_errno(ctx, BSQ_ENOMEM, ENOMEM, "names");
}

/* ---- the memory ---- */

int bsq_tally_add(struct bsq_ctx *ctx, struct bsq_tally *tally, uint64_t bytes)
{
    tally->bytes += bytes;
    if (tally->bytes <= BSQ_FREE_BYTES)
        return 0;
    int status = bsq_reserve(ctx, "names", bytes);
    if (status == 0)
        tally->reserved += bytes;
    return status;
}

void bsq_tally_release(struct bsq_ctx *ctx, struct bsq_tally *tally)
{
    bsq_release(ctx, tally->reserved);
    *tally = (struct bsq_tally){0};
}

int bsq_tally_grow(struct bsq_ctx *ctx, struct bsq_tally *tally, uint64_t count, uint64_t size,
                   void *inout, uint64_t *capacity)
{
    void *list;
    uint64_t wanted = *capacity > 0 ? *capacity : FIRST_CAPACITY;
    if (count <= *capacity)
        return 0;
    while (wanted < count)
        wanted *= 2;
    int status = bsq_tally_add(ctx, tally, (wanted - *capacity) * size);
    if (status < 0)
        return status;
    memcpy(&list, inout, sizeof list);
    list = reallocarray(list, wanted, size);
    if (!list)
        return fail_memory(ctx);
    memcpy(inout, &list, sizeof list);
    *capacity = wanted;
    return 0;
}

/* ---- texts ---- */

/* Returns the slot of a text, or an empty one. Some slot must be empty. */
static uint64_t *find_slot(const struct bsq_texts *texts, const char *text)
{
    uint64_t hash = UINT64_C(0xcbf29ce484222325); /* FNV-1a */
    for (const char *c = text; *c; c++)
        hash = (hash ^ (unsigned char)*c) * UINT64_C(0x100000001b3);
    for (uint64_t i = hash;; i++) {
        uint64_t *slot = &texts->slots[i & (2 * texts->capacity - 1)];
        if (*slot == 0 || strcmp(texts->list[*slot - 1], text) == 0)
            return slot;
    }
}

/* Makes space for one more text, and keeps half of the slots empty. */
static int grow(struct bsq_ctx *ctx, struct bsq_tally *tally, struct bsq_texts *texts)
{
    uint64_t capacity = texts->capacity;
    if (texts->count < capacity)
        return 0;
    int status =
        bsq_tally_grow(ctx, tally, texts->count + 1, sizeof *texts->list, &texts->list, &capacity);
    if (status == 0)
        status = bsq_tally_add(ctx, tally, 2 * (capacity - texts->capacity) * sizeof *texts->slots);
    assert(status < 0 || capacity > 0);
    uint64_t *slots = status == 0 ? calloc(2 * capacity, sizeof *slots) : NULL;
    if (!slots)
        return status < 0 ? status : fail_memory(ctx);
    free(texts->slots);
    texts->slots = slots;
    texts->capacity = capacity;
    for (uint64_t i = 0; i < texts->count; i++)
        *find_slot(texts, texts->list[i]) = i + 1;
    return 0;
}

uint64_t bsq_texts_find(const struct bsq_texts *texts, const char *text)
{
    const uint64_t slot = texts->count > 0 ? *find_slot(texts, text) : 0;
    return slot > 0 ? slot - 1 : texts->count;
}

int bsq_texts_add(struct bsq_ctx *ctx, struct bsq_tally *tally, struct bsq_texts *texts,
                  const char *text, uint64_t *number)
{
    *number = bsq_texts_find(texts, text);
    if (*number < texts->count)
        return 0;
    int status = grow(ctx, tally, texts);
    if (status == 0)
        status = bsq_tally_add(ctx, tally, strlen(text) + 1);
    char *copy = status == 0 ? strdup(text) : NULL;
    if (!copy)
        return status < 0 ? status : fail_memory(ctx);
    texts->list[texts->count++] = copy;
    *find_slot(texts, text) = texts->count;
    return 0;
}

void bsq_texts_free(struct bsq_texts *texts)
{
    for (uint64_t i = 0; i < texts->count; i++)
        free(texts->list[i]);
    free(texts->list);
    free(texts->slots);
    *texts = (struct bsq_texts){0};
}
