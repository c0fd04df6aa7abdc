/* tree_voxels_lanes.c - tests secondary rays against the voxels of blocks, and their records.
 *
 * bk_visit.h says which voxels a ray visits, and how their records are tested. Voxels from
 * params->coarse on end it without their records. Voxels are not visited in the order in
 * which rays meet them. If distances matter, the hit counts whose voxel is entered first. */
#include <stddef.h>
#include <string.h>

#include "base/simd/simd.h"
#define BK_WIDTH SIMD_FLOATS
#include "libbake/grid_tree/tree_rays.h"

enum { BLOCK_VOXELS = 64 };

/* ---- voxels ---- */

/* Visits of the pairs of a ray and a voxel, and which voxels of their rays still count. */
struct group {
    bk_visits visits;
    bk_fw rise; /* of bk_ray_rise() */
    bk_fw t_before, t_stop;
    bk_iw stop_axis;
};

/* Where leaves are, and their numbers in the grid. */
struct leaves {
    bk_iw corner[3], number;
};

/* Loads the leaves of blocks, which are nodes times BAKE_TREE_WIDTH and more. */
static inline void load_leaves(const struct bake_tree *tree, const uint32_t blocks[BK_WIDTH],
                               struct leaves *leaves)
{
    const void *from[BK_WIDTH];
    bk_fw row[4];
    _Static_assert(offsetof(struct bake_tree_node, first) == 12, "after the corner");
    for (int lane = 0; lane < BK_WIDTH; lane++)
        from[lane] = &tree->nodes[blocks[lane] / BAKE_TREE_WIDTH];
    floats_load_rows(from, offsetof(struct bake_tree_node, corner), row);
    for (int axis = 0; axis < 3; axis++)
        leaves->corner[axis] = (bk_iw)row[axis] & ~7;
    leaves->number = (bk_iw)row[3];
}

/* Loads pairs `first` to `first + count - 1`; further lanes repeat the first one. */
static void voxels_load_group(const struct bake_tree_tracer *tracer, uint32_t first, uint32_t count,
                              struct group *group)
{
    const struct bake_tree_stream *stream = tracer->stream;
    const void *rays[BK_WIDTH];
    uint32_t blocks[BK_WIDTH];
    bk_int inside[BK_WIDTH];
    struct leaves leaves;
    bk_visits *visits = &group->visits;
    bk_ray *to = &visits->ray;
    bk_fw row[4];
    for (uint32_t lane = 0; lane < BK_WIDTH; lane++) {
        const uint32_t pair = first + (lane < count ? lane : 0), block = stream->voxel_block[pair];
        rays[lane] = &stream->rays[stream->voxel_ray[pair]];
        blocks[lane] = block;
        inside[lane] = (bk_int)((block % BAKE_TREE_WIDTH) << 6 | stream->voxel[pair]);
        visits->values[lane] = stream->voxel_value[pair];
    }
    load_leaves(tracer->tree, blocks, &leaves);
    const bk_iw v = bk_load_lanes(inside);
    visits->cursor.x = leaves.corner[0] | (v >> 6 & 4) | (v >> 4 & 3);
    visits->cursor.y = leaves.corner[1] | (v >> 5 & 4) | (v >> 2 & 3);
    visits->cursor.z = leaves.corner[2] | (v >> 4 & 4) | (v & 3);
    visits->cursor.leaf = leaves.number;
    visits->cursor.mask = bk_splati(0);
    floats_load_rows(rays, offsetof(struct bake_tree_ray, inverse), row);
    to->inverse = bk_v3w(row[0], row[1], row[2]);
    group->t_before = row[3];
    floats_load_rows(rays, offsetof(struct bake_tree_ray, start), row);
    to->start = bk_v3w(row[0], row[1], row[2]);
    const bk_fw side = row[3];
    floats_load_rows(rays, offsetof(struct bake_tree_ray, base), row);
    to->bx = (bk_iw)row[0];
    to->by = (bk_iw)row[1];
    to->bz = (bk_iw)row[2];
    visits->t_begin = row[3];
    floats_load_rows(rays, offsetof(struct bake_tree_ray, first), row);
    visits->first_x = (bk_iw)row[0];
    visits->first_y = (bk_iw)row[1];
    visits->first_z = (bk_iw)row[2];
    group->t_stop = row[3];
    floats_load_rows(rays, offsetof(struct bake_tree_ray, direction), row);
    to->direction = bk_v3w(row[0], row[1], row[2]);
    group->rise = bk_keep(bk_less(bk_absw(side), bk_splat(1.5f)), bk_absw(side));
    to->facing = bk_scalew(to->direction, side / bk_absw(side));
    group->stop_axis = (bk_iw)row[3];
    floats_load_rows(rays, offsetof(struct bake_tree_ray, margin), row);
    visits->t_end = row[3];
    to->valid = bk_mask_of((1u << count) - 1u);
}

