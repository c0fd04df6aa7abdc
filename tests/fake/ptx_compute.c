/* ptx_compute.c - computes the results of PTX instructions on registers. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "tests/fake/ptx_internal.h"

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

uint64_t ptx_narrow(uint64_t value, enum type type)
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
        const int64_t x = (int64_t)ptx_narrow(a, in->type), y = (int64_t)ptx_narrow(b, in->type);
        sign = (x > y) - (x < y);
    } else {
        const uint64_t x = ptx_narrow(a, in->type), y = ptx_narrow(b, in->type);
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
    const unsigned bits = 8 * ptx_type_bytes[in->type];
    unsigned __int128 product;

    if (is_signed(in->type))
        product = (unsigned __int128)((__int128)(int64_t)ptx_narrow(a, in->type) *
                                      (int64_t)ptx_narrow(b, in->type));
    else
        product = (unsigned __int128)ptx_narrow(a, in->type) * ptx_narrow(b, in->type);
    return (uint64_t)(in->half == HIGH ? product >> bits : product);
}

/* Returns the smaller or larger of two numbers. Ignores NaN if the other is a number; -0 < +0. */
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
        return ((int64_t)ptx_narrow(a, in->type) > (int64_t)ptx_narrow(b, in->type)) == larger ? a
                                                                                               : b;
    return (ptx_narrow(a, in->type) > ptx_narrow(b, in->type)) == larger ? a : b;
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
    a = ptx_narrow(a, in->from);
    if (in->type == F32)
        return of_float(is_signed(in->from) ? (float)(int64_t)a : (float)a);
    return a;
}

static uint64_t shift(const struct instruction *in, uint64_t a, uint64_t by)
{
    const unsigned bits = 8 * ptx_type_bytes[in->type];

    by = (uint32_t)by;
    if (in->operation == OP_shl)
        return by < bits ? a << by : 0;
    if (is_signed(in->type))
        return (uint64_t)((int64_t)ptx_narrow(a, in->type) >> (by < bits ? by : bits - 1));
    return by < bits ? ptx_narrow(a, in->type) >> by : 0;
}

static uint64_t low_bits(uint64_t count)
{
    return count < 64 ? (UINT64_C(1) << count) - 1 : UINT64_MAX;
}

/* Returns `count` bits from bit `first` on; of a signed type with the sign of the highest of them.
 */
static uint64_t extract(const struct instruction *in, uint64_t a, uint64_t first, uint64_t count)
{
    const uint64_t bits = ptx_narrow(a, in->type) >> first & low_bits(count);
    const bool negative = is_signed(in->type) && count > 0 && bits >> (count - 1) & 1;
    return negative ? bits | ~low_bits(count) : bits;
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

uint64_t ptx_compute(const struct instruction *in, const uint64_t v[MAX_OPERANDS])
{
    const bool real = in->type == F32;
    const uint64_t a = v[1], b = v[2], c = v[3];

    switch (in->operation) {
    case OP_abs:
        return real ? a & 0x7fffffff : (uint64_t)llabs((int64_t)ptx_narrow(a, in->type));
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
        return extract(in, a, b & 63, c & 63);
    case OP_bfi: {
        const uint64_t mask = low_bits(v[4] & 255) << (c & 63);
        return (b & ~mask) | (a << (c & 63) & mask);
    }
    case OP_popc:
        return (uint64_t)__builtin_popcountll(ptx_narrow(a, in->type));
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

enum type ptx_result_type(const struct instruction *in)
{
    if (in->operation == OP_setp)
        return PRED;
    if (in->operation == OP_popc)
        return U32;
    if (in->operation == OP_mul && in->half == WIDE)
        return U64;
    return in->type == S32 ? U32 : in->type == S16 ? U16 : in->type;
}
