/* accumulate_lanes.h - the loop over triangles; included by a source for each kind of instructions.
 *
 * Triangles are taken in blocks. Inside a block they are grouped by the number of planes that cut
 * them along each axis, so that several can be divided and shaded side by side; the pieces are then
 * added in the order of the triangles, so that nothing shows of the grouping. Runs of triangles
 * that miss the window are passed over by their bounds. */
#ifndef VOX_ACCUMULATE_LANES_H
#define VOX_ACCUMULATE_LANES_H

#include <assert.h>

#include "libvoxel/block.h"
#include "libvoxel/clip.h"
#include "libvoxel/shade_lanes.h"

static_assert(sizeof(struct vox_sum) == 64, "sums are two rows of four");
static_assert(sizeof(struct vox_color_sum) == 32, "a colour is a row of four");
static_assert(sizeof(struct block_piece) == 64, "a piece begins with a row of four");

/* ---- triangles ---- */

/* Corners, and what goes with them, of the triangles with these places in the block; puts down what
 * their pieces have in common. */
LANES_INLINE void load_triangles(const struct vox_accumulation *what,
                                 const uint16_t places[LANE_COUNT], struct shade_triangles *t)
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
    t->has_normals = chunk->normals != NULL;
    t->curved = t->has_normals && chunk->coarse;
    t->lift_limit = chunk->wide ? SHADE_LIFT_LIMIT : SHADE_LIFT_LIMIT_CLOSE;
    t->detached = t->curved && !chunk->rises && chunk->large;
    t->has_color = what->sums->colors != NULL;
    for (int i = 0; i < 3; i++) {
        const double *points[LANE_COUNT];
        const float *normals[LANE_COUNT], *rises[LANE_COUNT];
        for (int l = 0; l < LANE_COUNT; l++) {
            uint32_t vertex = chunk->source.triangles[triangle[l]->number][i];
            points[l] = chunk->points[vertex];
            normals[l] = t->has_normals ? chunk->normals[vertex] : NULL;
            rises[l] = chunk->rises ? &chunk->rises[vertex] : NULL;
        }
        lanes_gather(points, low, t->p[i]);
        t->rise[i] = chunk->rises ? lanes_gather_float(rises) : lanes_all(0.0);
        if (t->has_normals)
            lanes_gather_floats(normals, t->normal[i]);
        else
            memset(t->normal[i], 0, sizeof t->normal[i]);
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
    four_ints p = four_load(chunk->cells[v[0]]), q = four_load(chunk->cells[v[1]]);
    four_ints r = four_load(chunk->cells[v[2]]);
    return (struct cell_bounds){four_min(four_min(p, q), r), four_max(four_max(p, q), r)};
}

LANES_INLINE struct cell_bounds bounds_of(const struct vox_box *box)
{
    return (struct cell_bounds){{box->lo[0], box->lo[1], box->lo[2], 0},
                                {box->hi[0], box->hi[1], box->hi[2], 0}};
}

/* ---- small triangles ---- */

/* Along an axis: what each cell from the lowest on adds to a voxel's number in the low and to a
 * piece's cell in the high half, or all ones where it is beside the window. */
struct cell_numbers {
    lane_mask of[DIVIDE_MAX_PLANES + 1];
};

LANES_INLINE void number_cells(const struct vox_accumulation *what, lanes low, int axis, int planes,
                               struct cell_numbers *numbers)
{
    const int shift = 14 - 4 * axis, inner = 6 - 3 * axis, cell = 32 + 4 - 2 * axis;
    double lo = what->window->lo[axis], hi = what->window->hi[axis];
    for (int i = 0; i <= planes; i++) {
        lanes at = low + (double)i;
        lane_mask bits = lanes_integer_bits(at - (double)what->region->lo[axis]);
        numbers->of[i] = (bits & 0x78) << shift | (bits & 7) << inner | (long long)i << cell |
                         (at < lo) | (at > hi);
    }
}

