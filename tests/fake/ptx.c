/* ptx.c - reads PTX into instructions, and takes warps through them. Where the threads of a warp
 * part, they meet again at the first place that all of them come to, as GPUs arrange it (Fung,
 * Sham, Yuan, Aamodt, "Dynamic Warp Formation and Scheduling for Efficient GPU Control Flow", 2007,
 * section 2: immediate post-dominators and a stack). */
#include "tests/fake/ptx.h"

#include <ctype.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum {
    LANES = 32,
    MOST_OPERANDS = 6,
    MOST_PARAMETERS = 64,
    LOCAL_BYTES = 4096,
    MOST_BANKS = 16,
    MOST_PATHS = 256
};

/* Address spaces start here, so that one cannot pass for another. */
#define CONSTANT_BASE (1ull << 40)
#define LOCAL_BASE    (1ull << 41)

enum type { PRED, B16, B32, B64, U16, U32, U64, S16, S32, S64, F32, NO_TYPE };
static const char *const type_names[] = {"pred", "b16", "b32", "b64", "u16", "u32",
                                         "u64",  "s16", "s32", "s64", "f32"};
static const unsigned type_bytes[] = {1, 2, 4, 8, 2, 4, 8, 2, 4, 8, 4, 0};

#define OPERATIONS(X)                                                                              \
    X(abs)                                                                                         \
    X(add)                                                                                         \
    X(and)                                                                                         \
    X(bfe) X(bfi) X(bra) X(cvt) X(cvta) X(div) X(ld) X(mad) X(max) X(min) X(mov) X(mul) X(neg)     \
        X(not ) X(or) X(popc) X(rcp) X(ret) X(selp) X(setp) X(shl) X(shr) X(sqrt) X(st) X(sub)     \
            X(xor)
#define OPERATION_NUMBER(name) OP_##name,
#define OPERATION_NAME(name)   #name,
enum operation { OPERATIONS(OPERATION_NUMBER) OPERATION_COUNT };
static const char *const operation_names[] = {OPERATIONS(OPERATION_NAME)};

enum special { TID_X, TID_Y, NTID_X, NTID_Y, CTAID_X, CTAID_Y, SPECIALS };
static const char *const special_names[] = {"%tid.x",  "%tid.y",   "%ntid.x",
                                            "%ntid.y", "%ctaid.x", "%ctaid.y"};

enum space { PARAMETER, GLOBAL, CONSTANT, LOCAL };
enum half { WHOLE, LOW, HIGH, WIDE };
enum relation { EQ, NE, LT, LE, GT, GE };

struct operand {
    enum { REGISTER, VALUE, SPECIAL } kind;
    unsigned number; /* of the register */
    uint64_t value;  /* or what is added to the register */
};

struct instruction {
    enum operation operation;
    enum type type, from;
    enum space space;
    enum half half;
    enum relation relation;
    bool unordered; /* the relation holds where a side is no number */
    bool floor, truncate;
    int guard; /* a register's number, -1: none */
    bool unless;
    unsigned vector; /* of loads and stores: how many registers */
    unsigned target; /* of a branch */
    unsigned meet;   /* where threads that part here meet again */
    unsigned operand_count;
    struct operand operands[MOST_OPERANDS];
};

struct bank {
    char prefix[8];
    unsigned first, count;
};

struct ptx {
    struct instruction *code;
    unsigned count, capacity;
    struct bank banks[MOST_BANKS];
    unsigned bank_count, registers;
    unsigned parameter_count, parameter_at[MOST_PARAMETERS + 1], parameter_bytes[MOST_PARAMETERS];
    uint8_t *constants;
    unsigned constant_bytes;
    char constant_name[64];
};

/* ---- reading ---- */

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

static bool refuse(const char *what, const char *text)
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

/* "%rd12" among the banks. */
static bool read_register(const struct ptx *ptx, const char *text, unsigned *out)
{
    for (unsigned i = 0; i < ptx->bank_count; i++) {
        const struct bank *bank = &ptx->banks[i];
        const size_t length = strlen(bank->prefix);
        char *end;
        if (strncmp(text, bank->prefix, length) != 0)
            continue;
        *out = bank->first;
        if (bank->count == 0 && text[length] == '\0')
            return true;
        if (bank->count == 0 || !isdigit((unsigned char)text[length]))
            continue;
        *out += (unsigned)strtoul(text + length, &end, 10);
        if (*end == '\0' && *out < bank->first + bank->count)
            return true;
    }
    return false;
}

