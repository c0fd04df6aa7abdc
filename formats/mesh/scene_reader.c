/* scene_reader.c - reads FBX, COLLADA and other files, which Assimp reads whole.
 *
 * Meant for low-poly meshes. The memory that Assimp takes is not known before; it is counted as a
 * multiple of the file. */
#include <inttypes.h>
#include <math.h>
#include <string.h>

#include "base/file.h"
#include "formats/mesh/mesh_format.h"
#include "formats/mesh/mesh_text.h"
#include "formats/mesh/scene_module.h"

/* Assimp's memory for a byte of a file. Text of positions takes less, compressed FBX files more. */
enum { MEMORY_PER_BYTE = 40 };

/* What the reader keeps of a file: source->data. */
struct scene_file {
    struct fmt_scene scene;
    uint64_t bytes; /* of the file */
};

/* ---- opening ---- */

static bool recognise(const char *head, size_t size)
{
    static const char magic[] = "Kaydara FBX Binary";
    return size >= sizeof magic && memcmp(head, magic, sizeof magic - 1) == 0;
}

/* Returns a name whose suffix tells the format: the file's, without the suffix of a packed file. */
static int name_for_format(struct bsq_ctx *ctx, const char *path, const char *head, size_t size,
                           char **out)
{
    int status = bsq_text_copy(ctx, recognise(head, size) ? "mesh.fbx" : bsq_file_name(path), out);
    if (!status)
        (*out)[fmt_mesh_unpacked_length(*out)] = '\0';
    return status;
}

static int read_whole(struct stream_source *source, const struct bsq_file *file)
{
    struct bsq_ctx *ctx = source->ctx;
    struct scene_file *scene = source->data;
    const struct fmt_module *module;
    char head[64], *name = NULL;
    uint64_t got = 0, memory;
    int status;
    scene->bytes = file->size;
    if (__builtin_mul_overflow(file->size, (uint64_t)MEMORY_PER_BYTE, &memory))
        return bsq_fail(ctx, BSQ_ENOMEM, "%s: too large", source->path);
    BSQ_TRY(fmt_module_open(ctx, "scene", "FBX, COLLADA and such files", &module));
    BSQ_TRY(bsq_file_read_some(ctx, file, head, sizeof head, 0, &got));
    BSQ_TRY(name_for_format(ctx, source->path, head, got, &name));
    BSQ_TRY(bsq_reserve(ctx, "reading a file whole by Assimp", memory));
    status = ((const struct fmt_scene_module *)module)
                 ->read(&fmt_host_functions, ctx, file, name, &scene->scene);
    bsq_release(ctx, memory);
done:
    bsq_free(ctx, name);
    return status;
}

static void end(struct stream_source *source)
{
    struct bsq_ctx *ctx = source->ctx;
    struct fmt_scene *s = &((struct scene_file *)source->data)->scene;
    void *memory[] = {s->positions, s->texcoords, s->normals, s->colors, s->face_sizes, s->corners};
    for (size_t i = 0; i < sizeof memory / sizeof *memory; i++)
        bsq_free(ctx, memory[i]);
    for (uint64_t i = 0; i < s->part_count; i++)
        bsq_free(ctx, s->parts[i].object);
    bsq_free(ctx, s->parts);
    for (uint64_t i = 0; i < s->material_count; i++) {
        bsq_free(ctx, s->materials[i].name);
        bsq_free(ctx, s->materials[i].texture);
    }
    bsq_free(ctx, s->materials);
}

static int begin(struct stream_source *source)
{
    const struct fmt_scene *scene = &((struct scene_file *)source->data)->scene;
    struct bsq_file file = BSQ_FILE_CLOSED;
    int status = fmt_input_open(source->input);
    if (status)
        return status;
    status = fmt_input_whole(source->input, &file);
    if (!status)
        status = read_whole(source, &file);
    bsq_file_close(source->ctx, &file);
    const int closed = fmt_input_close(source->input);
    source->material_count = scene->material_count;
    source->part_count = scene->part_count;
    return status ? status : closed;
}

/* ---- reading ---- */

/* Each mesh at a node is a part. The first part has all bytes of the file, also if there is none.
 */
static int cut(const struct stream_part *before, struct stream_slot *slot)
{
    const struct scene_file *file = slot->source->data;
    slot->part.kind = before->end > 0 ? before->kind + 1 : 0;
    slot->part.end = file->bytes;
    return slot->part.kind < file->scene.part_count || before->end == 0;
}

