/* nvdb_verify.c - the check of a whole .nvdb file: every section against its checksum, and what
 * only a faulty writer would get wrong. */
#include <sys/mman.h>
#include <unistd.h>
#include <xxhash.h>

#include "base/parallel.h"
#include "formats/grid/nvdb_layout_internal.h"

/* Between two looks at the interrupt flag. */
#define PIECE_BYTES (UINT64_C(4) << 20)

void fmt_nvdb_forget_pages(const void *from, uint64_t size)
{
    uintptr_t page = (uintptr_t)sysconf(_SC_PAGESIZE), begin = (uintptr_t)from / page * page;
    madvise((void *)begin, (uintptr_t)from + size - begin, MADV_DONTNEED);
}

static int hash_range(struct bsq_ctx *ctx, const uint8_t *data, uint64_t size, bool forget,
                      uint64_t *hash)
{
    XXH3_state_t *state = XXH3_createState();
    if (!state)
        return bsq_fail(ctx, BSQ_ENOMEM, "no memory for a checksum");
    int status = 0;
    XXH3_64bits_reset(state);
    for (uint64_t done = 0; done < size && status == 0;) {
        uint64_t piece = size - done < PIECE_BYTES ? size - done : PIECE_BYTES;
        XXH3_64bits_update(state, data + done, (size_t)piece);
        if (forget)
            fmt_nvdb_forget_pages(data + done, piece);
        done += piece;
        bsq_progress_add(ctx, piece);
        status = bsq_check(ctx);
    }
    *hash = XXH3_64bits_digest(state);
    XXH3_freeState(state);
    return status;
}

struct verify {
    struct bsq_ctx *ctx;
    const struct fmt_nvdb_grid *grid;
    const uint8_t *file;
    struct nvdb_layout layout;
    const struct nvdb_record *record;
    bool forget;
};

static int verify_section(void *arg, uint64_t index, unsigned worker)
{
    (void)worker;
    static const char *const names[] = {"header", "upper nodes", "lower nodes", "leaf nodes",
                                        "blind metadata"};
    const struct verify *v = arg;
    const struct nvdb_range *range = &v->layout.section[index];
    uint64_t hash = 0;
    int status = hash_range(v->ctx, v->file + range->offset, range->size, v->forget, &hash);
    if (status)
        return status;
    if (hash != v->record->checksum[index])
        return bsq_fail(
            v->ctx, BSQ_EDATA, "%s: damaged: wrong checksum of %s at byte %llu", v->grid->map.path,
            index < NVDB_NORMALS ? names[index] : fmt_nvdb_channel((enum nvdb_section)index)->name,
            (unsigned long long)range->offset);
    return 0;
}

/* Sections are padded to their alignment with zeros. */
static int verify_padding(const struct verify *v)
{
    for (int i = 1; i < NVDB_SECTION_COUNT; i++) {
        const struct nvdb_range *before = &v->layout.section[i - 1];
        for (uint64_t at = before->offset + before->size; at < v->layout.section[i].offset; at++)
            if (v->file[at] != 0)
                return bsq_fail(v->ctx, BSQ_EDATA, "%s: damaged: padding at byte %llu is not zero",
                                v->grid->map.path, (unsigned long long)at);
    }
    return 0;
}

int fmt_nvdb_verify_grid(struct bsq_ctx *ctx, const struct fmt_nvdb_grid *grid, bool forget)
{
    struct verify v = {.ctx = ctx, .grid = grid, .file = grid->map.data, .forget = forget};
    fmt_nvdb_layout_of(grid, &v.layout);
    v.record = fmt_nvdb_record_of(grid, &v.layout);
    int status = bsq_parallel_for(ctx, NVDB_RECORD, verify_section, &v);
    if (status == 0)
        status = verify_padding(&v);
    return status ? status : fmt_nvdb_check_records(ctx, grid, forget);
}

int fmt_nvdb_verify(struct bsq_ctx *ctx, const struct fmt_nvdb_grid *grid)
{
    return fmt_nvdb_verify_grid(ctx, grid, false);
}
