/* exact_kept.c - keeps chunks in memory that other chunks of a batch or a sweep need for vertex
 * normals.
 *
 * The chunks of a batch are traced in the order of the file, so it is known when a chunk is used
 * next: when it is traced itself, or with the next one that its bounds overlap. Of the chunks that
 * fit into memory, those that are used soonest are kept (Belady, "A Study of Replacement
 * Algorithms", 1966). */
#include "libbake/exact/exact_scene.h"

#include <string.h>

#include "base/parallel.h"

#define NEVER UINT32_MAX

int bake_exact_kept_create(const struct bake_exact *exact, struct exact_kept *out)
{
    struct bsq_ctx *ctx = exact->ctx;
    const uint64_t left = bsq_memory_share(ctx, "chunks near others", 1);
    const uint64_t sorting = bake_exact_buckets_scratch_bytes(exact);
    const uint64_t size = bake_exact_chunk_bytes(exact);
    const uint64_t most = left > sorting ? (left - sorting) / 8 * 7 / size : 0;
    int status = 0;
    *out = (struct exact_kept){.exact = exact};
    out->count = most < exact->chunk_count ? (uint32_t)most : exact->chunk_count;
    BSQ_TRY(
        bsq_alloc(ctx, "chunks near others", exact->chunk_count, sizeof *out->near, &out->near));
    BSQ_TRY(bsq_calloc(ctx, "chunks near others", exact->chunk_count, sizeof *out->entry_of,
                       &out->entry_of));
    BSQ_TRY(bsq_calloc(ctx, "chunks near others", out->count, sizeof *out->entries, &out->entries));
    BSQ_TRY(bsq_alloc(ctx, "chunks near others", out->count, sizeof *out->heap, &out->heap));
    BSQ_TRY(bsq_alloc(ctx, "chunks near others", out->count, size, &out->memory));
    for (uint32_t i = 0; i < out->count; i++) {
        out->entries[i] =
            (struct exact_kept_entry){.next = NEVER, .place = i, .memory = out->memory + i * size};
        out->heap[i] = i;
    }
done:
    return status;
}

void bake_exact_kept_free(struct bsq_ctx *ctx, struct exact_kept *kept)
{
    bsq_free(ctx, kept->near);
    bsq_free(ctx, kept->entry_of);
    bsq_free(ctx, kept->entries);
    bsq_free(ctx, kept->heap);
    bsq_free(ctx, kept->memory);
}

/* ---- which entry to give up ---- */

/* Returns whether an entry is given up before another one: it is not needed by the wave, and used
 * later. */
static bool kept_goes_first(const struct exact_kept *kept, uint32_t entry, uint32_t other)
{
    const struct exact_kept_entry *a = &kept->entries[entry], *b = &kept->entries[other];
    if (a->needed != b->needed)
        return b->needed;
    return a->next != b->next ? a->next > b->next : entry < other;
}

static void kept_put(struct exact_kept *kept, uint32_t place, uint32_t entry)
{
    kept->heap[place] = entry;
    kept->entries[entry].place = place;
}

/* Puts an entry where it belongs in the heap, after it has changed. */
static void kept_settle(struct exact_kept *kept, const struct exact_kept_entry *changed)
{
    const uint32_t entry = (uint32_t)(changed - kept->entries), *heap = kept->heap;
    uint32_t place = changed->place;
    for (; place > 0 && kept_goes_first(kept, entry, heap[(place - 1) / 2]);
         place = (place - 1) / 2)
        kept_put(kept, place, heap[(place - 1) / 2]);
    for (uint64_t child; (child = 2 * (uint64_t)place + 1) < kept->count; place = (uint32_t)child) {
        child += child + 1 < kept->count && kept_goes_first(kept, heap[child + 1], heap[child]);
        if (!kept_goes_first(kept, heap[child], entry))
            break;
        kept_put(kept, place, heap[child]);
    }
    kept_put(kept, place, entry);
}

/* Returns the entry that is used last of those that the wave does not need; NULL: there is none. */
static struct exact_kept_entry *kept_latest(const struct exact_kept *kept)
{
    struct exact_kept_entry *first = kept->count ? &kept->entries[kept->heap[0]] : NULL;
    return first && !first->needed ? first : NULL;
}

/* ---- chunks ---- */

static struct exact_kept_entry *kept_find(const struct exact_kept *kept, uint32_t number)
{
    struct exact_kept_entry *entry = kept->count ? &kept->entries[kept->entry_of[number]] : NULL;
    return entry && entry->number == number && (entry->used || entry->needed) ? entry : NULL;
}

