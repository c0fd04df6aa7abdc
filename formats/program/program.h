/* program.h - finds and runs programs that are installed with Bisque: for libraries that may crash,
 * hang or take any amount of memory, and that would bring some 250 others into every start. */
#ifndef FMT_PROGRAM_PROGRAM_H
#define FMT_PROGRAM_PROGRAM_H

#include <limits.h>
#include <sys/types.h>

#include "base/file.h"
#include "base/output.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The version of Bisque and a checksum of all headers that such programs share with their callers
 * (shared_headers in the Makefile). Each has a copy. */
extern const char fmt_program_stamp[];

/* Finds a program or another file that is installed, and sets its path. An error says who needs it:
 * "PURPOSE need the program FILE, which is not in ...". Errors: BSQ_ENOINPUT. */
int fmt_program_find(struct bsq_ctx *ctx, const char *file, const char *purpose,
                     char out[PATH_MAX]);

/* How a program ended. */
struct fmt_program_end {
    int error; /* errno of the call that could not start it; 0: it started */
    bool late; /* it was killed after its time */
    int state; /* as waitpid() gives it; -1: not known */
};

/* Runs the program arguments[0] to its end. Its standard input is the descriptor `from` (-1:
 * nothing), its standard output is `to`. It has no other descriptors, and what it prints as errors
 * is lost. It is killed after `seconds`, or if the context is interrupted. If the system cannot end
 * it, it is left behind. Returns 0, also if the program failed, or BSQ_EINTR. */
int fmt_program_run(struct bsq_ctx *ctx, char *const arguments[], int from, int to, double seconds,
                    struct fmt_program_end *out);
/* Reports that a program that reads a file with a library of others did not do so. text: its
 * output; that of an exit status BSQ_EDATA or BSQ_ENOINPUT is what is wrong. seconds: its limit.
 * `left`: the memory that was left for it. Returns the status. */
int fmt_program_fail(struct bsq_ctx *ctx, const char *path, const char *library,
                     const struct fmt_program_end *end, char *text, uint64_t seconds,
                     uint64_t left);
/* Lets such a program turn a file into another one. Its arguments are `option` (NULL: none), the
 * bytes of `memory` (0: what is left) and `seconds`, its input is the descriptor `from`. Sets
 * to->size, and the path of the program. Errors: those of fmt_program_find(), fmt_program_run() and
 * fmt_program_fail(). */
struct fmt_converter {
    const char *program, *purpose; /* as fmt_program_find() takes them */
    const char *library, *path;    /* as fmt_program_fail() takes them */
    char *option;
    uint64_t memory, seconds;
};
int fmt_program_convert(struct bsq_ctx *ctx, const struct fmt_converter *how, int from,
                        struct bsq_file *to, char program[PATH_MAX]);
/* The first step of any such program: ends with the thread that started it, dumps no core, and dies
 * of crashes, also with sanitizers, which would exit instead. */
void fmt_program_isolate(void);

/* The input of a program that fmt_program_convert() runs. */
struct fmt_program_input {
    const uint8_t *bytes;
    uint64_t size;
};
/* Begins such a program, which has `options` arguments (0 or 1) before its memory and seconds:
 * isolates it, maps its input, and limits its memory to `own` bytes more than the argument says,
 * its time, and the descriptors of files. Ends the program if its arguments or its input are
 * others. */
void fmt_program_begin(int argument_count, char **arguments, int options, uint64_t own,
                       uint64_t files, struct fmt_program_input *input);
/* Ends such a program. Its output becomes a text, what is wrong. */
__attribute__((noreturn)) void fmt_program_refuse(int status, const char *text);

/* Checks that the system allows what the libraries of a program need when they are loaded: threads
 * and addresses. Some end the process without. Errors: BSQ_ENOMEM. */
int fmt_program_check(struct bsq_ctx *ctx, const char *purpose);

/* The directory that such programs are installed in; compiled in. */
extern const char fmt_program_directory[];

#ifdef __cplusplus
}
#endif
#endif
