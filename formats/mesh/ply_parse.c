/* ply_parse.c - turns blocks of PLY files into vertices and faces.
 *
 * Text and binary files differ only in how the next number is read. Vertices of equal size are
 * converted property by property, in loops over the whole block, and runs of triangles without
 * other properties by a loop of their own, as most scans have nothing else. */
#include <inttypes.h>
#include <math.h>

#include "formats/mesh/mesh_text.h"
#include "formats/mesh/obj_number.h"
#include "formats/mesh/ply_internal.h"

/* No file can have this many elements of a kind; callers compare indices as signed numbers. */
#define INDEX_LIMIT ((uint64_t)1 << 61)

/* Where the values of a property go: that of vertex i to doubles[i * step] or floats[i * 3]. Both
 * are NULL if the property is not read. */
struct column {
    double *doubles;
    float *floats;
    uint64_t step;
};

/* A position in a block. */
struct cursor {
    const struct ply_source *source;
    struct stream_slot *slot;
    struct mesh_arrays *arrays; /* of the slot */
    const uint8_t *at, *end;
    uint64_t line; /* of text, from the start of the file */
    char line_end; /* of text, which follows the block */
    bool text, swap;
    int status;
    struct column columns[PLY_ROLE_COUNT]; /* of vertices */
};

/* A face while it is read. Its indices are stored after the last corner, its texture coordinates
 * after the last texture coordinate. */
struct face {
    uint64_t size;      /* indices */
    uint64_t texcoords; /* numbers in its list of texture coordinates */
    int64_t texture;
    double color[3]; /* 0 to 255 */
    bool clamped;    /* a colour was not in this range */
    uint64_t at;     /* line or byte */
};

/* ---- numbers ---- */

/* Returns the line, or the byte of the file, at the cursor. */
static uint64_t place(const struct cursor *c)
{
    return c->text ? c->line : c->slot->block.offset + (uint64_t)(c->at - c->slot->bytes);
}

static bool at_line_end(const struct cursor *c)
{
    return (char)*c->at == c->line_end;
}

static void skip_blanks(struct cursor *c)
{
    const uint8_t *at = c->at;
    while (fmt_mesh_is_space((char)*at) && (char)*at != c->line_end)
        at++;
    c->at = at;
}

static bool fail_word(const struct cursor *c, const char *what)
{
    if (at_line_end(c))
        fmt_stream_fail(c->slot, c->line, "the line ends before %s; each element must be a line",
                        what);
    else
        fmt_stream_fail(c->slot, c->line, "\"%s\" is not %s",
                        fmt_mesh_quote_word((const char *)c->at).text, what);
    return false;
}

static bool read_real_word(struct cursor *c, double *out)
{
    skip_blanks(c);
    const char *after = obj_real((const char *)c->at, out);
    if (!after)
        return fail_word(c, "a number");
    c->at = (const uint8_t *)after;
    return true;
}

static bool read_integer_word(struct cursor *c, int64_t *out)
{
    uint64_t value = 0;
    skip_blanks(c);
    const bool negative = *c->at == '-';
    const char *after = obj_integer((const char *)c->at + negative, &value);
    if (!after || (unsigned char)*after > ' ')
        return fail_word(c, "an integer");
    *out = negative ? -(int64_t)value : (int64_t)value;
    c->at = (const uint8_t *)after;
    return true;
}

/* Skips a number that is not read, whatever it is. */
static bool skip_word(struct cursor *c)
{
    skip_blanks(c);
    if (at_line_end(c))
        return fail_word(c, "its last number");
    while (*c->at > ' ')
        c->at++;
    return *c->at != '\0' || c->at == c->end || fail_word(c, "text");
}

/* These functions read or skip numbers of a type at the cursor. They return false, with slot->error
 * set, if text is wrong. Binary blocks are as long as their elements: the cut has seen to that. */

static inline bool read_real(struct cursor *c, enum ply_type type, double *out)
{
    if (c->text)
        return read_real_word(c, out);
    *out = ply_real(c->at, type, c->swap);
    c->at += fmt_ply_type_bytes[type];
    return true;
}

