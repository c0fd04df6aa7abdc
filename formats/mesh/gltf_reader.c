/* gltf_reader.c - reads glTF 2.0 files, .gltf and GLB, as an ordered stream of parsed parts.
 *
 * A file's JSON says where its elements are, so parts are cut without reading anything: first all
 * vertices, then all faces, each in the order of nodes and primitives. Buffers are read in parts,
 * and memory does not grow with them. */
#include <inttypes.h>
#include <string.h>

#include "formats/mesh/gltf_internal.h"
#include "formats/mesh/mesh_text.h"

/* ---- opening ---- */

static bool recognise(const char *head, size_t size)
{
    size_t i = fmt_mesh_mark(head, size);
    if (size >= 4 && memcmp(head, "glTF", 4) == 0)
        return true;
    while (i < size && (head[i] == ' ' || head[i] == '\t' || head[i] == '\r' || head[i] == '\n'))
        i++;
    return i < size && head[i] == '{' && memmem(head + i, size - i, "\"asset\"", 7) != NULL;
}

/* Reads all elements of a top-level array. *list: becomes an array of elements of `bytes` bytes,
 * with space for one more. */
static int read_list(struct gltf_document *document, struct gltf_source *file, const char *array,
                     uint64_t bytes, void *list, uint32_t *count,
                     int (*read)(const struct gltf_place *, struct gltf_source *, void *))
{
    const uint64_t all = fmt_gltf_count(document, array);
    uint8_t *elements;
    int status;
    BSQ_TRY((bsq_calloc)(document->ctx, array, all + 1, bytes, list));
    memcpy(&elements, list, sizeof elements);
    for (uint64_t i = 0; i < all; i++) {
        const struct gltf_place place = fmt_gltf_element(document, array, i);
        if (i % 1024 == 0)
            BSQ_TRY(bsq_check(document->ctx));
        ++*count;
        BSQ_TRY(read(&place, file, elements + i * bytes));
    }
done:
    return status;
}

#define READ_LIST(name, list, count, read)                                                         \
    read_list(document, file, name, sizeof *file->list, &file->list, &file->count, read)

static int read_document(struct gltf_document *document, struct gltf_source *file)
{
    int status;
    file->bytes = document->file.size;
    BSQ_TRY(fmt_gltf_check_extensions(document));
    BSQ_TRY(READ_LIST("buffers", buffers, buffer_count, fmt_gltf_read_buffer));
    file->view_capacity = fmt_gltf_count(document, "bufferViews") + 1;
    BSQ_TRY(READ_LIST("bufferViews", views, view_count, fmt_gltf_read_view));
    BSQ_TRY(READ_LIST("accessors", accessors, accessor_count, fmt_gltf_read_accessor));
    BSQ_TRY(READ_LIST("materials", materials, material_count, fmt_gltf_read_material));
    BSQ_TRY(fmt_gltf_allocate_primitives(document, file));
    BSQ_TRY(READ_LIST("meshes", meshes, mesh_count, fmt_gltf_read_mesh));
    status = fmt_gltf_read_scene(document, file);
done:
    return status;
}

static int begin(struct stream_source *source)
{
    struct gltf_source *file = source->data;
    struct gltf_document document;
    file->own = file->decoded = (struct bsq_file)BSQ_FILE_CLOSED;
    int status = fmt_input_open(source->input);
    if (status)
        return status;
    status = fmt_gltf_open_document(source->ctx, source->input, &document);
    file->size = document.file.size;
    if (!status)
        status = read_document(&document, file);
    fmt_gltf_close_document(&document);
    const int closed = fmt_input_close(source->input);
    source->material_count = file->material_count;
    source->part_count = file->part_count;
    source->reader->gltf_colors |= file->has_colors;
    return status ? status : closed;
}

static void end(struct stream_source *source)
{
    struct bsq_ctx *ctx = source->ctx;
    struct gltf_source *file = source->data;
    bsq_file_close(ctx, &file->own);
    fmt_gltf_free_buffers(ctx, file);
    for (uint32_t i = 0; i < file->material_count; i++)
        fmt_material_free(ctx, &file->materials[i].described);
    bsq_free(ctx, file->materials);
    bsq_free(ctx, file->accessors);
    bsq_free(ctx, file->primitives);
    bsq_free(ctx, file->meshes);
    for (uint32_t i = 0; i < file->placement_count; i++)
        bsq_free(ctx, file->placements[i].name);
    bsq_free(ctx, file->placements);
}

/* ---- cutting ---- */

