/* small_lanes.h - divides a block's small triangles into fragments, several side by side. */
#ifndef VOX_VOXELIZE_CLIP_SMALL_LANES_H
#define VOX_VOXELIZE_CLIP_SMALL_LANES_H

#include "base/geometry/smooth_normals.h"
#include "libvoxel/voxelize/clip/fragment_block.h"
#include "libvoxel/voxelize/clip/shade_lanes.h"

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

/* Chooses the normals of corners at creases: of the two sides the closer one to the triangle's
 * plane, or none if both are too far from it. */
static __attribute__((noinline)) void
choose_sides(const struct vox_chunk *chunk, const struct block_triangle *const triangle[LANE_COUNT],
             struct shade_triangles *t)
{
    const lane_mask has_area = lanes_less(lanes_all(0.5), shade_dot(t->flat, t->flat));
    const doubles least = lanes_keep(has_area, lanes_all(BSQ_FACET_COSINE));
    for (int i = 0; i < 3; i++) {
        float unpacked[LANE_COUNT][4];
        const float *seconds[LANE_COUNT];
        doubles *n = t->normal[i], *rise = &t->weights.rise[i], second[4];
        for (int l = 0; l < LANE_COUNT; l++) {
            const uint32_t vertex = chunk->source.triangles[triangle[l]->number][i];
            vox_chunk_second(chunk, vertex, unpacked[l]);
            seconds[l] = unpacked[l];
        }
        lanes_gather_floats(seconds, second);
        const doubles cosine = shade_dot(n, t->flat), other = shade_dot(second, t->flat);
        const lane_mask closer = lanes_less(cosine, other);
        const lane_mask far = lanes_less(lanes_max(cosine, other), least);
        for (int k = 0; k < 3; k++)
            n[k] = lanes_keep(~far, lanes_select(closer, second[k], n[k]));
        *rise = lanes_keep(~far, lanes_select(closer, second[3], *rise));
    }
}

/* Loads the triangles with these places in the block, and writes the rows that their fragments
 * share. lowest: the lowest voxel of each. */
LANES_INLINE void load_triangles(const struct vox_accumulation *chunk_sums,
                                 const uint16_t places[LANE_COUNT], struct shade_triangles *t,
                                 doubles lowest[4])
{
    const struct vox_chunk *chunk = chunk_sums->chunk;
    const struct block_triangle *triangle[LANE_COUNT];
    struct block_facts *facts[LANE_COUNT];
    const int32_t *low[LANE_COUNT];
    for (int l = 0; l < LANE_COUNT; l++) {
        triangle[l] = &chunk_sums->block->triangles[places[l]];
        facts[l] = &chunk_sums->block->facts[places[l]];
        low[l] = triangle[l]->low;
    }
    lanes_gather_integers(low, lowest);
    t->has_normals = chunk->normals != NULL;
    t->curved = t->has_normals && chunk->coarse;
    t->lift_limit = chunk->wide ? SHADE_LIFT_LIMIT : SHADE_LIFT_LIMIT_CLOSE;
    t->marked = t->curved || chunk->inconsistent;
    t->noise_share = chunk->noise_share;
    t->facet = inconsistent_lanes(chunk, triangle);
    t->has_color = chunk_sums->sums->colors != NULL;
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
        t->colored[l] =
            vox_shade_corners(chunk_sums->shading, &chunk->source, triangle[l]->number, rgb);
        for (int i = 0; i < 3; i++)
            for (int k = 0; k < 3; k++)
                t->rgb[i][k][l] = rgb[i][k];
    }
    shade_measure(t);
    if (chunk->creases)
        choose_sides(chunk, triangle, t);
    shade_prepare(t);
    shade_put_facts(t, facts);
}

/* ---- fragments ---- */

/* For each voxel along an axis, from the triangle's lowest on: the bits that it adds to a
 * fragment's number, or all ones if it lies outside the window. A number holds the voxel's number,
 * and above it cell, lane and place as in struct block_fragment. */
