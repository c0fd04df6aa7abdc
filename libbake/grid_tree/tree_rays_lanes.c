/* tree_rays_lanes.c - traces secondary rays through the tree of leaves.
 *
 * Work is in lists of pairs: of a ray and a node, a block of 4^3 voxels, or an occupied voxel. So
 * no step depends on what other rays do, lanes are always full, and what a step reads is prefetched
 * (after Barringer and Akenine-Möller, "Dynamic Ray Stream Traversal", 2014).
 *
 * Rays of points near each other, sorted by the octants of their directions, are in bundles. As
 * long as many of a bundle meet a node, all are tested against one box at a time; then one ray at a
 * time against the boxes of all children of a node. Boxes are tested with a margin for rounding.
 * tree_voxels_lanes.c tests blocks and voxels. */
#include <assert.h>
#include <float.h>
#include <math.h>
#include <stddef.h>
#include <string.h>

#include "base/simd/simd.h"
#define BK_WIDTH SIMD_FLOATS
#include "libbake/grid_tree/tree_rays.h"

/* At most this many rays of a bundle are tested against a node one by one. */
enum { SINGLE_RAYS_MOST = 24 };

/* Rays that look for their nearest hit are traced in sections: the first ends after FIRST_END
 * voxels, the next at END_FACTOR times that distance, and so on. FIRST_END is BAKE_TREE_BLOCK_MOST
 * below the default of params->coarse. */
#define FIRST_END  56.0f
#define END_FACTOR 4.0f

/* ---- nodes ---- */

typedef uint32_t four_uints __attribute__((vector_size(16)));

static four_floats load_floats(const void *from, size_t offset)
{
    four_floats v;
    memcpy(&v, (const char *)from + offset, sizeof v);
    return v;
}

static four_ints load_ints(const void *from, size_t offset)
{
    four_ints v;
    memcpy(&v, (const char *)from + offset, sizeof v);
    return v;
}

/* Returns the step of a node's borders in all lanes: the power of two with the exponent
 * bake_tree_shift(). */
static inline four_floats four_steps(const struct bake_tree_node *node)
{
    const four_ints first = node->corner[0] - (four_ints){0};
    _Static_assert(FLT_MANT_DIG == 24, "the exponent is in the bits from 23 on");
    return (four_floats)(((first & 7) << 24) + (127 << 23));
}

#define SPLAT_LANE(v, n) eights_splat((v)[n])

/* Returns the children of a node that a ray may meet in a section of it, one bit each. */
static inline uint32_t meet_children(const struct bake_tree_ray *ray,
                                     const struct bake_tree_node *node,
                                     const struct bake_tree_section *section)
{
    const four_floats step = four_steps(node);
    /* The fourth words are not used, and any bits: their difference must be allowed to wrap. */
    const four_ints corner = load_ints(node, offsetof(struct bake_tree_node, corner)) & ~7;
    const four_ints base = load_ints(ray, offsetof(struct bake_tree_ray, base));
    const four_floats start = load_floats(ray, offsetof(struct bake_tree_ray, start));
    const four_floats inverse = load_floats(ray, offsetof(struct bake_tree_ray, inverse));
    const four_floats margin = load_floats(ray, offsetof(struct bake_tree_ray, margin));
    const four_ints away = (four_ints)((four_uints)corner - (four_uints)base);
    const four_floats from = __builtin_convertvector(away, four_floats) - start;
    const four_floats scale = inverse * step, zero = from * inverse;
    const four_floats near = zero - margin, far = zero + margin;
    const uint8_t *borders = node->borders[0][0];
    eights t_in = eights_splat(bk_max(ray->t_begin, section->begin));
    eights t_out = eights_splat(bk_min(ray->t_last, section->end));

    for (int axis = 0; axis < 3; axis++) {
        const eights by = SPLAT_LANE(scale, axis);
        t_in = eights_max(t_in,
                          eights_of_bytes(borders + ray->near[axis]) * by + SPLAT_LANE(near, axis));
        t_out = eights_min(t_out,
                           eights_of_bytes(borders + ray->far[axis]) * by + SPLAT_LANE(far, axis));
    }
    return eights_not_above(t_in, t_out);
}

/* Lists of pairs of a ray and a node, or a block. */
struct list {
    uint32_t *items, *rays, count;
};

