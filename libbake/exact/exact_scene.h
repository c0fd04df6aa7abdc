/* exact_scene.h - what the files of this folder share; private to it: the opened scan, slots for
 * chunks in memory, and buckets of rays. */
#ifndef BAKE_EXACT_EXACT_SCENE_H
#define BAKE_EXACT_EXACT_SCENE_H

#include <math.h>
#include <pthread.h>

#include "base/geometry/positions.h"
#include "base/simd/simd.h"
#include "base/geometry/smooth_normals.h"
#include "formats/shading/shading.h"
#include "libbake/exact/exact.h"
#include "libbake/exact/exact_tree.h"

struct bake_exact {
    struct bsq_ctx *ctx;
    struct bake_exact_options options;
    struct fmt_tris_file *file;
    const struct fmt_tris_header *header;
    const struct fmt_tris_chunk_info *chunks;
    uint32_t chunk_count;
    enum bsq_simd simd;     /* instructions for tracing */
    struct exact_tree tree; /* over the chunks' bounds */
    void *tree_memory;
    struct fmt_shading shading;     /* its channels are those of transfer maps */
    struct bake_area_point *points; /* chunk_points of each chunk; NULL: they are not wanted */
    uint32_t chunk_points;
    _Atomic uint64_t *loads; /* number of chunks that were loaded, counted again each time */
};

/* Returns the number of values that the channels of a hit have. */
static inline uint64_t exact_transfer_floats(const struct bake_exact *exact)
{
    const uint32_t count = exact->shading.attribute_count;
    return count > 0 ? (uint64_t)BK_TRANSFER_VALUES * (count - FMT_SHADING_CHANNELS) : 0;
}

/* Returns the number after the last chunk that a batch meets. */
static inline uint32_t exact_end_chunk(const struct bake_exact *exact,
                                       const struct bake_exact_batch *batch)
{
    return batch->sweep ? batch->end_chunk : exact->chunk_count;
}

enum { EXACT_LOCKS = 256 /* over the hits */, EXACT_SLOTS_A_THREAD = 2 };

/* Returns the slots of a wave: two a thread, so that all threads are busy until it ends, and chunks
 * stay in the cache from one step to the next. */
static inline uint32_t exact_wave_slots(const struct bake_exact *exact)
{
    return EXACT_SLOTS_A_THREAD * bsq_threads(exact->ctx);
}

/* Returns whether hits need vertex normals that have to be summed. */
static inline bool exact_needs_smooth(const struct bake_exact *exact)
{
    return !(exact->header->attributes & FMT_TRIS_NORMALS) &&
           exact->options.normals != BSQ_SCAN_NORMALS_FLAT;
}

/* ---- a chunk in memory ---- */

/* Triangles, and positions, whose common bounds are kept; and triangles of a leaf of the tree. */
enum { EXACT_GROUP = BSQ_POSITIONS_BATCH, EXACT_RUN = 8 };

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

struct exact_chunk {
    struct fmt_tris_chunk tris;
    struct exact_box *groups; /* bounds of each EXACT_GROUP triangles; NULL: not set */
};

/* Sums of normals by position; see exact_smooth.c. */
struct exact_smooth {
    struct bsq_positions table;
    uint64_t *filter;   /* of positions in the table */
    uint32_t *entry_of; /* of each vertex of the chunk: index into sums[]; 0: not needed */
    float (*positions)[3];
    struct exact_box *groups; /* bounds of each EXACT_GROUP positions */
    struct exact_box *shared; /* of those of them that are in another chunk */
    /* Of one-rings (base/geometry/smooth_normals.h), from index 1: two rows each, and of creases
     * likewise.
     */
    double (*sums)[4], (*creases)[4], (*seconds)[4];
    uint32_t *crease_of; /* 0: no crease */
    uint32_t count;
};

enum { EXACT_RING_ROWS = 2 }; /* weighted normals; unit normals */

/* Returns the number of groups of positions. */
static inline uint32_t exact_groups(uint32_t positions)
{
    return (positions + EXACT_GROUP - 1) / EXACT_GROUP;
}

