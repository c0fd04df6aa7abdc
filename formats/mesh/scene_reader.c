/* scene_reader.c - reads FBX, COLLADA and other files, which Assimp reads whole.
 *
 * Meant for low-poly meshes. Assimp runs in the program bisque-scene, because damaged files make it
 * crash, loop or take any amount of memory. Its meshes come back in a temporary file, which is
 * mapped. */
#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "base/file.h"
#include "formats/mesh/mesh_format.h"
#include "formats/mesh/mesh_text.h"
#include "formats/mesh/scene_file.h"

/* Processor time in seconds that Assimp may take: LEAST_SECONDS for any file, and a second more for
 * each BYTES_A_SECOND of it. It usually reads a hundred times as many bytes in a second. */
enum { LEAST_SECONDS = 20, BYTES_A_SECOND = 1 << 18 };

/* What the reader keeps of a file: source->data. */
struct scene_file {
    struct bsq_map map;
    struct fmt_scene scene; /* of the map */
    uint64_t bytes;         /* of the file */
};

static const struct fmt_scene *scene_of(const struct stream_source *source)
{
    return &((const struct scene_file *)source->data)->scene;
}

/* ---- opening ---- */

static bool recognise(const char *head, size_t size)
{
    static const char magic[] = "Kaydara FBX Binary";
    return size >= sizeof magic && memcmp(head, magic, sizeof magic - 1) == 0;
}

/* Takes an array of `count` elements of `size` bytes from the start of the rest of a file. Returns
 * false if the rest is shorter. */
static bool take(const char **at, uint64_t *left, uint64_t count, uint64_t size, void *out)
{
    const bool fits = count <= *left / size;
    memcpy(out, at, sizeof *at);
    *at += fits ? count * size : 0;
    *left -= fits ? count * size : 0;
    return fits;
}

/* Checks that meshes follow each other and that their names are in the file. */
static bool check_tables(const struct fmt_scene *s)
{
    const struct fmt_scene_head *head = s->head;
    const struct fmt_scene_mesh *last = &s->meshes[head->mesh_count];
    bool good = s->texts[head->text_bytes - 1] == '\0' &&
                last->first_vertex == head->vertex_count && last->first_face == head->face_count &&
                last->first_corner == head->corner_count;
    for (const struct fmt_scene_mesh *p = s->meshes; p < last && good; p++)
        good = p->object < head->text_bytes && p[0].first_vertex <= p[1].first_vertex &&
               p[0].first_face <= p[1].first_face && p[0].first_corner <= p[1].first_corner;
    for (uint64_t i = 0; i < head->material_count && good; i++)
        good =
            s->materials[i].name < head->text_bytes &&
            (s->materials[i].texture < head->text_bytes || s->materials[i].texture == UINT64_MAX);
    return good;
}

bool fmt_scene_view(const void *file, uint64_t size, struct fmt_scene *out)
{
    const char *at = file;
    const struct fmt_scene_head *head = file;
    if (!take(&at, &size, 1, sizeof *head, &out->head) || head->mesh_count > size)
        return false;
    return strncmp(head->stamp, fmt_program_stamp, sizeof head->stamp) == 0 &&
           take(&at, &size, head->mesh_count + 1, sizeof *out->meshes, &out->meshes) &&
           take(&at, &size, head->material_count, sizeof *out->materials, &out->materials) &&
           take(&at, &size, head->vertex_count, sizeof *out->positions, &out->positions) &&
           take(&at, &size, head->vertex_count, sizeof *out->texcoords, &out->texcoords) &&
           take(&at, &size, head->corner_count, sizeof *out->corners, &out->corners) &&
           take(&at, &size, head->vertex_count, sizeof *out->normals, &out->normals) &&
           take(&at, &size, head->has_colors ? head->vertex_count : 0, sizeof *out->colors,
                &out->colors) &&
           take(&at, &size, head->face_count, sizeof *out->face_sizes, &out->face_sizes) &&
           take(&at, &size, head->text_bytes, 1, &out->texts) && size == 0 &&
           head->text_bytes > 0 && check_tables(out);
}

/* Returns the suffix that tells the format: the file's, without that of a packed file. */
static const char *find_suffix(char *path, const char *head, size_t size)
{
    path[fmt_mesh_unpacked_length(path)] = '\0';
    const char *point = strrchr(bsq_file_name(path), '.');
    return recognise(head, size) ? "fbx" : point ? point + 1 : "";
}

/* Takes the program's output over. */
static int open_scene(struct stream_source *source, const char *program, struct bsq_file *output)
{
    struct scene_file *file = source->data;
    int status;
    BSQ_TRY(bsq_map_file(source->ctx, output, &file->map));
    if (!fmt_scene_view(file->map.data, file->map.size, &file->scene))
        return bsq_fail(source->ctx, BSQ_ENOINPUT,
                        "%s: %s is not of this program's build, or does not work", source->path,
                        program);
    /* The program had the memory that is left. Now the largest amount is known. */
    BSQ_TRY(bsq_reserve(source->ctx, "reading a file by Assimp", file->scene.head->memory_bytes));
    bsq_release(source->ctx, file->scene.head->memory_bytes);
done:
    return status;
}

