/* accumulate_lanes.c - the loop over a chunk's triangles.
 *
 * Triangles are collected in blocks. Inside a block they are grouped by the number of voxel planes
 * that cut them along each axis. So several can be divided and shaded side by side. Their fragments
 * are then added in the order of the triangles, so results do not depend on the grouping. Groups of
 * triangles whose bounds miss the window are skipped. */
#include "libvoxel/voxelize/clip/fragment_block.h"

#include <assert.h>
#include <math.h>
#include <stddef.h>

#include "base/geometry/vec.h"
#include "libvoxel/voxelize/clip/clip.h"
#include "libvoxel/voxelize/clip/small_lanes.h"

static_assert(sizeof(struct vox_sum) == 64, "sums are two rows of four");
static_assert(sizeof(struct vox_color_sum) == 32, "a colour is a row of four");
static_assert(LANE_COUNT <= VOX_FRAGMENT_LANES, "channels of waiting fragments have space");
static_assert(sizeof(struct block_fragment) == 64, "a fragment begins with a row of four");
static_assert(sizeof(struct vox_fragment_block) / sizeof(double) < BLOCK_RUN_FACTS,
              "entries of runs hold two offsets");

/* ---- fragments ---- */

/* Where fragments come from and go to, and which rows they have. */
struct source {
    const struct vox_accumulation *chunk_sums;
    const struct vox_fragment_block *block;
    struct vox_accumulator *sums;
    bool smooth, marked, curved, has_color, has_ids, has_channels;
};

LANES_INLINE struct source source_of(const struct vox_accumulation *chunk_sums)
{
    bool smooth = chunk_sums->chunk->normals != NULL;
    return (struct source){.chunk_sums = chunk_sums,
                           .block = chunk_sums->block,
                           .sums = chunk_sums->sums,
                           .smooth = smooth,
                           .marked = smooth &&
                                     (chunk_sums->chunk->coarse || chunk_sums->chunk->inconsistent),
                           .curved = smooth && chunk_sums->chunk->coarse,
                           .has_color = chunk_sums->sums->colors != NULL,
                           .has_ids = chunk_sums->sums->votes != NULL,
                           .has_channels = chunk_sums->sums->channels != NULL};
}

/* What a fragment has from textures. */
struct textured {
    const double *rgb;          /* its colour, and 1; NULL: interpolated from the triangle's */
    const double *channels;     /* its further channels; NULL: those of the triangle's material */
    const float *texel;         /* of the triangle's normal map; NULL: it has none */
    const double (*uv_edge)[2]; /* with a texel: as for bsq_normal_map_apply() */
};

/* Replaces the sum of a fragment's normal by that of the normal map. The triangle's plane does not
 * predict it. */
static __attribute__((noinline)) void clip_add_normal_map(const struct block_facts *facts,
                                                          const struct textured *from, double area,
                                                          struct row *normal)
{
    const double *flat = facts->row[ROW_FLAT];
    double edge[2][3], n[4];
    row_store(*normal, n);
    const double length = sqrt(vox_dot(n, n));
    if (!(length > 0.0))
        return;
    for (int k = 0; k < 3; k++) {
        edge[0][k] = facts->row[ROW_EDGE1][k];
        edge[1][k] = facts->row[ROW_EDGE2][k];
        n[k] /= length;
    }
    if (!bsq_normal_map_apply((const double(*)[3])edge, from->uv_edge, from->texel, n))
        return;
    const double weight = area * fabs(vox_dot(n, flat));
    *normal = row_of(weight * n[0], weight * n[1], weight * n[2], area * VOX_INCONSISTENT);
}

/* Returns the number of the triangle with these facts. */
LANES_INLINE uint32_t triangle_of(const struct source *from, const struct block_facts *facts)
{
    return from->block->triangles[facts - from->block->facts].number;
}

/* Returns the id of a fragment of a triangle. */
LANES_INLINE uint32_t id_of(const struct source *from, uint32_t triangle,
                            const struct block_fragment *fragment)
{
    const double *moment = fragment->moment;
    const double weights[3] = {fragment->area - moment[0] - moment[1], moment[0], moment[1]};
    return fmt_shade_id(&from->chunk_sums->shading->scan, &from->chunk_sums->chunk->source,
                        triangle, weights) |
           0xff000000u;
}

/* Returns the channels of a triangle without textures. */
LANES_INLINE const double *channels_of(const struct source *from, uint32_t triangle)
{
    const struct vox_shading *shading = from->chunk_sums->shading;
    const uint32_t material =
        fmt_shading_material(&shading->scan, &from->chunk_sums->chunk->source, triangle);
    return shading->channels + (uint64_t)material * shading->channel_words;
}