/* Puts pieces down, a lane each so many bytes into the block's pieces. */
LANES_INLINE void put_pieces(const struct shade_triangles *t, lanes area, const lanes moment[2],
                             lane_mask number, struct vox_block *block, lane_mask offset)
{
    double *pieces[LANE_COUNT], *weights[LANE_COUNT];
    for (int l = 0; l < LANE_COUNT; l++) {
        pieces[l] = (double *)(void *)((char *)block->pieces + offset[l]);
        weights[l] = pieces[l] + 4;
    }
    if (t->has_normals) {
        lanes normal, center = lanes_all(0.0);
        lane_mask cancels;
        shade_weigh(t, area, moment, &normal, &center, &cancels);
        number |= cancels & ((long long)PIECE_FLAT << 32);
        lanes_scatter_pairs(normal, center, weights);
    }
    const lanes in[4] = {area, moment[0], moment[1], (lanes)number};
    lanes_scatter(in, pieces);
}

/* Shades what divide_small() has made of the triangles that are active, and puts it down from
 * offsets on, one after the other. Returns the offsets behind. */
LANES_INLINE lane_mask put_divided(const struct shade_triangles *t, const int planes[3],
                                   const struct divide_piece *piece,
                                   const struct cell_numbers numbers[3], lane_mask active,
                                   struct vox_block *block, lane_mask offset)
{
    lanes part = t->area / 3.0;
    for (int x = 0; x <= planes[0]; x++)
        for (int y = 0; y <= planes[1]; y++) {
            lane_mask row = numbers[0].of[x] | numbers[1].of[y];
            for (int z = 0; z <= planes[2]; z++, piece++) {
                lane_mask number = row | numbers[2].of[z];
                lane_mask taken = (piece->share > 0.0) & (number >= 0) & active;
                if (lanes_bits(taken) == 0)
                    continue;
                const lanes moment[2] = {part * piece->moment[0], part * piece->moment[1]};
                put_pieces(t, t->area * piece->share, moment, number, block, offset);
                offset += taken & (long long)sizeof(struct block_piece);
            }
        }
    return offset;
}

/* Divides up to LANE_COUNT triangles of the kind that has these planes. */
LANES_INLINE void divide_batch(const struct vox_accumulation *what, const uint16_t *order,
                               uint32_t count, const int planes[3])
{
    struct vox_block *block = what->block;
    struct divide_piece pieces[DIVIDE_MAX_CELLS];
    struct shade_triangles t;
    struct cell_numbers numbers[3];
    const int32_t *low[LANE_COUNT];
    uint32_t first[LANE_COUNT];
    uint16_t places[LANE_COUNT];
    long long offsets[LANE_COUNT], actives[LANE_COUNT];
    lane_mask offset, active;
    const uint32_t cells = (uint32_t)((planes[0] + 1) * (planes[1] + 1) * (planes[2] + 1));
    for (uint32_t l = 0; l < LANE_COUNT; l++) {
        places[l] = order[l < count ? l : count - 1];
        low[l] = block->triangles[places[l]].low;
        first[l] = l < count ? block->piece_count + l * cells : BLOCK_PIECES;
        offsets[l] = (long long)(first[l] * sizeof(struct block_piece));
        actives[l] = -(long long)(l < count);
    }
    memcpy(&offset, offsets, sizeof offset);
    memcpy(&active, actives, sizeof active);
    load_triangles(what, places, &t);
    lanes lowest[3];
    lanes_gather_integers(low, lowest);
    for (int a = 0; a < 3; a++)
        number_cells(what, lowest[a], a, planes[a], &numbers[a]);
    lane_mask doubtful = divide_small((const lanes(*)[3])t.p, planes, pieces);
    offset = put_divided(&t, planes, pieces, numbers, active & ~doubtful, block, offset);
    for (uint32_t l = 0; l < count; l++) {
        struct block_triangle *triangle = &block->triangles[places[l]];
        triangle->first = (uint16_t)first[l];
        triangle->count = (uint16_t)((size_t)offset[l] / sizeof(struct block_piece) - first[l]);
        triangle->alone = doubtful[l] != 0;
    }
    block->piece_count += count * cells;
}

