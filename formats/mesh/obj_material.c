/* obj_material.c - the names of materials and of material libraries that OBJ files mention.
 *
 * A name belongs to the file that contains it. Scans are often delivered as tiles, each with its
 * own library, and different libraries may have a material of the same name. */
#include <inttypes.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>

#include "base/context.h"
#include "formats/mesh/mesh_text.h"
#include "formats/mesh/obj_internal.h"

int fmt_obj_statement_text(const struct stream_slot *slot, const struct stream_statement *statement,
                           char **out)
{
    const char *from = (const char *)slot->bytes + statement->offset, *end = from + statement->size;
    char *to;
    BSQ_PASS(bsq_alloc(slot->ctx, "names", statement->size + 1, 1, out));
    for (to = *out; from < end; from++) {
        if (*from == '\\' && from + 1 < end && (from[1] == '\n' || from[1] == '\r'))
            from += 1 + (from[1] == '\r' && from[2] == '\n'); /* a blank came before it */
        else
            *to++ = *from;
    }
    while (to > *out && fmt_mesh_is_blank(to[-1]))
        to--;
    *to = '\0';
    return 0;
}

/* ---- libraries ---- */

/* Enters the library at `path`, unless it is known. */
static int add_library(struct stream_source *source, uint64_t line, const char *path)
{
    struct obj_file *file = source->data;
    const uint64_t known = file->libraries.count;
    uint64_t number;
    BSQ_PASS(bsq_note_input(source->ctx, path, "the material library that %s names", source->path));
    BSQ_PASS(FMT_RESERVE(source->ctx, known + 1, file->library_lines, file->line_capacity));
    BSQ_PASS(bsq_texts_add(source->ctx, &source->reader->names, &file->libraries, path, &number));
    if (file->libraries.count > known)
        file->library_lines[known] = line;
    return 0;
}

/* Enters one library; if `only_existing` is set, only if the file exists. Sets *exists if so. */
static int enter_library(struct stream_source *source, uint64_t line, const char *name,
                         bool only_existing, bool *exists)
{
    bool found;
    char *path = NULL;
    int status = fmt_path_find(source->ctx, fmt_input_beside(source->input), name, &path, &found);
    *exists |= !status && found;
    if (!status && (found || !only_existing))
        status = add_library(source, line, path);
    bsq_free(source->ctx, path);
    return status;
}

/* The standard allows several names. One name with blanks is as common in practice, so the whole
 * text is tried first; and if no library exists, a message shows the whole text. */
int fmt_obj_enter_libraries(struct stream_source *source, uint64_t line, const char *text)
{
    bool exists = false;
    char *names = NULL, *rest;
    int status;
    if (!*text || !strcmp(text, "#") || !strncmp(text, "# ", 2))
        return 0;
    BSQ_TRY(enter_library(source, line, text, true, &exists));
    if (exists)
        return 0;
    /* First the names of libraries that exist, and then also of others, if any does. */
    for (int pass = 0; pass < 1 + exists; pass++) {
        bsq_free(source->ctx, names);
        BSQ_TRY(bsq_text_copy(source->ctx, text, &names));
        fmt_mesh_unquote(names);
        for (char *name = strtok_r(names, " \t", &rest); name && *name != '#';
             name = strtok_r(NULL, " \t", &rest))
            BSQ_TRY(enter_library(source, line, name, pass == 0, &exists));
    }
    if (!exists)
        status = enter_library(source, line, text, false, &exists);
done:
    bsq_free(source->ctx, names);
    return status;
}

/* Reads a library of a file. Warnings were given if it was previewed. */
static int read_library(const struct stream_source *source, uint64_t library,
                        struct fmt_materials *out)
{
    const struct obj_file *file = source->data;
    char *place;
    BSQ_PASS(bsq_text_print(source->ctx, &place, "%s:%" PRIu64, source->path,
                            file->library_lines[library]));
    bsq_mute_warnings(source->ctx, library < file->previewed);
    const int status = fmt_mtl_read(source->ctx, file->libraries.list[library], place, out);
    bsq_mute_warnings(source->ctx, false);
    bsq_free(source->ctx, place);
    return status;
}

/* ---- materials of libraries ---- */

