/* mesh_reader.c - chooses the reader of a mesh and passes every call on to it. */
#include <inttypes.h>
#include <assert.h>
#include <string.h>
#include <stdio.h>
#include <strings.h>
#include <sys/stat.h>
#include <unistd.h>

#include "base/loss.h"
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

static bool has_suffix(const char *name, size_t length, const char *suffix)
{
    const size_t suffix_length = strlen(suffix);
    return length >= suffix_length &&
           strncasecmp(name + length - suffix_length, suffix, suffix_length) == 0;
}

/* Checks the suffixes of a format, which blanks separate. */
static bool has_any_suffix(const char *name, size_t length, const char *suffixes)
{
    char one[16];
    int used = 0;
    for (; sscanf(suffixes, " %15s%n", one, &used) == 1; suffixes += used)
        if (has_suffix(name, length, one))
            return true;
    return false;
}

size_t fmt_mesh_unpacked_length(const char *path)
{
    const size_t length = strlen(path);
    if (has_suffix(path, length, ".gz"))
        return length - 3;
    return length - (has_suffix(path, length, ".zst") ? 4 : 0);
}

static const struct fmt_mesh_format *find_by_content(const char *head, size_t size)
{
    for (size_t i = 0; i < FORMAT_COUNT; i++)
        if (formats[i]->recognise && formats[i]->recognise(head, size))
            return formats[i];
    return NULL;
}

