/* accumulate_lanes.c - the loop over a chunk's triangles.
 *
 * Triangles are collected in blocks. Inside a block they are grouped by the number of voxel planes
 * that cut them along each axis, so that several can be divided and shaded side by side. Their
 * fragments are then added in the order of the triangles, so results do not depend on the grouping.
 * Groups of triangles whose bounds miss the window are skipped. */
#include "libvoxel/voxelize/clip/fragment_block.h"

#include <assert.h>

#include "libvoxel/voxelize/clip/clip.h"
#include "libvoxel/voxelize/clip/shade_lanes.h"

static_assert(sizeof(struct vox_sum) == 64, "sums are two rows of four");
static_assert(sizeof(struct vox_color_sum) == 32, "a colour is a row of four");
static_assert(sizeof(struct block_fragment) == 64, "a fragment begins with a row of four");

/* ---- triangles ---- */

/* Returns the triangles of groups whose normals are inconsistent with their planes. */
LANES_INLINE lane_mask inconsistent_lanes(const struct vox_chunk *chunk,
                                          const struct block_triangle *const triangle[LANE_COUNT])
{
    doubles inconsistent = lanes_all(0.0);
    if (!chunk->inconsistent)
        return lanes_none();
    for (int l = 0; l < LANE_COUNT; l++)
        inconsistent[l] = chunk->inconsistent[triangle[l]->number / VOX_GROUP_TRIANGLES];
    return lanes_less(lanes_all(0.0), inconsistent);
}

/* Loads the triangles with these places in the block, and writes the rows that their fragments
 * share. lowest: the lowest voxel of each. */
LANES_INLINE void load_triangles(const struct vox_accumulation *job,
                                 const uint16_t places[LANE_COUNT], struct shade_triangles *t,
                                 doubles lowest[3])
{
    const struct vox_chunk *chunk = job->chunk;
    const struct block_triangle *triangle[LANE_COUNT];
    struct block_facts *facts[LANE_COUNT];
    const int32_t *low[LANE_COUNT];
    for (int l = 0; l < LANE_COUNT; l++) {
        triangle[l] = &job->block->triangles[places[l]];
        facts[l] = &job->block->facts[places[l]];
        low[l] = triangle[l]->low;
    }
    lanes_gather_integers(low, lowest);
    t->has_normals = chunk->normals != NULL;
    t->curved = t->has_normals && chunk->coarse;
    t->lift_limit = chunk->wide ? SHADE_LIFT_LIMIT : SHADE_LIFT_LIMIT_CLOSE;
    t->marked = t->curved || chunk->inconsistent;
    t->noise_share = chunk->noise_share;
    t->facet = inconsistent_lanes(chunk, triangle);
    t->has_color = job->sums->colors != NULL;
    for (int i = 0; i < 3; i++) {
        const double *points[LANE_COUNT];
        const float *normals[LANE_COUNT];
        for (int l = 0; l < LANE_COUNT; l++) {
            uint32_t vertex = chunk->source.triangles[triangle[l]->number][i];
            points[l] = chunk->points[vertex];
            normals[l] = t->has_normals ? chunk->normals[vertex] : NULL;
        }
        doubles corner[4];
        lanes_gather_four(points, corner);
        for (int k = 0; k < 3; k++)
            t->p[i][k] = corner[k] - lowest[k];
        if (t->has_normals) {
            doubles in[4];
            lanes_gather_floats(normals, in);
            memcpy(t->normal[i], in, sizeof t->normal[i]);
            t->weights.rise[i] = in[3];
        } else {
            memset(t->normal[i], 0, sizeof t->normal[i]);
        }
    }
    for (int l = 0; t->has_color && l < LANE_COUNT; l++) {
        double rgb[3][3];
        t->colored[l] = vox_shade_corners(job->shading, chunk, triangle[l]->number, rgb);
        for (int i = 0; i < 3; i++)
            for (int k = 0; k < 3; k++)
                t->rgb[i][k][l] = rgb[i][k];
    }
    shade_prepare(t);
    shade_put_facts(t, facts);
}

