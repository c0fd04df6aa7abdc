/* memory.c - the memory budget, and allocation that counts against it.
 *
 * A small block is [slack][64-byte header][payload]; the payload is aligned to 64 bytes. The header
 * holds what malloc() returned, so calloc() and realloc() of the C library can be used. The budget
 * counts all of the block and what malloc() adds: a name of a few bytes costs far more than its
 * bytes, and a file can have millions of names.
 *
 * A large block is a mapping of its own. Its payload begins at the start of a huge page and may
 * consist of huge pages: first-touch page faults cost more than most of the work on a page, and
 * their cost is per page. Its header ends the small page before the payload. The mapping ends with
 * the last small page of the payload, so resident memory stays within what is counted. Growing
 * moves pages instead of copying them. The budget counts the payload. */
#include <errno.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

#include "base/context_internal.h"

enum { HEADER_BYTES = 64, OVERHEAD = HEADER_BYTES + BSQ_ALIGNMENT };
/* glibc's malloc() adds a size of 8 bytes and rounds up to 16. */
enum { MALLOC_HEADER = 8, MALLOC_STEP = 16 };

/* Size of a huge page; on systems with other sizes this is only an alignment. A header needs a page
 * of the smallest size before the payload; systems with larger pages use the C library's blocks
 * alone. */
#define HUGE_BYTES ((size_t)2 << 20)
#define PAGE_BYTES ((size_t)4096)

struct header {
    void *base;      /* what malloc() returned, or the mapping */
    uint64_t size;   /* of the payload */
    uint64_t offset; /* of the payload from base */
    size_t mapped;   /* bytes of the mapping; 0: from malloc() */
};
_Static_assert(sizeof(struct header) <= HEADER_BYTES, "the header must fit before the payload");

/* ---- the budget ---- */

static void raise_high_water(struct bsq_ctx *ctx, uint64_t used)
{
    uint64_t high = atomic_load_explicit(&ctx->memory_high, memory_order_relaxed);
    while (used > high && !atomic_compare_exchange_weak(&ctx->memory_high, &high, used))
        ;
}

static bool try_reserve(struct bsq_ctx *ctx, uint64_t bytes)
{
    uint64_t limit = ctx->options.memory_bytes;
    uint64_t used = atomic_load_explicit(&ctx->memory_used, memory_order_relaxed);
    do {
        if (used > limit || bytes > limit - used)
            return false;
    } while (!atomic_compare_exchange_weak(&ctx->memory_used, &used, used + bytes));
    raise_high_water(ctx, used + bytes);
    return true;
}

int bsq_reserve(struct bsq_ctx *ctx, const char *what, uint64_t bytes)
{
    if (try_reserve(ctx, bytes))
        return 0;
    return bsq_fail(ctx, BSQ_ENOMEM,
                    "the memory budget is too small: %s needs %llu bytes, %llu of %llu are in use",
                    what, (unsigned long long)bytes, (unsigned long long)bsq_memory_used(ctx),
                    (unsigned long long)bsq_memory_limit(ctx));
}

void bsq_release(struct bsq_ctx *ctx, uint64_t bytes)
{
    atomic_fetch_sub(&ctx->memory_used, bytes);
}

uint64_t bsq_memory_limit(const struct bsq_ctx *ctx)
{
    return ctx->options.memory_bytes;
}

uint64_t bsq_memory_left(const struct bsq_ctx *ctx)
{
    uint64_t limit = bsq_memory_limit(ctx), used = bsq_memory_used(ctx);
    return limit > used ? limit - used : 0;
}

uint64_t bsq_memory_used(const struct bsq_ctx *ctx)
{
    return atomic_load(&ctx->memory_used);
}

uint64_t bsq_memory_high(const struct bsq_ctx *ctx)
{
    return atomic_load(&ctx->memory_high);
}

/* ---- blocks ---- */

static void set_pointer(void *out, void *value)
{
    memcpy(out, &value, sizeof value); /* out is the address of a pointer of any type */
}

static struct header *header_of(void *payload)
{
    return (struct header *)((char *)payload - HEADER_BYTES);
}

static size_t payload_offset(const void *base)
{
    uintptr_t start = (uintptr_t)base + HEADER_BYTES;
    uintptr_t aligned = (start + BSQ_ALIGNMENT - 1) & ~(uintptr_t)(BSQ_ALIGNMENT - 1);
    return aligned - (uintptr_t)base;
}

