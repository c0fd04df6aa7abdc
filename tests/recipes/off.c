/* off.c - the example of formats/mesh/README.md: reads OFF files as an ordered stream of parsed
 * blocks.
 *
 * A file is "OFF", a line with its numbers of vertices, faces and edges, a line "x y z" for each
 * vertex, and a line "3 i j k" for each face, of any size. What follows in a line is not read.
 * Lines may be blank or begin with "#". */
#include <inttypes.h>
#include <string.h>

#include "formats/mesh/mesh_format.h"
#include "formats/mesh/mesh_text.h"
#include "formats/mesh/obj_number.h"

/* What the reader keeps of a file: source->data. */
struct off_file {
    uint64_t vertices, faces, header_bytes, header_lines;
};

/* ---- opening ---- */

static bool off_recognise(const char *head, size_t size)
{
    return size >= 4 && memcmp(head, "OFF", 3) == 0 && fmt_mesh_line_end(head + 3) > 0;
}

static const char *off_next_line(const char *p, uint64_t *lines)
{
    while (!fmt_mesh_line_end(p))
        p++;
    ++*lines;
    return p + fmt_mesh_line_end(p);
}

static const char *off_skip_blanks(const char *p)
{
    while (fmt_mesh_is_blank(*p))
        p++;
    return p;
}

static bool off_is_empty(const char *line)
{
    line = off_skip_blanks(line);
    return *line == '#' || fmt_mesh_line_end(line) > 0;
}

static int off_begin(struct stream_source *source)
{
    struct off_file *file = source->data;
    char head[FMT_MESH_HEAD_BYTES + OBJ_TEXT_PADDING];
    uint64_t size;
    int status = fmt_input_peek(source->input, head, FMT_MESH_HEAD_BYTES, &size);
    if (status)
        return status;
    memset(head + size, '\n', sizeof head - size);
    const char *p = off_next_line(head, &file->header_lines);
    while (p < head + size && off_is_empty(p))
        p = off_next_line(p, &file->header_lines);
    const char *after = obj_integer(off_skip_blanks(p), &file->vertices);
    if (after)
        after = obj_integer(off_skip_blanks(after), &file->faces);
    if (!after || !off_recognise(head, size))
        return bsq_fail(source->ctx, BSQ_EDATA, "%s:%" PRIu64 ": not the numbers of an OFF file",
                        source->path, file->header_lines + 1);
    file->header_bytes = (uint64_t)(off_next_line(after, &file->header_lines) - head);
    return 0;
}

/* ---- cutting ---- */

/* Counts the elements in whole lines of the loaded text. Returns the bytes of these lines. */
static uint64_t off_find_lines(struct stream_slot *slot, uint64_t have, bool at_file_end)
{
    const struct off_file *file = slot->source->data;
    struct stream_block *block = &slot->block;
    const uint64_t most = file->vertices + file->faces - block->first_item;
    const char *from = (const char *)slot->bytes, *end = from + have, *p = from;
    block->items = block->lines = 0;
    memset(slot->bytes + have, '\n', STREAM_PADDING);
    while (block->items < most && p < end) {
        const bool empty = off_is_empty(p);
        uint64_t lines = 0;
        const char *next = off_next_line(p, &lines);
        if (next >= end && !at_file_end)
            break;
        block->items += !empty;
        block->lines += lines;
        p = next < end ? next : end;
    }
    return block->items > 0 ? (uint64_t)(p - from) : 0;
}

static int off_cut(const struct stream_block *before, struct stream_slot *slot)
{
    const struct off_file *file = slot->source->data;
    struct stream_block *block = &slot->block;
    const bool at_start = before->end == 0;
    uint64_t size;
    block->offset = at_start ? file->header_bytes : before->end;
    block->first_line = at_start ? file->header_lines + 1 : before->first_line + before->lines;
    block->first_item = before->first_item + before->items; /* vertices, then faces */
    int status = 0;
    if (block->first_item < file->vertices + file->faces) {
        status = fmt_stream_cut_text(slot, STREAM_BLOCK_BYTES, off_find_lines);
        if (status != 0)
            return status;
        fmt_stream_fail(slot, block->first_line,
                        "truncated: the file ends after %" PRIu64 " of %" PRIu64 " elements",
                        block->first_item, file->vertices + file->faces);
    }
    /* What follows the last element becomes a block without elements. */
    BSQ_TRY(fmt_input_reach(slot->source->input, UINT64_MAX, &size));
    block->items = block->size = 0;
    block->end = size;
    status = slot->error[0] || block->offset < size;
done:
    return status;
}

