/* ply_cut.c - cuts PLY files into parts of some thousand elements.
 *
 * Binary elements without lists have equal sizes, so their parts need not be loaded here. The sizes
 * of others are found by walking over their lists. Text is cut by counting lines. A strip of
 * triangles can be longer than all memory: its list is cut into pieces, each of which begins with
 * the two indices before it. */
#include <inttypes.h>

#include "formats/mesh/mesh_text.h"
#include "formats/mesh/ply_internal.h"

/* The state of one cut. */
struct cutter {
    struct bsq_ctx *ctx;
    const struct stream_source *source;
    const struct ply_header *header;
    const struct ply_element *element;
    struct stream_slot *slot;
    struct stream_part *part; /* of the slot */
    uint64_t limit;           /* elements that are left */
    uint64_t have;            /* bytes loaded */
    bool at_file_end;         /* the file ends with them, for certain */
    bool swap;
};

static uint64_t smaller(uint64_t a, uint64_t b)
{
    return a < b ? a : b;
}

/* Loads `size` bytes from the part's start on, or fewer at the end of the file. */
static int load(struct cutter *c, uint64_t size)
{
    return fmt_stream_extend(c->slot, c->have, size, &c->have, &c->at_file_end);
}

/* Returns the bytes of the file, as far as they are known: there may be more. */
static uint64_t known_size(const struct cutter *c)
{
    const uint64_t size = fmt_input_size(c->source->input);
    return size < UINT64_MAX ? size : c->part->offset + c->have;
}

/* Makes a part of the first `items` elements, which take `size` loaded bytes. */
static int take(struct cutter *c, uint64_t items, uint64_t size)
{
    c->part->items = items;
    c->part->size = size;
    c->part->end = c->part->offset + size;
    c->slot->loaded = true;
    return 1;
}

static int fail_truncated(struct cutter *c)
{
    c->part->end = known_size(c);
    fmt_stream_fail(c->slot,
                    c->part->first_line ? c->part->first_line + c->part->lines : c->part->end,
                    "truncated: the file ends after %" PRIu64 " of %" PRIu64 " elements \"%.40s\"",
                    c->part->first_item, c->element->count, c->element->name);
    return 1;
}

/* ---- binary ---- */

/* Cuts elements of equal size. Elements that are not read become one part. */
static int cut_equal(struct cutter *c)
{
    const uint64_t each = c->element->least_bytes, usual = STREAM_PART_BYTES / each;
    uint64_t items = smaller(c->limit, usual > 0 ? usual : 1), end, file_size;
    if (c->element->kind == PLY_OTHER)
        items = c->limit;
    if (__builtin_mul_overflow(items, each, &end) ||
        __builtin_add_overflow(end, c->part->offset, &end))
        end = UINT64_MAX;
    int status = fmt_input_reach(c->source->input, end, &file_size);
    if (status)
        return status;
    if (end > file_size || end == UINT64_MAX)
        return fail_truncated(c);
    take(c, items, items * each);
    c->slot->loaded = false;
    return 1;
}

/* Returns the bytes of the element at `from`, where `have` bytes are loaded. Returns 0 if they are
 * too few, or if a list has a negative length; then the slot has an error. */
static uint64_t element_bytes(struct cutter *c, const uint8_t *from, uint64_t have)
{
    const struct ply_property *p = c->header->properties + c->element->first_property;
    uint64_t at = 0;
    for (uint32_t i = 0; i < c->element->property_count; i++, p++) {
        uint64_t each = fmt_ply_type_bytes[p->type];
        if (p->count_type == PLY_NO_TYPE) {
            at += each;
        } else {
            uint64_t prefix = fmt_ply_type_bytes[p->count_type];
            if (have < at || have - at < prefix)
                return 0;
            int64_t length = ply_integer(from + at, p->count_type, c->swap);
            if (length < 0) {
                fmt_stream_fail(c->slot, c->part->offset + (uint64_t)(from - c->slot->bytes) + at,
                                "a list of %" PRId64 " numbers", length);
                return 0;
            }
            at += prefix;
            if ((uint64_t)length > (have - at) / each)
                return 0;
            at += (uint64_t)length * each;
        }
        if (at > have)
            return 0;
    }
    return at;
}