/* Appends pairs of a ray and first + i for each bit i that is set. */
static inline void add_pairs(struct list *list, uint32_t bits, uint32_t first, uint32_t ray)
{
    const eight_ints all = (int32_t)ray - (eight_ints){0};
    eights_store_set(bits, first, list->items + list->count);
    memcpy(list->rays + list->count, &all, sizeof all);
    list->count += (uint32_t)__builtin_popcount(bits);
}

/* Pairs that are about to be tested, while their nodes are read. */
struct pairs {
    uint32_t count, nodes[BAKE_TREE_AT_ONCE], rays[BAKE_TREE_AT_ONCE];
};

/* Takes the pairs that were added last. */
static void take_pairs(struct bake_tree_tracer *tracer, struct pairs *pairs)
{
    const struct bake_tree_stream *stream = tracer->stream;
    pairs->count = tracer->nodes < BAKE_TREE_AT_ONCE ? tracer->nodes : BAKE_TREE_AT_ONCE;
    tracer->nodes -= pairs->count;
    for (uint32_t i = 0; i < pairs->count; i++) {
        pairs->nodes[i] = stream->node[tracer->nodes + i];
        pairs->rays[i] = stream->node_ray[tracer->nodes + i];
        __builtin_prefetch(&tracer->tree->nodes[pairs->nodes[i]]);
    }
}

static void test_pairs(struct bake_tree_tracer *tracer, const struct pairs *pairs)
{
    struct bake_tree_stream *stream = tracer->stream;
    struct list lists[2] = {{stream->node, stream->node_ray, tracer->nodes},
                            {stream->block, stream->block_ray, tracer->blocks}};
    assert(tracer->nodes + BAKE_TREE_AT_ONCE * BAKE_TREE_WIDTH <= BAKE_TREE_NODES);
    assert(tracer->blocks + BAKE_TREE_AT_ONCE * BAKE_TREE_WIDTH <= BAKE_TREE_BLOCKS);
    for (uint32_t i = 0; i < pairs->count; i++) {
        const uint32_t number = pairs->nodes[i], ray = pairs->rays[i];
        const struct bake_tree_node *node = &tracer->tree->nodes[number];
        const uint32_t met = meet_children(&stream->rays[ray], node, &tracer->section);
        /* Half of the time it is a leaf, so no branch. */
        const uint32_t leaf = bake_tree_is_leaf(node), block = number * BAKE_TREE_WIDTH;
        add_pairs(&lists[leaf], met, node->first ^ ((node->first ^ block) & (0u - leaf)), ray);
    }
    tracer->nodes = lists[0].count;
    tracer->blocks = lists[1].count;
    if (tracer->blocks >= BAKE_TREE_TESTED)
        BSQ_SIMD_NAME(bake_tree_test_blocks)(tracer);
}

/* Tests all pairs of rays and nodes. */
static void drain_nodes(struct bake_tree_tracer *tracer)
{
    struct pairs pairs[2];
    pairs[0].count = 0;
    if (tracer->blocks >= BAKE_TREE_TESTED)
        BSQ_SIMD_NAME(bake_tree_test_blocks)(tracer);
    for (uint32_t turn = 0; tracer->nodes > 0 || pairs[turn].count > 0; turn ^= 1) {
        take_pairs(tracer, &pairs[turn ^ 1]);
        test_pairs(tracer, &pairs[turn]);
    }
}

/* ---- bundles ---- */

/* Rays in lanes. Unused lanes meet nothing. Borders of boxes count from the start of the first ray;
 * a ray that starts elsewhere meets them by `shift` sooner. */
struct bundle {
    const uint32_t *rays; /* their numbers in the stream */
    uint32_t count;
    float low[3], high[3]; /* a box around the rays, from the start of the first one */
    bk_fw inverse[3][BAKE_TREE_BUNDLE / BK_WIDTH], shift[3][BAKE_TREE_BUNDLE / BK_WIDTH];
    bk_fw t_begin[BAKE_TREE_BUNDLE / BK_WIDTH], t_end[BAKE_TREE_BUNDLE / BK_WIDTH];
};

/* Loads rays `first` and following ones of a bundle. low, high: a box around them in lanes, which
 * grows. */