/* Voxels of bounds. Fourth numbers are 0. */
struct cell_bounds {
    four_ints low, high;
};

LANES_INLINE struct cell_bounds cells_of(const struct vox_chunk *chunk, uint32_t triangle)
{
    const uint32_t *v = chunk->source.triangles[triangle];
    struct row p = row_load(chunk->points[v[0]]), q = row_load(chunk->points[v[1]]);
    struct row r = row_load(chunk->points[v[2]]);
    return (struct cell_bounds){vox_cell(row_min(row_min(p, q), r), chunk->last_cell),
                                vox_cell(row_max(row_max(p, q), r), chunk->last_cell)};
}

LANES_INLINE struct cell_bounds bounds_of(const struct vox_box *box)
{
    return (struct cell_bounds){{box->lo[0], box->lo[1], box->lo[2], 0},
                                {box->hi[0], box->hi[1], box->hi[2], 0}};
}

/* ---- small triangles ---- */

/* For each voxel along an axis, from the triangle's lowest on: the bits that it adds to a
 * fragment's number, or all ones if it lies outside the window. A number holds the voxel's number,
 * and above it cell, lane and place as in struct block_fragment. */
struct cell_numbers {
    lane_ints of[DIVIDE_MAX_PLANES + 1];
};

enum { NUMBER_CELL = 32, NUMBER_LANE = 40, NUMBER_PLACE = 48 };

LANES_INLINE void number_cells(const struct vox_accumulation *job, doubles low, int axis,
                               int planes, struct cell_numbers *numbers)
{
    const int shift = 14 - 4 * axis, inner = 6 - 3 * axis, cell = NUMBER_CELL + 4 - 2 * axis;
    const doubles lo = lanes_all(job->window->lo[axis]), hi = lanes_all(job->window->hi[axis]);
    for (int i = 0; i <= planes; i++) {
        doubles at = low + (double)i;
        lane_ints bits = lanes_integer_bits(at - (double)job->region->lo[axis]);
        bits = (bits & 0x78) << shift | (bits & 7) << inner | (long long)i << cell;
        numbers->of[i] = lanes_set_bits(lanes_less(at, lo) | lanes_less(hi, at), bits,
                                        lanes_all_bits(UINT64_MAX));
    }
}

/* Fragments on the way into the block. With eight lanes many would be empty, so fragments are
 * packed one after the other. With fewer lanes, a lane's fragments are those of its triangle, and
 * those not taken go to BLOCK_NOWHERE. */
struct queue {
    uint32_t count;
    _Alignas(64) double area[(DIVIDE_MAX_CELLS + 1) * LANE_COUNT];
    double moment[2][(DIVIDE_MAX_CELLS + 1) * LANE_COUNT];
    long long number[(DIVIDE_MAX_CELLS + 1) * LANE_COUNT];
};

LANES_INLINE lane_ints nowhere(void)
{
    return lanes_all_bits((uint64_t)BLOCK_NOWHERE << NUMBER_PLACE);
}

/* Queues the lanes of the mask. */
LANES_INLINE void queue_lanes(struct queue *queue, lane_mask taken, doubles area,
                              const doubles moment[2], lane_ints number)
{
    const uint32_t at = queue->count;
#if LANE_COUNT == 8
    lanes_store(lanes_pack(taken, area), &queue->area[at]);
    for (int k = 0; k < 2; k++)
        lanes_store(lanes_pack(taken, moment[k]), &queue->moment[k][at]);
    lanes_store_ints((lane_ints)lanes_pack(taken, (doubles)number), &queue->number[at]);
    queue->count = at + (uint32_t)__builtin_popcount(lanes_bits(taken));
#else
    if (lanes_bits(taken) == 0)
        return;
    lanes_store(area, &queue->area[at]);
    for (int k = 0; k < 2; k++)
        lanes_store(moment[k], &queue->moment[k][at]);
    lanes_store_ints((lane_ints)lanes_select(taken, (doubles)number, (doubles)nowhere()),
                     &queue->number[at]);
    queue->count = at + LANE_COUNT;
#endif
}

