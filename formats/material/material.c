/* material.c - see material.h. */
#include "formats/material/material.h"

#include <string.h>

#include "base/text.h"

const struct fmt_channel fmt_color_channel = {
    .name = "", .values = 3, .color = true, .mtl_map = "map_Kd", .mtl_value = "Kd", .usual = 0.8f};

/* Returns a channel that the file says nothing of. */
static struct fmt_material_channel usual_channel(const struct fmt_channel *row)
{
    return (struct fmt_material_channel){
        .channel = row, .value = {row->usual, row->usual, row->usual}, .factor = {1, 1, 1}};
}

int fmt_materials_add(struct bsq_ctx *ctx, struct fmt_materials *list, struct fmt_material **out)
{
    if (list->count == UINT32_MAX - 1)
        return bsq_fail(ctx, BSQ_EDATA, "too many materials");
    BSQ_PASS(BSQ_GROW(ctx, "materials", list->count + UINT64_C(1), &list->list, &list->capacity));
    *out = &list->list[list->count++];
    **out = (struct fmt_material){.color = usual_channel(&fmt_color_channel)};
    return 0;
}

static void free_channel(struct bsq_ctx *ctx, struct fmt_material_channel *channel)
{
    BSQ_FREE(ctx, channel->texture_path, channel->texture_place);
}

void fmt_material_free(struct bsq_ctx *ctx, struct fmt_material *material)
{
    for (uint32_t i = 0; i < material->channel_count; i++)
        free_channel(ctx, &material->channels[i]);
    free_channel(ctx, &material->color);
    BSQ_FREE(ctx, material->channels, material->name, material->object);
}

void fmt_materials_free(struct bsq_ctx *ctx, struct fmt_materials *materials)
{
    for (uint32_t i = 0; i < materials->count; i++)
        fmt_material_free(ctx, &materials->list[i]);
    bsq_free(ctx, materials->list);
    memset(materials, 0, sizeof *materials);
}

struct fmt_material_channel *fmt_material_find_channel(const struct fmt_material *material,
                                                       const char *name)
{
    for (uint32_t i = 0; i < material->channel_count; i++)
        if (strcmp(material->channels[i].channel->name, name) == 0)
            return &material->channels[i];
    return NULL;
}

int fmt_material_enter_channel(struct bsq_ctx *ctx, struct fmt_material *material,
                               const struct fmt_channel *channel, struct fmt_material_channel **out)
{
    uint64_t capacity = material->channel_count; /* materials have few channels */
    if ((*out = fmt_material_find_channel(material, channel->name)) != NULL)
        return 0;
    BSQ_PASS(BSQ_GROW(ctx, "materials", material->channel_count + UINT64_C(1), &material->channels,
                      &capacity));
    *out = &material->channels[material->channel_count++];
    **out = usual_channel(channel);
    return 0;
}

/* ---- copies ---- */

static int copy_channel(struct bsq_ctx *ctx, const struct fmt_material_channel *from,
                        struct fmt_material_channel *out)
{
    *out = *from;
    out->texture_path = out->texture_place = NULL;
    BSQ_PASS(bsq_text_copy(ctx, from->texture_path, &out->texture_path));
    return bsq_text_copy(ctx, from->texture_place, &out->texture_place);
}

int fmt_material_copy(struct bsq_ctx *ctx, const struct fmt_material *from,
                      struct fmt_material *out)
{
    /* NOLINTNEXTLINE(clang-analyzer-core.NullDereference): a material that was added */
    *out = *from;
    out->name = out->object = out->color.texture_path = out->color.texture_place = NULL;
    out->channels = NULL;
    out->channel_count = 0;
    BSQ_PASS(bsq_text_copy(ctx, from->name, &out->name));
    BSQ_PASS(copy_channel(ctx, &from->color, &out->color));
    if (from->channel_count > 0)
        BSQ_PASS(BSQ_CALLOC(ctx, "materials", from->channel_count, &out->channels));
    for (uint32_t i = 0; i < from->channel_count; i++)
        BSQ_PASS(copy_channel(ctx, &from->channels[i], &out->channels[out->channel_count++]));
    return 0;
}
