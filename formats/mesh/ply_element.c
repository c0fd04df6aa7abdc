/* ply_element.c - turns numbers of PLY elements into vertices and faces, for text and binary files.
 */
#include <inttypes.h>
#include <math.h>
#include <string.h>

#include "formats/mesh/ply_internal.h"

/* No file can have this many elements of a kind; callers compare indices as signed numbers. */
#define INDEX_LIMIT ((int64_t)1 << 61)

int fmt_ply_reserve(const struct ply_element *element, struct stream_slot *slot,
                    uint64_t most_items)
{
    const struct ply_source *source = slot->source->data;
    struct bsq_ctx *ctx = slot->ctx;
    struct mesh_arrays *a = &slot->arrays;
    const uint64_t count = slot->part.items;
    const bool strips = element->kind == PLY_STRIPS;
    const uint64_t faces = strips ? most_items : count;
    const uint64_t corners = strips ? 3 * most_items : most_items;
    int status;
    if (element->kind == PLY_VERTICES) {
        BSQ_TRY(FMT_RESERVE(ctx, count, a->positions, a->position_capacity));
        if (element->role[PLY_RED])
            BSQ_TRY(FMT_RESERVE(ctx, count, a->colors, a->color_capacity));
        if (source->vertex_normals)
            BSQ_TRY(FMT_RESERVE(ctx, count, a->normals, a->normal_capacity));
        if (source->vertex_texcoords)
            BSQ_TRY(FMT_RESERVE(ctx, count, a->texcoords, a->texcoord_capacity));
        return 0;
    }
    BSQ_TRY(FMT_RESERVE(ctx, corners, a->corners[FMT_MESH_VERTEX],
                        a->corner_capacity[FMT_MESH_VERTEX]));
    BSQ_TRY(FMT_RESERVE(ctx, faces, a->face_sizes, a->size_capacity));
    if (source->corner_texcoords) {
        BSQ_TRY(FMT_RESERVE(ctx, corners, a->corners[FMT_MESH_TEXCOORD],
                            a->corner_capacity[FMT_MESH_TEXCOORD]));
        BSQ_TRY(FMT_RESERVE(ctx, most_items / 2 + 1, a->texcoords, a->texcoord_capacity));
    }
    if (source->tags != PLY_TAGS_NONE)
        BSQ_TRY(FMT_RESERVE(ctx, faces, a->face_tags, a->tag_capacity));
done:
    return status;
}

/* ---- vertices ---- */

/* Returns what to multiply a colour by. Integers become 0 to 255, real numbers stay. */
static double color_scale(enum ply_type type)
{
    return type == PLY_UINT16 ? 1.0 / 257.0 : 1.0;
}

void fmt_ply_store_vertex(struct mesh_arrays *arrays, uint64_t vertex,
                          const struct ply_property *property, double value)
{
    const enum ply_role role = property->role;
    if (role >= PLY_X && role <= PLY_Z)
        arrays->positions[vertex][role - PLY_X] = value;
    else if (role >= PLY_NX && role <= PLY_NZ)
        arrays->normals[vertex][role - PLY_NX] = (float)value;
    else if (role >= PLY_RED && role <= PLY_BLUE)
        arrays->colors[vertex][role - PLY_RED] = (float)(value * color_scale(property->type));
    else if (role == PLY_S || role == PLY_T)
        arrays->texcoords[vertex][role - PLY_S] = value;
}

/* Sets vectors that are not finite to `missing`; returns their number. */
static uint64_t replace_bad(float (*vectors)[3], uint64_t count, float missing)
{
    uint64_t bad = 0;
    for (uint64_t i = 0; i < count; i++) {
        float *v = vectors[i];
        if (v[0] * 0.0f + v[1] * 0.0f + v[2] * 0.0f == 0.0f)
            continue;
        v[0] = v[1] = v[2] = missing;
        bad++;
    }
    return bad;
}

void fmt_ply_finish_vertices(const struct ply_element *element, struct stream_slot *slot,
                             uint64_t count)
{
    const struct ply_source *source = slot->source->data;
    struct mesh_arrays *a = &slot->arrays;
    a->count[FMT_MESH_VERTEX] = count;
    slot->odd[STREAM_NO_POSITION].count = fmt_stream_clear_bad(&a->positions[0][0], count, 3);
    if (source->vertex_normals) {
        a->count[FMT_MESH_NORMAL] = count;
        slot->odd[STREAM_NO_NORMAL].count += replace_bad(a->normals, count, 0.0f);
    }
    if (source->vertex_texcoords) {
        a->count[FMT_MESH_TEXCOORD] = count;
        slot->odd[STREAM_NO_TEXCOORD].count = fmt_stream_clear_bad(&a->texcoords[0][0], count, 2);
    }
    if (element->role[PLY_RED]) {
        a->has_colors = true;
        slot->color_white = ply_is_real(element->role[PLY_RED]->type) ? 0.0f : 255.0f;
        if (slot->color_white == 0.0f)
            slot->odd[STREAM_NO_COLOR].count += replace_bad(a->colors, count, -1.0f);
    }
}

/* ---- faces ---- */

bool fmt_ply_add_index(struct stream_slot *slot, struct ply_face *face, int64_t index)
{
    struct mesh_arrays *a = &slot->arrays;
    if (index < 0 || index >= INDEX_LIMIT) {
        fmt_stream_fail(slot, face->at, "face refers to vertex %" PRId64, index);
        return false;
    }
    a->corners[FMT_MESH_VERTEX][a->corner_count + face->size++] = (uint64_t)index;
    return true;
}