/* Returns job the weights of queued fragments are computed from. */
LANES_INLINE struct shade_weights weights_of(const struct shade_triangles *t, lane_ints number)
{
#if LANE_COUNT == 8
    return shade_pick(&t->weights, t->curved, number >> NUMBER_LANE);
#else
    (void)number;
    return t->weights;
#endif
}

/* Computes the weights of the queued fragments and puts them into the block. */
LANES_INLINE void put_queue(const struct shade_triangles *t, struct queue *queue,
                            struct vox_fragment_block *block)
{
    lanes_store_ints(nowhere(), &queue->number[queue->count]);
    for (uint32_t done = 0; done < queue->count; done += LANE_COUNT) {
        double *fragments[LANE_COUNT];
        const doubles moment[2] = {lanes_load(&queue->moment[0][done]),
                                   lanes_load(&queue->moment[1][done])};
        doubles area = lanes_load(&queue->area[done]);
        lane_ints number = lanes_load_ints(&queue->number[done]);
        for (uint32_t l = 0; l < LANE_COUNT; l++)
            fragments[l] = &block->fragments[queue->number[done + l] >> NUMBER_PLACE].area;
        if (t->has_normals) {
            const struct shade_weights of = weights_of(t, number);
            doubles normal, center = lanes_all(0.0);
            lane_mask cancels;
            shade_weigh(&of, t->curved, area, moment, &normal, &center, &cancels);
            number = lanes_set_bits(cancels, number,
                                    lanes_all_bits((uint64_t)FRAGMENT_FLAT << NUMBER_CELL));
            const doubles in[6] = {area, moment[0], moment[1], (doubles)number, normal, center};
            lanes_scatter_six(in, fragments);
        } else {
            const doubles in[4] = {area, moment[0], moment[1], (doubles)number};
            lanes_scatter(in, fragments);
        }
    }
}

/* Queues the fragments that divide_small() made, at places from `where` on. Returns the places
 * after the last ones. Of doubtful triangles anything may be queued. */
LANES_INLINE lane_ints queue_divided(const struct shade_triangles *t, const int planes[3],
                                     const struct divide_fragment *fragment,
                                     const struct cell_numbers numbers[3], lane_ints where,
                                     struct queue *queue, lane_mask *doubtful)
{
    const lane_ints next = lanes_all_bits(UINT64_C(1) << NUMBER_PLACE);
    doubles third = t->area / 3.0;
    queue->count = 0;
    for (int x = 0; x <= planes[0]; x++)
        for (int y = 0; y <= planes[1]; y++) {
            lane_ints row = numbers[0].of[x] | numbers[1].of[y];
            for (int z = 0; z <= planes[2]; z++, fragment++) {
                lane_ints number = row | numbers[2].of[z] | where;
                lane_mask taken =
                    divide_touching(fragment, doubtful) & ~lanes_signs((doubles)number);
                const doubles moment[2] = {third * fragment->moment[0],
                                           third * fragment->moment[1]};
                queue_lanes(queue, taken, t->area * fragment->share, moment, number);
                where = lanes_add_ints(taken, where, next);
            }
        }
    return where;
}

/* Divides the first `count` of these triangles. All are of the kind with these numbers of
 * planes. */