static inline void load_rays(const struct bake_tree_tracer *tracer, uint32_t first,
                             struct bundle *bundle, bk_fw low[3], bk_fw high[3])
{
    const struct bake_tree_ray *all = tracer->stream->rays, *rays = &all[bundle->rays[0]];
    const struct bake_tree_section *section = &tracer->section;
    const uint32_t left = bundle->count - first, group = first / BK_WIDTH;
    const void *from[BK_WIDTH];
    bk_fw inverse[4], start[4], base[4], direction[4], near[4];
    for (uint32_t lane = 0; lane < BK_WIDTH; lane++)
        from[lane] = &all[bundle->rays[first + (lane < left ? lane : 0)]];
    floats_load_rows(from, offsetof(struct bake_tree_ray, inverse), inverse);
    floats_load_rows(from, offsetof(struct bake_tree_ray, start), start);
    floats_load_rows(from, offsetof(struct bake_tree_ray, base), base);
    floats_load_rows(from, offsetof(struct bake_tree_ray, direction), direction);
    floats_load_rows(from, offsetof(struct bake_tree_ray, near), near);
    const bk_fw t_end = bk_minw(near[3], bk_splat(section->end));
    for (int axis = 0; axis < 3; axis++) {
        const bk_fw begin = bk_to_fw((bk_iw)base[axis] - rays->base[axis]) +
                            (start[axis] - bk_splat(rays->start[axis]));
        const bk_fw end = begin + direction[axis] * t_end;
        bundle->inverse[axis][group] = inverse[axis];
        bundle->shift[axis][group] = inverse[axis] * begin;
        low[axis] = bk_minw(low[axis], bk_minw(begin, end));
        high[axis] = bk_maxw(high[axis], bk_maxw(begin, end));
    }
    bundle->t_begin[group] = bk_maxw(base[3], bk_splat(section->begin));
    bundle->t_end[group] = bk_select(bk_mask_of(left < BK_WIDTH ? (1u << left) - 1u : ~0u), t_end,
                                     bk_splat(BAKE_TREE_DONE));
}

static void load_bundle(const struct bake_tree_tracer *tracer, struct bundle *bundle)
{
    const bk_fw none = bk_splat(0.0f);
    bk_fw low[3] = {none, none, none}, high[3] = {none, none, none};
    for (uint32_t first = 0; first < bundle->count; first += BK_WIDTH)
        load_rays(tracer, first, bundle, low, high);
    for (int axis = 0; axis < 3; axis++) {
        bundle->low[axis] = bundle->high[axis] = 0.0f;
        for (uint32_t lane = 0; lane < BK_WIDTH; lane++) {
            bundle->low[axis] = bk_min(bundle->low[axis], bk_lane(low[axis], lane));
            bundle->high[axis] = bk_max(bundle->high[axis], bk_lane(high[axis], lane));
        }
    }
}

/* Returns those of some rays of a bundle that meet a box; low, high: its borders from the start of
 * the first ray, with a margin. */
static inline uint64_t meet_box(const struct bundle *bundle, const float low[3],
                                const float high[3], uint64_t rays)
{
    uint64_t met = 0;
    for (uint32_t group = 0; group * BK_WIDTH < bundle->count; group++) {
        if ((rays >> group * BK_WIDTH & ((1u << BK_WIDTH) - 1u)) == 0)
            continue;
        bk_fw t_in = bundle->t_begin[group], t_out = bundle->t_end[group];
        for (int axis = 0; axis < 3; axis++) {
            const bk_fw inverse = bundle->inverse[axis][group];
            const bk_fw shift = bundle->shift[axis][group];
            const bk_fw a = inverse * low[axis] - shift, b = inverse * high[axis] - shift;
            t_in = bk_maxw(t_in, bk_minw(a, b));
            t_out = bk_minw(t_out, bk_maxw(a, b));
        }
        met |= (uint64_t)bk_bits(t_in <= t_out) << group * BK_WIDTH;
    }
    return met & rays;
}

/* Appends pairs of an item and the rays of a mask. */
static inline uint32_t add_rays_of(const struct bundle *bundle, uint64_t mask, uint32_t item,
                                   uint32_t *items, uint32_t *rays, uint32_t count)
{
    for (; mask; mask &= mask - 1) {
        items[count] = item;
        rays[count++] = bundle->rays[__builtin_ctzll(mask)];
    }
    return count;
}

/* A node that many rays of a bundle meet. */
struct bundle_entry {
    uint64_t rays;
    uint32_t node;
};

/* Borders of the boxes of a node's children, from the start of a bundle's first ray. */
struct boxes {
    float low[3][BAKE_TREE_WIDTH], high[3][BAKE_TREE_WIDTH];
};

/* Finds the boxes of a node's children, with a margin for rounding. Returns those that rays of a
 * bundle may meet, one bit each: they touch the box around the rays. */
