/* cover.c - see cover.h.
 *
 * What counts of an edge depends on the positions of its ends alone, so both triangles at it decide
 * alike, in whatever chunks they are. Sums are integers, so their order does not matter. */
#include "libvoxel/simplify/cover.h"

#include <stdatomic.h>
#include <string.h>

#include "libvoxel/simplify/distance_lanes.h"
#include "libvoxel/simplify/mesh.h"

struct vox_cover_sum {
    _Atomic uint64_t edges;  /* of hashes of directed edges; 0: all cancel */
    _Atomic uint64_t height; /* bits of the largest one */
    _Atomic int64_t turns;   /* how often the chain covers the middle */
};

static void add_block_vertex(struct vox_cover_block *block, const float position[3])
{
    const uint32_t v = block->vertex_count++;
    uint32_t bits[3];
    for (int k = 0; k < 3; k++) {
        const float x = position[k] + 0.0f; /* no -0 */
        memcpy(&bits[k], &x, sizeof x);
        block->points[k][v] = (double)x;
    }
    block->hashes[0][v] = vox_mix_bits(vox_mix_bits(bits[0] | (uint64_t)bits[1] << 32) + bits[2]);
    block->hashes[1][v] = vox_mix_bits(block->hashes[0][v] + UINT64_C(0x9e3779b97f4a7c15));
}

/* Grows the box of a block by a triangle. Returns false if it would have a side above `most`. */
static bool grow_cover_block(struct vox_cover_block *block, const float (*positions)[3],
                             const uint32_t corners[3], float most)
{
    struct vox_fours box = block->box;
    for (int i = 0; i < 3; i++)
        vox_grow_by_position(&box, positions[corners[i]]);
    const vox_four sides = box.high - box.low;
    if (sides[0] > most || sides[1] > most || sides[2] > most)
        return false;
    block->box = box;
    return true;
}

/* Returns whether the triangle may see an edge between a and b, whichever way it runs. */
static bool sees_edge(const struct vox_cover_block *block, const struct vox_cover_view *view,
                      uint32_t a, uint32_t b)
{
    const int64_t beyond_a = view->codes[a] & VOX_BEYOND_ALL,
                  beyond_b = view->codes[b] & VOX_BEYOND_ALL;
    unsigned left = 0, right = 0;
    if (beyond_a == 0 || beyond_b == 0 || (beyond_a & beyond_b))
        return !(beyond_a & beyond_b);
    const bool turned = block->hashes[0][a] > block->hashes[0][b];
    const uint32_t from = turned ? b : a, to = turned ? a : b;
    const double *x = view->across[0], *y = view->across[1];
    for (int i = 0; i < 3; i++) {
        const double side = (x[to] - x[from]) * (view->seen[i][1] - y[from]) -
                            (y[to] - y[from]) * (view->seen[i][0] - x[from]);
        left += side > 0;
        right += side < 0;
    }
    return left < 3 && right < 3;
}

/* Returns 1 if an edge from a to b crosses, upwards, a line from the middle to the right; -1
 * downwards. */
static int64_t count_crossing(const struct vox_cover_view *view, uint32_t a, uint32_t b)
{
    const int64_t codes = view->codes[a] ^ view->codes[b];
    if (!(codes & VOX_ABOVE_LINE))
        return 0;
    const bool up = view->codes[b] & VOX_ABOVE_LINE;
    if (!(codes & VOX_RIGHT_OF_LINE))
        return !(view->codes[a] & VOX_RIGHT_OF_LINE) ? 0 : up ? 1 : -1;
    const uint32_t low = up ? a : b, high = up ? b : a;
    const double *x = view->across[0], *y = view->across[1];
    const double share = (view->middle - y[low]) / (y[high] - y[low]);
    return !(x[low] + share * (x[high] - x[low]) > view->middle) ? 0 : up ? 1 : -1;
}

static void raise_bits(_Atomic uint64_t *kept, double value)
{
    uint64_t bits, old = atomic_load_explicit(kept, memory_order_relaxed);
    memcpy(&bits, &value, sizeof bits);
    while (bits > old && !atomic_compare_exchange_weak_explicit(
                             kept, &old, bits, memory_order_relaxed, memory_order_relaxed))
        ;
}

