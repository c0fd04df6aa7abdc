/* measure_parts.c - see measure.h.
 *
 * What is known of a mesh while it is measured takes much memory, so a large one is measured region
 * by region. A region has the triangles of the scan and of the mesh whose middles it has; others of
 * the mesh that are near them are looked at, too. */
#include <string.h>

#include "base/parallel.h"
#include "libvoxel/simplify/measure.h"
#include "libvoxel/simplify/steps.h"

/* Returns whether the middle of a triangle is in the region. */
static bool has_triangle(const struct vox_measuring *m, const float (*positions)[3],
                         const uint32_t corners[3])
{
    float middle[3];
    for (int k = 0; k < 3; k++)
        middle[k] =
            (positions[corners[0]][k] + positions[corners[1]][k] + positions[corners[2]][k]) / 3;
    return vox_region_has(m->region, middle);
}

/* Returns whether all of a chunk is in the region. */
static bool has_whole_chunk(const struct vox_measuring *m, uint64_t index)
{
    const struct fmt_tris_chunk_info *info = &fmt_tris_chunks(m->file)[index];
    return vox_region_has(m->region, info->bounds_min) &&
           vox_region_has(m->region, info->bounds_max);
}

int vox_keep_own(const struct vox_measuring *m, uint64_t index, struct fmt_tris_chunk *chunk)
{
    float(*positions)[3] = (float(*)[3])chunk->positions;
    uint32_t(*triangles)[3] = (uint32_t(*)[3])chunk->triangles;
    uint32_t *numbers = NULL, vertices = 0, count = 0;
    if (has_whole_chunk(m, index))
        return 0;
    BSQ_PASS(BSQ_CALLOC(m->ctx, "numbers of vertices", chunk->vertex_count, &numbers));
    for (uint32_t t = 0; t < chunk->triangle_count; t++) {
        if (!has_triangle(m, chunk->positions, triangles[t]))
            continue;
        memmove(triangles[count], triangles[t], sizeof *triangles);
        for (int i = 0; i < 3; i++)
            numbers[triangles[count][i]] = 1;
        count++;
    }
    for (uint32_t v = 0; v < chunk->vertex_count; v++)
        if (numbers[v] > 0) {
            memmove(positions[vertices], positions[v], sizeof *positions);
            numbers[v] = vertices++;
        }
    for (uint32_t t = 0; t < count; t++)
        for (int i = 0; i < 3; i++)
            triangles[t][i] = numbers[triangles[t][i]];
    chunk->triangle_count = count;
    chunk->vertex_count = vertices;
    bsq_free(m->ctx, numbers);
    return 0;
}

struct box {
    float low[3], high[3];
};

static const struct box no_box = {{INFINITY, INFINITY, INFINITY},
                                  {-INFINITY, -INFINITY, -INFINITY}};

static void grow_box(struct box *box, const float low[3], const float high[3])
{
    for (int k = 0; k < 3; k++) {
        box->low[k] = fminf(box->low[k], low[k]);
        box->high[k] = fmaxf(box->high[k], high[k]);
    }
}

static void grow_by_corners(struct box *box, const float (*positions)[3], const uint32_t v[3])
{
    const float *const corners[3] = {positions[v[0]], positions[v[1]], positions[v[2]]};
    float low[3], high[3];
    vox_bound_corners(corners, low, high);
    grow_box(box, low, high);
}

struct surroundings {
    const struct vox_measuring *m;
    struct box *boxes; /* of the region's triangles, one a worker */
};

static int surround_chunk(void *arg, uint64_t index, unsigned worker)
{
    const struct surroundings *s = arg;
    const struct vox_measuring *m = s->m;
    const struct fmt_tris_chunk_info *info = &fmt_tris_chunks(m->file)[index];
    struct fmt_tris_chunk chunk;
    void *scratch = NULL;
    int status = 0;
    bool touches = true;
    for (int k = 0; k < 3; k++)
        touches = touches && info->bounds_max[k] >= m->region->low[k] &&
                  info->bounds_min[k] < m->region->high[k];
    if (has_whole_chunk(m, index)) {
        grow_box(&s->boxes[worker], info->bounds_min, info->bounds_max);
    } else if (touches) {
        BSQ_TRY(vox_load_chunk(m, index, &scratch, &chunk));
        for (uint32_t t = 0; t < chunk.triangle_count; t++)
            if (has_triangle(m, chunk.positions, chunk.triangles[t]))
                grow_by_corners(&s->boxes[worker], chunk.positions, chunk.triangles[t]);
    }
done:
    bsq_free(m->ctx, scratch);
    return status;
}

/* Bounds the triangles that a region has, of the scan and of the mesh. Chunks may have triangles
 * far apart, so their own boxes are no measure. */
