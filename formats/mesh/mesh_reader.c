/* mesh_reader.c - chooses the reader of a mesh and passes every call on to it. */
#include <inttypes.h>
#include <string.h>
#include <stdio.h>
#include <strings.h>

#include "base/file.h"
#include "formats/mesh/mesh_format.h"
#include "formats/mesh/mesh_text.h"

#define MIB ((uint64_t)1 << 20)

const char *const fmt_mesh_kind_names[FMT_MESH_KIND_COUNT] = {"vertex", "texture coordinate",
                                                              "normal"};

#define FMT_MESH_COUNT(format) +1
enum { FORMAT_COUNT = 0 FMT_MESH_FORMATS(FMT_MESH_COUNT) };
#define FMT_MESH_ROW(format) &format,
static const struct fmt_mesh_format *const formats[FORMAT_COUNT] = {FMT_MESH_FORMATS(FMT_MESH_ROW)};

/* ---- choosing a format ---- */

static bool has_suffix(const char *path, const char *suffix)
{
    size_t length = strlen(path), suffix_length = strlen(suffix);
    return length >= suffix_length && strcasecmp(path + length - suffix_length, suffix) == 0;
}

static const struct fmt_mesh_format *find_by_content(const char *head, size_t size)
{
    for (size_t i = 0; i < FORMAT_COUNT; i++)
        if (formats[i]->recognise && formats[i]->recognise(head, size))
            return formats[i];
    return NULL;
}

static const struct fmt_mesh_format *find_by_suffix(const char *path)
{
    for (size_t i = 0; i < FORMAT_COUNT; i++)
        /* No row is NULL, but the analyzer forgets that at the call of a recognise function. */
        /* NOLINTNEXTLINE(clang-analyzer-core.NullDereference) */
        if (has_suffix(path, formats[i]->suffix))
            return formats[i];
    return NULL;
}

bool fmt_mesh_recognise(const char *path, const char *head, size_t size)
{
    return find_by_content(head, size) || find_by_suffix(path);
}

/* Kinds of files that users take for meshes, by their first bytes, and what to do about them. Other
 * files are left to the parsers, which name the line. */
static const struct foreign {
    const char *magic;
    unsigned size;
    const char *kind, *advice;
} foreign_kinds[] = {
    {"\x1f\x8b", 2, "a file packed by gzip", "unpack it first"},
    {"BZh", 3, "a file packed by bzip2", "unpack it first"},
    {"\3757zXZ", 5, "a file packed by xz", "unpack it first"},
    {"\x28\xb5\x2f\xfd", 4, "a file packed by Zstandard", "unpack it first"},
    {"PK\x03\x04", 4, "a ZIP archive", "unpack it first"},
    {"7z\xbc\xaf\x27\x1c", 6, "a 7z archive", "unpack it first"},
    {"Kaydara FBX Binary", 18, "an FBX file", "export the mesh as OBJ"},
    {"BLENDER", 7, "a Blender file", "export the mesh as OBJ"},
    {"\xff\xfe", 2, "text in UTF-16", "save it as UTF-8"},
    {"\xfe\xff", 2, "text in UTF-16", "save it as UTF-8"},
};

static int refuse_foreign(struct bsq_ctx *ctx, const char *path, const char *head, size_t size)
{
    for (size_t i = 0; i < sizeof foreign_kinds / sizeof *foreign_kinds; i++) {
        const struct foreign *foreign = &foreign_kinds[i];
        if (size >= foreign->size && memcmp(head, foreign->magic, foreign->size) == 0)
            return bsq_fail(ctx, BSQ_EDATA, "%s: cannot read %s: %s", path, foreign->kind,
                            foreign->advice);
    }
    return 0;
}

static int choose_format(struct bsq_ctx *ctx, const char *path, const struct fmt_mesh_format **out)
{
    struct bsq_file file = BSQ_FILE_CLOSED;
    char head[FMT_MESH_HEAD_BYTES];
    uint64_t size = 0;
    int status = bsq_file_open(ctx, path, &file);
    if (status == 0)
        status = bsq_file_read_some(ctx, &file, head, sizeof head, 0, &size);
    bsq_file_close(ctx, &file);
    if (status < 0 || (*out = find_by_content(head, size)) != NULL)
        return status;
    *out = find_by_suffix(path);
    if (*out == NULL)
        *out = formats[0];
    return refuse_foreign(ctx, path, head, size);
}

int fmt_mesh_open(struct bsq_ctx *ctx, const char *const *paths, uint32_t path_count,
                  struct fmt_mesh_reader **out)
{
    const struct fmt_mesh_format *first = formats[0];
    *out = NULL;
    for (uint32_t i = 0; i < path_count; i++) {
        const struct fmt_mesh_format *format;
        int status = choose_format(ctx, paths[i], &format);
        if (status < 0)
            return status;
        if (i == 0)
            first = format;
        if (format != first)
            return bsq_fail(
                ctx, BSQ_EDATA,
                "%s has the format %s, but %s has %s: all files of a scan need one format",
                paths[i], format->name, paths[0], first->name);
    }
    int status = first->open(ctx, paths, path_count, out);
    if (status == 0)
        (*out)->format = first;
    return status;
}

void fmt_mesh_close(struct fmt_mesh_reader *reader)
{
    if (reader)
        reader->format->close(reader);
}

/* ---- reading ---- */

/* Two slots a thread keep all threads busy as a rule. Four outlast a serial step that sometimes
 * takes long, for instance when it touches memory for the first time. They may take a small part of
 * the budget. */