/* Most positions that are looked up are not in the table. Two bits of a word tell so of nearly all
 * of them without a look at the table, which is too large for a small cache (Bloom, "Space/Time
 * Trade-offs in Hash Coding with Allowable Errors", 1970). */
static inline uint64_t *exact_filter_word(const struct exact_smooth *s, uint32_t hash)
{
    return &s->filter[(hash & s->table.mask) / 64];
}

static inline uint64_t exact_filter_bits(uint32_t hash)
{
    return UINT64_C(1) << hash % 64 | UINT64_C(1) << (hash >> 26);
}

/* Memory for a chunk, and what is computed from it. */
struct exact_slot {
    uint32_t number; /* of the chunk */
    bool loaded;
    struct exact_chunk chunk;
    struct exact_tree tree;
    struct exact_box8 *runs; /* boxes of their triangles; NULL: these are not kept */
    struct exact_smooth smooth;
    void *chunk_memory, *tree_memory, *smooth_memory;
    bool needed;    /* has hits whose normals are summed */
    uint32_t *near; /* chunks with triangles at vertices whose normals are summed, ascending */
    uint32_t near_count;
};

/* Buffers of a thread while it prepares a slot. */
struct exact_scratch {
    void *boxes;     /* of a chunk's runs */
    void *neighbour; /* another chunk */
    uint32_t *map;   /* of its vertices */
};

/* The slots of a wave of chunks. */
struct exact_slots {
    uint32_t count, preparers; /* slots; threads that may prepare them at the same time */
    struct exact_slot *slots;
    struct exact_scratch *scratches; /* of each preparer */
    void *memory;                    /* holds the buffers of all slots and scratches */
};

/* Allocates 1 to `most` slots, as many as fit `memory` bytes. runs: the boxes of triangles are
 * kept. Free them, also after a failure. */
int bake_exact_slots_create(const struct bake_exact *exact, uint32_t most, uint64_t memory,
                            bool runs, struct exact_slots *out);
void bake_exact_slots_free(struct bsq_ctx *ctx, struct exact_slots *slots);

/* Takes the points of a chunk that has just been loaded, unless they were taken before. */
void bake_exact_take_areas(const struct bake_exact *exact, uint32_t number,
                           const struct fmt_tris_chunk *chunk);

/* Returns the bytes of memory that any chunk fits. */
uint64_t bake_exact_chunk_bytes(const struct bake_exact *exact);
/* Loads a chunk. Errors: those of fmt_tris_load(). */
int bake_exact_load(const struct bake_exact *exact, uint32_t number, void *memory,
                    struct exact_chunk *out);
/* Sets the groups of a chunk that was loaded into `memory`, unless they are set. */
void bake_exact_set_groups(const struct bake_exact *exact, void *memory, struct exact_chunk *chunk);
/* Loads the chunk of a slot, or its sample, unless it is loaded, and builds the tree of the bounds
 * of each EXACT_RUN triangles. Workers may prepare different slots at the same time. */
int bake_exact_slot_prepare(const struct bake_exact *exact, const struct exact_slots *slots,
                            bool sampled, uint64_t index, unsigned worker);
/* Returns the buffers of a worker that prepares a slot. */
const struct exact_scratch *bake_exact_scratch(const struct bake_exact *exact,
                                               const struct exact_slots *slots, uint64_t slot,
                                               unsigned worker);

/* The hit of a ray that wins so far. */
struct exact_best {
    double t;
    uint64_t triangle;
    float w1, w2; /* barycentric weights of the second and third corner */
    double reach; /* of the ray */
};
/* Returns whether a hit wins over another: that with the lower bake_ray_cost(), then the outer one,
 * then the one with the lower triangle number. */
static inline bool exact_wins(double t, uint64_t triangle, double other_t, uint64_t other_triangle,
                              double reach)
{
    const double cost = bake_ray_cost(t, reach), other_cost = bake_ray_cost(other_t, reach);
    if (cost != other_cost)
        return cost < other_cost;
    return t != other_t ? t > other_t : triangle < other_triangle;
}

