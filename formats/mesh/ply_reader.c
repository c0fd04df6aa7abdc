/* ply_reader.c - reads PLY files as an ordered stream of parsed parts.
 *
 * Understood: text and binary of both byte orders, numbers of any type, elements in any order.
 * Vertices have positions, normals, colours and texture coordinates. Faces have any number of
 * corners, colours, texture coordinates of corners and a texture's number; "tristrips" are strips
 * of triangles. Other elements and properties are skipped. */
#include <inttypes.h>
#include <stdio.h>
#include <string.h>

#include "base/loss.h"
#include "formats/mesh/mesh_text.h"
#include "formats/mesh/ply_internal.h"

/* ---- opening ---- */

static bool recognise(const char *head, size_t size)
{
    const size_t mark = fmt_mesh_mark(head, size);
    return size >= mark + 4 && memcmp(head + mark, "ply", 3) == 0 &&
           (head[mark + 3] == '\n' || head[mark + 3] == '\r');
}

/* Leaves the texture coordinates of vertices unread, for files whose corners have their own. */
static void drop_vertex_texcoords(struct ply_header *header)
{
    for (uint32_t e = 0; e < header->element_count; e++) {
        struct ply_element *element = &header->elements[e];
        if (element->kind != PLY_VERTICES)
            continue;
        for (uint32_t i = 0; i < element->property_count; i++) {
            struct ply_property *p = &header->properties[element->first_property + i];
            if (p->role == PLY_S || p->role == PLY_T)
                p->role = PLY_UNUSED;
        }
        element->role[PLY_S] = element->role[PLY_T] = NULL;
    }
}

/* Decides what the properties of a file's header are used for. */
static void choose_use(struct ply_source *source)
{
    const struct ply_element *vertices = fmt_ply_find_element(&source->header, PLY_VERTICES);
    const struct ply_element *faces = fmt_ply_find_element(&source->header, PLY_FACES);
    source->vertex_normals = vertices->role[PLY_NX] != NULL;
    source->corner_texcoords = faces && faces->role[PLY_CORNER_TEXCOORDS];
    if (source->corner_texcoords)
        drop_vertex_texcoords(&source->header);
    source->vertex_texcoords = vertices->role[PLY_S] != NULL;
    if (source->header.texture_count > 0 && (source->corner_texcoords || source->vertex_texcoords))
        source->tags = PLY_TAGS_TEXTURE;
    else if (faces && faces->role[PLY_RED] && !vertices->role[PLY_RED])
        source->tags = PLY_TAGS_COLOR;
}

static int begin(struct stream_source *source)
{
    struct ply_source *file = source->data;
    int status = fmt_input_open(source->input);
    if (!status)
        status = fmt_ply_header_read(source->ctx, source->input, &file->header);
    const int closed = fmt_input_close(source->input);
    status = status ? status : closed;
    if (status)
        return status;
    choose_use(file);
    source->material_count = source->part_count = file->header.texture_count;
    return 0;
}

static void end(struct stream_source *source)
{
    struct ply_source *file = source->data;
    fmt_ply_header_free(source->ctx, &file->header);
    bsq_texts_free(&file->colors);
}

/* ---- reading ---- */

/* Gives each corner the normal and texture coordinate of its vertex. */
static int copy_vertex_indices(struct stream_slot *slot)
{
    const struct ply_source *file = slot->source->data;
    const bool wanted[FMT_MESH_KIND_COUNT] = {
        [FMT_MESH_NORMAL] = file->vertex_normals, [FMT_MESH_TEXCOORD] = file->vertex_texcoords};
    struct mesh_arrays *a = &slot->arrays;
    int status = 0;
    for (int kind = FMT_MESH_TEXCOORD; kind <= FMT_MESH_NORMAL && a->face_count > 0; kind++) {
        if (!wanted[kind])
            continue;
        BSQ_TRY(
            FMT_RESERVE(slot->ctx, a->corner_count, a->corners[kind], a->corner_capacity[kind]));
        a->has_corners[kind] = true;
        memcpy(a->corners[kind], a->corners[FMT_MESH_VERTEX], a->corner_count * sizeof(uint64_t));
    }
done:
    return status;
}

static int parse(struct stream_slot *slot)
{
    const struct ply_header *header = &((struct ply_source *)slot->source->data)->header;
    const uint32_t number = slot->part.kind & ~PLY_PART_PIECE;
    int status;
    if (slot->part.kind == PLY_PART_REST || header->elements[number].kind == PLY_OTHER)
        return 0;
    const struct ply_element *element = &header->elements[number];
    BSQ_TRY(fmt_stream_load(slot));
    BSQ_TRY(fmt_ply_parse(element, slot));
    slot->local = slot->arrays.count[FMT_MESH_TEXCOORD] > 0 && element->kind != PLY_VERTICES
                      ? 1u << FMT_MESH_TEXCOORD
                      : 0;
    status = copy_vertex_indices(slot);
done:
    return status;
}

