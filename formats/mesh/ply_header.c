/* ply_header.c - reads the header of a PLY file, and finds out what its properties are for.
 *
 * Lines may have any length. A buffer grows with the longest one, so a file can ask for no more
 * memory than it has bytes, and the budget limits that. */
#include "formats/mesh/ply_internal.h"

#include <inttypes.h>
#include <stdio.h>
#include <string.h>

#include "formats/mesh/mesh_text.h"

enum { step_bytes = 4096 };

const uint8_t fmt_ply_type_bytes[PLY_TYPE_COUNT] = {
    [PLY_INT8] = 1,   [PLY_UINT8] = 1, [PLY_INT16] = 2,  [PLY_UINT16] = 2,  [PLY_INT32] = 4,
    [PLY_UINT32] = 4, [PLY_INT64] = 8, [PLY_UINT64] = 8, [PLY_FLOAT32] = 4, [PLY_FLOAT64] = 8};

enum { MOST_NAMES = 4 };
typedef const char *names_of[MOST_NAMES];

static const names_of type_names[PLY_TYPE_COUNT] = {
    [PLY_INT8] = {"char", "int8"},        [PLY_UINT8] = {"uchar", "uint8"},
    [PLY_INT16] = {"short", "int16"},     [PLY_UINT16] = {"ushort", "uint16"},
    [PLY_INT32] = {"int", "int32"},       [PLY_UINT32] = {"uint", "uint32"},
    [PLY_INT64] = {"long", "int64"},      [PLY_UINT64] = {"ulong", "uint64"},
    [PLY_FLOAT32] = {"float", "float32"}, [PLY_FLOAT64] = {"double", "float64"}};

static bool is_among(const names_of names, const char *name)
{
    for (int i = 0; i < MOST_NAMES && names[i]; i++)
        if (strcmp(names[i], name) == 0)
            return true;
    return false;
}

/* The header while it is read, line by line. */
struct lines {
    struct bsq_ctx *ctx;
    struct fmt_input *input;
    const char *path;
    struct ply_header *header;
    char *text; /* of the file from the current line on */
    uint64_t capacity, have;
    uint64_t size; /* of the current line with its end; header->bytes and lines count it */
    bool has_format, ended;
};

/* ---- lines and words ---- */

static int fail_line(const struct lines *l, const char *what, const char *text)
{
    char quoted[64];
    fmt_mesh_quote(text, text + strlen(text), quoted, sizeof quoted);
    return bsq_fail(l->ctx, BSQ_EDATA, "%s:%" PRIu64 ": %s \"%s\"", l->path, l->header->lines, what,
                    quoted);
}

/* Loads more of the file behind the text. *got is 0 at the end of the file. */
static int load_more(struct lines *l, uint64_t *got)
{
    uint64_t at = l->header->bytes + l->have;
    BSQ_PASS(
        bsq_grow(l->ctx, "header of a PLY file", l->have + step_bytes, 1, &l->text, &l->capacity));
    BSQ_PASS(fmt_input_read_some(l->input, l->text + l->have, step_bytes, at, got));
    l->have += *got;
    return 0;
}

/* Finds the end of the line: at '\n', or at '\r' in a file whose first line ends so. */
static char *find_end(const struct lines *l, uint64_t from)
{
    char *begin = l->text + from, *limit = l->text + l->have;
    char *end = memchr(begin, l->header->line_end, (size_t)(limit - begin));
    if (l->header->lines > 1)
        return end;
    /* A "\r" is the first line's end if no other line end follows it. */
    char *old = memchr(begin, '\r', (size_t)((end ? end : limit) - begin));
    return old && old + 1 < limit && old[1] != '\n' && old[1] != '\r' ? old : end;
}

/* Refuses control characters, so that names are fit for messages. */
static int check_characters(const struct lines *l, const char *end)
{
    for (const char *p = l->text; p < end; p++)
        if (((unsigned char)*p < ' ' && *p != '\t' && *p != '\r') || *p == 127)
            return bsq_fail(l->ctx, BSQ_EDATA, "%s:%" PRIu64 ": a control character in the header",
                            l->path, l->header->lines);
    return 0;
}

