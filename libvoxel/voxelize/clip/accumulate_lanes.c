/* accumulate_lanes.c - the loop over triangles.
 *
 * Triangles are taken in blocks. Inside a block they are grouped by the number of planes that cut
 * them along each axis, so that several can be divided and shaded side by side; the pieces are then
 * added in the order of the triangles, so that nothing shows of the grouping. Runs of triangles
 * that miss the window are passed over by their bounds. */
#include "libvoxel/voxelize/clip/fragment_block.h"

#include <assert.h>

#include "libvoxel/voxelize/clip/clip.h"
#include "libvoxel/voxelize/clip/shade_lanes.h"

static_assert(sizeof(struct vox_sum) == 64, "sums are two rows of four");
static_assert(sizeof(struct vox_color_sum) == 32, "a colour is a row of four");
static_assert(sizeof(struct block_piece) == 64, "a piece begins with a row of four");

/* ---- triangles ---- */

/* Triangles of runs whose normals do not go with their planes. */
LANES_INLINE lane_mask stray_lanes(const struct vox_chunk *chunk,
                                   const struct block_triangle *const triangle[LANE_COUNT])
{
    doubles stray = lanes_all(0.0);
    if (!chunk->stray)
        return lanes_none();
    for (int l = 0; l < LANE_COUNT; l++)
        stray[l] = chunk->stray[triangle[l]->number / VOX_GROUP_TRIANGLES];
    return lanes_less(lanes_all(0.0), stray);
}

/* Corners, and what goes with them, of the triangles with these places in the block; puts down what
 * their pieces have in common. lowest: their lowest cells. */
LANES_INLINE void load_triangles(const struct vox_accumulation *what,
                                 const uint16_t places[LANE_COUNT], struct shade_triangles *t,
                                 doubles lowest[3])
{
    const struct vox_chunk *chunk = what->chunk;
    const struct block_triangle *triangle[LANE_COUNT];
    struct block_facts *facts[LANE_COUNT];
    const int32_t *low[LANE_COUNT];
    for (int l = 0; l < LANE_COUNT; l++) {
        triangle[l] = &what->block->triangles[places[l]];
        facts[l] = &what->block->facts[places[l]];
        low[l] = triangle[l]->low;
    }
    lanes_gather_integers(low, lowest);
    t->has_normals = chunk->normals != NULL;
    t->curved = t->has_normals && chunk->coarse;
    t->lift_limit = chunk->wide ? SHADE_LIFT_LIMIT : SHADE_LIFT_LIMIT_CLOSE;
    t->marked = t->curved || chunk->stray;
    t->grain_share = chunk->grain_share;
    t->facet = stray_lanes(chunk, triangle);
    t->has_color = what->sums->colors != NULL;
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
        t->colored[l] = vox_shade_corners(what->shading, chunk, triangle[l]->number, rgb);
        for (int i = 0; i < 3; i++)
            for (int k = 0; k < 3; k++)
                t->rgb[i][k][l] = rgb[i][k];
    }
    shade_prepare(t);
    shade_put_facts(t, facts);
}

/* Cells of a triangle's bounds, and a last number that is 0. */
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

/* Along an axis: what each cell from the lowest on adds to a piece's number, or all ones where it
 * is beside the window. The number is that of the piece's voxel, and above that its cell, lane and
 * place, as in struct block_piece. */
struct cell_numbers {
    lane_ints of[DIVIDE_MAX_PLANES + 1];
};

enum { NUMBER_CELL = 32, NUMBER_LANE = 40, NUMBER_PLACE = 48 };

LANES_INLINE void number_cells(const struct vox_accumulation *what, doubles low, int axis,
                               int planes, struct cell_numbers *numbers)
{
    const int shift = 14 - 4 * axis, inner = 6 - 3 * axis, cell = NUMBER_CELL + 4 - 2 * axis;
    const doubles lo = lanes_all(what->window->lo[axis]), hi = lanes_all(what->window->hi[axis]);
    for (int i = 0; i <= planes; i++) {
        doubles at = low + (double)i;
        lane_ints bits = lanes_integer_bits(at - (double)what->region->lo[axis]);
        bits = (bits & 0x78) << shift | (bits & 7) << inner | (long long)i << cell;
        numbers->of[i] = lanes_set_bits(lanes_less(at, lo) | lanes_less(hi, at), bits,
                                        lanes_all_bits(UINT64_MAX));
    }
}