static uint32_t rays_find_boxes(const struct bake_tree_tracer *tracer, const struct bundle *bundle,
                                const struct bake_tree_node *node, struct boxes *boxes)
{
    const struct bake_tree_ray *ray = &tracer->stream->rays[bundle->rays[0]];
    const eights unit = eights_splat((float)(1u << bake_tree_shift(node)));
    uint32_t met = eights_not_above(eights_of_bytes(node->borders[0][0]),
                                    eights_of_bytes(node->borders[0][1]));
    for (int axis = 0; axis < 3; axis++) {
        const float from =
            (float)(bake_tree_corner(node, axis) - ray->base[axis]) - ray->start[axis];
        const float margin = tracer->margins[axis];
        const eights low =
            eights_of_bytes(node->borders[axis][0]) * unit + eights_splat(from - margin);
        const eights high =
            eights_of_bytes(node->borders[axis][1]) * unit + eights_splat(from + margin);
        met &= eights_not_above(low, eights_splat(bundle->high[axis])) &
               eights_not_above(eights_splat(bundle->low[axis]), high);
        memcpy(boxes->low[axis], &low, sizeof low);
        memcpy(boxes->high[axis], &high, sizeof high);
    }
    return met;
}

/* Tests a bundle against the boxes of a node's children. Children that few rays meet become
 * pairs with single rays, others are appended to the stack. */
static void test_bundle(struct bake_tree_tracer *tracer, const struct bundle *bundle,
                        uint32_t number, uint64_t rays, struct bundle_entry *stack, uint32_t *top)
{
    struct bake_tree_stream *stream = tracer->stream;
    const struct bake_tree_node *node = &tracer->tree->nodes[number];
    struct boxes boxes;
    if (tracer->blocks + BAKE_TREE_WIDTH * BAKE_TREE_BUNDLE > BAKE_TREE_BLOCKS)
        BSQ_SIMD_NAME(bake_tree_test_blocks)(tracer);
    if (tracer->nodes > BAKE_TREE_BUNDLE * BAKE_TREE_WIDTH)
        drain_nodes(tracer);
    for (uint32_t left = rays_find_boxes(tracer, bundle, node, &boxes); left; left &= left - 1) {
        const uint32_t child = (uint32_t)__builtin_ctz(left);
        float low[3], high[3];
        for (int axis = 0; axis < 3; axis++) {
            low[axis] = boxes.low[axis][child];
            high[axis] = boxes.high[axis][child];
        }
        const uint64_t met = meet_box(bundle, low, high, rays);
        if (bake_tree_is_leaf(node))
            tracer->blocks = add_rays_of(bundle, met, number * BAKE_TREE_WIDTH + child,
                                         stream->block, stream->block_ray, tracer->blocks);
        else if (__builtin_popcountll(met) > SINGLE_RAYS_MOST)
            stack[(*top)++] = (struct bundle_entry){met, node->first + child};
        else
            tracer->nodes = add_rays_of(bundle, met, node->first + child, stream->node,
                                        stream->node_ray, tracer->nodes);
    }
}

/* Sends these rays through the tree, BAKE_TREE_BUNDLE at most. */
static void rays_trace_bundle(struct bake_tree_tracer *tracer, const uint32_t *rays, uint32_t count)
{
    struct bake_tree_stream *stream = tracer->stream;
    struct bundle_entry stack[BAKE_TREE_DEPTH * BAKE_TREE_WIDTH];
    struct bundle bundle = {.rays = rays, .count = count};
    const uint64_t all = ~UINT64_C(0) >> (BAKE_TREE_BUNDLE - count);
    uint32_t top = 0;
    if (count > SINGLE_RAYS_MOST) {
        load_bundle(tracer, &bundle);
        stack[top++] = (struct bundle_entry){all, 0};
    } else {
        tracer->nodes = add_rays_of(&bundle, all, 0, stream->node, stream->node_ray, tracer->nodes);
    }
    while (top > 0) {
        const struct bundle_entry next = stack[--top];
        test_bundle(tracer, &bundle, next.node, next.rays, stack, &top);
    }
    drain_nodes(tracer);
}

/* Lists the rays that have not ended before the section. Rays whose directions have the same signs
 * are neighbours in the list. Returns their number. */
