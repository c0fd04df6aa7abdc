/* obj_material.c - the names of materials and of material libraries that OBJ files mention.
 *
 * A name belongs to the file that contains it. Scans are often delivered as tiles, each with its
 * own library, and different libraries may have a material of the same name. */
#include <inttypes.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <xxhash.h>

#include "base/job_files.h"
#include "base/loss.h"
#include "formats/mesh/mtl.h"
#include "formats/mesh/mesh_text.h"
#include "formats/mesh/obj_internal.h"
#include "formats/mesh/obj_path.h"

/* Returns the slot that holds the name, or the empty slot for it. */
static uint32_t *find_slot(const struct obj_names *names, uint32_t source, const char *name)
{
    uint64_t i = XXH3_64bits_withSeed(name, strlen(name), source) & (names->slot_count - 1);
    for (;; i = (i + 1) & (names->slot_count - 1)) {
        uint32_t *slot = &names->slots[i];
        if (*slot == 0)
            return slot;
        const struct obj_name *entry = &names->list[*slot - 1];
        if (entry->source == source && !strcmp(entry->text, name))
            return slot;
    }
}

/* Keeps the table at most half full. */
static int make_slots(struct bsq_ctx *ctx, struct obj_names *names)
{
    if (names->slot_count > 2 * names->count)
        return 0;
    uint64_t slot_count = names->slot_count ? 4 * names->slot_count : 64;
    uint32_t *slots;
    int status = bsq_calloc(ctx, "names", slot_count, sizeof *slots, &slots);
    if (status)
        return status;
    bsq_free(ctx, names->slots);
    names->slots = slots;
    names->slot_count = slot_count;
    for (uint64_t i = 0; i < names->count; i++)
        *find_slot(names, names->list[i].source, names->list[i].text) = (uint32_t)(i + 1);
    return 0;
}

int fmt_obj_names_enter(struct bsq_ctx *ctx, struct obj_names *names, uint32_t source,
                        const char *name, uint32_t *number)
{
    int status = make_slots(ctx, names);
    if (status)
        return status;
    uint32_t *slot = find_slot(names, source, name);
    if (*slot == 0) {
        if (names->count == UINT32_MAX - 1)
            return bsq_fail(ctx, BSQ_EDATA, "more than %u materials", UINT32_MAX - 1);
        if (names->count == names->capacity &&
            (status = bsq_grow(ctx, "names", names->count + 1, sizeof *names->list, &names->list,
                               &names->capacity)))
            return status;
        struct obj_name *entry = &names->list[names->count];
        *entry = (struct obj_name){.source = source};
        if ((status = fmt_string_copy(ctx, name, &entry->text)))
            return status;
        *slot = (uint32_t)++names->count;
    }
    *number = *slot - 1;
    return 0;
}

void fmt_obj_names_free(struct bsq_ctx *ctx, struct obj_names *names)
{
    for (uint64_t i = 0; i < names->count; i++)
        bsq_free(ctx, names->list[i].text);
    bsq_free(ctx, names->list);
    bsq_free(ctx, names->slots);
    memset(names, 0, sizeof *names);
}

int fmt_obj_statement_text(struct bsq_ctx *ctx, const struct obj_block *block,
                           const struct obj_statement *statement, char **out)
{
    const char *from = block->text + statement->offset, *end = from + statement->size;
    char *to;
    int status = bsq_alloc(ctx, "names", statement->size + 1, 1, out);
    if (status)
        return status;
    for (to = *out; from < end; from++) {
        if (*from == '\\' && from + 1 < end && (from[1] == '\n' || from[1] == '\r'))
            from += 1 + (from[1] == '\r' && from[2] == '\n'); /* a blank came before it */
        else
            *to++ = *from;
    }
    while (to > *out && (to[-1] == ' ' || to[-1] == '\t'))
        to--;
    *to = '\0';
    return 0;
}

/* A mtllib statement. */
struct statement {
    uint32_t source;
    uint64_t line; /* from 1 */
};

/* Enters one library and sets *exists. If the file does not exist and `only_existing` is set,
 * enters nothing. */
static int enter_library(struct obj_reader *reader, const struct statement *at, const char *name,
                         bool only_existing, bool *exists)
{
    const struct obj_source *source = &reader->sources[at->source];
    char *path = NULL;
    uint32_t number = 0;
    int status =
        fmt_path_find(reader->base.ctx, fmt_input_beside(source->input), name, &path, exists);
    const bool enters = !status && (*exists || !only_existing);
    if (enters)
        status = bsq_note_input(reader->base.ctx, path, "the material library that %s names",
                                source->path);
    if (enters && !status)
        status =
            fmt_obj_names_enter(reader->base.ctx, &reader->libraries, at->source, path, &number);
    if (enters && !status && reader->libraries.list[number].line == 0)
        reader->libraries.list[number].line = at->line;
    bsq_free(reader->base.ctx, path);
    return status;
}