/* Pieces on their way into the block. Eight lanes would often be half empty, and are filled one
 * after the other; with fewer, a lane's pieces are those of its triangle, and some go nowhere. */
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

/* Queues the lanes that are taken. */
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

/* What the weights of queued pieces follow from. */
LANES_INLINE struct shade_weights weights_of(const struct shade_triangles *t, lane_ints number)
{
#if LANE_COUNT == 8
    return shade_pick(&t->weights, t->curved, number >> NUMBER_LANE);
#else
    (void)number;
    return t->weights;
#endif
}

/* Weighs the queue's pieces and puts them into the block. */
LANES_INLINE void put_queue(const struct shade_triangles *t, struct queue *queue,
                            struct vox_block *block)
{
    lanes_store_ints(nowhere(), &queue->number[queue->count]);
    for (uint32_t done = 0; done < queue->count; done += LANE_COUNT) {
        double *pieces[LANE_COUNT];
        const doubles moment[2] = {lanes_load(&queue->moment[0][done]),
                                   lanes_load(&queue->moment[1][done])};
        doubles area = lanes_load(&queue->area[done]);
        lane_ints number = lanes_load_ints(&queue->number[done]);
        for (uint32_t l = 0; l < LANE_COUNT; l++)
            pieces[l] = &block->pieces[queue->number[done + l] >> NUMBER_PLACE].area;
        if (t->has_normals) {
            const struct shade_weights of = weights_of(t, number);
            doubles normal, center = lanes_all(0.0);
            lane_mask cancels;
            shade_weigh(&of, t->curved, area, moment, &normal, &center, &cancels);
            number = lanes_set_bits(cancels, number,
                                    lanes_all_bits((uint64_t)PIECE_FLAT << NUMBER_CELL));
            const doubles in[6] = {area, moment[0], moment[1], (doubles)number, normal, center};
            lanes_scatter_six(in, pieces);
        } else {
            const doubles in[4] = {area, moment[0], moment[1], (doubles)number};
            lanes_scatter(in, pieces);
        }
    }
}

/* Queues what divide_small() has made of triangles, their pieces with places from `where` on.
 * Returns the places behind. Of doubtful triangles anything may be queued. */
LANES_INLINE lane_ints queue_divided(const struct shade_triangles *t, const int planes[3],
                                     const struct divide_piece *piece,
                                     const struct cell_numbers numbers[3], lane_ints where,
                                     struct queue *queue, lane_mask *doubtful)
{
    const lane_ints next = lanes_all_bits(UINT64_C(1) << NUMBER_PLACE);
    doubles part = t->area / 3.0;
    queue->count = 0;
    for (int x = 0; x <= planes[0]; x++)
        for (int y = 0; y <= planes[1]; y++) {
            lane_ints row = numbers[0].of[x] | numbers[1].of[y];
            for (int z = 0; z <= planes[2]; z++, piece++) {
                lane_ints number = row | numbers[2].of[z] | where;
                lane_mask taken = divide_touching(piece, doubtful) & ~lanes_signs((doubles)number);
                const doubles moment[2] = {part * piece->moment[0], part * piece->moment[1]};
                queue_lanes(queue, taken, t->area * piece->share, moment, number);
                where = lanes_add_ints(taken, where, next);
            }
        }
    return where;
}

