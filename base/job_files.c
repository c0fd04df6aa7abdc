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
#include "base/text.h"

/* Where a path leads. */
struct place {
    bool known, exists;
    uint64_t device, inode; /* of the file, or of its directory if the file does not exist */
    char *name;             /* in that directory; owned; NULL if the file exists */
};

/* An input or an output. */
struct noted {
    const char *path;
    char *role; /* of an input; NULL: nobody said */
    struct place place;
    bool opened, own;          /* of an input; own: this job wrote it before */
    bool written;              /* of an output */
    struct bsq_identity found; /* of an input that was opened */
};

struct list {
    struct bsq_texts paths;
    struct noted *files; /* numbered as their paths */
    uint64_t capacity;
};

struct job_files {
    struct list inputs, outputs;
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

static struct place files_find_place(const char *path)
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

bool bsq_same_file(const char *a, const char *b)
{
    struct place places[2] = {files_find_place(a), files_find_place(b)};
    const bool same = same_place(&places[0], &places[1]);
    free(places[0].name);
    free(places[1].name);
    return same;
}

/* ---- the lists ---- */

static int files_fail_memory(struct bsq_ctx *ctx, const char *path)
{
    bsq_fail_errno(ctx, BSQ_ENOMEM, ENOMEM, "%s", path);
    return BSQ_ENOMEM;
}

static int fail_overwrite(struct bsq_ctx *ctx, const char *output, const struct noted *input)
{
    const char *role = input->role ? input->role : "an input";
    if (strcmp(output, input->path) == 0)
        return bsq_fail(ctx, BSQ_EUSAGE, "%s: this output would overwrite %s", output, role);
    return bsq_fail(ctx, BSQ_EUSAGE, "%s: this output would overwrite %s, %s", output, input->path,
                    role);
}

static void free_list(struct list *list)
{
    for (uint64_t i = 0; i < list->paths.count; i++) {
        free(list->files[i].role);
        free(list->files[i].place.name);
    }
    bsq_texts_free(&list->paths);
    free(list->files);
}

static void free_files(struct bsq_ctx *ctx, void *object)
{
    struct job_files *files = object;
    free_list(&files->inputs);
    free_list(&files->outputs);
    bsq_tally_release(ctx, &files->tally);
    free(files);
}

/* Makes the lists if there are none. */
static int files_begin(struct bsq_ctx *ctx, const char *path)
{
    const struct job_files *files = bsq_member_of(ctx, BSQ_JOB_FILES, sizeof *files, free_files);
    return files ? 0 : files_fail_memory(ctx, path);
}

/* Returns the lists, or NULL if no file was noted yet. */
static struct job_files *files_of(struct bsq_ctx *ctx)
{
    return ctx->members[BSQ_JOB_FILES].object;
}

/* Sets *out to the file with this path, which is added if it is new. */
static int files_add(struct bsq_ctx *ctx, struct list *list, const char *path, struct noted **out)
{
    struct bsq_tally *tally = &files_of(ctx)->tally;
    const uint64_t count = list->paths.count;
    uint64_t number = 0;
    BSQ_PASS(
        bsq_tally_grow(ctx, tally, count + 1, sizeof *list->files, &list->files, &list->capacity));
    BSQ_PASS(bsq_texts_add(ctx, tally, &list->paths, path, &number));
    *out = &list->files[number];
    if (number == count)
        **out = (struct noted){.path = list->paths.list[number], .place = files_find_place(path)};
    return 0;
}

/* ---- inputs ---- */

/* Compares an input with all outputs. One that was written counts before others that were noted
 * under other names of the same file. */
static int files_check_input(struct bsq_ctx *ctx, struct noted *input)
{
    const struct list *outputs = &files_of(ctx)->outputs;
    const struct noted *same = NULL;
    for (uint64_t i = 0; i < outputs->paths.count; i++) {
        const struct noted *output = &outputs->files[i];
        if (same_place(&input->place, &output->place) && (!same || output->written))
            same = output;
    }
    if (!same)
        return 0;
    if (!same->written)
        return fail_overwrite(ctx, same->path, input);
    files_of(ctx)->own_count += !input->own;
    input->own = true;
    return 0;
}

static int set_role(struct bsq_ctx *ctx, struct noted *input, const char *format, va_list arguments)
{
    if (input->role)
        return 0;
    if (vasprintf(&input->role, format, arguments) < 0) {
        input->role = NULL;
        return files_fail_memory(ctx, input->path);
    }
    return bsq_tally_add(ctx, &files_of(ctx)->tally, strlen(input->role) + 1);
}

int bsq_note_input(struct bsq_ctx *ctx, const char *path, const char *format, ...)
{
    struct noted *input;
    va_list arguments;
    int status;
    va_start(arguments, format);
    pthread_mutex_lock(&ctx->members_lock);
    BSQ_TRY(files_begin(ctx, path));
    BSQ_TRY(files_add(ctx, &files_of(ctx)->inputs, path, &input));
    BSQ_TRY(set_role(ctx, input, format, arguments));
    BSQ_TRY(files_check_input(ctx, input));
done:
    pthread_mutex_unlock(&ctx->members_lock);
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
    struct noted *input;
    int status;
    pthread_mutex_lock(&ctx->members_lock);
    BSQ_TRY(files_begin(ctx, path));
    BSQ_TRY(files_add(ctx, &files_of(ctx)->inputs, path, &input));
    BSQ_TRY(files_check_input(ctx, input));
    if (!input->opened) {
        input->opened = true;
        input->found = *found;
    } else if (!bsq_same_identity(&input->found, found)) {
        status = bsq_fail_changed(ctx, path);
    }
done:
    pthread_mutex_unlock(&ctx->members_lock);
    return status;
}

int bsq_next_input(struct bsq_ctx *ctx, uint64_t *next, struct bsq_noted_input *out)
{
    int status = 0;
    *out = (struct bsq_noted_input){0};
    pthread_mutex_lock(&ctx->members_lock);
    const struct job_files *files = files_of(ctx);
    if (files && *next < files->inputs.paths.count) {
        const struct noted *input = &files->inputs.files[(*next)++];
        *out = (struct bsq_noted_input){.path = strdup(input->path),
                                        .role = strdup(input->role ? input->role : ""),
                                        .opened = input->opened,
                                        .own = input->own,
                                        .found = input->found};
        status = out->path && out->role ? 1 : files_fail_memory(ctx, input->path);
    }
    pthread_mutex_unlock(&ctx->members_lock);
    if (status < 0)
        bsq_noted_input_free(out);
    return status;
}

void bsq_noted_input_free(struct bsq_noted_input *input)
{
    free(input->path);
    free(input->role);
    *input = (struct bsq_noted_input){0};
}

/* ---- outputs ---- */

/* Finds out again where an output's path leads. */
static void check_again(struct noted *output, bool written)
{
    free(output->place.name);
    output->place = files_find_place(output->path);
    output->written = written;
}

int bsq_note_output(struct bsq_ctx *ctx, const char *path)
{
    struct noted *output;
    int status;
    pthread_mutex_lock(&ctx->members_lock);
    BSQ_TRY(files_begin(ctx, path));
    BSQ_TRY(files_add(ctx, &files_of(ctx)->outputs, path, &output));
    check_again(output, false);
    for (uint64_t i = 0; i < files_of(ctx)->inputs.paths.count; i++) {
        const struct noted *input = &files_of(ctx)->inputs.files[i];
        if (!input->own && same_place(&input->place, &output->place))
            BSQ_TRY(fail_overwrite(ctx, path, input));
    }
done:
    pthread_mutex_unlock(&ctx->members_lock);
    return status;
}

char *bsq_output_directory(struct bsq_ctx *ctx)
{
    pthread_mutex_lock(&ctx->members_lock);
    const struct job_files *files = files_of(ctx);
    const bool any = files && files->outputs.paths.count > 0;
    char *directory = bsq_dirname(any ? files->outputs.paths.list[0] : "");
    pthread_mutex_unlock(&ctx->members_lock);
    return directory;
}

void bsq_note_written(struct bsq_ctx *ctx, const char *path)
{
    pthread_mutex_lock(&ctx->members_lock);
    struct job_files *files = files_of(ctx);
    const uint64_t number = files ? bsq_texts_find(&files->outputs.paths, path) : 0;
    if (files && number < files->outputs.paths.count)
        check_again(&files->outputs.files[number], true);
    for (uint64_t i = 0; files && files->own_count > 0 && i < files->inputs.paths.count; i++)
        files->inputs.files[i].opened &= !files->inputs.files[i].own;
    pthread_mutex_unlock(&ctx->members_lock);
}
