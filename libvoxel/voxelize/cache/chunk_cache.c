/* chunk_cache.c - which chunks are kept, and which worker makes them.
 *
 * The schedule tells which region needs a chunk next, so the cache need not guess: it evicts the
 * chunk that is needed last (Belady, "A study of replacement algorithms for a virtual-storage
 * computer", 1966). Slots are allocated at their first use. */
#include "libvoxel/voxelize/cache/chunk_cache.h"
#include "libvoxel/voxelize/cache/chunk_content.h"

#include <pthread.h>

enum { NO_SLOT = -1 };
#define NO_CHUNK UINT32_MAX

struct slot {
    uint32_t chunk; /* NO_CHUNK: empty */
    uint32_t users;
    bool ready; /* or it has failed */
    int status;
    struct vox_chunk_content content;
};

struct use {
    vox_region_key next; /* next region that needs the chunk after the units under way */
    uint32_t expected;   /* units of work under way that need it */
    int32_t slot;
};

struct vox_chunks {
    struct bsq_ctx *ctx;
    struct vox_chunk_source from;
    pthread_mutex_t lock;
    pthread_cond_t made;  /* a slot is ready, or has failed */
    pthread_cond_t freed; /* a slot lost its last user */
    uint32_t chunk_count, slot_count, slots_used;
    struct slot *slots;
    struct use *uses;    /* one a chunk */
    uint64_t slot_bytes; /* enough for any chunk */
};

static int make_content(struct vox_chunks *c, struct slot *slot)
{
    if (!slot->content.memory)
        BSQ_PASS(bsq_alloc(c->ctx, "chunk cache", c->slot_bytes, 1, &slot->content.memory));
    return vox_chunk_make(&c->from, slot->chunk, &slot->content);
}

/* ---- the cache ---- */

/* Finds the first region that needs each chunk. */
static void find_first_uses(struct vox_chunks *c, const struct vox_chunk_box *boxes,
                            uint64_t box_count)
{
    for (uint32_t i = 0; i < c->chunk_count; i++)
        c->uses[i] = (struct use){.next = VOX_REGION_KEY_NEVER, .slot = NO_SLOT};
    for (uint64_t i = 0; i < box_count; i++) {
        vox_region_key first = vox_region_first(&boxes[i].box);
        struct use *use = &c->uses[boxes[i].chunk];
        if (first < use->next)
            use->next = first;
    }
}

int vox_chunks_create(struct bsq_ctx *ctx, const struct fmt_tris_file *file,
                      const struct vox_transform *transform, const struct vox_chunk_box *boxes,
                      uint64_t box_count, bool smooth, uint32_t slot_count, struct vox_chunks **out)
{
    const uint32_t chunk_count = (uint32_t)fmt_tris_get_header(file)->chunk_count;
    const char *what = "chunk cache";
    struct vox_chunks *c = NULL;
    int status;
    *out = NULL;
    BSQ_TRY(BSQ_CALLOC(ctx, what, 1, &c));
    *c = (struct vox_chunks){.ctx = ctx,
                             .from = {file, transform, smooth},
                             .lock = PTHREAD_MUTEX_INITIALIZER,
                             .made = PTHREAD_COND_INITIALIZER,
                             .freed = PTHREAD_COND_INITIALIZER,
                             .chunk_count = chunk_count,
                             .slot_count = slot_count,
                             .slot_bytes = vox_chunks_slot_bytes(file, smooth)};
    BSQ_TRY(BSQ_CALLOC(ctx, what, slot_count, &c->slots));
    BSQ_TRY(BSQ_CALLOC(ctx, what, chunk_count, &c->uses));
    find_first_uses(c, boxes, box_count);
    *out = c;
    return 0;
done:
    vox_chunks_destroy(c);
    return status;
}

void vox_chunks_destroy(struct vox_chunks *c)
{
    if (!c)
        return;
    for (uint32_t i = 0; c->slots && i < c->slots_used; i++)
        bsq_free(c->ctx, c->slots[i].content.memory);
    BSQ_FREE(c->ctx, c->slots, c->uses, c);
}

void vox_chunks_expect(struct vox_chunks *c, uint32_t chunk, uint32_t uses, vox_region_key after)
{
    struct use *use = &c->uses[chunk];
    pthread_mutex_lock(&c->lock);
    use->next = after;
    use->expected += uses;
    pthread_mutex_unlock(&c->lock);
}

void vox_chunks_done(struct vox_chunks *c, uint32_t chunk)
{
    pthread_mutex_lock(&c->lock);
    c->uses[chunk].expected--;
    pthread_mutex_unlock(&c->lock);
}

/* Returns whether chunk a is needed before chunk b. */
static bool needed_before(const struct vox_chunks *c, uint32_t a, uint32_t b)
{
    const struct use *ua = &c->uses[a], *ub = &c->uses[b];
    if ((ua->expected == 0) != (ub->expected == 0))
        return ua->expected != 0;
    return ua->next < ub->next;
}

static bool is_finished(const struct use *use)
{
    return use->expected == 0 && use->next == VOX_REGION_KEY_NEVER;
}

/* Returns a slot to fill: one whose chunk is no longer needed, else a new one, else the one whose
 * chunk is needed last. Returns NULL while all are held. Looking at all slots takes some
 * microseconds, and reading the chunk some milliseconds. */
