/* boxes.c - see measure.h.
 *
 * A triangle counts in each box that it touches. The scan's triangles are bounded box by box, so
 * that a box where the mesh is close has a low bound beside one where it is not. */
#include <string.h>

#include "libvoxel/simplify/measure.h"

/* A box that a chunk touches, and what is known of the chunk's triangles in it. */
struct touched_box {
    uint32_t number;
    struct vox_bound bound;
};

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

static void bound_corners(const float *const corners[3], float low[3], float high[3])
{
    for (int k = 0; k < 3; k++) {
        low[k] = fminf(corners[0][k], fminf(corners[1][k], corners[2][k]));
        high[k] = fmaxf(corners[0][k], fmaxf(corners[1][k], corners[2][k]));
    }
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

static void raise_box(const struct vox_boxes *boxes, const struct touched_box *touched)
{
    _Atomic uint64_t *most = &boxes->most[touched->number];
    uint64_t bits, old = atomic_load_explicit(most, memory_order_relaxed);
    const double value = fmax(touched->bound.low, touched->bound.high);
    memcpy(&bits, &value, sizeof bits);
    while (bits > old && !atomic_compare_exchange_weak_explicit(
                             most, &old, bits, memory_order_relaxed, memory_order_relaxed))
        ;
}

int vox_boxes_add_chunk(const struct vox_measuring *m, uint64_t index,
                        const struct fmt_tris_chunk *chunk, const struct vox_chunk_vertices *of)
{
    const struct fmt_tris_chunk_info *info = &fmt_tris_chunks(m->file)[index];
    const float(*positions)[3] = chunk->positions;
    struct touched_box *list = NULL;
    uint32_t count = 0;
    int status = 0;
    if (m->boxes.count == 0)
        return 0;
    BSQ_TRY(BSQ_ALLOC(m->ctx, "boxes", m->boxes.count, &list));
    for (uint32_t i = 0; i < m->boxes.count; i++)
        if (touches(&m->boxes, i, info->bounds_min, info->bounds_max))
            list[count++] = (struct touched_box){i, {.slack = m->scan.slack}};
    for (uint32_t t = 0; t < chunk->triangle_count; t++) {
        const uint32_t *v = chunk->triangles[t];
        const float *const corners[3] = {positions[v[0]], positions[v[1]], positions[v[2]]};
        float low[3], high[3];
        bound_corners(corners, low, high);
        for (uint32_t i = 0; i < count; i++)
            if (touches(&m->boxes, list[i].number, low, high))
                add_triangle(m, of, corners, v, &list[i].bound);
        if (t % 4096 == 0)
            BSQ_TRY(bsq_check(m->ctx));
    }
    for (uint32_t i = 0; i < count; i++)
        raise_box(&m->boxes, &list[i]);
done:
    bsq_free(m->ctx, list);
    return status;
}

int vox_boxes_begin(struct vox_measuring *m, struct vox_measured_box *list, uint32_t count)
{
    m->boxes = (struct vox_boxes){.list = list,
                                  .count = count,
                                  .origin = fmt_tris_get_header(m->file)->origin,
                                  .slack = m->scan.slack};
    return BSQ_CALLOC(m->ctx, "boxes", count, &m->boxes.most);
}

void vox_boxes_end(struct vox_measuring *m)
{
    for (uint32_t i = 0; i < m->boxes.count; i++) {
        struct vox_measured_box *box = &m->boxes.list[i];
        const uint64_t bits = m->boxes.most[i];
        memcpy(&box->from_scan, &bits, sizeof bits);
        box->from_mesh = 0;
    }
    for (uint32_t t = 0; t < m->mesh->triangle_count && m->boxes.count > 0; t++) {
        const float *corners[3];
        float low[3], high[3];
        vox_closest_corners(&m->tree, t, corners);
        bound_corners(corners, low, high);
        for (uint32_t i = 0; i < m->boxes.count; i++) {
            double *most = &m->boxes.list[i].from_mesh;
            if (m->bounds[t] > *most && touches(&m->boxes, i, low, high))
                *most = m->bounds[t];
        }
    }
}
