/* mtl.c - reads the colours, textures and further channels of materials in Wavefront MTL files.
 *
 * Such files are small, so one is held whole and cut into lines in place. */
#include "base/srgb.h"
#include "formats/mesh/obj_internal.h"

#include <ctype.h>
#include <errno.h>
#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <strings.h>
#include <sys/stat.h>
#include <unistd.h>

#include "base/context.h"
#include "formats/input/input.h"
#include "formats/mesh/mesh_text.h"
#include "formats/mesh/obj_number.h"

/* Larger values, scales and offsets would exceed the range of float in sums and products. */
static const double most_number = 1e30;

static const char unnamed_material[] = "no newmtl before this, ignored";
static const char unused_option[] = "texture is used without this option";

struct reader {
    struct bsq_ctx *ctx;
    const char *path;
    const char *place; /* of the statement that names it */
    uint64_t line;
    struct fmt_materials *materials;
    bool has_current;                /* the last material of the list is from this file */
    uint64_t unknown, first_unknown; /* statements that are not of the format; line of the first */
};

/* ---- words of a line ---- */

static char *skip_blanks(char *p)
{
    while (fmt_mesh_is_blank(*p))
        p++;
    return p;
}

static size_t word_length(const char *p)
{
    size_t length = 0;
    while (p[length] && !fmt_mesh_is_blank(p[length]))
        length++;
    return length;
}

static bool word_is(const char *p, const char *keyword)
{
    size_t length = strlen(keyword);
    return word_length(p) == length && !strncasecmp(p, keyword, length);
}

static void trim_end(char *text)
{
    size_t length = strlen(text);
    while (length && fmt_mesh_is_blank(text[length - 1]))
        text[--length] = '\0';
}

/* ---- statements ---- */

static int warn(struct reader *reader, const char *what, const char *text)
{
    return bsq_warn_loss(reader->ctx, "%s:%" PRIu64 ": %s: \"%.60s\"", reader->path, reader->line,
                         what, text);
}

/* Returns the material that statements describe now; NULL if there is none. */
static struct fmt_material *current(struct reader *reader)
{
    return reader->has_current ? &reader->materials->list[reader->materials->count - 1] : NULL;
}

static int begin_material(struct reader *reader, char *name)
{
    struct fmt_material *material;
    trim_end(name);
    int status = fmt_materials_add(reader->ctx, reader->materials, &material);
    reader->has_current = !status;
    return status ? status : bsq_text_copy(reader->ctx, name, &material->name);
}

/* Reads "r g b" or one number, which stands for all three; at most `most` after clamping. Sets
 * *known. Warns of values that are clamped. Spectral curves and CIE colours are not read. */
static int read_values(struct reader *reader, char *p, double most, float out[3], bool *known)
{
    double rgb[3];
    int count = 0;
    bool clamped = false;
    if (word_is(p, "spectral") || word_is(p, "xyz"))
        return warn(reader, "a spectral curve or a CIE colour, ignored", p);
    for (char *at = p; count < 3 && *at && *at != '#'; count++) {
        if (!obj_number(at, &rgb[count]))
            return warn(reader, "not a colour, ignored", p);
        at = skip_blanks(at + word_length(at));
    }
    if (count != 1 && count != 3)
        return warn(reader, "a colour has 1 or 3 numbers, ignored", p);
    for (int i = 0; i < 3; i++) {
        double value = rgb[count == 1 ? 0 : i];
        clamped |= value < 0 || value > most;
        out[i] = (float)(value < 0 ? 0 : value > most ? most : value);
    }
    *known = true;
    return clamped ? warn(reader, "out of range, clamped", p) : 0;
}

enum option_effect {
    OPTION_MOVES,   /* the texture, and is used */
    OPTION_PICKS,   /* a component, and is used */
    OPTION_CHANGES, /* what the texture means, but is not used */
    OPTION_FILTERS, /* the texture in a way that lookups do not follow */
};

