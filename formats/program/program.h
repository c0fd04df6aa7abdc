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
/* Lets a program that uses a library of others turn a file into another one. Its arguments are
 * fmt_program_stamp, which must be its own, `option` (NULL: ""), the bytes of `memory` (0: what is
 * left) and `seconds`, its input is the descriptor `from`. If its exit status is BSQ_EDATA or
 * BSQ_ENOINPUT, its output is what is wrong. Sets to->size. Errors: those of fmt_program_find() and
 * fmt_program_run(); what the program says; BSQ_EDATA if it crashed or was too slow; BSQ_ENOMEM,
 * BSQ_EIO. */
struct fmt_converter {
    const char *program, *purpose; /* as fmt_program_find() takes them */
    const char *library, *path;    /* for messages */
    char *option;
    uint64_t memory, seconds;
    bool exports; /* the library writes `path`, and does not read it */
};
int fmt_program_convert(struct bsq_ctx *ctx, const struct fmt_converter *how, int from,
                        struct bsq_file *to);
/* Reports that such a program is of another build, or does not work. Returns BSQ_ENOINPUT. */
int fmt_program_misfit(struct bsq_ctx *ctx, const struct fmt_converter *how);
/* The first step of any such program: ends with the thread that started it, dumps no core, and dies
 * of crashes, also with sanitizers, which would exit instead. */
void fmt_program_isolate(void);

/* The input of a program that fmt_program_convert() runs. */
struct fmt_program_input {
    const uint8_t *bytes;
    uint64_t size;
};
/* Begins such a program: isolates it, maps its input, and limits its memory to `own` bytes more
 * than its argument says (UINT64_MAX: no limits), its time, and the descriptors of files. Returns
 * its option. Ends the program if its arguments, its stamp or its input are others. */
const char *fmt_program_begin(int argument_count, char **arguments, uint64_t own, uint64_t files,
                              struct fmt_program_input *input);
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
