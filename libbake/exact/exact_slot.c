/* exact_slot.c - loads a chunk, and builds the tree of its triangles. */
#include "libbake/exact/exact_scene.h"

#include "base/octahedral.h"

int bake_exact_slot_load(const struct bake_exact *exact, uint32_t number, struct exact_slot *slot)
{
    slot->number = number;
    slot->loaded = false;
    int status = fmt_tris_load(exact->file, number, slot->chunk_memory, &slot->chunk);
    slot->loaded = status == 0;
    return status;
}

static struct exact_box triangle_box(const float *a, const float *b, const float *c)
{
    struct exact_box box;
    for (int k = 0; k < 3; k++) {
        float low = a[k] < b[k] ? a[k] : b[k], high = a[k] > b[k] ? a[k] : b[k];
        box.low[k] = c[k] < low ? c[k] : low;
        box.high[k] = c[k] > high ? c[k] : high;
    }
    return box;
}

void bake_exact_slot_build(struct exact_slot *slot, const struct exact_scratch *scratch)
{
    const struct fmt_tris_chunk *chunk = &slot->chunk;
    struct exact_box *boxes = scratch->boxes;
    for (uint32_t t = 0; t < chunk->triangle_count; t++) {
        const uint32_t *v = chunk->triangles[t];
        boxes[t] =
            triangle_box(chunk->positions[v[0]], chunk->positions[v[1]], chunk->positions[v[2]]);
    }
    bake_exact_tree_build(&slot->tree, chunk->triangle_count, boxes, slot->tree_memory,
                          scratch->keys);
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
