/* scene_reader.c - reads FBX, COLLADA and other files, which Assimp reads whole.
 *
 * Meant for low-poly meshes. Assimp runs in the program bisque-scene, because damaged files make it
 * crash, loop or take any amount of memory. Its meshes come back in a temporary file, as OBJ. */
#include <stdlib.h>
#include <string.h>

#include "base/file.h"
#include "formats/mesh/obj_internal.h"
#include "formats/mesh/obj_number.h"
#include "formats/mesh/scene_file.h"

/* Processor time in seconds that Assimp may take: LEAST_SECONDS for any file, and a second more for
 * each BYTES_A_SECOND of it. It usually reads a hundred times as many bytes in a second. */
enum { LEAST_SECONDS = 20, BYTES_A_SECOND = 1 << 18 };

/* What the reader keeps of a file: source->data. */
struct scene_file {
    struct obj_file obj; /* first: the OBJ reader finds it here */
    struct bsq_ctx *ctx;
    struct bsq_file output; /* of the program */
    struct fmt_scene_head head;
    struct bsq_source meshes; /* the OBJ text, which is the input after `begin` */
    uint64_t bytes;           /* of the file itself */
};

/* ---- opening ---- */

static bool recognise(const char *head, size_t size)
{
    static const char magic[] = "Kaydara FBX Binary";
    return size >= sizeof magic && memcmp(head, magic, sizeof magic - 1) == 0;
}

/* Returns the suffix that tells the format: the file's, without that of a packed file. */
static const char *find_suffix(char *path, const char *head, size_t size)
{
    path[fmt_mesh_unpacked_length(path)] = '\0';
    const char *point = strrchr(bsq_file_name(path), '.');
    return recognise(head, size) ? "fbx" : point ? point + 1 : "";
}

/* Reads the OBJ text; see struct bsq_source. */
static int read_meshes(void *user, void *to, uint64_t count, uint64_t offset)
{
    const struct scene_file *file = user;
    return bsq_file_read(file->ctx, &file->output, to, count,
                         sizeof file->head + file->head.material_bytes + offset);
}

/* Takes the program's output over. */
static int open_scene(struct stream_source *source, const char *program)
{
    struct scene_file *file = source->data;
    struct fmt_scene_head *head = &file->head;
    const uint64_t size = file->output.size;
    if (size >= sizeof *head)
        BSQ_PASS(bsq_file_read(source->ctx, &file->output, head, sizeof *head, 0));
    if (strncmp(head->stamp, fmt_program_stamp, sizeof head->stamp) != 0 ||
        head->material_bytes > size - sizeof *head)
        return bsq_fail(source->ctx, BSQ_ENOINPUT,
                        "%s: %s is not of this program's build, or does not work", source->path,
                        program);
    file->meshes = (struct bsq_source){.size = sizeof file->meshes,
                                       .bytes = size - sizeof *head - head->material_bytes,
                                       .read = read_meshes,
                                       .user = file};
    fmt_input_replace(source->input, &file->meshes);
    /* The program had the memory that is left. Now the largest amount is known. */
    BSQ_PASS(bsq_reserve(source->ctx, "reading a file by Assimp", head->memory_bytes));
    bsq_release(source->ctx, head->memory_bytes);
    return 0;
}

static int read_whole(struct stream_source *source, const struct bsq_file *file)
{
    struct bsq_ctx *ctx = source->ctx;
    struct scene_file *scene = source->data;
    struct fmt_converter how = {.program = "bisque-scene",
                                .purpose = "FBX, COLLADA and such files",
                                .library = "Assimp",
                                .path = source->path,
                                .seconds = LEAST_SECONDS + file->size / BYTES_A_SECOND};
    char head[64], program[PATH_MAX], *path = NULL;
    uint64_t got = 0;
    int status;
    scene->ctx = ctx;
    scene->bytes = file->size;
    BSQ_TRY(bsq_file_read_some(ctx, file, head, sizeof head, 0, &got));
    BSQ_TRY(bsq_text_copy(ctx, source->path, &path));
    BSQ_TRY(bsq_file_temp(ctx, NULL, "the meshes of a file", &scene->output));
    how.option = (char *)find_suffix(path, head, got);
    BSQ_TRY(fmt_program_convert(ctx, &how, file->fd, &scene->output, program));
    status = open_scene(source, program);
done:
    bsq_free(ctx, path);
    return status;
}

static void end(struct stream_source *source)
{
    bsq_file_close(source->ctx, &((struct scene_file *)source->data)->output);
    fmt_obj_format.end(source);
}

