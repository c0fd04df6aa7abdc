/* ply_material.c - materials of PLY files: textures that comments name, and colours of faces.
 *
 * Materials with the numbers below reader->texture_count are textures, file by file. A colour of
 * faces becomes a material at its first appearance. */
#include <stdio.h>
#include <string.h>

#include "formats/mesh/mesh_text.h"
#include "formats/mesh/obj_path.h"
#include "formats/mesh/ply_internal.h"

/* ---- colours of faces ---- */

static uint32_t *find_slot(const struct ply_colors *colors, uint32_t color)
{
    uint64_t i = (color * 0x9e3779b97f4a7c15u >> 24) & (colors->slot_count - 1);
    while (colors->slots[i] != 0 && colors->list[colors->slots[i] - 1] != color)
        i = (i + 1) & (colors->slot_count - 1);
    return &colors->slots[i];
}

/* Keeps the table at most half full. */
static int make_slots(struct bsq_ctx *ctx, struct ply_colors *colors)
{
    if (colors->slot_count > 2 * colors->count)
        return 0;
    uint64_t slot_count = colors->slot_count ? 4 * colors->slot_count : 1024;
    uint32_t *slots;
    int status = bsq_calloc(ctx, "colours of faces", slot_count, sizeof *slots, &slots);
    if (status)
        return status;
    bsq_free(ctx, colors->slots);
    colors->slots = slots;
    colors->slot_count = slot_count;
    for (uint64_t i = 0; i < colors->count; i++)
        *find_slot(colors, colors->list[i]) = (uint32_t)(i + 1);
    return 0;
}

/* Sets *number to the number of a colour; enters it if it is new. */
static int enter_color(struct bsq_ctx *ctx, struct ply_colors *colors, uint32_t color,
                       uint32_t *number)
{
    int status = make_slots(ctx, colors);
    uint32_t *slot = status ? NULL : find_slot(colors, color);
    if (!status && *slot == 0) {
        status = bsq_grow(ctx, "colours of faces", colors->count + 1, sizeof *colors->list,
                          &colors->list, &colors->capacity);
        if (!status) {
            colors->list[colors->count++] = color;
            *slot = (uint32_t)colors->count;
        }
    }
    if (!status)
        *number = *slot - 1;
    return status;
}

void fmt_ply_colors_free(struct bsq_ctx *ctx, struct ply_colors *colors)
{
    bsq_free(ctx, colors->list);
    bsq_free(ctx, colors->slots);
}

/* ---- materials of faces ---- */

static int find_material(struct ply_reader *reader, const struct ply_source *source, uint32_t tag,
                         uint32_t *material)
{
    if (tag == PLY_NO_TAG || source->tags == PLY_TAGS_TEXTURE) {
        *material = tag == PLY_NO_TAG ? FMT_MESH_NO_MATERIAL : source->texture_base + tag;
        return 0;
    }
    int status = enter_color(reader->stream.base.ctx, &reader->colors, tag, material);
    *material += reader->texture_count;
    return status;
}

int fmt_ply_find_materials(struct ply_reader *reader, const struct ply_source *source,
                           struct mesh_arrays *arrays)
{
    struct bsq_ctx *ctx = reader->stream.base.ctx;
    int status = 0;
    for (uint64_t face = 0; face < arrays->face_count && !status; face++) {
        const uint32_t tag = arrays->face_tags[face];
        if (face > 0 && tag == arrays->face_tags[face - 1])
            continue;
        status = fmt_arrays_reserve_changes(ctx, arrays, arrays->change_count + 1);
        if (status)
            return status;
        struct fmt_mesh_material_change *change = &arrays->changes[arrays->change_count++];
        change->face = face;
        status = find_material(reader, source, tag, &change->material);
    }
    return status;
}

/* ---- descriptions ---- */

static int describe_texture(struct ply_reader *reader, uint32_t file, const char *name,
                            struct fmt_material *out)
{
    struct bsq_ctx *ctx = reader->stream.base.ctx;
    bool exists;
    int status = fmt_string_copy(ctx, name, &out->name);
    for (int c = 0; c < 3; c++)
        out->diffuse[c] = 0.8f;
    if (!status)
        status = fmt_path_find(ctx, fmt_input_beside(reader->stream.sources[file].input), name,
                               &out->texture_path, &exists);
    if (!status)
        status = fmt_string_copy(ctx, reader->stream.sources[file].path, &out->texture_place);
    return status;
}

static int describe_color(struct bsq_ctx *ctx, uint32_t color, struct fmt_material *out)
{
    char name[16];
    for (int c = 0; c < 3; c++)
        out->diffuse[c] = (float)(color >> 8 * c & 255) / 255.0f;
    out->has_diffuse = true;
    snprintf(name, sizeof name, "#%02x%02x%02x", color & 255, color >> 8 & 255, color >> 16 & 255);
    return fmt_string_copy(ctx, name, &out->name);
}

int fmt_ply_read_materials(struct fmt_mesh_reader *base, struct fmt_materials *out)
{
    struct ply_reader *reader = (struct ply_reader *)base;
    const uint64_t count = reader->texture_count + reader->colors.count;
    if (count == 0)
        return 0;
    int status = bsq_calloc(base->ctx, "a list of materials and of colours of faces", count,
                            sizeof *out->list, &out->list);
    if (status)
        return status;
    out->count = (uint32_t)count;
    struct fmt_material *next = out->list;
    for (uint32_t file = 0; file < reader->stream.source_count; file++) {
        const struct ply_header *header = &reader->files[file].header;
        for (uint32_t i = 0; i < header->texture_count && !status; i++)
            status = describe_texture(reader, file, header->textures[i], next++);
    }
    for (uint64_t i = 0; i < reader->colors.count && !status; i++)
        status = describe_color(base->ctx, reader->colors.list[i], next++);
    if (status)
        fmt_materials_free(base->ctx, out);
    return status;
}
