/* gltf_parse.c - turns parts of glTF files into vertices and faces.
 *
 * A vertex or triangle is read again for each node that places its mesh. */
#include <inttypes.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "base/srgb.h"
#include "formats/mesh/gltf_internal.h"

/* What a part belongs to. */
struct parser {
    struct gltf_decoder decoder;
    const struct gltf_source *source;
    const struct gltf_placement *placement;
    const struct gltf_primitive *primitive;
    uint64_t first, count; /* vertices or triangles of the primitive */
    struct mesh_arrays *arrays;
};

__attribute__((format(printf, 2, 3))) static int fail(const struct parser *p, const char *format,
                                                      ...)
{
    char text[120];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    return fmt_stream_fail(p->decoder.slot, 0, "meshes[%" PRIu32 "], primitive %" PRIu32 ": %s",
                           p->primitive->mesh, p->primitive->number, text);
}

static int decode(const struct parser *p, uint32_t accessor, const double **out)
{
    return fmt_gltf_decode(&p->decoder, accessor, p->first, p->count, out);
}

/* ---- vertices ---- */

static int parse_positions(struct parser *p)
{
    const double(*m)[4] = p->placement->matrix;
    const double *from;
    double poison = 0;
    int status =
        FMT_RESERVE(p->decoder.ctx, p->count, p->arrays->positions, p->arrays->position_capacity);
    if (!status)
        status = decode(p, p->primitive->position, &from);
    if (status)
        return status;
    for (uint64_t i = 0; i < p->count; i++, from += 3)
        for (int k = 0; k < 3; k++) {
            const double value =
                m[k][0] * from[0] + m[k][1] * from[1] + m[k][2] * from[2] + m[k][3];
            p->arrays->positions[i][k] = value;
            poison += value * 0;
        }
    if (poison != 0)
        p->decoder.slot->odd[STREAM_NO_POSITION].count =
            fmt_stream_clear_bad(&p->arrays->positions[0][0], p->count, 3);
    p->arrays->count[FMT_MESH_VERTEX] = p->count;
    return 0;
}

static int parse_normals(struct parser *p)
{
    const double(*m)[3] = p->placement->normal_matrix;
    const double *from;
    int status =
        FMT_RESERVE(p->decoder.ctx, p->count, p->arrays->normals, p->arrays->normal_capacity);
    if (!status)
        status = decode(p, p->primitive->normal, &from);
    if (status)
        return status;
    for (uint64_t i = 0; i < p->count; i++, from += 3) {
        float *to = p->arrays->normals[i];
        float poison = 0;
        for (int k = 0; k < 3; k++) {
            const double value = m[k][0] * from[0] + m[k][1] * from[1] + m[k][2] * from[2];
            to[k] = fabs(value) <= 3e38 ? (float)value : NAN;
            poison += to[k] * 0;
        }
        if (poison != 0) {
            p->decoder.slot->odd[STREAM_NO_NORMAL].count++;
            memset(to, 0, sizeof *p->arrays->normals);
        }
    }
    p->arrays->count[FMT_MESH_NORMAL] = p->count;
    return 0;
}

/* v of glTF points downwards, v of a block upwards. */
static int parse_texcoords(struct parser *p)
{
    static const double plain[2][3] = {{1, 0, 0}, {0, 1, 0}};
    const uint32_t material = p->primitive->material;
    const double(*m)[3] = material == GLTF_NONE
                              ? plain
                              : (const double(*)[3])p->source->materials[material].uv_matrix;
    const double *from;
    double poison = 0;
    int status =
        FMT_RESERVE(p->decoder.ctx, p->count, p->arrays->texcoords, p->arrays->texcoord_capacity);
    if (!status)
        status = decode(p, p->primitive->texcoord, &from);
    if (status)
        return status;
    for (uint64_t i = 0; i < p->count; i++, from += 2) {
        double *to = p->arrays->texcoords[i];
        to[0] = m[0][0] * from[0] + m[0][1] * from[1] + m[0][2];
        to[1] = 1 - (m[1][0] * from[0] + m[1][1] * from[1] + m[1][2]);
        poison += to[0] * 0 + to[1] * 0;
    }
    if (poison != 0)
        p->decoder.slot->odd[STREAM_NO_TEXCOORD].count =
            fmt_stream_clear_bad(&p->arrays->texcoords[0][0], p->count, 2);
    p->arrays->count[FMT_MESH_TEXCOORD] = p->count;
    return 0;
}