static int begin(struct stream_source *source)
{
    struct bsq_file file = BSQ_FILE_CLOSED;
    ((struct scene_file *)source->data)->output = (struct bsq_file)BSQ_FILE_CLOSED;
    BSQ_PASS(fmt_input_open(source->input));
    int status = fmt_input_whole(source->input, &file);
    if (!status)
        status = read_whole(source, &file);
    bsq_file_close(source->ctx, &file);
    const int closed = fmt_input_close(source->input);
    return status ? status : closed;
}

/* ---- reading, as OBJ ---- */

/* Forgets lines of the OBJ text, which the file does not have. */
static void forget_lines(struct stream_slot *slot)
{
    slot->at = 0;
    for (int i = 0; i < STREAM_ODDITY_COUNT; i++)
        slot->odd[i].at = 0;
}

static int parse(struct stream_slot *slot)
{
    const int status = fmt_obj_format.parse(slot);
    slot->color_white = 1;
    forget_lines(slot);
    return status;
}

static int pass(struct stream_slot *slot)
{
    const struct scene_file *file = slot->source->data;
    struct fmt_mesh_totals *totals = slot->source->reader->totals;
    const int status = fmt_obj_format.pass(slot);
    forget_lines(slot);
    slot->block.first_line = 0;
    totals->has_tangents |= file->head.has_tangents > 0;
    totals->split_vertices = true;
    if (!slot->source->reader->uses_colors)
        slot->odd[STREAM_NO_COLOR].count = 0;
    return status;
}

/* Warns of what is not read. Colours matter only if the caller uses them. */
static int finish(struct stream_source *source)
{
    const struct scene_file *file = source->data;
    const bool colors = source->reader->uses_colors;
    const struct stream_unread kinds[] = {
        {colors ? file->head.inner_textures : 0, true,
         "textures are inside of the file and are not read: save them and use --texture"},
        {colors ? file->head.turned_textures : 0, true,
         "textures are turned, or use further texture coordinates, which is not applied"},
        {colors ? file->head.hidden_colors : 0, true,
         "meshes have a texture, so their vertex colours are not used"},
        {colors ? file->head.clamped_colors : 0, true,
         "meshes have a diffuse colour out of range, which was clamped"},
    };
    source->reader->totals->bytes += file->bytes - file->meshes.bytes;
    return fmt_stream_warn_unread(source, kinds, sizeof kinds / sizeof *kinds);
}

/* ---- materials ---- */

/* Lists all materials. Their textures are looked for beside the file, as those of MTL files are. */
static int preview_materials(struct stream_source *source, struct fmt_materials *out)
{
    const struct scene_file *file = source->data;
    const uint64_t size = file->head.material_bytes;
    char *text = NULL;
    int status;
    BSQ_TRY(bsq_calloc(source->ctx, "materials", size + OBJ_TEXT_PADDING, 1, &text));
    BSQ_TRY(bsq_file_read(source->ctx, &file->output, text, size, sizeof file->head));
    BSQ_TRY(fmt_mtl_parse(source->ctx, fmt_input_beside(source->input), text, size, out));
    for (uint32_t i = 0; i < out->count; i++) {
        char **place = &out->list[i].color.texture_place;
        bsq_free(source->ctx, *place);
        *place = NULL;
        if (out->list[i].color.texture_path)
            BSQ_TRY(bsq_text_copy(source->ctx, source->path, place));
    }
done:
    bsq_free(source->ctx, text);
    return status;
}

/* Lists the materials that faces have. */
static int read_materials(struct stream_source *source, struct fmt_materials *out)
{
    const struct bsq_texts *numbers = &((struct scene_file *)source->data)->obj.materials;
    struct fmt_materials all = {0};
    struct fmt_material *material;
    int status;
    BSQ_TRY(preview_materials(source, &all));
    for (uint64_t i = 0; i < numbers->count; i++) {
        const unsigned long number = strtoul(numbers->list[i], NULL, 10);
        BSQ_TRY(fmt_materials_add(source->ctx, out, &material));
        if (number < all.count) {
            *material = all.list[number];
            all.list[number] = (struct fmt_material){0};
        }
    }
done:
    fmt_materials_free(source->ctx, &all);
    return status;
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
    .cut = fmt_obj_cut,
    .parse = parse,
    .pass = pass,
    .finish = finish,
    .estimate = fmt_obj_estimate,
    .read_materials = read_materials,
    .preview_materials = preview_materials,
    .find_object = fmt_obj_find_object,
};