/* Options of map_ statements with the number of words that follow each. */
static const struct map_option {
    const char *name;
    int words; /* vectors, of three, may have fewer */
    enum option_effect effect;
    double numbers[3]; /* that change nothing */
    const char *word;  /* that changes nothing; NULL: none */
} map_options[] = {
    {"-s", 3, OPTION_MOVES, {1, 1, 1}, NULL},  {"-o", 3, OPTION_MOVES, {0}, NULL},
    {"-imfchan", 1, OPTION_PICKS, {0}, NULL},  {"-t", 3, OPTION_CHANGES, {0}, NULL},
    {"-mm", 2, OPTION_CHANGES, {0, 1}, NULL},  {"-bm", 1, OPTION_CHANGES, {1}, NULL},
    {"-cc", 1, OPTION_CHANGES, {NAN}, "off"},  {"-clamp", 1, OPTION_CHANGES, {NAN}, "off"},
    {"-type", 1, OPTION_CHANGES, {NAN}, NULL}, {"-blendu", 1, OPTION_FILTERS, {0}, NULL},
    {"-blendv", 1, OPTION_FILTERS, {0}, NULL}, {"-boost", 1, OPTION_FILTERS, {0}, NULL},
    {"-texres", 1, OPTION_FILTERS, {0}, NULL},
};

static const struct map_option *find_option(const char *p)
{
    for (size_t i = 0; i < sizeof map_options / sizeof *map_options; i++)
        if (word_is(p, map_options[i].name))
            return &map_options[i];
    return NULL;
}

/* What the options of a map_ statement say. */
struct texture {
    struct fmt_uv uv;
    uint32_t component;
    bool scalar;       /* it gives one value, so `component` counts */
    bool after_vector; /* the file could be a number of the option before it */
};

/* Notes what an option with these numbers says of the texture. */
static int use_vector(struct reader *reader, const char *option, const double numbers[3], int count,
                      struct texture *texture)
{
    struct fmt_uv *uv = &texture->uv;
    for (int i = 0; i < count; i++)
        if (fabs(numbers[i]) > most_number)
            return warn(reader, "out of range, ignored", option);
    for (int i = 0; i < 2; i++) {
        if (!uv->moves)
            uv->scale[i] = 1, uv->offset[i] = 0;
    }
    for (int i = 0; i < count && i < 2; i++)
        *(word_is(option, "-s") ? &uv->scale[i] : &uv->offset[i]) = (float)numbers[i];
    uv->moves = uv->scale[0] != 1 || uv->scale[1] != 1 || uv->offset[0] != 0 || uv->offset[1] != 0;
    return 0;
}

/* Notes the component that an option names with `word`. */
static int use_component(struct reader *reader, const char *option, const char *word,
                         struct texture *texture)
{
    static const char components[] = "rgbm"; /* m, the matte, is alpha */
    const char *found = word_length(word) == 1 ? strchr(components, tolower(*word)) : NULL;
    texture->component = found ? (uint32_t)(found - components) : 0;
    return found && texture->scalar ? 0 : warn(reader, unused_option, option);
}

/* Reads the words of one option. Never takes the last word of a line, which is the file. */
static int read_option(struct reader *reader, char **at, const struct map_option *option,
                       struct texture *texture)
{
    char *p = *at, *first = skip_blanks(p + word_length(p)), *rest = first;
    const bool is_vector = option->words == 3;
    bool changes = false;
    double numbers[3] = {0};
    int count = 0;
    texture->after_vector = false;
    while (count < option->words) {
        char *after = skip_blanks(rest + word_length(rest));
        const bool is_number = obj_number(rest, &numbers[count]);
        texture->after_vector = is_vector && is_number && !*after;
        if (!*after || (is_vector && !is_number))
            break;
        changes |= is_number ? numbers[count] != option->numbers[count]
                             : !option->word || !word_is(rest, option->word);
        count++;
        rest = after;
    }
    *at = rest;
    if (option->effect == OPTION_MOVES)
        return use_vector(reader, p, numbers, count, texture);
    if (option->effect == OPTION_PICKS)
        return use_component(reader, p, first, texture);
    return changes && option->effect == OPTION_CHANGES ? warn(reader, unused_option, p) : 0;
}

