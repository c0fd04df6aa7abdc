/* nvdb_verify.c - checks a whole grid file: each section against its checksum, and each record.
 *
 * Only verifying checks records, and bytes of nodes that a traversal does not follow. The baker is
 * safe with any bits in a record, and reading all channels would take most of the time of opening a
 * grid. Voxels are checked in tasks of whole entries of the channel "second"; their ranks, which
 * fmt_nvdb_check_nodes() has checked, give the numbers of a task's second records. */
#include <inttypes.h>
#include <math.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <unistd.h>
#include <xxhash.h>

#include "base/parallel.h"
#include "formats/grid/nvdb_layout_internal.h"

/* Bytes that are hashed between two checks for an interrupt. */
#define HASH_BYTES (UINT64_C(4) << 20)
/* Voxels of a task: 32 for each entry of the channel "second". */
#define VOXELS_PER_TASK (UINT64_C(32) << 14)

struct verify {
    struct bsq_ctx *ctx;
    const struct fmt_nvdb_grid *grid;
    const uint8_t *file;
    struct nvdb_layout layout;
    const struct nvdb_record *record;
};

/* Returns pages of a mapped file to the system, so that few are resident at a time. Leaves a grid
 * alone that is in other memory, as in tests: its bytes would be lost. */
static void forget_pages(const struct fmt_nvdb_grid *grid, const void *from, uint64_t size)
{
    uintptr_t page = (uintptr_t)sysconf(_SC_PAGESIZE), begin = (uintptr_t)from / page * page;
    if (grid->map.range)
        madvise((void *)begin, (uintptr_t)from + size - begin, MADV_DONTNEED);
}

/* ---- sections ---- */

static int hash_section(const struct verify *v, const struct nvdb_range *range, uint64_t *hash)
{
    XXH3_state_t *state = XXH3_createState();
    if (!state)
        return bsq_fail(v->ctx, BSQ_ENOMEM, "no memory for a checksum");
    int status = 0;
    XXH3_64bits_reset(state);
    const uint8_t *data = v->file + range->offset;
    for (uint64_t done = 0; done < range->size && status == 0;) {
        uint64_t left = range->size - done, size = left < HASH_BYTES ? left : HASH_BYTES;
        XXH3_64bits_update(state, data + done, (size_t)size);
        forget_pages(v->grid, data + done, size);
        done += size;
        bsq_progress_add(v->ctx, size);
        status = bsq_check(v->ctx);
    }
    *hash = XXH3_64bits_digest(state);
    XXH3_freeState(state);
    return status;
}

static int verify_section(void *arg, uint64_t index, unsigned worker)
{
    (void)worker;
    const struct verify *v = arg;
    const struct nvdb_range *range = &v->layout.section[index];
    uint64_t hash = 0;
    if ((index == NVDB_IDS || index == NVDB_NAMES) && v->grid->info.ids == BSQ_IDS_NONE)
        return 0;
    if (index == NVDB_CHANNELS && v->grid->channel_words == 0)
        return 0;
    int status = hash_section(v, range, &hash);
    if (status)
        return status;
    if (hash !=
        (index == NVDB_CHANNELS ? v->record->channels_checksum : v->record->checksum[index]))
        return bsq_fail(v->ctx, BSQ_EDATA, "%s: damaged: wrong checksum of %s at byte %llu",
                        v->grid->map.path, fmt_nvdb_channel((enum nvdb_section)index)->name,
                        (unsigned long long)range->offset);
    return 0;
}

/* Checks that the bytes between sections are zero. */
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

/* ---- nodes ---- */

/* Returns what is wrong with bytes of a node that no reader of Bisque follows, or NULL. */
static const char *fault_of_node(const struct nvdb_level *level, const struct nvdb_node *node)
{
    const uint64_t *mask = nvdb_child_mask(level, node), *of = nvdb_statistics(level, node);
    const int64_t *table = nvdb_table(level, node);
    uint64_t unused = 0;
    for (uint32_t i = 0; i < 64 * level->words; i++)
        unused |= mask[i / 64] >> (i % 64) & 1 ? 0 : (uint64_t)table[i];
    if (node->flags != NVDB_NODE_HAS_BBOX)
        return "flag";
    if (of[0] | of[1] | of[2] | of[3])
        return "statistic";
    return unused ? "offset without a child" : NULL;
}

static int verify_node(void *arg, uint64_t index, unsigned worker)
{
    (void)worker;
    const struct verify *v = arg;
    const bool upper = index < v->grid->upper_count;
    const struct nvdb_level *level = upper ? &fmt_nvdb_upper : &fmt_nvdb_lower;
    const uint64_t number = upper ? index : index - v->grid->upper_count;
    const uint8_t *node = (upper ? v->grid->uppers : v->grid->lowers) + number * level->node_bytes;
    const char *fault = fault_of_node(level, (const void *)node);
    forget_pages(v->grid, node, level->node_bytes);
    return fault ? bsq_fail(v->ctx, BSQ_EDATA, "%s: damaged: %s node %" PRIu64 " has a wrong %s",
                            v->grid->map.path, level->name, number, fault)
                 : bsq_check(v->ctx);
}