static uint64_t count_items(const struct gltf_source *source, const struct stream_part *part)
{
    const struct gltf_primitive *p = &source->primitives[part->carry];
    return part->carry_out == GLTF_FACES ? p->triangles : source->accessors[p->position].count;
}

/* Goes on to the next primitive, placement or kind of elements. Returns false at the end. */
static bool advance(const struct gltf_source *source, struct stream_part *part)
{
    const struct gltf_mesh *mesh = &source->meshes[source->placements[part->kind].mesh];
    part->first_item = 0;
    if (++part->carry < mesh->first + mesh->count)
        return true;
    if (++part->kind == source->placement_count) {
        part->kind = 0;
        part->carry_out++;
    }
    part->carry = source->meshes[source->placements[part->kind].mesh].first;
    return part->carry_out <= GLTF_FACES;
}

/* Returns how many elements a part has: its bytes, and the arrays that they become, fit a core's
 * cache. */
static uint64_t usual_items(const struct gltf_source *source, const struct stream_part *part)
{
    const struct gltf_primitive *p = &source->primitives[part->carry];
    const uint32_t accessors[] = {p->position, p->normal, p->texcoord, p->color};
    uint64_t bytes = 32;
    if (part->carry_out == GLTF_FACES)
        return STREAM_PART_BYTES / 24 + 1;
    for (int i = 0; i < 4; i++) {
        const uint64_t stride = accessors[i] == GLTF_NONE
                                    ? 0
                                    : fmt_gltf_stride(source, &source->accessors[accessors[i]]);
        bytes = stride > bytes ? stride : bytes;
    }
    return STREAM_PART_BYTES / bytes + 1;
}

/* The bytes of the file are shared out by elements, as a measure of progress. part->left counts the
 * elements of this and of earlier parts. */
static int cut(const struct stream_part *before, struct stream_slot *slot)
{
    const struct gltf_source *source = slot->source->data;
    const uint64_t size = source->size;
    const uint64_t all = source->total[FMT_MESH_VERTEX] + source->triangles;
    struct stream_part *part = &slot->part;
    if (before->left == all && (all > 0 || before->end > 0))
        return 0;
    slot->loaded = true; /* parsing reads what it needs */
    *part = *before;
    part->end = size;
    if (all == 0)
        return 1;
    part->first_item += before->items;
    if (before->left == 0)
        part->carry = source->meshes[source->placements[0].mesh].first;
    else if (part->first_item == count_items(source, part))
        advance(source, part);
    const uint64_t rest = count_items(source, part) - part->first_item;
    const uint64_t usual = usual_items(source, part);
    part->items = rest < usual ? rest : usual;
    part->left = before->left + part->items;
    part->end = (uint64_t)((unsigned __int128)size * part->left / all);
    return 1;
}

/* ---- reading ---- */

/* Opens the buffers, and prepares what can only be read whole. */
static int enter(struct stream_source *source)
{
    struct gltf_source *file = source->data;
    int status;
    if (file->own.fd < 0)
        BSQ_TRY(fmt_input_whole(source->input, &file->own));
    BSQ_TRY(fmt_gltf_open_buffers(source->ctx, file));
    BSQ_TRY(fmt_gltf_unpack(source->ctx, file));
    status = fmt_gltf_check_sparse(source->ctx, file);
done:
    return status;
}

static int leave(struct stream_source *source)
{
    struct gltf_source *file = source->data;
    bsq_file_close(source->ctx, &file->own);
    return fmt_gltf_close_buffers(source->ctx, file);
}

static int pass(struct stream_slot *slot)
{
    struct fmt_mesh_totals *totals = slot->source->reader->totals;
    fmt_stream_number_materials(slot);
    totals->split_vertices = true;
    totals->has_tangents |= ((struct gltf_source *)slot->source->data)->has_tangents;
    return 0;
}

/* Warns of what is not read. Colours matter only if the caller uses them. */
static int finish(struct stream_source *source)
{
    const struct gltf_unread *unread = &((struct gltf_source *)source->data)->unread;
    const bool colors = source->reader->uses_colors;
    const struct stream_unread kinds[] = {
        {unread->points, false, "primitives of points or lines are not read"},
        {unread->bare, true, "primitives without positions are not read"},
        {unread->rest, true, "indices of incomplete triangles are not read"},
        {unread->outside, true, "nodes with meshes are not in the scene and are not read"},
        {unread->unplaced, true, "meshes are at no node and are not read"},
        {unread->skins, false, "meshes have skins, which are not applied: they are in bind pose"},
        {unread->morphs, true, "meshes have weights of morph targets, which are not applied"},
        {unread->instances, true,
         "nodes have EXT_mesh_gpu_instancing, of which one instance is read"},
        {unread->hidden, true, "nodes are hidden by KHR_node_visibility, but are read"},
        {colors ? unread->images : 0, true,
         "textures have a format or an address that is not read"},
        {colors ? unread->packed_images : 0, true,
         "textures are inside of a packed file or a pipe: unpack it"},
        {colors ? unread->texture_factors : 0, true,
         "materials have a texture, so their colour factor is not used"},
        {colors ? unread->texture_colors : 0, true,
         "primitives have a texture, so their vertex colours are not used"},
        {colors ? unread->other_colors : 0, true,
         "primitives have COLOR_1 or the like without COLOR_0, which is not read"},
        {colors ? unread->variants : 0, true,
         "primitives have KHR_materials_variants, of which only the first material is read"},
    };
    return fmt_stream_warn_unread(source, kinds, sizeof kinds / sizeof *kinds);
}