/* Moves to the next line and ends it with a zero. */
static int next_line(struct lines *l)
{
    uint64_t searched = 0, got = 1;
    char *end;
    memmove(l->text, l->text + l->size, l->have - l->size);
    l->header->bytes += l->size;
    l->have -= l->size;
    l->size = 0;
    l->header->lines++;
    while (!(end = find_end(l, searched))) {
        searched = l->have > 0 ? l->have - 1 : 0;
        BSQ_PASS(load_more(l, &got));
        if (got == 0)
            return bsq_fail(l->ctx, BSQ_EDATA, "%s:%" PRIu64 ": the header has no end", l->path,
                            l->header->lines);
        BSQ_PASS(bsq_check(l->ctx));
    }
    if (l->header->lines == 1)
        l->header->line_end = *end;
    l->size = (uint64_t)(end - l->text) + 1;
    *end = '\0';
    return check_characters(l, end);
}

/* Cuts the next word off *text; returns "" if there is none. */
static const char *next_word(char **text)
{
    static const char blanks[] = " \t\r\v\f";
    char *word = *text + strspn(*text, blanks);
    *text = word + strcspn(word, blanks);
    if (**text)
        *(*text)++ = '\0';
    return word;
}

/* Parses a whole decimal number. Returns false if it is none or does not fit. */
static bool parse_count(const char *word, uint64_t *out)
{
    uint64_t value = 0;
    if (!*word)
        return false;
    for (; *word; word++) {
        unsigned digit = (unsigned)(unsigned char)*word - '0';
        if (digit > 9 || __builtin_mul_overflow(value, 10, &value) ||
            __builtin_add_overflow(value, digit, &value))
            return false;
    }
    *out = value;
    return true;
}

/* ---- statements ---- */

static int read_format(struct lines *l, char *rest)
{
    static const char *const names[] = {[PLY_ASCII] = "ascii",
                                        [PLY_LITTLE_ENDIAN] = "binary_little_endian",
                                        [PLY_BIG_ENDIAN] = "binary_big_endian"};
    const char *name = next_word(&rest), *version = next_word(&rest);
    for (int i = 0; i < 3; i++)
        if (strcmp(name, names[i]) == 0) {
            l->header->encoding = (enum ply_encoding)i;
            l->has_format = true;
        }
    if (!l->has_format)
        return fail_line(l, "unknown format", name);
    return strcmp(version, "1.0") == 0 ? 0 : fail_line(l, "unknown version", version);
}

static int read_element(struct lines *l, char *rest)
{
    struct ply_header *header = l->header;
    const char *name = next_word(&rest), *count = next_word(&rest);
    BSQ_PASS(BSQ_GROW(l->ctx, "header of a PLY file", header->element_count + 1, &header->elements,
                      &header->element_capacity));
    struct ply_element *element = &header->elements[header->element_count];
    *element = (struct ply_element){.first_property = header->property_count};
    if (!parse_count(count, &element->count))
        return fail_line(l, "not a number of elements:", count);
    int status = bsq_text_copy(l->ctx, name, &element->name);
    header->element_count += status == 0;
    return status;
}

static enum ply_type find_type(const char *name)
{
    int type = PLY_TYPE_COUNT - 1;
    while (type > PLY_NO_TYPE && !is_among(type_names[type], name))
        type--;
    return (enum ply_type)type;
}

static int read_property(struct lines *l, char *rest)
{
    struct ply_header *header = l->header;
    struct ply_property property = {0};
    const char *word = next_word(&rest);
    if (header->element_count == 0)
        return fail_line(l, "a property before any element:", word);
    if (strcmp(word, "list") == 0) {
        word = next_word(&rest);
        property.count_type = find_type(word);
        if (property.count_type == PLY_NO_TYPE || ply_is_real(property.count_type))
            return fail_line(l, "not a type of list lengths:", word);
        word = next_word(&rest);
    }
    property.type = find_type(word);
    if (property.type == PLY_NO_TYPE)
        return fail_line(l, "unknown type", word);
    BSQ_PASS(BSQ_GROW(l->ctx, "header of a PLY file", header->property_count + 1,
                      &header->properties, &header->property_capacity));
    BSQ_PASS(bsq_text_copy(l->ctx, next_word(&rest), &property.name));
    header->properties[header->property_count++] = property;
    header->elements[header->element_count - 1].property_count++;
    return 0;
}