/* Notes that a ray is hidden, if distances do not matter. */
static void note_hidden(const struct bake_tree_tracer *tracer, uint32_t number)
{
    struct bake_tree_ray *ray = &tracer->stream->rays[number];
    tracer->results[ray->result] = 0.0f;
    ray->t_stop = ray->t_last = ray->t_before = BAKE_TREE_DONE;
}

/* Notes the hit of a ray in a voxel that it enters at t_event across a border of `axis`. */
static void voxels_note_hit(const struct bake_tree_tracer *tracer, uint32_t number, float t,
                            float t_event, int32_t axis)
{
    struct bake_tree_ray *ray = &tracer->stream->rays[number];
    if (!tracer->nearest) {
        note_hidden(tracer, number);
    } else if (t_event < ray->t_stop || (t_event == ray->t_stop && axis < ray->stop_axis)) {
        tracer->results[ray->result] = bk_min(t, tracer->kind->limit);
        ray->t_stop = t_event;
        ray->stop_axis = axis;
        ray->t_last = bk_max(t_event, ray->t_begin);
    }
}

/* Drops the voxels of rays into the solid whose surfaces face away: most of those near the start.
 * None of them may be far. */
static void drop_averted(struct bake_tree_tracer *tracer)
{
    struct bake_tree_stream *stream = tracer->stream;
    uint32_t kept = 0;
    bk_cursor cursor = {0}; /* unused by rays into the solid */
    bk_ray ray = {0};
    bk_walk walk;
    bk_set_walk(tracer->kind, bk_splat(0.0f), &walk);
    for (uint32_t first = 0; first < tracer->voxels; first += BK_WIDTH) {
        const uint32_t left = tracer->voxels - first, count = left < BK_WIDTH ? left : BK_WIDTH;
        const void *rays[BK_WIDTH];
        bk_ulong values[BK_WIDTH];
        bk_fw start[4], direction[4];
        for (uint32_t lane = 0; lane < BK_WIDTH; lane++) {
            const uint32_t at = first + (lane < count ? lane : 0);
            rays[lane] = &stream->rays[stream->voxel_ray[at]];
            values[lane] = stream->voxel_value[at];
        }
        floats_load_rows(rays, offsetof(struct bake_tree_ray, start), start);
        floats_load_rows(rays, offsetof(struct bake_tree_ray, direction), direction);
        ray.facing = bk_scalew(bk_v3w(direction[0], direction[1], direction[2]), start[3]);
        for (bk_uint lanes = bk_find_met(tracer->grid, &walk, &ray, (1u << count) - 1u, values,
                                         &cursor, bk_splat(0.0f));
             lanes; lanes &= lanes - 1) {
            const uint32_t at = first + bk_first(lanes);
            stream->voxel[kept] = stream->voxel[at];
            stream->voxel_block[kept] = stream->voxel_block[at];
            stream->voxel_ray[kept] = stream->voxel_ray[at];
            stream->voxel_value[kept++] = stream->voxel_value[at];
        }
    }
    tracer->voxels = kept;
}