LANES_INLINE void divide_batch(const struct vox_accumulation *job,
                               const uint16_t places[LANE_COUNT], uint32_t count,
                               const int planes[3])
{
    struct vox_fragment_block *block = job->block;
    struct divide_fragment fragments[DIVIDE_MAX_CELLS];
    struct shade_triangles t;
    struct cell_numbers numbers[3];
    struct queue queue;
    long long where[LANE_COUNT];
    doubles lowest[3];
    const uint32_t cells = (uint32_t)((planes[0] + 1) * (planes[1] + 1) * (planes[2] + 1));
    for (uint32_t l = 0; l < LANE_COUNT; l++) {
        bool used = l < count;
        where[l] = (long long)l << NUMBER_LANE | (long long)(block->fragment_count + l * cells)
                                                     << NUMBER_PLACE;
        where[l] = used ? where[l] : -1;
    }
    load_triangles(job, places, &t, lowest);
    for (int a = 0; a < 3; a++)
        number_cells(job, lowest[a], a, planes[a], &numbers[a]);
    lane_mask doubtful = divide_small((const doubles(*)[3])t.p, planes, fragments);
    lane_ints after =
        queue_divided(&t, planes, fragments, numbers, lanes_load_ints(where), &queue, &doubtful);
    lanes_store_ints(after, where);
    put_queue(&t, &queue, block);
    for (uint32_t l = 0; l < count; l++) {
        struct block_triangle *triangle = &block->triangles[places[l]];
        uint32_t first = block->fragment_count + l * cells;
        triangle->first = (uint16_t)first;
        triangle->count = (uint16_t)((uint32_t)(where[l] >> NUMBER_PLACE) - first);
        triangle->alone = lanes_bits(doubtful) >> l & 1;
    }
    block->fragment_count += count * cells;
}

/* Divides triangles of the kind with these numbers of planes. */
LANES_INLINE void divide_with(const struct vox_accumulation *job, const uint16_t *order,
                              uint32_t count, const int planes[3])
{
    for (uint32_t done = 0; done < count; done += LANE_COUNT) {
        uint32_t left = count - done;
        uint16_t padded[LANE_COUNT];
        for (uint32_t l = 0; left < LANE_COUNT && l < LANE_COUNT; l++)
            padded[l] = order[done + (l < left ? l : 0)];
        divide_batch(job, left < LANE_COUNT ? padded : order + done,
                     left < LANE_COUNT ? left : LANE_COUNT, planes);
    }
}

/* Divides triangles that lie in one voxel: a quarter to a half if a scan is fine for its grid.
 * Compiled without the code for planes. */
static __attribute__((noinline)) void divide_whole(const struct vox_accumulation *job,
                                                   const uint16_t *order, uint32_t count)
{
    divide_with(job, order, count, (const int[3]){0, 0, 0});
}

static void divide_kind(const struct vox_accumulation *job, const uint16_t *order, uint32_t count,
                        uint32_t kind)
{
    const int planes[3] = {(int)(kind >> 4), (int)(kind >> 2 & 3), (int)(kind & 3)};
    if (kind == 0)
        divide_whole(job, order, count);
    else
        divide_with(job, order, count, planes);
}

/* ---- fragments ---- */

/* Where fragments come from and go to, and which rows they have. */
struct source {
    const struct vox_fragment_block *block;
    struct vox_accumulator *sums;
    bool smooth, marked, curved, has_color;
};

LANES_INLINE struct source source_of(const struct vox_accumulation *job)
{
    bool smooth = job->chunk->normals != NULL;
    return (struct source){.block = job->block,
                           .sums = job->sums,
                           .smooth = smooth,
                           .marked = smooth && (job->chunk->coarse || job->chunk->inconsistent),
                           .curved = smooth && job->chunk->coarse,
                           .has_color = job->sums->colors != NULL};
}

/* Adds a fragment of the triangle at this place. cell: lower corner of its voxel, relative to that
 * of the triangle's lowest. rgb: its colour, and 1; NULL: interpolated from the triangle's. */
