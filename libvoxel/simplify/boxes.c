/* boxes.c - see measure.h.
 *
 * A triangle counts in each box that it touches. The scan's triangles are bounded box by box, so
 * that a box where the mesh is close has a low bound beside one where it is not. */
#include <string.h>

#include "libvoxel/simplify/measure.h"

static bool touches(const struct vox_boxes *boxes, uint32_t number, const float low[3],
                    const float high[3])
{
    const struct vox_measured_box *box = &boxes->list[number];
    for (int k = 0; k < 3; k++)
        if ((double)high[k] < box->low[k] - boxes->origin[k] - boxes->slack ||
            (double)low[k] > box->high[k] - boxes->origin[k] + boxes->slack)
            return false;
    return true;
}

/* Raises what is known of a box by a triangle. */
static void add_triangle(const struct vox_measuring *m, const struct vox_chunk_vertices *of,
                         const float *const corners[3], const uint32_t *triangle,
                         struct vox_bound *b)
{
    for (int k = 0; k < 3; k++)
        vox_bound_note(
            b,
            (const double[3]){(double)corners[k][0], (double)corners[k][1], (double)corners[k][2]},
            sqrt(of->squares[triangle[k]]));
    const double allowed = vox_bound_allowed(b),
                 bound = vox_bound_by_corners(m, corners, triangle, of, allowed);
    if (bound <= allowed)
        b->high = fmax(b->high, bound);
    else
        vox_bound_triangle(&m->tree, corners, b);
}

int vox_boxes_touched(const struct vox_measuring *m, uint64_t index, struct vox_box_sums **list,
                      uint32_t *count)
{
    const struct fmt_tris_chunk_info *info = &fmt_tris_chunks(m->file)[index];
    uint32_t found = 0;
    *list = NULL;
    *count = 0;
    for (uint32_t i = 0; i < m->boxes.count; i++)
        found += touches(&m->boxes, i, info->bounds_min, info->bounds_max);
    if (found == 0)
        return 0;
    BSQ_PASS(BSQ_CALLOC(m->ctx, "boxes", found, list));
    for (uint32_t i = 0; i < m->boxes.count; i++)
        if (touches(&m->boxes, i, info->bounds_min, info->bounds_max)) {
            (*list)[*count].number = i;
            (*list)[(*count)++].bound.slack = m->scan.slack;
        }
    return 0;
}

void vox_boxes_add_point(const struct vox_measuring *m, const double point[3], double square,
                         double weight, struct vox_box_sums *list, uint32_t count)
{
    for (uint32_t i = 0; i < count; i++) {
        const struct vox_measured_box *box = &m->boxes.list[list[i].number];
        bool inside = true;
        for (int k = 0; k < 3; k++)
            inside = inside && point[k] >= box->low[k] - m->boxes.origin[k] &&
                     point[k] < box->high[k] - m->boxes.origin[k];
        if (!inside)
            continue;
        vox_add_distance(m, &list[i].sums, square, weight);
        vox_bound_note(&list[i].bound, point, sqrt(square));
    }
}

int vox_boxes_add_triangles(const struct vox_measuring *m, const struct fmt_tris_chunk *chunk,
                            const struct vox_chunk_vertices *of, struct vox_box_sums *list,
                            uint32_t count)
{
    const float(*positions)[3] = chunk->positions;
    for (uint32_t t = 0; t < chunk->triangle_count && count > 0; t++) {
        const uint32_t *v = chunk->triangles[t];
        const float *const corners[3] = {positions[v[0]], positions[v[1]], positions[v[2]]};
        float low[3], high[3];
        vox_bound_corners(corners, low, high);
        for (uint32_t i = 0; i < count; i++)
            if (touches(&m->boxes, list[i].number, low, high))
                add_triangle(m, of, corners, v, &list[i].bound);
        if (t % 4096 == 0)
            BSQ_PASS(bsq_check(m->ctx));
    }
    return 0;
}

void vox_boxes_add(struct vox_measuring *m, const struct vox_box_sums *list, uint32_t count)
{
    for (uint32_t i = 0; i < count; i++) {
        struct vox_box_sums *box = &m->boxes.from_scan[list[i].number];
        vox_sums_add(&box->sums, &list[i].sums);
        vox_bound_add(&box->bound, &list[i].bound);
    }
}

int vox_boxes_begin(struct vox_measuring *m, struct vox_measured_box *list, uint32_t count)
{
    m->boxes = (struct vox_boxes){.list = list,
                                  .count = count,
                                  .origin = fmt_tris_get_header(m->file)->origin,
                                  .slack = m->scan.slack};
    BSQ_PASS(BSQ_CALLOC(m->ctx, "boxes", count, &m->boxes.from_scan));
    BSQ_PASS(BSQ_CALLOC(m->ctx, "boxes", count, &m->boxes.from_mesh));
    for (uint32_t i = 0; i < count; i++)
        m->boxes.from_scan[i].number = m->boxes.from_mesh[i].number = i;
    return 0;
}

int vox_boxes_add_mesh(struct vox_measuring *m)
{
    uint32_t *near = NULL, count = 0;
    int status = 0;
    BSQ_TRY(BSQ_ALLOC(m->ctx, "boxes", m->boxes.count, &near));
    for (uint32_t i = 0; i < m->boxes.count; i++)
        if (touches(&m->boxes, i, m->near_low, m->near_high))
            near[count++] = i;
    for (uint32_t t = 0; t < m->mesh->triangle_count && count > 0; t++) {
        const float *corners[3];
        float low[3], high[3];
        if (t % 4096 == 0)
            BSQ_TRY(bsq_check(m->ctx));
        vox_closest_corners(&m->tree, t, corners);
        vox_bound_corners(corners, low, high);
        for (uint32_t i = 0; i < count; i++) {
            double *most = &m->boxes.from_mesh[near[i]].bound.high;
            if (m->bounds[t] > *most && touches(&m->boxes, near[i], low, high))
                *most = m->bounds[t];
        }
    }
done:
    bsq_free(m->ctx, near);
    return status;
}

void vox_boxes_end(const struct vox_measuring *m)
{
    for (uint32_t i = 0; i < m->boxes.count; i++) {
        const struct vox_box_sums *there = &m->boxes.from_scan[i], *back = &m->boxes.from_mesh[i];
        vox_summarize(m, &there->sums, &there->bound, &m->boxes.list[i].from_scan);
        vox_summarize(m, &back->sums, &back->bound, &m->boxes.list[i].from_mesh);
    }
}
