/* exact_device.c - chunks in the memory of a device: what they need, and those of first rays.
 *
 * A wave of first rays (exact_trace.c) has its chunks in the host's memory, for normals and
 * colours. Each also goes to a place on the device, with the tree that the processor has and leaves
 * in the order of the file, which tell the numbers of triangles. So the processor can go on at any
 * time. */
#include "libbake/exact/exact_leaves.h"

#include <string.h>

/* Returns the bytes of the largest chunk in a group of this many chunks. */
static uint64_t largest_in_group(const struct bake_exact *exact, uint32_t chunks)
{
    return bake_exact_table_bytes(chunks) + bake_exact_leaves_bytes(exact_most_triangles(exact));
}

void bake_exact_add_needs(const struct bake_exact *exact, struct bake_scene *scene)
{
    const uint64_t place = largest_in_group(exact, 1);
    if (bk_ray_count(&scene->params) > 0)
        scene->chunk_bytes =
            bk_upper(scene->chunk_bytes, largest_in_group(exact, exact->chunk_count));
    scene->place_bytes = bk_upper(scene->place_bytes, place);
    scene->wave_bytes = bk_upper(scene->wave_bytes, exact_wave_slots(exact) * place);
}

void bake_exact_set_device(struct bake_exact *exact, struct bake_device *device,
                           uint64_t wave_bytes)
{
    exact->device = device;
    exact->place_bytes = largest_in_group(exact, 1);
    exact->places = (uint32_t)(wave_bytes / exact->place_bytes);
}

/* Sends the leaves of a slot, as many at a time as there is memory for. */
static int send_leaves(const struct bake_exact *exact, const struct exact_slot *slot, uint64_t at,
                       struct exact_leaf *leaves, uint32_t most, unsigned worker)
{
    const uint32_t runs = exact_runs(slot->chunk.triangle_count);
    int status = 0;
    for (uint32_t done = 0, count; done < runs && status == 0; done += count) {
        count = runs - done < most ? runs - done : most;
        for (uint32_t i = 0; i < count; i++)
            bake_exact_leaf_set(&slot->chunk, NULL, done + i, !exact->two_sided, &leaves[i]);
        status = bake_device_send(exact->device, BAKE_WAVE, at + done * sizeof *leaves, leaves,
                                  count * sizeof *leaves, worker);
    }
    return status;
}

int bake_exact_slot_send(const struct bake_exact *exact, const struct exact_slot *slot,
                         uint64_t index, void *scratch, uint64_t bytes, unsigned worker)
{
    const struct fmt_tris_chunk_info *chunk = &exact->chunks[slot->number];
    const uint64_t table = bake_exact_table_bytes(1),
                   nodes = bake_exact_tree_bytes(slot->tree.count);
    uint64_t at = index * exact->place_bytes;
    struct exact_leaves leaves = {.tree = slot->tree};
    struct exact_group group = {.chunks = &leaves};
    struct exact_box box = EXACT_EMPTY_BOX;
    struct exact_box8 node;
    exact_box_grow(&box, chunk->bounds_min, chunk->bounds_max);
    bake_exact_tree_build(&group.tree, 1, &box, &node);
    bake_exact_table_set(&group, 1, scratch);
    BSQ_PASS(bake_device_send(exact->device, BAKE_WAVE, at, scratch, table, worker));
    at += table;
    BSQ_PASS(bake_device_send(exact->device, BAKE_WAVE, at, slot->tree.nodes, nodes, worker));
    return send_leaves(exact, slot, at + nodes, scratch,
                       (uint32_t)(bytes / sizeof(struct exact_leaf)), worker);
}
