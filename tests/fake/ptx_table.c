/* ptx_table.c - the instructions of PTX that this machine knows, each under its full name. A name
 * that is not in the table is refused: a rounding mode, a width or a type changes what an
 * instruction does (NVIDIA, "PTX ISA", 2013-2025, "Instruction Set").
 *
 * Operands arrive with their upper bits zero; results are cut to their width. */
#include <math.h>
#include <string.h>

#include "tests/fake/ptx_internal.h"

static float as_float(uint64_t bits)
{
    uint32_t low = (uint32_t)bits;
    float f;
    memcpy(&f, &low, sizeof f);
    return f;
}

/* NVIDIA's processors give all NaN results the same bits. */
static uint64_t of_float(float f)
{
    uint32_t bits;
    memcpy(&bits, &f, sizeof bits);
    return isnan(f) ? 0x7fffffff : bits;
}

/* Returns the smaller or larger of two numbers. Ignores NaN if the other is a number; -0 < +0. */
static float extreme(float a, float b, bool larger)
{
    if (isnan(a) || isnan(b))
        return isnan(a) ? b : a;
    if (a == b)
        return !signbit(a) == larger ? a : b;
    return (a > b) == larger ? a : b;
}

/* Converts towards zero; values out of range become the nearest one, NaN becomes 0. */
static uint64_t to_s32(float f)
{
    if (isnan(f))
        return 0;
    if (f >= 0x1p31f)
        return INT32_MAX;
    return (uint64_t)(f <= -0x1p31f ? INT32_MIN : (int32_t)f);
}

/* Returns bit `at` of a value. */
static uint64_t bit(uint64_t a, uint64_t at)
{
    return a >> at & 1;
}

/* bfe: `count` bits of `bits` from bit `first` on; what lies beyond is zero or the sign. */
static uint64_t extract(uint64_t a, uint64_t first, uint64_t count, unsigned bits, bool is_signed)
{
    uint64_t result = 0, last;

    first &= 255;
    count &= 255;
    last = first + count - 1 < bits - 1 ? first + count - 1 : bits - 1;
    for (uint64_t i = 0; i < bits; i++) {
        const bool inside = i < count && first + i < bits;
        const uint64_t sign = is_signed && count > 0 ? bit(a, last) : 0;
        result |= (inside ? bit(a, first + i) : sign) << i;
    }
    return result;
}

/* bfi: b with `count` of its bits, from bit `first` on, taken from a. */
static uint64_t insert(uint64_t a, uint64_t b, uint64_t first, uint64_t count, unsigned bits)
{
    first &= 255;
    count &= 255;
    for (uint64_t i = 0; i < count && first + i < bits; i++)
        b = (b & ~(UINT64_C(1) << (first + i))) | bit(a, i) << (first + i);
    return b;
}

/* Shifts by more than the width act as by the width. */
static uint64_t shift_right(int64_t a, uint64_t by, unsigned bits)
{
    return (uint64_t)(a >> (by < bits ? by : bits - 1));
}

#define F(x)          as_float(x)
#define S16(x)        ((int64_t)(int16_t)(x))
#define S32(x)        ((int64_t)(int32_t)(x))
#define S64(x)        ((int64_t)(x))
#define U32(x)        ((uint64_t)(uint32_t)(x))
#define U64(x)        ((uint64_t)(x))
#define NUMBERS(x, y) (!isnan(x) && !isnan(y))
#define FLOAT(x)      of_float(x)

