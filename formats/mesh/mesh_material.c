/* mesh_material.c - the materials of all files of a scan. */
#include <string.h>

#include "formats/mesh/mesh_format.h"

/* Moves the materials of a file to their numbers over the scan. */
static void place_materials(const struct stream_source *source, struct fmt_materials *own,
                            struct fmt_materials *out)
{
    for (uint32_t i = 0; i < own->count && i < source->number_count; i++) {
        out->list[source->numbers[i]] = own->list[i];
        own->list[i] = (struct fmt_material){0};
    }
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
        BSQ_TRY(BSQ_CALLOC(reader->ctx, "a list of materials and of colours of faces",
                           reader->material_count, &out->list));
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
