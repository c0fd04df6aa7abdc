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

static int bad_node(const struct verify *v, const char *level, uint64_t number, const char *what)
{
    return bsq_fail(v->ctx, BSQ_EDATA, "%s: damaged: %s node %" PRIu64 " has a wrong %s",
                    v->grid->map.path, level, number, what);
}

/* Returns what is wrong with bytes of a node that no reader of Bisque follows, or NULL. */
static const char *fault_of_node(uint64_t flags, const uint64_t statistics[4],
                                 const uint64_t *child_mask, const int64_t *table, uint32_t slots)
{
    uint64_t unused = 0;
    for (uint32_t i = 0; i < slots; i++)
        unused |= child_mask[i / 64] >> (i % 64) & 1 ? 0 : (uint64_t)table[i];
    if (flags != NVDB_NODE_HAS_BBOX)
        return "flag";
    if (statistics[0] | statistics[1] | statistics[2] | statistics[3])
        return "statistic";
    return unused ? "offset without a child" : NULL;
}

static int verify_upper(void *arg, uint64_t index, unsigned worker)
{
    (void)worker;
    const struct verify *v = arg;
    const struct nvdb_upper *node =
        (const struct nvdb_upper *)(const void *)v->grid->uppers + index;
    const char *fault =
        fault_of_node(node->flags, node->statistics, node->child_mask, node->table, 32768);
    return fault ? bad_node(v, "upper", index, fault) : bsq_check(v->ctx);
}

static int verify_lower(void *arg, uint64_t index, unsigned worker)
{
    (void)worker;
    const struct verify *v = arg;
    const struct nvdb_lower *node =
        (const struct nvdb_lower *)(const void *)v->grid->lowers + index;
    const char *fault =
        fault_of_node(node->flags, node->statistics, node->child_mask, node->table, 4096);
    forget_pages(v->grid, node, sizeof *node);
    return fault ? bad_node(v, "lower", index, fault) : bsq_check(v->ctx);
}

static int verify_nodes(struct verify *v)
{
    int status = bsq_parallel_for(v->ctx, v->grid->upper_count, verify_upper, v);
    return status ? status : bsq_parallel_for(v->ctx, v->grid->lower_count, verify_lower, v);
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
    forget_pages(grid, grid->normals + begin, (end - begin) * 4);
    forget_pages(grid, grid->planes + begin, (end - begin) * 4);
    if (grid->colors)
        forget_pages(grid, grid->colors + begin, (end - begin) * 4);
    if (grid->ids)
        forget_pages(grid, grid->ids + begin, (end - begin) * 4);
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
    forget_pages(grid, grid->map.data, grid->map.size);
    fmt_nvdb_layout_of(grid, &v.layout);
    v.record = fmt_nvdb_record_of(grid, &v.layout);
    int status = bsq_parallel_for(ctx, NVDB_RECORD, verify_section, &v);
    if (status == 0)
        status = verify_padding(&v);
    if (status == 0)
        status = verify_nodes(&v);
    return status ? status : verify_records(&v);
}
