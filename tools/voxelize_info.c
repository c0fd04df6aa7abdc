/* voxelize_info.c - describes what is in a mesh, a chunk file or a grid, for --info.
 *
 * A mesh is read once, batch by batch, so memory does not grow with it. Materials that no face uses
 * are left out. */
#include "tools/voxelize_arguments.h"

#include <float.h>
#include <math.h>
#include <string.h>
#include <unistd.h>

#include "formats/material/channels.h"
#include "formats/material/file_extent.h"
#include "formats/material/tile_files.h"
#include "formats/chunks/tris.h"
#include "formats/file_kind.h"
#include "formats/grid/nvdb.h"
#include "formats/mesh/mesh_reader.h"

/* ---- JSON ---- */

static json_t *vector_json(const double v[3])
{
    return json_pack("[f, f, f]", v[0], v[1], v[2]);
}

/* Returns the box of a file; null if it is empty. */
static json_t *box_json(const double min[3], const double max[3])
{
    if (!(min[0] <= max[0]))
        return json_null();
    const double size[3] = {max[0] - min[0], max[1] - min[1], max[2] - min[2]};
    return json_pack("{s:o, s:o, s:o}", "min", vector_json(min), "max", vector_json(max), "size",
                     vector_json(size));
}

/* Adds a text to an array that does not have it yet. Arrays are short, or their texts come in
 * groups, so only the last ones are compared. */
static void add_once(json_t **array, const char *text)
{
    enum { COMPARED = 64 };
    const size_t count = json_array_size(*array);
    for (size_t i = count; i > 0 && count - i < COMPARED; i--) {
        const char *other = json_string_value(json_array_get(*array, i - 1));
        if (other && strcmp(other, text) == 0)
            return;
    }
    cli_json_append(array, cli_json_text(text));
}

/* ---- meshes ---- */

struct survey {
    struct bsq_ctx *ctx;
    double min[3], max[3];
    bool has_colors, has_texcoords, has_normals;
    uint64_t *faces; /* of each material */
    uint64_t material_count, capacity;
    uint64_t bare_faces; /* without a material */
};

static int count_faces(struct survey *s, uint32_t material, uint64_t faces)
{
    if (material == FMT_MESH_NO_MATERIAL) {
        s->bare_faces += faces;
        return 0;
    }
    const uint64_t count = (uint64_t)material + 1;
    BSQ_PASS(BSQ_GROW(s->ctx, "materials", count, &s->faces, &s->capacity));
    for (; s->material_count < count; s->material_count++)
        s->faces[s->material_count] = 0;
    s->faces[material] += faces;
    return 0;
}

static int survey_batch(void *arg, const struct fmt_mesh_batch *batch)
{
    struct survey *s = arg;
    uint32_t material = batch->material_at_start;
    uint64_t begin = 0;
    bsq_progress_add(s->ctx, batch->byte_size);
    for (uint64_t v = 0; v < batch->vertex_count; v++)
        for (int axis = 0; axis < 3; axis++) {
            s->min[axis] = fmin(s->min[axis], batch->positions[v][axis]);
            s->max[axis] = fmax(s->max[axis], batch->positions[v][axis]);
        }
    s->has_colors |= batch->colors || batch->late_color_count > 0;
    s->has_texcoords |= fmt_mesh_any_index(batch->corner_texcoords, batch->corner_count);
    s->has_normals |= fmt_mesh_any_index(batch->corner_normals, batch->corner_count);
    for (uint64_t i = 0; i <= batch->material_change_count; i++) {
        const bool last = i == batch->material_change_count;
        const uint64_t end = last ? batch->face_count : batch->material_changes[i].face;
        BSQ_PASS(end > begin ? count_faces(s, material, end - begin) : 0);
        begin = end;
        material = last ? material : batch->material_changes[i].material;
    }
    return 0;
}

/* Returns whether a texture can be found. */
static bool file_info_is_there(const char *path)
{
    struct fmt_extent extent;
    return fmt_extent_parse(path, &extent) > 0 || fmt_has_tiles(path) || access(path, R_OK) == 0;
}

static json_t *texture_json(const char *path)
{
    return json_pack("{s:o, s:b}", "texture", cli_json_text(path), "found",
                     (int)file_info_is_there(path));
}

static json_t *channel_json(const struct fmt_material_channel *channel)
{
    const float *v = channel->value;
    if (channel->texture_path)
        return texture_json(channel->texture_path);
    return channel->channel->values == 1
               ? json_real((double)v[0])
               : json_pack("[f, f, f]", (double)v[0], (double)v[1], (double)v[2]);
}