/* X(name, its text, widths of result and operands, result). The operands are a, b, c and d. */
#define RELATION(X, name, sign)                                                                    \
    X(setp_##name##_s32, "setp." #name ".s32", "pww", S32(a) sign S32(b))                          \
    X(setp_##name##_u32, "setp." #name ".u32", "pww", a sign b)                                    \
    X(setp_##name##_s64, "setp." #name ".s64", "pdd", S64(a) sign S64(b))                          \
    X(setp_##name##_u64, "setp." #name ".u64", "pdd", a sign b)                                    \
    X(setp_##name##_f32, "setp." #name ".f32", "pww", NUMBERS(F(a), F(b)) && F(a) sign F(b))       \
    X(setp_##name##u_f32, "setp." #name "u.f32", "pww", !NUMBERS(F(a), F(b)) || F(a) sign F(b))
/* Instructions that work on bits alone. */
#define BITS(X, type, w)                                                                           \
    X(and_##type, "and." #type, w w w, a &b)                                                       \
    X(or_##type, "or." #type, w w w, a | b)                                                        \
    X(xor_##type, "xor." #type, w w w, a ^ b)                                                      \
    X(not_##type, "not." #type, w w, ~a)
#define SAME(X, type, w)                                                                           \
    X(mov_##type, "mov." #type, w w, a)                                                            \
    X(selp_##type, "selp." #type, w w w "p", c ? a : b)
/* Sums, differences and low halves of products do not depend on the sign. */
#define WHOLE(X, type, w)                                                                          \
    X(add_##type, "add." #type, w w w, a + b)                                                      \
    X(sub_##type, "sub." #type, w w w, a - b)                                                      \
    X(mul_lo_##type, "mul.lo." #type, w w w, a *b)                                                 \
    X(mad_lo_##type, "mad.lo." #type, w w w w, a *b + c)
#define EXTREMES(X, type, w, CAST)                                                                 \
    X(min_##type, "min." #type, w w w, U64(CAST(a) < CAST(b) ? CAST(a) : CAST(b)))                 \
    X(max_##type, "max." #type, w w w, U64(CAST(a) > CAST(b) ? CAST(a) : CAST(b)))

/* clang-format off */
#define COMPUTED(X)                                                                                \
    RELATION(X, eq, ==) RELATION(X, ne, !=) RELATION(X, lt, <)                                     \
    RELATION(X, le, <=) RELATION(X, gt, >) RELATION(X, ge, >=)                                     \
    X(setp_eq_b32, "setp.eq.b32", "pww", a == b)                                                   \
    X(setp_ne_b32, "setp.ne.b32", "pww", a != b)                                                   \
    X(setp_eq_b64, "setp.eq.b64", "pdd", a == b)                                                   \
    X(setp_ne_b64, "setp.ne.b64", "pdd", a != b)                                                   \
    BITS(X, pred, "p") BITS(X, b32, "w") BITS(X, b64, "d")                                         \
    X(mov_pred, "mov.pred", "pp", a)                                                               \
    SAME(X, b32, "w") SAME(X, u32, "w") SAME(X, s32, "w") SAME(X, f32, "w")                        \
    SAME(X, b64, "d") SAME(X, u64, "d") SAME(X, s64, "d")                                          \
    WHOLE(X, u32, "w") WHOLE(X, s32, "w") WHOLE(X, u64, "d") WHOLE(X, s64, "d")                    \
    EXTREMES(X, u32, "w", U64) EXTREMES(X, s32, "w", S32)                                          \
    EXTREMES(X, u64, "d", U64) EXTREMES(X, s64, "d", S64)                                          \
    X(mul_wide_u32, "mul.wide.u32", "dww", a * b)                                                  \
    X(mul_wide_s32, "mul.wide.s32", "dww", U64(S32(a) * S32(b)))                                   \
    X(mul_hi_u32, "mul.hi.u32", "www", a * b >> 32)                                                \
    X(mul_hi_u64, "mul.hi.u64", "ddd", U64((unsigned __int128)a * b >> 64))                        \
    X(neg_s32, "neg.s32", "ww", 0 - a)                                                             \
    X(neg_s64, "neg.s64", "dd", 0 - a)                                                             \
    X(shl_b32, "shl.b32", "www", b < 32 ? a << b : 0)                                              \
    X(shl_b64, "shl.b64", "ddw", b < 64 ? a << b : 0)                                              \
    X(shr_b32, "shr.b32", "www", b < 32 ? a >> b : 0)                                              \
    X(shr_b64, "shr.b64", "ddw", b < 64 ? a >> b : 0)                                              \
    X(shr_u32, "shr.u32", "www", b < 32 ? a >> b : 0)                                              \
    X(div_u32, "div.u32", "www", b ? a / b : 0)                                                    \
    X(rem_u32, "rem.u32", "www", b ? a % b : 0)                                                    \
    X(shr_u64, "shr.u64", "ddw", b < 64 ? a >> b : 0)                                              \
    X(shr_s32, "shr.s32", "www", shift_right(S32(a), b, 32))                                       \
    X(shr_s64, "shr.s64", "ddw", shift_right(S64(a), b, 64))                                       \
    X(bfe_u32, "bfe.u32", "wwww", extract(a, b, c, 32, false))                                     \
    X(bfe_s32, "bfe.s32", "wwww", extract(a, b, c, 32, true))                                      \
    X(bfe_u64, "bfe.u64", "ddww", extract(a, b, c, 64, false))                                     \
    X(bfe_s64, "bfe.s64", "ddww", extract(a, b, c, 64, true))                                      \
    X(bfi_b32, "bfi.b32", "wwwww", insert(a, b, c, d, 32))                                         \
    X(bfi_b64, "bfi.b64", "dddww", insert(a, b, c, d, 64))                                         \
    X(popc_b32, "popc.b32", "ww", U64(__builtin_popcountll(a)))                                    \
    X(popc_b64, "popc.b64", "wd", U64(__builtin_popcountll(a)))                                    \
    X(cvt_s32_s16, "cvt.s32.s16", "wH", U64(S16(a)))                                               \
    X(cvt_u32_u64, "cvt.u32.u64", "wd", a)                                                         \
    X(cvt_u64_u32, "cvt.u64.u32", "dW", U32(a))                                                    \
    X(cvt_s64_s32, "cvt.s64.s32", "dW", U64(S32(a)))                                               \
    X(cvt_rn_f32_s32, "cvt.rn.f32.s32", "ww", FLOAT((float)S32(a)))                                \
    X(cvt_rn_f32_u32, "cvt.rn.f32.u32", "ww", FLOAT((float)a))                                     \
    X(cvt_rzi_s32_f32, "cvt.rzi.s32.f32", "ww", to_s32(F(a)))                                      \
    X(cvt_rmi_f32_f32, "cvt.rmi.f32.f32", "ww", FLOAT(floorf(F(a))))                               \
    X(abs_f32, "abs.f32", "ww", FLOAT(fabsf(F(a))))                                                \
    X(neg_f32, "neg.f32", "ww", FLOAT(-F(a)))                                                      \
    X(min_f32, "min.f32", "www", FLOAT(extreme(F(a), F(b), false)))                                \
    X(max_f32, "max.f32", "www", FLOAT(extreme(F(a), F(b), true)))                                 \
    X(add_rn_f32, "add.rn.f32", "www", FLOAT(F(a) + F(b)))                                         \
    X(sub_rn_f32, "sub.rn.f32", "www", FLOAT(F(a) - F(b)))                                         \
    X(mul_rn_f32, "mul.rn.f32", "www", FLOAT(F(a) * F(b)))                                         \
    X(div_rn_f32, "div.rn.f32", "www", FLOAT(F(a) / F(b)))                                         \
    X(rcp_rn_f32, "rcp.rn.f32", "ww", FLOAT(1.0f / F(a)))                                          \
    X(sqrt_rn_f32, "sqrt.rn.f32", "ww", FLOAT(sqrtf(F(a))))                                        \
    X(cvta_to_global_u64, "cvta.to.global.u64", "dd", a)
/* clang-format on */

#define FUNCTION(name, text, widths, result)                                                       \
    static uint64_t name(uint64_t a, uint64_t b, uint64_t c, uint64_t d)                           \
    {                                                                                              \
        (void)a, (void)b, (void)c, (void)d;                                                        \
        return (uint64_t)(result);                                                                 \
    }
COMPUTED(FUNCTION)

#define MOVE(text, widths_of, is_store, from, size, registers)                                     \
    {.name = (text),                                                                               \
     .widths = (widths_of),                                                                        \
     .kind = (is_store) ? STORE : LOAD,                                                            \
     .space = (from),                                                                              \
     .bytes = (size),                                                                              \
     .vector = (registers)},
#define LOADS_OF(text, space, type, w, size)                                                       \
    MOVE("ld." text type, w "d", 0, space, size, 1)                                                \
    MOVE("ld." text "v2." type, w w "d", 0, space, size, 2)                                        \
    MOVE("ld." text "v4." type, w w w w "d", 0, space, size, 4)
#define STORES_OF(text, space, type, w, size)                                                      \
    MOVE("st." text type, "d" w, 1, space, size, 1)                                                \
    MOVE("st." text "v2." type, "d" w w, 1, space, size, 2)                                        \
    MOVE("st." text "v4." type, "d" w w w w, 1, space, size, 4)
/* Registers may be wider than what is moved; then the upper bits are zero, or are not stored. */
#define EACH_TYPE(X, text, space)                                                                  \
    X(text, space, "b32", "W", 4)                                                                  \
    X(text, space, "u32", "W", 4)                                                                  \
    X(text, space, "s32", "w", 4)                                                                  \
    X(text, space, "f32", "w", 4)                                                                  \
    X(text, space, "b64", "d", 8)                                                                  \
    X(text, space, "u64", "d", 8)                                                                  \
    X(text, space, "s64", "d", 8)

static const struct row rows[] = {
#define COMPUTED_ROW(function, text, widths_of, result)                                            \
    {.name = (text), .widths = (widths_of), .kind = COMPUTE, .compute = (function), .vector = 1},
    COMPUTED(COMPUTED_ROW) EACH_TYPE(LOADS_OF, "param.", PARAMETER) EACH_TYPE(LOADS_OF, "const.",
                                                                              CONSTANT)
        EACH_TYPE(LOADS_OF, "global.", GLOBAL) EACH_TYPE(LOADS_OF, "global.nc.", GLOBAL)
            EACH_TYPE(LOADS_OF, "local.", LOCAL) EACH_TYPE(STORES_OF, "global.", GLOBAL)
                EACH_TYPE(STORES_OF, "local.", LOCAL){.name = "bra", .widths = "", .kind = BRANCH},
    {.name = "bra.uni", .widths = "", .kind = BRANCH},
    {.name = "ret", .widths = "", .kind = RETURN},
};

const struct row *ptx_find_row(const char *name)
{
    for (size_t i = 0; i < sizeof rows / sizeof rows[0]; i++)
        if (strcmp(rows[i].name, name) == 0)
            return &rows[i];
    return NULL;
}

uint64_t ptx_cut(uint64_t value, char width)
{
    switch (width) {
    case 'p':
        return value & 1;
    case 'h':
        return (uint16_t)value;
    case 'w':
        return (uint32_t)value;
    default:
        return value;
    }
}