static int estimate(struct stream_source *source, uint64_t bytes, bool plain,
                    struct fmt_mesh_estimate *out)
{
    const struct gltf_source *file = source->data;
    (void)bytes, (void)plain;
    out->vertices += file->total[FMT_MESH_VERTEX];
    out->texcoords += file->total[FMT_MESH_TEXCOORD];
    out->normals += file->total[FMT_MESH_NORMAL];
    out->faces += file->triangles;
    out->corners += 3 * file->triangles;
    out->has_colors |= source->reader->gltf_colors;
    return 0;
}

/* ---- materials and other files ---- */

static int list_materials(struct stream_source *source, struct fmt_materials *out)
{
    const struct gltf_source *file = source->data;
    struct fmt_material *material;
    int status = 0;
    for (uint32_t i = 0; i < file->material_count; i++) {
        BSQ_TRY(fmt_materials_add(source->ctx, out, &material));
        BSQ_TRY(fmt_material_copy(source->ctx, &file->materials[i].described, material));
    }
done:
    return status;
}

/* Adds the material and the object of a primitive at a node. */
static int add_part(const struct stream_source *source, const struct gltf_placement *placement,
                    uint32_t material, struct fmt_materials *out)
{
    const struct gltf_source *file = source->data;
    struct fmt_material *part;
    int status;
    BSQ_TRY(fmt_materials_add(source->ctx, out, &part));
    if (material != GLTF_NONE)
        BSQ_TRY(fmt_material_copy(source->ctx, &file->materials[material].described, part));
    else
        BSQ_TRY(bsq_text_copy(source->ctx, "", &part->name));
    status = bsq_text_copy(source->ctx, placement->name, &part->object);
done:
    return status;
}

/* Lists the parts: the primitives of each placement, in the order of their numbers. */
static int list_parts(struct stream_source *source, struct fmt_materials *out)
{
    const struct gltf_source *file = source->data;
    int status = 0;
    for (uint32_t i = 0; i < file->placement_count; i++) {
        const struct gltf_placement *placement = &file->placements[i];
        const struct gltf_mesh *mesh = &file->meshes[placement->mesh];
        BSQ_TRY(bsq_check(source->ctx));
        for (uint32_t k = 0; k < mesh->count; k++)
            BSQ_TRY(add_part(source, placement, file->primitives[mesh->first + k].material, out));
    }
done:
    return status;
}

static int read_materials(struct stream_source *source, struct fmt_materials *out)
{
    return source->reader->objects ? list_parts(source, out) : list_materials(source, out);
}

static const char *dependency(const struct stream_source *source, uint32_t index)
{
    const struct gltf_source *file = source->data;
    for (uint32_t i = 0; i < file->buffer_count; i++)
        if (file->buffers[i].path && index-- == 0)
            return file->buffers[i].path;
    return NULL;
}

#define LEFT_OUT " are not finite and were left out"

const struct fmt_mesh_format fmt_gltf_format = {
    .name = "glTF",
    .suffix = ".gltf",
    .data_bytes = sizeof(struct gltf_source),
    .oddities = {[STREAM_NO_POSITION] = "positions" LEFT_OUT,
                 [STREAM_NO_NORMAL] = "normals" LEFT_OUT,
                 [STREAM_NO_TEXCOORD] = "texture coordinates" LEFT_OUT,
                 [STREAM_NO_COLOR] = "colours" LEFT_OUT},
    .recognise = recognise,
    .begin = begin,
    .end = end,
    .enter = enter,
    .leave = leave,
    .cut = cut,
    .parse = fmt_gltf_parse,
    .pass = pass,
    .finish = finish,
    .estimate = estimate,
    .read_materials = read_materials,
    .preview_materials = list_materials,
    .dependency = dependency,
};
