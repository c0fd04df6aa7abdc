/* failing.c - replaces functions of the C library. A hash table with open addressing holds the
 * blocks that are allocated while a job runs. */
#include "tests/unit/exhaustion/failing.h"

#include <dlfcn.h>
#include <errno.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>

#if defined __SANITIZE_ADDRESS__ || defined __SANITIZE_THREAD__
/* The linker turns calls of X into calls of __wrap_X (--wrap in the Makefile). */
#define OWN(name)  __wrap_##name
#define REAL(name) __real_##name
#else
#define OWN(name)  name
#define REAL(name) __libc_##name
#define COUNTS_BLOCKS
#endif

void *REAL(malloc)(size_t);
void *REAL(calloc)(size_t, size_t);
void *REAL(realloc)(void *, size_t);
void *OWN(malloc)(size_t);
void *OWN(calloc)(size_t, size_t);
void *OWN(realloc)(void *, size_t);
int OWN(pthread_create)(pthread_t *, const pthread_attr_t *, void *(*)(void *), void *);

static struct {
    atomic_int armed; /* enum failing + 1; 0: nothing fails */
    atomic_uint_least64_t calls, failed;
    uint64_t first;
    bool all_after;
} state;

static bool fails(enum failing what)
{
    if (atomic_load(&state.armed) != (int)what + 1)
        return false;
    uint64_t call = atomic_fetch_add(&state.calls, 1);
    if (call != state.first && !(state.all_after && call > state.first))
        return false;
    atomic_fetch_add(&state.failed, 1);
    return true;
}

/* ---- blocks ---- */

#ifdef COUNTS_BLOCKS
enum { SLOTS = 1 << 18 };
#define REMOVED ((void *)1)

void __libc_free(void *);
static void *blocks[SLOTS];
static int64_t block_count;
static atomic_flag lock = ATOMIC_FLAG_INIT;

static uint64_t slot_of(const void *block)
{
    return ((uintptr_t)block >> 4) * UINT64_C(0x9e3779b97f4a7c15) >> 46;
}

static void enter(void *block)
{
    if (!block || !atomic_load(&state.armed))
        return;
    while (atomic_flag_test_and_set(&lock))
        ;
    uint64_t i = slot_of(block);
    while (blocks[i] && blocks[i] != REMOVED)
        i = (i + 1) % SLOTS;
    blocks[i] = block;
    block_count++;
    atomic_flag_clear(&lock);
}

static void leave(const void *block)
{
    if (!block || !atomic_load(&state.armed))
        return;
    while (atomic_flag_test_and_set(&lock))
        ;
    uint64_t i = slot_of(block);
    while (blocks[i] && blocks[i] != block)
        i = (i + 1) % SLOTS;
    if (blocks[i]) {
        blocks[i] = REMOVED;
        block_count--;
    }
    atomic_flag_clear(&lock);
}

void free(void *block)
{
    leave(block);
    __libc_free(block);
}

static int64_t forget_blocks(void)
{
    int64_t count = block_count;
    memset(blocks, 0, sizeof blocks);
    block_count = 0;
    return count;
}
#else
static void enter(void *block)
{
    (void)block;
}

static void leave(const void *block)
{
    (void)block;
}

static int64_t forget_blocks(void)
{
    return 0;
}
#endif

/* ---- replacements of the C library's functions ---- */

void *OWN(malloc)(size_t size)
{
    if (fails(FAILING_MEMORY)) {
        errno = ENOMEM;
        return NULL;
    }
    void *block = REAL(malloc)(size);
    enter(block);
    return block;
}

void *OWN(calloc)(size_t count, size_t size)
{
    if (fails(FAILING_MEMORY)) {
        errno = ENOMEM;
        return NULL;
    }
    void *block = REAL(calloc)(count, size);
    enter(block);
    return block;
}

void *OWN(realloc)(void *old, size_t size)
{
    if (fails(FAILING_MEMORY)) {
        errno = ENOMEM;
        return NULL;
    }
    leave(old);
    void *block = REAL(realloc)(old, size);
    enter(block ? block : old);
    return block;
}

int OWN(pthread_create)(pthread_t *thread, const pthread_attr_t *attributes, void *(*start)(void *),
                        void *arg)
{
#ifdef COUNTS_BLOCKS
    static int (*real)(pthread_t *, const pthread_attr_t *, void *(*)(void *), void *);
    if (!real)
        *(void **)&real = dlsym(RTLD_NEXT, "pthread_create");
#else
    extern int REAL(pthread_create)(pthread_t *, const pthread_attr_t *, void *(*)(void *), void *);
    int (*real)(pthread_t *, const pthread_attr_t *, void *(*)(void *), void *) =
        REAL(pthread_create);
#endif
    return fails(FAILING_THREADS) ? EAGAIN : real(thread, attributes, start, arg);
}

/* ---- switching ---- */

void failing_begin(enum failing what, uint64_t first, bool all_after)
{
    forget_blocks();
    state.first = first;
    state.all_after = all_after;
    atomic_store(&state.calls, 0);
    atomic_store(&state.failed, 0);
    atomic_store(&state.armed, (int)what + 1);
}

struct failing_result failing_end(void)
{
    atomic_store(&state.armed, 0);
    return (struct failing_result){atomic_load(&state.calls), atomic_load(&state.failed),
                                   forget_blocks()};
}
