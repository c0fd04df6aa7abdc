/* job_files.c - the files that a job reads and writes.
 *
 * Files are compared by device and inode, so links and other spellings of a path do not matter. A
 * file that does not exist is its directory and its name in it. Inputs are found by their path in a
 * hash table, because a scan may name very many textures; outputs are few. */
#include <errno.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "base/context_internal.h"
#include "base/job_files.h"

/* The first bytes are not counted against the budget, so that jobs with few files have the same
 * memory as without this list. */
enum { FREE_BYTES = 64 << 10, FIRST_SLOTS = 64 };

/* Where a path leads. */
struct place {
    bool known, exists;
    uint64_t device, inode; /* of the file, or of its directory if the file does not exist */
    char *name;             /* in that directory; owned; NULL if the file exists */
};

struct input {
    char *path;
    char *role; /* NULL: nobody said */
    struct place place;
    bool opened, own; /* own: this job wrote it before */
    struct bsq_identity found;
};

struct output {
    char *path;
    struct place place;
    bool written;
};

struct job_files {
    struct input *inputs;
    uint64_t input_count, input_capacity;
    uint64_t *slots; /* open addressing: number of the input + 1 */
    uint64_t slot_count;
    struct output *outputs;
    uint64_t output_count;
    uint64_t bytes, reserved;
};

/* ---- places ---- */

static void find_missing(const char *path, struct place *out)
{
    struct stat info;
    char *end = bsq_follow_links(path);
    char *directory = end ? bsq_dirname(end) : NULL;
    if (directory && stat(directory, &info) == 0) {
        const char *slash = strrchr(end, '/');
        out->name = strdup(slash ? slash + 1 : end);
        out->known = out->name != NULL;
        out->device = info.st_dev;
        out->inode = info.st_ino;
    }
    free(directory);
    free(end);
}

static struct place find_place(const char *path)
{
    struct place place = {0};
    struct stat info;
    if (stat(path, &info) == 0)
        return (struct place){
            .known = true, .exists = true, .device = info.st_dev, .inode = info.st_ino};
    find_missing(path, &place);
    return place;
}

static bool same_place(const struct place *a, const struct place *b)
{
    return a->known && b->known && a->exists == b->exists && a->device == b->device &&
           a->inode == b->inode && (a->exists || strcmp(a->name, b->name) == 0);
}

/* ---- the list ---- */

static int fail_memory(struct bsq_ctx *ctx, const char *path)
{
    bsq_fail_errno(ctx, BSQ_ENOMEM, ENOMEM, "%s", path);
    return BSQ_ENOMEM;
}

/* Returns the slot of a path: that of its input, or an empty one. Some slot must be empty. */
static uint64_t *find_slot(const struct job_files *files, const char *path)
{
    uint64_t hash = UINT64_C(0xcbf29ce484222325); /* FNV-1a */
    for (const char *c = path; *c; c++)
        hash = (hash ^ (unsigned char)*c) * UINT64_C(0x100000001b3);
    for (uint64_t i = hash;; i++) {
        uint64_t *slot = &files->slots[i & (files->slot_count - 1)];
        if (*slot == 0 || strcmp(files->inputs[*slot - 1].path, path) == 0)
            return slot;
    }
}

/* Counts the bytes of new entries against the budget. */
static int count_bytes(struct bsq_ctx *ctx, struct job_files *files, uint64_t bytes)
{
    files->bytes += bytes;
    if (files->bytes <= FREE_BYTES)
        return 0;
    int status = bsq_reserve(ctx, "names of files", bytes);
    if (status == 0)
        files->reserved += bytes;
    return status;
}