/* ---- parsing ---- */

static const char *off_fail_word(struct stream_slot *slot, uint64_t line, const char *p)
{
    fmt_stream_fail(slot, line, "\"%s\" is not a number", fmt_mesh_quote_word(p).text);
    return NULL;
}

static const char *off_parse_vertex(struct stream_slot *slot, uint64_t line, const char *p)
{
    struct mesh_arrays *a = &slot->arrays;
    for (int i = 0; i < 3; i++) {
        const char *word = off_skip_blanks(p);
        p = obj_real(word, &a->positions[a->count[FMT_MESH_VERTEX]][i]);
        if (!p)
            return off_fail_word(slot, line, word);
    }
    a->count[FMT_MESH_VERTEX]++;
    return p;
}

static const char *off_parse_face(struct stream_slot *slot, uint64_t line, const char *p)
{
    struct mesh_arrays *a = &slot->arrays;
    const char *word = off_skip_blanks(p);
    uint64_t size, *corners = a->corners[FMT_MESH_VERTEX] + a->corner_count;
    p = obj_integer(word, &size);
    for (uint64_t i = 0; p && i < size; i++) {
        word = off_skip_blanks(p);
        p = obj_integer(word, &corners[i]);
    }
    if (!p)
        return off_fail_word(slot, line, word);
    if (size < 3 || size > UINT32_MAX) {
        slot->short_faces++;
        return p;
    }
    a->face_sizes[a->face_count++] = (uint32_t)size;
    a->corner_count += size;
    slot->at = line;
    return p;
}

static int off_parse(struct stream_slot *slot)
{
    const struct off_file *file = slot->source->data;
    const struct stream_block *block = &slot->block;
    struct mesh_arrays *a = &slot->arrays;
    uint64_t line = block->first_line, item = block->first_item;
    int status;
    if (block->items == 0)
        return 0;
    BSQ_TRY(fmt_stream_load(slot));
    /* A number takes two bytes at least. */
    BSQ_TRY(FMT_RESERVE(slot->ctx, block->items, a->positions, a->position_capacity));
    BSQ_TRY(FMT_RESERVE(slot->ctx, block->items, a->face_sizes, a->size_capacity));
    BSQ_TRY(FMT_RESERVE(slot->ctx, block->size / 2 + 1, a->corners[FMT_MESH_VERTEX],
                        a->corner_capacity[FMT_MESH_VERTEX]));
    memset(slot->bytes + block->size, '\n', STREAM_PADDING);
    const char *p = (const char *)slot->bytes, *end = p + block->size;
    while (p < end && a->face_count <= slot->last_face) {
        if (!off_is_empty(p)) {
            p = item++ < file->vertices ? off_parse_vertex(slot, line, p)
                                        : off_parse_face(slot, line, p);
            if (!p)
                break; /* slot->error says why */
        }
        p = off_next_line(p, &line);
    }
done:
    return status;
}

/* ---- the format ---- */

static int off_look(struct stream_source *source, struct fmt_mesh_hints *out)
{
    (void)source, (void)out;
    return 0; /* no texture coordinates, and faces come last */
}

const struct fmt_mesh_format fmt_off_format = {
    .name = "OFF",
    .suffix = ".off",
    .data_bytes = sizeof(struct off_file),
    .oddities = {[STREAM_NO_POSITION] = "positions are not finite and were left out"},
    .recognise = off_recognise,
    .begin = off_begin,
    .cut = off_cut,
    .parse = off_parse,
    .look = off_look,
};
