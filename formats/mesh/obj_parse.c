/* obj_parse.c - parses one block of OBJ text.
 *
 * The parser looks at each byte once: numbers and indices find their own ends, and lines without
 * fields that matter are skipped. The buffers grow to what the text of a block needs and are
 * reused, so only the first blocks touch memory for the first time. */
#include "formats/mesh/obj_internal.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "formats/mesh/mesh_text.h"
#include "formats/mesh/obj_line.h"

/* Statements of the OBJ standard (Wavefront, "Advanced Visualizer", appendix B1) that say nothing
 * about points and faces, superseded ones included. */
static const char *const standard_statements[] = {
    "s",     "l",        "p",        "vp",   "cstype", "deg",   "bmat", "step", "curv",
    "curv2", "parm",     "trim",     "hole", "scrv",   "sp",    "end",  "con",  "mg",
    "bevel", "c_interp", "d_interp", "lod",  "ctech",  "stech", "cdc",  "res"};
/* Further statements, whose arguments are names of things or files. */
static const char *const name_statements[] = {"g",          "o",         "usemap", "maplib",
                                              "shadow_obj", "trace_obj", "call",   "csh"};
/* Statements of surfaces that are no polygons, and superseded ones. */
static const char *const surface_statements[] = {"surf", "bsp", "bzp", "cdp"};

/* Parse functions return NULL on failure: the slot has an error if the text is wrong, otherwise
 * `status` says why. */
struct parser {
    struct bsq_ctx *ctx;
    struct stream_slot *slot; /* block.lines counts the line ends passed */
    struct mesh_arrays *arrays;
    const char *end; /* of the lines to be parsed before the next look for an interruption */
    bool objects;    /* keep o and g statements */
    int status;
    uint64_t vertices; /* the bits of all indices of vertices, from 1 */
};

__attribute__((format(printf, 2, 3))) static const char *fail(struct parser *parser,
                                                              const char *format, ...)
{
    struct stream_slot *slot = parser->slot;
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(slot->error, sizeof slot->error, format, arguments);
    va_end(arguments);
    return NULL;
}

/* ---- lines ---- */

/* Skips blanks and continued line ends, which it counts. */
static inline const char *skip_blanks(struct parser *parser, const char *p)
{
    for (;;) {
        while (fmt_mesh_is_blank(*p))
            p++;
        int size;
        if (__builtin_expect(*p != '\\', 1) || !(size = fmt_mesh_line_end(p + 1)))
            return p;
        p += 1 + size;
        parser->slot->block.lines++;
    }
}

/* Finds the end of a statement, from p after its first word: *end is its line end. Returns the
 * start of the next line. */
static const char *skip_statement(struct parser *parser, const char *p,
                                  enum mesh_continued continued, const char **end)
{
    *end = p + fmt_mesh_statement_size(p, continued, &parser->slot->block.lines);
    if (**end == '\0')
        return fail(parser, "not a text file (zero byte)");
    parser->slot->block.lines++;
    return *end + fmt_mesh_line_end(*end);
}

static const char *skip_comment(struct parser *parser, const char *p)
{
    return skip_statement(parser, p, MESH_NOT_CONTINUED, &p);
}

/* Reads the end of a statement after all its fields: blanks, a comment, the line end. */
static inline const char *finish_line(struct parser *parser, const char *p)
{
    if (__builtin_expect(*p == '\n', 1)) {
        parser->slot->block.lines++;
        return p + 1;
    }
    p = skip_blanks(parser, p);
    int size = fmt_mesh_line_end(p);
    if (size) {
        parser->slot->block.lines++;
        return p + size;
    }
    if (*p == '#')
        return skip_comment(parser, p);
    if (*p == '\0')
        return fail(parser, "not a text file (zero byte)");
    return fail(parser, "unexpected \"%s\" at the end of the line", fmt_mesh_quote_word(p).text);
}

static inline bool at_line_end(char c)
{
    return c == '\n' || c == '\r' || c == '#';
}

/* ---- elements ---- */

/* Ensures capacity for one more element after `count`; true on success. */
#define RESERVE(parser, what, count, array, capacity)                                              \
    (__builtin_expect((count) < (capacity), 1) ||                                                  \
     !((parser)->status =                                                                          \
           bsq_grow((parser)->ctx, what, (count) + 256, sizeof *(array), &(array), &(capacity))))