/* Divides the first `count` of these triangles, all of the kind that has these planes. */
LANES_INLINE void divide_batch(const struct vox_accumulation *what,
                               const uint16_t places[LANE_COUNT], uint32_t count,
                               const int planes[3])
{
    struct vox_block *block = what->block;
    struct divide_piece pieces[DIVIDE_MAX_CELLS];
    struct shade_triangles t;
    struct cell_numbers numbers[3];
    struct queue queue;
    long long where[LANE_COUNT];
    doubles lowest[3];
    const uint32_t cells = (uint32_t)((planes[0] + 1) * (planes[1] + 1) * (planes[2] + 1));
    for (uint32_t l = 0; l < LANE_COUNT; l++) {
        bool used = l < count;
        where[l] = (long long)l << NUMBER_LANE | (long long)(block->piece_count + l * cells)
                                                     << NUMBER_PLACE;
        where[l] = used ? where[l] : -1;
    }
    load_triangles(what, places, &t, lowest);
    for (int a = 0; a < 3; a++)
        number_cells(what, lowest[a], a, planes[a], &numbers[a]);
    lane_mask doubtful = divide_small((const doubles(*)[3])t.p, planes, pieces);
    lane_ints behind =
        queue_divided(&t, planes, pieces, numbers, lanes_load_ints(where), &queue, &doubtful);
    lanes_store_ints(behind, where);
    put_queue(&t, &queue, block);
    for (uint32_t l = 0; l < count; l++) {
        struct block_triangle *triangle = &block->triangles[places[l]];
        uint32_t first = block->piece_count + l * cells;
        triangle->first = (uint16_t)first;
        triangle->count = (uint16_t)((uint32_t)(where[l] >> NUMBER_PLACE) - first);
        triangle->alone = lanes_bits(doubtful) >> l & 1;
    }
    block->piece_count += count * cells;
}

/* Divides triangles of the kind that has these planes. */
LANES_INLINE void divide_with(const struct vox_accumulation *what, const uint16_t *order,
                              uint32_t count, const int planes[3])
{
    for (uint32_t done = 0; done < count; done += LANE_COUNT) {
        uint32_t left = count - done;
        uint16_t padded[LANE_COUNT];
        for (uint32_t l = 0; left < LANE_COUNT && l < LANE_COUNT; l++)
            padded[l] = order[done + (l < left ? l : 0)];
        divide_batch(what, left < LANE_COUNT ? padded : order + done,
                     left < LANE_COUNT ? left : LANE_COUNT, planes);
    }
}

/* Triangles that lie in one voxel, as a quarter to a half do where a scan is fine for its grid:
 * compiled without what planes need. */
static __attribute__((noinline)) void divide_whole(const struct vox_accumulation *what,
                                                   const uint16_t *order, uint32_t count)
{
    divide_with(what, order, count, (const int[3]){0, 0, 0});
}

static void divide_kind(const struct vox_accumulation *what, const uint16_t *order, uint32_t count,
                        uint32_t kind)
{
    const int planes[3] = {(int)(kind >> 4), (int)(kind >> 2 & 3), (int)(kind & 3)};
    if (kind == 0)
        divide_whole(what, order, count);
    else
        divide_with(what, order, count, planes);
}

/* ---- pieces ---- */

/* Where pieces come from, and go. */
struct source {
    const struct vox_block *block;
    struct vox_accumulator *sums;
    bool smooth, marked, curved, has_color;
};

LANES_INLINE struct source source_of(const struct vox_accumulation *what)
{
    bool smooth = what->chunk->normals != NULL;
    return (struct source){.block = what->block,
                           .sums = what->sums,
                           .smooth = smooth,
                           .marked = smooth && (what->chunk->coarse || what->chunk->stray),
                           .curved = smooth && what->chunk->coarse,
                           .has_color = what->sums->colors != NULL};
}

/* Adds a piece of the triangle at this place. cell: lower corner of its voxel, from that of the
 * triangle's lowest. rgb: its colour, and 1; NULL: that of the triangle. */
LANES_INLINE int add_piece(const struct source *from, uint32_t place,
                           const struct block_piece *piece, const double cell[4],
                           const double rgb[4])
{
    const struct block_facts *facts = &from->block->facts[place];
    struct vox_piece_sum sum;
    if (from->smooth && !(piece->cell & PIECE_FLAT))
        shade_smooth(facts, piece, cell, from->marked, from->curved, &sum);
    else
        shade_flat(facts, piece, cell, &sum);
    if (rgb)
        sum.color = row_times(piece->area, row_load(rgb));
    else if (from->has_color)
        sum.color = shade_mean(shade_rows(facts, ROW_COLOR), piece);
    else
        sum.color = (struct row){0};
    return vox_accumulator_add(from->sums, piece->voxel, &sum, from->has_color);
}