/* Describes a material. channels: collects the names of all channels. */
static json_t *material_json(const struct fmt_material *m, uint64_t faces, json_t **channels)
{
    json_t *root =
        json_pack("{s:o, s:I}", "name", cli_json_text(m->name), "faces", (json_int_t)faces);
    if (m->color.texture_path || m->color.has_value)
        cli_json_set(&root, "color", channel_json(&m->color));
    for (uint32_t c = 0; c < m->channel_count; c++) {
        const struct fmt_material_channel *channel = &m->channels[c];
        if (!channel->texture_path && !channel->has_value)
            continue;
        cli_json_set(&root, channel->channel->name, channel_json(channel));
        add_once(channels, channel->channel->name);
    }
    return root;
}

/* Lists what bisque-voxelize keeps without options. With --channels all it keeps the channels too.
 */
static json_t *kept_json(const struct survey *s, const json_t *materials)
{
    json_t *kept = json_array();
    bool textures = false, colors = false;
    for (size_t i = 0; i < json_array_size(materials); i++) {
        const json_t *color = json_object_get(json_array_get(materials, i), "color");
        textures |= s->has_texcoords && json_is_true(json_object_get(color, "found"));
        colors |= json_is_array(color);
    }
    const char *names[] = {"positions", s->has_normals ? "normals" : NULL,
                           s->has_colors ? "vertex colours" : NULL,
                           textures ? "colour textures" : NULL,
                           colors && !s->has_colors ? "colours of materials" : NULL};
    for (size_t i = 0; i < sizeof names / sizeof *names; i++)
        if (names[i])
            add_once(&kept, names[i]);
    return kept;
}

/* Adds the materials that faces use, and their objects. */
static void describe_materials(const struct survey *s, const struct fmt_materials *found,
                               json_t **root)
{
    json_t *materials = json_array(), *objects = json_array(), *channels = json_array();
    for (uint32_t i = 0; i < found->count; i++) {
        const struct fmt_material *m = &found->list[i];
        const uint64_t faces = i < s->material_count ? s->faces[i] : 0;
        if (faces > 0 && m->object && m->object[0])
            add_once(&objects, m->object);
        if (faces > 0 && m->name)
            cli_json_append(&materials, material_json(m, faces, &channels));
    }
    cli_json_set(root, "objects", objects);
    cli_json_set(root, "materials", materials);
    cli_json_set(root, "channels", channels);
    cli_json_set(root, "kept", kept_json(s, materials));
}

static json_t *mesh_json(const struct survey *s, const struct fmt_mesh_reader *reader,
                         const struct fmt_mesh_totals *t)
{
    const char *format = fmt_mesh_format_name(reader, 0);
    return json_pack(
        "{s:s, s:I, s:s?, s:o, s:I, s:I, s:I, s:b, s:b, s:b, s:I}", "format", format, "bytes",
        (json_int_t)t->bytes, "units", strcmp(format, "glTF") == 0 ? "metres" : NULL, "box",
        box_json(s->min, s->max), "vertices", (json_int_t)t->vertices, "faces",
        (json_int_t)t->faces, "triangles", (json_int_t)(t->corners - 2 * t->faces), "normals",
        (int)s->has_normals, "texture_coordinates", (int)s->has_texcoords, "vertex_colors",
        (int)s->has_colors, "faces_without_material", (json_int_t)s->bare_faces);
}

static int describe_mesh(struct bsq_ctx *ctx, const char *path, json_t **out)
{
    struct survey s = {.ctx = ctx,
                       .min = {INFINITY, INFINITY, INFINITY},
                       .max = {-INFINITY, -INFINITY, -INFINITY}};
    const struct fmt_mesh_inputs inputs = {.paths = &path, .path_count = 1, .pipes = true};
    struct fmt_mesh_reader *reader = NULL;
    struct fmt_mesh_totals totals = {0};
    struct fmt_materials found = {0};
    int status;
    BSQ_TRY(fmt_mesh_open_inputs(ctx, &inputs, &reader));
    fmt_mesh_use_objects(reader);
    bsq_progress_begin(ctx, "reading", "bytes", fmt_mesh_bytes(reader));
    status = fmt_mesh_read(reader, survey_batch, &s, &totals);
    bsq_progress_end(ctx);
    BSQ_TRY(status);
    if (totals.faces == 0)
        BSQ_TRY(fmt_mesh_fail_no_faces(ctx, path, &totals));
    BSQ_TRY(fmt_mesh_read_materials(reader, &found));
    *out = mesh_json(&s, reader, &totals);
    describe_materials(&s, &found, out);
done:
    fmt_materials_free(ctx, &found);
    fmt_mesh_close(reader);
    bsq_free(ctx, s.faces);
    return status;
}

/* ---- chunk files and grids ---- */