static void divide_kind(const struct vox_accumulation *what, const uint16_t *order, uint32_t count,
                        uint32_t kind)
{
    const int planes[3] = {(int)(kind >> 4), (int)(kind >> 2 & 3), (int)(kind & 3)};
    for (uint32_t done = 0; done < count; done += LANE_COUNT) {
        uint32_t left = count - done;
        divide_batch(what, order + done, left < LANE_COUNT ? left : LANE_COUNT, planes);
    }
}

/* ---- pieces ---- */

/* A triangle whose pieces are added. */
struct source {
    const struct block_facts *facts;
    struct vox_accumulator *sums;
    bool smooth, curved, has_color;
};

LANES_INLINE struct source source_of(const struct vox_accumulation *what, uint32_t place)
{
    bool smooth = what->chunk->normals != NULL;
    return (struct source){.facts = &what->block->facts[place],
                           .sums = what->sums,
                           .smooth = smooth,
                           .curved = smooth && what->chunk->coarse,
                           .has_color = what->sums->colors != NULL};
}

/* Adds a piece. cell: lower corner of its voxel, from that of the triangle's lowest. rgb: its
 * colour, and 1; NULL: that of the triangle. */
LANES_INLINE int add_piece(const struct source *from, const struct block_piece *piece,
                           const double cell[4], const double rgb[4])
{
    struct vox_piece_sum sum;
    if (from->smooth && !(piece->cell & PIECE_FLAT))
        shade_smooth(from->facts, piece, cell, from->curved, &sum);
    else
        shade_flat(from->facts, piece, cell, &sum);
    if (rgb)
        sum.color = row_times(piece->area, row_load(rgb));
    else if (from->has_color)
        sum.color = shade_mean(shade_rows(from->facts, ROW_COLOR), piece);
    else
        sum.color = (struct row){0};
    return vox_accumulator_add(from->sums, piece->voxel, &sum, from->has_color);
}

LANES_INLINE int add_run(const struct source *from, const struct block_piece *pieces,
                         uint32_t count)
{
    const struct block_piece *end = pieces + count;
    int status = vox_accumulator_make_room(from->sums);
    if (status != 0)
        return status;
    for (; pieces < end; pieces++)
        status |= add_piece(from, pieces, shade_cells[pieces->cell % PIECE_FLAT], NULL);
    return status;
}

/* Adds the pieces of a triangle of the block. The compiler is told what is known, so that what most
 * scans need has loops without what only others do. */
LANES_INLINE int add_pieces(const struct vox_accumulation *what, uint32_t place)
{
    struct source from = source_of(what, place);
    const struct block_triangle *triangle = &what->block->triangles[place];
    const struct block_piece *pieces = &what->block->pieces[triangle->first];
    if (from.has_color)
        return add_run(&from, pieces, triangle->count);
    from.has_color = false;
    if (!from.smooth) {
        from.smooth = false;
        return add_run(&from, pieces, triangle->count);
    }
    from.smooth = true;
    return add_run(&from, pieces, triangle->count);
}

/* ---- other triangles ---- */

/* A triangle, the same in all lanes, whose pieces come one after the other and wait for lanes to
 * fill. */
struct single {
    const struct vox_accumulation *what;
    struct source from;
    const int32_t *low;
    struct shade_triangles triangles;
    uint32_t image; /* UINT32_MAX: no texture */
    double uv[3][2];
    uint32_t count; /* pieces that wait */
    lanes area, moment[2];
    lane_mask number;
    double cells[LANE_COUNT][4], rgb[LANE_COUNT][4];
};

static int add_waiting(struct single *s)
{
    uint32_t count = s->count;
    lane_mask offset = {0};
    bool textured = s->image != UINT32_MAX;
    int status = vox_accumulator_make_room(s->from.sums);
    for (uint32_t l = 0; l < LANE_COUNT; l++)
        offset[l] = (long long)((BLOCK_PIECES + l) * sizeof(struct block_piece));
    put_pieces(&s->triangles, s->area, s->moment, s->number, s->what->block, offset);
    for (uint32_t l = 0; l < count && status == 0; l++)
        status = add_piece(&s->from, &s->what->block->pieces[BLOCK_PIECES + l], s->cells[l],
                           textured ? s->rgb[l] : NULL);
    s->count = 0;
    return status;
}

