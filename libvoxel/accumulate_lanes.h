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

static_assert(sizeof(struct vox_sum) == 64, "a sample is two vectors of four");
static_assert(sizeof(struct vox_color_sum) == 32, "a colour is a vector of four");

/* ---- triangles ---- */

/* Corners, and what goes with them, of the triangles with these places in the block. */
LANES_INLINE void load_triangles(const struct vox_accumulation *what,
                                 const uint16_t places[LANE_COUNT], struct shade_triangles *t)
{
    const struct vox_chunk *chunk = what->chunk;
    const struct block_triangle *triangle[LANE_COUNT];
    const int32_t *low[LANE_COUNT];
    for (int l = 0; l < LANE_COUNT; l++) {
        triangle[l] = &what->block->triangles[places[l]];
        low[l] = triangle[l]->low;
    }
    t->has_normals = chunk->normals != NULL;
    t->curved = t->has_normals && chunk->coarse;
    t->detached = t->curved && !chunk->rises && chunk->large;
    t->has_color = what->sums->colors != NULL;
    for (int i = 0; i < 3; i++) {
        const double *points[LANE_COUNT];
        const float *normals[LANE_COUNT];
        for (int l = 0; l < LANE_COUNT; l++) {
            uint32_t vertex = chunk->source.triangles[triangle[l]->number][i];
            points[l] = chunk->points[vertex];
            normals[l] = t->has_normals ? chunk->normals[vertex] : NULL;
            t->rise[i][l] = chunk->rises ? (double)chunk->rises[vertex] : 0.0;
        }
        lanes_gather(points, low, t->p[i]);
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

/* Where the next sample of each lane goes. */
struct outlets {
    uint32_t at[LANE_COUNT];
};

LANES_INLINE void put_samples(struct vox_block *block, struct outlets *outlets, unsigned taken,
                              uint8_t cell, const lanes sample[8], const lanes color[4],
                              bool has_color)
{
    double *to[2][LANE_COUNT], *colors[LANE_COUNT];
    for (int l = 0; l < LANE_COUNT; l++) {
        uint32_t at = taken >> l & 1 ? outlets->at[l] : BLOCK_SAMPLES;
        to[0][l] = block->samples[at].normal;
        to[1][l] = block->samples[at].center;
        colors[l] = has_color ? block->colors[at].rgb : NULL;
        block->cells[at] = cell;
        outlets->at[l] += taken >> l & 1;
    }
    lanes_scatter(sample, to[0]);
    lanes_scatter(sample + 4, to[1]);
    if (has_color)
        lanes_scatter(color, colors);
}

/* Divides and shades up to LANE_COUNT triangles of the kind that has these planes. */
LANES_INLINE void divide_batch(const struct vox_accumulation *what, const uint16_t *order,
                               uint32_t count, const int planes[3])
{
    struct vox_block *block = what->block;
    struct divide_piece pieces[DIVIDE_MAX_CELLS], *piece = pieces;
    struct shade_triangles t;
    struct outlets outlets;
    uint16_t places[LANE_COUNT];
    const uint32_t cells = (uint32_t)((planes[0] + 1) * (planes[1] + 1) * (planes[2] + 1));
    for (uint32_t l = 0; l < LANE_COUNT; l++) {
        places[l] = order[l < count ? l : count - 1];
        outlets.at[l] = block->sample_count + l * cells;
    }
    load_triangles(what, places, &t);
    unsigned active = (1u << count) - 1;
    unsigned doubtful = lanes_bits(divide_small((const lanes(*)[3])t.p, planes, pieces)) & active;
    active &= ~doubtful;
    for (int x = 0; x <= planes[0]; x++)
        for (int y = 0; y <= planes[1]; y++)
            for (int z = 0; z <= planes[2]; z++, piece++) {
                unsigned taken = lanes_bits(piece->share > 0.0) & active;
                if (taken == 0)
                    continue;
                const lanes cell[3] = {lanes_all(x), lanes_all(y), lanes_all(z)};
                lanes scale = 1.0 / (3.0 * piece->share), sample[8], color[4];
                lanes b[2] = {piece->moment[0] * scale, piece->moment[1] * scale};
                shade_pieces(&t, piece->share, b, cell, sample, color);
                put_samples(block, &outlets, taken, (uint8_t)(x << 4 | y << 2 | z), sample, color,
                            t.has_color);
            }
    for (uint32_t l = 0; l < count; l++) {
        struct block_triangle *triangle = &block->triangles[places[l]];
        triangle->first = (uint16_t)(block->sample_count + l * cells);
        triangle->count = (uint16_t)(outlets.at[l] - triangle->first);
        triangle->alone = doubtful >> l & 1;
    }
    block->sample_count += count * cells;
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

/* ---- other triangles ---- */

/* A triangle whose pieces come one after the other: in all lanes at first, then a piece a lane. */
struct single {
    const struct vox_accumulation *what;
    const int32_t *low;
    struct shade_triangles triangles;
    uint32_t image; /* UINT32_MAX: no texture */
    double uv[3][2];
    uint32_t count; /* pieces that wait */
    lanes share, b[2], cell[3], rgb[3];
    uint32_t voxels[LANE_COUNT];
};

static int add_waiting(struct single *s)
{
    const struct vox_accumulation *what = s->what;
    struct vox_sum samples[LANE_COUNT] = {0};
    struct vox_color_sum colors[LANE_COUNT] = {0};
    double *to[2][LANE_COUNT], *rgb[LANE_COUNT];
    lanes sample[8], color[4];
    uint32_t count = s->count;
    int status = 0;
    for (int l = 0; l < LANE_COUNT; l++) {
        to[0][l] = samples[l].normal;
        to[1][l] = samples[l].center;
        rgb[l] = colors[l].rgb;
    }
    shade_pieces(&s->triangles, s->share, s->b, s->cell, sample, color);
    lanes_scatter(sample, to[0]);
    lanes_scatter(sample + 4, to[1]);
    if (s->image != UINT32_MAX) {
        color[3] = sample[3];
        for (int k = 0; k < 3; k++)
            color[k] = sample[3] * s->rgb[k];
    }
    if (s->triangles.has_color)
        lanes_scatter(color, rgb);
    s->count = 0;
    for (uint32_t l = 0; l < count && status == 0; l++)
        status = vox_accumulator_add(what->sums, s->voxels[l], &samples[l], &colors[l]);
    return status;
}

static int take_piece(void *arg, const struct vox_piece *piece)
{
    struct single *s = arg;
    const int32_t *origin = s->what->region->lo;
    uint32_t l = s->count++, at[3];
    s->share[l] = piece->fraction;
    for (int k = 0; k < 2; k++)
        s->b[k][l] = piece->b[k];
    for (int k = 0; k < 3; k++) {
        s->cell[k][l] = piece->cell[k] - s->low[k];
        at[k] = (uint32_t)(piece->cell[k] - origin[k]);
    }
    s->voxels[l] = vox_voxel_number(at[0], at[1], at[2]);
    if (s->image != UINT32_MAX) {
        double rgb[3];
        int status = vox_shade_texture(s->what->shading, s->image, (const double(*)[2])s->uv,
                                       piece->b, piece->uv_extent, rgb);
        if (status < 0)
            return status;
        for (int k = 0; k < 3; k++)
            s->rgb[k][l] = rgb[k];
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
    struct single s = {.what = what, .low = triangle->low};
    uint16_t places[LANE_COUNT];
    for (int l = 0; l < LANE_COUNT; l++)
        places[l] = (uint16_t)place;
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

/* Lists the samples of the triangles from *next on in their order, up to one that is to be added
 * alone; leaves out those beside the window. Returns their number. */
LANES_INLINE uint32_t list_samples(const struct vox_accumulation *what, uint32_t *next)
{
    struct vox_block *block = what->block;
    const int32_t *origin = what->region->lo;
    uint32_t count = 0;
    for (; *next < block->triangle_count && !block->triangles[*next].alone; ++*next) {
        const struct block_triangle *triangle = &block->triangles[*next];
        for (uint32_t i = triangle->first; i < (uint32_t)triangle->first + triangle->count; i++) {
            uint32_t cell = block->cells[i];
            int32_t at[3] = {triangle->low[0] + (int32_t)(cell >> 4),
                             triangle->low[1] + (int32_t)(cell >> 2 & 3),
                             triangle->low[2] + (int32_t)(cell & 3)};
            block->voxels[count] =
                vox_voxel_number((uint32_t)(at[0] - origin[0]), (uint32_t)(at[1] - origin[1]),
                                 (uint32_t)(at[2] - origin[2]));
            block->places[count] = (uint16_t)i;
            count += triangle->inside || contains(what->window, at);
        }
    }
    return count;
}

/* Samples whose sums are on their way from memory. */
enum { SAMPLES_AHEAD = 12 };

LANES_INLINE int add_samples(const struct vox_accumulation *what, uint32_t count)
{
    const struct vox_block *block = what->block;
    struct vox_accumulator *sums = what->sums;
    int status = 0;
    for (uint32_t i = 0; i < count && status == 0; i++) {
        uint32_t place = block->places[i];
        if (i + SAMPLES_AHEAD < count)
            vox_accumulator_expect(sums, block->voxels[i + SAMPLES_AHEAD]);
        status = vox_accumulator_add(sums, block->voxels[i], &block->samples[place],
                                     &block->colors[place]);
    }
    return status;
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
    for (uint32_t next = 0; next < block->triangle_count && status == 0;) {
        if (block->triangles[next].alone)
            status = add_alone(what, next++);
        else
            status = add_samples(what, list_samples(what, &next));
    }
    block->triangle_count = 0;
    block->sample_count = 0;
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
        uint32_t samples = 0, kind = KIND_LARGE;
        if (!four_any(planes > DIVIDE_MAX_PLANES) &&
            (!what->shading->textures ||
             vox_shade_image(what->shading, what->chunk, i) == UINT32_MAX)) {
            kind = (uint32_t)(planes[0] << 4 | planes[1] << 2 | planes[2]);
            samples = (uint32_t)((planes[0] + 1) * (planes[1] + 1) * (planes[2] + 1));
        }
        if (samples > *room || block->triangle_count == BLOCK_TRIANGLES) {
            status = add_block(what);
            *room = BLOCK_SAMPLES;
        }
        *room -= samples;
        struct block_triangle *to = &block->triangles[block->triangle_count++];
        memcpy(to->low, &cells.low, sizeof to->low);
        to->number = i;
        to->kind = (uint8_t)kind;
        to->alone = kind == KIND_LARGE;
        to->inside = !four_any((cells.low < window.low) | (cells.high > window.high));
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
    uint32_t count = chunk->source.triangle_count, room = BLOCK_SAMPLES;
    int status = 0;
    what->block->triangle_count = what->block->sample_count = 0;
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
