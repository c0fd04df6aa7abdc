/* ptx_run.c - runs warps. After a divergent branch a stack holds the paths that are left to run
 * (Fung, Sham, Yuan, Aamodt, 2007, section 2; see ptx_reconverge.c). */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "tests/fake/ptx_internal.h"

enum { LANES = 32, LOCAL_BYTES = 4096, MAX_PATHS = 256 };

struct thread {
    uint64_t *registers;
    unsigned special[SPECIALS];
    uint8_t local[LOCAL_BYTES];
};

/* Threads at an instruction, which wait where they reconverge. */
struct path {
    unsigned place, reconverge;
    uint32_t threads; /* bits */
};

struct warp {
    const struct ptx *ptx;
    struct ptx_launch *launch;
    const uint8_t *parameters;
    struct thread threads[LANES];
    struct path paths[MAX_PATHS]; /* the last one is running */
    unsigned path_count;
};

static uint64_t get(const struct thread *thread, const struct operand *operand)
{
    if (operand->kind == REGISTER)
        return thread->registers[operand->number] + operand->value;
    return operand->kind == SPECIAL ? thread->special[operand->number] : operand->value;
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

static bool move_memory(struct warp *warp, struct thread *thread, const struct instruction *in)
{
    const bool store = in->row->kind == STORE;
    const unsigned first = store ? 1 : 0, bytes = in->row->bytes;
    uint64_t address = get(thread, &in->operands[store ? 0 : in->row->vector]);

    for (unsigned i = 0; i < in->row->vector; i++, address += bytes) {
        void *memory = find_memory(warp, thread, in->row->space, address, bytes);
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
    uint64_t values[MAX_OPERANDS] = {0};
    const char *widths = in->row->widths;

    if (!is_on(thread, in))
        return true;
    if (in->row->kind != COMPUTE)
        return move_memory(warp, thread, in);
    for (unsigned i = 1; i < in->operand_count; i++)
        values[i] = ptx_cut(get(thread, &in->operands[i]), widths[i]);
    thread->registers[in->operands[0].number] =
        ptx_cut(in->row->compute(values[1], values[2], values[3], values[4]), widths[0]);
    return true;
}

/* Branches. If only some threads branch, both paths run one after the other up to where they
 * reconverge. */
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
    if (in->reconverge != whole.reconverge) {
        path->place = in->reconverge;
        warp->path_count++;
    }
    warp->paths[warp->path_count - 1] =
        (struct path){whole.place + 1, in->reconverge, whole.threads & ~taken};
    warp->paths[warp->path_count++] = (struct path){in->target, in->reconverge, taken};
}

static bool run_warp(struct warp *warp)
{
    bool fine = true;

    while (fine && warp->path_count > 0) {
        struct path *path = &warp->paths[warp->path_count - 1];
        const struct instruction *in = &warp->ptx->code[path->place];
        if (path->place == path->reconverge) {
            warp->path_count--;
            continue;
        }
        warp->launch->instructions++;
        if (in->row->kind == BRANCH) {
            branch(warp, in);
            fine = warp->path_count + 2 < MAX_PATHS || ptx_refuse("branches are too deep", "");
            continue;
        }
        for (int i = 0; i < LANES && fine && in->row->kind != RETURN; i++)
            if (path->threads >> i & 1)
                fine = step(warp, &warp->threads[i], in);
        path->place = in->row->kind == RETURN ? warp->ptx->count : path->place + 1;
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
    warp->paths[0] = (struct path){.reconverge = warp->ptx->count, .threads = threads};
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