static void *place_header(void *base, uint64_t offset, uint64_t size, size_t mapped)
{
    void *payload = (char *)base + offset;
    *header_of(payload) =
        (struct header){.base = base, .size = size, .offset = offset, .mapped = mapped};
    return payload;
}

static bool size_of_array(uint64_t count, uint64_t size, uint64_t *bytes)
{
    return !__builtin_mul_overflow(count, size, bytes) && *bytes <= PTRDIFF_MAX - 2 * HUGE_BYTES;
}

static int fail_overflow(struct bsq_ctx *ctx, const char *what, uint64_t count, uint64_t size)
{
    return bsq_fail(ctx, BSQ_ENOMEM, "%s: %llu times %llu bytes is more than can be addressed",
                    what, (unsigned long long)count, (unsigned long long)size);
}

static int fail_system(struct bsq_ctx *ctx, const char *what, uint64_t bytes)
{
    return bsq_fail(ctx, BSQ_ENOMEM,
                    "the system has no memory left: %s needs %llu bytes, %llu of %llu are in use",
                    what, (unsigned long long)bytes, (unsigned long long)bsq_memory_used(ctx),
                    (unsigned long long)bsq_memory_limit(ctx));
}

/* ---- large blocks ---- */

/* With an address sanitizer all blocks come from the C library, which it watches. */
#if defined(__SANITIZE_ADDRESS__)
#define WATCHED 1
#elif defined(__has_feature)
#if __has_feature(address_sanitizer) || __has_feature(memory_sanitizer)
#define WATCHED 1
#endif
#endif

static bool is_large(uint64_t bytes)
{
#ifdef WATCHED
    (void)bytes;
    return false;
#else
    return bytes >= HUGE_BYTES && sysconf(_SC_PAGE_SIZE) == (long)PAGE_BYTES;
#endif
}

/* Returns the bytes to map for a large block: one page more than its payload. */
static size_t mapping_bytes(uint64_t bytes)
{
    return PAGE_BYTES + (((size_t)bytes + PAGE_BYTES - 1) & ~(PAGE_BYTES - 1));
}

/* Maps `size` bytes; the first page lies just before a huge page. Returns NULL if there is no
 * space. */