/* Makes space for one more input, and keeps half of the slots empty. */
static int grow_inputs(struct bsq_ctx *ctx, struct job_files *files, const char *path)
{
    if (files->input_count < files->input_capacity)
        return 0;
    uint64_t capacity = files->input_capacity ? 2 * files->input_capacity : FIRST_SLOTS / 2;
    int status = count_bytes(ctx, files,
                             (capacity - files->input_capacity) *
                                 (sizeof *files->inputs + 2 * sizeof *files->slots));
    if (status != 0)
        return status;
    struct input *inputs = reallocarray(files->inputs, capacity, sizeof *inputs);
    if (inputs)
        files->inputs = inputs;
    uint64_t *slots = inputs ? calloc(2 * capacity, sizeof *slots) : NULL;
    if (!slots)
        return fail_memory(ctx, path);
    free(files->slots);
    files->slots = slots;
    files->slot_count = 2 * capacity;
    files->input_capacity = capacity;
    for (uint64_t i = 0; i < files->input_count; i++)
        *find_slot(files, inputs[i].path) = i + 1;
    return 0;
}

static struct job_files *get_files(struct bsq_ctx *ctx)
{
    if (!ctx->files)
        ctx->files = calloc(1, sizeof *ctx->files);
    return ctx->files;
}

static int fail_overwrite(struct bsq_ctx *ctx, const char *output, const struct input *input)
{
    const char *role = input->role ? input->role : "an input";
    if (strcmp(output, input->path) == 0)
        return bsq_fail(ctx, BSQ_EUSAGE, "%s: this output would overwrite %s", output, role);
    return bsq_fail(ctx, BSQ_EUSAGE, "%s: this output would overwrite %s, %s", output, input->path,
                    role);
}

/* ---- inputs ---- */

/* Sets *out to the input with this path, which is added if it is new. */
static int add_input(struct bsq_ctx *ctx, const char *path, struct input **out)
{
    struct job_files *files = get_files(ctx);
    if (!files)
        return fail_memory(ctx, path);
    int status = grow_inputs(ctx, files, path);
    if (status != 0)
        return status;
    uint64_t *slot = find_slot(files, path);
    if (*slot != 0) {
        *out = &files->inputs[*slot - 1];
        return 0;
    }
    if ((status = count_bytes(ctx, files, strlen(path) + 1)) != 0)
        return status;
    struct input input = {.path = strdup(path)};
    if (!input.path)
        return fail_memory(ctx, path);
    input.place = find_place(path);
    *out = &files->inputs[files->input_count++];
    *slot = files->input_count;
    **out = input;
    return 0;
}

/* Compares an input with all outputs. */
static int check_input(struct bsq_ctx *ctx, struct input *input)
{
    struct job_files *files = ctx->files;
    for (uint64_t i = 0; i < files->output_count; i++) {
        if (!same_place(&input->place, &files->outputs[i].place))
            continue;
        if (!files->outputs[i].written)
            return fail_overwrite(ctx, files->outputs[i].path, input);
        input->own = true;
    }
    return 0;
}

static int set_role(struct bsq_ctx *ctx, struct input *input, const char *format, va_list arguments)
{
    if (input->role)
        return 0;
    if (vasprintf(&input->role, format, arguments) < 0) {
        input->role = NULL;
        return fail_memory(ctx, input->path);
    }
    return count_bytes(ctx, ctx->files, strlen(input->role) + 1);
}

int bsq_note_input(struct bsq_ctx *ctx, const char *path, const char *format, ...)
{
    struct input *input;
    va_list arguments;
    va_start(arguments, format);
    pthread_mutex_lock(&ctx->files_lock);
    int status = add_input(ctx, path, &input);
    if (status == 0)
        status = set_role(ctx, input, format, arguments);
    if (status == 0)
        status = check_input(ctx, input);
    pthread_mutex_unlock(&ctx->files_lock);
    va_end(arguments);
    return status;
}

bool bsq_same_identity(const struct bsq_identity *a, const struct bsq_identity *b)
{
    return a->device == b->device && a->inode == b->inode && a->size == b->size &&
           a->modified.tv_sec == b->modified.tv_sec && a->modified.tv_nsec == b->modified.tv_nsec;
}

int bsq_fail_changed(struct bsq_ctx *ctx, const char *path)
{
    return bsq_fail(ctx, BSQ_EIO, "%s: was changed while it was read", path);
}