static inline bool read_integer(struct cursor *c, enum ply_type type, int64_t *out)
{
    if (c->text)
        return read_integer_word(c, out);
    *out = ply_integer(c->at, type, c->swap);
    c->at += fmt_ply_type_bytes[type];
    return true;
}

/* Checks that the rest of a text is long enough for a list. */
static bool check_length(const struct cursor *c, int64_t length)
{
    if (length >= 0 && (uint64_t)length <= (uint64_t)(c->end - c->at) / 2)
        return true;
    fmt_stream_fail(c->slot, c->line, "a list of %" PRId64 " numbers%s", length,
                    length < 0 ? "" : " is longer than the text");
    return false;
}

/* Reads the length of a list. */
static inline bool read_length(struct cursor *c, const struct ply_property *p, uint64_t *out)
{
    int64_t length = 0;
    if (!read_integer(c, p->count_type, &length) || (c->text && !check_length(c, length)))
        return false;
    *out = (uint64_t)length;
    return true;
}

/* Reads numbers of a list of text, which may be as long as a file: integers, or real numbers, or
 * any words if both are NULL. */
static inline __attribute__((always_inline)) bool read_list_words(struct cursor *c, uint64_t count,
                                                                  int64_t *integers, double *reals)
{
    enum { NUMBERS_A_CHECK = 65536 };
    for (uint64_t i = 0; i < count; i++) {
        if (__builtin_expect(i % NUMBERS_A_CHECK == NUMBERS_A_CHECK - 1, 0) &&
            (c->status = bsq_check(c->slot->ctx)) != 0)
            return false;
        if (integers ? !read_integer_word(c, &integers[i])
            : reals  ? !read_real_word(c, &reals[i])
                     : !skip_word(c))
            return false;
    }
    return true;
}

static inline bool skip_property(struct cursor *c, const struct ply_property *p)
{
    uint64_t length = 1;
    if (p->count_type != PLY_NO_TYPE && !read_length(c, p, &length))
        return false;
    if (c->text)
        return read_list_words(c, length, NULL, NULL);
    c->at += length * fmt_ply_type_bytes[p->type];
    return true;
}

/* ---- vertices ---- */

static struct column find_column(const struct mesh_arrays *a, enum ply_role role)
{
    if (role >= PLY_X && role <= PLY_Z)
        return (struct column){.doubles = &a->positions[0][role - PLY_X], .step = 3};
    if (role >= PLY_NX && role <= PLY_NZ)
        return (struct column){.floats = &a->normals[0][role - PLY_NX]};
    if (role >= PLY_RED && role <= PLY_BLUE)
        return (struct column){.floats = &a->colors[0][role - PLY_RED]};
    if (role == PLY_S || role == PLY_T)
        return (struct column){.doubles = &a->texcoords[0][role - PLY_S], .step = 2};
    return (struct column){0};
}

/* Returns the factor that makes integers of colours 0 to 255; real numbers stay. The length of a
 * normal has no meaning. */
static inline float float_scale(enum ply_type type)
{
    return type == PLY_UINT16 ? 1.0f / 257.0f : 1.0f;
}

/* Stores one property of `count` vertices that are `each` bytes apart. `type` and `swap` are
 * constants where this is inlined. */
static inline __attribute__((always_inline)) void copy_property(struct column to,
                                                                const uint8_t *from, uint64_t each,
                                                                uint64_t count, enum ply_type type,
                                                                bool swap)
{
    if (to.doubles)
        for (uint64_t i = 0; i < count; i++)
            to.doubles[i * to.step] = ply_real(from + i * each, type, swap);
    else if (to.floats)
        for (uint64_t i = 0; i < count; i++)
            to.floats[i * 3] = (float)ply_real(from + i * each, type, swap) * float_scale(type);
}