void fmt_ply_add_texcoord(struct stream_slot *slot, uint64_t i, double value)
{
    struct mesh_arrays *a = &slot->arrays;
    a->texcoords[a->count[FMT_MESH_TEXCOORD] + i / 2][i % 2] = value;
}

void fmt_ply_set_material(struct ply_face *face, const struct ply_property *property, double value)
{
    if (property->role == PLY_TEXTURE_NUMBER) {
        face->texture = (int64_t)fmin(fmax(value, -1.0), 4294967296.0);
    } else if (property->role >= PLY_RED && property->role <= PLY_BLUE) {
        value *= ply_is_real(property->type) ? 255.0 : color_scale(property->type);
        face->clamped |= !(value >= 0.0 && value <= 255.0);
        face->color[property->role - PLY_RED] = fmin(fmax(value, 0.0), 255.0);
    }
}

/* Numbers the texture coordinates of a face's corners. If a list does not fit the face, or has
 * numbers that are not finite, corners go without. */
static void finish_texcoords(struct stream_slot *slot, const struct ply_face *face)
{
    struct mesh_arrays *a = &slot->arrays;
    const uint64_t base = a->count[FMT_MESH_TEXCOORD];
    uint64_t *corners = a->corners[FMT_MESH_TEXCOORD] + a->corner_count;
    const bool fits = face->texcoords == 2 * face->size;
    a->has_corners[FMT_MESH_TEXCOORD] = true;
    if (!fits && face->texcoords > 0)
        slot->odd[PLY_BAD_TEXCOORDS].count += face->size;
    for (uint64_t i = 0; i < face->size; i++) {
        const bool finite =
            fits && isfinite(a->texcoords[base + i][0]) && isfinite(a->texcoords[base + i][1]);
        corners[i] = finite ? base + i : FMT_MESH_NONE;
        if (!fits || finite)
            continue;
        slot->odd[PLY_BAD_TEXCOORDS].count++;
        a->texcoords[base + i][0] = a->texcoords[base + i][1] = 0.0;
    }
    a->count[FMT_MESH_TEXCOORD] += fits ? face->size : 0;
}

/* Finds what decides the face's material. A texture that the file does not name counts as lost. */
static void finish_tag(const struct ply_source *source, struct stream_slot *slot,
                       const struct ply_face *face)
{
    uint32_t *tag = &slot->arrays.face_tags[slot->arrays.face_count];
    if (source->tags == PLY_TAGS_COLOR) {
        slot->odd[PLY_CLAMPED_COLORS].count += face->clamped;
        *tag = (uint32_t)(face->color[0] + 0.5) | (uint32_t)(face->color[1] + 0.5) << 8 |
               (uint32_t)(face->color[2] + 0.5) << 16;
        return;
    }
    const bool lost = face->texture >= (int64_t)source->header.texture_count;
    *tag = face->texture < 0 || lost ? PLY_NO_TAG : (uint32_t)face->texture;
    if (lost && slot->odd[PLY_LOST_TEXTURES].count++ == 0)
        slot->odd[PLY_LOST_TEXTURES].at = face->at;
}

bool fmt_ply_finish_face(const struct ply_source *source, struct stream_slot *slot,
                         const struct ply_face *face)
{
    struct mesh_arrays *a = &slot->arrays;
    if (face->size < 3) {
        slot->short_faces++;
        return true;
    }
    if (face->size > UINT32_MAX) {
        fmt_stream_fail(slot, face->at, "a face of %" PRIu64 " corners", face->size);
        return false;
    }
    if (source->tags != PLY_TAGS_NONE)
        finish_tag(source, slot, face);
    if (source->corner_texcoords)
        finish_texcoords(slot, face);
    a->face_sizes[a->face_count] = (uint32_t)face->size;
    a->corner_count += face->size;
    slot->at = face->at;
    return a->face_count++ != slot->last_face;
}

/* ---- strips ---- */

bool fmt_ply_add_to_strip(const struct ply_source *source, struct stream_slot *slot,
                          struct ply_strip *strip, int64_t index, uint64_t at)
{
    struct mesh_arrays *a = &slot->arrays;
    if (index < 0) {
        strip->run = 0;
        return true;
    }
    if (index >= INDEX_LIMIT) {
        fmt_stream_fail(slot, at, "face refers to vertex %" PRId64, index);
        return false;
    }
    const uint64_t third = (uint64_t)index, first = strip->last[0], second = strip->last[1];
    const bool odd = strip->run % 2 != 0, whole = strip->run >= 2;
    strip->last[0] = second;
    strip->last[1] = third;
    strip->run = whole && odd ? 2 : strip->run + 1;
    /* Strips are joined by triangles without area, which name a vertex twice. */
    if (!whole || first == second || second == third || third == first)
        return true;
    uint64_t *corners = a->corners[FMT_MESH_VERTEX] + a->corner_count;
    corners[0] = odd ? second : first;
    corners[1] = odd ? first : second;
    corners[2] = third;
    a->corner_count += 3;
    a->face_sizes[a->face_count] = 3;
    if (source->tags != PLY_TAGS_NONE) /* strips have the first texture, and no colours */
        a->face_tags[a->face_count] = source->tags == PLY_TAGS_TEXTURE ? 0 : PLY_NO_TAG;
    slot->at = at;
    return a->face_count++ != slot->last_face;
}
