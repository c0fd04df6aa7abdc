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

/* Only text is certain from its first bytes: it has a facet soon after the name. */
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

static int begin(struct stream_source *source)
{
    char head[FMT_MESH_HEAD_BYTES];
    uint64_t size = 0;
    int status = fmt_input_peek(source->input, head, sizeof head, &size);
    return status ? status : examine(source->ctx, source->input, head, size, source->data);
}

/* ---- equal vertices of one part ---- */

/* A vertex whose place is taken this often is not welded: files could be made whose vertices all
 * have one place. Later stages match vertices by position. */
enum { MOST_PROBES = 256 };

/* The table: entries are numbers of vertices + 1; 0: empty. At most half of them are used. */
struct weld {
    uint64_t mask;
    uint32_t slots[];
};

int fmt_stl_begin_weld(struct stream_slot *slot, uint64_t most)
{
    struct mesh_arrays *a = &slot->arrays;
    uint64_t entries = 1024;
    int status;
    while (entries < 2 * most)
        entries *= 2;
    if (most > UINT32_MAX / 2)
        return bsq_fail(slot->ctx, BSQ_ENOMEM, "a part of an STL file has too many vertices");
    BSQ_TRY(FMT_RESERVE(slot->ctx, sizeof(struct weld) + entries * sizeof(uint32_t), slot->work,
                        slot->work_capacity));
    BSQ_TRY(FMT_RESERVE(slot->ctx, most, a->positions, a->position_capacity));
    if (a->has_colors)
        BSQ_TRY(FMT_RESERVE(slot->ctx, most, a->colors, a->color_capacity));
    struct weld *weld = (struct weld *)(void *)slot->work;
    weld->mask = entries - 1;
    memset(weld->slots, 0, entries * sizeof(uint32_t));
done:
    return status;
}

static uint64_t hash_position(const double position[3])
{
    uint64_t bits[3], hash = 0;
    memcpy(bits, position, sizeof bits);
    for (int i = 0; i < 3; i++) {
        hash = (hash ^ bits[i]) * 0x9e3779b97f4a7c15u;
        hash ^= hash >> 32;
    }
    return hash;
}

/* Compares bit by bit, so that 0 and -0 stay different. */
static bool is_same(const struct mesh_arrays *a, uint64_t vertex, const double position[3],
                    const float *color)
{
    /* NOLINTBEGIN(bugprone-suspicious-memory-comparison): see above */
    return memcmp(a->positions[vertex], position, sizeof a->positions[vertex]) == 0 &&
           (!color || memcmp(a->colors[vertex], color, sizeof a->colors[vertex]) == 0);
    /* NOLINTEND(bugprone-suspicious-memory-comparison) */
}

uint64_t fmt_stl_weld(struct stream_slot *slot, const double position[3], const float *color)
{
    struct weld *weld = (struct weld *)(void *)slot->work;
    struct mesh_arrays *a = &slot->arrays;
    uint64_t i = hash_position(position) & weld->mask;
    for (int probes = 0; probes < MOST_PROBES && weld->slots[i] != 0; probes++) {
        if (is_same(a, weld->slots[i] - 1, position, color))
            return weld->slots[i] - 1;
        i = (i + 1) & weld->mask;
    }
    const uint64_t vertex = a->count[FMT_MESH_VERTEX]++;
    slot->odd[STREAM_NO_POSITION].count += isnan(position[0]);
    if (weld->slots[i] == 0)
        weld->slots[i] = (uint32_t)vertex + 1;
    memcpy(a->positions[vertex], position, sizeof a->positions[vertex]);
    if (color)
        memcpy(a->colors[vertex], color, sizeof a->colors[vertex]);
    return vertex;
}

/* ---- binary files ---- */

/* Cuts after a number of triangles. What follows the last one becomes a part of its own. */
static int cut_binary(const struct stl_source *file, const struct stream_part *before,
                      struct stream_slot *slot)
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
        fmt_input_reach(slot->source->input, part->items > 0 ? part->end : UINT64_MAX, &file_size);
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

static int parse_binary(const struct stl_source *file, struct stream_slot *slot)
{
    struct mesh_arrays *a = &slot->arrays;
    const uint64_t count = slot->part.items;
    int status;
    a->has_colors = any_color(file, slot);
    slot->color_white = 255.0f;
    BSQ_TRY(fmt_stl_begin_weld(slot, 3 * count));
    BSQ_TRY(FMT_RESERVE(slot->ctx, count, a->face_sizes, a->size_capacity));
    BSQ_TRY(FMT_RESERVE(slot->ctx, 3 * count, a->corners[FMT_MESH_VERTEX],
                        a->corner_capacity[FMT_MESH_VERTEX]));
    for (uint64_t i = 0; i < count; i++)
        if (!add_triangle(file, slot, i))
            break;
done:
    return status;
}

/* ---- reading ---- */

static int cut(const struct stream_part *before, struct stream_slot *slot)
{
    const struct stl_source *file = slot->source->data;
    return file->kind == STL_TEXT ? fmt_stl_cut_text(before, slot) : cut_binary(file, before, slot);
}

static int parse(struct stream_slot *slot)
{
    const struct stl_source *file = slot->source->data;
    int status = fmt_stream_load(slot);
    slot->local = 1u << FMT_MESH_VERTEX;
    if (status)
        return status;
    status = file->kind == STL_TEXT ? fmt_stl_parse_text(slot) : parse_binary(file, slot);
    slot->arrays.vertex_bound = slot->arrays.count[FMT_MESH_VERTEX];
    return status;
}

/* Warns of bytes after the last triangle. */
static int pass(struct stream_slot *slot)
{
    const struct stream_source *source = slot->source;
    struct stl_source *file = source->data;
    file->open_solids = slot->balance + (slot->part.offset > 0 ? file->open_solids : 0);
    if (file->kind != STL_TEXT && slot->part.items == 0 && !source->reader->read_before)
        return bsq_warn_loss(source->ctx, "%s: %" PRIu64 " bytes after the last triangle not read",
                             source->path, slot->part.end - slot->part.offset);
    return 0;
}

static int finish(struct stream_source *source)
{
    const struct stl_source *file = source->data;
    if (file->kind != STL_TEXT || file->open_solids <= 0 || source->reader->read_before)
        return 0;
    return bsq_warn_loss(source->ctx, "%s: \"endsolid\" is missing: the file may be incomplete",
                         source->path);
}

/* A triangle of text takes about 250 bytes. Vertices are counted as if none were equal. */
static int estimate(struct stream_source *source, uint64_t bytes, bool plain,
                    struct fmt_mesh_estimate *out)
{
    const struct stl_source *file = source->data;
    const uint64_t triangles = file->kind == STL_TEXT ? bytes / 250 : file->triangles;
    (void)plain;
    out->faces += triangles;
    out->vertices += 3 * triangles;
    out->corners += 3 * triangles;
    out->has_colors |= file->kind == STL_BINARY_MAGICS;
    out->faces_come_last = false;
    return 0;
}

const struct fmt_mesh_format fmt_stl_format = {
    .name = "STL",
    .suffix = ".stl",
    .data_bytes = sizeof(struct stl_source),
    .recognise = recognise,
    .resembles = resembles,
    .begin = begin,
    .cut = cut,
    .parse = parse,
    .pass = pass,
    .finish = finish,
    .estimate = estimate,
};