/* Reads "[options] file" of a statement. The file name may contain blanks and be quoted. */
static int read_map(struct reader *reader, char *p, struct fmt_material_channel *entry)
{
    struct texture texture = {.component = entry->channel->component,
                              .scalar = entry->channel->values == 1};
    const char *statement = entry->channel->mtl_map;
    const struct map_option *option;
    char *path = NULL;
    bool exists = false;
    trim_end(p);
    while ((option = find_option(p)))
        BSQ_PASS(read_option(reader, &p, option, &texture));
    if (!*p || (*p == '#' && (!p[1] || fmt_mesh_is_blank(p[1]))) || !strcmp(p, "\"\""))
        return warn(reader, "names no file, ignored", statement);
    BSQ_PASS(fmt_path_find(reader->ctx, reader->path, p, &path, &exists));
    if (!exists && texture.after_vector) {
        bsq_free(reader->ctx, path);
        return warn(reader, "names no file, ignored", statement);
    }
    BSQ_FREE(reader->ctx, entry->texture_path, entry->texture_place);
    entry->texture_path = path;
    entry->uv = texture.uv;
    entry->component = texture.component;
    return bsq_text_print(reader->ctx, &entry->texture_place, "%s:%" PRIu64, reader->path,
                          reader->line);
}

/* ---- properties: the colour, and further channels ---- */

/* Returns the channel that a statement is about, or NULL. */
static const struct fmt_channel *find_property(const char *p, bool *is_map)
{
    const struct fmt_channel *row = &fmt_color_channel;
    for (unsigned i = 0; row; row = fmt_channel_at(i++)) {
        *is_map = row->mtl_map && word_is(p, row->mtl_map);
        if (*is_map || (row->mtl_value && word_is(p, row->mtl_value)) ||
            (row->mtl_inverse && word_is(p, row->mtl_inverse)))
            return row;
    }
    return NULL;
}

/* Reads the value of a channel from the statement at `p`. Colours are sRGB, which ends at 1; if a
 * number is above that, all three are linear light. */
static int read_channel_value(struct reader *reader, char *p, char *rest,
                              struct fmt_material_channel *entry)
{
    const bool inverse = entry->channel->mtl_inverse && word_is(p, entry->channel->mtl_inverse);
    const double most = inverse || entry->channel == &fmt_color_channel ? 1 : most_number;
    bool known = false;
    int status = read_values(reader, rest, most, entry->value, &known);
    const float *v = entry->value;
    const bool encoded = entry->channel->color && entry->channel != &fmt_color_channel &&
                         v[0] <= 1 && v[1] <= 1 && v[2] <= 1;
    for (int k = 0; k < 3 && known; k++)
        entry->value[k] = inverse   ? 1 - v[k]
                          : encoded ? (float)bsq_srgb_to_linear((double)v[k])
                                    : v[k];
    entry->has_value |= known;
    return status;
}

/* Reads a statement at `p` about a channel: its value, or its texture. */
static int read_property(struct reader *reader, const struct fmt_channel *channel, bool is_map,
                         char *p, char *rest)
{
    struct fmt_material *material = current(reader);
    struct fmt_material_channel *entry;
    if (!material)
        return warn(reader, unnamed_material, is_map ? channel->mtl_map : channel->mtl_value);
    entry = &material->color;
    if (channel != &fmt_color_channel)
        BSQ_PASS(fmt_material_enter_channel(reader->ctx, material, channel, &entry));
    return is_map ? read_map(reader, rest, entry) : read_channel_value(reader, p, rest, entry);
}

/* Returns whether a line says nothing that is kept: a comment, or a statement of rendering. Each
 * that begins with "map_" counts as one, since programs have their own. */
static bool is_ignored(const char *p)
{
    static const char *const ignored[] = {"Ka",   "Kt",    "Tf",    "Ni",   "Ns",
                                          "bump", "decal", "illum", "refl", "sharpness"};
    bool is = !*p || *p == '#' || !strncasecmp(p, "map_", 4);
    for (size_t i = 0; i < sizeof ignored / sizeof *ignored && !is; i++)
        is = word_is(p, ignored[i]);
    return is;
}