static void read_column(struct column to, const uint8_t *from, uint64_t each, uint64_t count,
                        const struct ply_property *p, bool swap)
{
    from += p->offset;
    if (p->type == PLY_FLOAT32 && !swap)
        copy_property(to, from, each, count, PLY_FLOAT32, false);
    else if (p->type == PLY_FLOAT64 && !swap)
        copy_property(to, from, each, count, PLY_FLOAT64, false);
    else if (p->type == PLY_UINT8)
        copy_property(to, from, each, count, PLY_UINT8, false);
    else
        copy_property(to, from, each, count, p->type, swap);
}

/* Copies positions of three floats in a row, which most scans have. Returns false if they are
 * something else. */
static bool copy_positions(struct mesh_arrays *a, const uint8_t *from,
                           const struct ply_element *element, uint64_t count, bool swap)
{
    const struct ply_property *x = element->role[PLY_X];
    const uint64_t each = element->least_bytes;
    for (int i = 0; i < 3; i++) {
        const struct ply_property *p = element->role[PLY_X + i];
        if (p != x + i || p->type != PLY_FLOAT32 || swap)
            return false;
    }
    double(*to)[3] = a->positions;
    from += x->offset;
    for (uint64_t i = 0; i < count; i++, from += each) {
        float position[3];
        memcpy(position, from, sizeof position);
        for (int k = 0; k < 3; k++)
            to[i][k] = (double)position[k];
    }
    return true;
}

/* Reads binary vertices without lists. */
static uint64_t read_equal_vertices(const struct cursor *c, const struct ply_element *element)
{
    const struct ply_property *p = c->source->header.properties + element->first_property;
    const uint64_t each = element->least_bytes, count = c->slot->block.items;
    const bool copied = copy_positions(c->arrays, c->at, element, count, c->swap);
    for (uint32_t i = 0; i < element->property_count; i++)
        if (p[i].role != PLY_UNUSED && !(copied && p[i].role <= PLY_Z))
            read_column(c->columns[p[i].role], c->at, each, count, &p[i], c->swap);
    return count;
}

static bool read_vertex(struct cursor *c, const struct ply_element *element, uint64_t vertex)
{
    const struct ply_property *p = c->source->header.properties + element->first_property;
    for (uint32_t i = 0; i < element->property_count; i++, p++) {
        const struct column *to = &c->columns[p->role];
        double value = 0;
        if (!to->doubles && !to->floats ? !skip_property(c, p) : !read_real(c, p->type, &value))
            return false;
        if (to->doubles)
            to->doubles[vertex * to->step] = value;
        else if (to->floats)
            to->floats[vertex * 3] = (float)value * float_scale(p->type);
    }
    return true;
}

/* Ends a block with this many vertices. */
static void finish_vertices(const struct cursor *c, const struct ply_element *element,
                            uint64_t count)
{
    struct mesh_arrays *a = c->arrays;
    a->count[FMT_MESH_VERTEX] = count;
    a->count[FMT_MESH_NORMAL] = c->source->vertex_normals ? count : 0;
    a->count[FMT_MESH_TEXCOORD] = c->source->vertex_texcoords ? count : 0;
    a->has_colors = element->role[PLY_RED] != NULL;
    if (!a->has_colors)
        return;
    c->slot->color_white = ply_is_real(element->role[PLY_RED]->type) ? 0.0f : 255.0f;
    for (int k = 0; k < 3; k++)
        c->slot->fine_colors |= element->role[PLY_RED + k]->type != PLY_UINT8;
}

/* ---- faces ---- */

static bool fail_index(const struct cursor *c, uint64_t at, int64_t index)
{
    fmt_stream_fail(c->slot, at, "face refers to vertex %" PRId64, index);
    return false;
}

/* Reads triangles of 32-bit indices, as long as there is nothing else. *items counts down. Returns
 * false, and reads none, if an index is negative or beyond 2^31. */