struct cell_numbers {
    lane_ints of[DIVIDE_MAX_PLANES + 1];
};

enum { NUMBER_CELL = 32, NUMBER_LANE = 40, NUMBER_PLACE = 48 };

LANES_INLINE void number_cells(const struct vox_accumulation *chunk_sums, doubles low, int axis,
                               int planes, struct cell_numbers *numbers)
{
    const int shift = 14 - 4 * axis, inner = 6 - 3 * axis, cell = NUMBER_CELL + 6 - 2 * axis;
    const doubles lo = lanes_all(chunk_sums->window->lo[axis]),
                  hi = lanes_all(chunk_sums->window->hi[axis]);
    for (int i = 0; i <= planes; i++) {
        doubles at = low + (double)i;
        lane_ints bits = lanes_integer_bits(at - (double)chunk_sums->region->lo[axis]);
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

/* Returns the values from which the weights of queued fragments are computed. */
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
                                    lanes_all_bits((uint64_t)FRAGMENT_FLAT << NUMBER_LANE));
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
    doubles third = t->area * (1.0 / 3.0);
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
LANES_INLINE void divide_batch(const struct vox_accumulation *chunk_sums,
                               const uint16_t places[LANE_COUNT], uint32_t count,
                               const int planes[3])
{
    struct vox_fragment_block *block = chunk_sums->block;
    struct divide_fragment fragments[DIVIDE_MAX_CELLS];
    struct shade_triangles t;
    struct cell_numbers numbers[3];
    struct queue queue;
    long long where[LANE_COUNT];
    doubles lowest[4];
    const uint32_t cells = (uint32_t)((planes[0] + 1) * (planes[1] + 1) * (planes[2] + 1));
    for (uint32_t l = 0; l < LANE_COUNT; l++) {
        bool used = l < count;
        where[l] = (long long)l << NUMBER_LANE | (long long)(block->fragment_count + l * cells)
                                                     << NUMBER_PLACE;
        where[l] = used ? where[l] : -1;
    }
    load_triangles(chunk_sums, places, &t, lowest);
    for (int a = 0; a < 3; a++)
        number_cells(chunk_sums, lowest[a], a, planes[a], &numbers[a]);
    lane_mask doubtful = divide_small((const doubles(*)[3])t.p, planes, fragments);
    lane_ints after = queue_divided(&t, planes, fragments, numbers,
                                    lanes_load_ints(where) | t.class_bits, &queue, &doubtful);
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
LANES_INLINE void divide_with(const struct vox_accumulation *chunk_sums, const uint16_t *order,
                              uint32_t count, const int planes[3])
{
    for (uint32_t done = 0; done < count; done += LANE_COUNT) {
        uint32_t left = count - done;
        uint16_t padded[LANE_COUNT];
        for (uint32_t l = 0; left < LANE_COUNT && l < LANE_COUNT; l++)
            padded[l] = order[done + (l < left ? l : 0)];
        divide_batch(chunk_sums, left < LANE_COUNT ? padded : order + done,
                     left < LANE_COUNT ? left : LANE_COUNT, planes);
    }
}

/* Divides triangles that lie in one voxel: a quarter to a half if a scan is fine for its grid.
 * Compiled without the code for planes. */
static __attribute__((noinline)) void divide_whole(const struct vox_accumulation *chunk_sums,
                                                   const uint16_t *order, uint32_t count)
{
    divide_with(chunk_sums, order, count, (const int[3]){0, 0, 0});
}

static void divide_kind(const struct vox_accumulation *chunk_sums, const uint16_t *order,
                        uint32_t count, uint32_t kind)
{
    const int planes[3] = {(int)(kind >> 4), (int)(kind >> 2 & 3), (int)(kind & 3)};
    if (kind == 0)
        divide_whole(chunk_sums, order, count);
    else
        divide_with(chunk_sums, order, count, planes);
}

#endif
