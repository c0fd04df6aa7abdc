/* vertex_buckets.c - see vertex_buckets.h. */
#include "libvoxel/partition/vertex_buckets.h"

#include <string.h>

#define BLOCK_VERTICES 8192u

/* Vertices have an order if fewer than one in eight changes the bucket. */
#define VERTICES_BY_CHANGE 8
/* Runs are searched, so they must take half of the memory of two bytes a vertex at most. */
#define VERTICES_BY_RUN 8

static const char what[] = "buckets of vertices";

/* Vertices that are read at once, and what is known of those up to them. */
struct vertex_block {
    uint64_t first;
    uint32_t count;
    float positions[BLOCK_VERTICES][3];
    uint32_t buckets[BLOCK_VERTICES];
    uint32_t last;    /* bucket of the last vertex */
    uint64_t changes; /* vertices in another bucket than the one before */
    uint64_t occupied[(1u << 3 * VERTEX_BUCKET_WIDE_LEVELS) / 64]; /* a bit for each bucket */
};

/* ---- reading ---- */

/* Reads the next block of vertices and finds their buckets. */
static int read_vertices(const struct scan *scan, const struct morton_cube *cube, uint32_t levels,
                         struct vertex_block *block)
{
    const struct attribute_stream *stream = &scan->streams[SCAN_POSITIONS];
    block->first += block->count;
    const uint64_t left = stream->count - block->first;
    block->count = left < BLOCK_VERTICES ? (uint32_t)left : BLOCK_VERTICES;
    BSQ_PASS(bsq_check(scan->ctx));
    BSQ_PASS(stream_read(stream, block->first, block->count, block->positions));
    for (uint32_t i = 0; i < block->count; i++) {
        const uint32_t bucket = morton_cell(cube, levels, block->positions[i]);
        block->buckets[i] = bucket;
        if (bucket == block->last && block->first + i > 0)
            continue;
        block->last = bucket;
        block->changes++;
        block->occupied[bucket / 64] |= (uint64_t)1 << bucket % 64;
    }
    return 0;
}

/* Counts the buckets that have vertices, on each level. */
static void count_occupied(const struct vertex_block *block, struct vertex_buckets *out)
{
    uint32_t before[VERTEX_BUCKET_WIDE_LEVELS + 1];
    memset(before, 0xff, sizeof before);
    for (uint32_t b = 0; b < 1u << 3 * out->levels; b++)
        for (uint32_t level = 0; block->occupied[b / 64] >> b % 64 & 1 && level <= out->levels;
             level++) {
            const uint32_t bucket = b >> 3 * (out->levels - level);
            out->occupied[level] += bucket != before[level];
            before[level] = bucket;
        }
}

/* ---- runs ---- */

static uint64_t first_run_bytes(const struct scan *scan)
{
    return (scan_count(scan, SCAN_POSITIONS) / VERTEX_RUN_VERTICES + 1) * sizeof(uint32_t);
}

/* Adds a block to the runs. Returns false if there are more than `most`. */
static bool vertices_add_runs(struct vertex_buckets *out, const struct vertex_block *block,
                              uint64_t most)
{
    if (block->changes > most)
        return false;
    for (uint32_t i = 0; i < block->count; i++) {
        const uint64_t vertex = block->first + i, bucket = block->buckets[i];
        if (out->run_count == 0 || (out->runs[out->run_count - 1] & VERTEX_RUN_MASK) != bucket)
            out->runs[out->run_count++] = vertex << VERTEX_RUN_BITS | bucket;
        if (vertex % VERTEX_RUN_VERTICES == 0)
            out->first_runs[vertex / VERTEX_RUN_VERTICES] = (uint32_t)(out->run_count - 1);
    }
    return true;
}

/* Ends the runs with an entry after all vertices, in memory of their size. */
static int end_runs(const struct scan *scan, struct vertex_buckets *out)
{
    uint64_t *runs = NULL;
    BSQ_PASS(BSQ_ALLOC(scan->ctx, what, out->run_count + 1, &runs));
    memcpy(runs, out->runs, out->run_count * sizeof *runs);
    runs[out->run_count] = UINT64_MAX;
    bsq_free(scan->ctx, out->runs);
    out->runs = runs;
    out->bytes = first_run_bytes(scan) + (out->run_count + 1) * sizeof *runs;
    return 0;
}