static int read_whole(struct stream_source *source, const struct bsq_file *file)
{
    struct bsq_ctx *ctx = source->ctx;
    struct bsq_file output = BSQ_FILE_CLOSED;
    struct fmt_converter how = {.program = "bisque-scene",
                                .purpose = "FBX, COLLADA and such files",
                                .library = "Assimp",
                                .path = source->path,
                                .seconds = LEAST_SECONDS + file->size / BYTES_A_SECOND};
    char head[64], program[PATH_MAX], *path = NULL;
    uint64_t got = 0;
    int status;
    ((struct scene_file *)source->data)->bytes = file->size;
    BSQ_TRY(bsq_file_read_some(ctx, file, head, sizeof head, 0, &got));
    BSQ_TRY(bsq_text_copy(ctx, source->path, &path));
    BSQ_TRY(bsq_file_temp(ctx, NULL, "the meshes of a file", &output));
    how.option = (char *)find_suffix(path, head, got);
    BSQ_TRY(fmt_program_convert(ctx, &how, file->fd, &output, program));
    status = open_scene(source, program, &output);
done:
    bsq_file_close(ctx, &output);
    bsq_free(ctx, path);
    return status;
}

static void end(struct stream_source *source)
{
    bsq_map_close(source->ctx, &((struct scene_file *)source->data)->map);
}

static int begin(struct stream_source *source)
{
    struct bsq_file file = BSQ_FILE_CLOSED;
    int status = fmt_input_open(source->input);
    if (status)
        return status;
    status = fmt_input_whole(source->input, &file);
    if (!status)
        status = read_whole(source, &file);
    bsq_file_close(source->ctx, &file);
    const int closed = fmt_input_close(source->input);
    status = status ? status : closed;
    if (!status) {
        source->material_count = scene_of(source)->head->material_count;
        source->object_count = scene_of(source)->head->mesh_count;
    }
    return status;
}

/* ---- reading ---- */

/* Each mesh at a node is a part. The first part has all bytes of the file, also if there is none.
 */
static int cut(const struct stream_part *before, struct stream_slot *slot)
{
    const struct scene_file *file = slot->source->data;
    slot->part.kind = before->end > 0 ? before->kind + 1 : 0;
    slot->part.end = file->bytes;
    return slot->part.kind < file->scene.head->mesh_count || before->end == 0;
}

static int copy_vertices(struct stream_slot *slot, uint64_t first, uint64_t count)
{
    const struct fmt_scene *s = scene_of(slot->source);
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
    if (!s->head->has_colors)
        return 0;
    BSQ_TRY(FMT_RESERVE(slot->ctx, count, a->colors, a->color_capacity));
    memcpy(a->colors, s->colors + first, count * sizeof *a->colors);
    a->has_colors = true;
    slot->color_white = 1;
done:
    return status;
}

static int copy_faces(struct stream_slot *slot, const struct fmt_scene_mesh *mesh)
{
    const struct fmt_scene *s = scene_of(slot->source);
    const uint64_t corners = mesh[1].first_corner - mesh->first_corner;
    const uint64_t faces = mesh[1].first_face - mesh->first_face;
    const bool has[FMT_MESH_KIND_COUNT] = {[FMT_MESH_VERTEX] = true,
                                           [FMT_MESH_TEXCOORD] = mesh->has_texcoords,
                                           [FMT_MESH_NORMAL] = mesh->has_normals};
    struct mesh_arrays *a = &slot->arrays;
    uint64_t counted = 0;
    int status;
    BSQ_TRY(FMT_RESERVE(slot->ctx, faces, a->face_sizes, a->size_capacity));
    BSQ_TRY(FMT_RESERVE(slot->ctx, 1, a->changes, a->change_capacity));
    for (int kind = 0; kind < FMT_MESH_KIND_COUNT; kind++) {
        if (!(a->has_corners[kind] = has[kind]))
            continue;
        BSQ_TRY(FMT_RESERVE(slot->ctx, corners, a->corners[kind], a->corner_capacity[kind]));
        memcpy(a->corners[kind], s->corners + mesh->first_corner, corners * sizeof(uint64_t));
    }
    memcpy(a->face_sizes, s->face_sizes + mesh->first_face, faces * sizeof *a->face_sizes);
    for (uint64_t f = 0; f < faces; f++)
        counted += a->face_sizes[f] < 3 ? corners + 1 : a->face_sizes[f];
    if (counted != corners)
        return bsq_fail(slot->ctx, BSQ_EBUG, "bisque-scene wrote wrong sizes of faces");
    a->face_count = faces;
    a->corner_count = corners;
    a->change_count = 1;
    a->changes[0].face = 0;
    a->changes[0].material = slot->source->reader->objects              ? slot->part.kind
                             : mesh->material < s->head->material_count ? mesh->material
                                                                        : FMT_MESH_NO_MATERIAL;
done:
    return status;
}

