/* ply_text.c - parses parts of PLY files in text: one line for each element. */
#include <inttypes.h>
#include <math.h>

#include "formats/mesh/mesh_text.h"
#include "formats/mesh/obj_number.h"
#include "formats/mesh/ply_internal.h"

/* A position in the part. `line` counts from the start of the file. */
struct text {
    const struct ply_source *source;
    struct stream_slot *slot;
    const char *at, *end;
    uint64_t line;
    char line_end;
};

static const char *skip_blanks(const struct text *t, const char *p)
{
    while ((*p == ' ' || *p == '\t' || *p == '\r' || *p == '\v' || *p == '\f' || *p == '\n') &&
           *p != t->line_end)
        p++;
    return p;
}

static bool fail_word(struct text *t, const char *what)
{
    const char *end = t->at;
    char quoted[44];
    while ((unsigned char)*end > ' ')
        end++;
    fmt_mesh_quote(t->at, end, quoted, sizeof quoted);
    if (*t->at == t->line_end)
        fmt_stream_fail(t->slot, t->line, "the line ends before %s; each element must be a line",
                        what);
    else
        fmt_stream_fail(t->slot, t->line, "\"%s\" is not %s", quoted, what);
    return false;
}

static bool read_real(struct text *t, double *out)
{
    t->at = skip_blanks(t, t->at);
    const char *after = obj_number(t->at, out);
    if (!after) {
        after = fmt_obj_not_finite(t->at);
        *out = NAN;
    }
    if (!after || *t->at == t->line_end)
        return fail_word(t, "a number");
    t->at = after;
    return true;
}

static bool read_integer(struct text *t, int64_t *out)
{
    uint64_t value = 0;
    t->at = skip_blanks(t, t->at);
    const bool negative = *t->at == '-';
    const char *after = obj_integer(t->at + negative, &value);
    if (!after || (unsigned char)*after > ' ')
        return fail_word(t, "an integer");
    *out = negative ? -(int64_t)value : (int64_t)value;
    t->at = after;
    return true;
}

/* Skips a number that is not read, whatever it is. */
static bool skip_word(struct text *t)
{
    t->at = skip_blanks(t, t->at);
    if (*t->at == t->line_end)
        return fail_word(t, "its last number");
    while ((unsigned char)*t->at > ' ')
        t->at++;
    return *t->at != '\0' || t->at == t->end || fail_word(t, "text");
}

/* Reads the length of a list. The rest of the part must be long enough for it. */
static bool read_length(struct text *t, uint64_t *out)
{
    int64_t length = 0;
    if (!read_integer(t, &length))
        return false;
    *out = (uint64_t)length;
    if (length >= 0 && *out <= (uint64_t)(t->end - t->at) / 2)
        return true;
    fmt_stream_fail(t->slot, t->line, "a list of %" PRId64 " numbers%s", length,
                    length < 0 ? "" : " is longer than the text");
    return false;
}

static bool skip_property(struct text *t, const struct ply_property *p)
{
    uint64_t length = 1;
    if (p->count_type != PLY_NO_TYPE && !read_length(t, &length))
        return false;
    for (uint64_t i = 0; i < length; i++)
        if (!skip_word(t))
            return false;
    return true;
}

/* ---- elements ---- */

static bool read_vertex(struct text *t, const struct ply_element *element, uint64_t vertex)
{
    const struct ply_property *p = t->source->header.properties + element->first_property;
    for (uint32_t i = 0; i < element->property_count; i++, p++) {
        double value;
        if (p->role == PLY_UNUSED || p->role == PLY_ALPHA) {
            if (!skip_property(t, p))
                return false;
            continue;
        }
        if (!read_real(t, &value))
            return false;
        fmt_ply_store_vertex(&t->slot->arrays, vertex, p, value);
    }
    return true;
}

static bool read_indices(struct text *t, struct ply_face *face)
{
    uint64_t length;
    int64_t index = 0;
    if (!read_length(t, &length))
        return false;
    for (uint64_t i = 0; i < length; i++)
        if (!read_integer(t, &index) || !fmt_ply_add_index(t->slot, face, index))
            return false;
    return true;
}

static bool read_texcoords(struct text *t, struct ply_face *face)
{
    double value;
    if (!read_length(t, &face->texcoords))
        return false;
    for (uint64_t i = 0; i < face->texcoords; i++) {
        if (!read_real(t, &value))
            return false;
        fmt_ply_add_texcoord(t->slot, i, value);
    }
    return true;
}

static bool read_face(struct text *t, const struct ply_element *element)
{
    const struct ply_property *p = t->source->header.properties + element->first_property;
    struct ply_face face = ply_face_at(t->line);
    for (uint32_t i = 0; i < element->property_count; i++, p++) {
        double value;
        bool good;
        if (p->role == PLY_INDICES) {
            good = read_indices(t, &face);
        } else if (p->role == PLY_CORNER_TEXCOORDS) {
            good = read_texcoords(t, &face);
        } else if (p->role == PLY_UNUSED || p->role == PLY_ALPHA) {
            good = skip_property(t, p);
        } else {
            good = read_real(t, &value);
            if (good)
                fmt_ply_set_material(&face, p, value);
        }
        if (!good)
            return false;
    }
    return fmt_ply_finish_face(t->source, t->slot, &face);
}

static bool read_strip(struct text *t)
{
    struct ply_strip strip = {0};
    uint64_t length;
    int64_t index = 0;
    if (!read_length(t, &length))
        return false;
    for (uint64_t i = 0; i < length; i++)
        if (!read_integer(t, &index) ||
            !fmt_ply_add_to_strip(t->source, t->slot, &strip, index, t->line))
            return false;
    return true;
}

/* ---- lines ---- */

/* Moves to the next line with text. Returns false if there is none. */
static bool next_line(struct text *t)
{
    for (; t->at < t->end; t->at++, t->line++) {
        t->at = skip_blanks(t, t->at);
        if (*t->at != t->line_end)
            return t->at < t->end;
    }
    return false;
}

static bool finish_line(struct text *t)
{
    t->at = skip_blanks(t, t->at);
    if (*t->at != t->line_end)
        return fail_word(t, "expected: each element must be a line");
    t->at++;
    t->line++;
    return true;
}

static bool read_element(struct text *t, const struct ply_element *element, uint64_t number)
{
    if (element->kind == PLY_VERTICES)
        return read_vertex(t, element, number);
    return element->kind == PLY_FACES ? read_face(t, element) : read_strip(t);
}

int fmt_ply_parse_text(const struct ply_element *element, struct stream_slot *slot)
{
    const struct ply_source *source = slot->source->data;
    struct text t = {.source = source,
                     .slot = slot,
                     .at = (const char *)slot->bytes,
                     .end = (const char *)slot->bytes + slot->part.size,
                     .line = slot->part.first_line,
                     .line_end = source->header.line_end};
    uint64_t count = 0;
    int status = fmt_ply_reserve(element, slot, slot->part.size / 2 + 1);
    if (status)
        return status;
    memset(slot->bytes + slot->part.size, 0, STREAM_PADDING);
    slot->bytes[slot->part.size] = (uint8_t)t.line_end;
    while (next_line(&t) && read_element(&t, element, count) && finish_line(&t))
        count++;
    if (element->kind == PLY_VERTICES)
        fmt_ply_finish_vertices(element, slot, count);
    return 0;
}
