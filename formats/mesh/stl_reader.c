/* stl_reader.c - reads STL files, binary and text, as an ordered stream of parsed parts.
 *
 * Understood: several solids in a text, polygons of any size, binary files that begin with "solid",
 * and the colours of two dialects (https://en.wikipedia.org/wiki/STL_(file_format)#Color). Normals
 * of facets are ignored, because they follow from the corners. */
#include <inttypes.h>
#include <math.h>
#include <string.h>
#include <strings.h>

#include "base/loss.h"
#include "formats/mesh/mesh_text.h"
#include "formats/mesh/stl_internal.h"

/* ---- opening ---- */

static bool is_text(const char *head, size_t size)
{
    size_t blanks = fmt_mesh_mark(head, size);
    while (blanks < size && head[blanks] != '\0' && (unsigned char)head[blanks] <= ' ')
        blanks++;
    return size - blanks >= 5 && strncasecmp(head + blanks, "solid", 5) == 0 &&
           memchr(head, '\0', size) == NULL;
}

/* Returns true if there are control characters that no text has. */
static bool has_controls(const char *head, size_t size)
{
    for (size_t i = 0; i < size; i++)
        if ((unsigned char)head[i] < ' ' && !(head[i] >= '\t' && head[i] <= '\r'))
            return true;
    return false;
}

/* Only text can be told for sure by its first bytes: it has a facet soon after the name. */
static bool recognise(const char *head, size_t size)
{
    if (!is_text(head, size))
        return false;
    for (size_t i = 5; i + 5 <= size; i++)
        if (strncasecmp(head + i, "facet", 5) == 0 && (unsigned char)head[i - 1] <= ' ')
            return true;
    return false;
}

static uint32_t load_u32(const char *from)
{
    uint32_t value;
    memcpy(&value, from, sizeof value);
    return value;
}

/* Returns whether corners of a triangle have coordinates of a mesh: finite, and no lengths that
 * random bytes have. Normals may be anything. */
static bool is_plausible(const char *triangle)
{
    float corners[9];
    bool good = true;
    memcpy(corners, triangle + 12, sizeof corners);
    for (int i = 0; i < 9; i++) {
        const float length = fabsf(corners[i]);
        good &= length == 0 || (length > 1e-20f && length < 1e20f);
    }
    return good;
}

/* Binary files have nothing that names them. The whole triangles in the first bytes must be
 * plausible, and a file that ends there must end after the last triangle. */
static bool resembles(const char *head, size_t size)
{
    const uint64_t count = size >= STL_HEADER_BYTES ? load_u32(head + 80) : 0;
    if (count == 0 || memchr(head, '\0', size) == NULL ||
        (size < FMT_MESH_HEAD_BYTES && size != STL_HEADER_BYTES + count * STL_TRIANGLE_BYTES))
        return false;
    const uint64_t whole = (size - STL_HEADER_BYTES) / STL_TRIANGLE_BYTES;
    for (uint64_t i = 0; i < whole && i < count; i++)
        if (!is_plausible(head + STL_HEADER_BYTES + i * STL_TRIANGLE_BYTES))
            return false;
    return true;
}

/* Finds "COLOR=" in the header, and the colour of the object after it. Magics writes
 * "COLOR=rgba,MATERIAL=", MeshLab "COLOR=rgb MATERIAL=". */
static void find_object_color(const char *head, struct stl_source *out)
{
    for (size_t i = 0; i + 10 <= 80; i++)
        if (memcmp(head + i, "COLOR=", 6) == 0) {
            out->kind = i + 19 <= 80 && memcmp(head + i + 9, " MATERIAL=", 10) == 0
                            ? STL_BINARY_MESHLAB
                            : STL_BINARY_MAGICS;
            for (int c = 0; c < 3; c++)
                out->object_color[c] = (float)(unsigned char)head[i + 6 + (size_t)c];
            return;
        }
}

/* Decides what a file is. The number of triangles in a binary header has 32 bits; the size of a
 * file with more than 2^32 tells the rest. A packed file, or a pipe, has no known size: then it is
 * text if it looks so, and the header counts the triangles. */
static int examine(struct bsq_ctx *ctx, const struct fmt_input *input, const char *head,
                   size_t size, struct stl_source *out)
{
    const uint64_t file_size = fmt_input_size(input);
    const bool known = file_size < UINT64_MAX;
    const uint32_t count = size >= STL_HEADER_BYTES ? load_u32(head + 80) : 0;
    const uint64_t body = size >= STL_HEADER_BYTES ? file_size - STL_HEADER_BYTES : 0;
    const uint64_t space = body / STL_TRIANGLE_BYTES;
    const bool exact = known && size >= STL_HEADER_BYTES && body % STL_TRIANGLE_BYTES == 0 &&
                       (uint32_t)space == count;
    out->kind = STL_TEXT;
    if (!exact && is_text(head, size) && (known || !has_controls(head, size)))
        return 0;
    out->kind = STL_BINARY;
    out->triangles = exact ? space : count;
    if (size < STL_HEADER_BYTES)
        return bsq_fail(ctx, BSQ_EDATA, "%s: truncated: %zu bytes are no STL file",
                        fmt_input_path(input), size);
    if (known && out->triangles > space)
        return bsq_fail(ctx, BSQ_EDATA,
                        "%s: truncated: the header counts %" PRIu32
                        " triangles, the file has %" PRIu64,
                        fmt_input_path(input), count, space);
    find_object_color(head, out);
    return 0;
}