LANES_INLINE int add_run(const struct source *from, const uint32_t *run, uint32_t count)
{
    int status = vox_accumulator_make_room(from->sums);
    if (status != 0)
        return status;
    for (uint32_t i = 0; i < count; i++) {
        const struct block_piece *piece = &from->block->pieces[run[i] % BLOCK_RUN_TRIANGLE];
        status |= add_piece(from, run[i] / BLOCK_RUN_TRIANGLE, piece,
                            shade_cells[piece->cell % PIECE_FLAT], NULL);
    }
    return status;
}

LANES_INLINE int add_runs(const struct source *from, uint32_t count)
{
    int status = 0;
    for (uint32_t done = 0; done < count && status == 0; done += VOX_PIECES_AT_ONCE) {
        uint32_t left = count - done;
        status = add_run(from, from->block->run + done,
                         left < VOX_PIECES_AT_ONCE ? left : VOX_PIECES_AT_ONCE);
    }
    return status;
}

/* Adds the first pieces of the block's run. The compiler is told what is known, so that what most
 * scans need has loops without what only others do. */
LANES_INLINE int add_pieces(const struct vox_accumulation *what, uint32_t count)
{
    struct source from = source_of(what);
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

/* Puts the pieces of the triangle at this place behind the block's run. Most have so few that there
 * is no branch to foresee. */
LANES_INLINE uint32_t append_pieces(struct vox_block *block, uint32_t place, uint32_t count)
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

/* A triangle, the same in all lanes, whose pieces come one after the other and wait for lanes to
 * fill. */
struct single {
    const struct vox_accumulation *what;
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
    int status = vox_accumulator_make_room(s->from.sums);
    put_queue(&s->triangles, &s->queue, s->what->block);
    for (uint32_t i = 0; i < s->queue.count && status == 0; i++)
        status = add_piece(&s->from, s->place, &s->what->block->pieces[BLOCK_PIECES + i],
                           s->cells[i], textured ? s->rgb[i] : NULL);
    s->queue.count = 0;
    return status;
}

static int take_piece(void *arg, const struct vox_piece *piece)
{
    struct single *s = arg;
    const int32_t *origin = s->what->region->lo;
    uint32_t i = s->queue.count++, at[3];
    double area = s->area * piece->fraction;
    area = area > VOX_NO_AREA ? area : VOX_NO_AREA;
    s->queue.area[i] = area;
    for (int k = 0; k < 2; k++)
        s->queue.moment[k][i] = area * piece->b[k];
    for (int k = 0; k < 3; k++) {
        s->cells[i][k] = piece->cell[k] - s->low[k];
        at[k] = (uint32_t)(piece->cell[k] - origin[k]);
    }
    s->queue.number[i] = vox_voxel_number(at[0], at[1], at[2]) | (long long)(BLOCK_PIECES + i)
                                                                     << NUMBER_PLACE;
    if (s->image != UINT32_MAX) {
        int status = vox_shade_texture(s->what->shading, s->image, (const double(*)[2])s->uv,
                                       piece->b, piece->uv_extent, s->rgb[i]);
        if (status < 0)
            return status;
    }
    return s->queue.count == LANE_COUNT ? add_waiting(s) : 0;
}

static __attribute__((noinline)) int add_alone(const struct vox_accumulation *what, uint32_t place)
{
    const struct vox_chunk *chunk = what->chunk;
    const struct block_triangle *triangle = &what->block->triangles[place];
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
    s.what = what;
    s.from = source_of(what);
    s.place = place;
    s.low = triangle->low;
    s.queue.count = 0;
    for (int l = 0; l < LANE_COUNT; l++) {
        places[l] = (uint16_t)place;
        s.cells[l][3] = 0.0;
        s.rgb[l][3] = 1.0;
    }
    load_triangles(what, places, &s.triangles, lowest);
    s.area = s.triangles.area[0];
    s.image = vox_shade_image(what->shading, chunk, triangle->number);
    if (s.image != UINT32_MAX) {
        for (int i = 0; i < 3; i++)
            for (int k = 0; k < 2; k++)
                s.uv[i][k] = (double)chunk->source.texcoords[v[i]][k];
        clip.uv = (const double(*)[2])s.uv;
    }
    int status = vox_clip(&clip, what->region, what->window, take_piece, &s);
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

/* Adds the block's triangles, and empties it. */
static int add_block(const struct vox_accumulation *what)
{
    struct vox_block *block = what->block;
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
            divide_kind(what, block->order + starts[kind] - counts[kind], counts[kind], kind);
    uint32_t count = 0;
    for (uint32_t place = 0; place < block->triangle_count && status == 0; place++) {
        if (!block->triangles[place].alone) {
            count = append_pieces(block, place, count);
            continue;
        }
        status = add_pieces(what, count);
        count = 0;
        if (status == 0)
            status = add_alone(what, place);
    }
    if (status == 0)
        status = add_pieces(what, count);
    block->triangle_count = 0;
    block->piece_count = 0;
    return status;
}

/* Asks for what the triangle needs here, and later in the block. */
LANES_INLINE void ask_for(const struct vox_chunk *chunk, uint32_t triangle)
{
    for (int i = 0; i < 3; i++) {
        uint32_t vertex = chunk->source.triangles[triangle][i];
        __builtin_prefetch(chunk->points[vertex]);
        if (chunk->normals)
            __builtin_prefetch(chunk->normals[vertex]);
    }
}

enum { ASK_AHEAD = 12 };

/* Puts the triangles from begin to end that meet the window into the block. */
static int add_group(const struct vox_accumulation *what, uint32_t begin, uint32_t end,
                     uint32_t *room)
{
    struct vox_block *block = what->block;
    const struct cell_bounds window = bounds_of(what->window);
    int status = 0;
    for (uint32_t i = begin; i < end && status == 0; i++) {
        if (i + ASK_AHEAD < what->chunk->source.triangle_count)
            ask_for(what->chunk, i + ASK_AHEAD);
        struct cell_bounds cells = cells_of(what->chunk, i);
        if (four_any((cells.low > window.high) | (cells.high < window.low)))
            continue;
        four_ints planes = cells.high - cells.low;
        uint32_t pieces = 0, kind = KIND_LARGE;
        if (!four_any(planes > DIVIDE_MAX_PLANES) &&
            (!what->shading->textures ||
             vox_shade_image(what->shading, what->chunk, i) == UINT32_MAX)) {
            kind = (uint32_t)(planes[0] << 4 | planes[1] << 2 | planes[2]);
            pieces = (uint32_t)((planes[0] + 1) * (planes[1] + 1) * (planes[2] + 1));
        }
        if (pieces > *room || block->triangle_count == BLOCK_TRIANGLES) {
            status = add_block(what);
            *room = BLOCK_PIECES;
        }
        *room -= pieces;
        struct block_triangle *to = &block->triangles[block->triangle_count++];
        memcpy(to->low, &cells.low, sizeof to->low);
        to->number = i;
        to->kind = (uint8_t)kind;
        to->alone = kind == KIND_LARGE;
    }
    return status;
}

int BSQ_SIMD_NAME(vox_accumulate_chunk)(const struct vox_accumulation *what, uint64_t *counted)
{
    const struct vox_chunk *chunk = what->chunk;
    uint32_t count = chunk->source.triangle_count, room = BLOCK_PIECES;
    int status = 0;
    what->block->triangle_count = what->block->piece_count = 0;
    for (uint32_t g = 0; g < chunk->group_count && status == 0; g++) {
        const struct vox_box *bounds = &chunk->groups[g];
        if (!vox_boxes_meet(bounds, what->window))
            continue;
        uint32_t begin = g * VOX_GROUP_TRIANGLES,
                 end = vox_group_end(begin, count, VOX_GROUP_TRIANGLES);
        status = add_group(what, begin, end, &room);
        if (contains(what->window, bounds->lo))
            *counted += end - begin;
    }
    return status == 0 ? add_block(what) : status;
}