static const char *fail_number(struct parser *parser, const char *p)
{
    if (*p == '\0')
        return fail(parser, "not a text file (zero byte)");
    return fail(parser, "\"%s\" is not a number", fmt_mesh_quote_word(p).text);
}

/* Counts the current line as odd. */
__attribute__((cold, noinline)) static void note_odd(struct parser *parser, int oddity)
{
    struct stream_oddity *odd = &parser->slot->odd[oddity];
    if (!odd->count++)
        odd->at = parser->slot->block.lines + 1;
    parser->slot->finite &= oddity >= STREAM_FORMAT_ODDITIES;
}

/* Reads a word that is no number. Returns NULL unless it stands for one that is not finite. */
__attribute__((cold, noinline)) static const char *parse_not_finite(struct parser *parser,
                                                                    const char *p, double *out)
{
    const char *after = fmt_obj_not_finite(p);
    if (!after)
        return fail_number(parser, p);
    *out = NAN;
    parser->slot->finite = false;
    return after;
}

/* Returns whether some of these numbers of the line are not finite. */
static inline bool any_nan(const struct parser *parser, const double *numbers, int count)
{
    bool any = false;
    for (int i = 0; __builtin_expect(!parser->slot->finite, 0) && i < count; i++)
        any |= isnan(numbers[i]) != 0;
    return any;
}

/* Reads up to `most` numbers and sets *count. Numbers that are not finite become NaN. Returns NULL
 * if one is malformed. */
static const char *parse_numbers(struct parser *parser, const char *p, double *numbers, int most,
                                 int *count)
{
    int n = 0;
    for (;; n++) {
        p = skip_blanks(parser, p);
        if (n == most || at_line_end(*p))
            break;
        const char *after = obj_number(p, &numbers[n]);
        if (__builtin_expect(!after, 0) && !(after = parse_not_finite(parser, p, &numbers[n])))
            return NULL;
        p = after;
    }
    *count = n;
    return p;
}

/* Adds the colour of the next vertex. Earlier vertices of the block without colour get -1. */
static bool add_color(struct parser *parser, const double *rgb)
{
    struct mesh_arrays *a = parser->arrays;
    const uint64_t vertex = a->count[FMT_MESH_VERTEX];
    if (!RESERVE(parser, "OBJ colours", vertex, a->colors, a->color_capacity))
        return false;
    for (uint64_t i = 0; i < vertex && !a->has_colors; i++)
        a->colors[i][0] = a->colors[i][1] = a->colors[i][2] = -1;
    a->has_colors = true;
    for (int i = 0; i < 3; i++)
        a->colors[vertex][i] = (float)rgb[i];
    return true;
}

/* Reads what follows the third number of a vertex: nothing, w, r g b, or r g b a. A single number
 * is w, which means nothing for polygons; a is ignored too, and so are two numbers. Programs with
 * vertex colours write r g b and r g b a, and most readers accept both. */
static const char *parse_vertex_rest(struct parser *parser, const char *p)
{
    static const double none[3] = {-1, -1, -1};
    double extra[5];
    int count = 0;
    if (!(p = parse_numbers(parser, p, extra, 5, &count)))
        return NULL;
    if (count == 5)
        return fail(parser, "a vertex of more than 7 numbers, expected 3, 4, 6 or 7");
    if (__builtin_expect(count == 2, 0))
        note_odd(parser, OBJ_VERTEX_SIZE);
    if (count >= 3 && any_nan(parser, extra, 3)) {
        note_odd(parser, STREAM_NO_COLOR);
        count = 0;
    }
    if (count >= 3 || parser->arrays->has_colors)
        if (!add_color(parser, count >= 3 ? extra : none))
            return NULL;
    return p;
}

/* Reads coordinate number `i` of a vertex, which obj_number() cannot read. A missing z is 0. */
__attribute__((cold, noinline)) static const char *
parse_odd_coordinate(struct parser *parser, const char *p, double *position, int i)
{
    if (!at_line_end(*p))
        return parse_not_finite(parser, p, &position[i]);
    if (i < 2)
        return fail(parser, "a vertex of %d numbers, expected 3, 4, 6 or 7", i);
    note_odd(parser, OBJ_VERTEX_SIZE);
    position[i] = 0.0;
    return p;
}