/* Returns the textures that materials name, each once. */
static json_t *textures_json(const struct fmt_tris_header *h)
{
    json_t *list = json_array();
    for (uint32_t m = 0; m < h->material_count; m++) {
        if (h->materials[m].texture_path)
            add_once(&list, h->materials[m].texture_path);
        for (uint32_t c = 0; c < h->channel_count; c++)
            if (h->materials[m].sources[c].texture_path)
                add_once(&list, h->materials[m].sources[c].texture_path);
    }
    return list;
}

/* Returns how viewers should use the opacity of a chunk file's materials: "blend", "mask" if it is
 * 0 or 1 everywhere, or NULL if all are opaque. */
static const char *alpha_text(const struct fmt_tris_header *h)
{
    bool masks = false, blends = false;
    for (uint64_t i = 0; i < (uint64_t)h->material_count * h->channel_count; i++) {
        const struct fmt_tris_source *s =
            &h->materials[i / h->channel_count].sources[i % h->channel_count];
        if (strcmp(h->channels[i % h->channel_count], "opacity") != 0)
            continue;
        const bool mask = s->texture_path ? s->component == FMT_CHANNEL_CUTOUT : s->value[0] <= 0;
        masks |= mask;
        blends |= !mask && (s->texture_path || s->value[0] < 1);
    }
    return blends ? "blend" : masks ? "mask" : NULL;
}

/* Returns whether a material of a chunk file gives light. */
static bool emits(const struct fmt_tris_header *h)
{
    bool any = false;
    for (uint64_t i = 0; i < (uint64_t)h->material_count * h->channel_count; i++)
        for (int k = 0; k < 3 && strcmp(h->channels[i % h->channel_count], "emission") == 0; k++)
            any |= h->materials[i / h->channel_count].sources[i % h->channel_count].value[k] > 0;
    return any;
}

static int describe_tris(struct bsq_ctx *ctx, const char *path, json_t **out)
{
    struct fmt_tris_file *file;
    double min[3], max[3];
    BSQ_PASS(fmt_tris_open(ctx, path, &file));
    const struct fmt_tris_header *h = fmt_tris_get_header(file);
    json_t *channels = json_array();
    for (int axis = 0; axis < 3; axis++) {
        min[axis] = h->origin[axis] + (double)h->bounds_min[axis];
        max[axis] = h->origin[axis] + (double)h->bounds_max[axis];
    }
    for (uint32_t c = 0; c < h->channel_count; c++)
        add_once(&channels, h->channels[c]);
    *out = json_pack(
        "{s:s, s:I, s:o, s:I, s:I, s:I, s:b, s:s?, s:b, s:b, s:b, s:b, s:s?, s:I, s:o, s:s?, s:b, s:o}",
        "format", "chunk file", "version", (json_int_t)FMT_TRIS_VERSION, "box", box_json(min, max),
        "triangles", (json_int_t)h->triangle_count, "chunks", (json_int_t)h->chunk_count,
        "source_faces", (json_int_t)h->source_faces, "normals",
        (int)!!(h->attributes & FMT_TRIS_NORMALS), "made_normals",
        fmt_tris_normals_text(h->made_normals), "texture_coordinates",
        (int)!!(h->attributes & FMT_TRIS_TEXCOORDS), "vertex_colors",
        (int)!!(h->attributes & FMT_TRIS_COLORS), "fine_colors",
        (int)!!(h->attributes & FMT_TRIS_FINE_COLORS), "color", (int)fmt_tris_has_color(h), "ids",
        h->ids == FMT_IDS_NONE ? NULL : fmt_ids_text(h->ids), "materials",
        (json_int_t)h->material_count, "channels", channels, "alpha", alpha_text(h), "emits",
        (int)emits(h), "textures", textures_json(h));
    fmt_tris_close(file);
    return 0;
}

static int describe_grid(struct bsq_ctx *ctx, const char *path, json_t **out)
{
    struct fmt_nvdb_grid grid;
    char **names = NULL;
    uint32_t count = 0;
    int status = 0;
    BSQ_PASS(fmt_nvdb_open(ctx, path, &grid));
    json_t *channels = json_array();
    if (grid.channel_list)
        status =
            fmt_channel_list_split(ctx, grid.channel_list, grid.channel_list_bytes, &names, &count);
    for (uint32_t c = 0; c < count; c++)
        add_once(&channels, names[c]);
    *out = json_pack(
        "{s:s, s:I, s:I, s:o, s:f, s:[i, i, i], s:[i, i, i], s:I, s:I, s:b, s:s?, s:o}", "format",
        "grid (NanoVDB)", "version", (json_int_t)fmt_nvdb_trailer_version(&grid), "bytes",
        (json_int_t)grid.map.size, "box", box_json(grid.info.scan_min, grid.info.scan_max),
        "voxel_size", grid.info.voxel_size, "index_min", grid.index_min[0], grid.index_min[1],
        grid.index_min[2], "index_max", grid.index_max[0], grid.index_max[1], grid.index_max[2],
        "voxels", (json_int_t)grid.voxel_count, "source_triangles",
        (json_int_t)grid.info.source_triangles, "color", (int)grid.info.has_color, "ids",
        grid.info.ids == FMT_IDS_NONE ? NULL : fmt_ids_text(grid.info.ids), "channels", channels);
    bsq_free(ctx, names);
    fmt_nvdb_close(ctx, &grid);
    return status;
}

