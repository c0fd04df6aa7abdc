/* ptx_read.c - reads PTX into instructions. */
#include <ctype.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "tests/fake/ptx_internal.h"

static const char *const special_names[] = {"%tid.x",  "%tid.y",   "%ntid.x",
                                            "%ntid.y", "%ctaid.x", "%ctaid.y"};

struct label {
    char name[64];
    unsigned at;
};

struct reader {
    struct ptx *ptx;
    char entry[64];
    struct label *labels;
    unsigned label_count;
};

bool ptx_refuse(const char *what, const char *text)
{
    fprintf(stderr, "fake CUDA: PTX: %s: %.80s\n", what, text);
    return false;
}

static int find_name(const char *const *names, int count, const char *name)
{
    for (int i = 0; i < count; i++)
        if (strcmp(names[i], name) == 0)
            return i;
    return -1;
}

/* Finds the register "%rd12" in its bank. */
static bool read_register(const struct ptx *ptx, const char *text, struct operand *out)
{
    for (unsigned i = 0; i < ptx->bank_count; i++) {
        const struct bank *bank = &ptx->banks[i];
        const size_t length = strlen(bank->prefix);
        char *end;
        if (strncmp(text, bank->prefix, length) != 0)
            continue;
        *out = (struct operand){
            .kind = REGISTER, .number = bank->first, .width = bank->width, .value = out->value};
        if (bank->count == 0 && text[length] == '\0')
            return true;
        if (bank->count == 0 || !isdigit((unsigned char)text[length]))
            continue;
        out->number += (unsigned)strtoul(text + length, &end, 10);
        if (*end == '\0' && out->number < bank->first + bank->count)
            return true;
    }
    return false;
}

/* Finds a symbol's address in its space. */
static bool read_symbol(const struct reader *r, const char *text, uint64_t *out)
{
    char prefix[80];
    int length = snprintf(prefix, sizeof prefix, "%s_param_", r->entry);

    if (strncmp(text, prefix, (size_t)length) == 0) {
        unsigned long number = strtoul(text + length, NULL, 10);
        *out = number < r->ptx->parameter_count ? r->ptx->parameter_at[number] : 0;
        return number < r->ptx->parameter_count;
    }
    if (strcmp(text, r->ptx->constant_name) == 0)
        *out = CONSTANT_BASE;
    else if (strncmp(text, "__local_depot", strlen("__local_depot")) == 0)
        *out = LOCAL_BASE;
    else
        return false;
    return true;
}

static bool read_operand(const struct reader *r, char *text, struct operand *out)
{
    char *plus, *end;
    int special;

    *out = (struct operand){.kind = VALUE};
    if (text[0] == '[') {
        text[strlen(text) - 1] = '\0';
        text++;
        if ((plus = strchr(text, '+'))) {
            *plus = '\0';
            out->value = (uint64_t)strtoll(plus + 1, NULL, 0);
        }
    }
    if ((special = find_name(special_names, SPECIALS, text)) >= 0) {
        out->kind = SPECIAL;
        out->number = (unsigned)special;
        out->width = 'w';
        return true;
    }
    if (text[0] == '%')
        return read_register(r->ptx, text, out) || ptx_refuse("no register", text);
    if (strncmp(text, "0f", 2) == 0 || strncmp(text, "0F", 2) == 0) {
        out->value = strtoull(text + 2, &end, 16);
        return *end == '\0' || ptx_refuse("no number", text);
    }
    if (isdigit((unsigned char)text[0]) || text[0] == '-') {
        out->value = text[0] == '-' ? (uint64_t)strtoll(text, &end, 0) : strtoull(text, &end, 0);
        return *end == '\0' || ptx_refuse("no number", text);
    }
    uint64_t address;
    if (!read_symbol(r, text, &address))
        return ptx_refuse("no symbol", text);
    out->value += address;
    return true;
}

/* Returns whether an operand may stand where the row has this width. */
static bool fits(const struct operand *operand, char width)
{
    static const char widths[] = "phwd";
    const char *wanted = strchr(widths, tolower((unsigned char)width));

    if (operand->kind == VALUE || operand->width == width)
        return true;
    return isupper((unsigned char)width) && strchr(wanted, operand->width);
}