/* Limits that a hit must meet to count. */
struct exact_limits {
    double t_min, t_max, gap;
    bool facing_origin, two_sided; /* as in struct bake_exact_batch and bake_exact_options */
    bool any;                      /* the first hit that is found will do */
    bool from_reach;               /* as in struct bake_exact_batch */
};

/* Replaces best[i] of `count` rays, at most BAKE_EXACT_BUNDLE, by the nearest hit among the chunk's
 * triangles, if that wins. Returns a bit mask of the rays whose hit was replaced. first: number of
 * the chunk's first triangle. */
typedef unsigned bake_exact_slot_trace_fn(const struct exact_slot *slot, uint64_t first,
                                          const struct bake_exact_ray *rays, uint32_t count,
                                          const struct exact_limits *limits,
                                          struct exact_best *best);
BSQ_SIMD_DECLARE(bake_exact_slot_trace_fn, bake_exact_slot_trace);

/* Chunks in memory, with a tree over their bounds. */
struct exact_group {
    const struct bake_exact *exact;
    const struct exact_slot *slots;
    struct exact_tree tree;
};

/* Does what bake_exact_slot_trace() does with the triangles of all slots of the group. */
typedef bool bake_exact_group_trace_fn(const struct exact_group *group,
                                       const struct bake_exact_ray *ray,
                                       const struct exact_limits *limits, struct exact_best *best);
BSQ_SIMD_DECLARE(bake_exact_group_trace_fn, bake_exact_group_trace);

/* Writes the numbers of the boxes that rays, at most BAKE_EXACT_BUNDLE, cross between t_min and
 * t_max to out[], ascending, and returns their count. Boxes near the rays may be among them. boxes:
 * `count` of them, by eights. out: space for count + 7 numbers. */
typedef uint32_t bake_exact_crossed_fn(const struct bake_exact_ray *rays, uint32_t ray_count,
                                       double t_min, double t_max, const struct exact_box8 *boxes,
                                       uint32_t count, uint32_t *out);
BSQ_SIMD_DECLARE(bake_exact_crossed_fn, bake_exact_crossed);

/* Checks whether the winding of a triangle disagrees with its vertex normals. The normals then
 * decide which side is outside. False if the chunk has no normals. */
bool bake_exact_wound_backwards(const struct fmt_tris_chunk *chunk, uint32_t triangle);

/* ---- rays by chunk ---- */

/* Bundles for which candidate chunks are looked up together. */
enum { EXACT_SORTED = 4 };

/* The bundles of rays that cross each chunk: those of chunk c are entries starts[c] to
 * starts[c + 1] - 1, ascending. */
struct exact_buckets {
    uint32_t *bundles;
    uint16_t *found; /* of each entry: bit i: tracing took a hit for ray i of the bundle */
    uint64_t capacity;
    uint64_t *starts;         /* chunk_count + 1 */
    struct exact_box *around; /* what the rays of each EXACT_SORTED bundles cross */
};

/* Returns the number of bundles that a number of rays is. */
static inline uint64_t exact_bundles(uint64_t rays)
{
    return (rays + BAKE_EXACT_BUNDLE - 1) / BAKE_EXACT_BUNDLE;
}

/* Returns how many entries buckets should have for a batch. If its rays cross more chunks than
 * that, it is traced in parts; a small one of rays far apart should not be. */
static inline uint64_t exact_bucket_entries(const struct bake_exact *exact, uint64_t rays)
{
    return 8 * (exact_bundles(rays) + exact->chunk_count) + 16384;
}

/* Sorts bundles [first, first + *count) of a batch into the buckets. If they do not fit, lowers
 * *count until they do. Errors: BSQ_ENOMEM, BSQ_EINTR. */
int bake_exact_sort_rays(const struct bake_exact *exact, const struct bake_exact_batch *batch,
                         uint64_t first, uint64_t *count, struct exact_buckets *buckets);
/* Returns the bytes that sorting needs besides the buckets. */
uint64_t bake_exact_buckets_scratch_bytes(const struct bake_exact *exact);

/* ---- chunks that are kept ---- */

