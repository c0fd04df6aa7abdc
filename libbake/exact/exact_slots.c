/* exact_slots.c - chunks in memory: divides the budget between them, their preparation and rays,
 * loads them, and builds the trees of their triangles. */
#include "libbake/exact/exact_leaves.h"

#include <string.h>

#include "base/geometry/vec.h"

/* ---- memory ---- */

/* Sizes in bytes of the buffers of a slot, and of a thread that prepares one, which fit every
 * chunk. A slot never needs its tree and its normals at the same time. */
struct sizes {
    uint64_t chunk, tree, slot;
    uint64_t boxes;
};

static struct sizes buffer_sizes(const struct bake_exact *exact)
{
    struct sizes sizes = {0};
    const uint32_t triangles = exact_most_triangles(exact);
    sizes.chunk = bsq_align_up(fmt_tris_load_size_max(exact->file), BSQ_ALIGNMENT);
    sizes.tree = bsq_align_up(bake_exact_tree_bytes(exact_runs(triangles)), BSQ_ALIGNMENT);
    sizes.boxes = bsq_align_up(exact_runs(triangles) * sizeof(struct exact_box), BSQ_ALIGNMENT);
    sizes.boxes = bk_upper(sizes.boxes, sizeof(struct exact_leaf)); /* to be sent */
    const uint64_t normals = exact->smooth ? fmt_tris_normals_size_max(exact->file) : 0;
    sizes.slot = sizes.chunk + bk_upper(sizes.tree, bsq_align_up(normals, BSQ_ALIGNMENT));
    return sizes;
}

/* How many slots there are, and how many threads may prepare them at the same time. */
struct slot_counts {
    uint32_t slots, preparers;
    uint64_t bytes;
};

/* Plans up to `most` slots, at least one, that fit `memory` bytes; each thread prepares one. */
static struct slot_counts slots_count(const struct bake_exact *exact, uint32_t most,
                                      uint32_t threads, uint64_t memory)
{
    const struct sizes sizes = buffer_sizes(exact);
    const uint64_t slot = sizes.slot, scratch = sizes.boxes;
    struct slot_counts counts = {.slots = most, .preparers = most < threads ? most : threads};
    while (counts.slots > 1 && counts.slots * slot + counts.preparers * scratch > memory) {
        counts.slots--;
        counts.preparers = counts.slots < threads ? counts.slots : threads;
    }
    counts.bytes = counts.slots * slot + counts.preparers * scratch;
    return counts;
}

enum { BUCKET_BYTES_A_RAY = EXACT_ENTRY_BYTES / 2 };

/* Returns the bytes of a ray of a batch, with its hit. */
static uint64_t ray_bytes(const struct bake_exact *exact)
{
    return sizeof(struct bake_ray) + sizeof(struct bake_hit) +
           (bake_exact_wants_footprints(exact) ? sizeof(uint32_t) : 0) +
           exact_transfer_floats(exact) * sizeof(float) + BUCKET_BYTES_A_RAY;
}

uint64_t bake_exact_capacity(const struct bake_exact *exact, uint64_t more_bytes)
{
    const uint64_t left = bsq_memory_left(exact->ctx);
    const uint32_t threads = bsq_threads(exact->ctx);
    const uint64_t fixed = slots_count(exact, exact_wave_slots(exact), threads, left / 4).bytes +
                           bake_exact_buckets_scratch_bytes(exact) +
                           (exact->chunk_count + 1) * sizeof(uint64_t) +
                           (exact_bucket_entries(exact, 0) + BAKE_RAY_BUNDLE) * EXACT_ENTRY_BYTES +
                           EXACT_LOCKS * sizeof(pthread_mutex_t);
    const uint64_t ray = ray_bytes(exact) + more_bytes;
    /* An eighth is left to other parts of the job. */
    const uint64_t usable = left / 8 * 7;
    const uint64_t rays = usable > fixed ? (usable - fixed) / ray : 0;
    return rays < 1 ? 1 : rays > UINT32_MAX / 4 ? UINT32_MAX / 4 : rays;
}