/* Checks number and widths of the operands. In a load or store, the address may be a constant. */
static bool check_operands(const struct instruction *in)
{
    const char *widths = in->row->widths;

    if (in->operand_count != strlen(widths))
        return false;
    for (unsigned i = 0; i < in->operand_count; i++)
        if (!fits(&in->operands[i], widths[i]))
            return false;
    return in->row->kind == STORE || in->operand_count == 0 || in->operands[0].kind == REGISTER;
}

static unsigned find_label(const struct reader *r, const char *name)
{
    for (unsigned i = 0; i < r->label_count; i++)
        if (strcmp(r->labels[i].name, name) == 0)
            return r->labels[i].at;
    return UINT32_MAX;
}

/* Reads the operands; those of a vector {a, b} count singly. */
static bool read_operands(const struct reader *r, char *text, struct instruction *out)
{
    char *state, *part;

    if (out->row->kind == BRANCH) {
        out->target = find_label(r, strtok_r(text, " \t", &state));
        return out->target != UINT32_MAX || ptx_refuse("no label", text);
    }
    for (part = strtok_r(text, ", \t{}", &state); part; part = strtok_r(NULL, ", \t{}", &state)) {
        if (out->operand_count == MAX_OPERANDS)
            return ptx_refuse("too many operands", part);
        if (!read_operand(r, part, &out->operands[out->operand_count++]))
            return false;
    }
    return check_operands(out) || ptx_refuse("wrong operands", out->row->name);
}

/* Reads an instruction, as "@%p1 add.s32 %r1, %r2, 3". */
static bool read_instruction(const struct reader *r, char *text)
{
    struct instruction in = {.guard = -1};
    struct ptx *ptx = r->ptx;
    char *rest;

    if (text[0] == '@') {
        struct operand guard = {.value = 0};
        in.unless = text[1] == '!';
        rest = strpbrk(text, " \t");
        if (!rest)
            return ptx_refuse("no instruction", text);
        *rest++ = '\0';
        if (!read_register(ptx, text + 1 + in.unless, &guard) || guard.width != 'p')
            return ptx_refuse("no predicate", text);
        in.guard = (int)guard.number;
        text = rest + strspn(rest, " \t");
    }
    rest = text + strcspn(text, " \t");
    if (*rest)
        *rest++ = '\0';
    in.row = ptx_find_row(text);
    if (!in.row)
        return ptx_refuse("no instruction", text);
    if (!read_operands(r, rest, &in))
        return false;
    if (ptx->count == ptx->capacity) {
        ptx->capacity = ptx->capacity ? 2 * ptx->capacity : 4096;
        ptx->code = realloc(ptx->code, ptx->capacity * sizeof *ptx->code);
    }
    ptx->code[ptx->count++] = in;
    return true;
}

/* Reads ".reg .b32 %r<17>" or ".reg .b64 %SP". */
static bool read_registers(struct ptx *ptx, const char *text)
{
    static const char *const types[] = {"pred", "b16", "u16", "s16", "b32", "u32",
                                        "s32",  "f32", "b64", "u64", "s64"};
    struct bank *bank = &ptx->banks[ptx->bank_count++];
    unsigned count = 0;
    char type[8];
    int number;

    if (ptx->bank_count == MAX_BANKS ||
        sscanf(text, ".reg .%7s %7[^<;]<%u>", type, bank->prefix, &count) < 2 ||
        (number = find_name(types, sizeof types / sizeof types[0], type)) < 0)
        return ptx_refuse("no registers", text);
    bank->width = "phhhwwwwddd"[number];
    bank->first = ptx->registers;
    bank->count = count;
    ptx->registers += count ? count : 1;
    return true;
}

/* Reads ".const .align 4 .b8 NAME[1024] = {0, 1, ...};". */
static bool read_constants(struct ptx *ptx, const char *text)
{
    const char *at = strstr(text, ".const .align 4 .b8 "), *value;

    if (!at)
        return true;
    if (sscanf(at, ".const .align 4 .b8 %63[^[][%u]", ptx->constant_name, &ptx->constant_bytes) !=
            2 ||
        !(value = strchr(at, '{')) || strstr(at + 1, ".const .align"))
        return ptx_refuse("no table", at);
    ptx->constants = calloc(1, ptx->constant_bytes);
    for (unsigned i = 0; i < ptx->constant_bytes; i++) {
        ptx->constants[i] = (uint8_t)strtoul(value + 1, NULL, 10);
        value = strpbrk(value + 1, ",}");
    }
    return true;
}