/* Returns whether a word of `names` is a library that exists. Changes `names`. */
static int any_library(struct obj_reader *reader, uint32_t source, char *names, bool *exists)
{
    char *rest, *path = NULL;
    int status = 0;
    *exists = false;
    for (char *name = strtok_r(names, " \t", &rest); name && !status && !*exists;
         name = strtok_r(NULL, " \t", &rest)) {
        status = fmt_path_find(reader->base.ctx, fmt_input_beside(reader->sources[source].input),
                               name, &path, exists);
        bsq_free(reader->base.ctx, path);
    }
    return status;
}

/* The standard allows several names. One name with blanks is as common in practice, so the whole
 * text is tried first; and if no library exists, a message shows the whole text. */
int fmt_obj_enter_libraries(struct obj_reader *reader, uint32_t source, uint64_t line,
                            const char *text)
{
    const struct statement at = {.source = source, .line = line};
    bool exists, any = false;
    if (!*text || !strcmp(text, "#") || !strncmp(text, "# ", 2))
        return 0;
    int status = enter_library(reader, &at, text, true, &exists);
    if (status || exists)
        return status;
    char *names, *rest, *name;
    if ((status = fmt_string_copy(reader->base.ctx, text, &names)))
        return status;
    status = any_library(reader, source, names, &any);
    if (!status && !any)
        status = enter_library(reader, &at, text, false, &exists);
    strcpy(names, text);
    fmt_mesh_plain_name(names);
    for (name = any ? strtok_r(names, " \t", &rest) : NULL; name && !status;
         name = strtok_r(NULL, " \t", &rest))
        status = enter_library(reader, &at, name, false, &exists);
    bsq_free(reader->base.ctx, names);
    return status;
}

const char *fmt_obj_dependency(const struct fmt_mesh_reader *base, uint32_t index)
{
    const struct obj_reader *reader = (const struct obj_reader *)base;
    return index < reader->libraries.count ? reader->libraries.list[index].text : NULL;
}

/* Moves what a library says about a material to the entry of its name, unless faces do not use it
 * or an earlier library has said it. Returns the entry that has it now, or `from`. */
static const struct fmt_material *describe(struct obj_reader *reader, uint32_t source,
                                           struct fmt_material *from, struct fmt_materials *out)
{
    const uint32_t number = *find_slot(&reader->materials, source, from->name);
    if (number == 0 || out->list[number - 1].name)
        return from;
    out->list[number - 1] = *from;
    from->name = from->texture_path = from->texture_place = NULL;
    from->channels = NULL;
    from->channel_count = 0;
    return &out->list[number - 1];
}

/* Forms of a name: without what is a comment for sure, then without what may be one. */
enum loose_form { LOOSE_TIDY, LOOSE_PLAIN, LOOSE_FORMS };

/* The names of a library's materials in a form, as describe_loosely() compares them; `from` has the
 * material of each. */
struct loose_names {
    struct obj_names names;
    const struct fmt_material **from;
};

/* Copies a name without quotes, comment and capitals. */
static int copy_loosely(struct bsq_ctx *ctx, const char *name, enum loose_form form, char **out)
{
    int status = fmt_string_copy(ctx, name, out);
    if (status)
        return status;
    if (form == LOOSE_TIDY)
        fmt_mesh_tidy_name(*out);
    else
        fmt_mesh_plain_name(*out);
    for (char *c = *out; *c; c++)
        *c = *c >= 'A' && *c <= 'Z' ? (char)(*c + 'a' - 'A') : *c;
    return 0;
}

/* Enters the loose forms of a material's name, unless they are there. */
static int enter_loosely(struct bsq_ctx *ctx, struct loose_names loose[LOOSE_FORMS],
                         const struct fmt_material *from)
{
    int status = 0;
    for (enum loose_form form = LOOSE_TIDY; form < LOOSE_FORMS && !status; form++) {
        struct loose_names *names = &loose[form];
        char *copy = NULL;
        uint32_t number = 0;
        const uint64_t before = names->names.count;
        status = copy_loosely(ctx, from->name, form, &copy);
        if (!status)
            status = fmt_obj_names_enter(ctx, &names->names, 0, copy, &number);
        if (!status && names->names.count > before)
            names->from[number] = from;
        bsq_free(ctx, copy);
    }
    return status;
}