/* Returns how many elements from byte `at` on are triangles, of at most `limit`. It knows only
 * elements with one list, whose length is one byte; most scans have no others. *each: bytes of such
 * a triangle. */
static uint64_t count_triangles(const struct cutter *c, uint64_t at, uint64_t limit, uint64_t *each)
{
    const struct ply_property *p = c->element->role[PLY_INDICES];
    uint64_t items = 0;
    *each = 0;
    if (c->element->list_count != 1 || !p || fmt_ply_type_bytes[p->count_type] != 1)
        return 0;
    *each = c->element->least_bytes + 3 * (uint64_t)fmt_ply_type_bytes[p->type];
    const uint8_t *length = c->slot->bytes + at + p->offset;
    limit = smaller(limit, (c->have - at) / *each);
    for (; items < limit && *length == 3; items++)
        length += *each;
    return items;
}

/* Returns how many of the loaded elements are whole. *size: their bytes. */
static uint64_t count_whole(struct cutter *c, uint64_t *size)
{
    uint64_t items = 0, at = 0, each;
    while (items < c->limit) {
        const uint64_t triangles = count_triangles(c, at, c->limit - items, &each);
        at += triangles * each;
        items += triangles;
        if (items == c->limit)
            break;
        uint64_t bytes = element_bytes(c, c->slot->bytes + at, c->have - at);
        if (bytes == 0)
            break;
        at += bytes;
        items++;
    }
    *size = at;
    return items;
}

static int cut_piece(struct cutter *c, uint32_t run, uint64_t left);

/* Begins to cut the list of one strip into pieces. */
static int begin_pieces(struct cutter *c)
{
    const struct ply_property *p = c->element->role[PLY_INDICES];
    const uint64_t prefix = fmt_ply_type_bytes[p->count_type];
    uint64_t length = (uint64_t)ply_integer(c->slot->bytes, p->count_type, c->swap);
    c->part->offset += prefix;
    c->have = 0;
    if (length > (fmt_input_size(c->source->input) - c->part->offset) / fmt_ply_type_bytes[p->type])
        return fail_truncated(c);
    return cut_piece(c, 0, length);
}

/* Cuts elements with lists. Loads more if not even the first one is whole. */
static int cut_lists(struct cutter *c)
{
    uint64_t size, items, wanted = STREAM_PART_BYTES;
    for (;; wanted *= 2) {
        int status = load(c, wanted);
        if (status)
            return status;
        items = count_whole(c, &size);
        if (items > 0 || c->slot->error[0] || c->at_file_end || c->element->kind == PLY_STRIPS)
            break;
        if ((status = bsq_check(c->ctx)))
            return status;
    }
    if (items > 0) {
        /* What is wrong with the next element is reported with the next part. */
        c->slot->error[0] = '\0';
        return take(c, items, size);
    }
    if (c->slot->error[0]) {
        c->part->end = known_size(c);
        return 1;
    }
    return c->element->kind == PLY_STRIPS && !c->at_file_end ? begin_pieces(c) : fail_truncated(c);
}

/* Returns the state of a strip after the loaded items, see struct ply_strip. */
static uint32_t run_after(const struct cutter *c, uint64_t items, uint32_t run)
{
    const enum ply_type type = c->element->role[PLY_INDICES]->type;
    const uint32_t each = fmt_ply_type_bytes[type];
    uint64_t since = 0;
    while (since < items &&
           ply_integer(c->slot->bytes + (items - since - 1) * each, type, c->swap) >= 0)
        since++;
    if (since == items) /* the first items are the end of the piece before */
        since += run - smaller(run, 2);
    return (uint32_t)(since < 2 ? since : 2 + since % 2);
}