/* Reads the entry's parameters, each at a multiple of its alignment. Returns the text of its body.
 */
static const char *read_parameters(struct ptx *ptx, const char *text, const char *name)
{
    char head[80];
    const char *at, *end;
    unsigned place = 0;

    snprintf(head, sizeof head, ".entry %s(", name);
    at = strstr(text, head);
    end = at ? strchr(at, ')') : NULL;
    while (end && (at = strstr(at, ".param ")) && at < end &&
           ptx->parameter_count < MAX_PARAMETERS) {
        unsigned align, bytes, bits;
        if (sscanf(at, ".param .align %u .b8 %*[^[][%u]", &align, &bytes) != 2) {
            if (sscanf(at, ".param .%*[usbf]%u", &bits) != 1)
                return NULL;
            align = bytes = bits / 8;
        }
        place = (place + align - 1) / align * align;
        ptx->parameter_at[ptx->parameter_count] = place;
        ptx->parameter_bytes[ptx->parameter_count++] = bytes;
        place += bytes;
        at++;
    }
    ptx->parameter_at[ptx->parameter_count] = place;
    return end ? strchr(end, '{') : NULL;
}

/* Reads a line without outer blanks, comment and semicolon. Returns false at the body's end. */
static bool next_line(const char **at, char *line, size_t bytes)
{
    const char *end = strchr(*at, '\n');
    size_t length;
    char *comment;

    *at += strspn(*at, " \t");
    if (!end || **at == '}')
        return false;
    length = (size_t)(end - *at) < bytes - 1 ? (size_t)(end - *at) : bytes - 1;
    memcpy(line, *at, length);
    line[length] = '\0';
    if ((comment = strstr(line, "//")))
        *comment = '\0';
    for (length = strlen(line); length && strchr(" \t;", line[length - 1]);)
        line[--length] = '\0';
    *at = end + 1;
    return true;
}

static bool is_label(const char *line)
{
    return line[0] && line[strlen(line) - 1] == ':';
}

static void read_labels(struct reader *r, const char *body)
{
    char line[256];
    unsigned at = 0;

    r->labels = calloc(strlen(body) / 8 + 1, sizeof *r->labels);
    while (next_line(&body, line, sizeof line))
        if (is_label(line)) {
            struct label *label = &r->labels[r->label_count++];
            snprintf(label->name, sizeof label->name, "%.*s", (int)strlen(line) - 1, line);
            label->at = at;
        } else if (line[0] && line[0] != '.') {
            at++;
        }
}

static bool read_body(struct reader *r, const char *body)
{
    char line[256];
    bool fine = true;

    while (fine && next_line(&body, line, sizeof line)) {
        if (strncmp(line, ".reg", 4) == 0)
            fine = read_registers(r->ptx, line);
        else if (line[0] && line[0] != '.' && !is_label(line))
            fine = read_instruction(r, line);
    }
    return fine;
}

struct ptx *ptx_read(const char *text, const char *name)
{
    struct reader r = {.ptx = calloc(1, sizeof *r.ptx)};
    const char *body = read_parameters(r.ptx, text, name);
    bool fine = body && read_constants(r.ptx, text);

    snprintf(r.entry, sizeof r.entry, "%s", name);
    if (fine) {
        body = strchr(body, '\n') + 1;
        read_labels(&r, body);
        fine = read_body(&r, body);
    } else {
        ptx_refuse("no entry", name);
    }
    free(r.labels);
    if (!fine) {
        ptx_free(r.ptx);
        return NULL;
    }
    ptx_find_reconvergence(r.ptx);
    return r.ptx;
}

void ptx_free(struct ptx *ptx)
{
    if (!ptx)
        return;
    free(ptx->code);
    free(ptx->constants);
    free(ptx);
}
