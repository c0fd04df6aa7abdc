/* ptx_internal.h - PTX instructions, as read and before they are run. */
#ifndef FAKE_PTX_INTERNAL_H
#define FAKE_PTX_INTERNAL_H

#include "tests/fake/ptx.h"

enum { MAX_OPERANDS = 6, MAX_PARAMETERS = 64, MAX_BANKS = 16 };

/* Start addresses of the address spaces, so that one is not mistaken for another. */
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
    uint64_t value;  /* a constant, or the offset from the register */
};

struct instruction {
    enum operation operation;
    enum type type, from;
    enum space space;
    enum half half;
    enum relation relation;
    bool unordered; /* the relation holds if a side is NaN */
    bool floor, truncate;
    int guard; /* number of the predicate register, -1: none */
    bool unless;
    unsigned vector;     /* number of registers of a load or store */
    unsigned target;     /* of a branch */
    unsigned reconverge; /* instruction at which threads that diverge here reconverge */
    unsigned operand_count;
    struct operand operands[MAX_OPERANDS];
};

struct bank {
    char prefix[8];
    unsigned first, count;
};

struct ptx {
    struct instruction *code;
    unsigned count, capacity;
    struct bank banks[MAX_BANKS];
    unsigned bank_count, registers;
    unsigned parameter_count, parameter_at[MAX_PARAMETERS + 1], parameter_bytes[MAX_PARAMETERS];
    uint8_t *constants;
    unsigned constant_bytes;
    char constant_name[64];
};

extern const unsigned ptx_type_bytes[];

/* Prints on standard error what is unknown or impossible. Returns false. */
bool ptx_refuse(const char *what, const char *text);

/* Finds the instruction at which diverged threads reconverge, for each branch. */
void ptx_find_reconvergence(struct ptx *ptx);

/* Extends the low bits of a value, as those of a type, to 64 bits. */
uint64_t ptx_narrow(uint64_t value, enum type type);
/* Returns the result of an operation on registers. */
uint64_t ptx_compute(const struct instruction *in, const uint64_t v[MAX_OPERANDS]);
/* Returns the type of a result, which may differ from its operands'. */
enum type ptx_result_type(const struct instruction *in);

#endif