static void test_voxels(struct bake_tree_tracer *tracer)
{
    struct group group;
    bk_visits *visits = &group.visits;
    bk_walk walk;
    if (!tracer->kind->open && tracer->section.end + BAKE_TREE_BLOCK_MOST <= tracer->params->coarse)
        drop_averted(tracer);
    for (uint32_t first = 0; first < tracer->voxels; first += BK_WIDTH) {
        const uint32_t left = tracer->voxels - first;
        voxels_load_group(tracer, first, left < BK_WIDTH ? left : BK_WIDTH, &group);
        visits->t_event = bk_find_entry(visits, &visits->cursor, &visits->axis);
        visits->t_exit = bk_find_exit(&visits->ray, &visits->cursor, &visits->exit_axis);
        bk_uint lanes = bk_bits(
            visits->ray.valid & bk_less(visits->t_event, group.t_before) &
            bk_comes_before(visits->t_event, visits->axis, visits->t_exit, visits->exit_axis) &
            bk_comes_before(visits->t_event, visits->axis, group.t_stop, group.stop_axis));
        const bk_fw t = bk_maxw(visits->t_begin, visits->t_event);
        const bk_uint coarse =
            lanes & bk_bits(bk_not(bk_less(t, bk_splat(tracer->params->coarse))));
        bk_set_walk(tracer->kind, group.rise, &walk);
        const bk_uint near = lanes & ~coarse & bk_bits(bk_less(t, walk.t_near));
        if (near)
            lanes ^= near ^ bk_find_met(tracer->grid, &walk, &visits->ray, near, visits->values,
                                        &visits->cursor, t);
        if (lanes == 0)
            continue;
        bk_clear_walk(&walk);
        if (lanes & ~coarse)
            bk_meet_visits(tracer->grid, tracer->params, &tracer->cache, visits, lanes & ~coarse, t,
                           &walk);
        if (coarse)
            bk_stop(&walk, bk_mask_of(coarse), t);
        for (bk_uint found = bk_bits(walk.hit.found) & lanes; found; found &= found - 1) {
            const bk_uint lane = bk_first(found);
            voxels_note_hit(tracer, tracer->stream->voxel_ray[first + lane],
                            bk_lane(walk.hit.t, lane), bk_lane(visits->t_event, lane),
                            bk_lane(visits->axis, lane));
        }
    }
    tracer->voxels = 0;
}

/* ---- blocks ---- */

/* The t at which rays enter and leave each of a block's four layers of an axis. They never enter
 * layers behind the voxel in which their walk begins, and are in its own layer from the start. */
struct layers {
    bk_fw in[4], out[4];
};

/* Pairs of rays and blocks, in lanes. */
struct block_group {
    struct layers axes[3];
    bk_fw t_begin, t_before, t_stop;
    bk_fw t_in; /* at which rays enter the blocks; very low in a block in which walks begin */
};

/* Finds when rays are in the layers of an axis from `corner` on. */
static inline struct layers find_layers(bk_iw corner, bk_iw first, bk_iw base, bk_fw start,
                                        bk_fw inverse)
{
    const bk_fw past = bk_splat(-BK_FAR), future = bk_splat(BK_FAR);
    const bk_mask up = bk_upwards(inverse) != 0;
    bk_fw border = bk_border(corner, base, start, inverse);
    struct layers layers;
    for (int i = 0; i < 4; i++) {
        const bk_iw layer = corner + i;
        const bk_mask below = layer < first, above = first < layer;
        const bk_mask behind = bk_selecti(up, below, above);
        const bk_fw next = bk_border(layer + 1, base, start, inverse);
        const bk_fw in = bk_select(layer == first, past, bk_minw(border, next));
        layers.in[i] = bk_select(behind, future, in);
        layers.out[i] = bk_select(behind, past, bk_maxw(border, next));
        border = next;
    }
    return layers;
}

/* Returns the t at which rays enter the first of the layers that they are in. */
static inline bk_fw first_entry(const struct layers *layers)
{
    return bk_minw(bk_minw(layers->in[0], layers->in[1]), bk_minw(layers->in[2], layers->in[3]));
}

/* Loads pairs `first` and following ones; lanes from `count` on repeat the first one. */
static void load_blocks(const struct bake_tree_tracer *tracer, uint32_t first, uint32_t count,
                        struct block_group *group)
{
    const struct bake_tree_stream *stream = tracer->stream;
    const void *rays[BK_WIDTH];
    uint32_t blocks[BK_WIDTH];
    bk_fw inverse[4], start[4], base[4], begin[4];
    struct leaves leaves;
    for (uint32_t lane = 0; lane < BK_WIDTH; lane++) {
        const uint32_t pair = first + (lane < count ? lane : 0);
        rays[lane] = &stream->rays[stream->block_ray[pair]];
        blocks[lane] = stream->block[pair];
    }
    load_leaves(tracer->tree, blocks, &leaves);
    floats_load_rows(rays, offsetof(struct bake_tree_ray, inverse), inverse);
    floats_load_rows(rays, offsetof(struct bake_tree_ray, start), start);
    floats_load_rows(rays, offsetof(struct bake_tree_ray, base), base);
    floats_load_rows(rays, offsetof(struct bake_tree_ray, first), begin);
    const bk_iw block = bk_load_lanes((const bk_int *)blocks);
    for (int axis = 0; axis < 3; axis++)
        group->axes[axis] =
            find_layers(leaves.corner[axis] | (block << axis & 4), (bk_iw)begin[axis],
                        (bk_iw)base[axis], start[axis], inverse[axis]);
    group->t_begin = base[3];
    group->t_before = inverse[3];
    group->t_stop = begin[3];
    group->t_in = bk_maxw(first_entry(&group->axes[0]),
                          bk_maxw(first_entry(&group->axes[1]), first_entry(&group->axes[2])));
}

