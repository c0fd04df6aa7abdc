/* ptx_internal.h - PTX instructions, as read and before they are run. */
#ifndef FAKE_PTX_INTERNAL_H
#define FAKE_PTX_INTERNAL_H

#include "tests/fake/ptx.h"

enum { MAX_OPERANDS = 6, MAX_PARAMETERS = 64, MAX_BANKS = 16 };

/* Start addresses of the address spaces, so that one is not mistaken for another. */
#define CONSTANT_BASE (1ull << 40)
#define LOCAL_BASE    (1ull << 41)

enum special { TID_X, TID_Y, NTID_X, NTID_Y, CTAID_X, CTAID_Y, SPECIALS };

enum space { PARAMETER, GLOBAL, CONSTANT, LOCAL };

/* An instruction of PTX under its full name, as "mul.wide.u32". */
struct row {
    const char *name;
    /* Of the result and the operands: p predicate, h 16 bits, w 32, d 64; a capital letter: that or
     * more. */
    const char *widths;
    enum { COMPUTE, LOAD, STORE, BRANCH, RETURN } kind;
    uint64_t (*compute)(uint64_t a, uint64_t b, uint64_t c, uint64_t d);
    enum space space; /* of a load or store */
    unsigned bytes;   /* of each register that it moves */
    unsigned vector;  /* number of these registers */
};

struct operand {
    enum { REGISTER, VALUE, SPECIAL } kind;
    unsigned number; /* of the register */
    char width;      /* of the register */
    uint64_t value;  /* a constant, or the offset from the register */
};

struct instruction {
    const struct row *row;
    int guard; /* number of the predicate register, -1: none */
    bool unless;
    unsigned target;     /* of a branch */
    unsigned reconverge; /* instruction at which threads that diverge here reconverge */
    unsigned operand_count;
    struct operand operands[MAX_OPERANDS];
};

struct bank {
    char prefix[8], width;
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

/* Prints on standard error what is unknown or impossible. Returns false. */
bool ptx_refuse(const char *what, const char *text);

/* Finds the instruction at which diverged threads reconverge, for each branch. */
void ptx_find_reconvergence(struct ptx *ptx);

/* Returns the instruction of this name, or NULL. */
const struct row *ptx_find_row(const char *name);
/* Returns the low bits of a value, as many as a width has. */
uint64_t ptx_cut(uint64_t value, char width);

#endif
