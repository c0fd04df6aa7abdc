/* pipe.c - see pipe.h. */
#include "formats/input/pipe.h"

#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <string.h>
#include <unistd.h>

#include "base/file.h"

/* How often a wait looks for an interruption, in milliseconds. */
enum { PATIENCE_MS = 50 };

int fmt_pipe_open(struct bsq_ctx *ctx, const char *path, int *fd)
{
    *fd = strcmp(path, "-") == 0
              ? fcntl(STDIN_FILENO, F_DUPFD_CLOEXEC, STDERR_FILENO + 1)
              : bsq_fd_above_standard(open(path, O_RDONLY | O_NONBLOCK | O_NOCTTY | O_CLOEXEC));
    return *fd < 0 ? bsq_fail_errno(ctx, BSQ_ENOINPUT, errno, "%s", path) : 0;
}

/* Waits until a pipe has bytes or has ended. A FIFO that nobody has opened for writing yet has
 * neither. */
static int wait_for_bytes(struct bsq_ctx *ctx, const char *path, int fd, const atomic_bool *stop)
{
    struct pollfd poll_fd = {.fd = fd, .events = POLLIN};
    for (;;) {
        int status = stop && atomic_load(stop) ? BSQ_EINTR : bsq_check(ctx);
        if (status)
            return status;
        int ready = poll(&poll_fd, 1, PATIENCE_MS);
        if (ready > 0)
            return 0;
        if (ready < 0 && errno != EINTR)
            return bsq_fail_errno(ctx, BSQ_EIO, errno, "%s", path);
    }
}

int fmt_pipe_read(struct bsq_ctx *ctx, const char *path, int fd, const atomic_bool *stop,
                  void *buffer, uint64_t size, uint64_t *got)
{
    for (*got = 0;;) {
        int status = wait_for_bytes(ctx, path, fd, stop);
        if (status)
            return status;
        ssize_t count = read(fd, buffer, size);
        if (count >= 0) {
            *got = (uint64_t)count;
            return 0;
        }
        if (errno != EINTR && errno != EAGAIN)
            return bsq_fail_errno(ctx, BSQ_EIO, errno, "%s", path);
    }
}
