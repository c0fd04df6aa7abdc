/* stl_text.c - STL files in text: any number of solids, words in any case and on any line.
 *
 * Only "vertex" and the ends of loops matter. The name of a solid ends with its line, or before
 * "facet normal", because some files are one line. Files are cut after a line that begins with
 * "endfacet", or between "endfacet" and "facet normal". */
#include <math.h>
#include <string.h>
#include <strings.h>

#include "formats/mesh/mesh_text.h"
#include "formats/mesh/obj_number.h"
#include "formats/mesh/stl_internal.h"

enum { STATEMENTS_A_CHECK = 4096 };

/* ---- cutting ---- */

static bool is_line_end(uint8_t c)
{
    return c == '\n' || c == '\r';
}

/* Returns the position of the first character from `at` on that is no blank, at most `size`. */
static uint64_t skip_blanks(const uint8_t *text, uint64_t at, uint64_t size)
{
    return at + fmt_mesh_count_space(text + at, size - at);
}

static bool is_number(const uint8_t *text, uint64_t size)
{
    static const char first[13] = "+-.0123456789";
    return size >= 3 && (memchr(first, text[0], sizeof first) ||
                         strncasecmp((const char *)text, "nan", 3) == 0 ||
                         strncasecmp((const char *)text, "inf", 3) == 0);
}

/* Returns whether the `size` bytes have "facet normal" and a number at `at`. */
static bool is_facet_normal(const uint8_t *text, uint64_t at, uint64_t size)
{
    if (size - at < 5 || strncasecmp((const char *)text + at, "facet", 5) != 0)
        return false;
    const uint64_t normal = skip_blanks(text, at + 5, size);
    if (normal == at + 5 || size - normal < 6 ||
        strncasecmp((const char *)text + normal, "normal", 6) != 0)
        return false;
    const uint64_t number = skip_blanks(text, normal + 6, size);
    return number > normal + 6 && is_number(text + number, size - number);
}

/* Returns whether a facet ends with the word "endfacet" at `at`, which ends before a blank. */
static bool is_end_of_facet(const uint8_t *text, uint64_t at, uint64_t size)
{
    if ((text[at] | 32) != 'e' || strncasecmp((const char *)text + at, "endfacet", 8) != 0 ||
        (at > 0 && text[at - 1] > ' '))
        return false;
    if (is_facet_normal(text, skip_blanks(text, at + 8, size), size))
        return true;
    while (at > 0 && (text[at - 1] == ' ' || text[at - 1] == '\t'))
        at--;
    return at == 0 || is_line_end(text[at - 1]);
}

/* Returns the position after the last facet in `size` bytes; 0: there is none. */
static uint64_t find_cut(const uint8_t *text, uint64_t size)
{
    for (uint64_t at = size; at >= 9; at--)
        if (text[at - 1] <= ' ' && is_end_of_facet(text, at - 9, size))
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
    slot->part.lines = lines;
    return size;
}

int fmt_stl_cut_text(const struct stream_part *before, struct stream_slot *slot)
{
    slot->part.offset = before->end;
    slot->part.first_line = before->end == 0 ? 1 : before->first_line + before->lines;
    return fmt_stream_cut_text(slot, find_facets);
}

/* ---- parsing ---- */

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

/* Moves to the next word. Returns false at the end of the part. */
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
    if (strncasecmp(t->at, word, size) != 0 || (unsigned char)t->at[size] > ' ')
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
    if (isnan(position[0] + position[1] + position[2]))
        position[0] = position[1] = position[2] = NAN;
    const uint64_t corner = a->corner_count + t->size;
    t->status = FMT_RESERVE(t->ctx, corner + 1, a->corners[FMT_MESH_VERTEX],
                            a->corner_capacity[FMT_MESH_VERTEX]);
    if (t->status)
        return false;
    a->corners[FMT_MESH_VERTEX][corner] = fmt_stl_weld(t->slot, position, NULL);
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
    const uint8_t *text = (const uint8_t *)t->at;
    const uint64_t size = (uint64_t)(t->end - t->at);
    uint64_t at = 0;
    t->slot->balance += solids;
    while (at < size && !is_line_end(text[at]) &&
           !(text[at] <= ' ' && is_facet_normal(text, at + 1, size)))
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

int fmt_stl_parse_text(struct stream_slot *slot)
{
    /* "vertex 0 0 0" takes 13 bytes. */
    int status = fmt_stl_begin_weld(slot, slot->part.size / 13 + 1);
    if (status)
        return status;
    memset(slot->bytes + slot->part.size, 0, STREAM_PADDING);
    slot->bytes[slot->part.size] = '\n';
    struct text t = {.ctx = slot->ctx,
                     .slot = slot,
                     .at = (const char *)slot->bytes,
                     .end = (const char *)slot->bytes + slot->part.size,
                     .line = slot->part.first_line};
    bool more = true;
    if (slot->part.offset == 0)
        t.at += fmt_mesh_mark(t.at, slot->part.size);
    for (uint64_t i = 0; more && next_word(&t); i++) {
        if (i % STATEMENTS_A_CHECK == 0 && (t.status = bsq_check(slot->ctx)) != 0)
            return t.status;
        more = read_statement(&t);
    }
    if (more && t.size > 0)
        fail_word(&t, "");
    return t.status;
}
