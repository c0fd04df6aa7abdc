/* mesh_reader.c - opens the files of a scan, chooses their formats, and places faces in messages.
 */
#include <inttypes.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>
#include <strings.h>

#include "base/context.h"
#include "formats/mesh/mesh_format.h"

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

#define EXPORT_ADVICE                                                                              \
    "make a GLB file of it, such as by `assimp export in.fbx in.glb` (Debian: assimp-utils)"

/* Suffixes of files of meshes that Bisque does not read. */
#define FOREIGN_SUFFIXES ".fbx .dae .3ds .x"

/* Kinds of files that users take for meshes, by their first bytes, and what to do about them. Other
 * files are left to the parsers, which name the line. */
static const struct foreign {
    const char *magic;
    unsigned size;
    const char *kind, *advice;
} foreign_kinds[] = {
    {"Kaydara FBX Binary", 18, "an FBX file", EXPORT_ADVICE},
    {"\x1f\x8b", 2, "a file packed by gzip twice", "unpack it first"},
    {"BZh", 3, "a file packed by bzip2", "unpack it first"},
    {"\3757zXZ", 5, "a file packed by xz", "unpack it first"},
    {"\x28\xb5\x2f\xfd", 4, "a file packed by Zstandard twice", "unpack it first"},
    {"BSQTRIS\n", 8, "a chunk file as a mesh",
     "a scan that is packed or piped must be a plain file, a low-poly mesh a mesh file"},
    {"PK\x03\x04", 4, "a ZIP archive", "unpack it first; of 3MF or USDZ, export the mesh as OBJ"},
    {"7z\xbc\xaf\x27\x1c", 6, "a 7z archive", "unpack it first"},
    {"BLENDER", 7, "a Blender file", "export the mesh as OBJ"},
    {"LASF", 4, "a point cloud", "make a mesh of it"},
    {"\x89PNG", 4, "an image", "give the mesh, and its image with --texture"},
    {"\xff\xd8\xff", 3, "an image", "give the mesh, and its image with --texture"},
    {"\xff\xfe", 2, "text in UTF-16 or UTF-32", "save it as UTF-8"},
    {"\xfe\xff", 2, "text in UTF-16", "save it as UTF-8"},
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
    if (has_any_suffix(path, fmt_mesh_unpacked_length(path), FOREIGN_SUFFIXES))
        return bsq_fail(ctx, BSQ_EDATA, "%s: cannot read files of this format: %s", path,
                        EXPORT_ADVICE);
    return 0;
}

static int choose_format(struct stream_source *source)
{
    char head[FMT_MESH_HEAD_BYTES];
    uint64_t size = 0;
    int status = fmt_input_peek(source->input, head, sizeof head, &size);
    if (status < 0 || (source->format = find_by_content(head, size)) != NULL)
        return status;
    source->format = find_by_suffix(source->path);
    status = refuse_foreign(source->ctx, source->path, head, size);
    for (size_t i = 0; i < FORMAT_COUNT && !source->format; i++)
        if (formats[i]->resembles && formats[i]->resembles(head, size))
            source->format = formats[i];
    if (source->format == NULL)
        source->format = formats[0];
    return status;
}

/* ---- opening ---- */

/* Returns the name that the system knows for a path; "-" is standard input. */
static const char *system_name(const char *path)
{
    return strcmp(path, "-") == 0 ? "/dev/stdin" : path;
}

/* Checks that input number `i` is not a pipe that is among the earlier ones. */
static int check_once(struct bsq_ctx *ctx, const struct fmt_mesh_inputs *from, uint32_t i)
{
    if (!from->pipes || !fmt_input_is_pipe(from->paths[i]))
        return 0;
    for (uint32_t k = 0; k < i; k++)
        if (bsq_same_file(system_name(from->paths[k]), system_name(from->paths[i])))
            return bsq_fail(ctx, BSQ_EUSAGE, "%s: a pipe can be read only once", from->paths[i]);
    return 0;
}

static int set_placement(struct stream_source *source, const struct bsq_placement *p)
{
    source->placement = *p;
    source->moves = p->scale != 1.0 || p->up != BSQ_UP_KEEP || p->translate[0] != 0.0 ||
                    p->translate[1] != 0.0 || p->translate[2] != 0.0;
    if (!(p->scale > 0.0) || !isfinite(p->scale))
        return bsq_fail(source->ctx, BSQ_EUSAGE, "%s: a scale of %g", source->path, p->scale);
    return 0;
}

/* Finds a file's format and reads the start of it. */
static int begin_source(struct stream_source *source)
{
    BSQ_PASS(choose_format(source));
    if (source->format->data_bytes > 0)
        BSQ_PASS(
            bsq_calloc(source->ctx, "a mesh file", 1, source->format->data_bytes, &source->data));
    if (source->format->begin)
        return source->format->begin(source);
    return 0;
}

