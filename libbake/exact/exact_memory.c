/* exact_memory.c - divides the memory budget between chunks, their preparation and rays. */
#include "libbake/exact/exact_scene.h"

/* Sizes in bytes of the buffers of a slot and of a scratch, which fit every chunk. */
struct sizes {
    uint64_t chunk, tree, smooth;
    uint64_t boxes, keys, neighbour, map, near;
};

static struct sizes buffer_sizes(const struct bake_exact *exact)
{
    struct sizes sizes = {0};
    uint32_t triangles = 0, vertices = 0;
    for (uint32_t c = 0; c < exact->chunk_count; c++) {
        const struct fmt_tris_chunk_info *chunk = &exact->chunks[c];
        triangles = chunk->triangle_count > triangles ? chunk->triangle_count : triangles;
        vertices = chunk->vertex_count > vertices ? chunk->vertex_count : vertices;
    }
    sizes.chunk = bsq_align_up(fmt_tris_load_size_max(exact->file), BSQ_ALIGNMENT);
    sizes.tree = bsq_align_up(bake_exact_tree_bytes(triangles), BSQ_ALIGNMENT);
    sizes.boxes = bsq_align_up(triangles * sizeof(struct exact_box), BSQ_ALIGNMENT);
    sizes.keys = bsq_align_up(bake_exact_tree_scratch_bytes(triangles), BSQ_ALIGNMENT);
    if (exact_needs_smooth(exact)) {
        sizes.smooth = bsq_align_up(bake_exact_smooth_bytes(vertices), BSQ_ALIGNMENT);
        sizes.neighbour = sizes.chunk;
        sizes.map = bsq_align_up(vertices * sizeof(uint32_t), BSQ_ALIGNMENT);
        sizes.near = bsq_align_up(exact->chunk_count * sizeof(uint32_t), BSQ_ALIGNMENT);
    }
    return sizes;
}

/* A slot never holds a tree and sums of normals at the same time. */
static uint64_t slot_bytes(const struct sizes *sizes)
{
    return sizes->chunk + (sizes->tree > sizes->smooth ? sizes->tree : sizes->smooth);
}

static uint64_t scratch_bytes(const struct sizes *sizes)
{
    uint64_t building = sizes->boxes + sizes->keys;
    uint64_t shading = sizes->neighbour + sizes->map + sizes->near;
    return building > shading ? building : shading;
}

/* How many slots there are, and how many threads may prepare them at the same time. */
struct plan {
    uint32_t slots, preparers;
    uint64_t bytes;
};

/* Plans up to `most` slots, at least one, that fit `memory` bytes; each thread prepares one. */
static struct plan plan_slots(const struct bake_exact *exact, uint32_t most, uint32_t threads,
                              uint64_t memory)
{
    const struct sizes sizes = buffer_sizes(exact);
    const uint64_t slot = slot_bytes(&sizes), scratch = scratch_bytes(&sizes);
    struct plan plan = {.slots = most, .preparers = most < threads ? most : threads};
    while (plan.slots > 1 && plan.slots * slot + plan.preparers * scratch > memory) {
        plan.slots--;
        plan.preparers = plan.slots < threads ? plan.slots : threads;
    }
    plan.bytes = plan.slots * slot + plan.preparers * scratch;
    return plan;
}

/* Returns the bytes of a ray of a batch, with its hit. */
static uint64_t ray_bytes(const struct bake_exact *exact)
{
    return sizeof(struct bake_exact_ray) + sizeof(struct bake_exact_hit) +
           (bake_exact_wants_footprints(exact) ? sizeof(uint32_t) : 0) +
           exact_transfer_floats(exact) * sizeof(float) + EXACT_PAIRS_PER_RAY * sizeof(uint32_t);
}

struct bake_exact_needs bake_exact_expect(const struct bake_exact *exact, uint32_t threads)
{
    const uint32_t chunks = exact->chunk_count, slots = EXACT_SLOTS_A_THREAD * threads;
    return (struct bake_exact_needs){
        .fixed_bytes = plan_slots(exact, slots, threads, UINT64_MAX).bytes,
        .ray_bytes = ray_bytes(exact),
        .scan_bytes = plan_slots(exact, chunks, threads, UINT64_MAX).bytes,
        .chunk_count = chunks};
}

uint64_t bake_exact_capacity(const struct bake_exact *exact, uint64_t more_bytes)
{
    const uint64_t left = bsq_memory_share(exact->ctx, "chunks and rays", 1);
    const uint32_t threads = bsq_threads(exact->ctx);
    const uint64_t fixed = plan_slots(exact, exact_wave_slots(exact), threads, left / 4).bytes +
                           bake_exact_buckets_scratch_bytes(exact) +
                           (exact->chunk_count + 1) * (sizeof(uint64_t) + EXACT_PAIRS_PER_RAY * 4) +
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
    const struct plan plan = plan_slots(exact, most, bsq_threads(ctx), memory);
    *out = (struct exact_slots){.count = plan.slots, .preparers = plan.preparers};
    int status = bsq_calloc(ctx, "chunks in memory", plan.slots, sizeof *out->slots, &out->slots);
    if (status == 0)
        status = bsq_calloc(ctx, "chunks in memory", plan.preparers, sizeof *out->scratches,
                            &out->scratches);
    if (status == 0)
        status = bsq_alloc(ctx, "chunks in memory", plan.bytes, 1, &out->memory);
    if (status < 0)
        return status;
    char *at = out->memory;
    for (uint32_t s = 0; s < plan.slots; s++, at += slot_bytes(&sizes)) {
        out->slots[s].chunk_memory = at;
        out->slots[s].tree_memory = out->slots[s].smooth_memory = at + sizes.chunk;
    }
    for (uint32_t p = 0; p < plan.preparers; p++, at += scratch_bytes(&sizes)) {
        struct exact_scratch *scratch = &out->scratches[p];
        scratch->boxes = scratch->neighbour = at;
        scratch->keys = at + sizes.boxes;
        scratch->map = (uint32_t *)(void *)(at + sizes.neighbour);
        scratch->near = (uint32_t *)(void *)(at + sizes.neighbour + sizes.map);
    }
    return 0;
}

void bake_exact_slots_free(struct bsq_ctx *ctx, struct exact_slots *slots)
{
    bsq_free(ctx, slots->memory);
    bsq_free(ctx, slots->slots);
    bsq_free(ctx, slots->scratches);
}