static void note_unknown(struct reader *reader)
{
    if (reader->unknown++ == 0)
        reader->first_unknown = reader->line;
}

static int read_line(struct reader *reader, char *line)
{
    char *p = skip_blanks(line);
    char *rest = skip_blanks(p + word_length(p));
    if (word_is(p, "newmtl"))
        return begin_material(reader, rest);
    bool is_map;
    const struct fmt_channel *channel = find_property(p, &is_map);
    if (channel)
        return read_property(reader, channel, is_map, p, rest);
    if (!is_ignored(p))
        note_unknown(reader);
    return 0;
}

/* Makes blanks of the line ends in a statement that a backslash continues, and ends it. */
static void join_lines(char *line, char *end)
{
    for (char *p = line; p < end; p++)
        if (*p == '\n' || *p == '\r')
            p[-1] = p[0] = ' ';
    *end = '\0';
}

static int warn_zero(struct reader *reader)
{
    return bsq_warn_loss(reader->ctx,
                         "%s:%" PRIu64 ": not a text file (zero byte): not read from here on",
                         reader->path, reader->line);
}

static int read_text(struct reader *reader, char *text, uint64_t size)
{
    char *p = text + fmt_mesh_mark(text, size), *end = text + size;
    uint64_t lines = 0; /* before `p` */
    *end = '\n';
    for (uint64_t i = 0; p < end; i++) {
        char *line = p;
        reader->line = lines + 1;
        if (i % 1024 == 0)
            BSQ_PASS(bsq_check(reader->ctx));
        p += fmt_mesh_statement_size(
            line, *skip_blanks(line) == '#' ? MESH_NOT_CONTINUED : MESH_CONTINUED_NAMES, &lines);
        if (*p == '\0')
            return warn_zero(reader);
        const int line_end = fmt_mesh_line_end(p);
        join_lines(line, p);
        p += line_end;
        lines++;
        BSQ_PASS(read_line(reader, line));
    }
    return 0;
}

static int warn_unknown(const struct reader *reader)
{
    return reader->unknown == 0
               ? 0
               : bsq_warn_loss(reader->ctx,
                               "%s:%" PRIu64 ": lines with statements that are not of the format: "
                               "%" PRIu64 "; this is the first",
                               reader->path, reader->first_unknown, reader->unknown);
}

/* Warns if the file cannot be read, and sets *readable. */
static int check_readable(const struct reader *reader, bool *readable)
{
    struct stat info;
    const char *problem = NULL;
    if (stat(reader->path, &info) || access(reader->path, R_OK))
        problem = strerror(errno);
    else if (!S_ISREG(info.st_mode))
        problem = "not a regular file";
    *readable = problem == NULL;
    if (!problem && info.st_size == 0)
        problem = "an empty file";
    if (!problem)
        return 0;
    return bsq_warn_loss(reader->ctx, "%s: %s: %s: its materials are missing", reader->place,
                         reader->path, problem);
}

/* Turns the failure to read a damaged text into a warning. */
static int warn_damaged(const struct reader *reader)
{
    char *why;
    BSQ_PASS(bsq_text_copy(reader->ctx, bsq_error(reader->ctx), &why));
    bsq_clear_error(reader->ctx);
    const int status =
        bsq_warn_loss(reader->ctx, "%s: %s: its materials are missing", reader->place, why);
    bsq_free(reader->ctx, why);
    return status;
}

int fmt_mtl_read(struct bsq_ctx *ctx, const char *path, const char *place,
                 struct fmt_materials *materials)
{
    struct reader reader = {.ctx = ctx, .path = path, .place = place, .materials = materials};
    char *text = NULL;
    uint64_t size = 0;
    bool readable;
    int status = check_readable(&reader, &readable);
    if (status || !readable)
        return status;
    status = fmt_input_text(ctx, path, OBJ_TEXT_PADDING, &text, &size);
    if (!status)
        status = read_text(&reader, text, size);
    else if (status == BSQ_EDATA)
        status = warn_damaged(&reader);
    if (!status)
        status = warn_unknown(&reader);
    bsq_free(ctx, text);
    return status;
}