static const char *parse_vertex(struct parser *parser, const char *p)
{
    struct mesh_arrays *a = parser->arrays;
    uint64_t vertex = a->count[FMT_MESH_VERTEX];
    if (!RESERVE(parser, "OBJ vertices", vertex, a->positions, a->position_capacity))
        return NULL;
    double *position = a->positions[vertex];
    for (int i = 0; i < 3; i++) {
        p = skip_blanks(parser, p);
        const char *after = obj_number(p, &position[i]);
        if (__builtin_expect(!after, 0) && !(after = parse_odd_coordinate(parser, p, position, i)))
            return NULL;
        p = after;
    }
    if (any_nan(parser, position, 3))
        note_odd(parser, STREAM_NO_POSITION);
    if (__builtin_expect(!fmt_mesh_line_end(p) || a->has_colors, 0) &&
        !(p = parse_vertex_rest(parser, p)))
        return NULL;
    if (!(p = finish_line(parser, p)))
        return NULL;
    a->count[FMT_MESH_VERTEX] = vertex + 1;
    return p;
}

static const char *parse_texcoord(struct parser *parser, const char *p)
{
    struct mesh_arrays *a = parser->arrays;
    uint64_t *count = &a->count[FMT_MESH_TEXCOORD];
    if (!RESERVE(parser, "OBJ texture coordinates", *count, a->texcoords, a->texcoord_capacity))
        return NULL;
    double numbers[3] = {0};
    int given = 0;
    if (!(p = parse_numbers(parser, p, numbers, 3, &given)))
        return NULL;
    if (given == 0 || any_nan(parser, numbers, 2)) {
        numbers[0] = NAN;
        note_odd(parser, STREAM_NO_TEXCOORD);
    }
    if (!(p = finish_line(parser, p)))
        return NULL;
    memcpy(a->texcoords[*count], numbers, sizeof a->texcoords[0]);
    ++*count;
    return p;
}

static const char *parse_normal(struct parser *parser, const char *p)
{
    struct mesh_arrays *a = parser->arrays;
    uint64_t *count = &a->count[FMT_MESH_NORMAL];
    if (!RESERVE(parser, "OBJ normals", *count, a->normals, a->normal_capacity))
        return NULL;
    double numbers[4];
    int given = 0;
    if (!(p = parse_numbers(parser, p, numbers, 4, &given)))
        return NULL;
    if (given < 3 || any_nan(parser, numbers, 3)) {
        numbers[0] = numbers[1] = numbers[2] = NAN;
        note_odd(parser, STREAM_NO_NORMAL);
    }
    if (!(p = finish_line(parser, p)))
        return NULL;
    for (int i = 0; i < 3; i++)
        a->normals[*count][i] = (float)numbers[i];
    ++*count;
    return p;
}

/* ---- faces ---- */

/* Reads one index into *out, encoded as obj_internal.h says. */
static inline const char *parse_index(struct parser *parser, const char *p, enum fmt_mesh_kind kind,
                                      uint64_t *out)
{
    struct mesh_arrays *a = parser->arrays;
    bool negative = *p == '-';
    uint64_t value;
    const char *after = obj_integer(p + (negative || *p == '+'), &value);
    if (__builtin_expect(!after, 0))
        return fail(parser, "\"%s\" is not a face corner", fmt_mesh_quote_word(p).text);
    if (__builtin_expect(value == 0, 0)) {
        if (kind == FMT_MESH_VERTEX)
            return fail(parser, "face refers to vertex 0, indices begin with 1");
        *out = FMT_MESH_BEFORE;
        return after;
    }
    *out = value - 1;
    if (kind == FMT_MESH_VERTEX)
        parser->vertices |= negative ? UINT64_MAX : value;
    if (negative) {
        *out = OBJ_RELATIVE_ZERO + a->count[kind] - value;
        parser->slot->block.carry_out |= 1u << kind;
    }
    return after;
}

/* Stores the texture coordinate or normal index of corner number `corner`. Corners before the first
 * one of the block that has such an index get FMT_MESH_NONE. */
static bool put_corner(struct parser *parser, enum fmt_mesh_kind kind, uint64_t corner,
                       uint64_t index)
{
    struct mesh_arrays *a = parser->arrays;
    if (!RESERVE(parser, "OBJ corners", corner, a->corners[kind], a->corner_capacity[kind]))
        return false;
    if (!a->has_corners[kind])
        memset(a->corners[kind], 0xff, corner * sizeof(uint64_t));
    a->has_corners[kind] = true;
    a->corners[kind][corner] = index;
    return true;
}

