/* farm.h - work that is divided into tasks: what plans and parts of all kinds have in common.
 *
 * In: the members of a plan as JSON, the inputs of a job, and what a task made. Out: plan files,
 * which name all inputs with checksums, and part files, each of which belongs to one plan and one
 * task. FORMATS.md describes both. A kind of work (a bake, a grid) adds members and content. */
#ifndef FMT_FARM_FARM_H
#define FMT_FARM_FARM_H

#include <jansson.h>

#include "base/output.h"

#ifdef __cplusplus
extern "C" {
#endif

/* ---- plans ---- */

/* A kind of work. The strings live as long as the program. */
struct fmt_farm_kind {
    const char *format;          /* member "format" of its plans */
    uint32_t format_version;     /* of its plans */
    const char *program;         /* that reads and writes them, for messages */
    const char *program_version; /* its version */
    const char *work;            /* for messages: "a bake" */
    char magic[8];               /* of its parts */
    uint32_t part_version;
    uint32_t most_tasks;
};

/* A file that the work reads. */
struct fmt_farm_input {
    char *path, *role; /* owned; the role is for messages */
    uint64_t bytes;
    uint64_t hash[2]; /* of its content, or of samples of it */
    char *identity;   /* see fmt_farm_identity(); owned; NULL: unknown */
};

/* What plans of all kinds have. */
struct fmt_farm_plan {
    struct bsq_ctx *ctx;
    const struct fmt_farm_kind *kind;
    char *path;     /* of the plan file */
    uint64_t id[2]; /* a checksum of what is in the file */
    uint32_t task_count;
    uint32_t input_count;
    struct fmt_farm_input *inputs;
};

/* Makes a plan without inputs. Clear it with fmt_farm_plan_clear(), also after a failure. Errors:
 * BSQ_ENOMEM. */
int fmt_farm_plan_init(struct bsq_ctx *ctx, const struct fmt_farm_kind *kind, const char *path,
                       uint32_t task_count, struct fmt_farm_plan *plan);
void fmt_farm_plan_clear(struct fmt_farm_plan *plan); /* zeros are allowed */

/* Writes the plan file, computes its id, and sets *kept if the same plan was there already.
 * members: an object with the members of this kind, which this call takes over and completes; NULL
 * if there was no memory for it. Errors: BSQ_EUSAGE for a file name that is not UTF-8;
 * BSQ_ECANTCREAT, BSQ_EIO, BSQ_ENOMEM. */
int fmt_farm_plan_write(struct fmt_farm_plan *plan, json_t *members, bool *kept);

/* A plan file as JSON. */
struct fmt_farm_text {
    struct bsq_ctx *ctx;
    json_t *json;
    uint64_t reserved; /* bytes of the budget */
};

/* Reads a plan file: checks its kind, version and id, and fills in *plan. text->json has the
 * members of this kind. Clear plan and text also after a failure. Errors: BSQ_ENOINPUT; BSQ_EDATA
 * for a file that is no such plan, is damaged or was written by another version. */
int fmt_farm_plan_read(struct bsq_ctx *ctx, const struct fmt_farm_kind *kind, const char *path,
                       struct fmt_farm_plan *plan, struct fmt_farm_text *text);
void fmt_farm_text_clear(struct fmt_farm_text *text); /* zeros are allowed */

/* Report BSQ_ENOMEM; BSQ_EDATA for a damaged plan, with what is damaged. Return that. */
int fmt_farm_fail_memory(const struct fmt_farm_plan *plan);
int fmt_farm_fail_plan(const struct fmt_farm_plan *plan, const char *what);

/* Reads the whole number `name` of an object, from `least` to `most`. Errors: BSQ_EDATA. */
int fmt_farm_read_count(const struct fmt_farm_plan *plan, const json_t *json, const char *name,
                        uint64_t least, uint64_t most, uint64_t *out);

/* Returns how a plan names a file: a path below the plan's directory, and one that was given
 * relative to the current directory, becomes relative to the plan's directory; others stay as they
 * are. The caller frees it. NULL if there is no memory. */
char *fmt_farm_path_in_plan(const char *plan_path, const char *path);

/* Returns the path that a name in a plan stands for. Rules for paths (base/path_map.h) apply to
 * absolute ones. The caller frees it. NULL if there is no memory. */
char *fmt_farm_path_from_plan(struct bsq_ctx *ctx, const char *plan_path, const char *name);

/* Checks that a plan can name a file: JSON holds UTF-8 only. NULL is allowed. Errors: BSQ_EUSAGE.
 */
int fmt_farm_check_name(struct bsq_ctx *ctx, const char *path);

/* Reads a whole number from 0 to `most`. Returns false if the value is none. */
bool fmt_farm_is_count(const json_t *value, uint64_t most, uint64_t *out);

/* ---- inputs ---- */

/* Adds each file that the job has opened as input, with its checksum. Errors: those of
 * bsq_file_open() and bsq_file_read(), BSQ_ENOMEM. */
int fmt_farm_add_inputs(struct fmt_farm_plan *plan);

/* Checks that all inputs are those of the plan: by the identity of the files, else by checksum.
 * Errors: BSQ_EDATA, which names the first that is not; those of bsq_file_open(). */
int fmt_farm_check_inputs(const struct fmt_farm_plan *plan);

/* Of a file up to this many bytes, all of it is read for the checksum; else samples. */
#define FMT_FARM_WHOLE (UINT64_C(64) << 20)

/* ---- parts ---- */

/* The first bytes of all parts. The last 8 bytes of a header are the checksum of those before. */
struct fmt_farm_part_head {
    char magic[8];
    uint32_t version;
    uint32_t own; /* of each kind */
    uint64_t plan_id[2];
    uint32_t task, task_count;
};

/* Fills in the head of a task's part. */
struct fmt_farm_part_head fmt_farm_part_head(const struct fmt_farm_plan *plan, uint32_t task,
                                             uint32_t own);

/* Returns the path of a task's part file, which the caller frees; NULL if there is no memory. */
char *fmt_farm_part_path(const struct fmt_farm_plan *plan, uint32_t task);

/* Opens a task's part and reads its header of `size` bytes, which begins with a head. Checks what
 * all parts have. Close *file also after a failure. Errors: BSQ_ENOINPUT; BSQ_EDATA for a part that
 * is damaged or of another task or plan. */
int fmt_farm_part_open(const struct fmt_farm_plan *plan, uint32_t task, void *header, size_t size,
                       struct bsq_file *file);

/* Reports BSQ_EDATA for a part, and that its task should run again. Returns that. */
int fmt_farm_fail_part(const struct fmt_farm_plan *plan, const struct bsq_file *file,
                       const char *what);

/* How a kind of part is written and checked. */
struct fmt_farm_part_steps {
    void *arg;
    /* Writes all of a part. May be called more than once. */
    int (*write)(void *arg, struct bsq_output *output);
    /* Opens the part of a task and checks it. */
    int (*check)(void *arg, uint32_t task);
};

/* Writes the part of a task. Tries again if another task of the same number took the file away.
 * Errors: BSQ_EIO, BSQ_ECANTCREAT, BSQ_ENOMEM, BSQ_EINTR. */
int fmt_farm_part_write(const struct fmt_farm_plan *plan, uint32_t task,
                        const struct fmt_farm_part_steps *steps);

/* Sets *out if the part of a task is there and steps->check() accepts it. Errors: BSQ_ENOMEM,
 * BSQ_EINTR. */
int fmt_farm_part_is_there(const struct fmt_farm_plan *plan, uint32_t task,
                           const struct fmt_farm_part_steps *steps, bool *out);

/* Checks that all parts are there and accepted. Errors: BSQ_ENOINPUT, which names the missing ones;
 * BSQ_EINTR; those of steps->check(). */
int fmt_farm_parts_check(const struct fmt_farm_plan *plan, const struct fmt_farm_part_steps *steps);

/* Checks that the plan has a task of this number. Errors: BSQ_EUSAGE. */
int fmt_farm_check_task(const struct fmt_farm_plan *plan, uint32_t task);

/* Check before the work that the part of a task, or the note of the merge, can be written. Errors:
 * those of bsq_output_check(). */
int fmt_farm_check_part_output(const struct fmt_farm_plan *plan, uint32_t task);
int fmt_farm_check_note_output(const struct fmt_farm_plan *plan);

/* ---- merged files ---- */

/* Writes a text to a file, which appears whole or not at all. Errors: as bsq_output_open() and
 * bsq_output_commit(). */
int fmt_farm_write_text(struct bsq_ctx *ctx, const char *path, const char *text);

/* Returns the path of the note that the parts are merged, which the caller frees; NULL if there is
 * no memory. */
char *fmt_farm_note_path(const struct fmt_farm_plan *plan);

/* Bytes of what a merge found, with its end. */
enum { FMT_FARM_FOUND_BYTES = 128 };

/* Notes in a file beside the plan that these files were merged. found: a line for
 * fmt_farm_is_merged(). Errors: BSQ_EIO, BSQ_ECANTCREAT, BSQ_ENOMEM, BSQ_ENOINPUT. */
int fmt_farm_note_merged(const struct fmt_farm_plan *plan, char *const *paths, uint64_t count,
                         const char *found);

/* Returns whether these files were merged from the plan and not touched since. If so, copies the
 * line that fmt_farm_note_merged() was given. */
bool fmt_farm_is_merged(const struct fmt_farm_plan *plan, char *const *paths, uint64_t count,
                        char found[FMT_FARM_FOUND_BYTES]);

#ifdef __cplusplus
}
#endif
#endif