LANES_INLINE int add_fragment(const struct source *from, uint32_t place,
                              const struct block_fragment *fragment, const double cell[4],
                              const double rgb[4])
{
    const struct block_facts *facts = &from->block->facts[place];
    struct vox_fragment_sum sum;
    if (from->smooth && !(fragment->cell & FRAGMENT_FLAT))
        shade_smooth(facts, fragment, cell, from->marked, from->curved, &sum);
    else
        shade_flat(facts, fragment, cell, &sum);
    if (rgb)
        sum.color = row_times(fragment->area, row_load(rgb));
    else if (from->has_color)
        sum.color = shade_mean(shade_rows(facts, ROW_COLOR), fragment);
    else
        sum.color = (struct row){0};
    return vox_accumulator_add(from->sums, fragment->voxel, &sum, from->has_color);
}

LANES_INLINE int add_run(const struct source *from, const uint32_t *run, uint32_t count)
{
    int status = vox_accumulator_reserve(from->sums);
    if (status != 0)
        return status;
    for (uint32_t i = 0; i < count; i++) {
        const struct block_fragment *fragment =
            &from->block->fragments[run[i] % BLOCK_RUN_TRIANGLE];
        status |= add_fragment(from, run[i] / BLOCK_RUN_TRIANGLE, fragment,
                               shade_cells[fragment->cell % FRAGMENT_FLAT], NULL);
    }
    return status;
}

LANES_INLINE int add_runs(const struct source *from, uint32_t count)
{
    int status = 0;
    for (uint32_t done = 0; done < count && status == 0; done += VOX_FRAGMENTS_AT_ONCE) {
        uint32_t left = count - done;
        status = add_run(from, from->block->run + done,
                         left < VOX_FRAGMENTS_AT_ONCE ? left : VOX_FRAGMENTS_AT_ONCE);
    }
    return status;
}

/* Adds the first `count` fragments of the run. Constant flags let the compiler make a loop for most
 * scans without the code for the others. */
LANES_INLINE int add_fragments(const struct vox_accumulation *job, uint32_t count)
{
    struct source from = source_of(job);
    if (from.has_color)
        return add_runs(&from, count);
    from.has_color = false;
    if (!from.smooth) {
        from.smooth = false;
        return add_runs(&from, count);
    }
    from.smooth = true;
    return add_runs(&from, count);
}

typedef uint32_t run_step __attribute__((vector_size(4 * BLOCK_RUN_STEP)));

/* Appends the fragments of the triangle at this place to the run. Most triangles have so few that
 * there is no branch to mispredict. */
LANES_INLINE uint32_t append_fragments(struct vox_fragment_block *block, uint32_t place,
                                       uint32_t count)
{
    const struct block_triangle *triangle = &block->triangles[place];
    run_step entries =
        place * BLOCK_RUN_TRIANGLE + triangle->first + (run_step){0, 1, 2, 3, 4, 5, 6, 7};
    for (uint32_t done = 0; done < triangle->count || done == 0; done += BLOCK_RUN_STEP) {
        memcpy(&block->run[count + done], &entries, sizeof entries);
        entries += BLOCK_RUN_STEP;
    }
    return count + triangle->count;
}

/* ---- other triangles ---- */

/* A triangle, the same in all lanes, that is clipped alone. Its fragments wait until all lanes are
 * filled. */
struct single {
    const struct vox_accumulation *job;
    struct source from;
    uint32_t place;
    const int32_t *low;
    struct shade_triangles triangles;
    uint32_t image; /* UINT32_MAX: no texture */
    double area, uv[3][2];
    struct queue queue;
    double cells[LANE_COUNT][4], rgb[LANE_COUNT][4];
};

static int add_waiting(struct single *s)
{
    bool textured = s->image != UINT32_MAX;
    int status = vox_accumulator_reserve(s->from.sums);
    put_queue(&s->triangles, &s->queue, s->job->block);
    for (uint32_t i = 0; i < s->queue.count && status == 0; i++)
        status = add_fragment(&s->from, s->place, &s->job->block->fragments[BLOCK_FRAGMENTS + i],
                              s->cells[i], textured ? s->rgb[i] : NULL);
    s->queue.count = 0;
    return status;
}