static struct slot *cache_find_slot(struct vox_chunks *c)
{
    struct slot *best = NULL;
    for (uint32_t i = 0; i < c->slots_used; i++) {
        struct slot *slot = &c->slots[i];
        if (slot->users > 0)
            continue;
        if (slot->chunk == NO_CHUNK || is_finished(&c->uses[slot->chunk]))
            return slot;
        if (!best || needed_before(c, best->chunk, slot->chunk))
            best = slot;
    }
    if (c->slots_used < c->slot_count) {
        best = &c->slots[c->slots_used++];
        best->chunk = NO_CHUNK;
    }
    return best;
}

/* Assigns the slot to the chunk, which the caller has to make. */
static void give_slot(struct vox_chunks *c, struct slot *slot, uint32_t chunk)
{
    if (slot->chunk != NO_CHUNK)
        c->uses[slot->chunk].slot = NO_SLOT;
    slot->chunk = chunk;
    slot->ready = false;
    slot->status = 0;
    c->uses[chunk].slot = (int32_t)(slot - c->slots);
}

/* Drops a use of the slot. Called with the lock held, as are all functions below that are not
 * public. */
static void leave_slot(struct vox_chunks *c, struct slot *slot)
{
    if (--slot->users > 0)
        return;
    if (slot->status < 0) {
        c->uses[slot->chunk].slot = NO_SLOT;
        slot->chunk = NO_CHUNK;
    }
    pthread_cond_broadcast(&c->freed);
}

/* Makes the content of a slot that is in use if it is `mine`, else waits until it is made. */
static int make_ready(struct vox_chunks *c, struct slot *slot, bool mine)
{
    if (mine) {
        pthread_mutex_unlock(&c->lock);
        int status = make_content(c, slot);
        pthread_mutex_lock(&c->lock);
        slot->ready = true;
        slot->status = status;
        pthread_cond_broadcast(&c->made);
    }
    while (!slot->ready)
        pthread_cond_wait(&c->made, &c->lock);
    return slot->status;
}

/* Returns the chunk needed first among those that have no slot. NO_CHUNK if there is none. Looking
 * at all takes less than 50 microseconds with a billion triangles. */
static uint32_t next_unready(const struct vox_chunks *c)
{
    uint32_t best = NO_CHUNK;
    for (uint32_t i = 0; i < c->chunk_count; i++) {
        const struct use *use = &c->uses[i];
        if (use->slot == NO_SLOT && !is_finished(use) &&
            (best == NO_CHUNK || needed_before(c, i, best)))
            best = i;
    }
    return best;
}

/* Gives the chunk a slot that no unit under way needs, if there is one. */
static bool give_spare_slot(struct vox_chunks *c, uint32_t chunk)
{
    struct slot *slot = cache_find_slot(c);
    if (!slot || (slot->chunk != NO_CHUNK &&
                  (c->uses[slot->chunk].expected > 0 || needed_before(c, slot->chunk, chunk))))
        return false;
    give_slot(c, slot, chunk);
    return true;
}

/* Makes other chunks ready while another worker makes the wanted one. Neighbouring regions share
 * chunks, so workers often need the same chunk at the same time. */
static int prepare_others(struct vox_chunks *c, const struct slot *wanted)
{
    int status = 0;
    while (status == 0 && !wanted->ready) {
        uint32_t chunk = next_unready(c);
        if (chunk == NO_CHUNK || !give_spare_slot(c, chunk))
            break;
        struct slot *slot = &c->slots[c->uses[chunk].slot];
        slot->users++;
        status = make_ready(c, slot, true);
        leave_slot(c, slot);
    }
    return status;
}

/* Returns a slot of the chunk, and counts a use of it. Waits while all slots are held. *fresh: the
 * caller has to make it. */
static struct slot *take_slot(struct vox_chunks *c, uint32_t chunk, bool *fresh)
{
    const struct use *use = &c->uses[chunk];
    struct slot *slot;
    *fresh = false;
    while (use->slot == NO_SLOT) {
        if ((slot = cache_find_slot(c)) != NULL) {
            give_slot(c, slot, chunk);
            *fresh = true;
        } else {
            pthread_cond_wait(&c->freed, &c->lock);
        }
    }
    slot = &c->slots[use->slot];
    slot->users++;
    return slot;
}

static int acquire(struct vox_chunks *c, uint32_t chunk, const struct vox_chunk **out)
{
    bool fresh;
    struct slot *slot = take_slot(c, chunk, &fresh);
    int status = fresh ? 0 : prepare_others(c, slot);
    if (status == 0)
        status = make_ready(c, slot, fresh);
    if (status < 0)
        leave_slot(c, slot);
    else
        *out = &slot->content.chunk;
    return status;
}

int vox_chunks_acquire(struct vox_chunks *c, uint32_t chunk, const struct vox_chunk **out)
{
    *out = NULL;
    pthread_mutex_lock(&c->lock);
    int status = acquire(c, chunk, out);
    pthread_mutex_unlock(&c->lock);
    return status;
}

void vox_chunks_release(struct vox_chunks *c, uint32_t chunk)
{
    pthread_mutex_lock(&c->lock);
    leave_slot(c, &c->slots[c->uses[chunk].slot]);
    pthread_mutex_unlock(&c->lock);
}