/* Adds a fragment of the triangle with these facts. cell: lower corner of its voxel, relative to
 * that of the triangle's lowest. */
LANES_INLINE int add_fragment(const struct source *from, const struct block_facts *facts,
                              const struct block_fragment *fragment, const double cell[4],
                              const struct textured *textured)
{
    const bool mapped = textured && textured->texel; /* the class follows from the normal map */
    uint32_t number;
    struct vox_fragment_sum sum;
    if (!mapped && !vox_accumulator_sum(from->sums, fragment->voxel, &number))
        return VOX_REGION_FULL;
    if (from->smooth && !(fragment->lane & FRAGMENT_FLAT))
        shade_smooth(facts, fragment, cell, from->marked, from->curved, &sum);
    else
        shade_flat(facts, fragment, cell, &sum);
    if (mapped) {
        const uint32_t voxel = fragment->voxel & VOX_LINK_NUMBER;
        clip_add_normal_map(facts, textured, fragment->area, &sum.normal);
        if (!vox_accumulator_sum(from->sums, voxel | vox_class_bits(sum.normal), &number))
            return VOX_REGION_FULL;
    }
    if (textured && textured->rgb)
        sum.color = row_times(fragment->area, row_load(textured->rgb));
    else if (from->has_color)
        sum.color = shade_mean(shade_rows(facts, ROW_COLOR), fragment);
    else
        sum.color = (struct row){0};
    sum.id = from->has_ids ? id_of(from, triangle_of(from, facts), fragment) : 0;
    sum.channels = textured ? textured->channels : NULL;
    if (from->has_channels && !sum.channels)
        sum.channels = channels_of(from, triangle_of(from, facts));
    vox_accumulator_add(from->sums, number, &sum, from->has_color, from->has_ids,
                        from->has_channels);
    return 0;
}