/* ---- records ---- */

static int bad_record(const struct verify *v, uint64_t number, const char *what)
{
    return bsq_fail(v->ctx, BSQ_EDATA, "%s: damaged: record %" PRIu64 " has a wrong %s",
                    v->grid->map.path, number, what);
}

/* Returns what is wrong with a record, or NULL. second: whether its voxel has a second record. */
static const char *fault_of(const struct fmt_nvdb_grid *grid, uint64_t number, bool second)
{
    uint32_t normal = grid->normals[number], plane = grid->planes[number];
    if ((normal & 0xffff) == 0x8000 || normal >> 16 == 0x8000)
        return "normal";
    uint32_t noise = plane >> FMT_NVDB_FACET_NOISE_SHIFT;
    if (noise > FMT_NVDB_FACET_NOISE_MAX || (noise > 0 && (plane & FMT_NVDB_PLANE_INCONSISTENT)) ||
        abs((int16_t)(plane & 0xffff)) > FMT_NVDB_PLANE_MAX)
        return "plane";
    if (!(plane & FMT_NVDB_PLANE_SECOND) != !second)
        return "mark of a second record";
    uint32_t color = grid->colors ? grid->colors[number] : 0;
    if (color != 0 && color >> 24 != 255)
        return "colour";
    if (grid->ids && grid->ids[number] >> 24 != 255)
        return "id";
    bool finite = true;
    for (uint32_t i = 0; i < grid->channel_words; i++)
        finite &= isfinite(grid->channels[number * grid->channel_words + i]) != 0;
    return finite ? NULL : "channel";
}

/* Returns whether the background's channels are 0. */
static bool channels_begin_with_zeros(const struct fmt_nvdb_grid *grid)
{
    bool zero = true;
    for (uint32_t i = 0; i < grid->channel_words; i++)
        zero &= grid->channels[i] == 0.0f && !signbit(grid->channels[i]);
    return zero;
}

static int verify_voxel(const struct verify *v, uint64_t index)
{
    uint64_t second = fmt_nvdb_second(v->grid, index);
    const char *fault = fault_of(v->grid, index, second != 0);
    if (fault)
        return bad_record(v, index, fault);
    if (second && (fault = fault_of(v->grid, second, false)))
        return bad_record(v, second, fault);
    return 0;
}

static int verify_voxels(void *arg, uint64_t task, unsigned worker)
{
    (void)worker;
    const struct verify *v = arg;
    const struct fmt_nvdb_grid *grid = v->grid;
    uint64_t begin = task * VOXELS_PER_TASK, end = begin + VOXELS_PER_TASK;
    int status = bsq_check(v->ctx);
    if (end > grid->voxel_count + 1)
        end = grid->voxel_count + 1;
    for (uint64_t i = begin > 0 ? begin : 1; i < end && !status; i++)
        status = verify_voxel(v, i);
    const uint32_t *const values[] = {grid->normals, grid->planes, grid->colors, grid->ids};
    for (int i = 0; i < 4; i++)
        if (values[i])
            forget_pages(grid, values[i] + begin, (end - begin) * sizeof *values[i]);
    if (grid->channels)
        forget_pages(grid, grid->channels + begin * grid->channel_words,
                     (end - begin) * grid->channel_words * sizeof *grid->channels);
    return status;
}

static int verify_records(struct verify *v)
{
    const struct fmt_nvdb_grid *grid = v->grid;
    if (grid->normals[0] || grid->planes[0] || (grid->colors && grid->colors[0]) ||
        (grid->ids && grid->ids[0]) || !channels_begin_with_zeros(grid))
        return bad_record(v, 0, "value, as it is the background");
    return bsq_parallel_for(v->ctx, grid->voxel_count / VOXELS_PER_TASK + 1, verify_voxels, v);
}

int fmt_nvdb_verify(struct bsq_ctx *ctx, const struct fmt_nvdb_grid *grid)
{
    struct verify v = {.ctx = ctx, .grid = grid, .file = grid->map.data};
    int status;
    forget_pages(grid, grid->map.data, grid->map.size);
    fmt_nvdb_layout_of(grid, &v.layout);
    v.record = fmt_nvdb_record_of(grid, &v.layout);
    BSQ_TRY(bsq_parallel_for(ctx, NVDB_RECORD, verify_section, &v));
    BSQ_TRY(verify_padding(&v));
    BSQ_TRY(
        bsq_parallel_for(ctx, (uint64_t)grid->upper_count + grid->lower_count, verify_node, &v));
    status = verify_records(&v);
done:
    return status;
}