static char *map_aligned(size_t size, int protection)
{
    size_t reserved = size + HUGE_BYTES;
    char *at = mmap(NULL, reserved, protection, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    if (at == MAP_FAILED)
        return NULL;
    uintptr_t start = (uintptr_t)at + PAGE_BYTES;
    size_t before = (size_t)(-start & (HUGE_BYTES - 1)), after = reserved - before - size;
    if (before > 0)
        munmap(at, before);
    if (after > 0)
        munmap(at + before + size, after);
    return at + before;
}

static void *allocate_large(uint64_t bytes)
{
    size_t size = mapping_bytes(bytes);
    char *base = map_aligned(size, PROT_READ | PROT_WRITE);
    if (!base)
        return NULL;
    /* Only advice to the system. Includes the first page, as a range with mixed advice cannot be
     * moved at once. */
    madvise(base, size, MADV_HUGEPAGE);
    return place_header(base, PAGE_BYTES, bytes, size);
}

/* Moves the pages to an address with enough space after them and the same alignment. */
static void *grow_large(void *payload, uint64_t bytes)
{
    struct header old = *header_of(payload);
    size_t size = mapping_bytes(bytes);
    char *base = map_aligned(size, PROT_NONE);
    if (!base)
        return NULL;
    if (mremap(old.base, old.mapped, size, MREMAP_MAYMOVE | MREMAP_FIXED, base) == MAP_FAILED) {
        munmap(base, size);
        return NULL;
    }
    return place_header(base, PAGE_BYTES, bytes, size);
}

/* ---- all blocks ---- */

uint64_t bsq_block_cost(uint64_t bytes)
{
    return is_large(bytes) ? bytes : bsq_align_up(bytes + OVERHEAD + MALLOC_HEADER, MALLOC_STEP);
}

static int memory_allocate(struct bsq_ctx *ctx, const char *what, uint64_t count, uint64_t size,
                           bool zeroed, void *out)
{
    set_pointer(out, NULL);
    uint64_t bytes;
    if (!size_of_array(count, size, &bytes))
        return fail_overflow(ctx, what, count, size);
    BSQ_PASS(bsq_reserve(ctx, what, bsq_block_cost(bytes)));
    void *payload = NULL;
    if (is_large(bytes)) {
        payload = allocate_large(bytes);
    } else {
        void *base = zeroed ? calloc(1, bytes + OVERHEAD) : malloc(bytes + OVERHEAD);
        if (base)
            payload = place_header(base, payload_offset(base), bytes, 0);
    }
    if (!payload) {
        bsq_release(ctx, bsq_block_cost(bytes));
        return fail_system(ctx, what, bytes);
    }
    set_pointer(out, payload);
    return 0;
}

int(bsq_alloc)(struct bsq_ctx *ctx, const char *what, uint64_t count, uint64_t size, void *out)
{
    return memory_allocate(ctx, what, count, size, false, out);
}

int(bsq_calloc)(struct bsq_ctx *ctx, const char *what, uint64_t count, uint64_t size, void *out)
{
    return memory_allocate(ctx, what, count, size, true, out);
}

static void free_block(void *payload)
{
    struct header header = *header_of(payload);
    if (header.mapped > 0)
        munmap(header.base, header.mapped);
    else
        free(header.base);
}

void bsq_free(struct bsq_ctx *ctx, void *memory)
{
    if (!memory)
        return;
    uint64_t cost = bsq_block_cost(header_of(memory)->size);
    free_block(memory);
    bsq_release(ctx, cost);
}

void bsq_free_all(struct bsq_ctx *ctx, void *const *blocks, size_t count)
{
    for (size_t i = 0; i < count; i++)
        bsq_free(ctx, blocks[i]);
}

static void *resize_small(void *payload, uint64_t bytes)
{
    struct header old = {0};
    if (payload)
        old = *header_of(payload);
    char *base = realloc(old.base, bytes + OVERHEAD);
    if (!base)
        return NULL;
    uint64_t offset = payload_offset(base);
    if (old.size && offset != old.offset)
        memmove(base + offset, base + old.offset, old.size);
    return place_header(base, offset, bytes, 0);
}

/* Resizes a block whose extra bytes are reserved already. Returns NULL if the system has no memory.
 */
static void *resize(void *payload, uint64_t bytes)
{
    if (!is_large(bytes))
        return resize_small(payload, bytes);
    if (payload && header_of(payload)->mapped > 0)
        return grow_large(payload, bytes);
    void *grown = allocate_large(bytes);
    if (grown && payload) {
        memcpy(grown, payload, header_of(payload)->size);
        free_block(payload);
    }
    return grown;
}

/* Returns what a block of `bytes` costs above `old_cost`. */
static uint64_t more_cost(uint64_t bytes, uint64_t old_cost)
{
    const uint64_t cost = bsq_block_cost(bytes);
    return cost > old_cost ? cost - old_cost : 0;
}

int(bsq_grow)(struct bsq_ctx *ctx, const char *what, uint64_t count, uint64_t size, void *inout,
              uint64_t *capacity)
{
    if (count <= *capacity)
        return 0;
    void *payload;
    memcpy(&payload, inout, sizeof payload);
    uint64_t old_cost = payload ? bsq_block_cost(header_of(payload)->size) : 0;

    /* Asks for half more; where that does not fit, for a quarter more, and so on. So a block that
     * grows in small steps is rarely copied, also if it takes most of the budget. */
    uint64_t wanted, bytes, extra = *capacity / 2;
    bool fits;
    do {
        wanted = count - *capacity < extra ? *capacity + extra : count;
        extra /= 2;
        fits = size_of_array(wanted, size, &bytes);
        if (wanted == count && !fits)
            return fail_overflow(ctx, what, count, size);
        fits = fits && try_reserve(ctx, more_cost(bytes, old_cost));
    } while (!fits && wanted > count);
    if (!fits)
        BSQ_PASS(bsq_reserve(ctx, what, more_cost(bytes, old_cost)));
    void *grown = resize(payload, bytes);
    if (!grown) {
        bsq_release(ctx, more_cost(bytes, old_cost));
        return fail_system(ctx, what, bytes);
    }
    /* The first large block may cost less than the small block before it. */
    if (bsq_block_cost(bytes) < old_cost)
        bsq_release(ctx, old_cost - bsq_block_cost(bytes));
    set_pointer(inout, grown);
    *capacity = wanted;
    return 0;
}