/* Keeps the file name of "comment TextureFile NAME", which may have blanks. */
static int read_comment(struct lines *l, char *rest)
{
    struct ply_header *header = l->header;
    if (strcmp(next_word(&rest), "TextureFile") != 0)
        return 0;
    rest += strspn(rest, " \t\r");
    size_t length = strlen(rest);
    while (length > 0 && strchr(" \t\r", rest[length - 1]))
        rest[--length] = '\0';
    BSQ_PASS(BSQ_GROW(l->ctx, "header of a PLY file", header->texture_count + 1, &header->textures,
                      &header->texture_capacity));
    BSQ_PASS(bsq_text_copy(l->ctx, rest, &header->textures[header->texture_count]));
    header->texture_count++;
    return 0;
}

static int read_statement(struct lines *l)
{
    char *rest = l->text;
    const char *word = next_word(&rest);
    if (l->header->lines == 1)
        return strcmp(word, "ply") == 0 ? 0 : fail_line(l, "not a PLY file:", word);
    if (strcmp(word, "end_header") == 0)
        l->ended = true;
    else if (strcmp(word, "format") == 0)
        return read_format(l, rest);
    else if (strcmp(word, "element") == 0)
        return read_element(l, rest);
    else if (strcmp(word, "property") == 0)
        return read_property(l, rest);
    else if (strcmp(word, "comment") == 0)
        return read_comment(l, rest);
    else if (*word && strcmp(word, "obj_info") != 0)
        return fail_line(l, "unknown statement", word);
    return 0;
}

/* ---- roles: the names are those that scanners and mesh programs write ---- */

enum { OF_VERTICES = 1 << PLY_VERTICES, OF_FACES = 1 << PLY_FACES };

static const struct role_row {
    unsigned kinds; /* of elements, a bit for each */
    bool list;
    names_of names;
} role_rows[PLY_ROLE_COUNT] = {
    [PLY_X] = {OF_VERTICES, false, {"x"}},
    [PLY_Y] = {OF_VERTICES, false, {"y"}},
    [PLY_Z] = {OF_VERTICES, false, {"z"}},
    [PLY_NX] = {OF_VERTICES, false, {"nx", "normal_x"}},
    [PLY_NY] = {OF_VERTICES, false, {"ny", "normal_y"}},
    [PLY_NZ] = {OF_VERTICES, false, {"nz", "normal_z"}},
    [PLY_S] = {OF_VERTICES, false, {"s", "u", "texture_u", "texture_s"}},
    [PLY_T] = {OF_VERTICES, false, {"t", "v", "texture_v", "texture_t"}},
    [PLY_RED] = {OF_VERTICES | OF_FACES, false, {"red", "r", "diffuse_red"}},
    [PLY_GREEN] = {OF_VERTICES | OF_FACES, false, {"green", "g", "diffuse_green"}},
    [PLY_BLUE] = {OF_VERTICES | OF_FACES, false, {"blue", "b", "diffuse_blue"}},
    [PLY_ALPHA] = {OF_VERTICES | OF_FACES, false, {"alpha", "a", "diffuse_alpha"}},
    [PLY_TEXTURE_NUMBER] = {OF_FACES, false, {"texnumber"}},
    [PLY_INDICES] = {OF_FACES, true, {"vertex_indices", "vertex_index"}},
    [PLY_CORNER_TEXCOORDS] = {OF_FACES, true, {"texcoord"}},
};

/* Returns what a property of an element of this kind is for. */
static enum ply_role role_of(enum ply_kind kind, const struct ply_property *p)
{
    for (int role = PLY_UNUSED + 1; role < PLY_ROLE_COUNT; role++) {
        const struct role_row *row = &role_rows[role];
        if (row->kinds >> kind & 1 && row->list == (p->count_type != PLY_NO_TYPE) &&
            is_among(row->names, p->name))
            return (enum ply_role)role;
    }
    return PLY_UNUSED;
}

static enum ply_kind kind_of(const char *name)
{
    if (strcmp(name, "vertex") == 0)
        return PLY_VERTICES;
    return strcmp(name, "face") == 0 ? PLY_FACES : PLY_OTHER;
}

