#include "tests/fuzz/fuzz_file.h"

#include <assert.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

#include "tests/fuzz/memory_files.h"

const char *__asan_default_options(void);

/* Options that make AddressSanitizer fast for many small inputs. To see a finding's full history,
 * run it again with ASAN_OPTIONS=malloc_context_size=30. */
const char *__asan_default_options(void)
{
    return "quarantine_size_mb=8:malloc_context_size=2:max_malloc_fill_size=0";
}

void require(bool good, const char *what)
{
    if (good)
        return;
    fprintf(stderr, "fuzz: %s\n", what);
    abort();
}

static void check_end(struct bsq_ctx *ctx, int status)
{
    if (status) {
        require(status == BSQ_EDATA || status == BSQ_ENOINPUT || status == BSQ_ENOMEM,
                bsq_error(ctx));
        require(bsq_error(ctx)[0] && !strchr(bsq_error(ctx), '\n'), "not one line of error");
    }
    require(bsq_memory_used(ctx) == 0, "memory is left");
    bsq_ctx_destroy(ctx);
}

static struct bsq_ctx *new_context(unsigned threads)
{
    struct bsq_ctx_options options = {.threads = threads, .memory_bytes = 64 << 20};
    struct bsq_ctx *ctx;
    require(bsq_ctx_create(&options, &ctx) == 0, "no context");
    return ctx;
}

int fuzz_in_context(int (*use)(struct bsq_ctx *ctx))
{
    struct bsq_ctx *ctx = new_context(1);
    int status = use(ctx);
    check_end(ctx, status);
    return status;
}

/* Returns true for one of SYSTEM_SHARE inputs, which are all alike in this. */
static bool belongs_to_system(const struct fuzz_input *inputs, uint32_t count)
{
    enum { SYSTEM_SHARE = 64 };
    unsigned sum = 0;
    for (uint32_t i = 0; i < count; i++)
        for (size_t k = 0; k < inputs[i].size; k++)
            sum += inputs[i].data[k];
    return sum % SYSTEM_SHARE == 0;
}

static void use_system(const struct fuzz_input *inputs, uint32_t count, unsigned threads,
                       fuzz_use *use)
{
    struct bsq_ctx *ctx = new_context(threads);
    char paths[FUZZ_MAX_FILES][32];
    const char *names[FUZZ_MAX_FILES];
    int files[FUZZ_MAX_FILES];
    for (uint32_t i = 0; i < count; i++) {
        files[i] = memfd_create(inputs[i].name, MFD_CLOEXEC);
        require(files[i] >= 0 &&
                    write(files[i], inputs[i].data, inputs[i].size) == (ssize_t)inputs[i].size,
                "cannot make a file");
        snprintf(paths[i], sizeof paths[i], "/proc/self/fd/%d", files[i]);
        names[i] = paths[i];
    }
    check_end(ctx, use(ctx, names, count));
    for (uint32_t i = 0; i < count; i++)
        close(files[i]);
}

static void use_memory(const struct fuzz_input *inputs, uint32_t count, fuzz_use *use)
{
    struct bsq_ctx *ctx = new_context(1);
    const char *names[FUZZ_MAX_FILES];
    memory_files_begin();
    for (uint32_t i = 0; i < count; i++) {
        names[i] = inputs[i].name;
        memory_files_add(names[i], inputs[i].data, inputs[i].size);
    }
    check_end(ctx, use(ctx, names, count));
    memory_files_end();
}

int fuzz_files(const struct fuzz_input *inputs, uint32_t count, fuzz_use *use)
{
    assert(count <= FUZZ_MAX_FILES);
    if (belongs_to_system(inputs, count))
        use_system(inputs, count, 3, use);
    else
        use_memory(inputs, count, use);
    return 0;
}

int fuzz_system_file(const uint8_t *data, size_t size, const char *name, fuzz_use *use)
{
    use_system(&(struct fuzz_input){data, size, name}, 1, 1, use);
    return 0;
}
