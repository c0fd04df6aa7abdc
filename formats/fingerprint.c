/* fingerprint.c - see fingerprint.h.
 *
 * Textures and meshes have no checksums, and are read wholly: 0.14 s for each GB that the system
 * has in memory (AMD EPYC), and as long as the disk takes otherwise. Chunk files and grids may be
 * larger than all else, and a task that reads one on another machine must not read 100 GB of it
 * twice. Whoever opens one checks what it uses by the checksums in it. */
#include "formats/fingerprint.h"

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <xxhash.h>

#include "formats/file_kind.h"

/* The header of a chunk file is in its first bytes, the record of a grid in its last ones. */
enum { BUFFER_BYTES = 1 << 20, WHOLE_BYTES = 64 << 20, END_BYTES = 4096 };

/* Adds the bytes from `begin` to `end` to a checksum. buffer: BUFFER_BYTES. */
static int add_bytes(struct bsq_ctx *ctx, const struct bsq_file *file, uint64_t begin, uint64_t end,
                     void *buffer, XXH3_state_t *state)
{
    int status = 0;
    for (uint64_t at = begin; at < end; at += BUFFER_BYTES) {
        const uint64_t size = end - at < BUFFER_BYTES ? end - at : BUFFER_BYTES;
        BSQ_TRY(bsq_check(ctx));
        BSQ_TRY(bsq_file_read(ctx, file, buffer, size, at));
        XXH3_128bits_update(state, buffer, size);
    }
done:
    return status;
}

static int hash_file(struct bsq_ctx *ctx, const struct bsq_file *file, enum fmt_kind kind,
                     char hash[33])
{
    const bool has_checksums = kind == FMT_KIND_TRIS || kind == FMT_KIND_NVDB;
    const bool whole = !has_checksums || file->size <= WHOLE_BYTES;
    XXH3_state_t *state = XXH3_createState();
    void *buffer = NULL;
    int status = 0;
    if (!state || XXH3_128bits_reset(state) != XXH_OK) {
        XXH3_freeState(state);
        return bsq_fail(ctx, BSQ_ENOMEM, "%s: out of memory", file->path);
    }
    BSQ_TRY(bsq_alloc(ctx, "checksum of a file", 1, BUFFER_BYTES, &buffer));
    BSQ_TRY(add_bytes(ctx, file, 0, whole ? file->size : END_BYTES, buffer, state));
    if (!whole)
        BSQ_TRY(add_bytes(ctx, file, file->size - END_BYTES, file->size, buffer, state));
    BSQ_TRY(bsq_file_check(ctx, file));
    const XXH128_hash_t digest = XXH3_128bits_digest(state);
    snprintf(hash, 33, "%016" PRIx64 "%016" PRIx64, digest.high64, digest.low64);
done:
    bsq_free(ctx, buffer);
    XXH3_freeState(state);
    return status;
}

int fmt_fingerprint(struct bsq_ctx *ctx, const char *path, struct fmt_fingerprint *out)
{
    const time_t settled = time(NULL) - BSQ_SETTLED_SECONDS;
    struct bsq_file file = BSQ_FILE_CLOSED;
    enum fmt_kind kind;
    int status = 0;
    *out = (struct fmt_fingerprint){0};
    BSQ_TRY(fmt_recognise(ctx, path, &kind));
    BSQ_TRY(bsq_file_open(ctx, path, &file));
    out->bytes = file.size;
    if (file.identity.changed.tv_sec <= settled)
        bsq_identity_text(&file.identity, out->identity);
    status = hash_file(ctx, &file, kind, out->hash);
done:
    bsq_file_close(ctx, &file);
    return status;
}

int fmt_is_same(struct bsq_ctx *ctx, const char *path, uint64_t bytes, const char *hash,
                const char *identity, bool *same)
{
    struct fmt_fingerprint now;
    struct bsq_file file;
    char text[BSQ_IDENTITY_BYTES];
    int status = bsq_file_open(ctx, path, &file);
    if (status < 0)
        return status;
    bsq_identity_text(&file.identity, text);
    const bool other_size = file.size != bytes;
    bsq_file_close(ctx, &file);
    *same = strcmp(text, identity) == 0;
    if (*same || other_size)
        return 0;
    status = fmt_fingerprint(ctx, path, &now);
    *same = strcmp(now.hash, hash) == 0;
    return status;
}