/* Makes a table of runs, unless there are too many. *made: the table is complete. */
static int make_runs(const struct scan *scan, const struct morton_cube *cube, uint64_t bytes,
                     struct vertex_block *block, struct vertex_buckets *out, bool *made)
{
    const uint64_t vertices = scan_count(scan, SCAN_POSITIONS);
    const uint64_t others = first_run_bytes(scan) + sizeof *out->runs;
    /* They are copied once. */
    uint64_t most = bytes > others ? (bytes - others) / 2 / sizeof *out->runs : 0;
    most = most < vertices / VERTICES_BY_RUN ? most : vertices / VERTICES_BY_RUN;
    *made = most > 0;
    BSQ_PASS(BSQ_ALLOC(scan->ctx, what, most, &out->runs));
    BSQ_PASS(bsq_alloc(scan->ctx, what, first_run_bytes(scan), 1, &out->first_runs));
    while (*made && block->first + block->count < vertices) {
        BSQ_PASS(read_vertices(scan, cube, out->levels, block));
        *made = vertices_add_runs(out, block, most);
    }
    return *made ? end_runs(scan, out) : 0;
}

/* ---- tables ---- */

/* Makes a table with an entry for each vertex. */
static int vertices_make_entries(const struct scan *scan, const struct morton_cube *cube,
                                 struct vertex_block *block, struct vertex_buckets *out)
{
    const uint64_t vertices = scan_count(scan, SCAN_POSITIONS);
    if (out->levels > VERTEX_BUCKET_NARROW_LEVELS)
        BSQ_PASS(BSQ_ALLOC(scan->ctx, what, vertices, &out->wide));
    else
        BSQ_PASS(BSQ_ALLOC(scan->ctx, what, vertices, &out->narrow));
    while (block->first + block->count < vertices) {
        BSQ_PASS(read_vertices(scan, cube, out->levels, block));
        for (uint32_t i = 0; i < block->count; i++)
            if (out->wide)
                out->wide[block->first + i] = (uint16_t)block->buckets[i];
            else
                out->narrow[block->first + i] = (uint8_t)block->buckets[i];
    }
    return 0;
}

/* Returns the levels of a table with an entry for each vertex, or 0 if none is that small. */
static uint32_t levels_of_entries(uint64_t vertices, uint32_t levels, uint64_t bytes)
{
    if (levels > VERTEX_BUCKET_NARROW_LEVELS && sizeof(uint16_t) * vertices <= bytes)
        return levels;
    if (vertices > bytes)
        return 0;
    return levels < VERTEX_BUCKET_NARROW_LEVELS ? levels : VERTEX_BUCKET_NARROW_LEVELS;
}

/* The bits and ranks of chunk/gather_window.h take nearly a quarter of a byte for each vertex, so
 * there must be as much memory, however small the table is. */
int vox_vertex_buckets_make(const struct scan *scan, const struct morton_cube *cube,
                            uint32_t levels, uint64_t bytes, struct vertex_buckets *out)
{
    const uint64_t vertices = scan_count(scan, SCAN_POSITIONS);
    struct vertex_block *block = NULL;
    bool made = false;
    int status;
    *out = (struct vertex_buckets){.levels = levels};
    BSQ_TRY(BSQ_CALLOC(scan->ctx, what, 1, &block));
    if (vertices / 4 <= bytes)
        BSQ_TRY(make_runs(scan, cube, bytes, block, out, &made));
    if (!made) {
        vox_vertex_buckets_free(scan, out);
        memset(block, 0, sizeof *block);
        out->levels = levels_of_entries(vertices, levels, bytes);
        out->bytes = vertices * (out->levels > VERTEX_BUCKET_NARROW_LEVELS ? 2 : 1);
        status = out->levels > 0 ? vertices_make_entries(scan, cube, block, out) : 0;
    }
    out->have_order = block->changes < vertices / VERTICES_BY_CHANGE;
    count_occupied(block, out);
done:
    bsq_free(scan->ctx, block);
    return status;
}

void vox_vertex_buckets_coarsen(const struct scan *scan, struct vertex_buckets *buckets,
                                uint32_t levels)
{
    const uint32_t shift = 3 * (buckets->levels - levels);
    const uint64_t vertices = scan_count(scan, SCAN_POSITIONS);
    buckets->levels = levels;
    for (uint64_t i = 0; i < buckets->run_count; i++)
        buckets->runs[i] =
            (buckets->runs[i] & ~VERTEX_RUN_MASK) | (buckets->runs[i] & VERTEX_RUN_MASK) >> shift;
    for (uint64_t v = 0; buckets->wide && v < vertices; v++)
        buckets->wide[v] = (uint16_t)(buckets->wide[v] >> shift);
    for (uint64_t v = 0; buckets->narrow && v < vertices; v++)
        buckets->narrow[v] = (uint8_t)(buckets->narrow[v] >> shift);
}

void vox_vertex_buckets_free(const struct scan *scan, struct vertex_buckets *buckets)
{
    BSQ_FREE(scan->ctx, buckets->wide, buckets->narrow, buckets->runs, buckets->first_runs);
    *buckets = (struct vertex_buckets){0};
}