/* Warns of bytes after the last element, unless they are blank. */
static int warn_rest(const struct stream_slot *slot)
{
    const struct stream_source *source = slot->source;
    const uint64_t bytes = slot->part.end - slot->part.offset;
    char sample[256];
    uint64_t got;
    int status = fmt_input_read_some(source->input, sample, sizeof sample, slot->part.offset, &got);
    if (!status && fmt_mesh_count_space(sample, got) < bytes && !source->reader->read_before)
        status = bsq_warn_loss(source->ctx, "%s: %" PRIu64 " bytes after the last element not read",
                               source->path, bytes);
    return status;
}

/* ---- materials of faces ---- */

/* Returns the first PLY file of the scan, which has the colours of faces of all of them. */
static struct stream_source *colors_owner(const struct stream_source *source)
{
    struct stream_source *first = source->reader->sources;
    while (first->format != &fmt_ply_format)
        first++;
    return first;
}

/* Sets *number to the number of a colour of faces. */
static int enter_color(struct stream_source *owner, uint32_t color, uint64_t *number)
{
    static const char digits[] = "0123456789abcdef";
    struct ply_source *file = owner->data;
    const uint32_t slot = color * 0x9e3779b1u >> 20;
    char name[8] = "#";
    int status = 0;
    if (file->cached[slot].entry == 0 || file->cached[slot].color != color) {
        for (int i = 0; i < 6; i++)
            name[1 + i] = digits[color >> (8 * (i / 2) + (i % 2 ? 0 : 4)) & 15];
        status = bsq_texts_add(owner->ctx, &owner->reader->names, &file->colors, name, number);
        file->cached[slot].color = color;
        file->cached[slot].entry = status ? 0 : (uint32_t)*number + 1;
    }
    *number = file->cached[slot].entry - UINT64_C(1);
    return status;
}

/* Sets *material to the number over the scan of a face's material. */
static int find_material(const struct stream_source *source, uint32_t tag, uint32_t *material)
{
    struct stream_source *owner = colors_owner(source);
    const struct ply_source *file = source->data;
    uint64_t number;
    int status = 0;
    *material = FMT_MESH_NO_MATERIAL;
    if (tag != PLY_NO_TAG && file->tags == PLY_TAGS_TEXTURE) {
        *material = source->numbers[tag];
    } else if (tag != PLY_NO_TAG) {
        BSQ_TRY(enter_color(owner, tag, &number));
        const uint64_t place = owner->material_count + number; /* textures come first */
        if (place == owner->number_count)
            BSQ_TRY(fmt_stream_add_material(owner, material));
        *material = owner->numbers[place];
    }
done:
    return status;
}

/* Turns face_tags into changes of material. */
static int find_materials(struct stream_slot *slot)
{
    struct mesh_arrays *a = &slot->arrays;
    int status = 0;
    for (uint64_t face = 0; face < a->face_count; face++) {
        const uint32_t tag = a->face_tags[face];
        if (face > 0 && tag == a->face_tags[face - 1])
            continue;
        BSQ_TRY(FMT_RESERVE(slot->ctx, a->change_count + 1, a->changes, a->change_capacity));
        struct fmt_mesh_material_change *change = &a->changes[a->change_count++];
        change->face = face;
        BSQ_TRY(find_material(slot->source, tag, &change->material));
    }
done:
    return status;
}

static int pass(struct stream_slot *slot)
{
    const struct ply_source *file = slot->source->data;
    if (slot->part.kind == PLY_PART_REST)
        return warn_rest(slot);
    return file->tags != PLY_TAGS_NONE ? find_materials(slot) : 0;
}

static int describe_texture(const struct stream_source *source, const char *name,
                            struct fmt_material *out)
{
    bool exists;
    int status;
    BSQ_TRY(bsq_text_copy(source->ctx, name, &out->name));
    BSQ_TRY(fmt_path_find(source->ctx, fmt_input_beside(source->input), name, &out->texture_path,
                          &exists));
    status = bsq_text_copy(source->ctx, source->path, &out->texture_place);
done:
    return status;
}

