/* farm_inputs.c - the files that a plan was made of, and whether they are still the same.
 *
 * Checksums are XXH3-128. Of a file above FMT_FARM_WHOLE only samples are read: its first and last
 * MiB and pieces in equal steps, because a task must not read all of a scan of 100 GB to begin. The
 * headers of .tris and .nvdb files lie in the first MiB, and hold checksums of other parts.
 *
 * Tasks need not read even these of a file that still has the inode, size and times that it had
 * when the plan was made: the system changes the time of the last change of inode or content with
 * every write, and no program can set it. */
#include <inttypes.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>
#include <xxhash.h>

#include "base/job_files.h"
#include "formats/farm/farm.h"

enum { BUFFER = 1 << 20, PIECE = 16 << 10, PIECES = 512 };

/* Adds bytes of a file to a checksum. buffer: BUFFER bytes. */
static int add_bytes(struct bsq_ctx *ctx, const struct bsq_file *file, uint64_t begin, uint64_t end,
                     void *buffer, XXH3_state_t *state)
{
    int status = 0;
    for (uint64_t at = begin; at < end && status == 0; at += BUFFER) {
        const uint64_t size = end - at < BUFFER ? end - at : BUFFER;
        status = bsq_check(ctx);
        if (status == 0)
            status = bsq_file_read(ctx, file, buffer, size, at);
        if (status == 0)
            XXH3_128bits_update(state, buffer, size);
    }
    return status;
}

static int add_samples(struct bsq_ctx *ctx, const struct bsq_file *file, void *buffer,
                       XXH3_state_t *state)
{
    int status = add_bytes(ctx, file, 0, BUFFER, buffer, state);
    for (uint64_t i = 1; i < PIECES && status == 0; i++) {
        const uint64_t at = file->size / PIECES * i;
        status = add_bytes(ctx, file, at, at + PIECE, buffer, state);
    }
    return status < 0 ? status
                      : add_bytes(ctx, file, file->size - BUFFER, file->size, buffer, state);
}

static int hash_file(struct bsq_ctx *ctx, const struct bsq_file *file, void *buffer,
                     uint64_t hash[2])
{
    XXH3_state_t *state = XXH3_createState();
    if (!state || XXH3_128bits_reset(state) != XXH_OK) {
        XXH3_freeState(state);
        return bsq_fail(ctx, BSQ_ENOMEM, "%s: out of memory", file->path);
    }
    int status = file->size <= FMT_FARM_WHOLE ? add_bytes(ctx, file, 0, file->size, buffer, state)
                                              : add_samples(ctx, file, buffer, state);
    const XXH128_hash_t digest = XXH3_128bits_digest(state);
    hash[0] = digest.high64;
    hash[1] = digest.low64;
    XXH3_freeState(state);
    return status < 0 ? status : bsq_file_check(ctx, file);
}

/* Opens a file, and allocates what its checksum needs. */
static int open_input(struct bsq_ctx *ctx, const char *path, struct bsq_file *file, void **buffer)
{
    int status = bsq_alloc(ctx, "checksum of a file", 1, BUFFER, buffer);
    if (status != 0)
        return status;
    status = bsq_file_open(ctx, path, file);
    if (status != 0)
        bsq_free(ctx, *buffer);
    return status;
}

/* Returns inode, size and times of a file as text, to be freed; NULL if they are unknown. The
 * device is left out, because machines number devices of one file server differently. */
static char *identity_of(const struct bsq_file *file, time_t *changed)
{
    struct stat info;
    char *text = NULL;
    if (fstat(file->fd, &info) != 0 ||
        asprintf(&text, "%ju %jd %jd.%09ld %jd.%09ld", (uintmax_t)info.st_ino,
                 (intmax_t)info.st_size, (intmax_t)info.st_mtim.tv_sec, info.st_mtim.tv_nsec,
                 (intmax_t)info.st_ctim.tv_sec, info.st_ctim.tv_nsec) < 0)
        return NULL;
    *changed = info.st_ctim.tv_sec;
    return text;
}

/* A file that was changed within the last seconds could be changed again without getting another
 * time. */
enum { SETTLED_SECONDS = 3 };

/* Sets size, checksum and identity of an input. */
static int describe(struct bsq_ctx *ctx, struct fmt_farm_input *input)
{
    const time_t now = time(NULL);
    struct bsq_file file;
    time_t changed = now;
    void *buffer;
    int status = open_input(ctx, input->path, &file, &buffer);
    if (status != 0)
        return status;
    input->bytes = file.size;
    input->identity = identity_of(&file, &changed);
    if (changed > now - SETTLED_SECONDS) {
        free(input->identity);
        input->identity = NULL;
    }
    status = hash_file(ctx, &file, buffer, input->hash);
    bsq_file_close(ctx, &file);
    bsq_free(ctx, buffer);
    return status;
}

/* Adds an input, whose path and role the plan takes over in any case. */
static int add_input(struct fmt_farm_plan *plan, char *path, char *role)
{
    struct fmt_farm_input *inputs =
        reallocarray(plan->inputs, plan->input_count + 1u, sizeof *inputs);
    if (!inputs) {
        free(path);
        free(role);
        return fmt_farm_fail_memory(plan);
    }
    plan->inputs = inputs;
    struct fmt_farm_input *input = &inputs[plan->input_count++];
    *input = (struct fmt_farm_input){.path = path, .role = role};
    return describe(plan->ctx, input);
}

int fmt_farm_add_inputs(struct fmt_farm_plan *plan)
{
    uint64_t next = 0;
    char *path, *role;
    int status;
    while ((status = bsq_next_input(plan->ctx, &next, &path, &role)) > 0) {
        status = add_input(plan, path, role);
        if (status < 0)
            break;
    }
    return status;
}

/* Sets *same: whether an open file is the input. */
static int compare(struct bsq_ctx *ctx, const struct fmt_farm_input *input,
                   const struct bsq_file *file, void *buffer, bool *same)
{
    uint64_t hash[2] = {0};
    time_t changed;
    char *identity = input->identity ? identity_of(file, &changed) : NULL;
    *same = identity && strcmp(identity, input->identity) == 0;
    free(identity);
    if (*same || file->size != input->bytes)
        return 0;
    int status = hash_file(ctx, file, buffer, hash);
    *same = hash[0] == input->hash[0] && hash[1] == input->hash[1];
    return status;
}

static int check_input(const struct fmt_farm_plan *plan, const struct fmt_farm_input *input)
{
    struct bsq_ctx *ctx = plan->ctx;
    struct bsq_file file;
    void *buffer;
    bool same = false;
    int status = open_input(ctx, input->path, &file, &buffer);
    if (status != 0)
        return status;
    status = compare(ctx, input, &file, buffer, &same);
    bsq_file_close(ctx, &file);
    bsq_free(ctx, buffer);
    if (status < 0 || same)
        return status;
    return bsq_fail(ctx, BSQ_EDATA,
                    "%s: %s is not the file that the plan %s was made with: make a new plan",
                    input->path, input->role[0] ? input->role : "this input", plan->path);
}

int fmt_farm_check_inputs(const struct fmt_farm_plan *plan)
{
    int status = 0;
    for (uint32_t i = 0; i < plan->input_count && status == 0; i++)
        status = check_input(plan, &plan->inputs[i]);
    return status;
}
