/* job_files.c - the files that a job reads and writes.
 *
 * Files are compared by device and inode, so links and other spellings of a path do not matter. A
 * file that does not exist is its directory and its name in it. Both lists are found by paths in
 * hash tables, because a scan may name very many textures, and a bake may write very many tiles. */
#include <errno.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "base/context_internal.h"
#include "base/file.h"
#include "base/job_files.h"
#include "base/text_table.h"

/* Where a path leads. */
struct place {
    bool known, exists;
    uint64_t device, inode; /* of the file, or of its directory if the file does not exist */
    char *name;             /* in that directory; owned; NULL if the file exists */
};

struct input {
    const char *path;
    char *role; /* NULL: nobody said */
    struct place place;
    bool opened, own; /* own: this job wrote it before */
    struct bsq_identity found;
};

struct output {
    const char *path;
    struct place place;
    bool written;
};

struct job_files {
    struct bsq_texts input_paths, output_paths;
    struct input *inputs;   /* numbered as their paths */
    struct output *outputs; /* numbered as their paths */
    uint64_t input_capacity, output_capacity;
    uint64_t own_count; /* of inputs that this job wrote before */
    struct bsq_tally tally;
};

/* ---- places ---- */

static void find_missing(const char *path, struct place *out)
{
    struct stat info;
    char *end = bsq_follow_links(path);
    char *directory = end ? bsq_dirname(end) : NULL;
    if (directory && stat(directory, &info) == 0) {
        out->name = strdup(bsq_file_name(end));
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

static void free_files(struct bsq_ctx *ctx, void *object)
{
    struct job_files *files = object;
    for (uint64_t i = 0; i < files->input_paths.count; i++) {
        free(files->inputs[i].role);
        free(files->inputs[i].place.name);
    }
    for (uint64_t i = 0; i < files->output_paths.count; i++)
        free(files->outputs[i].place.name);
    bsq_texts_free(&files->input_paths);
    bsq_texts_free(&files->output_paths);
    bsq_tally_release(ctx, &files->tally);
    free(files->inputs);
    free(files->outputs);
    free(files);
}

static struct job_files *get_files(struct bsq_ctx *ctx)
{
    struct job_files *files = bsq_part_of(ctx, BSQ_JOB_FILES, sizeof *files, free_files);
    return files;
}

/* Returns NULL if no file was noted yet. */
static struct job_files *noted_files(struct bsq_ctx *ctx)
{
    return ctx->parts[BSQ_JOB_FILES].object;
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
    const uint64_t count = files->input_paths.count;
    uint64_t number = 0;
    int status = bsq_tally_grow(ctx, &files->tally, count + 1, sizeof *files->inputs,
                                &files->inputs, &files->input_capacity);
    if (status == 0)
        status = bsq_texts_add(ctx, &files->tally, &files->input_paths, path, &number);
    if (status < 0)
        return status;
    *out = &files->inputs[number];
    if (number == count)
        **out = (struct input){.path = files->input_paths.list[number], .place = find_place(path)};
    return 0;
}

/* Compares an input with all outputs. One that was written counts before others that were noted
 * under other names of the same file. */
static int check_input(struct bsq_ctx *ctx, struct input *input)
{
    struct job_files *files = noted_files(ctx);
    const struct output *same = NULL;
    for (uint64_t i = 0; i < files->output_paths.count; i++) {
        const struct output *output = &files->outputs[i];
        if (same_place(&input->place, &output->place) && (!same || output->written))
            same = output;
    }
    if (!same)
        return 0;
    if (!same->written)
        return fail_overwrite(ctx, same->path, input);
    files->own_count += !input->own;
    input->own = true;
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
    return bsq_tally_add(ctx, &noted_files(ctx)->tally, strlen(input->role) + 1);
}

int bsq_note_input(struct bsq_ctx *ctx, const char *path, const char *format, ...)
{
    struct input *input;
    va_list arguments;
    va_start(arguments, format);
    pthread_mutex_lock(&ctx->parts_lock);
    int status = add_input(ctx, path, &input);
    if (status == 0)
        status = set_role(ctx, input, format, arguments);
    if (status == 0)
        status = check_input(ctx, input);
    pthread_mutex_unlock(&ctx->parts_lock);
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
    pthread_mutex_lock(&ctx->parts_lock);
    int status = add_input(ctx, path, &input);
    if (status == 0)
        status = check_input(ctx, input);
    if (status == 0 && !input->opened) {
        input->opened = true;
        input->found = *found;
    } else if (status == 0 && !bsq_same_identity(&input->found, found)) {
        status = bsq_fail_changed(ctx, path);
    }
    pthread_mutex_unlock(&ctx->parts_lock);
    return status;
}

int bsq_next_input(struct bsq_ctx *ctx, uint64_t *next, char **path, char **role)
{
    int status = 0;
    *path = *role = NULL;
    pthread_mutex_lock(&ctx->parts_lock);
    const struct job_files *files = noted_files(ctx);
    for (; status == 0 && files && *next < files->input_paths.count; ++*next) {
        const struct input *input = &files->inputs[*next];
        if (!input->opened)
            continue;
        *path = strdup(input->path);
        *role = strdup(input->role ? input->role : "");
        status = *path && *role ? 1 : fail_memory(ctx, input->path);
    }
    pthread_mutex_unlock(&ctx->parts_lock);
    if (status < 0) {
        free(*path);
        free(*role);
        *path = *role = NULL;
    }
    return status;
}

/* ---- outputs ---- */

/* Sets *out to the output with this path, which is added if it is new. */
static int add_output(struct bsq_ctx *ctx, const char *path, struct output **out)
{
    struct job_files *files = get_files(ctx);
    if (!files)
        return fail_memory(ctx, path);
    const uint64_t count = files->output_paths.count;
    uint64_t number = 0;
    int status = bsq_tally_grow(ctx, &files->tally, count + 1, sizeof *files->outputs,
                                &files->outputs, &files->output_capacity);
    if (status == 0)
        status = bsq_texts_add(ctx, &files->tally, &files->output_paths, path, &number);
    if (status < 0)
        return status;
    *out = &files->outputs[number];
    if (number == count)
        **out = (struct output){.path = files->output_paths.list[number]};
    return 0;
}

int bsq_note_output(struct bsq_ctx *ctx, const char *path)
{
    struct output *output = NULL;
    pthread_mutex_lock(&ctx->parts_lock);
    int status = add_output(ctx, path, &output);
    if (status == 0) {
        free(output->place.name);
        output->place = find_place(path);
        output->written = false;
        for (uint64_t i = 0; status == 0 && i < noted_files(ctx)->input_paths.count; i++) {
            const struct input *input = &noted_files(ctx)->inputs[i];
            if (!input->own && same_place(&input->place, &output->place))
                status = fail_overwrite(ctx, path, input);
        }
    }
    pthread_mutex_unlock(&ctx->parts_lock);
    return status;
}

char *bsq_output_directory(struct bsq_ctx *ctx)
{
    pthread_mutex_lock(&ctx->parts_lock);
    const struct job_files *files = noted_files(ctx);
    char *directory =
        bsq_dirname(files && files->output_paths.count > 0 ? files->output_paths.list[0] : "");
    pthread_mutex_unlock(&ctx->parts_lock);
    return directory;
}

void bsq_note_written(struct bsq_ctx *ctx, const char *path)
{
    pthread_mutex_lock(&ctx->parts_lock);
    struct job_files *files = noted_files(ctx);
    const uint64_t number = files ? bsq_texts_find(&files->output_paths, path) : 0;
    if (files && number < files->output_paths.count) {
        struct output *output = &files->outputs[number];
        free(output->place.name);
        output->place = find_place(path);
        output->written = true;
    }
    for (uint64_t i = 0; files && files->own_count > 0 && i < files->input_paths.count; i++)
        files->inputs[i].opened &= !files->inputs[i].own;
    pthread_mutex_unlock(&ctx->parts_lock);
}