static bool read_triangles(struct cursor *c, uint64_t *items)
{
    struct mesh_arrays *a = c->arrays;
    const uint8_t *from = c->at;
    uint64_t *corners = a->corners[FMT_MESH_VERTEX] + a->corner_count;
    uint32_t *sizes = a->face_sizes + a->face_count, all = 0;
    const uint64_t most = *items;
    uint64_t count = 0;
    for (; count < most && from[13 * count] == 3; count++) {
        uint32_t v[3];
        memcpy(v, from + 13 * count + 1, sizeof v);
        for (int k = 0; k < 3; k++) {
            corners[3 * count + (uint64_t)k] = v[k];
            all |= v[k];
        }
    }
    if (all >> 31)
        return false;
    for (uint64_t i = 0; i < count; i++)
        sizes[i] = 3;
    a->vertex_bound = a->vertex_bound > all ? a->vertex_bound : all + UINT64_C(1);
    a->face_count += count;
    a->corner_count += 3 * count;
    *items -= count;
    c->at += 13 * count;
    return true;
}

/* Returns whether faces are nothing but a list that read_triangles() understands. */
static bool are_plain(const struct cursor *c, const struct ply_element *element)
{
    const struct ply_property *p = element->role[PLY_INDICES];
    return !c->text && !c->swap && element->kind == PLY_FACES && element->property_count == 1 &&
           fmt_ply_type_bytes[p->count_type] == 1 && fmt_ply_type_bytes[p->type] == 4 &&
           c->source->tags == PLY_TAGS_NONE && c->slot->last_face == UINT64_MAX;
}

static bool read_indices(struct cursor *c, const struct ply_property *p, struct face *face)
{
    struct mesh_arrays *a = c->arrays;
    uint64_t *to = a->corners[FMT_MESH_VERTEX] + a->corner_count, all = 0;
    if (!read_length(c, p, &face->size))
        return false;
    const uint64_t each = fmt_ply_type_bytes[p->type], size = face->size;
    if (c->text && !read_list_words(c, size, (int64_t *)to, NULL))
        return false;
    for (uint64_t i = 0; i < size && !c->text; i++)
        to[i] = (uint64_t)ply_integer(c->at + i * each, p->type, c->swap);
    c->at += c->text ? 0 : size * each;
    for (uint64_t i = 0; i < size; i++)
        all |= to[i];
    for (uint64_t i = 0; all >= INDEX_LIMIT && i < size; i++)
        if (to[i] >= INDEX_LIMIT)
            return fail_index(c, face->at, (int64_t)to[i]);
    a->vertex_bound = all < a->vertex_bound ? a->vertex_bound : all + 1;
    return true;
}

static bool read_texcoords(struct cursor *c, const struct ply_property *p, struct face *face)
{
    struct mesh_arrays *a = c->arrays;
    if (!read_length(c, p, &face->texcoords))
        return false;
    double *to = a->texcoords[a->count[FMT_MESH_TEXCOORD]];
    if (c->text)
        return read_list_words(c, face->texcoords, NULL, to);
    for (uint64_t i = 0; i < face->texcoords; i++)
        read_real(c, p->type, &to[i]);
    return true;
}

/* Reads a number that decides the face's material. */
static bool read_material(struct cursor *c, const struct ply_property *p, struct face *face)
{
    double value;
    if (!read_real(c, p->type, &value))
        return false;
    if (p->role == PLY_TEXTURE_NUMBER) {
        face->texture = (int64_t)fmin(fmax(value, -1.0), 4294967296.0);
    } else {
        value *= ply_is_real(p->type) ? 255.0 : p->type == PLY_UINT16 ? 1.0 / 257.0 : 1.0;
        face->clamped |= !(value >= 0.0 && value <= 255.0);
        face->color[p->role - PLY_RED] = fmin(fmax(value, 0.0), 255.0);
    }
    return true;
}

/* Numbers the texture coordinates of a face's corners. If a list does not fit the face, corners go
 * without. */
