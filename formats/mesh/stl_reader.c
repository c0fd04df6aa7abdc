/* stl_reader.c - reads STL files, binary and text, as an ordered stream of parsed blocks.
 *
 * Understood: several solids in a text, polygons of any size, binary files that begin with "solid".
 * Normals of facets are ignored, because they follow from the corners. Colours, for which there are
 * several dialects (https://en.wikipedia.org/wiki/STL_(file_format)#Color), are a warning.
 *
 * STL files repeat each vertex for each triangle. Vertices of a block that are equal are made one
 * here, which leaves about one vertex for a triangle; the rest is left to later stages, which match
 * vertices by position (docs/decisions). So memory does not grow with the file. */
#include <inttypes.h>
#include <math.h>
#include <string.h>
#include <strings.h>

#include "base/bytes.h"
#include "base/context.h"
#include "formats/mesh/mesh_format.h"
#include "formats/mesh/mesh_text.h"
#include "formats/mesh/obj_number.h"

/* Bytes of a binary file before its triangles, and of a triangle. */
#define STL_HEADER_BYTES   ((uint64_t)84)
#define STL_TRIANGLE_BYTES ((uint64_t)50)

/* What the reader keeps of a file: source->data. */
struct stl_source {
    bool text;
    uint64_t triangles; /* of a binary file, by its size or its header */
    int64_t odd;        /* of one reading: "solid" without "endsolid"; of a binary file, colours */
};

/* ---- opening ---- */

static bool is_text(const char *head, size_t size)
{
    size_t blanks = fmt_mesh_mark(head, size);
    blanks += fmt_mesh_count_space(head + blanks, size - blanks);
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
    const uint64_t count = size >= STL_HEADER_BYTES ? bsq_little(head + 80, 4) : 0;
    if (count == 0 || memchr(head, '\0', size) == NULL ||
        (size < FMT_MESH_HEAD_BYTES && size != STL_HEADER_BYTES + count * STL_TRIANGLE_BYTES))
        return false;
    const uint64_t whole = (size - STL_HEADER_BYTES) / STL_TRIANGLE_BYTES;
    for (uint64_t i = 0; i < whole && i < count; i++)
        if (!is_plausible(head + STL_HEADER_BYTES + i * STL_TRIANGLE_BYTES))
            return false;
    return true;
}

/* Decides what a file is. The number of triangles in a binary header has 32 bits; the size of a
 * file with more than 2^32 tells the rest. A packed file, or a pipe, has no known size: then it is
 * text if it looks so, and the header counts the triangles. */
static int examine(struct bsq_ctx *ctx, const struct fmt_input *input, const char *head,
                   size_t size, struct stl_source *out)
{
    const uint64_t file_size = fmt_input_size(input);
    const bool known = file_size < UINT64_MAX;
    const uint32_t count = size >= STL_HEADER_BYTES ? (uint32_t)bsq_little(head + 80, 4) : 0;
    const uint64_t body = size >= STL_HEADER_BYTES ? file_size - STL_HEADER_BYTES : 0;
    const uint64_t space = body / STL_TRIANGLE_BYTES;
    const bool exact = known && size >= STL_HEADER_BYTES && body % STL_TRIANGLE_BYTES == 0 &&
                       (uint32_t)space == count;
    out->text = !exact && is_text(head, size) && (known || !has_controls(head, size));
    if (out->text)
        return 0;
    out->triangles = exact ? space : count;
    if (size < STL_HEADER_BYTES)
        return bsq_fail(ctx, BSQ_EDATA, "%s: truncated: %zu bytes are no STL file",
                        fmt_input_path(input), size);
    if (known && out->triangles > space)
        return bsq_fail(ctx, BSQ_EDATA,
                        "%s: truncated: the header counts %" PRIu32
                        " triangles, the file has %" PRIu64,
                        fmt_input_path(input), count, space);
    out->odd = memmem(head, 80, "COLOR=", 6) != NULL; /* of Magics and MeshLab */
    return 0;
}

static int begin(struct stream_source *source)
{
    char head[FMT_MESH_HEAD_BYTES];
    uint64_t size = 0;
    BSQ_PASS(fmt_input_peek(source->input, head, sizeof head, &size));
    return examine(source->ctx, source->input, head, size, source->data);
}

/* ---- equal vertices of one block ---- */

/* A vertex whose place is taken this often is not welded: files could be made whose vertices all
 * have one place. Later stages match vertices by position. */
enum { MOST_PROBES = 256 };

/* The table: entries are numbers of vertices + 1; 0: empty. At most half of them are used. */
struct weld {
    uint64_t mask;
    uint32_t cells[];
};