/* Finds the format by the suffix; that of "scan.stl.gz" is ".stl". */
static const struct fmt_mesh_format *find_by_suffix(const char *path)
{
    const size_t length = fmt_mesh_unpacked_length(path);
    for (size_t i = 0; i < FORMAT_COUNT; i++)
        /* No row is NULL, but the analyzer forgets that at the call of a recognise function. */
        /* NOLINTNEXTLINE(clang-analyzer-core.NullDereference) */
        if (has_any_suffix(path, length, formats[i]->suffix))
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
    {"\x1f\x8b", 2, "a file packed by gzip twice", "unpack it first"},
    {"BZh", 3, "a file packed by bzip2", "unpack it first"},
    {"\3757zXZ", 5, "a file packed by xz", "unpack it first"},
    {"\x28\xb5\x2f\xfd", 4, "a file packed by Zstandard twice", "unpack it first"},
    {"BSQTRIS\n", 8, "a chunk file as a mesh",
     "a scan that is packed or piped must be a plain file, a low-poly mesh a mesh file"},
    {"PK\x03\x04", 4, "a ZIP archive", "unpack it first"},
    {"7z\xbc\xaf\x27\x1c", 6, "a 7z archive", "unpack it first"},
    {"BLENDER", 7, "a Blender file", "export the mesh as OBJ"},
    {"\xff\xfe", 2, "text in UTF-32 or in damaged UTF-16", "save it as UTF-8"},
    {"\xfe\xff", 2, "text in damaged UTF-16", "save it as UTF-8"},
    {"\0\0\xfe\xff", 4, "text in UTF-32", "save it as UTF-8"},
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

static int choose_format(struct bsq_ctx *ctx, struct fmt_input *input,
                         const struct fmt_mesh_format **out)
{
    char head[FMT_MESH_HEAD_BYTES];
    uint64_t size = 0;
    const char *path = fmt_input_path(input);
    int status = fmt_input_peek(input, head, sizeof head, &size);
    if (status < 0 || (*out = find_by_content(head, size)) != NULL)
        return status;
    *out = find_by_suffix(path);
    status = refuse_foreign(ctx, path, head, size);
    for (size_t i = 0; i < FORMAT_COUNT && !*out; i++)
        if (formats[i]->resembles && formats[i]->resembles(head, size))
            *out = formats[i];
    if (*out == NULL)
        *out = formats[0];
    return status;
}

/* ---- opening ---- */

static void free_inputs(struct bsq_ctx *ctx, struct fmt_input **inputs, uint32_t count)
{
    for (uint32_t i = 0; inputs && i < count; i++)
        fmt_input_free(inputs[i]);
    bsq_free(ctx, inputs);
}

/* Finds the format of each input. Sets *one to that of all if one reader takes them, else to NULL.
 */
static int choose_formats(struct bsq_ctx *ctx, struct fmt_input *const *inputs, uint32_t count,
                          const struct fmt_mesh_format **found, const struct fmt_mesh_format **one)
{
    int status = 0;
    *one = NULL;
    for (uint32_t i = 0; i < count && !status; i++) {
        status = choose_format(ctx, inputs[i], &found[i]);
        if (!status)
            *one = i == 0 || (found[i] == *one && !found[i]->single) ? found[i] : NULL;
    }
    return status;
}

/* Opens the reader, or the readers, that the inputs need. */
static int open_readers(struct bsq_ctx *ctx, struct fmt_input *const *inputs, uint32_t count,
                        struct fmt_mesh_reader **out)
{
    const struct fmt_mesh_format **found, *one = NULL;
    int status = bsq_calloc(ctx, "inputs", count, sizeof(void *), &found);
    if (!status)
        status = choose_formats(ctx, inputs, count, found, &one);
    if (!status && one)
        status = one->open(ctx, inputs, count, out);
    else if (!status)
        status = fmt_mesh_open_mixed(ctx, inputs, found, count, out);
    if (!status)
        (*out)->format = one ? one : &fmt_mixed_format;
    bsq_free(ctx, found);
    return status;
}

/* Sets *info for a path; "-" is standard input. Returns false if it cannot be seen. */
static bool identify(const char *path, struct stat *info)
{
    return (strcmp(path, "-") == 0 ? fstat(STDIN_FILENO, info) : stat(path, info)) == 0;
}

/* Returns whether two paths name one file. */
static bool is_same(const char *a, const char *b)
{
    struct stat info_a, info_b;
    if (!identify(a, &info_a) || !identify(b, &info_b))
        return strcmp(a, b) == 0;
    return info_a.st_dev == info_b.st_dev && info_a.st_ino == info_b.st_ino;
}

/* Checks that input number `i` is not a pipe that is among the earlier ones. */
static int check_once(struct bsq_ctx *ctx, const struct fmt_mesh_inputs *from, uint32_t i)
{
    if (!from->pipes || !fmt_input_is_pipe(from->paths[i]))
        return 0;
    for (uint32_t k = 0; k < i; k++)
        if (is_same(from->paths[k], from->paths[i]))
            return bsq_fail(ctx, BSQ_EUSAGE, "%s: a pipe can be read only once", from->paths[i]);
    return 0;
}

static int create_inputs(struct bsq_ctx *ctx, const struct fmt_mesh_inputs *from,
                         struct fmt_input **inputs)
{
    int status = 0;
    /* All are checked before one is opened, which may wait for a writer. */
    for (uint32_t i = 0; i < from->path_count && !status; i++)
        status = check_once(ctx, from, i);
    for (uint32_t i = 0; i < from->path_count && !status; i++)
        status = fmt_input_create(ctx, from->paths[i], from->beside, from->pipes, &inputs[i]);
    return status;
}

int fmt_mesh_open_inputs(struct bsq_ctx *ctx, const struct fmt_mesh_inputs *from,
                         struct fmt_mesh_reader **out)
{
    struct fmt_input **inputs;
    *out = NULL;
    int status = bsq_calloc(ctx, "inputs", from->path_count, sizeof(void *), &inputs);
    if (status == 0)
        status = create_inputs(ctx, from, inputs);
    if (status == 0)
        status = open_readers(ctx, inputs, from->path_count, out);
    if (status < 0) {
        free_inputs(ctx, inputs, from->path_count);
        return status;
    }
    assert(*out);
    (*out)->inputs = inputs;
    (*out)->input_count = from->path_count;
    status = from->placements ? fmt_mesh_keep_placements(*out, from->placements) : 0;
    if (status < 0) {
        fmt_mesh_close(*out);
        *out = NULL;
    }
    return status;
}

int fmt_mesh_open(struct bsq_ctx *ctx, const char *const *paths, uint32_t path_count,
                  struct fmt_mesh_reader **out)
{
    const struct fmt_mesh_inputs inputs = {.paths = paths, .path_count = path_count};
    return fmt_mesh_open_inputs(ctx, &inputs, out);
}

void fmt_mesh_close(struct fmt_mesh_reader *reader)
{
    if (!reader)
        return;
    struct bsq_ctx *ctx = reader->ctx;
    struct fmt_input **inputs = reader->inputs;
    const uint32_t count = reader->input_count;
    bsq_free(ctx, reader->placements);
    reader->format->close(reader);
    free_inputs(ctx, inputs, count);
}

uint64_t fmt_mesh_bytes(const struct fmt_mesh_reader *reader)
{
    uint64_t bytes = 0;
    for (uint32_t i = 0; i < reader->input_count; i++) {
        const uint64_t size = fmt_input_size(reader->inputs[i]);
        if (size == UINT64_MAX)
            return 0;
        bytes += size;
    }
    return bytes;
}

bool fmt_mesh_given(const struct fmt_mesh_reader *reader, const char *path, uint64_t *bytes,
                    uint64_t *hash)
{
    for (uint32_t i = 0; i < reader->input_count; i++)
        if (strcmp(fmt_input_path(reader->inputs[i]), path) == 0)
            return fmt_input_given(reader->inputs[i], bytes, hash);
    return false;
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
    return reader->placements ? fmt_mesh_read_placed(reader, steps, arg, totals)
                              : reader->format->read(reader, steps, arg, totals);
}

int fmt_mesh_read(struct fmt_mesh_reader *reader,
                  int (*on_block)(void *arg, const struct fmt_mesh_block *block), void *arg,
                  struct fmt_mesh_totals *totals)
{
    const struct fmt_mesh_steps steps = {.on_block = on_block};
    return fmt_mesh_read_steps(reader, &steps, arg, totals);
}

static void limit(uint64_t *count, uint64_t most)
{
    *count = *count < most ? *count : most;
}

/* Limits what headers of packed files claim to what the unpacked bytes can hold, at four bytes an
 * element. Of a pipe nothing is known, and nothing is believed. */
static void limit_estimate(struct fmt_mesh_estimate *estimate, uint64_t bytes)
{
    limit(&estimate->vertices, bytes / 4);
    limit(&estimate->texcoords, bytes / 4);
    limit(&estimate->normals, bytes / 4);
    limit(&estimate->faces, bytes / 4);
    limit(&estimate->corners, bytes);
}

int fmt_mesh_estimate(const struct fmt_mesh_reader *reader, struct fmt_mesh_estimate *out)
{
    uint64_t temp_bytes = 0, all_bytes = 0;
    bool all_plain = true;
    int status = 0;
    for (uint32_t i = 0; i < reader->input_count && status == 0; i++) {
        uint64_t bytes;
        bool plain;
        status = fmt_input_guess(reader->inputs[i], &bytes, &plain);
        all_bytes += bytes;
        all_plain &= plain;
        /* Unpacked files are dropped one after the other. */
        if (status == 0 && !plain && bytes > temp_bytes)
            temp_bytes = bytes;
    }
    if (status == 0)
        status = reader->format->estimate(reader, out);
    if (!all_plain)
        limit_estimate(out, all_bytes);
    out->temp_bytes = temp_bytes;
    return status;
}

/* ---- materials ---- */

void fmt_mesh_use_objects(struct fmt_mesh_reader *reader)
{
    reader->objects = true;
}

int fmt_mesh_read_materials(struct fmt_mesh_reader *reader, struct fmt_materials *out)
{
    memset(out, 0, sizeof *out);
    return reader->format->read_materials ? reader->format->read_materials(reader, out) : 0;
}

int fmt_mesh_preview_materials(struct fmt_mesh_reader *reader, struct fmt_materials *out)
{
    memset(out, 0, sizeof *out);
    return reader->format->preview_materials ? reader->format->preview_materials(reader, out) : 0;
}

int fmt_channels_copy(struct bsq_ctx *ctx, const struct fmt_material_channel *from, uint32_t count,
                      struct fmt_material *out)
{
    int status = bsq_calloc(ctx, "materials", count, sizeof *out->channels, &out->channels);
    for (uint32_t i = 0; i < count && !status; i++) {
        const struct fmt_material_channel *source = &from[i];
        struct fmt_material_channel *copy = &out->channels[out->channel_count++];
        *copy = *source;
        copy->texture_path = copy->texture_place = NULL;
        if (source->texture_path)
            status = fmt_string_copy(ctx, source->texture_path, &copy->texture_path);
        if (!status && source->texture_place)
            status = fmt_string_copy(ctx, source->texture_place, &copy->texture_place);
    }
    return status;
}

int fmt_material_copy(struct bsq_ctx *ctx, const struct fmt_material *from, const char *name,
                      struct fmt_material *out)
{
    *out = *from;
    out->name = out->texture_path = out->texture_place = out->object = NULL;
    out->channels = NULL;
    out->channel_count = 0;
    int status = fmt_string_copy(ctx, name, &out->name);
    if (!status && from->texture_path)
        status = fmt_string_copy(ctx, from->texture_path, &out->texture_path);
    if (!status && from->texture_place)
        status = fmt_string_copy(ctx, from->texture_place, &out->texture_place);
    if (!status && from->channel_count > 0)
        status = fmt_channels_copy(ctx, from->channels, from->channel_count, out);
    return status;
}

void fmt_channels_free(struct bsq_ctx *ctx, struct fmt_material_channel *list, uint32_t count)
{
    for (uint32_t i = 0; i < count; i++) {
        bsq_free(ctx, list[i].texture_path);
        bsq_free(ctx, list[i].texture_place);
    }
    bsq_free(ctx, list);
}

void fmt_materials_free(struct bsq_ctx *ctx, struct fmt_materials *materials)
{
    for (uint32_t i = 0; i < materials->count; i++) {
        bsq_free(ctx, materials->list[i].name);
        bsq_free(ctx, materials->list[i].texture_path);
        bsq_free(ctx, materials->list[i].texture_place);
        bsq_free(ctx, materials->list[i].object);
        fmt_channels_free(ctx, materials->list[i].channels, materials->list[i].channel_count);
    }
    bsq_free(ctx, materials->list);
    memset(materials, 0, sizeof *materials);
}

int fmt_material_enter_channel(struct bsq_ctx *ctx, struct fmt_material *material,
                               const struct bsq_channel *channel, struct fmt_material_channel **out)
{
    uint64_t capacity = material->channel_count; /* materials have few channels */
    for (uint32_t i = 0; i < material->channel_count; i++)
        if (material->channels[i].channel == channel) {
            *out = &material->channels[i];
            return 0;
        }
    int status = bsq_grow(ctx, "materials", material->channel_count + UINT64_C(1),
                          sizeof *material->channels, &material->channels, &capacity);
    if (status)
        return status;
    *out = &material->channels[material->channel_count++];
    **out = (struct fmt_material_channel){
        .channel = channel, .value = {channel->usual, channel->usual, channel->usual}};
    return 0;
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
    return bsq_fail(ctx, BSQ_EDATA, "%s: face %" PRIu64 " %s", place->path,
                    face - place->first_face + 1, text);
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
        snprintf(*out, size, "%s: face %" PRIu64, place.path, face - place.first_face + 1);
    return 0;
}

int fmt_mesh_fail_no_faces(struct bsq_ctx *ctx, const char *path,
                           const struct fmt_mesh_totals *totals)
{
    const bool points = totals->vertices > 0 && totals->short_faces == 0;
    return bsq_fail(ctx, BSQ_EDATA, "%s: no faces%s", path, points ? ", only points or lines" : "");
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
    bsq_mute_warnings(ctx, true); /* they were given when the file was loaded */
    int status = fmt_mesh_open(ctx, &path, 1, &reader);
    if (status == 0)
        status = fmt_mesh_read(reader, NULL, NULL, NULL);
    bsq_mute_warnings(ctx, false);
    if (status == 0)
        status = reader->format->locate_face(reader, face, &place);
    if (status == 0)
        status = fail_face(ctx, &place, face, "%s", what);
    fmt_mesh_close(reader);
    return status;
}
