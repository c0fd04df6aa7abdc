#include "tests/fuzz/fuzz_file.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

void require(bool good, const char *what)
{
    if (good)
        return;
    fprintf(stderr, "fuzz: %s\n", what);
    abort();
}

int fuzz_file(const uint8_t *data, size_t size, const char *name,
              int (*use)(struct bsq_ctx *ctx, const char *path))
{
    struct bsq_ctx_options options = {.threads = 1, .memory_bytes = 64 << 20};
    struct bsq_ctx *ctx;
    char path[64];
    int fd = memfd_create(name, MFD_CLOEXEC);
    require(fd >= 0 && write(fd, data, size) == (ssize_t)size, "cannot make the file");
    snprintf(path, sizeof path, "/proc/self/fd/%d", fd);
    require(bsq_ctx_create(&options, &ctx) == 0, "no context");
    int status = use(ctx, path);
    if (status) {
        require(status == BSQ_EDATA || status == BSQ_ENOMEM, "an unexpected status");
        require(bsq_error(ctx)[0] && !strchr(bsq_error(ctx), '\n'), "not one line of error");
    }
    require(bsq_memory_used(ctx) == 0, "memory is left");
    bsq_ctx_destroy(ctx);
    close(fd);
    return 0;
}