static int take_fragment(void *arg, const struct vox_fragment *fragment)
{
    struct single *s = arg;
    const int32_t *origin = s->job->region->lo;
    uint32_t i = s->queue.count++, at[3];
    double area = s->area * fragment->fraction;
    area = area > VOX_NO_AREA ? area : VOX_NO_AREA;
    s->queue.area[i] = area;
    for (int k = 0; k < 2; k++)
        s->queue.moment[k][i] = area * fragment->b[k];
    for (int k = 0; k < 3; k++) {
        s->cells[i][k] = fragment->cell[k] - s->low[k];
        at[k] = (uint32_t)(fragment->cell[k] - origin[k]);
    }
    s->queue.number[i] = vox_voxel_number(at[0], at[1], at[2]) | (long long)(BLOCK_FRAGMENTS + i)
                                                                     << NUMBER_PLACE;
    if (s->image != UINT32_MAX) {
        int status = vox_shade_texture(s->job->shading, s->image, (const double(*)[2])s->uv,
                                       fragment->b, fragment->uv_extent, s->rgb[i]);
        if (status < 0)
            return status;
    }
    return s->queue.count == LANE_COUNT ? add_waiting(s) : 0;
}

static __attribute__((noinline)) int add_alone(const struct vox_accumulation *job, uint32_t place)
{
    const struct vox_chunk *chunk = job->chunk;
    const struct block_triangle *triangle = &job->block->triangles[place];
    const uint32_t *v = chunk->source.triangles[triangle->number];
    struct cell_bounds bounds = cells_of(chunk, triangle->number);
    struct vox_box cells;
    memcpy(cells.lo, &bounds.low, sizeof cells.lo);
    memcpy(cells.hi, &bounds.high, sizeof cells.hi);
    struct vox_clip_triangle clip = {
        .corner = {chunk->points[v[0]], chunk->points[v[1]], chunk->points[v[2]]},
        .cells = &cells,
    };
    struct single s;
    doubles lowest[3];
    uint16_t places[LANE_COUNT];
    s.job = job;
    s.from = source_of(job);
    s.place = place;
    s.low = triangle->low;
    s.queue.count = 0;
    for (int l = 0; l < LANE_COUNT; l++) {
        places[l] = (uint16_t)place;
        s.cells[l][3] = 0.0;
        s.rgb[l][3] = 1.0;
    }
    load_triangles(job, places, &s.triangles, lowest);
    s.area = s.triangles.area[0];
    s.image = vox_shade_image(job->shading, chunk, triangle->number);
    if (s.image != UINT32_MAX) {
        for (int i = 0; i < 3; i++)
            for (int k = 0; k < 2; k++)
                s.uv[i][k] = (double)chunk->source.texcoords[v[i]][k];
        clip.uv = (const double(*)[2])s.uv;
    }
    int status = vox_clip(&clip, job->region, job->window, take_fragment, &s);
    return status == 0 && s.queue.count > 0 ? add_waiting(&s) : status;
}

/* ---- blocks ---- */

static bool contains(const struct vox_box *box, const int32_t cell[3])
{
    bool outside = false;
    for (int k = 0; k < 3; k++)
        outside |= (cell[k] < box->lo[k]) | (cell[k] > box->hi[k]);
    return !outside;
}