/* Takes the roles from `first` to `last` back from the properties of an element. */
static void drop_roles(struct ply_element *element, struct ply_property *properties,
                       enum ply_role first, enum ply_role last)
{
    for (int role = (int)first; role <= (int)last; role++) {
        if (element->role[role])
            properties[element->role[role] - properties].role = PLY_UNUSED;
        element->role[role] = NULL;
    }
}

/* Drops a group of roles that is incomplete, such as x and y without z. */
static void check_group(struct ply_element *element, struct ply_property *properties,
                        enum ply_role first, enum ply_role last)
{
    bool complete = true;
    for (int role = (int)first; role <= (int)last; role++)
        complete &= element->role[role] != NULL;
    if (!complete)
        drop_roles(element, properties, first, last);
}

static void describe_element(struct ply_header *header, struct ply_element *element)
{
    struct ply_property *properties = header->properties;
    element->kind = kind_of(element->name);
    for (uint32_t i = 0; i < element->property_count; i++) {
        struct ply_property *p = &properties[element->first_property + i];
        bool list = p->count_type != PLY_NO_TYPE;
        p->offset = element->least_bytes;
        element->list_count += list;
        element->least_bytes += fmt_ply_type_bytes[list ? p->count_type : p->type];
        p->role = role_of(element->kind, p);
        if (element->role[p->role] || (p->role == PLY_INDICES && ply_is_real(p->type)) ||
            (p->role == PLY_TEXTURE_NUMBER && ply_is_real(p->type)))
            p->role = PLY_UNUSED;
        if (p->role != PLY_UNUSED)
            element->role[p->role] = p;
    }
    check_group(element, properties, PLY_X, PLY_Z);
    check_group(element, properties, PLY_NX, PLY_NZ);
    check_group(element, properties, PLY_RED, PLY_BLUE);
    check_group(element, properties, PLY_S, PLY_T);
}

/* ---- checks ---- */

struct ply_element *fmt_ply_find_element(const struct ply_header *header, enum ply_kind kind)
{
    for (uint32_t i = 0; i < header->element_count; i++)
        if (header->elements[i].kind == kind)
            return &header->elements[i];
    return NULL;
}

/* Checks that no element that is read comes twice. */
static int check_kinds(struct bsq_ctx *ctx, const char *path, const struct ply_header *header)
{
    for (uint32_t i = 0; i < header->element_count; i++) {
        const struct ply_element *element = &header->elements[i];
        if (element->kind != PLY_OTHER && fmt_ply_find_element(header, element->kind) != element)
            return bsq_fail(ctx, BSQ_EDATA, "%s: the header has two elements \"%s\"", path,
                            element->name);
    }
    return 0;
}

static int check_is_mesh(struct bsq_ctx *ctx, const char *path, const struct ply_header *header)
{
    const struct ply_element *vertices = fmt_ply_find_element(header, PLY_VERTICES);
    const struct ply_element *faces = fmt_ply_find_element(header, PLY_FACES);
    for (uint32_t i = 0; i < header->element_count; i++)
        if (strcmp(header->elements[i].name, "tristrips") == 0 && header->elements[i].count > 0)
            return bsq_fail(ctx, BSQ_EDATA,
                            "%s: strips of triangles (\"tristrips\"), which are not read; save the "
                            "mesh with faces, as MeshLab does",
                            path);
    if (!vertices || !vertices->role[PLY_X])
        return bsq_fail(ctx, BSQ_EDATA, "%s: the header has no vertices with x, y and z", path);
    if (!faces || faces->count == 0)
        return bsq_fail(ctx, BSQ_EDATA,
                        "%s: a point cloud of %" PRIu64 " points without faces; make a mesh of it",
                        path, vertices->count);
    if (!faces->role[PLY_INDICES])
        return bsq_fail(ctx, BSQ_EDATA, "%s: faces without a list \"vertex_indices\" of integers",
                        path);
    return 0;
}

/* Checks that the file is long enough for all elements, if all their lists were empty. An element
 * of a text file has a line of its own, in which each property takes at least two bytes; the last
 * line may lack its end. */
