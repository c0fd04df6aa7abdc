#include "tests/fuzz/fuzz_file.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

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

static struct bsq_ctx *new_context(void)
{
    struct bsq_ctx_options options = {.threads = 1, .memory_bytes = 64 << 20};
    struct bsq_ctx *ctx;
    require(bsq_ctx_create(&options, &ctx) == 0, "no context");
    return ctx;
}

int fuzz_in_context(int (*use)(struct bsq_ctx *ctx))
{
    struct bsq_ctx *ctx = new_context();
    int status = use(ctx);
    check_end(ctx, status);
    return status;
}

int fuzz_file(const uint8_t *data, size_t size, const char *name,
              int (*use)(struct bsq_ctx *ctx, const char *path))
{
    struct bsq_ctx *ctx = new_context();
    char path[64];
    int fd = memfd_create(name, MFD_CLOEXEC);
    require(fd >= 0 && write(fd, data, size) == (ssize_t)size, "cannot make the file");
    snprintf(path, sizeof path, "/proc/self/fd/%d", fd);
    check_end(ctx, use(ctx, path));
    close(fd);
    return 0;
}