/* Adds the block's triangles, and empties the block. */
static int add_block(const struct vox_accumulation *job)
{
    struct vox_fragment_block *block = job->block;
    uint32_t counts[KIND_COUNT] = {0}, begin = 0;
    uint32_t starts[KIND_COUNT];
    int status = 0;
    for (uint32_t i = 0; i < block->triangle_count; i++)
        counts[block->triangles[i].kind]++;
    for (uint32_t kind = 0; kind < KIND_COUNT; kind++) {
        starts[kind] = begin;
        begin += counts[kind];
    }
    for (uint32_t i = 0; i < block->triangle_count; i++)
        block->order[starts[block->triangles[i].kind]++] = (uint16_t)i;
    for (uint32_t kind = 0; kind < KIND_LARGE; kind++)
        if (counts[kind] > 0)
            divide_kind(job, block->order + starts[kind] - counts[kind], counts[kind], kind);
    uint32_t count = 0;
    for (uint32_t place = 0; place < block->triangle_count && status == 0; place++) {
        if (!block->triangles[place].alone) {
            count = append_fragments(block, place, count);
            continue;
        }
        status = add_fragments(job, count);
        count = 0;
        if (status == 0)
            status = add_alone(job, place);
    }
    if (status == 0)
        status = add_fragments(job, count);
    block->triangle_count = 0;
    block->fragment_count = 0;
    return status;
}

/* Prefetches job the triangle needs in add_group() and later in the block. */
LANES_INLINE void prefetch_triangle(const struct vox_chunk *chunk, uint32_t triangle)
{
    for (int i = 0; i < 3; i++) {
        uint32_t vertex = chunk->source.triangles[triangle][i];
        __builtin_prefetch(chunk->points[vertex]);
        if (chunk->normals)
            __builtin_prefetch(chunk->normals[vertex]);
    }
}

enum { PREFETCH_AHEAD = 12 };

/* Puts the triangles from begin to end that meet the window into the block. capacity: fragments
 * that the block can still take. */
static int add_group(const struct vox_accumulation *job, uint32_t begin, uint32_t end,
                     uint32_t *capacity)
{
    struct vox_fragment_block *block = job->block;
    const struct cell_bounds window = bounds_of(job->window);
    int status = 0;
    for (uint32_t i = begin; i < end && status == 0; i++) {
        if (i + PREFETCH_AHEAD < job->chunk->source.triangle_count)
            prefetch_triangle(job->chunk, i + PREFETCH_AHEAD);
        struct cell_bounds cells = cells_of(job->chunk, i);
        if (four_any((cells.low > window.high) | (cells.high < window.low)))
            continue;
        four_ints planes = cells.high - cells.low;
        uint32_t fragments = 0, kind = KIND_LARGE;
        if (!four_any(planes > DIVIDE_MAX_PLANES) &&
            (!job->shading->textures ||
             vox_shade_image(job->shading, job->chunk, i) == UINT32_MAX)) {
            kind = (uint32_t)(planes[0] << 4 | planes[1] << 2 | planes[2]);
            fragments = (uint32_t)((planes[0] + 1) * (planes[1] + 1) * (planes[2] + 1));
        }
        if (fragments > *capacity || block->triangle_count == BLOCK_TRIANGLES) {
            status = add_block(job);
            *capacity = BLOCK_FRAGMENTS;
        }
        *capacity -= fragments;
        struct block_triangle *to = &block->triangles[block->triangle_count++];
        memcpy(to->low, &cells.low, sizeof to->low);
        to->number = i;
        to->kind = (uint8_t)kind;
        to->alone = kind == KIND_LARGE;
    }
    return status;
}

int BSQ_SIMD_NAME(vox_accumulate_chunk)(const struct vox_accumulation *job, uint64_t *counted)
{
    const struct vox_chunk *chunk = job->chunk;
    uint32_t count = chunk->source.triangle_count, capacity = BLOCK_FRAGMENTS;
    int status = 0;
    job->block->triangle_count = job->block->fragment_count = 0;
    for (uint32_t g = 0; g < chunk->group_count && status == 0; g++) {
        const struct vox_box *bounds = &chunk->groups[g];
        if (!vox_boxes_meet(bounds, job->window))
            continue;
        uint32_t begin = g * VOX_GROUP_TRIANGLES,
                 end = vox_group_end(begin, count, VOX_GROUP_TRIANGLES);
        status = add_group(job, begin, end, &capacity);
        if (contains(job->window, bounds->lo))
            *counted += end - begin;
    }
    return status == 0 ? add_block(job) : status;
}