static uint32_t list_rays(const struct bake_tree_tracer *tracer, uint32_t list[BAKE_TREE_RAYS])
{
    const struct bake_tree_ray *rays = tracer->stream->rays;
    uint32_t ends[9] = {0}, count = 0;
    uint8_t octants[BAKE_TREE_RAYS];
    for (uint32_t i = 0; i < tracer->rays; i++) {
        const int32_t *near = rays[i].near;
        octants[i] = (uint8_t)((near[0] & BAKE_TREE_WIDTH) >> 1 | (near[1] & BAKE_TREE_WIDTH) >> 2 |
                               (near[2] & BAKE_TREE_WIDTH) >> 3);
        if (rays[i].t_last < tracer->section.begin)
            octants[i] = 8;
        ends[octants[i]]++;
    }
    for (uint32_t octant = 0; octant < 8; octant++) {
        count += ends[octant];
        ends[octant] = count - ends[octant];
    }
    for (uint32_t i = 0; i < tracer->rays; i++)
        if (octants[i] < 8)
            list[ends[octants[i]]++] = i;
    return count;
}

/* Traces the rays of the stream, and empties it. If the nearest hit counts, the first section of
 * all rays is traced before the next one. A ray whose hit lies in a section skips the
 * others. */
static void trace_rays(struct bake_tree_tracer *tracer)
{
    struct bake_tree_section *section = &tracer->section;
    uint32_t list[BAKE_TREE_RAYS];
    *section = (struct bake_tree_section){0.0f, tracer->nearest ? FIRST_END : BK_FAR};
    for (bool more = true; more;
         section->begin = section->end, section->end = section->end * END_FACTOR) {
        const uint32_t count = list_rays(tracer, list);
        for (uint32_t i = 0; i < count; i += BAKE_TREE_BUNDLE)
            rays_trace_bundle(tracer, list + i,
                              count - i < BAKE_TREE_BUNDLE ? count - i : BAKE_TREE_BUNDLE);
        BSQ_SIMD_NAME(bake_tree_test_blocks)(tracer);
        more = count > 0 && section->end < tracer->kind->limit;
    }
    tracer->rays = 0;
    memset(tracer->margins, 0, sizeof tracer->margins);
}

/* Finds the margins of boxes for rays that start at a point. */
static void find_margins(const struct bake_tree *tree, bk_vec3 start, float margins[3])
{
    const float from[3] = {start.x, start.y, start.z};
    for (int axis = 0; axis < 3; axis++)
        margins[axis] = bk_tree_margin(tree->low[axis], tree->high[axis] - 1, from[axis]);
}

/* Appends rays `first` and following ones of a point, at most BK_WIDTH, but for those that cross
 * its wall; NULL: it has none. */