/* Prepares slot->work and slot->arrays for a block of up to `most` vertices. */
static int begin_weld(struct stream_slot *slot, uint64_t most)
{
    struct mesh_arrays *a = &slot->arrays;
    uint64_t entries = 1024;
    while (entries < 2 * most)
        entries *= 2;
    if (most > UINT32_MAX / 2)
        return bsq_fail(slot->ctx, BSQ_ENOMEM, "a part of an STL file has too many vertices");
    BSQ_PASS(FMT_RESERVE(slot->ctx, sizeof(struct weld) + entries * sizeof(uint32_t), slot->work,
                         slot->work_capacity));
    BSQ_PASS(FMT_RESERVE(slot->ctx, most, a->positions, a->position_capacity));
    struct weld *weld = (struct weld *)(void *)slot->work;
    weld->mask = entries - 1;
    memset(weld->cells, 0, entries * sizeof(uint32_t));
    return 0;
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
static bool is_same(const struct mesh_arrays *a, uint64_t vertex, const double position[3])
{
    /* NOLINTNEXTLINE(bugprone-suspicious-memory-comparison): see above */
    return memcmp(a->positions[vertex], position, sizeof a->positions[vertex]) == 0;
}

/* Returns the number, in the block, of the vertex at this position; adds it if it is new. */
static uint64_t weld_vertex(struct stream_slot *slot, const double position[3])
{
    struct weld *weld = (struct weld *)(void *)slot->work;
    struct mesh_arrays *a = &slot->arrays;
    uint64_t i = hash_position(position) & weld->mask;
    for (int probes = 0; probes < MOST_PROBES && weld->cells[i] != 0; probes++) {
        if (is_same(a, weld->cells[i] - 1, position))
            return weld->cells[i] - 1;
        i = (i + 1) & weld->mask;
    }
    const uint64_t vertex = a->count[FMT_MESH_VERTEX]++;
    if (weld->cells[i] == 0)
        weld->cells[i] = (uint32_t)vertex + 1;
    memcpy(a->positions[vertex], position, sizeof a->positions[vertex]);
    return vertex;
}

/* ---- binary files ---- */

/* Cuts after a number of triangles. What follows the last one becomes a block of its own. */
static int cut_binary(const struct stl_source *file, const struct stream_block *before,
                      struct stream_slot *slot)
{
    uint64_t file_size;
    struct stream_block *block = &slot->block;
    const uint64_t done = before->first_item + before->items, left = file->triangles - done;
    const uint64_t usual = STREAM_BLOCK_BYTES / STL_TRIANGLE_BYTES + 1;
    block->offset = before->end > 0 ? before->end : STL_HEADER_BYTES;
    block->first_item = done;
    block->items = left < usual ? left : usual;
    block->size = block->items * STL_TRIANGLE_BYTES;
    block->end = block->offset + block->size;
    int status = fmt_input_reach(slot->source->input, block->items > 0 ? block->end : UINT64_MAX,
                                 &file_size);
    if (status || (block->items == 0 && block->offset >= file_size))
        return status;
    if (block->items == 0)
        block->end = file_size;
    else if (block->end > file_size)
        fmt_stream_fail(slot, file_size,
                        "truncated: the header counts %" PRIu64 " triangles, the file has %" PRIu64,
                        file->triangles, (file_size - STL_HEADER_BYTES) / STL_TRIANGLE_BYTES);
    return 1;
}

/* Adds triangle number `i` of the block. Returns false if parsing must stop. */
static bool add_triangle(struct stream_slot *slot, uint64_t i)
{
    struct mesh_arrays *a = &slot->arrays;
    const uint8_t *triangle = slot->bytes + i * STL_TRIANGLE_BYTES;
    double position[3];
    float corner[3];
    slot->balance += triangle[49] >> 7; /* VisCAM and SolidView: there is a colour */
    slot->at = slot->block.offset + i * STL_TRIANGLE_BYTES;
    for (uint64_t k = 0; k < 3; k++) {
        memcpy(corner, triangle + 12 * (k + 1), sizeof corner);
        for (int c = 0; c < 3; c++)
            position[c] = (double)corner[c];
        a->corners[FMT_MESH_VERTEX][3 * i + k] = weld_vertex(slot, position);
    }
    a->face_sizes[i] = 3;
    a->corner_count += 3;
    return a->face_count++ != slot->last_face;
}

static int parse_binary(struct stream_slot *slot)
{
    struct mesh_arrays *a = &slot->arrays;
    const uint64_t count = slot->block.items;
    BSQ_PASS(begin_weld(slot, 3 * count));
    BSQ_PASS(FMT_RESERVE(slot->ctx, count, a->face_sizes, a->size_capacity));
    BSQ_PASS(FMT_RESERVE(slot->ctx, 3 * count, a->corners[FMT_MESH_VERTEX],
                         a->corner_capacity[FMT_MESH_VERTEX]));
    for (uint64_t i = 0; i < count; i++)
        if (!add_triangle(slot, i))
            break;
    return 0;
}

/* ---- text ----
 *
 * There may be any number of solids, and words in any case and on any line. Only "vertex" and the
 * ends of loops matter. The name of a solid ends with its line, or before "facet normal", because
 * some files are one line. Files are cut after the word "endfacet". */

/* Returns whether the `size` bytes have "facet normal" at `at`. */
static bool is_facet_normal(const char *text, uint64_t at, uint64_t size)
{
    if (size - at < 5 || strncasecmp(text + at, "facet", 5) != 0)
        return false;
    const uint64_t normal = at + 5 + fmt_mesh_count_space(text + at + 5, size - at - 5);
    return normal > at + 5 && size - normal >= 6 && strncasecmp(text + normal, "normal", 6) == 0;
}

/* Returns whether the word "endfacet" is at `at`. */
static bool is_end_of_facet(const uint8_t *text, uint64_t at)
{
    return (text[at] | 32) == 'e' && strncasecmp((const char *)text + at, "endfacet", 8) == 0 &&
           (at == 0 || text[at - 1] <= ' ');
}

/* Returns the position after the last facet in `size` bytes; 0: there is none. */
static uint64_t find_cut(const uint8_t *text, uint64_t size)
{
    for (uint64_t at = size; at >= 9; at--)
        if (text[at - 1] <= ' ' && is_end_of_facet(text, at - 9))
            return at - 1;
    return 0;
}

/* Returns the bytes of whole facets in loaded text; 0: there are none. */
static uint64_t find_facets(struct stream_slot *slot, uint64_t have, bool at_file_end)
{
    const uint64_t size = at_file_end ? have : find_cut(slot->bytes, have);
    const uint64_t counted = size > 0 ? size : have;
    const uint8_t *text = slot->bytes;
    uint64_t lines = 0;
    for (uint64_t i = 0; i < counted; i++)
        lines += text[i] == '\n';
    slot->block.lines = lines;
    return size;
}

static int cut_text(const struct stream_block *before, struct stream_slot *slot)
{
    slot->block.offset = before->end;
    slot->block.first_line = before->end == 0 ? 1 : before->first_line + before->lines;
    return fmt_stream_cut_text(slot, STREAM_BLOCK_BYTES, find_facets);
}

struct text {
    struct bsq_ctx *ctx;
    struct stream_slot *slot;
    const char *at, *end;
    uint64_t line, facet_line;
    uint64_t size; /* corners of the current loop */
    int status;
};

static bool fail_word(struct text *t, const char *what)
{
    if (t->at >= t->end)
        fmt_stream_fail(t->slot, t->line, "truncated: the file ends within a facet");
    else
        fmt_stream_fail(t->slot, t->line, "\"%s\" is not %s", fmt_mesh_quote_word(t->at).text,
                        what);
    return false;
}

/* Moves to the next word. Returns false at the end of the block. */
static bool next_word(struct text *t)
{
    for (; t->at < t->end && (unsigned char)*t->at <= ' ' && *t->at != '\0'; t->at++)
        t->line += *t->at == '\n';
    return t->at < t->end;
}

/* Skips the word at the current position if it is `word`. */
static bool take(struct text *t, const char *word)
{
    const size_t size = strlen(word);
    if ((*t->at | 32) != *word || strncasecmp(t->at, word, size) != 0 ||
        (unsigned char)t->at[size] > ' ')
        return false;
    t->at += size;
    return true;
}

static bool skip_numbers(struct text *t, int count)
{
    for (int i = 0; i < count; i++) {
        if (!next_word(t))
            return fail_word(t, "");
        while ((unsigned char)*t->at > ' ')
            t->at++;
    }
    return true;
}

static bool read_vertex(struct text *t)
{
    struct mesh_arrays *a = &t->slot->arrays;
    double position[3];
    for (int i = 0; i < 3; i++) {
        next_word(t);
        const char *after = obj_real(t->at, &position[i]);
        if (!after || t->at >= t->end)
            return fail_word(t, "a number");
        t->at = after;
    }
    const uint64_t corner = a->corner_count + t->size;
    t->status = FMT_RESERVE(t->ctx, corner + 1, a->corners[FMT_MESH_VERTEX],
                            a->corner_capacity[FMT_MESH_VERTEX]);
    if (t->status)
        return false;
    a->corners[FMT_MESH_VERTEX][corner] = weld_vertex(t->slot, position);
    t->size++;
    return true;
}

/* Ends a loop. Returns false if parsing must stop. */
static bool finish_loop(struct text *t)
{
    struct mesh_arrays *a = &t->slot->arrays;
    const uint64_t size = t->size;
    t->size = 0;
    if (size < 3) {
        t->slot->short_faces++;
        return true;
    }
    t->status = FMT_RESERVE(t->ctx, a->face_count + 1, a->face_sizes, a->size_capacity);
    if (t->status || size > UINT32_MAX)
        return false;
    a->face_sizes[a->face_count] = (uint32_t)size;
    a->corner_count += size;
    t->slot->at = t->facet_line;
    return a->face_count++ != t->slot->last_face;
}

/* Skips the name of a solid: the rest of the line, or what comes before "facet normal". */
static bool skip_name(struct text *t, int solids)
{
    const uint64_t size = (uint64_t)(t->end - t->at);
    uint64_t at = 0;
    t->slot->balance += solids;
    while (at < size && !fmt_mesh_line_end(t->at + at) &&
           !((unsigned char)t->at[at] <= ' ' && is_facet_normal(t->at, at + 1, size)))
        at++;
    t->at += at;
    return true;
}

/* Reads the statement at the current position. Returns false if parsing must stop. */
static bool read_statement(struct text *t)
{
    if (take(t, "vertex"))
        return read_vertex(t);
    if (take(t, "facet")) {
        t->facet_line = t->line;
        return true;
    }
    if (take(t, "normal"))
        return skip_numbers(t, 3);
    if (take(t, "outer")) {
        t->size = 0;
        return true;
    }
    if (take(t, "loop") || take(t, "endfacet"))
        return true;
    if (take(t, "endloop"))
        return finish_loop(t);
    if (take(t, "solid"))
        return skip_name(t, 1);
    return take(t, "endsolid") ? skip_name(t, -1) : fail_word(t, "a word of STL files");
}

static int parse_text(struct stream_slot *slot)
{
    /* "vertex 0 0 0" takes 13 bytes. */
    BSQ_PASS(begin_weld(slot, slot->block.size / 13 + 1));
    memset(slot->bytes + slot->block.size, 0, STREAM_PADDING);
    slot->bytes[slot->block.size] = '\n';
    struct text t = {.ctx = slot->ctx,
                     .slot = slot,
                     .at = (const char *)slot->bytes,
                     .end = (const char *)slot->bytes + slot->block.size,
                     .line = slot->block.first_line};
    enum { STATEMENTS_A_CHECK = 4096 };
    bool more = true;
    if (slot->block.offset == 0)
        t.at += fmt_mesh_mark(t.at, slot->block.size);
    for (uint64_t i = 0; more && next_word(&t); i++) {
        if (i % STATEMENTS_A_CHECK == 0 && (t.status = bsq_check(slot->ctx)) != 0)
            return t.status;
        more = read_statement(&t);
    }
    if (more && t.size > 0)
        fail_word(&t, "");
    return t.status;
}

/* ---- reading ---- */

static int cut(const struct stream_block *before, struct stream_slot *slot)
{
    const struct stl_source *file = slot->source->data;
    return file->text ? cut_text(before, slot) : cut_binary(file, before, slot);
}

static int parse(struct stream_slot *slot)
{
    const struct stl_source *file = slot->source->data;
    slot->local = 1u << FMT_MESH_VERTEX;
    BSQ_PASS(fmt_stream_load(slot));
    const int status = file->text ? parse_text(slot) : parse_binary(slot);
    slot->arrays.vertex_bound = slot->arrays.count[FMT_MESH_VERTEX];
    return status;
}

/* Warns of bytes after the last triangle. */
static int pass(struct stream_slot *slot)
{
    const struct stream_source *source = slot->source;
    struct stl_source *file = source->data;
    file->odd = slot->balance + (slot->block.offset > 0 ? file->odd : 0);
    if (!file->text && slot->block.items == 0 && !source->reader->read_before)
        return bsq_warn_loss(source->ctx, "%s: %" PRIu64 " bytes after the last triangle not read",
                             source->path, slot->block.end - slot->block.offset);
    return 0;
}

static int finish(struct stream_source *source)
{
    const struct stl_source *file = source->data;
    if (file->odd <= 0 || source->reader->read_before)
        return 0;
    if (file->text)
        return bsq_warn_loss(source->ctx, "%s: \"endsolid\" is missing: the file may be incomplete",
                             source->path);
    return bsq_warn_loss(source->ctx, "%s: colours of STL files are not read: those of PLY are",
                         source->path);
}

static int look(struct stream_source *source, struct fmt_mesh_hints *out)
{
    (void)source;
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
    .look = look,
};