/* Sets *from to the material with a loose form of the name, or to NULL. */
static int find_loosely(struct bsq_ctx *ctx, const struct loose_names loose[LOOSE_FORMS],
                        const char *name, const struct fmt_material **from)
{
    int status = 0;
    *from = NULL;
    for (enum loose_form form = LOOSE_TIDY; form < LOOSE_FORMS && !*from && !status; form++) {
        char *copy = NULL;
        status = copy_loosely(ctx, name, form, &copy);
        const uint32_t number = status ? 0 : *find_slot(&loose[form].names, 0, copy);
        *from = number > 0 ? loose[form].from[number - 1] : NULL;
        bsq_free(ctx, copy);
    }
    return status;
}

/* Describes the materials of one file that no library names exactly, but with quotes, a comment or
 * other capitals. */
static int describe_loosely(struct obj_reader *reader, uint32_t source,
                            const struct loose_names loose[LOOSE_FORMS], struct fmt_materials *out)
{
    struct bsq_ctx *ctx = reader->base.ctx;
    int status = 0;
    for (uint32_t i = 0; i < out->count && !status; i++) {
        const struct fmt_material *from;
        if (reader->materials.list[i].source != source || out->list[i].name)
            continue;
        status = find_loosely(ctx, loose, reader->materials.list[i].text, &from);
        if (!status && from)
            status = fmt_material_copy(ctx, from, from->name, &out->list[i]);
    }
    return status;
}

/* Describes the materials of one file by those of its own libraries. */
static int describe_all(struct obj_reader *reader, uint32_t source, struct fmt_materials *found,
                        struct fmt_materials *out)
{
    struct bsq_ctx *ctx = reader->base.ctx;
    struct loose_names loose[LOOSE_FORMS] = {0};
    int status = 0;
    for (int form = 0; form < LOOSE_FORMS && !status; form++)
        status = bsq_alloc(ctx, "materials", (uint64_t)found->count + 1, sizeof(void *),
                           &loose[form].from);
    for (uint32_t i = 0; i < found->count && !status; i++) {
        status = i % 1024 == 0 ? bsq_check(ctx) : 0;
        const struct fmt_material *from = describe(reader, source, &found->list[i], out);
        if (!status)
            status = enter_loosely(ctx, loose, from);
    }
    if (!status && found->count > 0)
        status = describe_loosely(reader, source, loose, out);
    for (int form = 0; form < LOOSE_FORMS; form++) {
        fmt_obj_names_free(ctx, &loose[form].names);
        bsq_free(ctx, loose[form].from);
    }
    return status;
}

/* Reads a library. again: it was read before, so there are no warnings. */
static int read_library(const struct obj_reader *reader, const struct obj_name *library, bool again,
                        struct fmt_materials *out)
{
    struct bsq_ctx *ctx = reader->base.ctx;
    const char *path = reader->sources[library->source].path;
    const size_t size = strlen(path) + 24;
    char *place;
    int status = bsq_alloc(ctx, "names", size, 1, &place);
    if (status)
        return status;
    snprintf(place, size, "%s:%" PRIu64, path, library->line);
    status = fmt_mtl_read(ctx, library->text, place, again, out);
    bsq_free(ctx, place);
    return status;
}

/* Describes the materials of one file from its own libraries. */
static int read_materials_of(struct obj_reader *reader, uint32_t source, struct fmt_materials *out)
{
    struct bsq_ctx *ctx = reader->base.ctx;
    struct fmt_materials found = {0};
    int status = 0;
    for (uint64_t i = 0; i < reader->libraries.count && !status; i++)
        if (reader->libraries.list[i].source == source)
            status =
                read_library(reader, &reader->libraries.list[i], i < reader->previewed, &found);
    if (!status)
        status = describe_all(reader, source, &found, out);
    fmt_materials_free(ctx, &found);
    return status;
}

/* Returns whether a file of the scan names a library that can be read and is not empty. */
static bool has_library(const struct obj_reader *reader, uint32_t source)
{
    struct stat info;
    for (uint64_t i = 0; i < reader->libraries.count; i++)
        if (reader->libraries.list[i].source == source &&
            stat(reader->libraries.list[i].text, &info) == 0 && S_ISREG(info.st_mode) &&
            info.st_size > 0)
            return true;
    return false;
}

/* Returns whether a file of the scan names a library. */
static bool names_library(const struct obj_reader *reader, uint32_t source)
{
    for (uint64_t i = 0; i < reader->libraries.count; i++)
        if (reader->libraries.list[i].source == source)
            return true;
    return false;
}