static void add_rays(struct bake_tree_tracer *tracer, const bk_viewpoint *point,
                     const bk_wall *wall, const float margins[3], uint32_t first, uint32_t result)
{
    struct bake_tree_stream *stream = tracer->stream;
    const bk_rays *kind = tracer->kind;
    const bk_uint left = kind->count - first, count = left < BK_WIDTH ? left : BK_WIDTH;
    const bk_vec3w direction = bk_ray_directions(kind, point, first);
    const bk_ray line =
        bk_ray_along(bk_splat3(bk_ray_start(kind, point)), direction,
                     bk_scalew(direction, bk_splat(point->side)), bk_mask_of((1u << count) - 1u));
    const bk_fw limit = bk_splat(kind->limit);
    const bk_fw rise = bk_ray_rise(kind, point, direction);
    bk_walk walk;
    bk_fw t_near, t_far, t;
    bk_cursor cursor;

    bk_set_walk(kind, rise, &walk);
    bk_bounds(&line, tracer->params, &t_near, &t_far);
    const bk_fw t_end = bk_minw(limit, t_far);
    bk_uint walked = bk_begin_walk(tracer->params, &line, &walk, t_near, t_end, &t, &cursor);
    const bk_mask through = bk_mask_of(kind->open ? 0u : ~0u) & bk_not(bk_less(t_far, limit));
    bk_fw found = bk_select(through, limit, bk_splat(-1.0f)), t_wall;
    if (wall) {
        const bk_mask met = bk_cross_wall(wall, direction, rise, &t_wall) & (t_wall <= limit);
        found = bk_select(met, t_wall, found);
        walked &= ~bk_bits(met);
    }
    memcpy(&tracer->results[result], &found, count * sizeof(float));

    /* The cursor of a ray that is not walked is that of the next one. */
    bk_int places[BK_WIDTH];
    void *to[BK_WIDTH];
    for (bk_uint lane = 0; lane < BK_WIDTH; lane++) {
        places[lane] = (bk_int)(result + lane);
        to[lane] = &stream->rays[tracer->rays];
        tracer->rays += walked >> lane & 1;
    }
    const bk_fw t_before = bk_select(bk_less(t, t_end), t_end, bk_splat(-0.5f * BK_FAR));
    const bk_iw down_x = ~bk_upwards(line.inverse.x), down_y = ~bk_upwards(line.inverse.y);
    const bk_iw down_z = ~bk_upwards(line.inverse.z);
#define STORE_ROW(member, a, b, c, d)                                                              \
    floats_store_rows(to, offsetof(struct bake_tree_ray, member), (bk_fw)(a), (bk_fw)(b),          \
                      (bk_fw)(c), (bk_fw)(d))
    STORE_ROW(inverse, line.inverse.x, line.inverse.y, line.inverse.z, t_before);
    STORE_ROW(start, line.start.x, line.start.y, line.start.z,
              point->side * bk_select(rise == 0.0f, bk_splat(2.0f), rise));
    STORE_ROW(base, line.bx, line.by, line.bz, t);
    STORE_ROW(first, cursor.x, cursor.y, cursor.z, t_end);
    STORE_ROW(direction, line.direction.x, line.direction.y, line.direction.z, bk_splati(3));
    STORE_ROW(margin, bk_absw(line.inverse.x) * margins[0], bk_absw(line.inverse.y) * margins[1],
              bk_absw(line.inverse.z) * margins[2], t_end);
    STORE_ROW(near, down_x & BAKE_TREE_WIDTH, (down_y & BAKE_TREE_WIDTH) + 2 * BAKE_TREE_WIDTH,
              (down_z & BAKE_TREE_WIDTH) + 4 * BAKE_TREE_WIDTH, t_end);
    STORE_ROW(far, ~down_x & BAKE_TREE_WIDTH, (~down_y & BAKE_TREE_WIDTH) + 2 * BAKE_TREE_WIDTH,
              (~down_z & BAKE_TREE_WIDTH) + 4 * BAKE_TREE_WIDTH, bk_load_lanes(places));
}

/* Appends rays `first` and following ones of a point, BAKE_TREE_BUNDLE at most. result: of its
 * first ray. */
static void rays_add_point(struct bake_tree_tracer *tracer, const bk_viewpoint *point,
                           uint32_t first, uint32_t result)
{
    const bk_uint left = tracer->kind->count - first;
    const bk_uint end = first + (left < BAKE_TREE_BUNDLE ? left : BAKE_TREE_BUNDLE);
    const bool walled = tracer->kind->open && point->crowded == BK_CROWDED_BY_WALL;
    float margins[3];
    bk_wall wall;
    if (walled)
        wall = bk_find_wall(tracer->grid, &tracer->cache, point->solid_from, point->normal);
    find_margins(tracer->tree, bk_ray_start(tracer->kind, point), margins);
    for (bk_uint ray = first; ray < end; ray += BK_WIDTH)
        add_rays(tracer, point, walled ? &wall : NULL, margins, ray, result + ray);
    for (int axis = 0; axis < 3; axis++)
        tracer->margins[axis] = bk_max(tracer->margins[axis], 2.0f * margins[axis]);
}

void BSQ_SIMD_NAME(bake_tree_look)(const struct bk_grid *grid, const struct bk_params *params,
                                   const struct bake_tree *tree, const bk_rays *kind,
                                   const bk_viewpoint *points, uint32_t count, float *results,
                                   uint64_t stride, struct bake_tree_stream *stream)
{
    struct bake_tree_tracer tracer = {.grid = grid,
                                      .params = params,
                                      .tree = tree,
                                      .kind = kind,
                                      .stream = stream,
                                      .results = results,
                                      .nearest = !kind->open || params->flags & BK_OPEN_FALLOFF,
                                      .cache = bk_cache_empty()};
    if (kind->count == 0)
        return;
    for (uint32_t i = 0; i < count; i++)
        for (bk_uint first = 0; first < kind->count; first += BAKE_TREE_BUNDLE) {
            if (tracer.rays + BAKE_TREE_BUNDLE > BAKE_TREE_RAYS)
                trace_rays(&tracer);
            rays_add_point(&tracer, &points[i], first, (uint32_t)(i * stride));
        }
    trace_rays(&tracer);
}