/* Adds the triangles of a block to the chain of a triangle of the mesh. */
static bool add_to_chain(void *arg, uint32_t triangle, double square)
{
    const struct vox_cover_block *block = arg;
    struct vox_cover_view view;
    const float *corners[3];
    uint64_t edges = 0;
    int64_t turns = 0;
    double height = -1;
    (void)square;
    vox_closest_corners(block->cover->tree, triangle, corners);
    view.middle = view.unit = 0;
    if (!BSQ_SIMD_PICK(block->cover->tree->level, vox_view_block)(
            block, corners, block->cover->height, block->cover->margin, &view))
        return false;
    for (uint32_t t = 0; t < block->triangle_count; t++) {
        const uint8_t *v = block->triangles[t];
        const int64_t a = view.codes[v[0]], b = view.codes[v[1]], c = view.codes[v[2]];
        if ((a & b & c & VOX_BEYOND_ALL) || ((a | b | c) & VOX_TOO_HIGH))
            continue;
        for (int k = 0; k < 3; k++) {
            const uint32_t from = v[k], to = v[(k + 1) % 3];
            height = view.heights[from] > height ? view.heights[from] : height;
            if (sees_edge(block, &view, from, to))
                edges += block->hashes[0][from] * block->hashes[1][to] -
                         block->hashes[0][to] * block->hashes[1][from];
            turns += count_crossing(&view, from, to);
        }
    }
    if (height < 0)
        return false;
    struct vox_cover_sum *sum = &block->cover->sums[triangle];
    atomic_fetch_add_explicit(&sum->edges, edges, memory_order_relaxed);
    atomic_fetch_add_explicit(&sum->turns, turns, memory_order_relaxed);
    raise_bits(&sum->height, height / view.unit);
    return false;
}

/* Fills a block with triangles of a chunk from number `begin` on, as long as it stays small.
 * blocks[v]: a vertex's number in the last block that it was in, below the number of the block.
 * Returns the end. */
static uint32_t fill_cover_block(const struct vox_cover *cover, const struct fmt_tris_chunk *chunk,
                                 uint32_t begin, uint64_t *blocks, struct vox_cover_block *block)
{
    const uint64_t number = ((uint64_t)begin + 1) << 8;
    uint32_t t = begin;
    block->cover = cover;
    block->triangle_count = block->vertex_count = 0;
    block->box = vox_no_box;
    for (; t < chunk->triangle_count && t - begin < VOX_BLOCK_TRIANGLES; t++) {
        const uint32_t *corners = chunk->triangles[t];
        if (!grow_cover_block(block, chunk->positions, corners,
                              t == begin ? INFINITY : (float)cover->reach))
            break;
        for (int k = 0; k < 3; k++) {
            uint64_t *at = &blocks[corners[k]];
            if (*at < number) {
                *at = number + block->vertex_count;
                add_block_vertex(block, chunk->positions[corners[k]]);
            }
            block->triangles[block->triangle_count][k] = (uint8_t)*at;
        }
        block->triangle_count++;
    }
    return t;
}

int vox_cover_add(struct bsq_ctx *ctx, const struct vox_cover *cover,
                  const struct fmt_tris_chunk *chunk, uint64_t *blocks)
{
    struct vox_cover_block block;
    memset(blocks, 0, chunk->vertex_count * sizeof *blocks);
    for (uint32_t t = 0; t < chunk->triangle_count;) {
        BSQ_PASS(bsq_check(ctx)); /* a block in the middle of a fan is near all of its triangles */
        t = fill_cover_block(cover, chunk, t, blocks, &block);
        vox_closest_near(cover->tree, (const float *)&block.box.low, (const float *)&block.box.high,
                         cover->height * cover->height, add_to_chain, &block);
    }
    return 0;
}

int vox_cover_begin(struct bsq_ctx *ctx, uint32_t triangle_count, struct vox_cover *cover)
{
    return BSQ_CALLOC(ctx, "sums of triangles", triangle_count, &cover->sums);
}

void vox_cover_free(struct bsq_ctx *ctx, struct vox_cover *cover)
{
    bsq_free(ctx, (void *)cover->sums);
    cover->sums = NULL;
}

/* Each point is near one that is seen: what is seen is the triangle, shrunk towards the middle of
 * its inscribed circle, whose radius is twice the area over the sum of the edges. */
double vox_cover_bound(const struct vox_cover *cover, uint32_t triangle)
{
    const struct vox_cover_sum *sum = &cover->sums[triangle];
    const uint64_t bits = sum->height;
    const float *c[3];
    double height, edges[2][3], normal[3], around = 0, longest = 0;
    memcpy(&height, &bits, sizeof height);
    vox_closest_corners(cover->tree, triangle, c);
    for (int k = 0; k < 3; k++) {
        const double edge = sqrt(vox_square_between(c[k], c[(k + 1) % 3]));
        around += edge;
        longest = fmax(longest, edge);
        edges[0][k] = (double)c[1][k] - (double)c[0][k];
        edges[1][k] = (double)c[2][k] - (double)c[0][k];
    }
    bsq_crossd(edges[0], edges[1], normal);
    const double share = cover->margin * around / sqrt(bsq_dotd(normal, normal));
    return sum->edges == 0 && sum->turns != 0 && share < 0.25 ? height + share * longest : INFINITY;
}