int bake_exact_slots_create(const struct bake_exact *exact, uint32_t most, uint64_t memory,
                            struct exact_slots *out)
{
    struct bsq_ctx *ctx = exact->ctx;
    const struct sizes sizes = buffer_sizes(exact);
    const struct slot_counts counts = slots_count(exact, most, bsq_threads(ctx), memory);
    *out = (struct exact_slots){.count = counts.slots, .preparers = counts.preparers};
    BSQ_PASS(BSQ_CALLOC(ctx, "chunks in memory", counts.slots, &out->slots));
    BSQ_PASS(bsq_alloc(ctx, "chunks in memory", counts.bytes, 1, &out->memory));
    char *at = out->memory;
    for (uint32_t s = 0; s < counts.slots; s++, at += sizes.slot) {
        out->slots[s].chunk_memory = at;
        out->slots[s].tree_memory = at + sizes.chunk;
    }
    out->boxes = at;
    out->boxes_bytes = sizes.boxes;
    return 0;
}

void bake_exact_slots_free(struct bsq_ctx *ctx, struct exact_slots *slots)
{
    BSQ_FREE(ctx, slots->memory, slots->slots);
}

/* ---- chunks ---- */

/* Builds the tree of the loaded chunk. boxes: space for its runs. */
static void build_tree(struct exact_slot *slot, struct exact_box *boxes)
{
    const struct fmt_tris_chunk *chunk = &slot->chunk;
    const uint32_t count = chunk->triangle_count, runs = exact_runs(count);
    for (uint32_t r = 0; r < runs; r++) {
        const uint32_t end = r + 1 < runs ? EXACT_RUN * (r + 1) : count;
        four_floats least, most, low, high;
        exact_triangle_bounds(chunk, EXACT_RUN * r, &least, &most);
        for (uint32_t t = EXACT_RUN * r + 1; t < end; t++) {
            exact_triangle_bounds(chunk, t, &low, &high);
            least = four_floats_min(least, low);
            most = four_floats_max(most, high);
        }
        memcpy(boxes[r].low, &least, sizeof boxes[r].low);
        memcpy(boxes[r].high, &most, sizeof boxes[r].high);
    }
    bake_exact_tree_build(&slot->tree, runs, boxes, slot->tree_memory);
}

/* Loads the chunk of a slot, or its sample if `sampled` and it has one. */
static int slots_load_slot(const struct bake_exact *exact, struct exact_slot *slot, bool sampled)
{
    bool found = false;
    int status = 0;
    slot->chunk = (struct fmt_tris_chunk){0};
    if (sampled)
        status = fmt_tris_load_sample(exact->file, slot->number, slot->chunk_memory, &slot->chunk,
                                      &found);
    if (status < 0 || found)
        return status;
    ++*exact->loads;
    return fmt_tris_load(exact->file, slot->number, slot->chunk_memory, &slot->chunk);
}

int bake_exact_slot_prepare(const struct bake_exact *exact, const struct exact_slots *slots,
                            bool sampled, uint64_t index, unsigned worker)
{
    struct exact_slot *slot = &slots->slots[index];
    int status = 0;
    if (!slot->loaded)
        status = slots_load_slot(exact, slot, sampled);
    if (status < 0)
        return status;
    slot->loaded = true;
    /* If there are fewer preparers than threads, there are as many as slots. */
    const uint64_t preparer = slots->preparers < bsq_threads(exact->ctx) ? index : worker;
    void *boxes = slots->boxes + preparer * slots->boxes_bytes;
    build_tree(slot, boxes);
    if (slots->on_device)
        status = bake_exact_slot_send(exact, slot, index, boxes, slots->boxes_bytes, worker);
    return status == BSQ_RETRY ? 0 : status; /* the processor has all that it needs */
}

bool bake_exact_wound_backwards(const struct fmt_tris_chunk *chunk, uint32_t triangle)
{
    if (!chunk->normals)
        return false;
    const uint32_t *v = chunk->triangles[triangle];
    const float *a = chunk->positions[v[0]], *b = chunk->positions[v[1]],
                *c = chunk->positions[v[2]];
    struct bsq_vec3 n0 = bsq_oct_unpack(chunk->normals[v[0]]),
                    n1 = bsq_oct_unpack(chunk->normals[v[1]]),
                    n2 = bsq_oct_unpack(chunk->normals[v[2]]);
    const double n[3] = {(double)n0.x + (double)n1.x + (double)n2.x,
                         (double)n0.y + (double)n1.y + (double)n2.y,
                         (double)n0.z + (double)n1.z + (double)n2.z};
    double dot = 0;
    for (int k = 0; k < 3; k++) {
        int i = (k + 1) % 3, j = (k + 2) % 3;
        dot += n[k] * (((double)b[i] - (double)a[i]) * ((double)c[j] - (double)a[j]) -
                       ((double)b[j] - (double)a[j]) * ((double)c[i] - (double)a[i]));
    }
    return dot < 0;
}
