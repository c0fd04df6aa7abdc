/* mikkt_topology.c - welds corners with a hash table, and pairs edges with two counting sorts.
 *
 * Both are linear in the number of corners for any mesh: poles with many triangles and edges that
 * many triangles share cost no more than others. */
#include "libbake/lowpoly/mikkt.h"

#include <string.h>

/* ---- welding ---- */

static uint64_t mix_floats(uint64_t hash, const float *values, int count)
{
    for (int k = 0; k < count; k++) {
        float value = values[k] + 0.0f; /* -0 becomes 0 */
        uint32_t bits;
        memcpy(&bits, &value, sizeof(bits));
        hash = (hash ^ bits) * 0x9e3779b97f4a7c15u;
        hash ^= hash >> 32;
    }
    return hash;
}

static uint64_t hash_corner(const struct mikkt_input *input, uint32_t corner)
{
    uint64_t hash = mix_floats(1, input->positions[corner], 3);
    if (input->normals)
        hash = mix_floats(hash, input->normals[corner], 3);
    return input->texcoords ? mix_floats(hash, input->texcoords[corner], 2) : hash;
}

static bool equal_floats(const float *a, const float *b, int count)
{
    for (int k = 0; k < count; k++) {
        if (!(a[k] == b[k]))
            return false;
    }
    return true;
}

static bool equal_corners(const struct mikkt_input *input, uint32_t a, uint32_t b)
{
    return equal_floats(input->positions[a], input->positions[b], 3) &&
           (!input->normals || equal_floats(input->normals[a], input->normals[b], 3)) &&
           (!input->texcoords || equal_floats(input->texcoords[a], input->texcoords[b], 2));
}

int bake_mikkt_weld(struct bsq_ctx *ctx, const struct mikkt_input *input, uint32_t *vertices)
{
    uint32_t *table = NULL;
    uint64_t capacity = 16, steps = 0; /* a mesh can be made so that hashes collide */

    while (capacity < 2 * (uint64_t)input->corner_count)
        capacity *= 2;
    int status = bsq_alloc(ctx, "vertex table", capacity, sizeof(*table), &table);
    if (status < 0)
        return status;
    memset(table, 0xff, capacity * sizeof(*table));
    for (uint32_t c = 0; c < input->corner_count && status == 0; c++) {
        uint64_t slot = hash_corner(input, c) & (capacity - 1);
        for (; table[slot] != MIKKT_NONE && !equal_corners(input, table[slot], c) && status == 0;
             slot = (slot + 1) & (capacity - 1))
            status = ++steps % MIKKT_CORNERS_A_CHECK == 0 ? bsq_check(ctx) : 0;
        if (table[slot] == MIKKT_NONE)
            table[slot] = c;
        vertices[c] = table[slot];
        if (status == 0 && ++steps % MIKKT_CORNERS_A_CHECK == 0)
            status = bsq_check(ctx);
    }
    bsq_free(ctx, table);
    return status;
}

/* ---- twins ---- */

struct edge_ends {
    uint32_t low, high; /* vertices, ordered by number */
};

static struct edge_ends ends_of(const uint32_t *vertices, uint32_t edge)
{
    uint32_t a = vertices[edge], b = vertices[mikkt_next(edge)];
    return a < b ? (struct edge_ends){a, b} : (struct edge_ends){b, a};
}

/* Sorts edge numbers by their higher or lower vertex with a stable counting sort. from NULL: all
 * edges in order. starts: scratch memory of count + 1 entries; vertices are numbered by corners. */
static void sort_edges(uint32_t count, const uint32_t *vertices, bool by_high, const uint32_t *from,
                       uint32_t *to, uint32_t *starts)
{
    memset(starts, 0, ((size_t)count + 1) * sizeof(*starts));
    for (uint32_t e = 0; e < count; e++) {
        struct edge_ends ends = ends_of(vertices, e);
        starts[(by_high ? ends.high : ends.low) + 1]++;
    }
    for (uint32_t v = 0; v < count; v++)
        starts[v + 1] += starts[v];
    for (uint32_t n = 0; n < count; n++) {
        uint32_t e = from ? from[n] : n;
        struct edge_ends ends = ends_of(vertices, e);
        to[starts[by_high ? ends.high : ends.low]++] = e;
    }
}

/* Pairs edges that all connect the same two vertices. Each edge is paired with the first unpaired
 * one of the opposite direction. Unpaired edges all have the same direction, so one cursor does. */
static void pair_edges(const uint32_t *edges, uint32_t count, const uint32_t *vertices,
                       uint32_t *twins)
{
    uint32_t unpaired = 0;

    for (uint32_t n = 0; n < count; n++) {
        while (unpaired < n && twins[edges[unpaired]] != MIKKT_NONE)
            unpaired++;
        if (unpaired < n && vertices[edges[unpaired]] != vertices[edges[n]]) {
            twins[edges[unpaired]] = edges[n];
            twins[edges[n]] = edges[unpaired];
        }
    }
}

static void pair_sorted(const struct mikkt_input *input, const uint32_t *vertices, uint32_t *order,
                        uint32_t *twins)
{
    uint32_t kept = 0;

    for (uint32_t n = 0; n < input->corner_count; n++) {
        if (!mikkt_is_degenerate(input, order[n] / 3))
            order[kept++] = order[n];
    }
    for (uint32_t begin = 0, end; begin < kept; begin = end) {
        struct edge_ends ends = ends_of(vertices, order[begin]);
        for (end = begin + 1; end < kept; end++) {
            struct edge_ends other = ends_of(vertices, order[end]);
            if (other.low != ends.low || other.high != ends.high)
                break;
        }
        pair_edges(order + begin, end - begin, vertices, twins);
    }
}

int bake_mikkt_find_twins(struct bsq_ctx *ctx, const struct mikkt_input *input,
                          const uint32_t *vertices, uint32_t *twins)
{
    const uint32_t corner_count = input->corner_count;
    uint32_t *by_high = NULL, *by_both = NULL, *starts = NULL;

    int status = 0;
    BSQ_TRY(bsq_alloc(ctx, "edge order", corner_count, sizeof(*by_high), &by_high));
    BSQ_TRY(bsq_alloc(ctx, "edge order", corner_count, sizeof(*by_both), &by_both));
    BSQ_TRY(bsq_alloc(ctx, "edge order", (uint64_t)corner_count + 1, sizeof(*starts), &starts));
    sort_edges(corner_count, vertices, true, NULL, by_high, starts);
    BSQ_TRY(bsq_check(ctx));
    sort_edges(corner_count, vertices, false, by_high, by_both, starts);
    BSQ_TRY(bsq_check(ctx));
    memset(twins, 0xff, (size_t)corner_count * sizeof(*twins));
    pair_sorted(input, vertices, by_both, twins);
done:
    bsq_free(ctx, starts);
    bsq_free(ctx, by_both);
    bsq_free(ctx, by_high);
    return status;
}
