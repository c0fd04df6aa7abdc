/* fingerprint.c - see fingerprint.h.
 *
 * Textures and meshes have no checksums, and are read wholly: 0.14 s for each GB that the system
 * has in memory (AMD EPYC), and as long as the disk takes otherwise. Chunk files and grids may be
 * larger than all else, and a part of a bake on another machine must not read 100 GB of it
 * twice. The header of a chunk file has a checksum that covers those of all chunks, by which each
 * chunk is checked when it is loaded. */
#include "formats/fingerprint.h"

#include <inttypes.h>
#include <stdio.h>
#include <string.h>
#include <xxhash.h>

#include "formats/chunks/tris.h"
#include "formats/file_kind.h"

/* The first bytes of a grid have its counts; the last ones are its trailer, which has a checksum of
 * each section. */
enum { BUFFER_BYTES = 1 << 20, WHOLE_BYTES = 64 << 20, END_BYTES = 4096 };

/* Adds the bytes from `begin` to `end` to a checksum. buffer: BUFFER_BYTES. */
static int add_bytes(struct bsq_ctx *ctx, const struct bsq_file *file, uint64_t begin, uint64_t end,
                     void *buffer, XXH3_state_t *state)
{
    for (uint64_t at = begin; at < end; at += BUFFER_BYTES) {
        const uint64_t size = end - at < BUFFER_BYTES ? end - at : BUFFER_BYTES;
        BSQ_PASS(bsq_check(ctx));
        BSQ_PASS(bsq_file_read(ctx, file, buffer, size, at));
        XXH3_128bits_update(state, buffer, size);
    }
    return 0;
}

/* Adds the checksum of a chunk file, whose header, materials and table are checked. */
static int add_checksum(struct bsq_ctx *ctx, const char *path, XXH3_state_t *state)
{
    struct fmt_tris_file *chunks;
    BSQ_PASS(fmt_tris_open(ctx, path, &chunks));
    const uint64_t checksum = fmt_tris_checksum(chunks);
    XXH3_128bits_update(state, &checksum, sizeof checksum);
    fmt_tris_close(chunks);
    return 0;
}

/* Adds a file that is no chunk file: all bytes, but of a large grid both ends. */
static int fingerprint_add_file(struct bsq_ctx *ctx, const struct bsq_file *file,
                                enum fmt_kind kind, XXH3_state_t *state)
{
    const bool whole = kind != FMT_KIND_NVDB || file->size <= WHOLE_BYTES;
    void *buffer = NULL;
    int status;
    BSQ_TRY(bsq_alloc(ctx, "checksum of a file", 1, BUFFER_BYTES, &buffer));
    BSQ_TRY(add_bytes(ctx, file, 0, whole ? file->size : END_BYTES, buffer, state));
    if (!whole)
        status = add_bytes(ctx, file, file->size - END_BYTES, file->size, buffer, state);
done:
    bsq_free(ctx, buffer);
    return status;
}

static int hash_file(struct bsq_ctx *ctx, const struct bsq_file *file, enum fmt_kind kind,
                     char hash[FMT_FINGERPRINT_BYTES])
{
    XXH3_state_t *state = XXH3_createState();
    int status;
    if (!state || XXH3_128bits_reset(state) != XXH_OK) {
        XXH3_freeState(state);
        return bsq_fail(ctx, BSQ_ENOMEM, "%s: out of memory", file->path);
    }
    BSQ_TRY(kind == FMT_KIND_TRIS ? add_checksum(ctx, file->path, state)
                                  : fingerprint_add_file(ctx, file, kind, state));
    BSQ_TRY(bsq_file_check(ctx, file));
    const XXH128_hash_t digest = XXH3_128bits_digest(state);
    snprintf(hash, FMT_FINGERPRINT_BYTES, "%016" PRIx64 "%016" PRIx64, digest.high64, digest.low64);
done:
    XXH3_freeState(state);
    return status;
}

int fmt_fingerprint(struct bsq_ctx *ctx, const char *path, char out[FMT_FINGERPRINT_BYTES])
{
    struct bsq_file file = BSQ_FILE_CLOSED;
    enum fmt_kind kind;
    int status = 0;
    BSQ_TRY(fmt_recognise(ctx, path, &kind));
    BSQ_TRY(bsq_file_open(ctx, path, &file));
    status = hash_file(ctx, &file, kind, out);
done:
    bsq_file_close(ctx, &file);
    return status;
}