/* Finds the voxels that rays may visit in their blocks, bits of two words: those that they do not
 * leave before they enter them. A ray through an edge or a corner leaves some of them as it enters
 * them; test_voxels() finds out which of these it visits. */
static void visit_voxels(const struct block_group *group, bk_iw words[2])
{
    bk_fw out_z[4];
    words[0] = words[1] = bk_splati(0);
    for (int z = 0; z < 4; z++)
        out_z[z] = bk_minw(group->axes[2].out[z], group->t_before);
    for (int yz = 0; yz < 16; yz++) {
        const bk_fw in = bk_maxw(group->axes[1].in[yz >> 2], group->axes[2].in[yz & 3]);
        const bk_fw out = bk_minw(group->axes[1].out[yz >> 2], out_z[yz & 3]);
        for (int x = 0; x < 4; x++) {
            const bk_mask met =
                bk_maxw(group->axes[0].in[x], in) <= bk_minw(group->axes[0].out[x], out);
            words[x >> 1] |= met & (bk_int)(1u << (16 * (x & 1) + yz));
        }
    }
}

/* Returns the t at which rays enter the first of the occupied voxels that they surely visit: they
 * enter them before they leave them; BK_FAR: there is none. *doubtful: lanes in which rays enter
 * and leave some at the same t. */
static bk_fw enter_voxels(const struct block_group *group, const bk_iw occupied[2],
                          bk_mask *doubtful)
{
    const bk_fw far = bk_splat(BK_FAR);
    bk_fw first = far;
    *doubtful = bk_mask_of(0);
    for (int yz = 0; yz < 16; yz++) {
        const bk_fw in = bk_maxw(group->axes[1].in[yz >> 2], group->axes[2].in[yz & 3]);
        const bk_fw out = bk_minw(group->axes[1].out[yz >> 2],
                                  bk_minw(group->axes[2].out[yz & 3], group->t_before));
        for (int x = 0; x < 4; x++) {
            const bk_mask there = (occupied[x >> 1] & (bk_int)(1u << (16 * (x & 1) + yz))) != 0;
            const bk_fw t = bk_maxw(group->axes[0].in[x], in);
            const bk_fw t_out = bk_minw(group->axes[0].out[x], out);
            first = bk_minw(first, bk_select(there & bk_less(t, t_out), t, far));
            *doubtful = *doubtful | (there & (t == t_out));
        }
    }
    return first;
}

/* Returns where the occupied voxels of a block are stored. */
static inline const uint64_t *find_block(const struct bake_tree *tree, uint32_t block)
{
    return &tree->blocks[tree->nodes[block / BAKE_TREE_WIDTH].first][block % BAKE_TREE_WIDTH];
}

/* Keeps a pair of a ray and a block with the voxels that the ray meets, and prefetches the words of
 * the leaf that say where the records of these are. */
static inline void note_met(const struct bake_tree_tracer *tracer, uint32_t pair, uint64_t voxels,
                            uint32_t at)
{
    struct bake_tree_stream *stream = tracer->stream;
    const uint32_t number = stream->block[pair];
    const uint32_t leaf = tracer->tree->nodes[number / BAKE_TREE_WIDTH].first;
    const bk_ulong *words = tracer->grid->leaves + (uint64_t)leaf * BK_LEAF_WORDS;
    __builtin_prefetch(&words[BK_LEAF_MASK + (number & 4)]);
    __builtin_prefetch(&words[BK_LEAF_PREFIX]);
    stream->met[at] = pair;
    stream->met_voxels[at] = voxels;
}

/* Appends the occupied voxels of a pair of a ray and a block. */
static void add_voxels(struct bake_tree_tracer *tracer, uint32_t pair, uint64_t voxels)
{
    struct bake_tree_stream *stream = tracer->stream;
    const bk_grid *grid = tracer->grid;
    const uint32_t number = stream->block[pair], block = number % BAKE_TREE_WIDTH;
    const uint32_t leaf = tracer->tree->nodes[number / BAKE_TREE_WIDTH].first;
    if (tracer->voxels + BLOCK_VOXELS > BAKE_TREE_VOXELS)
        test_voxels(tracer);
    for (; voxels; voxels &= voxels - 1) {
        const uint32_t voxel = (uint32_t)__builtin_ctzll(voxels), at = tracer->voxels++;
        const bk_ulong value = bk_leaf_rank(
            grid, grid->leaves + (uint64_t)leaf * BK_LEAF_WORDS, (block & 4) | voxel >> 4,
            (block & 2) << 4 | (voxel >> 2 & 3) << 3 | (block & 1) << 2 | (voxel & 3));
        __builtin_prefetch(&grid->normals[value]);
        __builtin_prefetch(&grid->planes[value]);
        stream->voxel[at] = (uint8_t)voxel;
        stream->voxel_block[at] = number;
        stream->voxel_ray[at] = stream->block_ray[pair];
        stream->voxel_value[at] = value;
    }
}

