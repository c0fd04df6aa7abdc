/* exact_smooth.c - smooth vertex normals of a chunk, as if the scan were whole.
 *
 * Vertices are the same where their positions are, in one chunk or in several. A vertex's normal is
 * the sum of the triangles' cross products around it, in the order of the file whatever
 * chunks they are in, so it is the same bit for bit as on the whole scan. Only normals that hits
 * ask for are summed, and only chunks that reach to those vertices are read. */
#include "libbake/exact_scene_internal.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#define NO_ENTRY UINT32_MAX

/* ---- memory ---- */

static uint32_t table_size(uint32_t vertices)
{
    uint32_t size = 16;
    while (size < 2 * vertices)
        size *= 2;
    return size;
}

uint64_t exact_smooth_bytes(uint32_t vertices)
{
    const struct exact_smooth *s = NULL;
    return table_size(vertices) * sizeof *s->table +
           (uint64_t)vertices * (sizeof *s->sums + sizeof *s->positions + sizeof *s->entry_of);
}

void exact_smooth_begin(struct exact_slot *slot)
{
    struct exact_smooth *s = &slot->smooth;
    const uint32_t vertices = slot->chunk.vertex_count, size = table_size(vertices);
    s->sums = slot->smooth_memory;
    s->positions = (float(*)[3])(void *)(s->sums + vertices);
    s->entry_of = (uint32_t *)(void *)(s->positions + vertices);
    s->table = s->entry_of + vertices;
    s->table_mask = size - 1;
    s->count = 0;
    memset(s->table, 0, size * sizeof *s->table);
    memset(s->entry_of, 0xff, vertices * sizeof *s->entry_of);
}

/* ---- vertices by position ---- */

static uint64_t hash(const float position[3])
{
    uint32_t bits[3];
    for (int k = 0; k < 3; k++) {
        float p = position[k] + 0.0f; /* one zero */
        memcpy(&bits[k], &p, sizeof p);
    }
    uint64_t h = (bits[0] | (uint64_t)bits[1] << 32) * UINT64_C(0x9e3779b97f4a7c15);
    h = (h ^ h >> 29 ^ bits[2]) * UINT64_C(0xbf58476d1ce4e5b9);
    return h ^ h >> 32;
}

/* Place in the table of the position, or of the gap where it would be. */
static uint32_t find(const struct exact_smooth *s, const float position[3])
{
    uint32_t at = (uint32_t)hash(position) & s->table_mask;
    for (; s->table[at] != 0; at = (at + 1) & s->table_mask) {
        const float *p = s->positions[s->table[at] - 1];
        if (p[0] == position[0] && p[1] == position[1] && p[2] == position[2])
            break;
    }
    return at;
}

void exact_smooth_need(struct exact_slot *slot, uint32_t vertex)
{
    struct exact_smooth *s = &slot->smooth;
    if (s->entry_of[vertex] != NO_ENTRY)
        return;
    const uint32_t at = find(s, slot->chunk.positions[vertex]);
    if (s->table[at] == 0) {
        memcpy(s->positions[s->count], slot->chunk.positions[vertex], sizeof *s->positions);
        memset(s->sums[s->count], 0, sizeof *s->sums);
        s->table[at] = ++s->count;
    }
    s->entry_of[vertex] = s->table[at] - 1;
}

/* ---- sums ---- */

static bool inside(const struct exact_box *box, const float p[3])
{
    bool in = true;
    for (int k = 0; k < 3; k++)
        in &= (p[k] >= box->low[k]) & (p[k] <= box->high[k]);
    return in;
}

static void map_vertices(const struct exact_smooth *s, const struct fmt_tris_chunk *chunk,
                         const struct exact_box *box, uint32_t *map)
{
    for (uint32_t v = 0; v < chunk->vertex_count; v++)
        map[v] = inside(box, chunk->positions[v])
                     ? s->table[find(s, chunk->positions[v])] - 1 /* NO_ENTRY in a gap */
                     : NO_ENTRY;
}

static void add_triangles(struct exact_smooth *s, const struct fmt_tris_chunk *chunk,
                          const uint32_t *map)
{
    for (uint32_t t = 0; t < chunk->triangle_count; t++) {
        const uint32_t *v = chunk->triangles[t];
        if ((map[v[0]] & map[v[1]] & map[v[2]]) == NO_ENTRY)
            continue;
        const float *a = chunk->positions[v[0]], *b = chunk->positions[v[1]],
                    *c = chunk->positions[v[2]];
        double p[3], q[3];
        for (int k = 0; k < 3; k++) {
            p[k] = (double)b[k] - (double)a[k];
            q[k] = (double)c[k] - (double)a[k];
        }
        const double cross[3] = {p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2],
                                 p[0] * q[1] - p[1] * q[0]};
        const double length =
            sqrt(cross[0] * cross[0] + cross[1] * cross[1] + cross[2] * cross[2]);
        for (int i = 0; i < 3; i++) {
            if (map[v[i]] == NO_ENTRY)
                continue;
            for (int k = 0; k < 3; k++)
                s->sums[map[v[i]]][k] += cross[k];
            s->sums[map[v[i]]][3] += length;
        }
    }
}

static struct exact_box bounds_of(const struct exact_smooth *s)
{
    struct exact_box box = {{INFINITY, INFINITY, INFINITY}, {-INFINITY, -INFINITY, -INFINITY}};
    for (uint32_t i = 0; i < s->count; i++)
        for (int k = 0; k < 3; k++) {
            const float p = s->positions[i][k];
            box.low[k] = p < box.low[k] ? p : box.low[k];
            box.high[k] = p > box.high[k] ? p : box.high[k];
        }
    return box;
}

/* Whether any needed vertex lies within the chunk's bounds. */
static bool reaches(const struct exact_smooth *s, const struct fmt_tris_chunk_info *chunk)
{
    struct exact_box box;
    memcpy(box.low, chunk->bounds_min, sizeof box.low);
    memcpy(box.high, chunk->bounds_max, sizeof box.high);
    for (uint32_t i = 0; i < s->count; i++)
        if (inside(&box, s->positions[i]))
            return true;
    return false;
}

static int ascending(const void *a, const void *b)
{
    uint32_t x = *(const uint32_t *)a, y = *(const uint32_t *)b;
    return (x > y) - (x < y);
}

int exact_smooth_sum(const struct bake_exact *exact, struct exact_slot *slot,
                     const struct exact_scratch *scratch)
{
    struct exact_smooth *s = &slot->smooth;
    const struct exact_box box = bounds_of(s);
    const uint32_t near = exact_tree_overlapping(&exact->tree, &box, scratch->near);
    qsort(scratch->near, near, sizeof *scratch->near, ascending);
    for (uint32_t i = 0; i < near; i++) {
        const uint32_t number = scratch->near[i];
        if (number == slot->number) {
            /* Vertices that share a needed one's position count as well. */
            map_vertices(s, &slot->chunk, &box, s->entry_of);
            add_triangles(s, &slot->chunk, s->entry_of);
            continue;
        }
        if (!reaches(s, &exact->chunks[number]))
            continue;
        struct fmt_tris_chunk neighbour;
        int status = fmt_tris_load(exact->file, number, scratch->neighbour, &neighbour);
        if (status < 0)
            return status;
        map_vertices(s, &neighbour, &box, scratch->map);
        add_triangles(s, &neighbour, scratch->map);
    }
    return 0;
}