/* Reads "/t", "/t/n", "//n" or nothing, after the vertex of corner number `corner`. */
static const char *parse_attributes(struct parser *parser, const char *p, uint64_t corner)
{
    struct mesh_arrays *a = parser->arrays;
    for (enum fmt_mesh_kind kind = FMT_MESH_TEXCOORD; kind <= FMT_MESH_NORMAL; kind++) {
        uint64_t index = FMT_MESH_NONE;
        if (*p == '/') {
            p++;
            bool given = *p != '/' && !obj_is_delimiter(*p);
            if (given && !(p = parse_index(parser, p, kind, &index)))
                return NULL;
        }
        if (index == FMT_MESH_NONE && !a->has_corners[kind])
            continue;
        if (!put_corner(parser, kind, corner, index))
            return NULL;
    }
    return p;
}

/* Corners between checks for an interruption. */
enum { CORNERS_CHECKED = 4096 };

static const char *parse_face(struct parser *parser, const char *p)
{
    struct mesh_arrays *a = parser->arrays;
    uint64_t first = a->corner_count, corner = first;
    for (;; corner++) {
        p = skip_blanks(parser, p);
        if (at_line_end(*p))
            break;
        if (!RESERVE(parser, "OBJ corners", corner, a->corners[FMT_MESH_VERTEX],
                     a->corner_capacity[FMT_MESH_VERTEX]))
            return NULL;
        const char *word = p;
        p = parse_index(parser, p, FMT_MESH_VERTEX, &a->corners[FMT_MESH_VERTEX][corner]);
        if (!p)
            return NULL;
        if (*p == '/' || a->has_corners[FMT_MESH_TEXCOORD] || a->has_corners[FMT_MESH_NORMAL])
            if (!(p = parse_attributes(parser, p, corner)))
                return NULL;
        if (__builtin_expect(!obj_is_delimiter(*p) && *p != '#', 0))
            return fail(parser, "\"%s\" is not a face corner", fmt_mesh_quote_word(word).text);
        /* A single face may be as large as a scan. */
        if (corner % CORNERS_CHECKED == 0 && (parser->status = bsq_check(parser->ctx)) < 0)
            return NULL;
    }
    if (!(p = finish_line(parser, p)))
        return NULL;
    if (__builtin_expect(corner - first < 3, 0)) {
        parser->slot->short_faces++;
        return p;
    }
    if (corner - first > UINT32_MAX)
        return fail(parser, "a face of more than %u corners", UINT32_MAX);
    if (!RESERVE(parser, "OBJ faces", a->face_count, a->face_sizes, a->size_capacity))
        return NULL;
    a->face_sizes[a->face_count++] = (uint32_t)(corner - first);
    a->corner_count = corner;
    return p;
}

/* ---- other statements ---- */

/* Keeps bytes [p, end) of a statement that begins in line `line` of the block. */
static bool add_statement(struct parser *parser, enum obj_statement_kind kind, uint64_t line,
                          const char *p, const char *end)
{
    struct stream_slot *slot = parser->slot;
    if (!RESERVE(parser, "OBJ statements", slot->statement_count, slot->statements,
                 slot->statement_capacity))
        return false;
    slot->statements[slot->statement_count++] = (struct stream_statement){
        .kind = kind,
        .face = parser->arrays->face_count,
        .line = line,
        .offset = (uint64_t)(p - (const char *)slot->bytes),
        .size = (uint64_t)(end - p),
    };
    return true;
}

/* Keeps the name after the first word of a statement. */
static const char *parse_name(struct parser *parser, const char *p, enum obj_statement_kind kind)
{
    const uint64_t line = parser->slot->block.lines;
    if (fmt_mesh_is_blank(*p))
        p = skip_blanks(parser, p);
    const char *end = p, *after = skip_statement(parser, p, MESH_CONTINUED_NAMES, &end);
    parser->slot->balance++;
    return after && add_statement(parser, kind, line, p, end) ? after : NULL;
}

/* Returns whether a list has a word. */
static bool is_in(const char *const *list, size_t count, const char *word, size_t length)
{
    for (size_t i = 0; i < count; i++)
        if (strlen(list[i]) == length && !memcmp(list[i], word, length))
            return true;
    return false;
}
#define IS_IN(list, word, length) is_in(list, sizeof(list) / sizeof *(list), word, length)

