/* mesh_material.c - lists of materials, for all formats. */
#include <string.h>

#include "formats/mesh/mesh_format.h"
#include "formats/mesh/mesh_text.h"

const struct bsq_channel fmt_color_channel = {
    .name = "", .values = 3, .color = true, .mtl_map = "map_Kd", .mtl_value = "Kd", .usual = 0.8f};

/* ---- the materials of a scan ---- */

/* Moves the materials of a file to their numbers over the scan. */
static void place_materials(const struct stream_source *source, struct fmt_materials *own,
                            struct fmt_materials *out)
{
    for (uint32_t i = 0; i < own->count && i < source->number_count; i++) {
        out->list[source->numbers[i]] = own->list[i];
        own->list[i] = (struct fmt_material){0};
    }
}

static int copy_channel(struct bsq_ctx *ctx, const struct fmt_material_channel *from,
                        struct fmt_material_channel *out)
{
    *out = *from;
    out->texture_path = out->texture_place = NULL;
    const int status = bsq_text_copy(ctx, from->texture_path, &out->texture_path);
    return status ? status : bsq_text_copy(ctx, from->texture_place, &out->texture_place);
}

int fmt_material_copy(struct bsq_ctx *ctx, const struct fmt_material *from,
                      struct fmt_material *out)
{
    int status;
    /* NOLINTNEXTLINE(clang-analyzer-core.NullDereference): a material that was added */
    *out = *from;
    out->name = out->object = out->color.texture_path = out->color.texture_place = NULL;
    out->channels = NULL;
    out->channel_count = 0;
    BSQ_TRY(bsq_text_copy(ctx, from->name, &out->name));
    BSQ_TRY(copy_channel(ctx, &from->color, &out->color));
    if (from->channel_count > 0)
        BSQ_TRY(bsq_calloc(ctx, "materials", from->channel_count, sizeof *out->channels,
                           &out->channels));
    for (uint32_t i = 0; i < from->channel_count; i++)
        BSQ_TRY(copy_channel(ctx, &from->channels[i], &out->channels[out->channel_count++]));
done:
    return status;
}

/* Turns the list of a file's materials into one of its objects. */
static int list_objects(const struct stream_source *source, struct fmt_materials *list)
{
    static const struct fmt_material none = {.name = "", .color = {.value = {0.8f, 0.8f, 0.8f}}};
    struct fmt_materials objects = {0};
    struct fmt_material *added = NULL;
    uint32_t material = 0;
    int status = 0;
    for (uint64_t i = 0; i < source->number_count; i++) {
        const char *object = source->format->find_object(source, i, &material);
        BSQ_TRY(i % 256 ? 0 : bsq_check(source->ctx));
        BSQ_TRY(fmt_materials_add(source->ctx, &objects, &added));
        BSQ_TRY(fmt_material_copy(source->ctx,
                                  material < list->count ? &list->list[material] : &none, added));
        BSQ_TRY(bsq_text_copy(source->ctx, object, &added->object));
    }
done:
    fmt_materials_free(source->ctx, list);
    *list = objects;
    return status;
}

int fmt_mesh_read_materials(struct fmt_mesh_reader *reader, struct fmt_materials *out)
{
    struct fmt_materials own = {0};
    int status = 0;
    memset(out, 0, sizeof *out);
    if (reader->material_count > 0)
        BSQ_TRY(bsq_calloc(reader->ctx, "a list of materials and of colours of faces",
                           reader->material_count, sizeof *out->list, &out->list));
    out->count = (uint32_t)reader->material_count;
    out->capacity = reader->material_count;
    for (uint32_t i = 0; i < reader->source_count; i++) {
        struct stream_source *source = &reader->sources[i];
        if (!source->format->read_materials)
            continue;
        BSQ_TRY(bsq_check(reader->ctx));
        BSQ_TRY(source->format->read_materials(source, &own));
        if (reader->objects && source->format->find_object)
            BSQ_TRY(list_objects(source, &own));
        place_materials(source, &own, out);
        fmt_materials_free(reader->ctx, &own);
    }
    status = fmt_obj_finish_materials(reader);
done:
    fmt_materials_free(reader->ctx, &own);
    if (status)
        fmt_materials_free(reader->ctx, out);
    return status;
}

int fmt_mesh_preview_materials(struct fmt_mesh_reader *reader, struct fmt_materials *out)
{
    int status = 0;
    memset(out, 0, sizeof *out);
    reader->uses_colors = reader->warns_of_materials = true;
    for (uint32_t i = 0; i < reader->source_count && !status; i++)
        if (reader->sources[i].format->preview_materials)
            status = reader->sources[i].format->preview_materials(&reader->sources[i], out);
    if (status)
        fmt_materials_free(reader->ctx, out);
    return status;
}

/* Returns a channel that the file says nothing of. */
static struct fmt_material_channel usual_channel(const struct bsq_channel *row)
{
    return (struct fmt_material_channel){
        .channel = row, .value = {row->usual, row->usual, row->usual}, .factor = {1, 1, 1}};
}

int fmt_materials_add(struct bsq_ctx *ctx, struct fmt_materials *list, struct fmt_material **out)
{
    if (list->count == UINT32_MAX - 1)
        return bsq_fail(ctx, BSQ_EDATA, "too many materials");
    int status = FMT_RESERVE(ctx, list->count + UINT64_C(1), list->list, list->capacity);
    if (status)
        return status;
    *out = &list->list[list->count++];
    **out = (struct fmt_material){.color = usual_channel(&fmt_color_channel)};
    return 0;
}

/* ---- one material ---- */

static void free_channel(struct bsq_ctx *ctx, struct fmt_material_channel *channel)
{
    bsq_free(ctx, channel->texture_path);
    bsq_free(ctx, channel->texture_place);
}

void fmt_material_free(struct bsq_ctx *ctx, struct fmt_material *material)
{
    for (uint32_t i = 0; i < material->channel_count; i++)
        free_channel(ctx, &material->channels[i]);
    free_channel(ctx, &material->color);
    bsq_free(ctx, material->channels);
    bsq_free(ctx, material->name);
    bsq_free(ctx, material->object);
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
                               const struct bsq_channel *channel, struct fmt_material_channel **out)
{
    uint64_t capacity = material->channel_count; /* materials have few channels */
    if ((*out = fmt_material_find_channel(material, channel->name)) != NULL)
        return 0;
    int status = bsq_grow(ctx, "materials", material->channel_count + UINT64_C(1),
                          sizeof *material->channels, &material->channels, &capacity);
    if (status)
        return status;
    *out = &material->channels[material->channel_count++];
    **out = usual_channel(channel);
    return 0;
}
