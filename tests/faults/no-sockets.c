/* no-sockets.c - runs a program that is killed (SIGSYS) if it, or a process that it starts, calls
 * anything about sockets.
 *
 *   no-sockets PROGRAM ARGUMENT...
 *   no-sockets --open      opens a socket itself, to show that it is killed under another
 * no-sockets
 *
 * A seccomp filter looks at the number of each system call. io_uring is refused too, as it can open
 * sockets without further calls. Exit code 77: the system has no such filters. */
#include <errno.h>
#include <linux/audit.h>
#include <linux/filter.h>
#include <linux/seccomp.h>
#include <stddef.h>
#include <stdio.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <unistd.h>

#if defined __x86_64__
#define ARCHITECTURE AUDIT_ARCH_X86_64
#define MOST_NUMBERS 0x3fffffffu /* those above are of x32, with numbers of their own */
#elif defined __aarch64__
#define ARCHITECTURE AUDIT_ARCH_AARCH64
#define MOST_NUMBERS 0xffffffffu
#else
#error "add the architecture's number"
#endif

static const unsigned calls[] = {
    SYS_socket,   SYS_socketpair,  SYS_connect,     SYS_bind,           SYS_listen,
    SYS_accept,   SYS_accept4,     SYS_sendto,      SYS_sendmsg,        SYS_sendmmsg,
    SYS_recvfrom, SYS_recvmsg,     SYS_recvmmsg,    SYS_setsockopt,     SYS_getsockopt,
    SYS_shutdown, SYS_getsockname, SYS_getpeername, SYS_io_uring_setup,
};
enum { CALLS = sizeof calls / sizeof *calls };

static const struct sock_filter head[] = {
    BPF_STMT(BPF_LD | BPF_W | BPF_ABS, offsetof(struct seccomp_data, arch)),
    BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, ARCHITECTURE, 1, 0),
    BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_KILL_PROCESS),
    BPF_STMT(BPF_LD | BPF_W | BPF_ABS, offsetof(struct seccomp_data, nr)),
    BPF_JUMP(BPF_JMP | BPF_JGT | BPF_K, MOST_NUMBERS, 0, 1),
    BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_KILL_PROCESS),
};
enum { HEAD = sizeof head / sizeof *head };

static int install(void)
{
    struct sock_filter code[HEAD + 2 * CALLS + 1];
    struct sock_fprog filter = {HEAD, code};
    memcpy(code, head, sizeof head);
    for (unsigned i = 0; i < CALLS; i++) {
        code[filter.len++] =
            (struct sock_filter)BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, calls[i], 0, 1);
        code[filter.len++] =
            (struct sock_filter)BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_KILL_PROCESS);
    }
    code[filter.len++] = (struct sock_filter)BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_ALLOW);
    if (prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) != 0)
        return -1;
    return prctl(PR_SET_SECCOMP, SECCOMP_MODE_FILTER, &filter);
}

int main(int argc, char **argv)
{
    if (argc == 2 && strcmp(argv[1], "--open") == 0)
        return socket(AF_UNIX, SOCK_STREAM, 0) < 0 ? 1 : 0;
    if (argc < 2)
        return 64;
    if (install() != 0) {
        fprintf(stderr, "no-sockets: %s\n", strerror(errno));
        return 77;
    }
    execv(argv[1], argv + 1);
    fprintf(stderr, "no-sockets: %s: %s\n", argv[1], strerror(errno));
    return 127;
}
