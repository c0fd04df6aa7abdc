/* exact_scene.h - what the parts of the exact tracer share: the opened scan, slots for
 * chunks in memory, and the lists of rays by chunk. */
#ifndef BAKE_EXACT_EXACT_SCENE_H
#define BAKE_EXACT_EXACT_SCENE_H

#include <math.h>
#include <pthread.h>

#include "base/positions.h"
#include "base/smooth_normals.h"
#include "formats/texture/texture.h"
#include "formats/chunks/tris.h"
#include "libbake/exact/exact.h"
#include "libbake/exact/exact_tree.h"

struct bake_exact {
    struct bsq_ctx *ctx;
    struct bake_exact_options options;
    struct bake_exact_info info;
    struct fmt_tris_file *file;
    const struct fmt_tris_header *header;
    const struct fmt_tris_chunk_info *chunks;
    uint32_t chunk_count;
    struct exact_tree tree; /* over the chunks' bounds */
    void *tree_memory;
    bool color;
    struct fmt_textures *textures;
    float (*diffuse)[3]; /* linear light, of each material */
};

static inline uint64_t exact_left_of_budget(const struct bsq_ctx *ctx)
{
    uint64_t limit = bsq_memory_limit(ctx), used = bsq_memory_used(ctx);
    return used < limit ? limit - used : 0;
}

/* ---- a chunk in memory ---- */

/* Sums of normals by position, see exact_smooth.c. */
struct exact_smooth {
    struct bsq_positions table; /* of positions */
    uint32_t *entry_of;         /* of each vertex of the chunk, + 1; 0: not needed */
    float (*positions)[3];
    double (*sums)[4]; /* of one-rings (base/smooth_normals.h), by entry_of; 0: not needed */
    uint32_t count;
};

struct exact_slot {
    uint32_t number; /* of the chunk */
    bool loaded;
    struct fmt_tris_chunk chunk;
    struct exact_tree tree;
    struct exact_smooth smooth;
    void *chunk_memory, *tree_memory, *smooth_memory;
};

/* Buffers of one worker while it prepares a slot. */
struct exact_scratch {
    void *boxes;     /* of a chunk's triangles */
    void *keys;      /* for sorting them */
    void *neighbour; /* another chunk */
    uint32_t *map;   /* of its vertices */
    uint32_t *near;  /* chunk numbers, chunk_count of them */
};

/* Loads a chunk into the slot, and makes its tree. */
int bake_exact_slot_load(const struct bake_exact *exact, uint32_t number, struct exact_slot *slot);
void bake_exact_slot_build(struct exact_slot *slot, const struct exact_scratch *scratch);

/* The nearest hit so far of one ray. */
struct exact_best {
    double t;
    uint64_t triangle;
    float w1, w2;
};
/* a wins over b: nearer, else in front, else of the lower number. */
static inline bool exact_wins(double t, uint64_t triangle, double other_t, uint64_t other_triangle)
{
    if (fabs(t) != fabs(other_t))
        return fabs(t) < fabs(other_t);
    if ((t < 0) != (other_t < 0))
        return other_t < 0;
    return triangle < other_triangle;
}

struct exact_limits {
    double t_min, t_max;
    bool against, two_sided;
};

/* Improves *best by the chunk's triangles; true where it did. first: number of the chunk's first
 * triangle. */
bool bake_exact_slot_trace(const struct exact_slot *slot, uint64_t first,
                           const struct bake_exact_ray *ray, const struct exact_limits *limits,
                           struct exact_best *best);

/* ---- rays by chunk ---- */

/* Rays of chunk c: rays[starts[c]] .. rays[starts[c + 1] - 1], ascending. */
struct exact_bins {
    uint32_t *rays;
    uint64_t capacity;
    uint64_t *starts; /* chunk_count + 1 */
};

/* Bins the rays [first, first + *count) of a batch; lowers *count where their pairs do not fit. */
int bake_exact_bin(const struct bake_exact *exact, const struct bake_exact_batch *batch,
                   uint64_t first, uint64_t *count, struct exact_bins *bins);
/* Bytes that binning needs besides the bins. */
uint64_t bake_exact_bin_bytes(const struct bake_exact *exact);

/* ---- attributes ---- */

uint64_t bake_exact_smooth_bytes(uint32_t vertices);
/* Starts collecting; then each vertex of the chunk whose normal is needed; then the sums. */
void bake_exact_smooth_begin(struct exact_slot *slot);
void bake_exact_smooth_need(struct exact_slot *slot, uint32_t vertex);
int bake_exact_smooth_sum(const struct bake_exact *exact, struct exact_slot *slot,
                          const struct exact_scratch *scratch);

/* Turns hits that hold barycentric weights in normal[0 .. 1] into normals and colours. */
int bake_exact_shade(const struct bake_exact *exact, const struct exact_slot *slot,
                     const struct bake_exact_batch *batch, uint64_t ray);

#endif