/* So few plain files stay open until they are read, so that each is opened once. Opening others
 * again for each look at them keeps within the limit of open files. */
enum { MOST_HELD = 64 };

static int open_sources(struct fmt_mesh_reader *reader, const struct fmt_mesh_inputs *from)
{
    struct bsq_ctx *ctx = reader->ctx;
    BSQ_PASS(BSQ_CALLOC(ctx, "inputs", from->path_count, &reader->sources));
    /* All are checked before one is opened, which may wait for a writer. */
    for (uint32_t i = 0; i < from->path_count; i++)
        BSQ_PASS(check_once(ctx, from, i));
    for (uint32_t i = 0; i < from->path_count; i++) {
        struct stream_source *source = &reader->sources[reader->source_count++];
        *source = (struct stream_source){.ctx = ctx, .reader = reader, .number = i};
        if (from->sources && from->sources[i])
            BSQ_PASS(
                fmt_input_create_source(ctx, from->paths[i], from->sources[i], &source->input));
        else
            BSQ_PASS(
                fmt_input_create(ctx, from->paths[i], from->beside, from->pipes, &source->input));
        source->path = fmt_input_path(source->input);
        if (from->path_count <= MOST_HELD && fmt_input_is_plain(source->input))
            BSQ_PASS(fmt_input_open(source->input));
        source->held = from->path_count <= MOST_HELD && fmt_input_is_plain(source->input);
    }
    for (uint32_t i = 0; i < from->path_count; i++)
        BSQ_PASS(begin_source(&reader->sources[i]));
    for (uint32_t i = 0; i < from->path_count && from->placements; i++)
        BSQ_PASS(set_placement(&reader->sources[i], &from->placements[i]));
    return 0;
}

int fmt_mesh_open_inputs(struct bsq_ctx *ctx, const struct fmt_mesh_inputs *from,
                         struct fmt_mesh_reader **out)
{
    struct fmt_mesh_reader *reader;
    *out = NULL;
    if (from->path_count == 0)
        return bsq_fail(ctx, BSQ_EUSAGE, "no mesh file is given");
    BSQ_PASS(BSQ_CALLOC(ctx, "mesh reader", 1, &reader));
    reader->ctx = ctx;
    int status = open_sources(reader, from);
    if (status)
        fmt_mesh_close(reader);
    else
        *out = reader;
    return status;
}

int fmt_mesh_open(struct bsq_ctx *ctx, const char *const *paths, uint32_t path_count,
                  struct fmt_mesh_reader **out)
{
    const struct fmt_mesh_inputs inputs = {.paths = paths, .path_count = path_count};
    return fmt_mesh_open_inputs(ctx, &inputs, out);
}

const char *fmt_mesh_format_name(const struct fmt_mesh_reader *reader, uint32_t file)
{
    return reader->sources[file].format->name;
}

uint64_t fmt_mesh_bytes(const struct fmt_mesh_reader *reader)
{
    uint64_t bytes = 0;
    for (uint32_t i = 0; i < reader->source_count; i++) {
        const uint64_t size = fmt_input_size(reader->sources[i].input);
        if (size == UINT64_MAX)
            return 0;
        bytes += size;
    }
    return bytes;
}

/* ---- reading ---- */

/* Two slots a thread keep all threads busy as a rule. Four outlast a serial step that sometimes
 * takes long, for instance when it touches memory for the first time. They may take a small part of
 * the budget. */
unsigned fmt_mesh_max_slots(const struct fmt_mesh_reader *reader)
{
    const uint64_t usual_slot_bytes = 2 * MIB;
    uint64_t affordable = bsq_memory_limit(reader->ctx) / 8 / usual_slot_bytes;
    uint64_t count = 2 * (uint64_t)bsq_threads(reader->ctx), generous = affordable / 4;
    if (count > affordable)
        count = affordable > 2 ? affordable : 2;
    else if (count < generous)
        count = generous < 2 * count ? generous : 2 * count;
    return (unsigned)count;
}

int fmt_mesh_read(struct fmt_mesh_reader *reader,
                  int (*on_batch)(void *arg, const struct fmt_mesh_batch *batch), void *arg,
                  struct fmt_mesh_totals *totals)
{
    const struct fmt_mesh_steps steps = {.on_batch = on_batch};
    return fmt_mesh_read_steps(reader, &steps, arg, totals);
}

int fmt_mesh_look(const struct fmt_mesh_reader *reader, struct fmt_mesh_hints *out)
{
    int status = 0;
    *out = (struct fmt_mesh_hints){.faces_come_last = reader->source_count == 1};
    for (uint32_t i = 0; i < reader->source_count && status == 0; i++)
        status = reader->sources[i].format->look(&reader->sources[i], out);
    return status;
}

void fmt_mesh_use_objects(struct fmt_mesh_reader *reader)
{
    reader->objects = true;
}

/* ---- indices ---- */