static int bound_region(struct vox_measuring *m, struct box *out)
{
    const float(*positions)[3] = (const float(*)[3])m->mesh->positions;
    struct surroundings s = {.m = m};
    int status = 0;
    *out = no_box;
    BSQ_TRY(BSQ_ALLOC(m->ctx, "boxes", bsq_threads(m->ctx), &s.boxes));
    for (unsigned i = 0; i < bsq_threads(m->ctx); i++)
        s.boxes[i] = no_box;
    BSQ_TRY(vox_visit_chunks(m, surround_chunk, &s));
    for (unsigned i = 0; i < bsq_threads(m->ctx); i++)
        grow_box(out, s.boxes[i].low, s.boxes[i].high);
    for (uint32_t t = 0; t < m->mesh->triangle_count; t++)
        if (has_triangle(m, positions, m->mesh->triangles[t]))
            grow_by_corners(out, positions, m->mesh->triangles[t]);
done:
    bsq_free(m->ctx, s.boxes);
    return status;
}

/* Sets the box of what matters to a region: what is in its box and this much farther. */
static void surround_region(struct vox_measuring *m, const struct box *box, double farther)
{
    for (int k = 0; k < 3; k++) {
        m->near_low[k] = box->low[k] - (float)farther;
        m->near_high[k] = box->high[k] + (float)farther;
    }
}

int vox_surround_region(struct vox_measuring *m, double farther)
{
    struct box box;
    BSQ_PASS(bound_region(m, &box));
    surround_region(m, &box, farther);
    return 0;
}

/* Returns whether a triangle of the mesh is the region's. *near: whether it matters there. */
static bool is_owned(const struct vox_measuring *m, const uint32_t v[3], bool *near)
{
    const float(*positions)[3] = (const float(*)[3])m->mesh->positions;
    const float *const corners[3] = {positions[v[0]], positions[v[1]], positions[v[2]]};
    const bool own = has_triangle(m, positions, v);
    float low[3], high[3];
    vox_bound_corners(corners, low, high);
    *near = own || !(vox_box_square(low, high, m->near_low, m->near_high) > 0);
    return own;
}

/* Measures a region with the triangles of the mesh near it. numbers: space, of all vertices. */
static int measure_part(struct vox_measuring *m, uint32_t *numbers)
{
    const struct vox_mesh *whole = m->mesh;
    struct vox_mesh part = {0};
    struct box box;
    bool *owned = NULL, near;
    uint32_t count = 0;
    int status = 0;
    m->reach = sqrt(m->area / whole->triangle_count);
    BSQ_PASS(bound_region(m, &box));
    if (box.low[0] > box.high[0])
        return 0; /* the region is empty */
    for (double farther = fmax(VOX_NEAR_REACHES * m->reach, m->scan.slack); count == 0;
         farther *= 2) {
        surround_region(m, &box, farther);
        for (uint32_t t = 0; t < whole->triangle_count; t++) {
            is_owned(m, whole->triangles[t], &near);
            count += near;
        }
        BSQ_PASS(bsq_check(m->ctx));
    }
    BSQ_TRY(BSQ_ALLOC(m->ctx, "a region", count, &owned));
    BSQ_TRY(vox_mesh_allocate(m->ctx, 3 * count, count, false, &part));
    part.vertex_count = part.triangle_count = 0;
    memset(numbers, 0, whole->vertex_count * sizeof *numbers);
    for (uint32_t t = 0; t < whole->triangle_count; t++) {
        const uint32_t *corners = whole->triangles[t];
        const bool own = is_owned(m, corners, &near);
        if (!near)
            continue;
        owned[part.triangle_count] = own;
        for (int k = 0; k < 3; k++) {
            uint32_t *number = &numbers[corners[k]];
            if (*number == 0) {
                memcpy(part.positions[part.vertex_count], whole->positions[corners[k]],
                       sizeof *part.positions);
                *number = ++part.vertex_count;
            }
            part.triangles[part.triangle_count][k] = *number - 1;
        }
        part.triangle_count++;
    }
    m->mesh = &part;
    m->reach = vox_mean_reach(&part);
    status = vox_measure_region(m, owned);
    m->mesh = whole;
done:
    bsq_free(m->ctx, owned);
    vox_mesh_free(m->ctx, &part);
    return status;
}

int vox_measure_parts(struct vox_measuring *m, uint32_t at_once)
{
    const struct vox_mesh *whole = m->mesh;
    const double share = (double)at_once / whole->triangle_count;
    struct vox_level level = {.ctx = m->ctx};
    struct vox_region *regions = NULL;
    uint32_t *numbers = NULL;
    uint64_t count;
    int status = 0;
    BSQ_TRY(vox_reduce_chunks(m->ctx, m->file, UINT64_MAX, NULL, &level));
    BSQ_TRY(vox_divide_level(&level, (uint64_t)(share * (double)level.triangles), 0.5, &regions,
                             &count));
    BSQ_TRY(BSQ_ALLOC(m->ctx, "a region", whole->vertex_count, &numbers));
    for (uint64_t i = 0; i < count; i++) {
        m->region = &regions[i];
        BSQ_TRY(measure_part(m, numbers));
    }
done:
    BSQ_FREE(m->ctx, numbers, regions);
    vox_level_free(&level, NULL);
    return status;
}
