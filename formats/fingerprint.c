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

/* Adds the bytes from `begin` to `end` to a checksum. */
static int add_range(struct bsq_ctx *ctx, const struct bsq_file *file, uint64_t begin, uint64_t end,
                     XXH3_state_t *state)
{
    void *buffer;
    int status;
    BSQ_TRY(bsq_alloc(ctx, "checksum of a file", 1, BUFFER_BYTES, &buffer));
    for (uint64_t at = begin; at < end; at += BUFFER_BYTES) {
        const uint64_t size = end - at < BUFFER_BYTES ? end - at : BUFFER_BYTES;
        BSQ_TRY(bsq_check(ctx));
        BSQ_TRY(bsq_file_read(ctx, file, buffer, size, at));
        XXH3_128bits_update(state, buffer, size);
    }
done:
    bsq_free(ctx, buffer);
    return status;
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
    BSQ_PASS(add_range(ctx, file, 0, whole ? file->size : END_BYTES, state));
    return whole ? 0 : add_range(ctx, file, file->size - END_BYTES, file->size, state);
}

int fmt_fingerprint_begin(struct bsq_ctx *ctx, XXH3_state_t **out)
{
    *out = XXH3_createState();
    if (*out && XXH3_128bits_reset(*out) == XXH_OK)
        return 0;
    XXH3_freeState(*out);
    *out = NULL;
    return bsq_fail(ctx, BSQ_ENOMEM, "checksum: out of memory");
}

void fmt_fingerprint_end(XXH3_state_t *state, char out[FMT_FINGERPRINT_BYTES])
{
    const XXH128_hash_t digest = XXH3_128bits_digest(state);
    snprintf(out, FMT_FINGERPRINT_BYTES, "%016" PRIx64 "%016" PRIx64, digest.high64, digest.low64);
    XXH3_freeState(state);
}

int fmt_fingerprint(struct bsq_ctx *ctx, const char *path, char out[FMT_FINGERPRINT_BYTES])
{
    struct bsq_file file = BSQ_FILE_CLOSED;
    XXH3_state_t *state = NULL;
    enum fmt_kind kind;
    int status = 0;
    BSQ_TRY(fmt_recognise(ctx, path, &kind));
    BSQ_TRY(bsq_file_open(ctx, path, &file));
    BSQ_TRY(fmt_fingerprint_begin(ctx, &state));
    BSQ_TRY(kind == FMT_KIND_TRIS ? add_checksum(ctx, path, state)
                                  : fingerprint_add_file(ctx, &file, kind, state));
    BSQ_TRY(bsq_file_check(ctx, &file));
    fmt_fingerprint_end(state, out);
    state = NULL;
done:
    XXH3_freeState(state);
    bsq_file_close(ctx, &file);
    return status;
}

int fmt_fingerprint_bytes(struct bsq_ctx *ctx, const struct bsq_file *file, uint64_t size,
                          char out[FMT_FINGERPRINT_BYTES])
{
    XXH3_state_t *state;
    BSQ_PASS(fmt_fingerprint_begin(ctx, &state));
    const int status = add_range(ctx, file, 0, size, state);
    fmt_fingerprint_end(state, out);
    return status;
}