/* Returns whether the arguments of a usemap statement name a map: they are not "off". */
static bool names_map(struct parser *parser, const char *p)
{
    const uint64_t lines = parser->slot->block.lines;
    const bool off = strncmp(skip_blanks(parser, p), "off", 3) == 0;
    parser->slot->block.lines = lines; /* the caller reads the arguments again */
    return !off;
}

/* Parses any statement other than v, vt, vn and f. */
static const char *parse_other(struct parser *parser, const char *p)
{
    const char *word = p, *end = p;
    const uint64_t line = parser->slot->block.lines;
    while (!obj_is_delimiter(*p))
        p++;
    size_t length = (size_t)(p - word);
    if (length == 6 && !memcmp(word, "usemtl", 6))
        return parse_name(parser, p, OBJ_USEMTL);
    if (length == 6 && !memcmp(word, "mtllib", 6))
        return parse_name(parser, p, OBJ_MTLLIB);
    if (length == 1 && (*word == 'o' || *word == 'g') && parser->objects)
        return parse_name(parser, p, OBJ_OBJECT);
    if (length == 6 && !memcmp(word, "usemap", 6) && names_map(parser, p))
        note_odd(parser, OBJ_USEMAP);
    const bool surface = IS_IN(surface_statements, word, length);
    const bool name = IS_IN(name_statements, word, length);
    const bool standard = surface || name || IS_IN(standard_statements, word, length);
    if (surface || !standard)
        note_odd(parser, surface ? OBJ_SURFACE : OBJ_UNKNOWN);
    parser->slot->balance += standard;
    p = skip_statement(parser, p, name || !standard ? MESH_CONTINUED_NAMES : MESH_CONTINUED, &end);
    if (p && !standard && parser->slot->odd[OBJ_UNKNOWN].count == 1 &&
        !add_statement(parser, OBJ_FIRST_UNKNOWN, line, word, end))
        return NULL;
    return p;
}

/* Reads eight hexadecimal digits, MMRRGGBB. Returns false for other text. */
static bool read_paint(const char *p, uint32_t *out)
{
    uint32_t value = 0;
    for (int i = 0; i < 8; i++) {
        const int digit = fmt_mesh_hex_digit(p[i]);
        if (digit < 0)
            return false;
        value = value << 4 | (uint32_t)digit;
    }
    *out = value;
    return true;
}

/* Adds the colours of a comment that ZBrush writes after the vertices: "#MRGB " and MMRRGGBB for
 * each of up to 64 vertices. The mask MM is ignored. Returns false if memory lacks. */
static bool add_paint(struct parser *parser, const char *p)
{
    struct mesh_arrays *a = parser->arrays;
    uint32_t v;
    for (; read_paint(p, &v); p += 8) {
        if (!RESERVE(parser, "OBJ colours", a->late_color_count, a->late_colors,
                     a->late_color_capacity))
            return false;
        a->late_colors[a->late_color_count++] =
            0xff000000u | (v & 0xff) << 16 | (v & 0xff00) | (v >> 16 & 0xff);
    }
    while (fmt_mesh_is_blank(*p))
        p++;
    return fmt_mesh_line_end(p) ||
           add_statement(parser, OBJ_BAD_PAINT, parser->slot->block.lines, p, p);
}

static bool is_separator(char c)
{
    return fmt_mesh_is_blank(c) || c == '\\' || at_line_end(c);
}

/* Parses one line (with its continuations) that begins at p. */
static inline const char *parse_line(struct parser *parser, const char *p)
{
    if (p[0] == 'v') {
        if (fmt_mesh_is_blank(p[1]))
            return parse_vertex(parser, p + 2);
        if (p[1] == 't' && is_separator(p[2]))
            return parse_texcoord(parser, p + 2);
        if (p[1] == 'n' && is_separator(p[2]))
            return parse_normal(parser, p + 2);
        if (is_separator(p[1]))
            return parse_vertex(parser, p + 1);
    }
    if (p[0] == 'f' && is_separator(p[1]))
        return parse_face(parser, p + 1);
    if (p[0] == 'f' && p[1] == 'o' && is_separator(p[2])) /* its name before version 3 */
        return parse_face(parser, p + 2);
    if (p[0] == '#') {
        if (__builtin_expect(strncmp(p, "#MRGB ", 6) == 0, 0) && !add_paint(parser, p + 6))
            return NULL;
        return skip_comment(parser, p);
    }
    int size = fmt_mesh_line_end(p);
    if (size) {
        parser->slot->block.lines++;
        return p + size;
    }
    if (p[0] == '\0')
        return fail(parser, "not a text file (zero byte)");
    return parse_other(parser, p);
}