/* Loads the occupied voxels of blocks, bits of two words. */
static void load_occupied(const struct bake_tree_tracer *tracer, uint32_t first, uint32_t count,
                          bk_iw words[2])
{
    bk_int low[BK_WIDTH], high[BK_WIDTH];
    for (uint32_t lane = 0; lane < BK_WIDTH; lane++) {
        const uint32_t pair = first + (lane < count ? lane : 0);
        const uint64_t voxels = *find_block(tracer->tree, tracer->stream->block[pair]);
        low[lane] = (bk_int)(uint32_t)voxels;
        high[lane] = (bk_int)(uint32_t)(voxels >> 32);
    }
    words[0] = bk_load_lanes(low);
    words[1] = bk_load_lanes(high);
}

/* Ends rays in the first voxels of far blocks. first: of the pairs. Returns the lanes whose voxels
 * have to be tested one by one. */
static bk_uint meet_far_blocks(const struct bake_tree_tracer *tracer,
                               const struct block_group *group, bk_uint lanes, uint32_t first,
                               const bk_iw occupied[2])
{
    const bk_fw depth = bk_splat(tracer->kind->open ? 0.0f : BK_FAR_DEPTH);
    bk_mask doubtful;
    const bk_fw t_event = enter_voxels(group, occupied, &doubtful);
    const bk_fw t = bk_maxw(t_event, group->t_begin) + depth;
    const bk_uint met = lanes & bk_bits(bk_less(t_event, bk_splat(BK_FAR)));
    for (bk_uint left = met; left; left &= left - 1) {
        const bk_uint lane = bk_first(left);
        /* A doubtful voxel at the same t comes first. */
        voxels_note_hit(tracer, tracer->stream->block_ray[first + lane], bk_lane(t, lane),
                        bk_lane(t_event, lane), 3);
    }
    return lanes & bk_bits(doubtful) & (tracer->nearest ? ~0u : ~met);
}

void BSQ_SIMD_NAME(bake_tree_test_blocks)(struct bake_tree_tracer *tracer)
{
    const struct bake_tree_stream *stream = tracer->stream;
    const uint32_t count = tracer->blocks;
    uint32_t met = 0;
    for (uint32_t i = 0; i < count && i < BK_WIDTH; i++)
        __builtin_prefetch(find_block(tracer->tree, stream->block[i]));
    for (uint32_t first = 0; first < count; first += BK_WIDTH) {
        const uint32_t left = count - first, pairs = left < BK_WIDTH ? left : BK_WIDTH;
        struct block_group group;
        bk_iw words[2], occupied[2];
        for (uint32_t i = first + BK_WIDTH; i < count && i < first + 2 * BK_WIDTH; i++)
            __builtin_prefetch(find_block(tracer->tree, stream->block[i]));
        load_blocks(tracer, first, pairs, &group);
        load_occupied(tracer, first, pairs, occupied);
        bk_uint lanes = ((1u << pairs) - 1u) & bk_bits(bk_not(bk_less(group.t_stop, group.t_in)));
        const bk_uint far =
            lanes & bk_bits(bk_not(bk_less(group.t_in, bk_splat(tracer->params->coarse))));
        if (far)
            lanes ^= far ^ meet_far_blocks(tracer, &group, far, first, occupied);
        if (lanes == 0)
            continue;
        visit_voxels(&group, words);
        words[0] &= occupied[0];
        words[1] &= occupied[1];
        for (lanes &= bk_bits((words[0] | words[1]) != 0); lanes; lanes &= lanes - 1) {
            const bk_uint lane = bk_first(lanes);
            const uint32_t low = (uint32_t)bk_lane(words[0], lane);
            const uint32_t high = (uint32_t)bk_lane(words[1], lane);
            note_met(tracer, first + lane, low | (uint64_t)high << 32, met++);
        }
    }
    for (uint32_t i = 0; i < met; i++)
        add_voxels(tracer, stream->met[i], stream->met_voxels[i]);
    tracer->blocks = 0;
    test_voxels(tracer);
}