/* Returns the sRGB value of linear light. One out of range stays so, for callers that count them;
 * it is above -1, which stands for no colour. */
static float display_color(double linear)
{
    const bool inside = linear >= 0.0 && linear <= 1.0;
    return (float)(inside ? bsq_linear_to_srgb(linear) : fmax(linear, -0.5));
}

/* Colours are linear, and factors of the material's. If any vertex of the scan has a colour, the
 * others get that of their material, because colours of vertices hide those of materials. */
static int parse_colors(struct parser *p)
{
    static const double white[3] = {1, 1, 1};
    const uint32_t material = p->primitive->material, accessor = p->primitive->color;
    const double *factor = material == GLTF_NONE ? white : p->source->materials[material].color;
    const double *from = white;
    const uint32_t step = accessor == GLTF_NONE ? 0 : p->source->accessors[accessor].components;
    int status =
        FMT_RESERVE(p->decoder.ctx, p->count, p->arrays->colors, p->arrays->color_capacity);
    if (!status && step > 0)
        status = decode(p, accessor, &from);
    for (uint64_t i = 0; i < p->count && !status; i++, from += step) {
        bool good = true;
        for (int k = 0; k < 3; k++) {
            p->arrays->colors[i][k] = display_color(from[k] * factor[k]);
            good &= isfinite(from[k]);
        }
        for (int k = 0; k < 3 && !good; k++)
            p->arrays->colors[i][k] = -1;
        p->decoder.slot->odd[STREAM_NO_COLOR].count += !good;
    }
    p->arrays->has_colors = true;
    p->decoder.slot->color_white = 1;
    return status;
}

static int parse_vertices(struct parser *p)
{
    int status;
    BSQ_TRY(parse_positions(p));
    if (p->primitive->normal != GLTF_NONE)
        BSQ_TRY(parse_normals(p));
    if (p->primitive->texcoord != GLTF_NONE)
        BSQ_TRY(parse_texcoords(p));
    if (p->decoder.slot->source->reader->gltf_colors)
        BSQ_TRY(parse_colors(p));
done:
    return status;
}

/* ---- faces ---- */

/* Entries of a primitive's list of indices; without a list, entry i is i. */
struct window {
    const double *values; /* NULL: there is no list */
    uint64_t first, count;
    uint64_t start; /* entry 0, which each triangle of a fan has */
};

static int load_window(const struct parser *p, struct window *w)
{
    const struct gltf_primitive *primitive = p->primitive;
    int status = 0;
    *w = (struct window){.first = p->first, .count = p->count + 2};
    if (primitive->mode == 4)
        *w = (struct window){.first = 3 * p->first, .count = 3 * p->count};
    if (primitive->index == GLTF_NONE)
        return 0;
    if (primitive->mode == 6) {
        status = fmt_gltf_decode(&p->decoder, primitive->index, 0, 1, &w->values);
        w->start = status ? 0 : (uint64_t)w->values[0];
    }
    return status ? status
                  : fmt_gltf_decode(&p->decoder, primitive->index, w->first, w->count, &w->values);
}

static uint64_t entry(const struct window *w, uint64_t i)
{
    if (!w->values)
        return i;
    return i < w->first ? w->start : (uint64_t)w->values[i - w->first];
}

/* Sets the vertices of a triangle, numbered in the primitive. Every second one of a strip is in
 * reverse order in the file. */
static void find_corners(const struct parser *p, const struct window *w, uint64_t triangle,
                         uint64_t out[3])
{
    const uint64_t t = triangle, odd = t & 1;
    const uint64_t entries[3][3] = {
        {3 * t, 3 * t + 1, 3 * t + 2}, {t, t + 1 + odd, t + 2 - odd}, {t + 1, t + 2, 0}};
    const uint64_t *own = entries[p->primitive->mode - 4];
    for (int i = 0; i < 3; i++)
        out[i] = entry(w, own[i]);
    if (p->placement->mirrored) {
        const uint64_t last = out[2];
        out[2] = out[1];
        out[1] = last;
    }
}