unsigned fmt_mesh_slots_for(uint64_t memory_bytes, unsigned threads)
{
    const uint64_t usual_slot_bytes = 2 * MIB;
    uint64_t affordable = memory_bytes / 8 / usual_slot_bytes;
    uint64_t count = 2 * (uint64_t)threads, generous = affordable / 4;
    if (count > affordable)
        count = affordable > 2 ? affordable : 2;
    else if (count < generous)
        count = generous < 2 * count ? generous : 2 * count;
    return (unsigned)count;
}

unsigned fmt_mesh_max_slots(const struct fmt_mesh_reader *reader)
{
    return fmt_mesh_slots_for(bsq_memory_limit(reader->ctx), bsq_threads(reader->ctx));
}

int fmt_mesh_read_steps(struct fmt_mesh_reader *reader, const struct fmt_mesh_steps *steps,
                        void *arg, struct fmt_mesh_totals *totals)
{
    struct fmt_mesh_totals unused = {0};
    totals = totals ? totals : &unused;
    memset(totals, 0, sizeof *totals);
    return reader->format->read(reader, steps, arg, totals);
}

int fmt_mesh_read(struct fmt_mesh_reader *reader,
                  int (*on_block)(void *arg, const struct fmt_mesh_block *block), void *arg,
                  struct fmt_mesh_totals *totals)
{
    const struct fmt_mesh_steps steps = {.on_block = on_block};
    return fmt_mesh_read_steps(reader, &steps, arg, totals);
}

int fmt_mesh_estimate(const struct fmt_mesh_reader *reader, struct fmt_mesh_estimate *out)
{
    return reader->format->estimate(reader, out);
}

/* ---- materials ---- */

int fmt_mesh_read_materials(struct fmt_mesh_reader *reader, struct fmt_materials *out)
{
    memset(out, 0, sizeof *out);
    return reader->format->read_materials ? reader->format->read_materials(reader, out) : 0;
}

int fmt_material_copy(struct bsq_ctx *ctx, const struct fmt_material *from, const char *name,
                      struct fmt_material *out)
{
    *out = *from;
    out->name = out->texture_path = NULL;
    int status = fmt_string_copy(ctx, name, &out->name);
    if (!status && from->texture_path)
        status = fmt_string_copy(ctx, from->texture_path, &out->texture_path);
    return status;
}

void fmt_materials_free(struct bsq_ctx *ctx, struct fmt_materials *materials)
{
    for (uint32_t i = 0; i < materials->count; i++) {
        bsq_free(ctx, materials->list[i].name);
        bsq_free(ctx, materials->list[i].texture_path);
    }
    bsq_free(ctx, materials->list);
    memset(materials, 0, sizeof *materials);
}

const char *fmt_mesh_dependency(const struct fmt_mesh_reader *reader, uint32_t index)
{
    return reader->format->dependency ? reader->format->dependency(reader, index) : NULL;
}

/* ---- messages about faces ---- */

/* Fails with "path:line: face " and the text. If the format has no lines, with "path: byte 99: face
 * " and the text, or "path: face 12 " if the byte is unknown too. */
__attribute__((format(printf, 4, 5))) static int fail_face(struct bsq_ctx *ctx,
                                                           const struct fmt_mesh_place *place,
                                                           uint64_t face, const char *format, ...)
{
    char text[160];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    if (place->line > 0)
        return bsq_fail(ctx, BSQ_EDATA, "%s:%" PRIu64 ": face %s", place->path, place->line, text);
    if (place->byte > 0)
        return bsq_fail(ctx, BSQ_EDATA, "%s: byte %" PRIu64 ": face %s", place->path, place->byte,
                        text);
    return bsq_fail(ctx, BSQ_EDATA, "%s: face %" PRIu64 " %s", place->path, face + 1, text);
}

int fmt_mesh_place_text(struct fmt_mesh_reader *reader, uint64_t face, char **out)
{
    struct fmt_mesh_place place;
    *out = NULL;
    int status = reader->format->locate_face(reader, face, &place);
    const size_t size = status == 0 ? strlen(place.path) + 40 : 1;
    if (status == 0)
        status = bsq_alloc(reader->ctx, "names", size, 1, out);
    if (status < 0)
        return status;
    if (place.line > 0)
        snprintf(*out, size, "%s:%" PRIu64, place.path, place.line);
    else if (place.byte > 0)
        snprintf(*out, size, "%s: byte %" PRIu64, place.path, place.byte);
    else
        snprintf(*out, size, "%s: face %" PRIu64, place.path, face + 1);
    return 0;
}

int fmt_mesh_fail_index(struct fmt_mesh_reader *reader, uint64_t face, enum fmt_mesh_kind kind,
                        uint64_t index)
{
    struct fmt_mesh_place place;
    int status = reader->format->locate_face(reader, face, &place);
    if (status < 0)
        return status;
    if (index - place.base[kind] >= FMT_MESH_BEFORE)
        return fail_face(reader->ctx, &place, face, "refers to a %s before the first one",
                         fmt_mesh_kind_names[kind]);
    return fail_face(reader->ctx, &place, face, "refers to %s %" PRIu64 "%s, file has %" PRIu64,
                     fmt_mesh_kind_names[kind], index - place.base[kind] + !place.from_zero,
                     place.from_zero ? " (counted from 0)" : "", place.count[kind]);
}

int fmt_mesh_fail_face(struct bsq_ctx *ctx, const char *path, uint64_t face, const char *what)
{
    struct fmt_mesh_reader *reader;
    struct fmt_mesh_place place;
    int status = fmt_mesh_open(ctx, &path, 1, &reader);
    if (status == 0)
        status = fmt_mesh_read(reader, NULL, NULL, NULL);
    if (status == 0)
        status = reader->format->locate_face(reader, face, &place);
    if (status == 0)
        status = fail_face(ctx, &place, face, "%s", what);
    fmt_mesh_close(reader);
    return status;
}
