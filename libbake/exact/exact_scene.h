/* exact_scene.h - what the files of this folder share; private to it: the opened scan, slots for
 * chunks in memory, and buckets of rays. */
#ifndef BAKE_EXACT_EXACT_SCENE_H
#define BAKE_EXACT_EXACT_SCENE_H

#include <math.h>
#include <pthread.h>

#include "base/simd/simd.h"
#include "base/geometry/smooth_normals.h"
#include "formats/shading/shading.h"
#include "libbake/exact/exact.h"
#include "libbake/exact/exact_tree.h"
#include "libbake/kernel/bk_meet.h"

struct bake_exact {
    struct bsq_ctx *ctx;
    const char *path;
    struct fmt_tris_file *file;
    const struct fmt_tris_header *header;
    const struct fmt_tris_chunk_info *chunks;
    uint32_t chunk_count;
    bool two_sided;         /* also hit surfaces that face away */
    bool smooth;            /* hits take the vertex normals that were made */
    enum bsq_simd simd;     /* instructions for tracing */
    struct exact_tree tree; /* over the chunks' bounds */
    void *tree_memory;
    struct fmt_shading shading; /* its channels are those of transfer maps */
    struct bake_device *device; /* NULL: the processor traces all rays */
    uint32_t places;            /* for chunks in the device's memory, of place_bytes each */
    uint64_t place_bytes;
    _Atomic uint64_t *loads; /* number of chunks that were loaded, counted again each time */
};

/* Returns the number of values that the channels of a hit have. */
static inline uint64_t exact_transfer_floats(const struct bake_exact *exact)
{
    const uint32_t count = exact->shading.attribute_count;
    return count > 0 ? (uint64_t)BK_TRANSFER_VALUES * (count - FMT_SHADING_CHANNELS) : 0;
}

enum { EXACT_LOCKS = 256 /* over the hits */, EXACT_SLOTS_A_THREAD = 2 };

/* Returns the slots of a wave: two a thread, so that all threads are busy until it ends, and chunks
 * stay in the cache from one step to the next. */
static inline uint32_t exact_wave_slots(const struct bake_exact *exact)
{
    return EXACT_SLOTS_A_THREAD * bsq_threads(exact->ctx);
}

/* Returns the triangles of the largest chunk. */
static inline uint32_t exact_most_triangles(const struct bake_exact *exact)
{
    uint32_t most = 0;
    for (uint32_t c = 0; c < exact->chunk_count; c++)
        most = exact->chunks[c].triangle_count > most ? exact->chunks[c].triangle_count : most;
    return most;
}

/* ---- a chunk in memory ---- */

enum { EXACT_RUN = 8 /* triangles of a leaf of the tree */ };

static inline uint32_t exact_runs(uint32_t triangles)
{
    return (triangles + EXACT_RUN - 1) / EXACT_RUN;
}

/* Sets the bounds of a triangle. The fourth numbers are arbitrary. */
LANES_INLINE void exact_triangle_bounds(const struct fmt_tris_chunk *chunk, uint32_t triangle,
                                        four_floats *low, four_floats *high)
{
    const uint32_t *v = chunk->triangles[triangle];
    const four_floats a = four_floats_load(chunk->positions[v[0]]),
                      b = four_floats_load(chunk->positions[v[1]]),
                      c = four_floats_load(chunk->positions[v[2]]);
    *low = four_floats_min(four_floats_min(a, b), c);
    *high = four_floats_max(four_floats_max(a, b), c);
}

/* Sets the boxes of a run's triangles. */
LANES_INLINE void exact_run_set(const struct fmt_tris_chunk *chunk, uint32_t run,
                                struct exact_box8 *out)
{
    const uint32_t first = EXACT_RUN * run;
    four_floats low[EXACT_RUN], high[EXACT_RUN];
    for (uint32_t i = 0; i < EXACT_RUN; i++) {
        low[i] = (four_floats){INFINITY, INFINITY, INFINITY, INFINITY};
        high[i] = -low[i];
        if (first + i < chunk->triangle_count)
            exact_triangle_bounds(chunk, first + i, &low[i], &high[i]);
    }
    exact_node_set(out, low, high, 0);
}

/* Memory for a chunk, and what is computed from it. */
struct exact_slot {
    uint32_t number; /* of the chunk */
    bool loaded;
    struct fmt_tris_chunk chunk;
    struct exact_tree tree;
    struct fmt_tris_normals normals; /* that were made; while hits are evaluated, in tree_memory */
    void *chunk_memory, *tree_memory;
};

/* The slots of a wave of chunks. */
struct exact_slots {
    uint32_t count, preparers; /* slots; threads that may prepare them at the same time */
    struct exact_slot *slots;
    char *boxes; /* of each preparer, boxes_bytes for the runs of a chunk */
    uint64_t boxes_bytes;
    void *memory;   /* holds the buffers of all slots and preparers */
    bool on_device; /* each chunk goes to the place of its slot on the device, too */
};