/* Materials that no library describes. */
struct others {
    uint32_t count;
    const struct obj_name *first;
};

static void add_other(struct others *others, const struct obj_name *name)
{
    others->first = others->count++ ? others->first : name;
}

/* Warns of materials without a description: lost ones, whose file has a library that lacks them,
 * and those of files that name no library, unless vertices have colours. */
static int warn_of_others(const struct obj_reader *reader, const struct others *lost,
                          const struct others *bare)
{
    const struct obj_source *sources = reader->sources;
    int status = 0;
    if (bare->count > 0 && !reader->has_colors)
        status = bsq_warn_loss(reader->base.ctx,
                               "%s: no material library is named; materials without a colour, such "
                               "as \"%.60s\": %u (see --texture)",
                               sources[bare->first->source].path, bare->first->text, bare->count);
    if (status == 0 && lost->count > 0)
        status = bsq_warn_loss(reader->base.ctx,
                               "%s: no material library describes \"%.60s\"; materials without a "
                               "colour: %u (see --texture)",
                               sources[lost->first->source].path, lost->first->text, lost->count);
    return status;
}

/* Warns of faces without a material in files whose materials have colours or textures, unless
 * vertices have colours. */
static int warn_of_plain_faces(const struct obj_reader *reader, const struct fmt_materials *found)
{
    uint64_t count = 0;
    uint32_t counted = UINT32_MAX, first = 0; /* files */
    for (uint32_t i = 0; i < found->count && !reader->has_colors; i++) {
        const struct fmt_material *material = &found->list[i];
        const uint32_t source = reader->materials.list[i].source;
        if (source == counted || !(material->has_diffuse || material->texture_path))
            continue;
        counted = source;
        first = count > 0 ? first : source;
        count += reader->sources[source].plain_faces;
    }
    return count == 0 ? 0
                      : bsq_warn_loss(reader->base.ctx,
                                      "%s: faces without a material: %" PRIu64
                                      "; they have no colour (see --texture)",
                                      reader->sources[first].path, count);
}

/* Names the materials that no library describes, and warns of them. If a library is missing,
 * another warning has said so. */
static int name_others(struct obj_reader *reader, struct fmt_materials *out)
{
    struct others lost = {0}, bare = {0};
    uint32_t source = UINT32_MAX;
    bool readable = false, named = false;
    int status = 0;
    for (uint32_t i = 0; i < out->count && !status; i++) {
        const struct obj_name *name = &reader->materials.list[i];
        if (out->list[i].name)
            continue;
        if (name->source != source) {
            readable = has_library(reader, name->source);
            named = names_library(reader, name->source);
        }
        source = name->source;
        if (readable)
            add_other(&lost, name);
        else if (!named)
            add_other(&bare, name);
        status = fmt_string_copy(reader->base.ctx, name->text, &out->list[i].name);
    }
    if (!status && reader->warns)
        status = warn_of_others(reader, &lost, &bare);
    if (!status && reader->warns)
        status = warn_of_plain_faces(reader, out);
    reader->warns = false;
    return status;
}

/* Warns if libraries have textures, but faces have no materials. */
static int warn_of_unused_libraries(struct obj_reader *reader)
{
    struct bsq_ctx *ctx = reader->base.ctx;
    struct fmt_materials found = {0};
    const char *texture = NULL;
    int status = 0;
    for (uint64_t i = 0; i < reader->libraries.count && !status && !texture; i++) {
        status = read_library(reader, &reader->libraries.list[i], i < reader->previewed, &found);
        for (uint32_t k = 0; k < found.count && !texture; k++)
            texture = found.list[k].texture_path;
    }
    if (!status && texture && reader->warns)
        status = bsq_warn_loss(ctx,
                               "%s: no face has a material, so textures such as %s are not used "
                               "(see --texture)",
                               reader->sources[0].path, texture);
    reader->warns = false;
    fmt_materials_free(ctx, &found);
    return status;
}

/* Describes all materials of usemtl statements. */
static int read_materials(struct obj_reader *reader, struct fmt_materials *out)
{
    uint64_t count = reader->materials.count;
    if (count == 0)
        return warn_of_unused_libraries(reader);
    int status = bsq_calloc(reader->base.ctx, "materials", count, sizeof *out->list, &out->list);
    if (status)
        return status;
    out->count = (uint32_t)count;
    for (uint64_t i = 0; i < count; i++)
        for (int c = 0; c < 3; c++)
            out->list[i].diffuse[c] = 0.8f;
    for (uint32_t source = 0; source < reader->source_count && !status; source++)
        status = read_materials_of(reader, source, out);
    if (!status)
        status = name_others(reader, out);
    for (uint64_t i = 0; i < count && !status; i++)
        fmt_mesh_tidy_name(out->list[i].name);
    if (status)
        fmt_materials_free(reader->base.ctx, out);
    return status;
}