static int copy_vertices(struct stream_slot *slot, uint64_t first, uint64_t count)
{
    const struct fmt_scene *s = &((struct scene_file *)slot->source->data)->scene;
    struct mesh_arrays *a = &slot->arrays;
    int status;
    BSQ_TRY(FMT_RESERVE(slot->ctx, count, a->positions, a->position_capacity));
    BSQ_TRY(FMT_RESERVE(slot->ctx, count, a->texcoords, a->texcoord_capacity));
    BSQ_TRY(FMT_RESERVE(slot->ctx, count, a->normals, a->normal_capacity));
    memcpy(a->positions, s->positions + first, count * sizeof *a->positions);
    memcpy(a->texcoords, s->texcoords + first, count * sizeof *a->texcoords);
    memcpy(a->normals, s->normals + first, count * sizeof *a->normals);
    for (int kind = 0; kind < FMT_MESH_KIND_COUNT; kind++)
        a->count[kind] = count;
    slot->odd[STREAM_NO_POSITION].count = fmt_stream_clear_bad(&a->positions[0][0], count, 3);
    slot->odd[STREAM_NO_TEXCOORD].count = fmt_stream_clear_bad(&a->texcoords[0][0], count, 2);
    slot->odd[STREAM_NO_NORMAL].count = fmt_stream_replace_bad(a->normals, count, 0.0f);
    if (!s->colors)
        return 0;
    BSQ_TRY(FMT_RESERVE(slot->ctx, count, a->colors, a->color_capacity));
    memcpy(a->colors, s->colors + first, count * sizeof *a->colors);
    a->has_colors = true;
    slot->color_white = 1;
    const uint64_t bad = fmt_stream_replace_bad(a->colors, count, -1.0f);
    slot->odd[STREAM_NO_COLOR].count = slot->source->reader->uses_colors ? bad : 0;
done:
    return status;
}

static int copy_faces(struct stream_slot *slot, const struct fmt_scene_part *part)
{
    const struct fmt_scene *s = &((struct scene_file *)slot->source->data)->scene;
    const uint64_t corners = part[1].first_corner - part->first_corner;
    const uint64_t faces = part[1].first_face - part->first_face;
    const bool has[FMT_MESH_KIND_COUNT] = {[FMT_MESH_VERTEX] = true,
                                           [FMT_MESH_TEXCOORD] = part->has_texcoords,
                                           [FMT_MESH_NORMAL] = part->has_normals};
    struct mesh_arrays *a = &slot->arrays;
    int status;
    BSQ_TRY(FMT_RESERVE(slot->ctx, faces, a->face_sizes, a->size_capacity));
    BSQ_TRY(FMT_RESERVE(slot->ctx, 1, a->changes, a->change_capacity));
    for (int kind = 0; kind < FMT_MESH_KIND_COUNT; kind++) {
        if (!(a->has_corners[kind] = has[kind]))
            continue;
        BSQ_TRY(FMT_RESERVE(slot->ctx, corners, a->corners[kind], a->corner_capacity[kind]));
        memcpy(a->corners[kind], s->corners + part->first_corner, corners * sizeof(uint64_t));
    }
    memcpy(a->face_sizes, s->face_sizes + part->first_face, faces * sizeof *a->face_sizes);
    a->face_count = faces;
    a->corner_count = corners;
    a->vertex_bound = s->vertex_count;
    a->change_count = 1;
    a->changes[0].face = 0;
    a->changes[0].material = slot->source->reader->objects        ? slot->part.kind
                             : part->material < s->material_count ? part->material
                                                                  : FMT_MESH_NO_MATERIAL;
done:
    return status;
}

static int parse(struct stream_slot *slot)
{
    const struct fmt_scene *s = &((struct scene_file *)slot->source->data)->scene;
    const struct fmt_scene_part *part = &s->parts[slot->part.kind];
    int status = 0;
    if (slot->part.kind >= s->part_count)
        return 0;
    if (part[1].first_vertex > part->first_vertex)
        BSQ_TRY(copy_vertices(slot, part->first_vertex, part[1].first_vertex - part->first_vertex));
    if (part[1].first_face > part->first_face)
        BSQ_TRY(copy_faces(slot, part));
done:
    return status;
}

static int pass(struct stream_slot *slot)
{
    const struct fmt_scene *s = &((struct scene_file *)slot->source->data)->scene;
    struct fmt_mesh_totals *totals = slot->source->reader->totals;
    fmt_stream_number_materials(slot);
    totals->has_tangents |= s->has_tangents;
    totals->split_vertices = true;
    if (slot->part.kind == 0)
        totals->short_faces += s->short_faces;
    return 0;
}