/* A symbol's address in its space. */
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
        return true;
    }
    if (text[0] == '%') {
        out->kind = REGISTER;
        return read_register(r->ptx, text, &out->number) || refuse("no register", text);
    }
    if (strncmp(text, "0f", 2) == 0 || strncmp(text, "0F", 2) == 0) {
        out->value = strtoull(text + 2, &end, 16);
        return *end == '\0' || refuse("no number", text);
    }
    if (isdigit((unsigned char)text[0]) || text[0] == '-') {
        out->value = text[0] == '-' ? (uint64_t)strtoll(text, &end, 0) : strtoull(text, &end, 0);
        return *end == '\0' || refuse("no number", text);
    }
    uint64_t address;
    if (!read_symbol(r, text, &address))
        return refuse("no symbol", text);
    out->value += address;
    return true;
}

static bool read_relation(const char *name, struct instruction *out)
{
    static const char *const relations[] = {"eq", "ne", "lt", "le", "gt", "ge"};
    static const char *const unordered[] = {"equ", "neu", "ltu", "leu", "gtu", "geu"};
    int number = find_name(relations, 6, name);

    if (number < 0 && (number = find_name(unordered, 6, name)) >= 0)
        out->unordered = true;
    if (number >= 0)
        out->relation = (enum relation)number;
    return number >= 0;
}

/* What follows the operation in "mul.wide.u32". */
static bool read_suffix(const char *part, struct instruction *out)
{
    static const char *const spaces[] = {"param", "global", "const", "local"};
    static const char *const halves[] = {"", "lo", "hi", "wide"};
    int number = find_name(type_names, NO_TYPE, part);

    if (number >= 0) {
        if (out->type == NO_TYPE)
            out->type = (enum type)number;
        else
            out->from = (enum type)number;
        return true;
    }
    if (out->operation == OP_setp && read_relation(part, out))
        return true;
    if ((number = find_name(spaces, 4, part)) >= 0) {
        out->space = (enum space)number;
        return true;
    }
    if ((number = find_name(halves, 4, part)) > 0) {
        out->half = (enum half)number;
        return true;
    }
    if (part[0] == 'v' && (part[1] == '2' || part[1] == '4')) {
        out->vector = (unsigned)(part[1] - '0');
        return true;
    }
    out->floor |= strcmp(part, "rmi") == 0;
    out->truncate |= strcmp(part, "rzi") == 0;
    return out->floor || out->truncate || strcmp(part, "rn") == 0 || strcmp(part, "nc") == 0 ||
           strcmp(part, "uni") == 0 || strcmp(part, "to") == 0;
}

static bool read_mnemonic(char *text, struct instruction *out)
{
    char *state, *part = strtok_r(text, ".", &state);
    const int operation = find_name(operation_names, OPERATION_COUNT, part);

    if (operation < 0)
        return refuse("no operation", part);
    out->operation = (enum operation)operation;
    while ((part = strtok_r(NULL, ".", &state)))
        if (!read_suffix(part, out))
            return refuse("no suffix", part);
    return true;
}

static unsigned find_label(const struct reader *r, const char *name)
{
    for (unsigned i = 0; i < r->label_count; i++)
        if (strcmp(r->labels[i].name, name) == 0)
            return r->labels[i].at;
    return UINT32_MAX;
}

/* Operands, with those of {a, b} one by one. */
static bool read_operands(const struct reader *r, char *text, struct instruction *out)
{
    char *state, *part;

    if (out->operation == OP_bra) {
        out->target = find_label(r, strtok_r(text, " \t", &state));
        return out->target != UINT32_MAX || refuse("no label", text);
    }
    for (part = strtok_r(text, ", \t{}", &state); part; part = strtok_r(NULL, ", \t{}", &state)) {
        if (out->operand_count == MOST_OPERANDS)
            return refuse("too many operands", part);
        if (!read_operand(r, part, &out->operands[out->operand_count++]))
            return false;
    }
    return true;
}