static int open_file(struct stream_reader *stream, uint32_t number)
{
    struct stl_reader *reader = (struct stl_reader *)stream;
    struct bsq_ctx *ctx = reader->stream.base.ctx;
    struct fmt_input *input = reader->stream.sources[number].input;
    char head[FMT_MESH_HEAD_BYTES];
    uint64_t size = 0;
    int status = fmt_input_peek(input, head, sizeof head, &size);
    return status ? status : examine(ctx, input, head, size, &reader->files[number]);
}

static void close_reader(struct fmt_mesh_reader *base)
{
    struct stl_reader *reader = (struct stl_reader *)base;
    bsq_free(base->ctx, reader->files);
    fmt_stream_free(&reader->stream);
}

/* ---- binary files ---- */

/* Cuts after a number of triangles. What follows the last one becomes a part of its own. */
static int cut_binary(const struct stl_source *file, const struct stream_source *source,
                      const struct stream_part *before, struct stream_slot *slot)
{
    uint64_t file_size;
    struct stream_part *part = &slot->part;
    const uint64_t done = before->first_item + before->items, left = file->triangles - done;
    const uint64_t usual = STREAM_PART_BYTES / STL_TRIANGLE_BYTES + 1;
    part->offset = before->end > 0 ? before->end : STL_HEADER_BYTES;
    part->first_item = done;
    part->items = left < usual ? left : usual;
    part->size = part->items * STL_TRIANGLE_BYTES;
    part->end = part->offset + part->size;
    int status =
        fmt_input_reach(source->input, part->items > 0 ? part->end : UINT64_MAX, &file_size);
    if (status || (part->items == 0 && part->offset >= file_size))
        return status;
    if (part->items == 0)
        part->end = file_size;
    else if (part->end > file_size)
        fmt_stream_fail(slot, file_size,
                        "truncated: the header counts %" PRIu64 " triangles, the file has %" PRIu64,
                        file->triangles, (file_size - STL_HEADER_BYTES) / STL_TRIANGLE_BYTES);
    return 1;
}

/* Sets the colour of a triangle. Returns whether it has one. */
static bool decode_color(const struct stl_source *file, const uint8_t *triangle, float color[3])
{
    const uint32_t bits = triangle[48] | (uint32_t)triangle[49] << 8;
    const bool magics = file->kind == STL_BINARY_MAGICS, top = bits >> 15;
    const bool red_first = file->kind != STL_BINARY, given = magics || top;
    if (magics && top) {
        memcpy(color, file->object_color, sizeof file->object_color);
        return true;
    }
    for (int c = 0; c < 3; c++) {
        const uint32_t level = bits >> 5 * (red_first ? c : 2 - c) & 31;
        color[c] = given ? (float)level * (255.0f / 31.0f) : -1.0f;
    }
    return given;
}

static bool any_color(const struct stl_source *file, const struct stream_slot *slot)
{
    float color[3];
    for (uint64_t i = 0; i < slot->part.items; i++)
        if (decode_color(file, slot->bytes + i * STL_TRIANGLE_BYTES, color))
            return true;
    return false;
}

/* Reads a corner of a triangle. All numbers become NaN if one is not finite. */
static void read_corner(const uint8_t *from, double position[3])
{
    float values[3], poison = 0.0f;
    memcpy(values, from, sizeof values);
    for (int i = 0; i < 3; i++) {
        poison += values[i] * 0.0f;
        position[i] = (double)values[i];
    }
    if (poison != 0.0f)
        position[0] = position[1] = position[2] = NAN;
}

/* Adds triangle number `i` of the part. Returns false if parsing must stop. */
static bool add_triangle(const struct stl_source *file, struct stream_slot *slot, uint64_t i)
{
    struct mesh_arrays *a = &slot->arrays;
    const uint8_t *triangle = slot->bytes + i * STL_TRIANGLE_BYTES;
    double position[3];
    float color[3];
    decode_color(file, triangle, color);
    slot->at = slot->part.offset + i * STL_TRIANGLE_BYTES;
    for (uint64_t k = 0; k < 3; k++) {
        read_corner(triangle + 12 * (k + 1), position);
        a->corners[FMT_MESH_VERTEX][3 * i + k] =
            fmt_stl_weld(slot, position, a->has_colors ? color : NULL);
    }
    a->face_sizes[i] = 3;
    a->corner_count += 3;
    return a->face_count++ != slot->last_face;
}