LANES_INLINE int add_run(const struct source *from, const uint32_t *run, uint32_t count)
{
    const double *block = (const void *)from->block;
    int status = vox_accumulator_reserve(from->sums);
    for (uint32_t i = 0; i < count && status == 0; i++) {
        const struct block_fragment *fragment = (const void *)(block + run[i] % BLOCK_RUN_FACTS);
        status = add_fragment(from, (const void *)(block + run[i] / BLOCK_RUN_FACTS), fragment,
                              shade_cells + fragment->cell, NULL);
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
LANES_INLINE int add_fragments(const struct vox_accumulation *chunk_sums, uint32_t count)
{
    struct source from = source_of(chunk_sums);
    if (from.has_ids || from.has_channels)
        return add_runs(&from, count);
    from.has_ids = from.has_channels = false;
    if (from.has_color)
        return add_runs(&from, count);
    from.has_color = false;
    if (!from.smooth) {
        from.smooth = false;
        return add_runs(&from, count);
    }
    from.smooth = true;
    if (!from.curved)
        return add_runs(&from, count);
    from.marked = from.curved = true;
    return add_runs(&from, count);
}

typedef uint32_t run_step __attribute__((vector_size(4 * BLOCK_RUN_STEP)));

/* Appends the fragments of the triangle at this place to the run. Most triangles have so few that
 * there is no branch to mispredict. */
LANES_INLINE uint32_t append_fragments(struct vox_fragment_block *block, uint32_t place,
                                       uint32_t count)
{
    enum {
        NEXT_FACTS = sizeof *block->facts / sizeof(double),
        NEXT = sizeof *block->fragments / sizeof(double),
        FIRST = offsetof(struct vox_fragment_block, facts) / sizeof(double) * BLOCK_RUN_FACTS +
                offsetof(struct vox_fragment_block, fragments) / sizeof(double)
    };
    const struct block_triangle *triangle = &block->triangles[place];
    run_step entries = FIRST + place * NEXT_FACTS * BLOCK_RUN_FACTS + NEXT * triangle->first +
                       NEXT * (run_step){0, 1, 2, 3, 4, 5, 6, 7};
    for (uint32_t done = 0; done < triangle->count || done == 0; done += BLOCK_RUN_STEP) {
        memcpy(&block->run[count + done], &entries, sizeof entries);
        entries += NEXT * BLOCK_RUN_STEP;
    }
    return count + triangle->count;
}

/* ---- other triangles ---- */

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

/* A triangle, the same in all lanes, that is clipped alone. Its fragments wait until all lanes are
 * filled. */
struct single {
    struct queue queue;
    struct shade_triangles triangles;
    const struct vox_accumulation *chunk_sums;
    const int32_t *low;
    double area, uv[3][2], uv_edge[2][2];
    struct source from;
    double cells[LANE_COUNT][4], rgb[LANE_COUNT][4];
    double tint[3][3];           /* colours of the corners, which multiply the texture */
    float texels[LANE_COUNT][3]; /* of the normal map */
    uint32_t place, material;
    bool color, channels, normal_map; /* have textures */
    bool tinted;
};

static int add_waiting(struct single *s)
{
    const double *channels = s->channels ? s->from.sums->fragment_channels : NULL;
    int status = vox_accumulator_reserve(s->from.sums);
    put_queue(&s->triangles, &s->queue, s->chunk_sums->block);
    for (uint32_t i = 0; i < s->queue.count && status == 0; i++) {
        const struct textured textured = {
            .rgb = s->color ? s->rgb[i] : NULL,
            .channels = channels ? channels + i * s->from.sums->channel_words : NULL,
            .texel = s->normal_map ? s->texels[i] : NULL,
            .uv_edge = (const double(*)[2])s->uv_edge,
        };
        status = add_fragment(&s->from, &s->chunk_sums->block->facts[s->place],
                              &s->chunk_sums->block->fragments[BLOCK_FRAGMENTS + i], s->cells[i],
                              &textured);
    }
    s->queue.count = 0;
    return status;
}

/* Samples the textures of a fragment, which waits at place i. */
static int sample_textures(struct single *s, const struct vox_fragment *fragment, uint32_t i)
{
    const struct vox_accumulator *sums = s->from.sums;
    const double *b = fragment->b;
    struct fmt_shading_footprint footprint = {.material = s->material};
    if (!s->color && !s->channels && !s->normal_map)
        return 0;
    for (int k = 0; k < 2; k++) {
        footprint.at[k] = (float)(s->uv[0][k] + b[0] * (s->uv[1][k] - s->uv[0][k]) +
                                  b[1] * (s->uv[2][k] - s->uv[0][k]));
        footprint.width[k] = (float)fragment->uv_extent[k];
    }
    int status = vox_shade_textures(
        &s->chunk_sums->shading->scan, &footprint, s->color ? s->rgb[i] : NULL,
        s->channels ? sums->fragment_channels + (uint64_t)i * sums->channel_words : NULL,
        s->normal_map ? s->texels[i] : NULL);
    for (int k = 0; k < 3 && s->tinted; k++)
        s->rgb[i][k] *= s->tint[0][k] + b[0] * (s->tint[1][k] - s->tint[0][k]) +
                        b[1] * (s->tint[2][k] - s->tint[0][k]);
    return status;
}

static int take_fragment(void *arg, const struct vox_fragment *fragment)
{
    struct single *s = arg;
    const int32_t *origin = s->chunk_sums->region->lo;
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
    s->queue.number[i] = vox_voxel_number(at[0], at[1], at[2]) | s->triangles.class_bits[0] |
                         (long long)(BLOCK_FRAGMENTS + i) << NUMBER_PLACE;
    BSQ_PASS(sample_textures(s, fragment, i));
    return s->queue.count == LANE_COUNT ? add_waiting(s) : 0;
}

/* Sets the texture coordinates of the triangle's corners, and their differences. */
static void set_uv(struct single *s, const struct vox_chunk *chunk, const uint32_t v[3])
{
    for (int k = 0; k < 2; k++) {
        for (int i = 0; i < 3; i++)
            s->uv[i][k] = (double)chunk->source.texcoords[v[i]][k];
        for (int e = 0; e < 2; e++)
            s->uv_edge[e][k] = s->uv[e + 1][k] - s->uv[0][k];
    }
}

/* Finds what of a triangle comes from textures. Returns whether something does. */
static bool clip_find_textures(struct single *s, const struct vox_shading *shading,
                               const struct fmt_tris_chunk *chunk, uint32_t triangle)
{
    s->material = fmt_shading_material(&shading->scan, chunk, triangle);
    const bool any = shading->textured && shading->textured[s->material];
    s->color = any && fmt_shading_is_textured(&shading->scan, FMT_SHADING_COLOR, s->material);
    s->normal_map =
        any && fmt_shading_is_textured(&shading->scan, FMT_SHADING_NORMAL_MAP, s->material);
    s->channels = any && s->from.has_channels;
    s->tinted = s->color && chunk->colors && fmt_shading_is_tinted(&shading->scan, s->material);
    if (s->tinted)
        vox_shade_corners(shading, chunk, triangle, s->tint);
    return any;
}

static __attribute__((noinline)) int add_alone(const struct vox_accumulation *chunk_sums,
                                               uint32_t place)
{
    const struct vox_chunk *chunk = chunk_sums->chunk;
    const struct block_triangle *triangle = &chunk_sums->block->triangles[place];
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
    doubles lowest[4];
    uint16_t places[LANE_COUNT];
    s.chunk_sums = chunk_sums;
    s.from = source_of(chunk_sums);
    s.place = place;
    s.low = triangle->low;
    s.queue.count = 0;
    for (int l = 0; l < LANE_COUNT; l++) {
        places[l] = (uint16_t)place;
        s.cells[l][3] = 0.0;
        s.rgb[l][3] = 1.0;
    }
    load_triangles(chunk_sums, places, &s.triangles, lowest);
    s.area = s.triangles.area[0];
    if (clip_find_textures(&s, chunk_sums->shading, &chunk->source, triangle->number)) {
        set_uv(&s, chunk, v);
        clip.uv = (const double(*)[2])s.uv;
    }
    int status = vox_clip(&clip, chunk_sums->region, chunk_sums->window, take_fragment, &s);
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
static int clip_add_block(const struct vox_accumulation *chunk_sums)
{
    struct vox_fragment_block *block = chunk_sums->block;
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
            divide_kind(chunk_sums, block->order + starts[kind] - counts[kind], counts[kind], kind);
    uint32_t count = 0;
    for (uint32_t place = 0; place < block->triangle_count && status == 0; place++) {
        if (!block->triangles[place].alone) {
            count = append_fragments(block, place, count);
            continue;
        }
        status = add_fragments(chunk_sums, count);
        count = 0;
        if (status == 0)
            status = add_alone(chunk_sums, place);
    }
    if (status == 0)
        status = add_fragments(chunk_sums, count);
    block->triangle_count = 0;
    block->fragment_count = 0;
    return status;
}

/* Prefetches what add_group() and the rest of the block need of the triangle. */
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

/* Returns whether something of a triangle comes from textures, so that it is clipped alone. */
LANES_INLINE bool is_textured(const struct vox_accumulation *chunk_sums, uint32_t triangle)
{
    const struct vox_shading *shading = chunk_sums->shading;
    return shading->textured && shading->textured[fmt_shading_material(
                                    &shading->scan, &chunk_sums->chunk->source, triangle)];
}

/* Puts the triangles from begin to end that meet the window into the block. capacity: fragments
 * that the block can still take. */
static int add_group(const struct vox_accumulation *chunk_sums, uint32_t begin, uint32_t end,
                     uint32_t *capacity)
{
    struct vox_fragment_block *block = chunk_sums->block;
    const struct cell_bounds window = bounds_of(chunk_sums->window);
    int status = 0;
    for (uint32_t i = begin; i < end && status == 0; i++) {
        if (i + PREFETCH_AHEAD < chunk_sums->chunk->source.triangle_count)
            prefetch_triangle(chunk_sums->chunk, i + PREFETCH_AHEAD);
        struct cell_bounds cells = cells_of(chunk_sums->chunk, i);
        if (four_any((cells.low > window.high) | (cells.high < window.low)))
            continue;
        four_ints planes = cells.high - cells.low;
        uint32_t fragments = 0, kind = KIND_LARGE;
        if (!four_any(planes > DIVIDE_MAX_PLANES) && !is_textured(chunk_sums, i)) {
            kind = (uint32_t)(planes[0] << 4 | planes[1] << 2 | planes[2]);
            fragments = (uint32_t)((planes[0] + 1) * (planes[1] + 1) * (planes[2] + 1));
        }
        if (fragments > *capacity || block->triangle_count == BLOCK_TRIANGLES) {
            status = clip_add_block(chunk_sums);
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

int BSQ_SIMD_NAME(vox_accumulate_chunk)(const struct vox_accumulation *chunk_sums,
                                        uint64_t *counted)
{
    const struct vox_chunk *chunk = chunk_sums->chunk;
    uint32_t count = chunk->source.triangle_count, capacity = BLOCK_FRAGMENTS;
    int status = 0;
    chunk_sums->block->triangle_count = chunk_sums->block->fragment_count = 0;
    for (uint32_t g = 0; g < chunk->group_count && status == 0; g++) {
        const struct vox_box *bounds = &chunk->groups[g];
        if (!vox_boxes_meet(bounds, chunk_sums->window))
            continue;
        uint32_t begin = g * VOX_GROUP_TRIANGLES,
                 end = vox_group_end(begin, count, VOX_GROUP_TRIANGLES);
        status = add_group(chunk_sums, begin, end, &capacity);
        if (contains(chunk_sums->window, bounds->lo))
            *counted += end - begin;
    }
    return status == 0 ? clip_add_block(chunk_sums) : status;
}