/* Moves what libraries say about materials to the entries of their names, unless faces do not use
 * them or an earlier library has said it. */
static void describe_all(const struct obj_file *file, struct fmt_materials *found,
                         struct fmt_materials *out)
{
    for (uint32_t i = 0; i < found->count; i++) {
        const uint64_t number = bsq_texts_find(&file->materials, found->list[i].name);
        if (number == file->materials.count || out->list[number].name)
            continue;
        out->list[number] = found->list[i];
        found->list[i] = (struct fmt_material){0};
    }
}

/* ---- materials without a description ---- */

/* Returns whether a file names a library that can be read and is not empty. */
static bool has_library(const struct obj_file *file)
{
    struct stat info;
    for (uint64_t i = 0; i < file->libraries.count; i++)
        if (stat(file->libraries.list[i], &info) == 0 && S_ISREG(info.st_mode) && info.st_size > 0)
            return true;
    return false;
}

static void add_colorless(struct stream_colorless *to, const struct stream_source *source,
                          uint64_t count, const char *name)
{
    if (to->count == 0) {
        to->source = source->number;
        to->name = name;
    }
    to->count += count;
}

/* Names the materials that no library describes, and counts them: lost ones, whose file has a
 * library that lacks them, and those of files that name no library. If a library is missing,
 * another warning has said so. Counts faces without a material too, if others have colours. */
static int name_others(struct stream_source *source, struct fmt_materials *out)
{
    struct fmt_mesh_reader *reader = source->reader;
    const struct obj_file *file = source->data;
    const bool readable = has_library(file);
    bool colored = false;
    for (uint32_t i = 0; i < out->count; i++) {
        const char *name = file->materials.list[i];
        colored |= out->list[i].color.has_value || out->list[i].color.texture_path;
        if (out->list[i].name)
            continue;
        if (readable || file->libraries.count == 0)
            add_colorless(readable ? &reader->lost : &reader->bare, source, 1, name);
        BSQ_PASS(bsq_text_copy(source->ctx, name, &out->list[i].name));
    }
    if (colored && file->plain_faces > 0)
        add_colorless(&reader->plain, source, file->plain_faces, NULL);
    return 0;
}

/* Returns the first texture in a list of materials, or NULL. */
static const char *find_texture(const struct fmt_materials *list)
{
    for (uint32_t i = 0; i < list->count; i++)
        if (list->list[i].color.texture_path)
            return list->list[i].color.texture_path;
    return NULL;
}

/* Warns if libraries have textures, but no face of the scan has a material. */
static int warn_of_unused_libraries(struct fmt_mesh_reader *reader)
{
    struct fmt_materials found = {0};
    int status = 0;
    for (uint32_t i = 0; i < reader->source_count && !find_texture(&found); i++) {
        const struct stream_source *source = &reader->sources[i];
        const struct obj_file *file = source->data;
        for (uint64_t k = 0; source->format == &fmt_obj_format && k < file->libraries.count; k++)
            BSQ_TRY(read_library(source, k, &found));
    }
    if (find_texture(&found))
        status = bsq_warn_loss(reader->ctx,
                               "%s: no face has a material, so textures such as %s are not used "
                               "(see --texture)",
                               reader->sources[0].path, find_texture(&found));
done:
    fmt_materials_free(reader->ctx, &found);
    return status;
}

int fmt_obj_finish_materials(struct fmt_mesh_reader *reader)
{
    const struct stream_colorless bare = reader->bare, lost = reader->lost, plain = reader->plain;
    const bool warns = reader->warns_of_materials, bare_vertices = !reader->has_colors;
    reader->bare = reader->lost = reader->plain = (struct stream_colorless){0};
    reader->warns_of_materials = false;
    if (!warns)
        return 0;
    if (reader->material_count == 0)
        return warn_of_unused_libraries(reader);
    if (bare.count > 0 && bare_vertices)
        BSQ_PASS(bsq_warn_loss(reader->ctx,
                               "%s: no material library is named; materials without a colour, such "
                               "as \"%.60s\": %" PRIu64 " (see --texture)",
                               reader->sources[bare.source].path, bare.name, bare.count));
    if (lost.count > 0)
        BSQ_PASS(bsq_warn_loss(reader->ctx,
                               "%s: no material library describes \"%.60s\"; materials without a "
                               "colour: %" PRIu64 " (see --texture)",
                               reader->sources[lost.source].path, lost.name, lost.count));
    if (plain.count > 0 && bare_vertices)
        return bsq_warn_loss(reader->ctx,
                             "%s: faces without a material: %" PRIu64
                             "; they have no colour (see --texture)",
                             reader->sources[plain.source].path, plain.count);
    return 0;
}