/* ---- runs of plain lines ----
 *
 * Each of these two functions parses consecutive lines of the form "v 0.5 -1.5 2.5" or "f 1 2 3",
 * as long as the buffers have capacity. Returns the start of the first line that it did not parse.
 */

static const char *parse_plain_vertices(struct parser *parser, const char *p)
{
    struct mesh_arrays *a = parser->arrays;
    const char *end = parser->end;
    const uint64_t first = a->count[FMT_MESH_VERTEX];
    uint64_t vertex = first;
    while (p < end && vertex < a->position_capacity && p[0] == 'v' && p[1] == ' ') {
        const char *after = obj_three_numbers(p + 2, a->positions[vertex]);
        if (!after)
            break;
        p = after;
        vertex++;
    }
    a->count[FMT_MESH_VERTEX] = vertex;
    parser->slot->block.lines += vertex - first;
    return p;
}

static const char *parse_plain_triangles(struct parser *parser, const char *p)
{
    struct mesh_arrays *a = parser->arrays;
    const char *end = parser->end;
    const uint64_t first = a->face_count;
    const uint64_t capacity = (a->corner_capacity[FMT_MESH_VERTEX] - a->corner_count) / 3;
    uint64_t limit = first + capacity;
    if (limit > a->size_capacity)
        limit = a->size_capacity;
    if (limit > parser->slot->last_face) /* the caller wants the line of this face */
        limit = parser->slot->last_face;
    if (limit <= first) /* the buffers may have no capacity at all yet */
        return p;
    uint64_t face = first, *corners = a->corners[FMT_MESH_VERTEX] + a->corner_count;
    obj_most most = {0};
    while (p < end && face < limit && p[0] == 'f' && p[1] == ' ') {
        const char *after = obj_three_indices(p + 2, corners, &most);
        if (!after)
            break;
        p = after;
        corners += 3;
        a->face_sizes[face++] = 3;
    }
    a->face_count = face;
    a->corner_count += 3 * (face - first);
    if (face > first && obj_bound_of(most) > a->vertex_bound)
        a->vertex_bound = obj_bound_of(most);
    parser->slot->block.lines += face - first;
    return p;
}

static const char *parse_plain_lines(struct parser *parser, const char *p)
{
    const struct mesh_arrays *a = parser->arrays;
    if (p[0] == 'v' && !a->has_colors)
        return parse_plain_vertices(parser, p);
    if (p[0] == 'f' && !a->has_corners[FMT_MESH_TEXCOORD] && !a->has_corners[FMT_MESH_NORMAL])
        return parse_plain_triangles(parser, p);
    return p;
}

int fmt_obj_parse_text(struct stream_slot *slot, uint64_t begin, uint64_t size, bool objects)
{
    const char *p = (const char *)slot->bytes + begin, *const end = p + size;
    struct parser parser = {
        .ctx = slot->ctx, .slot = slot, .arrays = &slot->arrays, .objects = objects};
    uint64_t line = 0;
    slot->block.lines = slot->block.carry_out = 0;
    slot->arrays.vertex_bound = 0;
    slot->finite = true;
    /* Two line ends: the last line may lack its own and even end in a continuation. */
    memset(slot->bytes + begin + size, 0, STREAM_PADDING);
    memset(slot->bytes + begin + size, '\n', 2);
    if (slot->block.offset == 0)
        p += fmt_mesh_mark(p, size);
    /* A block has more bytes if all lines end in a backslash, as comments may. */
    while (p && p < end && slot->arrays.face_count <= slot->last_face && parser.status == 0) {
        parser.end = (uint64_t)(end - p) > OBJ_BLOCK_BYTES ? p + OBJ_BLOCK_BYTES : end;
        parser.status = bsq_check(slot->ctx);
        while (p && p < parser.end && slot->arrays.face_count <= slot->last_face) {
            p = parse_plain_lines(&parser, p);
            if (p >= parser.end)
                break;
            line = slot->block.lines;
            p = parse_line(&parser, skip_blanks(&parser, p));
        }
    }
    if (parser.vertices > slot->arrays.vertex_bound)
        slot->arrays.vertex_bound = parser.vertices;
    slot->at = line + (slot->block.first_line ? slot->block.first_line : 1);
    return parser.status;
}
