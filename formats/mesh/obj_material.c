/* obj_material.c - the names of materials and of material libraries that OBJ files mention.
 *
 * A name belongs to the file that contains it. Scans are often delivered as tiles, each with its
 * own library, and different libraries may have a material of the same name. */
#include <string.h>
#include <xxhash.h>

#include "base/job_files.h"
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
        entry->source = source;
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
        if (*from == '\\' && (from[1] == '\n' || from[1] == '\r')) {
            from += 1 + (from[1] == '\r' && from[2] == '\n');
            *to++ = ' ';
        } else {
            *to++ = *from;
        }
    }
    while (to > *out && (to[-1] == ' ' || to[-1] == '\t'))
        to--;
    *to = '\0';
    return 0;
}

/* Enters one library and sets *exists. If the file does not exist and `only_existing` is set,
 * enters nothing. */
static int enter_library(struct obj_reader *reader, uint32_t source, const char *name,
                         bool only_existing, bool *exists)
{
    char *path = NULL;
    uint32_t number;
    int status = fmt_path_find(reader->base.ctx, reader->sources[source].path, name, &path, exists);
    if (!status && (*exists || !only_existing))
        status = bsq_note_input(reader->base.ctx, path, "the material library that %s names",
                                reader->sources[source].path);
    if (!status && (*exists || !only_existing))
        status = fmt_obj_names_enter(reader->base.ctx, &reader->libraries, source, path, &number);
    bsq_free(reader->base.ctx, path);
    return status;
}

/* The standard allows several names. One name with blanks is as common in practice, so the whole
 * text is tried first. */
int fmt_obj_enter_libraries(struct obj_reader *reader, uint32_t source, const char *text)
{
    bool exists;
    if (!*text)
        return 0;
    int status = enter_library(reader, source, text, true, &exists);
    if (status || exists)
        return status;
    char *names, *rest, *name;
    if ((status = fmt_string_copy(reader->base.ctx, text, &names)))
        return status;
    for (name = strtok_r(names, " \t", &rest); name && !status; name = strtok_r(NULL, " \t", &rest))
        status = enter_library(reader, source, name, false, &exists);
    bsq_free(reader->base.ctx, names);
    return status;
}

const char *fmt_obj_dependency(const struct fmt_mesh_reader *base, uint32_t index)
{
    const struct obj_reader *reader = (const struct obj_reader *)base;
    return index < reader->libraries.count ? reader->libraries.list[index].text : NULL;
}

/* Moves what a library says about a material to the entry of its name, unless faces do not use it
 * or an earlier library has said it. */
static void describe(struct obj_reader *reader, uint32_t source, struct fmt_material *from,
                     struct fmt_materials *out)
{
    const uint32_t number = *find_slot(&reader->materials, source, from->name);
    if (number == 0 || out->list[number - 1].name)
        return;
    out->list[number - 1] = *from;
    from->name = from->texture_path = NULL;
}

/* Describes the materials of one file from its own libraries. */
static int read_materials_of(struct obj_reader *reader, uint32_t source, struct fmt_materials *out)
{
    struct bsq_ctx *ctx = reader->base.ctx;
    struct fmt_materials found = {0};
    int status = 0;
    for (uint64_t i = 0; i < reader->libraries.count && !status; i++)
        if (reader->libraries.list[i].source == source)
            status = fmt_mtl_read(ctx, reader->libraries.list[i].text, &found);
    for (uint32_t i = 0; i < found.count && !status; i++)
        describe(reader, source, &found.list[i], out);
    fmt_materials_free(ctx, &found);
    return status;
}

/* Names the materials that no library describes. */
static int name_others(struct obj_reader *reader, struct fmt_materials *out)
{
    int status = 0;
    for (uint32_t i = 0; i < out->count && !status; i++)
        if (!out->list[i].name)
            status = fmt_string_copy(reader->base.ctx, reader->materials.list[i].text,
                                     &out->list[i].name);
    return status;
}

int fmt_obj_read_materials(struct fmt_mesh_reader *base, struct fmt_materials *out)
{
    struct obj_reader *reader = (struct obj_reader *)base;
    uint64_t count = reader->materials.count;
    if (count == 0)
        return 0;
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
    if (status)
        fmt_materials_free(reader->base.ctx, out);
    return status;
}