/* ---- lists of materials ---- */

/* Describes all materials of usemtl statements. */
int fmt_obj_read_materials(struct stream_source *source, struct fmt_materials *out)
{
    const struct obj_file *file = source->data;
    struct fmt_materials found = {0};
    struct fmt_material *added;
    int status = 0;
    if (file->materials.count == 0)
        return 0;
    for (uint64_t i = 0; i < file->materials.count; i++)
        BSQ_TRY(fmt_materials_add(source->ctx, out, &added));
    for (uint64_t i = 0; i < file->libraries.count; i++)
        BSQ_TRY(read_library(source, i, &found));
    describe_all(file, &found, out);
    BSQ_TRY(name_others(source, out));
    for (uint32_t i = 0; i < out->count; i++)
        fmt_mesh_tidy_name(out->list[i].name);
done:
    fmt_materials_free(source->ctx, &found);
    return status;
}

const char *fmt_obj_find_object(const struct stream_source *source, uint64_t number,
                                uint32_t *material)
{
    const char *object = ((struct obj_file *)source->data)->objects.list[number];
    *material = FMT_MESH_NO_MATERIAL;
    sscanf(object, "%8" SCNx32, material); /* OBJ_MATERIAL_DIGITS */
    return object + OBJ_MATERIAL_DIGITS;
}

/* ---- before the first reading ---- */

/* Enters the libraries that the first lines of a file name. */
static int find_libraries(struct stream_source *source)
{
    struct stream_slot slot = {.ctx = source->ctx, .source = source, .last_face = UINT64_MAX};
    char *text = NULL;
    uint64_t size = 0;
    int status;
    BSQ_TRY(fmt_stream_reserve(&slot, FMT_INPUT_SAMPLE_BYTES));
    BSQ_TRY(fmt_input_peek(source->input, slot.bytes, FMT_INPUT_SAMPLE_BYTES, &size));
    const bool cut = size == FMT_INPUT_SAMPLE_BYTES;
    while (cut && size > 0 && slot.bytes[size - 1] != '\n')
        size--;
    BSQ_TRY(fmt_obj_parse_text(&slot, 0, size, false));
    for (uint64_t i = 0; i < slot.statement_count; i++) {
        if (slot.statements[i].kind != OBJ_MTLLIB)
            continue;
        bsq_free(source->ctx, text);
        text = NULL;
        BSQ_TRY(fmt_obj_statement_text(&slot, &slot.statements[i], &text));
        BSQ_TRY(fmt_obj_enter_libraries(source, slot.statements[i].line + 1, text));
    }
done:
    bsq_free(source->ctx, text);
    fmt_stream_free_slot(&slot);
    return status;
}

/* Returns whether the preview has read a library for an earlier file of the scan. */
static bool was_previewed(const struct stream_source *source, const char *path)
{
    for (uint32_t i = 0; i < source->number; i++) {
        const struct stream_source *other = &source->reader->sources[i];
        const struct obj_file *file = other->data;
        if (other->format == &fmt_obj_format &&
            bsq_texts_find(&file->libraries, path) < file->libraries.count)
            return true;
    }
    return false;
}

/* Reads the libraries that are known so far, each once. */
int fmt_obj_preview_materials(struct stream_source *source, struct fmt_materials *out)
{
    struct obj_file *file = source->data;
    BSQ_PASS(find_libraries(source));
    for (uint64_t i = 0; i < file->libraries.count; i++) {
        BSQ_PASS(bsq_check(source->ctx));
        if (!was_previewed(source, file->libraries.list[i]))
            BSQ_PASS(read_library(source, i, out));
    }
    file->previewed = file->libraries.count;
    return 0;
}