static int describe_color(struct bsq_ctx *ctx, const char *name, struct fmt_material *out)
{
    unsigned color[3] = {0};
    sscanf(name, "#%2x%2x%2x", &color[0], &color[1], &color[2]);
    for (int c = 0; c < 3; c++)
        out->diffuse[c] = (float)color[c] / 255.0f;
    out->has_diffuse = true;
    return bsq_text_copy(ctx, name, &out->name);
}

/* Lists the textures that comments name, and then the colours of faces. */
static int read_materials(struct stream_source *source, struct fmt_materials *out)
{
    const struct ply_source *file = source->data;
    struct fmt_material *material;
    int status = 0;
    for (uint32_t i = 0; i < file->header.texture_count; i++) {
        BSQ_TRY(fmt_materials_add(source->ctx, out, &material));
        BSQ_TRY(describe_texture(source, file->header.textures[i], material));
    }
    for (uint64_t i = 0; i < file->colors.count; i++) {
        BSQ_TRY(fmt_materials_add(source->ctx, out, &material));
        BSQ_TRY(describe_color(source->ctx, file->colors.list[i], material));
    }
done:
    return status;
}

/* ---- warnings ---- */

/* Warns of elements, properties, colours and textures that are not used. */
static int finish(struct stream_source *source)
{
    const struct ply_source *file = source->data;
    const struct ply_element *faces = fmt_ply_find_element(&file->header, PLY_FACES);
    const bool textured = file->tags == PLY_TAGS_TEXTURE;
    int status = 0;
    if (source->reader->read_before)
        return 0;
    fmt_ply_warn_unread(source->ctx, source->path, &file->header);
    if (file->header.texture_count > 0 && !textured)
        status =
            bsq_warn_loss(source->ctx, "%s: no texture coordinates, so the texture %s is not used",
                          source->path, file->header.textures[0]);
    if (status == 0 && faces && faces->role[PLY_RED] && file->tags != PLY_TAGS_COLOR)
        status = bsq_warn_loss(source->ctx, "%s: colours of faces are not used beside %s",
                               source->path, textured ? "a texture" : "those of vertices");
    return status;
}

/* Faces are taken for triangles. */
static int estimate(struct stream_source *source, uint64_t bytes, bool plain,
                    struct fmt_mesh_estimate *out)
{
    const struct ply_source *file = source->data;
    const struct ply_element *vertices = fmt_ply_find_element(&file->header, PLY_VERTICES);
    const struct ply_element *faces = fmt_ply_find_element(&file->header, PLY_FACES);
    const struct ply_element *strips = fmt_ply_find_element(&file->header, PLY_STRIPS);
    uint64_t triangles = faces ? faces->count : 0;
    (void)plain;
    if (strips && strips->count > 0)
        triangles += bytes > file->header.bytes ? (bytes - file->header.bytes) / 4 : 0;
    out->vertices += vertices->count;
    out->normals += file->vertex_normals ? vertices->count : 0;
    out->texcoords += file->vertex_texcoords   ? vertices->count
                      : file->corner_texcoords ? 3 * triangles
                                               : 0;
    out->faces += triangles;
    out->corners += 3 * triangles;
    out->has_colors |= vertices->role[PLY_RED] != NULL;
    out->faces_come_last &=
        !file->corner_texcoords && (!faces || faces > vertices) && (!strips || strips > vertices);
    return 0;
}

static const char lost_textures[] =
    "faces whose texnumber, from 0, is not below the number of textures that the file names; they "
    "have no texture";
static const char clamped_colors[] =
    "colours of faces are out of range and were clamped; real numbers range to 1";

const struct fmt_mesh_format fmt_ply_format = {
    .name = "PLY",
    .suffix = ".ply",
    .data_bytes = sizeof(struct ply_source),
    .oddities =
        {[STREAM_NO_POSITION] = "positions are not finite or incomplete and were left out",
         [STREAM_NO_NORMAL] = "normals are not finite or incomplete and were left out",
         [STREAM_NO_COLOR] = "colours are not finite or incomplete and were left out",
         [STREAM_NO_TEXCOORD] =
             "texture coordinates are not finite or incomplete and were left out",
         [PLY_BAD_TEXCOORDS] =
             "texture coordinates of corners are not finite or incomplete and were left out",
         [PLY_CLAMPED_COLORS] = clamped_colors,
         [PLY_LOST_TEXTURES] = lost_textures},
    .recognise = recognise,
    .begin = begin,
    .end = end,
    .cut = fmt_ply_cut,
    .parse = parse,
    .pass = pass,
    .finish = finish,
    .estimate = estimate,
    .read_materials = read_materials,
    .preview_materials = read_materials,
};