static void finish_texcoords(struct stream_slot *slot, const struct face *face)
{
    struct mesh_arrays *a = &slot->arrays;
    const uint64_t base = a->count[FMT_MESH_TEXCOORD];
    uint64_t *corners = a->corners[FMT_MESH_TEXCOORD] + a->corner_count;
    const bool fits = face->texcoords == 2 * face->size;
    a->has_corners[FMT_MESH_TEXCOORD] = true;
    if (!fits && face->texcoords > 0)
        slot->odd[PLY_BAD_TEXCOORDS].count += face->size;
    for (uint64_t i = 0; i < face->size; i++)
        corners[i] = fits ? base + i : FMT_MESH_NONE;
    a->count[FMT_MESH_TEXCOORD] += fits ? face->size : 0;
}

/* Finds what decides the face's material. A texture that the file does not name counts as lost. */
static void finish_tag(const struct cursor *c, const struct face *face)
{
    struct stream_oddity *odd = c->slot->odd;
    uint32_t *tag = &c->arrays->face_tags[c->arrays->face_count];
    if (c->source->tags == PLY_TAGS_COLOR) {
        odd[PLY_CLAMPED_COLORS].count += face->clamped;
        *tag = (uint32_t)(face->color[0] + 0.5) | (uint32_t)(face->color[1] + 0.5) << 8 |
               (uint32_t)(face->color[2] + 0.5) << 16;
        return;
    }
    const bool lost = face->texture >= (int64_t)c->source->header.texture_count;
    *tag = face->texture < 0 || lost ? PLY_NO_TAG : (uint32_t)face->texture;
    if (lost && odd[PLY_LOST_TEXTURES].count++ == 0)
        odd[PLY_LOST_TEXTURES].at = face->at;
}

/* Ends a face. Returns false if parsing must stop: at an error, or after slot->last_face. */
static bool finish_face(const struct cursor *c, const struct face *face)
{
    struct mesh_arrays *a = c->arrays;
    if (face->size < 3) {
        c->slot->short_faces++;
        return true;
    }
    if (face->size > UINT32_MAX) {
        fmt_stream_fail(c->slot, face->at, "a face of %" PRIu64 " corners", face->size);
        return false;
    }
    if (c->source->tags != PLY_TAGS_NONE)
        finish_tag(c, face);
    if (c->source->corner_texcoords)
        finish_texcoords(c->slot, face);
    a->face_sizes[a->face_count] = (uint32_t)face->size;
    a->corner_count += face->size;
    c->slot->at = face->at;
    return a->face_count++ != c->slot->last_face;
}

/* A face has the first texture, unless it says another one. */
static bool read_face(struct cursor *c, const struct ply_element *element)
{
    const struct ply_property *p = c->source->header.properties + element->first_property;
    struct face face = {.at = place(c)};
    bool good = true;
    for (uint32_t i = 0; good && i < element->property_count; i++, p++) {
        if (p->role == PLY_INDICES)
            good = read_indices(c, p, &face);
        else if (p->role == PLY_CORNER_TEXCOORDS)
            good = read_texcoords(c, p, &face);
        else if (p->role == PLY_UNUSED || p->role == PLY_ALPHA)
            good = skip_property(c, p);
        else
            good = read_material(c, p, &face);
    }
    return good && finish_face(c, &face);
}

/* ---- blocks ---- */

/* Moves to the next line with text. Returns false if there is none. */
static bool next_line(struct cursor *c)
{
    for (; c->at < c->end; c->at++, c->line++) {
        skip_blanks(c);
        if (!at_line_end(c))
            return c->at < c->end;
    }
    return false;
}

static bool finish_line(struct cursor *c)
{
    skip_blanks(c);
    if (!at_line_end(c))
        return fail_word(c, "expected: each element must be a line");
    c->at++;
    c->line++;
    return true;
}

static bool read_element(struct cursor *c, const struct ply_element *element, uint64_t number)
{
    if (c->text && !next_line(c))
        return false;
    const bool good =
        element->kind == PLY_VERTICES ? read_vertex(c, element, number) : read_face(c, element);
    return good && (!c->text || finish_line(c));
}