static void add_triangle(const struct parser *p, const uint64_t corners[3],
                         const uint64_t base[FMT_MESH_KIND_COUNT])
{
    struct mesh_arrays *a = p->arrays;
    for (int kind = 0; kind < FMT_MESH_KIND_COUNT; kind++)
        for (int i = 0; i < 3 && (kind == FMT_MESH_VERTEX || a->has_corners[kind]); i++)
            a->corners[kind][a->corner_count + (uint64_t)i] = base[kind] + corners[i];
    a->corner_count += 3;
    a->face_sizes[a->face_count++] = 3;
}

/* Adds the triangles of the part. In strips and fans, triangles that name a vertex twice only
 * connect others; they are left out. */
static int add_triangles(const struct parser *p, const struct window *w)
{
    const uint64_t vertices = p->source->accessors[p->primitive->position].count;
    uint64_t base[FMT_MESH_KIND_COUNT], v[3];
    for (int kind = 0; kind < FMT_MESH_KIND_COUNT; kind++)
        base[kind] = p->placement->base[kind] + p->primitive->base[kind];
    p->arrays->vertex_bound = base[FMT_MESH_VERTEX] + vertices;
    for (uint64_t t = p->first; t < p->first + p->count; t++) {
        find_corners(p, w, t, v);
        for (int i = 0; i < 3; i++)
            if (v[i] >= vertices)
                return fail(p,
                            "triangle %" PRIu64 " refers to vertex %" PRIu64 ", there are %" PRIu64,
                            t, v[i], vertices);
        if (p->primitive->mode == 4 || (v[0] != v[1] && v[1] != v[2] && v[2] != v[0]))
            add_triangle(p, v, base);
    }
    return 0;
}

/* Returns the number in the file of a primitive at a node. fmt_stream_read() checks that it fits.
 */
static uint32_t part_of(const struct parser *p)
{
    const uint64_t primitive = (uint64_t)(p->primitive - p->source->primitives) -
                               p->source->meshes[p->placement->mesh].first;
    return (uint32_t)(p->placement->part_base + primitive);
}

static int reserve_faces(const struct parser *p)
{
    const bool wanted[FMT_MESH_KIND_COUNT] = {
        [FMT_MESH_VERTEX] = true,
        [FMT_MESH_TEXCOORD] = p->primitive->texcoord != GLTF_NONE,
        [FMT_MESH_NORMAL] = p->primitive->normal != GLTF_NONE};
    struct mesh_arrays *a = p->arrays;
    int status;
    BSQ_TRY(FMT_RESERVE(p->decoder.ctx, p->count, a->face_sizes, a->size_capacity));
    for (int kind = 0; kind < FMT_MESH_KIND_COUNT; kind++) {
        if (!wanted[kind])
            continue;
        BSQ_TRY(
            FMT_RESERVE(p->decoder.ctx, 3 * p->count, a->corners[kind], a->corner_capacity[kind]));
        a->has_corners[kind] = true;
    }
    status = FMT_RESERVE(p->decoder.ctx, 1, a->changes, a->change_capacity);
done:
    return status;
}

static int parse_faces(struct parser *p)
{
    struct window window;
    int status;
    BSQ_TRY(reserve_faces(p));
    BSQ_TRY(load_window(p, &window));
    BSQ_TRY(add_triangles(p, &window));
    p->arrays->change_count = p->arrays->face_count > 0;
    p->arrays->changes[0] = (struct fmt_mesh_material_change){
        .face = 0,
        .material = p->decoder.slot->source->reader->objects ? part_of(p)
                    : p->primitive->material == GLTF_NONE    ? FMT_MESH_NO_MATERIAL
                                                             : p->primitive->material};
done:
    return status;
}

/* ---- parts ---- */

int fmt_gltf_parse(struct stream_slot *slot)
{
    const struct gltf_source *source = slot->source->data;
    struct parser p = {
        .decoder = {slot->ctx, source, slot},
        .source = source,
        .first = slot->part.first_item,
        .count = slot->part.items,
        .arrays = &slot->arrays,
    };
    if (p.count == 0)
        return 0;
    p.placement = &source->placements[slot->part.kind];
    p.primitive = &source->primitives[slot->part.carry];
    return slot->part.carry_out == GLTF_VERTICES ? parse_vertices(&p) : parse_faces(&p);
}