/* "@%p1 add.s32 %r1, %r2, 3" */
static bool read_instruction(const struct reader *r, char *text)
{
    struct instruction in = {.guard = -1, .type = NO_TYPE, .from = NO_TYPE, .vector = 1};
    struct ptx *ptx = r->ptx;
    char *rest;

    if (text[0] == '@') {
        unsigned guard;
        in.unless = text[1] == '!';
        rest = strpbrk(text, " \t");
        if (!rest)
            return refuse("no instruction", text);
        *rest++ = '\0';
        if (!read_register(ptx, text + 1 + in.unless, &guard))
            return refuse("no predicate", text);
        in.guard = (int)guard;
        text = rest + strspn(rest, " \t");
    }
    rest = text + strcspn(text, " \t");
    if (*rest)
        *rest++ = '\0';
    if (!read_mnemonic(text, &in) || !read_operands(r, rest, &in))
        return false;
    if (ptx->count == ptx->capacity) {
        ptx->capacity = ptx->capacity ? 2 * ptx->capacity : 4096;
        ptx->code = realloc(ptx->code, ptx->capacity * sizeof *ptx->code);
    }
    ptx->code[ptx->count++] = in;
    return true;
}

/* ".reg .b32 %r<17>" or ".reg .b64 %SP" */
static bool read_registers(struct ptx *ptx, const char *text)
{
    struct bank *bank = &ptx->banks[ptx->bank_count++];
    unsigned count = 0;

    if (ptx->bank_count == MOST_BANKS ||
        sscanf(text, ".reg .%*s %7[^<;]<%u>", bank->prefix, &count) < 1)
        return refuse("no registers", text);
    bank->first = ptx->registers;
    bank->count = count;
    ptx->registers += count ? count : 1;
    return true;
}

/* ".const .align 4 .b8 NAME[1024] = {0, 1, ...};" */
static bool read_constants(struct ptx *ptx, const char *text)
{
    const char *at = strstr(text, ".const .align 4 .b8 "), *value;

    if (!at)
        return true;
    if (sscanf(at, ".const .align 4 .b8 %63[^[][%u]", ptx->constant_name, &ptx->constant_bytes) !=
            2 ||
        !(value = strchr(at, '{')) || strstr(at + 1, ".const .align"))
        return refuse("no table", at);
    ptx->constants = calloc(1, ptx->constant_bytes);
    for (unsigned i = 0; i < ptx->constant_bytes; i++) {
        ptx->constants[i] = (uint8_t)strtoul(value + 1, NULL, 10);
        value = strpbrk(value + 1, ",}");
    }
    return true;
}