/* Reads elements one by one; returns how many there are. */
static uint64_t read_elements(struct cursor *c, const struct ply_element *element)
{
    const uint64_t items = c->slot->block.items;
    bool plain = are_plain(c, element);
    uint64_t left = items;
    for (; left > 0; left--) {
        plain = plain && read_triangles(c, &left);
        if (left == 0 || !read_element(c, element, items - left))
            break;
    }
    return items - left;
}

/* Returns more than the lists of the block can have numbers. */
static uint64_t most_numbers(const struct cursor *c, const struct ply_element *element)
{
    static const enum ply_role lists[] = {PLY_INDICES, PLY_CORNER_TEXCOORDS};
    uint64_t least = c->text ? 2 : 8;
    for (int i = 0; i < 2 && !c->text; i++) {
        const struct ply_property *p = element->role[lists[i]];
        if (p && fmt_ply_type_bytes[p->type] < least)
            least = fmt_ply_type_bytes[p->type];
    }
    return c->slot->block.size / least + 1;
}

/* Ensures capacity for all elements of the block. */
static int reserve(const struct cursor *c, const struct ply_element *element)
{
    const struct ply_source *source = c->source;
    struct bsq_ctx *ctx = c->slot->ctx;
    struct mesh_arrays *a = c->arrays;
    const uint64_t count = c->slot->block.items, numbers = most_numbers(c, element);
    if (element->kind == PLY_VERTICES) {
        BSQ_PASS(FMT_RESERVE(ctx, count, a->positions, a->position_capacity));
        if (element->role[PLY_RED])
            BSQ_PASS(FMT_RESERVE(ctx, count, a->colors, a->color_capacity));
        if (source->vertex_normals)
            BSQ_PASS(FMT_RESERVE(ctx, count, a->normals, a->normal_capacity));
        if (source->vertex_texcoords)
            BSQ_PASS(FMT_RESERVE(ctx, count, a->texcoords, a->texcoord_capacity));
        return 0;
    }
    BSQ_PASS(FMT_RESERVE(ctx, numbers, a->corners[FMT_MESH_VERTEX],
                         a->corner_capacity[FMT_MESH_VERTEX]));
    BSQ_PASS(FMT_RESERVE(ctx, count, a->face_sizes, a->size_capacity));
    if (source->corner_texcoords) {
        BSQ_PASS(FMT_RESERVE(ctx, numbers, a->corners[FMT_MESH_TEXCOORD],
                             a->corner_capacity[FMT_MESH_TEXCOORD]));
        BSQ_PASS(FMT_RESERVE(ctx, numbers / 2 + 1, a->texcoords, a->texcoord_capacity));
    }
    if (source->tags != PLY_TAGS_NONE)
        BSQ_PASS(FMT_RESERVE(ctx, count, a->face_tags, a->tag_capacity));
    return 0;
}

int fmt_ply_parse(const struct ply_element *element, struct stream_slot *slot)
{
    const struct ply_source *source = slot->source->data;
    struct cursor c = {.source = source,
                       .slot = slot,
                       .arrays = &slot->arrays,
                       .at = slot->bytes,
                       .end = slot->bytes + slot->block.size,
                       .line = slot->block.first_line,
                       .line_end = source->header.line_end,
                       .text = source->header.encoding == PLY_ASCII,
                       .swap = source->header.encoding == PLY_BIG_ENDIAN};
    uint64_t count = 0;
    BSQ_PASS(reserve(&c, element));
    slot->arrays.vertex_bound = 0;
    for (int role = 0; role < PLY_ROLE_COUNT && element->kind == PLY_VERTICES; role++)
        if (element->role[role])
            c.columns[role] = find_column(c.arrays, (enum ply_role)role);
    memset(slot->bytes + slot->block.size, 0, STREAM_PADDING);
    slot->bytes[slot->block.size] = (uint8_t)c.line_end;
    if (element->kind == PLY_VERTICES && element->list_count == 0 && !c.text)
        count = read_equal_vertices(&c, element);
    else
        count = read_elements(&c, element);
    if (element->kind == PLY_VERTICES)
        finish_vertices(&c, element, count);
    return c.status;
}