/* Sets *out to a description of a file, for the caller to free with json_decref(), also after a
 * failure. Reads meshes whole, and of other files only what is needed. Errors: those of reading. */
static int describe_file(struct bsq_ctx *ctx, const char *path, json_t **out)
{
    enum fmt_kind kind;
    int status;
    *out = NULL;
    BSQ_PASS(fmt_recognise(ctx, path, &kind));
    if (kind == FMT_KIND_VDB)
        return bsq_fail(ctx, BSQ_EDATA, "%s: an OpenVDB file, which Bisque does not read", path);
    status = kind == FMT_KIND_TRIS   ? describe_tris(ctx, path, out)
             : kind == FMT_KIND_NVDB ? describe_grid(ctx, path, out)
                                     : describe_mesh(ctx, path, out);
    cli_json_set(out, "path", cli_json_text(path));
    if (status == 0 && !*out)
        status = bsq_fail(ctx, BSQ_ENOMEM, "%s: no memory to describe it", path);
    return status;
}

/* ---- printing ---- */

/* Names of a list that are printed; --json has all. */
enum { MOST_NAMES = 20 };

static void print_value(const json_t *value);

static void print_list(const json_t *list)
{
    const size_t count = json_array_size(list);
    for (size_t i = 0; i < count && i < MOST_NAMES; i++) {
        cli_print("%s", i > 0 ? ", " : "");
        print_value(json_array_get(list, i));
    }
    if (count > MOST_NAMES)
        cli_print(" and %zu more", count - MOST_NAMES);
}

/* Prints the members of an object. */
static void print_members(const json_t *object)
{
    const char *key, *comma = "";
    json_t *member;
    json_object_foreach((json_t *)(uintptr_t)object, key, member)
    {
        cli_print("%s%s ", comma, key);
        print_value(member);
        comma = ", ";
    }
}

static void print_value(const json_t *value)
{
    if (json_is_array(value)) {
        print_list(value);
    } else if (json_is_string(value)) {
        cli_print("%s", json_string_value(value));
    } else if (json_is_integer(value)) {
        cli_print("%s", cli_count((uint64_t)json_integer_value(value)).text);
    } else if (json_is_real(value)) {
        cli_print("%.7g", json_real_value(value));
    } else if (json_is_boolean(value)) {
        cli_print("%s", json_is_true(value) ? "yes" : "no");
    } else if (json_is_object(value)) {
        cli_print("(");
        print_members(value);
        cli_print(")");
    }
}

/* Prints a member as a line; a list of objects has a line for each. */
static void print_member(const char *key, const json_t *value)
{
    const size_t count = json_array_size(value);
    if (json_is_null(value) || (json_is_array(value) && count == 0))
        return;
    cli_print("  ");
    for (const char *c = key; *c; c++)
        cli_print("%c", *c == '_' ? ' ' : *c);
    if (json_is_object(json_array_get(value, 0))) {
        cli_print(":\n");
        for (size_t i = 0; i < count && i < MOST_NAMES; i++) {
            cli_print("    ");
            print_members(json_array_get(value, i));
            cli_print("\n");
        }
        if (count > MOST_NAMES)
            cli_print("    and %zu more\n", count - MOST_NAMES);
        return;
    }
    cli_print(": ");
    if (json_is_object(value))
        print_members(value);
    else
        print_value(value);
    cli_print("\n");
}

int voxelize_info_print(struct cli *cli, const char *const *paths, uint32_t count)
{
    json_t *list = json_array();
    int status = 0;
    for (uint32_t i = 0; i < count && status == 0; i++) {
        const char *key;
        json_t *info, *member;
        status = describe_file(cli->ctx, paths[i], &info);
        cli_clear_bar(cli);
        if (status == 0 && !cli->json) {
            cli_print("%s\n", paths[i]);
            json_object_foreach(info, key, member) if (strcmp(key, "path") != 0)
                print_member(key, member);
        }
        cli_json_append(&list, info);
    }
    if (status == 0 && cli->json)
        return cli_print_json(cli, json_pack("{s:o}", "files", list));
    json_decref(list);
    return status;
}