/* Returns how many meshes have a diffuse colour out of range, which describe_material() clamps.
 * Beside vertex colours, it is one of these. */
static uint64_t count_clamped(const struct fmt_scene *s)
{
    uint64_t count = 0;
    for (uint64_t i = 0; i < s->part_count && !s->colors; i++) {
        const uint32_t number = s->parts[i].material;
        const struct fmt_scene_material *m =
            number < s->material_count ? &s->materials[number] : NULL;
        bool clamped = false;
        for (int k = 0; k < 3 && m && m->has_diffuse && !m->texture; k++)
            clamped |= m->diffuse[k] < 0 || m->diffuse[k] > 1;
        count += clamped;
    }
    return count;
}

/* Warns of what is not read. Colours matter only if the caller uses them. */
static int finish(struct stream_source *source)
{
    const struct fmt_scene *s = &((struct scene_file *)source->data)->scene;
    const bool colors = source->reader->uses_colors;
    const struct stream_unread kinds[] = {
        {colors ? s->inner_textures : 0, true,
         "textures are inside of the file and are not read: save them and use --texture"},
        {colors ? s->turned_textures : 0, true,
         "textures are turned, or use further texture coordinates, which is not applied"},
        {colors ? s->hidden_colors : 0, true,
         "meshes have a texture, so their vertex colours are not used"},
        {colors ? count_clamped(s) : 0, true,
         "meshes have a diffuse colour out of range, which was clamped"},
    };
    return fmt_stream_warn_unread(source, kinds, sizeof kinds / sizeof *kinds);
}

static int estimate(struct stream_source *source, uint64_t bytes, bool plain,
                    struct fmt_mesh_estimate *out)
{
    const struct fmt_scene *s = &((struct scene_file *)source->data)->scene;
    (void)bytes, (void)plain;
    out->vertices += s->vertex_count;
    out->texcoords += s->vertex_count;
    out->normals += s->vertex_count;
    out->faces += s->face_count;
    out->corners += s->corner_count;
    out->has_colors |= s->colors != NULL;
    return 0;
}

/* ---- materials ---- */

/* Describes a material. Its texture is looked for beside the file, as those of MTL files are. */
static int describe_material(const struct stream_source *source,
                             const struct fmt_scene_material *from, struct fmt_material *out)
{
    int status;
    for (int k = 0; k < 3; k++)
        out->diffuse[k] = fminf(fmaxf(from->diffuse[k], 0), 1);
    out->has_diffuse = from->has_diffuse;
    out->uv = from->uv;
    BSQ_TRY(bsq_text_copy(source->ctx, from->name, &out->name));
    if (!from->texture)
        return 0;
    BSQ_TRY(fmt_path_find(source->ctx, fmt_input_beside(source->input), from->texture,
                          &out->texture_path, NULL));
    status = bsq_text_copy(source->ctx, source->path, &out->texture_place);
done:
    return status;
}

static int list_materials(struct stream_source *source, struct fmt_materials *out)
{
    const struct fmt_scene *s = &((struct scene_file *)source->data)->scene;
    struct fmt_material *material;
    int status = 0;
    for (uint64_t i = 0; i < s->material_count; i++) {
        BSQ_TRY(fmt_materials_add(source->ctx, out, &material));
        BSQ_TRY(describe_material(source, &s->materials[i], material));
    }
done:
    return status;
}

static const char *find_part(const struct stream_source *source, uint64_t number,
                             uint32_t *material)
{
    const struct fmt_scene *s = &((struct scene_file *)source->data)->scene;
    *material = s->parts[number].material;
    return s->parts[number].object;
}

static const char left_out[] = "values are not finite and were left out";

const struct fmt_mesh_format fmt_scene_format = {
    .name = "FBX, COLLADA or the like",
    .suffix = ".fbx .dae .3ds .x",
    .data_bytes = sizeof(struct scene_file),
    .oddities = {[STREAM_NO_POSITION] = left_out,
                 [STREAM_NO_TEXCOORD] = left_out,
                 [STREAM_NO_NORMAL] = left_out,
                 [STREAM_NO_COLOR] = "colours are not finite and were left out"},
    .recognise = recognise,
    .begin = begin,
    .end = end,
    .cut = cut,
    .parse = parse,
    .pass = pass,
    .finish = finish,
    .estimate = estimate,
    .read_materials = list_materials,
    .preview_materials = list_materials,
    .find_part = find_part,
};