/* Enters the libraries that the first lines of a file name. */
static int find_libraries(struct obj_reader *reader, uint32_t source)
{
    struct bsq_ctx *ctx = reader->base.ctx;
    struct obj_block block = {0};
    uint64_t size = 0;
    int status = fmt_obj_block_reserve_text(ctx, &block, FMT_INPUT_SAMPLE_BYTES);
    if (!status)
        status = fmt_input_peek(reader->sources[source].input, block.buffer, FMT_INPUT_SAMPLE_BYTES,
                                &size);
    const bool cut = size == FMT_INPUT_SAMPLE_BYTES;
    while (cut && size > 0 && block.buffer[size - 1] != '\n')
        size--;
    if (!status) {
        fmt_obj_block_set_text(&block, 0, size);
        status = fmt_obj_block_parse(ctx, &block, true, UINT64_MAX);
    }
    for (uint64_t i = 0; i < block.statement_count && !status; i++) {
        char *text;
        if (block.statements[i].kind != OBJ_MTLLIB)
            continue;
        if ((status = fmt_obj_statement_text(ctx, &block, &block.statements[i], &text)))
            break;
        status = fmt_obj_enter_libraries(reader, source, block.statements[i].line + 1, text);
        bsq_free(ctx, text);
    }
    fmt_obj_block_free(ctx, &block);
    return status;
}

/* Reads the libraries that are known so far, each once. */
static int preview_libraries(struct obj_reader *reader, struct fmt_materials *out)
{
    struct bsq_ctx *ctx = reader->base.ctx;
    struct obj_names paths = {0};
    int status = 0;
    for (uint64_t i = 0; i < reader->libraries.count && !status; i++) {
        const struct obj_name *library = &reader->libraries.list[i];
        const uint64_t known = paths.count;
        uint32_t number;
        status = bsq_check(ctx);
        if (!status)
            status = fmt_obj_names_enter(ctx, &paths, 0, library->text, &number);
        if (!status && paths.count > known)
            status = read_library(reader, library, false, out);
    }
    fmt_obj_names_free(ctx, &paths);
    return status;
}

int fmt_obj_preview_materials(struct fmt_mesh_reader *base, struct fmt_materials *out)
{
    struct obj_reader *reader = (struct obj_reader *)base;
    int status = 0;
    for (uint32_t source = 0; source < reader->source_count && !status; source++)
        status = find_libraries(reader, source);
    if (!status)
        status = preview_libraries(reader, out);
    reader->warns = true;
    reader->previewed = reader->libraries.count;
    if (status)
        fmt_materials_free(base->ctx, out);
    return status;
}

/* Describes the material and the object of a part. */
static int describe_part(struct bsq_ctx *ctx, const struct obj_name *part,
                         const struct fmt_materials *materials, struct fmt_material *out)
{
    static const struct fmt_material none = {.name = "", .diffuse = {0.8f, 0.8f, 0.8f}};
    const struct fmt_material *from =
        part->source < materials->count ? &materials->list[part->source] : &none;
    int status = fmt_material_copy(ctx, from, from->name, out);
    return status ? status : fmt_string_copy(ctx, part->text, &out->object);
}

static int read_parts(struct obj_reader *reader, struct fmt_materials *out)
{
    struct bsq_ctx *ctx = reader->base.ctx;
    struct fmt_materials materials = {0};
    const uint64_t count = reader->parts.count;
    int status = read_materials(reader, &materials);
    if (!status && count > 0)
        status = bsq_calloc(ctx, "materials", count, sizeof *out->list, &out->list);
    if (!status)
        out->count = (uint32_t)count;
    for (uint32_t i = 0; i < out->count && !status; i++) {
        status = i % 1024 == 0 ? bsq_check(ctx) : 0;
        if (!status)
            status = describe_part(ctx, &reader->parts.list[i], &materials, &out->list[i]);
    }
    fmt_materials_free(ctx, &materials);
    if (status)
        fmt_materials_free(ctx, out);
    return status;
}

int fmt_obj_read_materials(struct fmt_mesh_reader *base, struct fmt_materials *out)
{
    struct obj_reader *reader = (struct obj_reader *)base;
    return base->objects ? read_parts(reader, out) : read_materials(reader, out);
}