bool fmt_mesh_all_below(const uint64_t *indices, uint64_t count, uint64_t end)
{
    uint64_t differences = 0;
    for (uint64_t i = 0; i < count; i++)
        differences |= end - 1 - indices[i];
    return differences >> 63 == 0;
}

bool fmt_mesh_check_vertices(const struct fmt_mesh_batch *batch, uint64_t end, uint64_t *face,
                             uint64_t *index)
{
    uint64_t f = 0, first = 0, corner = 0;
    if (batch->vertex_bound <= end ||
        fmt_mesh_all_below(batch->corner_vertices, batch->corner_count, end))
        return true;
    while (batch->corner_vertices[corner] < end)
        corner++;
    for (; first + batch->face_sizes[f] <= corner; f++)
        first += batch->face_sizes[f];
    *face = batch->face_base + f;
    *index = batch->corner_vertices[corner];
    return false;
}

/* ---- messages about faces ---- */

/* What follows the path in the location of a face: ":120". */
struct location_end {
    char text[40];
};

static struct location_end end_of_location(const struct fmt_mesh_location *location, uint64_t face)
{
    struct location_end end;
    if (location->line > 0)
        snprintf(end.text, sizeof end.text, ":%" PRIu64, location->line);
    else if (location->byte > 0)
        snprintf(end.text, sizeof end.text, ": byte %" PRIu64, location->byte);
    else
        snprintf(end.text, sizeof end.text, ": face %" PRIu64, face - location->first_face + 1);
    return end;
}

/* Fails with "path:line: face " and the text. If the format has no lines, with "path: byte 99: face
 * " and the text, or "path: face 12 " if the byte is unknown too. */
__attribute__((format(printf, 4, 5))) static int fail_face(struct bsq_ctx *ctx,
                                                           const struct fmt_mesh_location *location,
                                                           uint64_t face, const char *format, ...)
{
    char text[160];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    return bsq_fail(ctx, BSQ_EDATA, "%s%s%s%s", location->path,
                    end_of_location(location, face).text,
                    location->line + location->byte > 0 ? ": face " : " ", text);
}

int fmt_mesh_location_text(struct fmt_mesh_reader *reader, uint64_t face, char **out)
{
    struct fmt_mesh_location location;
    *out = NULL;
    BSQ_PASS(fmt_stream_locate_face(reader, face, &location));
    return bsq_text_print(reader->ctx, out, "%s%s", location.path,
                          end_of_location(&location, face).text);
}

int fmt_mesh_report_loss(struct fmt_mesh_reader *reader, enum fmt_mesh_kind kind,
                         const struct fmt_mesh_loss *loss, uint64_t faces)
{
    const uint64_t count = loss->count;
    char *location = NULL;
    int status = 0;
    if (count == 0)
        return 0;
    BSQ_TRY(fmt_mesh_location_text(reader, loss->face, &location));
    if (kind != FMT_MESH_VERTEX)
        status = bsq_warn_loss(reader->ctx,
                               "%s: corners that refer to a %s that the file does not have: "
                               "%" PRIu64 "; this is the first",
                               location, fmt_mesh_kind_names[kind], count);
    else if (count > faces / 100)
        status = bsq_fail(reader->ctx, BSQ_EDATA,
                          "%s: %" PRIu64 " of %" PRIu64 " faces have a vertex without a finite "
                          "position, more than 1 %%; this is the first",
                          location, count, faces);
    else
        status = bsq_warn_loss(reader->ctx,
                               "%s: faces left out, as they have a vertex without a finite "
                               "position: %" PRIu64 "; this is the first",
                               location, count);
done:
    bsq_free(reader->ctx, location);
    return status;
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
    struct fmt_mesh_location location;
    BSQ_PASS(fmt_stream_locate_face(reader, face, &location));
    if (index - location.base[kind] >= FMT_MESH_BEFORE)
        return fail_face(reader->ctx, &location, face, "refers to a %s before the first one",
                         fmt_mesh_kind_names[kind]);
    return fail_face(reader->ctx, &location, face, "refers to %s %" PRIu64 "%s, file has %" PRIu64,
                     fmt_mesh_kind_names[kind], index - location.base[kind] + !location.from_zero,
                     location.from_zero ? " (counted from 0)" : "", location.count[kind]);
}

int fmt_mesh_fail_face(struct bsq_ctx *ctx, const char *path, uint64_t face, const char *what)
{
    struct fmt_mesh_reader *reader;
    struct fmt_mesh_location location;
    bsq_mute_warnings(ctx, true); /* they were given when the file was loaded */
    int status = fmt_mesh_open(ctx, &path, 1, &reader);
    if (status == 0)
        status = fmt_mesh_read(reader, NULL, NULL, NULL);
    bsq_mute_warnings(ctx, false);
    if (status == 0)
        status = fmt_stream_locate_face(reader, face, &location);
    if (status == 0)
        status = fail_face(ctx, &location, face, "%s", what);
    fmt_mesh_close(reader);
    return status;
}