/* Allocates 1 to `most` slots, as many as fit `memory` bytes. Free them, also after a failure. */
int bake_exact_slots_create(const struct bake_exact *exact, uint32_t most, uint64_t memory,
                            struct exact_slots *out);
void bake_exact_slots_free(struct bsq_ctx *ctx, struct exact_slots *slots);

/* Loads the chunk of a slot, or its sample, unless it is loaded, and builds the tree of the bounds
 * of each EXACT_RUN triangles. Workers may prepare different slots at the same time. */
int bake_exact_slot_prepare(const struct bake_exact *exact, const struct exact_slots *slots,
                            bool sampled, uint64_t index, unsigned worker);
/* Sends a prepared slot to its place on the device, a group of its own. scratch: `bytes` of them,
 * at least those of a leaf. Errors: those of bake_device_send(). */
int bake_exact_slot_send(const struct bake_exact *exact, const struct exact_slot *slot,
                         uint64_t index, void *scratch, uint64_t bytes, unsigned worker);

/* The hit of a ray that wins so far. */
struct exact_best {
    double t;
    uint64_t triangle;
    float w1, w2; /* barycentric weights of the second and third corner */
    double reach; /* of the ray */
};

/* Replaces best[i] of `count` rays, at most BAKE_RAY_BUNDLE, by the nearest hit among the chunk's
 * triangles, if that wins. Returns a bit mask of the rays whose hit was replaced. first: number of
 * the chunk's first triangle. */
typedef unsigned bake_exact_slot_trace_fn(const struct exact_slot *slot, uint64_t first,
                                          const struct bake_ray *rays, uint32_t count,
                                          const bk_limits *limits, struct exact_best *best);
BSQ_SIMD_DECLARE(bake_exact_slot_trace_fn, bake_exact_slot_trace);

/* Writes the numbers of the boxes that rays, at most BAKE_RAY_BUNDLE, cross between t_min and
 * t_max to out[], ascending, and returns their count. Boxes near the rays may be among them. boxes:
 * `count` of them, by eights. out: space for count + 7 numbers. */
typedef uint32_t bake_exact_crossed_fn(const struct bake_ray *rays, uint32_t ray_count,
                                       double t_min, double t_max, const struct exact_box8 *boxes,
                                       uint32_t count, uint32_t *out);
BSQ_SIMD_DECLARE(bake_exact_crossed_fn, bake_exact_crossed);

/* Checks whether the winding of a triangle disagrees with its vertex normals. The normals then
 * decide which side is outside. False if the chunk has no normals. */
bool bake_exact_wound_backwards(const struct fmt_tris_chunk *chunk, uint32_t triangle);

/* ---- rays by chunk ---- */

/* The bundles of rays that cross each chunk: those of chunk c are entries starts[c] to
 * starts[c + 1] - 1, in any order. */
struct exact_buckets {
    uint32_t *bundles;
    uint16_t *found; /* of each entry: bit i: tracing took a hit for ray i of the bundle */
    uint64_t capacity;
    uint64_t *starts; /* chunk_count + 1 */
};

/* Bytes of an entry, with those for sorting it. */
enum { EXACT_ENTRY_BYTES = 3 * sizeof(uint32_t) + sizeof(uint16_t) };

/* Returns the number of bundles that a number of rays is. */
static inline uint64_t exact_bundles(uint64_t rays)
{
    return (rays + BAKE_RAY_BUNDLE - 1) / BAKE_RAY_BUNDLE;
}

/* Returns how many entries buckets should have for a batch. If its rays cross more chunks than
 * that, it is traced in parts; a small one of rays far apart should not be. */
static inline uint64_t exact_bucket_entries(const struct bake_exact *exact, uint64_t rays)
{
    return 8 * (exact_bundles(rays) + exact->chunk_count) + 16384;
}

/* Sorts bundles [first, first + *count) of a batch into the buckets. If they do not fit, lowers
 * *count until they do. Errors: BSQ_ENOMEM, BSQ_EINTR. */
int bake_exact_sort_rays(const struct bake_exact *exact, const struct bake_ray_batch *batch,
                         uint64_t first, uint64_t *count, struct exact_buckets *buckets);
/* Returns the bytes that sorting needs besides the buckets. */
uint64_t bake_exact_buckets_scratch_bytes(const struct bake_exact *exact);

/* Memory for the chunks of one batch, or of several. */
struct bake_exact_sweep {
    struct bake_exact *exact;
    uint64_t most_rays; /* of a batch; 0: a single batch */
    struct exact_slots slots;
};

/* ---- normals and colours ---- */

/* Evaluates the normal and colour of a ray's hit, which must lie in the slot's chunk. Tracing left
 * its barycentric weights in normal[0] and normal[1]. */
int bake_exact_shade(const struct bake_exact *exact, const struct exact_slot *slot,
                     const struct bake_ray_batch *batch, uint64_t ray);

#endif