/* Cuts the next piece of a list with `left` more items. run: the state of the strip before it. */
static int cut_piece(struct cutter *c, uint32_t run, uint64_t left)
{
    const uint64_t each = fmt_ply_type_bytes[c->element->role[PLY_INDICES]->type];
    const uint64_t repeated = smaller(run, 2), items = smaller(left, STREAM_PART_BYTES / each);
    c->part->offset -= repeated * each;
    int status = load(c, (repeated + items) * each);
    if (status)
        return status;
    if (c->have < (repeated + items) * each)
        return fail_truncated(c);
    take(c, items == left, (repeated + items) * each);
    c->part->kind |= PLY_PART_PIECE;
    c->part->left = left - items;
    c->part->carry = run;
    c->part->carry_out = run_after(c, repeated + items, run);
    return 1;
}

/* ---- text ---- */

/* Counts the elements in whole lines of the loaded text. Returns the bytes of these lines. */
static uint64_t find_lines(struct stream_slot *slot, uint64_t have, bool at_file_end)
{
    const struct ply_header *header = &((struct ply_source *)slot->source->data)->header;
    struct stream_part *part = &slot->part;
    const uint64_t most = header->elements[part->kind].count - part->first_item;
    const uint8_t *from = slot->bytes, *limit = from + have;
    part->items = part->lines = 0;
    while (part->items < most && from < limit) {
        const uint8_t *end = memchr(from, header->line_end, (size_t)(limit - from));
        if (!end && !at_file_end)
            break;
        end = end ? end : limit;
        part->items += from + fmt_mesh_count_space(from, (uint64_t)(end - from)) < end;
        part->lines++;
        from = end < limit ? end + 1 : end;
    }
    return part->items > 0 ? (uint64_t)(from - slot->bytes) : 0;
}

static int cut_text(struct cutter *c)
{
    int status = fmt_stream_cut_text(c->slot, find_lines);
    if (status != 0)
        return status;
    return fail_truncated(c);
}

/* ---- the next part ---- */

/* Finds the element after `items` ones of element number `number`. Sets c->element and c->limit.
 * Returns false if there is none. */
static bool find_element(struct cutter *c, uint32_t number, uint64_t items)
{
    for (; number < c->header->element_count; number++, items = 0) {
        c->element = &c->header->elements[number];
        c->limit = c->element->count - items;
        c->part->kind = number;
        c->part->first_item = items;
        if (c->limit > 0 && c->element->property_count > 0)
            return true;
    }
    return false;
}

/* What follows the last element becomes a part without elements. */
static int cut_rest(struct cutter *c)
{
    uint64_t file_size;
    int status = fmt_input_reach(c->source->input, UINT64_MAX, &file_size);
    if (status || c->part->offset >= file_size)
        return status;
    c->part->kind = PLY_PART_REST;
    c->part->end = file_size;
    return 1;
}

int fmt_ply_cut(const struct stream_part *before, struct stream_slot *slot)
{
    const struct ply_header *header = &((struct ply_source *)slot->source->data)->header;
    struct cutter c = {.ctx = slot->ctx,
                       .source = slot->source,
                       .header = header,
                       .slot = slot,
                       .part = &slot->part,
                       .swap = header->encoding == PLY_BIG_ENDIAN};
    const bool at_start = before->end == 0, text = header->encoding == PLY_ASCII;
    if (before->kind == PLY_PART_REST)
        return 0;
    c.part->offset = at_start ? header->bytes : before->end;
    if (text)
        c.part->first_line = at_start ? header->lines + 1 : before->first_line + before->lines;
    if (!find_element(&c, before->kind & ~PLY_PART_PIECE, before->first_item + before->items))
        return cut_rest(&c);
    if (before->left > 0)
        return cut_piece(&c, before->carry_out, before->left);
    if (text)
        return cut_text(&c);
    return c.element->list_count > 0 ? cut_lists(&c) : cut_equal(&c);
}
