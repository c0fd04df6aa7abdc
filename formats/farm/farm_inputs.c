/* farm_inputs.c - the files that a plan was made of, and whether they are still the same.
 *
 * Checksums are XXH3-128. Of a file above FMT_FARM_WHOLE only samples are read: its first and last
 * MiB and pieces in equal steps, because a task must not read all of a scan of 100 GB to begin. The
 * headers of .tris and .nvdb files lie in the first MiB, and hold checksums of other parts. */
#include <inttypes.h>
#include <stdlib.h>
#include <string.h>

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

int fmt_farm_hash(struct bsq_ctx *ctx, const char *path, uint64_t *bytes, uint64_t hash[2])
{
    struct bsq_file file;
    void *buffer;
    int status = bsq_alloc(ctx, "checksum of a file", 1, BUFFER, &buffer);
    if (status < 0)
        return status;
    status = bsq_file_open(ctx, path, &file);
    if (status == 0) {
        *bytes = file.size;
        status = hash_file(ctx, &file, buffer, hash);
        bsq_file_close(ctx, &file);
    }
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
    return fmt_farm_hash(plan->ctx, path, &input->bytes, input->hash);
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

int fmt_farm_check_inputs(const struct fmt_farm_plan *plan)
{
    int status = 0;
    for (uint32_t i = 0; i < plan->input_count && status == 0; i++) {
        const struct fmt_farm_input *input = &plan->inputs[i];
        uint64_t bytes = 0, hash[2] = {0};
        status = fmt_farm_hash(plan->ctx, input->path, &bytes, hash);
        if (status == 0 &&
            (bytes != input->bytes || hash[0] != input->hash[0] || hash[1] != input->hash[1]))
            status = bsq_fail(plan->ctx, BSQ_EDATA,
                              "%s: %s is not the file that the plan %s was made with: make a new "
                              "plan",
                              input->path, input->role[0] ? input->role : "this input", plan->path);
    }
    return status;
}