static int parse(struct stream_slot *slot)
{
    const struct fmt_scene *s = scene_of(slot->source);
    const struct fmt_scene_mesh *mesh = &s->meshes[slot->part.kind];
    int status = 0;
    if (slot->part.kind >= s->head->mesh_count)
        return 0;
    if (mesh[1].first_vertex > mesh->first_vertex)
        BSQ_TRY(copy_vertices(slot, mesh->first_vertex, mesh[1].first_vertex - mesh->first_vertex));
    if (mesh[1].first_face > mesh->first_face)
        BSQ_TRY(copy_faces(slot, mesh));
done:
    return status;
}

static int pass(struct stream_slot *slot)
{
    const struct fmt_scene *s = scene_of(slot->source);
    struct fmt_mesh_totals *totals = slot->source->reader->totals;
    fmt_stream_number_materials(slot);
    totals->has_tangents |= s->head->has_tangents;
    totals->split_vertices = true;
    if (slot->part.kind == 0)
        totals->short_faces += s->head->short_faces;
    if (!slot->source->reader->uses_colors)
        slot->odd[STREAM_NO_COLOR].count = 0;
    return 0;
}

/* Returns how many meshes have a diffuse colour out of range, which describe_material() clamps.
 * Beside vertex colours, it is one of these. */
static uint64_t count_clamped(const struct fmt_scene *s)
{
    uint64_t count = 0;
    for (uint64_t i = 0; i < s->head->mesh_count && !s->head->has_colors; i++) {
        const uint32_t number = s->meshes[i].material;
        const struct fmt_scene_material *m =
            number < s->head->material_count ? &s->materials[number] : NULL;
        bool clamped = false;
        for (int k = 0; k < 3 && m && m->has_diffuse && m->texture == UINT64_MAX; k++)
            clamped |= m->diffuse[k] < 0 || m->diffuse[k] > 1;
        count += clamped;
    }
    return count;
}

/* Warns of what is not read. Colours matter only if the caller uses them. */
static int finish(struct stream_source *source)
{
    const struct fmt_scene *s = scene_of(source);
    const bool colors = source->reader->uses_colors;
    const struct stream_unread kinds[] = {
        {colors ? s->head->inner_textures : 0, true,
         "textures are inside of the file and are not read: save them and use --texture"},
        {colors ? s->head->turned_textures : 0, true,
         "textures are turned, or use further texture coordinates, which is not applied"},
        {colors ? s->head->hidden_colors : 0, true,
         "meshes have a texture, so their vertex colours are not used"},
        {colors ? count_clamped(s) : 0, true,
         "meshes have a diffuse colour out of range, which was clamped"},
    };
    return fmt_stream_warn_unread(source, kinds, sizeof kinds / sizeof *kinds);
}

static int estimate(struct stream_source *source, uint64_t bytes, bool plain,
                    struct fmt_mesh_estimate *out)
{
    const struct fmt_scene *s = scene_of(source);
    (void)bytes, (void)plain;
    out->vertices += s->head->vertex_count;
    out->texcoords += s->head->vertex_count;
    out->normals += s->head->vertex_count;
    out->faces += s->head->face_count;
    out->corners += s->head->corner_count;
    out->has_colors |= s->head->has_colors;
    return 0;
}

/* ---- materials ---- */

/* Describes a material. Its texture is looked for beside the file, as those of MTL files are. */
static int describe_material(const struct stream_source *source,
                             const struct fmt_scene_material *from, struct fmt_material *out)
{
    const char *texts = scene_of(source)->texts;
    int status;
    for (int k = 0; k < 3; k++)
        out->color.value[k] = fminf(fmaxf(from->diffuse[k], 0), 1);
    out->color.has_value = from->has_diffuse;
    out->color.uv = from->uv;
    BSQ_TRY(bsq_text_copy(source->ctx, texts + from->name, &out->name));
    if (from->texture == UINT64_MAX)
        return 0;
    BSQ_TRY(fmt_path_find(source->ctx, fmt_input_beside(source->input), texts + from->texture,
                          &out->color.texture_path, NULL));
    status = bsq_text_copy(source->ctx, source->path, &out->color.texture_place);
done:
    return status;
}

static int list_materials(struct stream_source *source, struct fmt_materials *out)
{
    const struct fmt_scene *s = scene_of(source);
    struct fmt_material *material;
    int status = 0;
    for (uint64_t i = 0; i < s->head->material_count; i++) {
        BSQ_TRY(fmt_materials_add(source->ctx, out, &material));
        BSQ_TRY(describe_material(source, &s->materials[i], material));
    }
done:
    return status;
}

static const char *find_object(const struct stream_source *source, uint64_t number,
                               uint32_t *material)
{
    const struct fmt_scene *s = scene_of(source);
    *material = s->meshes[number].material;
    return s->texts + s->meshes[number].object;
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
    .find_object = find_object,
};