int bsq_hold_input(struct bsq_ctx *ctx, const char *path, const struct bsq_identity *found)
{
    struct input *input;
    pthread_mutex_lock(&ctx->files_lock);
    int status = add_input(ctx, path, &input);
    if (status == 0)
        status = check_input(ctx, input);
    if (status == 0 && !input->opened) {
        input->opened = true;
        input->found = *found;
    } else if (status == 0 && !bsq_same_identity(&input->found, found)) {
        status = bsq_fail_changed(ctx, path);
    }
    pthread_mutex_unlock(&ctx->files_lock);
    return status;
}

int bsq_next_input(struct bsq_ctx *ctx, uint64_t *next, char **path, char **role)
{
    int status = 0;
    *path = *role = NULL;
    pthread_mutex_lock(&ctx->files_lock);
    const struct job_files *files = ctx->files;
    for (; status == 0 && files && *next < files->input_count; ++*next) {
        const struct input *input = &files->inputs[*next];
        if (!input->opened)
            continue;
        *path = strdup(input->path);
        *role = strdup(input->role ? input->role : "");
        status = *path && *role ? 1 : fail_memory(ctx, input->path);
    }
    pthread_mutex_unlock(&ctx->files_lock);
    if (status < 0) {
        free(*path);
        free(*role);
        *path = *role = NULL;
    }
    return status;
}

/* ---- outputs ---- */

static int add_output(struct bsq_ctx *ctx, const char *path, struct output **out)
{
    struct job_files *files = get_files(ctx);
    for (uint64_t i = 0; files && i < files->output_count; i++)
        if (strcmp(files->outputs[i].path, path) == 0) {
            *out = &files->outputs[i];
            return 0;
        }
    struct output *outputs =
        files ? reallocarray(files->outputs, files->output_count + 1, sizeof *outputs) : NULL;
    if (outputs)
        files->outputs = outputs;
    char *copy = outputs ? strdup(path) : NULL;
    if (!copy)
        return fail_memory(ctx, path);
    *out = &outputs[files->output_count++];
    **out = (struct output){.path = copy};
    return count_bytes(ctx, files, sizeof *outputs + strlen(path) + 1);
}

int bsq_note_output(struct bsq_ctx *ctx, const char *path)
{
    struct output *output = NULL;
    pthread_mutex_lock(&ctx->files_lock);
    int status = add_output(ctx, path, &output);
    if (status == 0) {
        free(output->place.name);
        output->place = find_place(path);
        output->written = false;
        for (uint64_t i = 0; status == 0 && i < ctx->files->input_count; i++) {
            const struct input *input = &ctx->files->inputs[i];
            if (!input->own && same_place(&input->place, &output->place))
                status = fail_overwrite(ctx, path, input);
        }
    }
    pthread_mutex_unlock(&ctx->files_lock);
    return status;
}

void bsq_note_written(struct bsq_ctx *ctx, const char *path)
{
    struct place place = find_place(path);
    pthread_mutex_lock(&ctx->files_lock);
    struct job_files *files = ctx->files;
    for (uint64_t i = 0; files && i < files->output_count; i++) {
        struct output *output = &files->outputs[i];
        free(output->place.name);
        output->place = find_place(output->path);
        output->written |= same_place(&output->place, &place);
    }
    for (uint64_t i = 0; files && i < files->input_count; i++)
        files->inputs[i].opened &= !files->inputs[i].own;
    pthread_mutex_unlock(&ctx->files_lock);
    free(place.name);
}

void bsq_forget_files(struct bsq_ctx *ctx)
{
    pthread_mutex_lock(&ctx->files_lock);
    struct job_files *files = ctx->files;
    ctx->files = NULL;
    pthread_mutex_unlock(&ctx->files_lock);
    if (!files)
        return;
    for (uint64_t i = 0; i < files->input_count; i++) {
        free(files->inputs[i].path);
        free(files->inputs[i].role);
        free(files->inputs[i].place.name);
    }
    for (uint64_t i = 0; i < files->output_count; i++) {
        free(files->outputs[i].path);
        free(files->outputs[i].place.name);
    }
    bsq_release(ctx, files->reserved);
    free(files->inputs);
    free(files->slots);
    free(files->outputs);
    free(files);
}