static int check_size(struct bsq_ctx *ctx, const struct fmt_input *input,
                      const struct ply_header *header)
{
    const uint64_t size = fmt_input_size(input);
    uint64_t left = size - header->bytes + (header->encoding == PLY_ASCII);
    if (size == UINT64_MAX)
        return 0;
    for (uint32_t i = 0; i < header->element_count; i++) {
        const struct ply_element *element = &header->elements[i];
        uint64_t each = header->encoding == PLY_ASCII ? 2 * (uint64_t)element->property_count
                                                      : element->least_bytes;
        if (each > 0 && element->count > left / each)
            return bsq_fail(ctx, BSQ_EDATA,
                            "%s: truncated: the header counts %" PRIu64 " elements \"%s\" of at "
                            "least %" PRIu64 " bytes, but %" PRIu64 " bytes are left",
                            fmt_input_path(input), element->count, element->name, each,
                            left - (header->encoding == PLY_ASCII));
        left -= element->count * each;
    }
    return 0;
}

static int find_roles(struct bsq_ctx *ctx, struct fmt_input *input, struct ply_header *header)
{
    for (uint32_t i = 0; i < header->element_count; i++)
        describe_element(header, &header->elements[i]);
    BSQ_PASS(check_kinds(ctx, fmt_input_path(input), header));
    BSQ_PASS(check_is_mesh(ctx, fmt_input_path(input), header));
    /* Texture coordinates of vertices are not read beside those of corners. */
    if (fmt_ply_find_element(header, PLY_FACES)->role[PLY_CORNER_TEXCOORDS])
        drop_roles(fmt_ply_find_element(header, PLY_VERTICES), header->properties, PLY_S, PLY_T);
    return check_size(ctx, input, header);
}

/* ---- the whole header ---- */

int fmt_ply_header_read(struct bsq_ctx *ctx, struct fmt_input *input, struct ply_header *out)
{
    struct lines l = {.ctx = ctx, .input = input, .path = fmt_input_path(input), .header = out};
    memset(out, 0, sizeof *out);
    out->line_end = '\n';
    uint64_t got;
    int status = load_more(&l, &got);
    l.size = status ? 0 : fmt_mesh_mark(l.text, l.have);
    while (!status && !l.ended) {
        status = next_line(&l);
        if (!status)
            status = read_statement(&l);
    }
    out->bytes += l.size;
    bsq_free(ctx, l.text);
    if (!status && !l.has_format)
        status = bsq_fail(ctx, BSQ_EDATA, "%s: the header has no format", l.path);
    if (!status)
        status = find_roles(ctx, input, out);
    return status;
}

void fmt_ply_header_free(struct bsq_ctx *ctx, struct ply_header *header)
{
    for (uint32_t i = 0; i < header->element_count; i++)
        bsq_free(ctx, header->elements[i].name);
    for (uint32_t i = 0; i < header->property_count; i++)
        bsq_free(ctx, header->properties[i].name);
    for (uint32_t i = 0; i < header->texture_count; i++)
        bsq_free(ctx, header->textures[i]);
    BSQ_FREE(ctx, header->elements, header->properties, header->textures);
    memset(header, 0, sizeof *header);
}

/* ---- what is not read ---- */

/* Appends to a list with commas, as far as it has space. */
static void append(char *list, size_t size, const char *text)
{
    size_t length = strlen(list);
    snprintf(list + length, size - length, "%s%s", length > 0 ? ", " : "", text);
}

static void warn_properties(struct bsq_ctx *ctx, const char *path, const struct ply_header *header,
                            const struct ply_element *element)
{
    char names[160] = "";
    uint32_t count = 0;
    for (uint32_t i = 0; i < element->property_count; i++) {
        const struct ply_property *p = &header->properties[element->first_property + i];
        if (p->role != PLY_UNUSED)
            continue;
        append(names, sizeof names, p->name);
        count++;
    }
    if (count > 0)
        bsq_warn(ctx, "%s: %u %s of \"%s\" not read: %s", path, count,
                 count == 1 ? "property" : "properties", element->name, names);
}

void fmt_ply_warn_unread(struct bsq_ctx *ctx, const char *path, const struct ply_header *header)
{
    for (uint32_t i = 0; i < header->element_count; i++) {
        const struct ply_element *element = &header->elements[i];
        if (element->count == 0)
            continue;
        if (element->kind == PLY_OTHER)
            bsq_warn(ctx, "%s: %" PRIu64 " elements \"%s\" not read", path, element->count,
                     element->name);
        else
            warn_properties(ctx, path, header, element);
    }
}