/* Memory for a chunk that other chunks need. */
struct exact_kept_entry {
    uint32_t number; /* of the chunk */
    uint32_t next;   /* chunk with which it is used next */
    bool used;       /* holds a chunk */
    bool needed;     /* by the current wave */
    uint32_t place;  /* in the heap */
    struct exact_chunk chunk;
    void *memory;
};
/* Chunks in memory beside those of a wave. */
struct exact_kept {
    const struct bake_exact *exact;
    const uint64_t *starts; /* of the buckets, see below */
    uint32_t end;           /* chunks from here on belong to later batches */
    uint32_t count;         /* of entries; 0: none is kept */
    struct exact_kept_entry *entries;
    uint32_t *heap;     /* numbers of entries: the one to give up first is on top */
    uint32_t *near;     /* chunk_count numbers */
    uint32_t *entry_of; /* of each chunk: the last entry that it had, or 0 */
    char *memory;
};
/* Makes entries for chunks: takes up to three quarters of what is left of the budget. Free them,
 * also after a failure. Errors: BSQ_ENOMEM. */
int bake_exact_kept_create(const struct bake_exact *exact, struct exact_kept *out);
void bake_exact_kept_free(struct bsq_ctx *ctx, struct exact_kept *kept);
/* Returns a chunk, or NULL if it is not kept. Thread-safe while nothing else is called. */
const struct exact_chunk *bake_exact_kept_find(const struct exact_kept *kept, uint32_t number);
/* Moves the chunk with the slot's number into the slot. Returns false if it is not kept. */
bool bake_exact_kept_take(struct exact_kept *kept, struct exact_slot *slot);
/* Loads the chunks that are near those of a wave, as many as fit. Must not be called from parallel
 * work. Errors: those of fmt_tris_load(). */
int bake_exact_kept_load(struct exact_kept *kept, const struct exact_slots *wave, uint32_t used);
/* Keeps those chunks that are used soonest, of these and of the wave. */
void bake_exact_kept_end_wave(struct exact_kept *kept, const struct exact_slots *wave,
                              uint32_t used);

/* Memory for the chunks of one batch, or of several. */
struct bake_exact_sweep {
    struct bake_exact *exact;
    uint64_t most_rays; /* of a batch; 0: a single batch */
    struct exact_slots slots;
    struct exact_kept kept;
};

/* ---- normals and colours ---- */

/* Returns the bytes of smooth_memory for a chunk with this many vertices. */
uint64_t bake_exact_smooth_bytes(uint32_t vertices);
/* Forgets which vertex normals of the slot's chunk are needed. Overwrites its tree. */
void bake_exact_smooth_begin(struct exact_slot *slot);
/* Makes bake_exact_smooth_sum() sum the normal of a vertex. */
void bake_exact_smooth_need(struct exact_slot *slot, uint32_t vertex);
/* Lists the chunks with triangles at these vertices in the slot's near[]. */
typedef void bake_exact_smooth_find_near_fn(const struct bake_exact *exact,
                                            struct exact_slot *slot);
BSQ_SIMD_DECLARE(bake_exact_smooth_find_near_fn, bake_exact_smooth_find_near);

/* Sums of a slot, and what they are made of. */
struct exact_summing {
    const struct bake_exact *exact;
    struct exact_slot *slot;
    const struct exact_slot *wave; /* slots whose chunks are in memory, if they are loaded */
    uint32_t wave_count;
    const struct exact_kept *kept;
    const struct exact_scratch *scratch;
};
/* Sums the normals of the vertices that are needed, and of both sides of creases. Workers may do so
 * for different slots at the same time. Errors: those of fmt_tris_load(); BSQ_EINTR. */
typedef int bake_exact_smooth_sum_fn(const struct exact_summing *of);
BSQ_SIMD_DECLARE(bake_exact_smooth_sum_fn, bake_exact_smooth_sum);

/* Evaluates the normal and colour of a ray's hit, which must lie in the slot's chunk. Tracing left
 * its barycentric weights in normal[0] and normal[1]. */
int bake_exact_shade(const struct bake_exact *exact, const struct exact_slot *slot,
                     const struct bake_exact_batch *batch, uint64_t ray);

#endif