static int parse_binary(struct bsq_ctx *ctx, const struct stl_source *file,
                        struct stream_slot *slot)
{
    struct mesh_arrays *a = &slot->arrays;
    const uint64_t count = slot->part.items;
    a->has_colors = any_color(file, slot);
    slot->color_white = 255.0f;
    int status = fmt_stl_begin_weld(ctx, slot, 3 * count);
    if (!status)
        status = fmt_arrays_reserve_faces(ctx, a, count);
    if (!status)
        status = fmt_arrays_reserve_corners(ctx, a, FMT_MESH_VERTEX, 3 * count);
    for (uint64_t i = 0; !status && i < count; i++)
        if (!add_triangle(file, slot, i))
            break;
    return status;
}

/* ---- reading ---- */

static const struct stl_source *file_of(const struct stream_reader *reader, uint32_t number)
{
    return &((const struct stl_reader *)reader)->files[number];
}

static int cut(struct stream_reader *reader, const struct stream_part *before,
               struct stream_slot *slot)
{
    const struct stl_source *file = file_of(reader, before->source);
    return file->kind == STL_TEXT
               ? fmt_stl_cut_text(reader, before, slot)
               : cut_binary(file, &reader->sources[before->source], before, slot);
}

static int parse(struct stream_reader *reader, struct stream_slot *slot)
{
    const struct stl_source *file = file_of(reader, slot->part.source);
    slot->balance = 0;
    int status = fmt_stream_load(reader, slot);
    if (status)
        return status;
    return file->kind == STL_TEXT ? fmt_stl_parse_text(reader->base.ctx, slot)
                                  : parse_binary(reader->base.ctx, file, slot);
}

/* Makes indices count from the start of the file. Warns of bytes after the last triangle. */
static int pass(struct stream_reader *base, struct stream_slot *slot,
                struct fmt_mesh_totals *totals)
{
    struct stl_reader *reader = (struct stl_reader *)base;
    const struct stl_source *file = file_of(base, slot->part.source);
    const struct stream_source *source = &base->sources[slot->part.source];
    struct mesh_arrays *a = &slot->arrays;
    (void)totals;
    reader->open_solids += slot->balance;
    for (uint64_t i = 0; i < a->corner_count; i++)
        a->corners[FMT_MESH_VERTEX][i] += source->count[FMT_MESH_VERTEX];
    if (file->kind != STL_TEXT && slot->part.items == 0 && !reader->read_before)
        return bsq_warn_loss(base->base.ctx,
                             "%s: %" PRIu64 " bytes after the last triangle not read", source->path,
                             slot->part.end - slot->part.offset);
    return 0;
}

static int read_all(struct fmt_mesh_reader *base, const struct fmt_mesh_steps *steps, void *arg,
                    struct fmt_mesh_totals *totals)
{
    struct stl_reader *reader = (struct stl_reader *)base;
    reader->open_solids = 0;
    int status = fmt_stream_read(&reader->stream, steps, arg, totals);
    if (!status && reader->open_solids > 0 && !reader->read_before)
        status = bsq_warn_loss(base->ctx, "%s: \"endsolid\" is missing: the file may be incomplete",
                               reader->stream.sources[0].path);
    reader->read_before |= status == 0;
    return status;
}

static int locate_face(struct fmt_mesh_reader *base, uint64_t face, struct fmt_mesh_place *out)
{
    return fmt_stream_locate_face((struct stream_reader *)base, face, out);
}

/* A triangle of text takes about 250 bytes. Vertices are counted as if none were equal. */
static int estimate(const struct fmt_mesh_reader *base, struct fmt_mesh_estimate *out)
{
    const struct stl_reader *reader = (const struct stl_reader *)base;
    *out = (struct fmt_mesh_estimate){.faces_come_last = false};
    for (uint32_t i = 0; i < reader->stream.source_count; i++) {
        const struct stl_source *file = &reader->files[i];
        uint64_t bytes;
        bool plain;
        int status = fmt_input_guess(reader->stream.sources[i].input, &bytes, &plain);
        if (status)
            return status;
        out->faces += file->kind == STL_TEXT ? bytes / 250 : file->triangles;
        out->has_colors |= file->kind == STL_BINARY_MAGICS;
    }
    out->vertices = out->corners = 3 * out->faces;
    return 0;
}

/* ---- the format ---- */

static int prepare(struct stream_reader *stream)
{
    struct stl_reader *reader = (struct stl_reader *)stream;
    return bsq_calloc(stream->base.ctx, "STL files", stream->source_count, sizeof *reader->files,
                      &reader->files);
}

static int open_reader(struct bsq_ctx *ctx, struct fmt_input *const *inputs, uint32_t input_count,
                       struct fmt_mesh_reader **out)
{
    static const struct stream_format stream = {
        .reader_name = "STL reader",
        .reader_bytes = sizeof(struct stl_reader),
        .prepare = prepare,
        .begin = open_file,
        .end = close_reader,
        .cut = cut,
        .parse = parse,
        .pass = pass,
    };
    return fmt_stream_open(ctx, &stream, inputs, input_count, out);
}

const struct fmt_mesh_format fmt_stl_format = {
    .name = "STL",
    .suffix = ".stl",
    .recognise = recognise,
    .resembles = resembles,
    .open = open_reader,
    .close = close_reader,
    .read = read_all,
    .estimate = estimate,
    .locate_face = locate_face,
};