static int take_piece(void *arg, const struct vox_piece *piece)
{
    struct single *s = arg;
    const int32_t *origin = s->what->region->lo;
    uint32_t l = s->count++, at[3];
    double area = s->triangles.area[0] * piece->fraction;
    s->area[l] = area > VOX_NO_AREA ? area : VOX_NO_AREA;
    for (int k = 0; k < 2; k++)
        s->moment[k][l] = s->area[l] * piece->b[k];
    for (int k = 0; k < 3; k++) {
        s->cells[l][k] = piece->cell[k] - s->low[k];
        at[k] = (uint32_t)(piece->cell[k] - origin[k]);
    }
    s->number[l] = vox_voxel_number(at[0], at[1], at[2]);
    if (s->image != UINT32_MAX) {
        int status = vox_shade_texture(s->what->shading, s->image, (const double(*)[2])s->uv,
                                       piece->b, piece->uv_extent, s->rgb[l]);
        if (status < 0)
            return status;
    }
    return s->count == LANE_COUNT ? add_waiting(s) : 0;
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
    struct single s = {.what = what, .from = source_of(what, place), .low = triangle->low};
    uint16_t places[LANE_COUNT];
    for (int l = 0; l < LANE_COUNT; l++) {
        places[l] = (uint16_t)place;
        s.rgb[l][3] = 1.0;
    }
    load_triangles(what, places, &s.triangles);
    s.image = vox_shade_image(what->shading, chunk, triangle->number);
    if (s.image != UINT32_MAX) {
        for (int i = 0; i < 3; i++)
            for (int k = 0; k < 2; k++)
                s.uv[i][k] = (double)chunk->source.texcoords[v[i]][k];
        clip.uv = (const double(*)[2])s.uv;
    }
    int status = vox_clip(&clip, what->region, what->window, take_piece, &s);
    return status == 0 && s.count > 0 ? add_waiting(&s) : status;
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
    for (uint32_t place = 0; place < block->triangle_count && status == 0; place++) {
        if (block->triangles[place].alone)
            status = add_alone(what, place);
        else
            status = add_pieces(what, place);
    }
    block->triangle_count = 0;
    block->piece_count = 0;
    return status;
}

/* Puts the triangles from begin to end that meet the window into the block. */
static int add_group(const struct vox_accumulation *what, uint32_t begin, uint32_t end,
                     uint32_t *room)
{
    struct vox_block *block = what->block;
    const struct cell_bounds window = bounds_of(what->window);
    int status = 0;
    for (uint32_t i = begin; i < end && status == 0; i++) {
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

static bool overlap(const struct vox_box *a, const struct vox_box *b)
{
    bool apart = false;
    for (int k = 0; k < 3; k++)
        apart |= (a->lo[k] > b->hi[k]) | (a->hi[k] < b->lo[k]);
    return !apart;
}

static int accumulate_chunk(const struct vox_accumulation *what, uint64_t *counted)
{
    const struct vox_chunk *chunk = what->chunk;
    uint32_t count = chunk->source.triangle_count, room = BLOCK_PIECES;
    int status = 0;
    what->block->triangle_count = what->block->piece_count = 0;
    for (uint32_t g = 0; g < chunk->group_count && status == 0; g++) {
        const struct vox_box *bounds = &chunk->groups[g];
        if (!overlap(bounds, what->window))
            continue;
        uint32_t begin = g * VOX_GROUP_TRIANGLES;
        uint32_t end = count - begin < VOX_GROUP_TRIANGLES ? count : begin + VOX_GROUP_TRIANGLES;
        status = add_group(what, begin, end, &room);
        if (contains(what->window, bounds->lo))
            *counted += end - begin;
    }
    return status == 0 ? add_block(what) : status;
}

#endif
