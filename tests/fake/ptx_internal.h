/* ptx_internal.h - PTX as instructions, between reading and running it. */
#ifndef FAKE_PTX_INTERNAL_H
#define FAKE_PTX_INTERNAL_H

#include "tests/fake/ptx.h"

enum { MOST_OPERANDS = 6, MOST_PARAMETERS = 64, MOST_BANKS = 16 };

/* Address spaces start here, so that one cannot pass for another. */
#define CONSTANT_BASE (1ull << 40)
#define LOCAL_BASE    (1ull << 41)

enum type { PRED, B16, B32, B64, U16, U32, U64, S16, S32, S64, F32, NO_TYPE };

/* clang-format off */
#define OPERATIONS(X)                                                                              \
    X(abs) X(add) X(and) X(bfe) X(bfi) X(bra) X(cvt) X(cvta) X(div) X(ld) X(mad) X(max) X(min)     \
    X(mov) X(mul) X(neg) X(not) X(or) X(popc) X(rcp) X(ret) X(selp) X(setp) X(shl) X(shr) X(sqrt)  \
    X(st) X(sub) X(xor)
/* clang-format on */
#define OPERATION_NUMBER(name) OP_##name,
enum operation { OPERATIONS(OPERATION_NUMBER) OPERATION_COUNT };

enum special { TID_X, TID_Y, NTID_X, NTID_Y, CTAID_X, CTAID_Y, SPECIALS };

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

extern const unsigned ptx_type_bytes[];

/* Says on standard error what is not known or not possible; returns false. */
bool ptx_refuse(const char *what, const char *text);

/* Sets the place where threads that part at an instruction meet again. */
void ptx_find_meetings(struct ptx *ptx);

/* The low bits of a value as those of a type, in 64 bits. */
uint64_t ptx_narrow(uint64_t value, enum type type);
/* The result of an operation on registers. */
uint64_t ptx_compute(const struct instruction *in, const uint64_t v[MOST_OPERANDS]);
/* The type that a result has, which may be another than its operands'. */
enum type ptx_result_type(const struct instruction *in);

#endif