/* The entry's parameters, each at a multiple of its alignment. Returns the text of its body. */
static const char *read_parameters(struct ptx *ptx, const char *text, const char *name)
{
    char head[80];
    const char *at, *end;
    unsigned place = 0;

    snprintf(head, sizeof head, ".entry %s(", name);
    at = strstr(text, head);
    end = at ? strchr(at, ')') : NULL;
    while (end && (at = strstr(at, ".param ")) && at < end &&
           ptx->parameter_count < MOST_PARAMETERS) {
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

/* A line without blanks at its ends, comment and semicolon; false at the body's end. */
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

/* ---- where threads meet ---- */

/* Instructions from `first` on without a way in or out between. */
struct block {
    unsigned first, end, next[2], next_count;
    uint8_t
        *after; /* for each block, whether all ways lead through it; the last stands for the end */
    unsigned after_count;
};

static unsigned split(const struct ptx *ptx, struct block *blocks, unsigned *block_of)
{
    uint8_t *begins = calloc(ptx->count + 1, 1);
    unsigned count = 0;

    begins[0] = 1;
    for (unsigned i = 0; i < ptx->count; i++)
        if (ptx->code[i].operation == OP_bra || ptx->code[i].operation == OP_ret) {
            begins[i + 1] = 1;
            if (ptx->code[i].operation == OP_bra)
                begins[ptx->code[i].target] = 1;
        }
    for (unsigned i = 0; i < ptx->count; i++) {
        if (begins[i])
            blocks[count++].first = i;
        block_of[i] = count - 1;
    }
    block_of[ptx->count] = count;
    blocks[count].first = ptx->count;
    free(begins);
    return count;
}

static void link_blocks(const struct ptx *ptx, struct block *blocks, unsigned count,
                        const unsigned *block_of)
{
    for (unsigned b = 0; b < count; b++) {
        struct block *block = &blocks[b];
        const struct instruction *last;
        block->end = blocks[b + 1].first;
        last = &ptx->code[block->end - 1];
        if (last->operation == OP_bra)
            block->next[block->next_count++] = block_of[last->target];
        if (last->operation == OP_ret)
            block->next[block->next_count++] = count;
        else if (last->operation != OP_bra || last->guard >= 0)
            block->next[block->next_count++] = b + 1;
    }
}

/* Which blocks each way from a block leads through: more and more are found not to be. */
static void find_after(struct block *blocks, unsigned count)
{
    bool changed = true;

    while (changed) {
        changed = false;
        for (unsigned b = count; b-- > 0;)
            for (unsigned i = 0; i <= count; i++) {
                bool all = true;
                for (unsigned n = 0; n < blocks[b].next_count; n++)
                    all &= blocks[blocks[b].next[n]].after[i];
                if (i != b && blocks[b].after[i] && !all) {
                    blocks[b].after[i] = 0;
                    changed = true;
                }
            }
    }
    for (unsigned b = 0; b <= count; b++)
        for (unsigned i = 0; i <= count; i++)
            blocks[b].after_count += blocks[b].after[i];
}

static void find_meetings(struct ptx *ptx)
{
    struct block *blocks = calloc(ptx->count + 1, sizeof *blocks);
    unsigned *block_of = calloc(ptx->count + 1, sizeof *block_of);
    const unsigned count = split(ptx, blocks, block_of);

    link_blocks(ptx, blocks, count, block_of);
    for (unsigned b = 0; b <= count; b++) {
        blocks[b].after = malloc(count + 1);
        memset(blocks[b].after, b < count, count + 1);
    }
    blocks[count].after[count] = 1;
    find_after(blocks, count);
    for (unsigned b = 0; b < count; b++) {
        unsigned first = count; /* the one that all others come after */
        for (unsigned i = 0; i < count; i++)
            if (i != b && blocks[b].after[i] && blocks[i].after_count > blocks[first].after_count)
                first = i;
        ptx->code[blocks[b].end - 1].meet = blocks[first].first;
    }
    for (unsigned b = 0; b <= count; b++)
        free(blocks[b].after);
    free(blocks);
    free(block_of);
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
        refuse("no entry", name);
    }
    free(r.labels);
    if (!fine) {
        ptx_free(r.ptx);
        return NULL;
    }
    find_meetings(r.ptx);
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

/* ---- running ---- */

struct thread {
    uint64_t *registers;
    unsigned special[SPECIALS];
    uint8_t local[LOCAL_BYTES];
};

/* Threads at a place, which wait where they meet others. */
struct path {
    unsigned place, meet;
    uint32_t threads; /* bits */
};

struct warp {
    const struct ptx *ptx;
    struct ptx_launch *launch;
    const uint8_t *parameters;
    struct thread threads[LANES];
    struct path paths[MOST_PATHS]; /* the last one is gone along */
    unsigned path_count;
};

static float as_float(uint64_t bits)
{
    uint32_t low = (uint32_t)bits;
    float f;
    memcpy(&f, &low, sizeof f);
    return f;
}

static uint64_t of_float(float f)
{
    uint32_t bits;
    memcpy(&bits, &f, sizeof bits);
    return bits;
}

static uint64_t get(const struct thread *thread, const struct operand *operand)
{
    if (operand->kind == REGISTER)
        return thread->registers[operand->number] + operand->value;
    return operand->kind == SPECIAL ? thread->special[operand->number] : operand->value;
}

/* The low bits of a value as those of a type, in 64 bits. */
static uint64_t narrow(uint64_t value, enum type type)
{
    switch (type) {
    case PRED:
        return value & 1;
    case B16:
    case U16:
        return (uint16_t)value;
    case S16:
        return (uint64_t)(int16_t)value;
    case S32:
        return (uint64_t)(int32_t)value;
    case B32:
    case U32:
    case F32:
        return (uint32_t)value;
    default:
        return value;
    }
}

static bool is_signed(enum type type)
{
    return type == S16 || type == S32 || type == S64;
}

static bool holds(const struct instruction *in, uint64_t a, uint64_t b)
{
    int sign;

    if (in->type == F32) {
        const float x = as_float(a), y = as_float(b);
        if (isnan(x) || isnan(y))
            return in->unordered || in->relation == NE;
        sign = (x > y) - (x < y);
    } else if (is_signed(in->type)) {
        const int64_t x = (int64_t)narrow(a, in->type), y = (int64_t)narrow(b, in->type);
        sign = (x > y) - (x < y);
    } else {
        const uint64_t x = narrow(a, in->type), y = narrow(b, in->type);
        sign = (x > y) - (x < y);
    }
    switch (in->relation) {
    case EQ:
        return sign == 0;
    case NE:
        return sign != 0;
    case LT:
        return sign < 0;
    case LE:
        return sign <= 0;
    case GT:
        return sign > 0;
    default:
        return sign >= 0;
    }
}

static uint64_t multiply(const struct instruction *in, uint64_t a, uint64_t b)
{
    const unsigned bits = 8 * type_bytes[in->type];
    unsigned __int128 product;

    if (is_signed(in->type))
        product = (unsigned __int128)((__int128)(int64_t)narrow(a, in->type) *
                                      (int64_t)narrow(b, in->type));
    else
        product = (unsigned __int128)narrow(a, in->type) * narrow(b, in->type);
    return (uint64_t)(in->half == HIGH ? product >> bits : product);
}

/* Smaller or larger of two numbers; of one and none the number, and -0 is less than +0. */
static float float_extreme(float a, float b, bool larger)
{
    if (isnan(a) || isnan(b))
        return isnan(a) ? b : a;
    if (a == b)
        return !signbit(a) == larger ? a : b;
    return (a > b) == larger ? a : b;
}

static uint64_t extreme(const struct instruction *in, uint64_t a, uint64_t b, bool larger)
{
    if (in->type == F32)
        return of_float(float_extreme(as_float(a), as_float(b), larger));
    if (is_signed(in->type))
        return ((int64_t)narrow(a, in->type) > (int64_t)narrow(b, in->type)) == larger ? a : b;
    return (narrow(a, in->type) > narrow(b, in->type)) == larger ? a : b;
}

static uint64_t convert(const struct instruction *in, uint64_t a)
{
    if (in->from == F32) {
        const float f = as_float(a);
        if (in->type == F32)
            return of_float(in->floor ? floorf(f) : f);
        if (isnan(f))
            return 0;
        return (uint64_t)(int64_t)(f <= -0x1p31f  ? INT32_MIN
                                   : f >= 0x1p31f ? INT32_MAX
                                                  : (int32_t)f);
    }
    a = narrow(a, in->from);
    if (in->type == F32)
        return of_float(is_signed(in->from) ? (float)(int64_t)a : (float)a);
    return a;
}

static uint64_t shift(const struct instruction *in, uint64_t a, uint64_t by)
{
    const unsigned bits = 8 * type_bytes[in->type];

    by = (uint32_t)by;
    if (in->operation == OP_shl)
        return by < bits ? a << by : 0;
    if (is_signed(in->type))
        return (uint64_t)((int64_t)narrow(a, in->type) >> (by < bits ? by : bits - 1));
    return by < bits ? narrow(a, in->type) >> by : 0;
}

static uint64_t low_bits(uint64_t count)
{
    return count < 64 ? (UINT64_C(1) << count) - 1 : UINT64_MAX;
}

static uint64_t float_operation(const struct instruction *in, float a, float b)
{
    switch (in->operation) {
    case OP_add:
        return of_float(a + b);
    case OP_sub:
        return of_float(a - b);
    case OP_mul:
        return of_float(a * b);
    case OP_div:
        return of_float(a / b);
    case OP_rcp:
        return of_float(1.0f / a);
    default:
        return of_float(sqrtf(a));
    }
}

/* The result of an operation on registers. */
static uint64_t compute(const struct instruction *in, const uint64_t v[MOST_OPERANDS])
{
    const bool real = in->type == F32;
    const uint64_t a = v[1], b = v[2], c = v[3];

    switch (in->operation) {
    case OP_abs:
        return real ? a & 0x7fffffff : (uint64_t)llabs((int64_t)narrow(a, in->type));
    case OP_neg:
        return real ? a ^ 0x80000000 : 0 - a;
    case OP_add:
    case OP_sub:
        if (!real)
            return in->operation == OP_add ? a + b : a - b;
        return float_operation(in, as_float(a), as_float(b));
    case OP_mul:
        return real ? float_operation(in, as_float(a), as_float(b)) : multiply(in, a, b);
    case OP_div:
    case OP_rcp:
    case OP_sqrt:
        return float_operation(in, as_float(a), as_float(b));
    case OP_mad:
        return multiply(in, a, b) + c;
    case OP_and:
        return a & b;
    case OP_or:
        return a | b;
    case OP_xor:
        return a ^ b;
    case OP_not:
        return ~a;
    case OP_shl:
    case OP_shr:
        return shift(in, a, b);
    case OP_bfe:
        return narrow(a, in->type) >> (b & 255) & low_bits(c & 255);
    case OP_bfi: {
        const uint64_t mask = low_bits(v[4] & 255) << (c & 63);
        return (b & ~mask) | (a << (c & 63) & mask);
    }
    case OP_popc:
        return (uint64_t)__builtin_popcountll(narrow(a, in->type));
    case OP_max:
    case OP_min:
        return extreme(in, a, b, in->operation == OP_max);
    case OP_selp:
        return c & 1 ? a : b;
    case OP_setp:
        return holds(in, a, b);
    case OP_cvt:
        return convert(in, a);
    default: /* mov, cvta */
        return a;
    }
}

/* The type that a result has, which may be another than its operands'. */
static enum type result_type(const struct instruction *in)
{
    if (in->operation == OP_setp)
        return PRED;
    if (in->operation == OP_popc)
        return U32;
    if (in->operation == OP_mul && in->half == WIDE)
        return U64;
    return in->type == S32 ? U32 : in->type == S16 ? U16 : in->type;
}

static void *find_memory(struct warp *warp, struct thread *thread, enum space space,
                         uint64_t address, size_t bytes)
{
    const struct ptx *ptx = warp->ptx;

    switch (space) {
    case PARAMETER:
        return address + bytes <= ptx->parameter_at[ptx->parameter_count]
                   ? (void *)(uintptr_t)(warp->parameters + address)
                   : NULL;
    case CONSTANT:
        return address >= CONSTANT_BASE && address - CONSTANT_BASE + bytes <= ptx->constant_bytes
                   ? ptx->constants + (address - CONSTANT_BASE)
                   : NULL;
    case LOCAL:
        return address >= LOCAL_BASE && address - LOCAL_BASE + bytes <= LOCAL_BYTES
                   ? thread->local + (address - LOCAL_BASE)
                   : NULL;
    default:
        return address % bytes ? NULL : warp->launch->memory(address, bytes);
    }
}

/* ld and st */
static bool move_memory(struct warp *warp, struct thread *thread, const struct instruction *in)
{
    const bool store = in->operation == OP_st;
    const unsigned first = store ? 1 : 0, bytes = type_bytes[in->type];
    uint64_t address = get(thread, &in->operands[store ? 0 : in->vector]);

    for (unsigned i = 0; i < in->vector; i++, address += bytes) {
        void *memory = find_memory(warp, thread, in->space, address, bytes);
        const struct operand *operand = &in->operands[first + i];
        uint64_t value = 0;
        if (!memory) {
            fprintf(stderr, "fake CUDA: PTX: instruction %td is outside of the memory: %#llx\n",
                    in - warp->ptx->code, (unsigned long long)address);
            return false;
        }
        if (store) {
            value = get(thread, operand);
            memcpy(memory, &value, bytes);
        } else {
            memcpy(&value, memory, bytes);
            thread->registers[operand->number] = value;
        }
    }
    return true;
}

static bool is_on(const struct thread *thread, const struct instruction *in)
{
    return in->guard < 0 || (thread->registers[in->guard] & 1) != in->unless;
}

static bool step(struct warp *warp, struct thread *thread, const struct instruction *in)
{
    uint64_t values[MOST_OPERANDS] = {0};

    if (!is_on(thread, in))
        return true;
    if (in->operation == OP_ld || in->operation == OP_st)
        return move_memory(warp, thread, in);
    for (unsigned i = 1; i < in->operand_count; i++)
        values[i] = get(thread, &in->operands[i]);
    thread->registers[in->operands[0].number] = narrow(compute(in, values), result_type(in));
    return true;
}

/* Where only some threads branch, both ways are gone one after the other, and then on from where
 * they meet. */
static void branch(struct warp *warp, const struct instruction *in)
{
    struct path *path = &warp->paths[warp->path_count - 1];
    const struct path whole = *path;
    uint32_t taken = 0;

    for (int i = 0; i < LANES; i++)
        if (whole.threads >> i & 1 && is_on(&warp->threads[i], in))
            taken |= UINT32_C(1) << i;
    path->place = taken ? in->target : whole.place + 1;
    if (taken == 0 || taken == whole.threads)
        return;
    if (in->meet != whole.meet) {
        path->place = in->meet;
        warp->path_count++;
    }
    warp->paths[warp->path_count - 1] =
        (struct path){whole.place + 1, in->meet, whole.threads & ~taken};
    warp->paths[warp->path_count++] = (struct path){in->target, in->meet, taken};
}

static bool run_warp(struct warp *warp)
{
    bool fine = true;

    while (fine && warp->path_count > 0) {
        struct path *path = &warp->paths[warp->path_count - 1];
        const struct instruction *in = &warp->ptx->code[path->place];
        if (path->place == path->meet) {
            warp->path_count--;
            continue;
        }
        warp->launch->instructions++;
        if (in->operation == OP_bra) {
            branch(warp, in);
            fine = warp->path_count + 2 < MOST_PATHS || refuse("branches are too deep", "");
            continue;
        }
        for (int i = 0; i < LANES && fine && in->operation != OP_ret; i++)
            if (path->threads >> i & 1)
                fine = step(warp, &warp->threads[i], in);
        path->place = in->operation == OP_ret ? warp->ptx->count : path->place + 1;
    }
    return fine;
}

static void begin_warp(struct warp *warp, unsigned block_x, unsigned block_y, unsigned first)
{
    const struct ptx_launch *launch = warp->launch;
    uint32_t threads = 0;

    for (unsigned i = 0; i < LANES; i++) {
        struct thread *thread = &warp->threads[i];
        const unsigned number = first + i;
        const bool there = number < launch->block_x * launch->block_y;
        const unsigned special[] = {number % launch->block_x,
                                    number / launch->block_x,
                                    launch->block_x,
                                    launch->block_y,
                                    block_x,
                                    block_y};
        threads |= (uint32_t)there << i;
        memcpy(thread->special, special, sizeof special);
        memset(thread->registers, 0xa5, warp->ptx->registers * sizeof *thread->registers);
    }
    warp->paths[0] = (struct path){.meet = warp->ptx->count, .threads = threads};
    warp->path_count = 1;
}

bool ptx_run(const struct ptx *ptx, struct ptx_launch *launch)
{
    struct warp *warp = calloc(1, sizeof *warp);
    uint8_t *parameters = calloc(1, ptx->parameter_at[ptx->parameter_count] + 1);
    uint64_t *registers = calloc((size_t)LANES * ptx->registers, sizeof *registers);
    bool fine = true;

    for (unsigned i = 0; i < ptx->parameter_count; i++)
        memcpy(parameters + ptx->parameter_at[i], launch->parameters[i], ptx->parameter_bytes[i]);
    warp->ptx = ptx;
    warp->launch = launch;
    warp->parameters = parameters;
    for (unsigned i = 0; i < LANES; i++)
        warp->threads[i].registers = registers + (size_t)i * ptx->registers;
    for (unsigned y = 0; y < launch->grid_y && fine; y++)
        for (unsigned x = 0; x < launch->grid_x && fine; x++)
            for (unsigned first = 0; first < launch->block_x * launch->block_y && fine;
                 first += LANES) {
                begin_warp(warp, x, y, first);
                fine = run_warp(warp);
            }
    free(registers);
    free(parameters);
    free(warp);
    return fine;
}
