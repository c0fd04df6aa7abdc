/* bisque-devices.c - lists the devices of one kind, for bake_probe(). The libraries start this
 * program because drivers may crash, hang or print; users call bisque-bake --list devices. */
#include <fcntl.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "formats/program/program.h"
#include "libbake/device/cuda/cuda.h"
#include "libbake/device/driver/driver.h"
#include "libbake/device/opencl/opencl.h"

enum { LIFE_SECONDS = 60 /* longer than the caller waits */ };

static const struct {
    const char *kind;
    void (*list)(struct bake_device_list *out);
} kinds[] = {
    {"cuda", bake_cuda_list},
    {"opencl", bake_opencl_list},
};
enum { KINDS = sizeof kinds / sizeof kinds[0] };

/* Hides what drivers print. Returns a descriptor of what was the standard output. */
static int isolate(void)
{
    int answer = fcntl(STDOUT_FILENO, F_DUPFD_CLOEXEC, STDERR_FILENO + 1);
    fmt_program_isolate();
    alarm(LIFE_SECONDS); /* if the caller ended before that call */
    dup2(STDERR_FILENO, STDOUT_FILENO);
    return answer;
}

int main(int argument_count, char **arguments)
{
    static struct bake_device_list list;
    int kind = 0, answer;
    while (kind < KINDS && !(argument_count == 2 && strcmp(arguments[1], kinds[kind].kind) == 0))
        kind++;
    if (kind == KINDS) {
        fputs("bisque-devices: is run by Bisque; see bisque-bake --list devices\n", stderr);
        return 64;
    }
    answer = isolate();
    kinds[kind].list(&list);
    _exit(bake_probe_answer(answer, &list) ? 0 : 70); /* no driver's destructor */
}