const struct exact_chunk *bake_exact_kept_find(const struct exact_kept *kept, uint32_t number)
{
    const struct exact_kept_entry *entry = kept_find(kept, number);
    return entry ? &entry->chunk : NULL;
}

/* Exchanges the chunks of an entry and a slot. */
static void exchange(struct exact_kept_entry *entry, struct exact_slot *slot)
{
    const struct exact_kept_entry other = *entry;
    entry->chunk = slot->chunk;
    entry->memory = slot->chunk_memory;
    slot->chunk = other.chunk;
    slot->chunk_memory = other.memory;
}

bool bake_exact_kept_take(struct exact_kept *kept, struct exact_slot *slot)
{
    struct exact_kept_entry *entry = kept_find(kept, slot->number);
    if (entry) {
        exchange(entry, slot);
        entry->used = false;
        entry->next = NEVER;
        kept_settle(kept, entry);
    }
    return entry != NULL;
}

/* Returns the next chunk after `last` that uses a chunk and has rays, or that later batches of a
 * sweep meet, or NEVER. */
static uint32_t next_use(const struct exact_kept *kept, uint32_t number, uint32_t last)
{
    const struct fmt_tris_chunk_info *chunk = &kept->exact->chunks[number];
    struct exact_box box;
    uint32_t next = NEVER;
    memcpy(box.low, chunk->bounds_min, sizeof box.low);
    memcpy(box.high, chunk->bounds_max, sizeof box.high);
    const uint32_t near = bake_exact_tree_overlapping(&kept->exact->tree, &box, kept->near);
    for (uint32_t i = 0; i < near; i++) {
        const uint32_t c = kept->near[i];
        if (c > last && c < next && (c >= kept->end || kept->starts[c] < kept->starts[c + 1]))
            next = c;
    }
    return next;
}

/* Keeps a chunk for the wave, if there is an entry for it. Returns whether it has to be loaded. */
static bool kept_reserve(struct exact_kept *kept, uint32_t number)
{
    struct exact_kept_entry *entry = kept_find(kept, number);
    const bool load = !entry;
    if (load)
        entry = kept_latest(kept);
    if (!entry)
        return false;
    entry->needed = true;
    if (load) {
        *entry = (struct exact_kept_entry){
            .number = number, .memory = entry->memory, .needed = true, .place = entry->place};
        kept->entry_of[number] = (uint32_t)(entry - kept->entries);
    }
    kept_settle(kept, entry);
    return load;
}

static bool in_wave(const struct exact_slots *wave, uint32_t used, uint32_t number)
{
    bool in = false;
    for (uint32_t i = 0; i < used; i++)
        in |= wave->slots[i].number == number;
    return in;
}

static int load_entry(void *arg, uint64_t index, unsigned worker)
{
    (void)worker;
    struct exact_kept *kept = arg;
    struct exact_kept_entry *entry = &kept->entries[index];
    if (!entry->needed || entry->used)
        return 0;
    const int status = bake_exact_load(kept->exact, entry->number, entry->memory, &entry->chunk);
    entry->used = status == 0;
    if (entry->used)
        bake_exact_set_groups(kept->exact, entry->memory, &entry->chunk);
    return status;
}

int bake_exact_kept_load(struct exact_kept *kept, const struct exact_slots *wave, uint32_t used)
{
    bool load = false;
    for (uint32_t s = 0; s < used; s++)
        for (uint32_t i = 0; i < wave->slots[s].near_count; i++)
            if (!in_wave(wave, used, wave->slots[s].near[i]))
                load |= kept_reserve(kept, wave->slots[s].near[i]);
    return load ? bsq_parallel_for(kept->exact->ctx, kept->count, load_entry, kept) : 0;
}

void bake_exact_kept_end_wave(struct exact_kept *kept, const struct exact_slots *wave,
                              uint32_t used)
{
    const uint32_t last = wave->slots[used - 1].number;
    if (kept->count == 0)
        return;
    for (uint32_t i = 0; i < kept->count; i++) {
        struct exact_kept_entry *entry = &kept->entries[i];
        entry->needed = false;
        if (entry->used && entry->next <= last)
            entry->next = next_use(kept, entry->number, last);
        kept_settle(kept, entry);
    }
    for (uint32_t s = 0; s < used; s++) {
        struct exact_slot *slot = &wave->slots[s];
        const uint32_t next = next_use(kept, slot->number, last);
        struct exact_kept_entry *entry = kept_latest(kept);
        if (!entry || entry->next <= next)
            continue;
        exchange(entry, slot);
        entry->number = slot->number;
        kept->entry_of[slot->number] = (uint32_t)(entry - kept->entries);
        entry->next = next;
        entry->used = true;
        kept_settle(kept, entry);
        slot->loaded = false;
    }
}
