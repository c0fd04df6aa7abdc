/* nvdb_writer.c - takes a grid region by region and keeps its sections in a temporary file.
 *
 * Regions come in the file's order, so each leaf, value index and prefix sum is final when it is
 * appended. Only the tables of internal nodes need totals: they hold distances between sections. Of
 * these nodes a stub is kept, and nvdb_commit.c writes them in full. Memory holds two stubs, a
 * buffer for each stream, and a key for each root tile of 4096^3 voxels. */
#include <inttypes.h>
#include <math.h>
#include <string.h>
#include <xxhash.h>

#include "formats/material/channels.h"
#include "base/text.h"
#include "formats/grid/nvdb_writer_internal.h"

enum { PAGE_BYTES = 1 << 18 }; /* of streams */

/* ---- streams ---- */

/* Opens a stream of a section. Its page comes now, before others divide the memory. */
static int nvdb_open_stream(struct fmt_nvdb_writer *writer, int section, int half)
{
    struct nvdb_stream *stream = &writer->stream[section][half];
    uint8_t *at;
    uint64_t capacity;
    *stream = (struct nvdb_stream){.spill = &writer->spill,
                                   .number = (uint32_t)(2 * section + half),
                                   .written = XXH3_createState()};
    if (!stream->written)
        return bsq_fail(writer->ctx, BSQ_ENOMEM, "no memory for a checksum");
    XXH3_64bits_reset(stream->written);
    return bsq_spill_reserve(stream->spill, stream->number, &at, &capacity);
}

/* Appends to a stream. Hashes each page when it is full, while it is in the cache. */
static int nvdb_put(struct nvdb_stream *stream, const void *bytes, uint64_t size)
{
    const struct bsq_spill_stream *page = &stream->spill->list[stream->number];
    const uint8_t *from = bytes;
    for (uint64_t step; size > 0; from += step, size -= step) {
        const uint64_t space = PAGE_BYTES - page->fill;
        step = size < space ? size : space;
        if (step == space) {
            XXH3_64bits_update(stream->written, page->buffer, page->fill);
            XXH3_64bits_update(stream->written, from, step);
        }
        BSQ_PASS(bsq_spill_add(stream->spill, stream->number, from, step));
    }
    return 0;
}

/* Opens the streams of a section, unless the grid lacks the section or it does not grow. */
static int open_streams(struct fmt_nvdb_writer *writer, int section)
{
    const struct nvdb_row *row = &fmt_nvdb_rows[section];
    if (!row->grows || !nvdb_has(writer->counts.flags, section))
        return 0;
    int status = nvdb_open_stream(writer, section, 0);
    return status == 0 && row->per_record ? nvdb_open_stream(writer, section, 1) : status;
}

/* ---- creation ---- */

/* Counts the values of channels, if the grid has any. */
static int count_channels(struct fmt_nvdb_writer *writer)
{
    const char *list = writer->info.channels;
    if (!list)
        return 0;
    writer->counts.channel_words = fmt_channel_list_values(list, strlen(list));
    writer->counts.channel_list_bytes = (uint32_t)strlen(list);
    return writer->counts.channel_words > 0
               ? 0
               : bsq_fail(writer->ctx, BSQ_EUSAGE, "%s: \"%.60s\" cannot be channels", writer->path,
                          list);
}

/* Begins the section of channels: its head, the list, and the background's values. */
static int begin_channels(struct fmt_nvdb_writer *writer)
{
    static const uint8_t zeros[NVDB_ALIGNMENT];
    const struct nvdb_channels_head head = {writer->counts.channel_words,
                                            writer->counts.channel_list_bytes};
    const uint64_t head_bytes = nvdb_channels_head_bytes(head.list_bytes);
    struct nvdb_stream *stream = &writer->stream[NVDB_CHANNELS][0];
    if (head.words == 0)
        return 0;
    BSQ_PASS(nvdb_put(stream, &head, sizeof head));
    BSQ_PASS(nvdb_put(stream, writer->info.channels, head.list_bytes));
    BSQ_PASS(nvdb_put(stream, zeros, head_bytes - sizeof head - head.list_bytes));
    for (uint32_t i = 0; i < head.words; i++)
        BSQ_PASS(nvdb_put(stream, zeros, sizeof(float)));
    return 0;
}

/* Refuses what fmt_nvdb_check_header() would refuse later. */
static int check_info(struct bsq_ctx *ctx, const char *path, const struct fmt_nvdb_info *info)
{
    if (!(info->voxel_size > 0.0) || !isfinite(info->voxel_size) ||
        !isfinite(1.0 / info->voxel_size))
        return bsq_fail(ctx, BSQ_EUSAGE, "%s: voxel size %g is not a positive number", path,
                        info->voxel_size);
    for (int axis = 0; axis < 3; axis++)
        if (!isfinite(info->translation[axis]) || !(info->scan_min[axis] <= info->scan_max[axis]) ||
            !isfinite(info->scan_min[axis]) || !isfinite(info->scan_max[axis]))
            return bsq_fail(ctx, BSQ_EBUG, "%s: translation or scan bounds are not finite", path);
    return 0;
}

int fmt_nvdb_create(struct bsq_ctx *ctx, const char *path, const struct fmt_nvdb_info *info,
                    struct fmt_nvdb_writer **out)
{
    struct fmt_nvdb_writer *writer = NULL;
    int status;
    *out = NULL;
    BSQ_TRY(check_info(ctx, path, info));
    BSQ_TRY(BSQ_CALLOC(ctx, "grid writer", 1, &writer));
    writer->ctx = ctx;
    writer->info = *info;
    writer->counts.flags = nvdb_flags(info->has_color, info->ids, info->channels != NULL);
    fmt_nvdb_bbox_clear(writer->bbox_min, writer->bbox_max);
    BSQ_TRY(bsq_text_copy(ctx, path, &writer->path));
    BSQ_TRY(count_channels(writer));
    BSQ_TRY(fmt_nvdb_set_names(writer, NULL, 0));
    BSQ_TRY(bsq_output_open(ctx, path, &writer->output));
    BSQ_TRY(bsq_spill_init(&writer->spill, ctx, "sections of a grid", writer->path,
                           2 * NVDB_TRAILER, 2 * NVDB_TRAILER, PAGE_BYTES, 0));
    for (int section = 0; section < NVDB_TRAILER; section++)
        BSQ_TRY(open_streams(writer, section));
    BSQ_TRY(begin_channels(writer));
    writer->info.channels = NULL; /* the caller's */
    *out = writer;
    return 0;
done:
    fmt_nvdb_discard(writer);
    return status;
}

int fmt_nvdb_set_names(struct fmt_nvdb_writer *writer, const char *const *names, uint64_t count)
{
    const struct nvdb_names_head head = {writer->info.ids, (uint32_t)count};
    uint64_t bytes = sizeof head;
    if (writer->info.ids == FMT_IDS_NONE)
        return 0;
    for (uint64_t i = 0; i < count; i++)
        bytes += sizeof(uint32_t) + strlen(names[i]);
    if (bytes > UINT32_MAX)
        return bsq_fail(writer->ctx, BSQ_EUSAGE, "%s: the names of ids have 4 GiB", writer->path);
    bsq_free(writer->ctx, writer->names);
    writer->names = NULL;
    BSQ_PASS(bsq_alloc(writer->ctx, "names of ids", bytes, 1, &writer->names));
    uint8_t *to = writer->names;
    memcpy(to, &head, sizeof head);
    to += sizeof head;
    for (uint64_t i = 0; i < count; i++) {
        const uint32_t length = (uint32_t)strlen(names[i]);
        memcpy(to, &length, sizeof length);
        memcpy(to + sizeof length, names[i], length);
        to += sizeof length + length;
    }
    writer->counts.name_bytes = bytes;
    return 0;
}

void fmt_nvdb_discard(struct fmt_nvdb_writer *writer)
{
    if (!writer)
        return;
    struct bsq_ctx *ctx = writer->ctx;
    bsq_output_discard(writer->output);
    for (int i = 0; i < 2 * NVDB_TRAILER; i++)
        XXH3_freeState(writer->stream[i / 2][i % 2].written);
    bsq_spill_free(&writer->spill);
    BSQ_FREE(ctx, writer->keys, writer->names, writer->path, writer);
}

/* ---- regions ---- */

static int fail_region(struct fmt_nvdb_writer *writer, const struct fmt_nvdb_region *region,
                       const char *reason)
{
    return bsq_fail(writer->ctx, BSQ_EBUG, "%s: region %d %d %d: %s", writer->path,
                    region->origin[0], region->origin[1], region->origin[2], reason);
}

/* Returns whether the region at `origin` is the open lower node. */
static bool is_open(const struct fmt_nvdb_writer *writer, const int32_t origin[3])
{
    uint32_t count = writer->counts.uppers;
    return count > 0 && writer->keys[count - 1] == nvdb_root_key(origin) &&
           writer->last_cell == nvdb_upper_cell(origin);
}

/* Checks the order, leaves and counts of a region before anything of it is kept. */
static int check_region(struct fmt_nvdb_writer *writer, const struct fmt_nvdb_region *region)
{
    const int32_t *origin = region->origin;
    if ((origin[0] | origin[1] | origin[2]) & (NVDB_LOWER_DIM - 1))
        return fail_region(writer, region, "origin is not a multiple of 128");
    if (writer->counts.uppers) {
        uint64_t key = nvdb_root_key(origin), last = writer->keys[writer->counts.uppers - 1];
        bool before = key < last || (key == last && nvdb_upper_cell(origin) < writer->last_cell);
        if (before || (is_open(writer, origin) && region->leaf_count > 0 &&
                       region->leaf_ids[0] <= writer->last_leaf))
            return fail_region(writer, region, "out of order");
    }
    uint64_t voxels = 0, seconds = 0;
    for (uint32_t i = 0; i < region->leaf_count; i++) {
        uint32_t count = 0;
        for (int word = 0; word < 8; word++)
            count += nvdb_popcount(region->masks[i][word]);
        if (count == 0)
            return fail_region(writer, region, "leaf without voxels");
        if (region->leaf_ids[i] >= 4096 ||
            (i > 0 && region->leaf_ids[i] <= region->leaf_ids[i - 1]))
            return fail_region(writer, region, "leaf numbers are not ascending below 4096");
        voxels += count;
    }
    if (voxels != region->record_count)
        return fail_region(writer, region, "records and voxels differ in number");
    for (uint64_t i = 0; i < voxels; i++)
        seconds += (region->records[i].plane & FMT_NVDB_PLANE_SECOND) != 0;
    if (seconds != region->second_count)
        return fail_region(writer, region, "second records do not match their flags");
    return 0;
}

/* Checks limits of the format: node counts and ranks of second records have 32 bits. */
static int check_limits(struct fmt_nvdb_writer *writer, const struct fmt_nvdb_region *region)
{
    const struct nvdb_counts *counts = &writer->counts;
    const char *what = NULL;
    if ((uint64_t)counts->leaves + region->leaf_count > UINT32_MAX)
        what = "leaves of 8x8x8 voxels";
    else if (counts->lowers == UINT32_MAX && !is_open(writer, region->origin))
        what = "nodes of 128x128x128 voxels";
    else if (counts->seconds + region->second_count > UINT32_MAX)
        what = "voxels with two surfaces";
    if (!what)
        return 0;
    return bsq_fail(writer->ctx, BSQ_EUSAGE,
                    "%s: the grid has more than %" PRIu32 " %s; choose larger voxels", writer->path,
                    UINT32_MAX, what);
}

/* Writes the stub of the open lower node, and extends the boxes above it. */
static int close_lower(struct fmt_nvdb_writer *writer)
{
    const struct nvdb_stub *lower = &writer->lower;
    struct nvdb_stub *upper = &writer->upper;
    if (writer->counts.lowers == 0)
        return 0;
    fmt_nvdb_bbox_extend(upper->bbox_min, upper->bbox_max, lower->bbox_min, lower->bbox_max);
    fmt_nvdb_bbox_extend(writer->bbox_min, writer->bbox_max, lower->bbox_min, lower->bbox_max);
    return nvdb_put(writer->stream[NVDB_LOWERS], lower, nvdb_stub_bytes(&fmt_nvdb_lower));
}

/* Writes the stub of the open upper node. */
static int close_upper(struct fmt_nvdb_writer *writer)
{
    if (writer->counts.uppers == 0)
        return 0;
    return nvdb_put(writer->stream[NVDB_UPPERS], &writer->upper, nvdb_stub_bytes(&fmt_nvdb_upper));
}

/* Opens the upper node of a region unless it is open already. */
static int open_upper(struct fmt_nvdb_writer *writer, const int32_t origin[3])
{
    uint32_t count = writer->counts.uppers;
    uint64_t key = nvdb_root_key(origin);
    if (count > 0 && writer->keys[count - 1] == key)
        return 0;
    BSQ_PASS(close_upper(writer));
    BSQ_PASS(BSQ_GROW(writer->ctx, "grid root tiles", (uint64_t)count + 1, &writer->keys,
                      &writer->keys_capacity));
    writer->keys[count] = key;
    writer->counts.uppers = count + 1;
    memset(&writer->upper, 0, sizeof writer->upper);
    fmt_nvdb_bbox_clear(writer->upper.bbox_min, writer->upper.bbox_max);
    return 0;
}

/* Opens the nodes of a region unless they are open already. */
static int open_region(struct fmt_nvdb_writer *writer, const int32_t origin[3])
{
    const uint32_t cell = nvdb_upper_cell(origin);
    if (is_open(writer, origin))
        return 0;
    BSQ_PASS(close_lower(writer));
    BSQ_PASS(open_upper(writer, origin));
    writer->last_cell = cell;
    writer->upper.child_mask[cell >> 6] |= UINT64_C(1) << (cell & 63);
    memset(&writer->lower, 0, sizeof writer->lower);
    fmt_nvdb_bbox_clear(writer->lower.bbox_min, writer->lower.bbox_max);
    writer->counts.lowers++;
    return 0;
}

static void leaf_origin(const int32_t region_origin[3], uint32_t id, int32_t origin[3])
{
    origin[0] = region_origin[0] + (int32_t)(id >> 8) * NVDB_LEAF_DIM;
    origin[1] = region_origin[1] + (int32_t)(id >> 4 & 15) * NVDB_LEAF_DIM;
    origin[2] = region_origin[2] + (int32_t)(id & 15) * NVDB_LEAF_DIM;
}

/* Appends a region's leaves to the open lower node. */
static int append_leaves(struct fmt_nvdb_writer *writer, const struct fmt_nvdb_region *region)
{
    struct nvdb_stub *lower = &writer->lower;
    uint64_t value = 1 + writer->counts.voxels;
    struct nvdb_stream *leaves = writer->stream[NVDB_LEAVES];
    for (uint32_t i = 0; i < region->leaf_count; i++) {
        struct nvdb_leaf leaf = {.flags = NVDB_NODE_HAS_BBOX, .offset = value};
        int32_t origin[3], bbox_max[3];
        leaf_origin(region->origin, region->leaf_ids[i], origin);
        uint32_t count = fmt_nvdb_leaf_bounds(origin, region->masks[i], leaf.bbox_min, bbox_max);
        for (int axis = 0; axis < 3; axis++)
            leaf.bbox_dif[axis] = (uint8_t)(bbox_max[axis] - leaf.bbox_min[axis]);
        memcpy(leaf.mask, region->masks[i], sizeof(leaf.mask));
        leaf.prefix_sum = fmt_nvdb_prefix_sum(leaf.mask);
        BSQ_PASS(nvdb_put(leaves, &leaf, sizeof leaf));
        value += count;
        fmt_nvdb_bbox_extend(lower->bbox_min, lower->bbox_max, leaf.bbox_min, bbox_max);
        lower->child_mask[region->leaf_ids[i] >> 6] |= UINT64_C(1) << (region->leaf_ids[i] & 63);
    }
    writer->last_leaf = region->leaf_ids[region->leaf_count - 1];
    return 0;
}

/* Appends a member of records, at byte `member` of each, to a stream. */
static int append_channel(struct nvdb_stream *stream, const struct fmt_nvdb_record *records,
                          uint64_t count, size_t member)
{
    uint32_t some[512];
    for (uint64_t done = 0, n; done < count; done += n) {
        n = count - done < 512 ? count - done : 512;
        for (uint64_t i = 0; i < n; i++)
            memcpy(&some[i], (const uint8_t *)&records[done + i] + member, sizeof *some);
        BSQ_PASS(nvdb_put(stream, some, n * sizeof *some));
    }
    return 0;
}

/* Splits first or second records into channels. values: those of further channels. */
static int nvdb_append_records(struct fmt_nvdb_writer *writer, bool second,
                               const struct fmt_nvdb_record *records, const float *values,
                               uint64_t count)
{
    static const struct {
        enum nvdb_section section;
        size_t member;
    } members[] = {{NVDB_NORMALS, offsetof(struct fmt_nvdb_record, normal)},
                   {NVDB_PLANES, offsetof(struct fmt_nvdb_record, plane)},
                   {NVDB_COLORS, offsetof(struct fmt_nvdb_record, color)},
                   {NVDB_IDS, offsetof(struct fmt_nvdb_record, id)}};
    for (size_t i = 0; i < sizeof members / sizeof *members; i++) {
        struct nvdb_stream *stream = &writer->stream[members[i].section][second];
        if (stream->spill)
            BSQ_PASS(append_channel(stream, records, count, members[i].member));
    }
    if (values)
        return nvdb_put(&writer->stream[NVDB_CHANNELS][second], values,
                        count * writer->counts.channel_words * sizeof *values);
    return 0;
}

/* Writes the open entry of section NVDB_SECONDS. */
static int end_entry(struct fmt_nvdb_writer *writer)
{
    const uint32_t entry[2] = {writer->entry_bits, writer->entry_rank};
    writer->entry_rank += nvdb_popcount(writer->entry_bits);
    writer->entry_bits = 0;
    return nvdb_put(writer->stream[NVDB_SECONDS], entry, sizeof entry);
}

/* Returns a bit for each of up to 32 records: whether its voxel has a second one. */
static uint32_t second_bits(const struct fmt_nvdb_record *records, uint32_t count)
{
    uint32_t bits = 0;
    for (uint32_t i = 0; i < count; i++)
        bits |= (uint32_t)((records[i].plane & FMT_NVDB_PLANE_SECOND) != 0) << i;
    return bits;
}

/* Sets the bits of voxels that have second records. */
static int append_seconds(struct fmt_nvdb_writer *writer, const struct fmt_nvdb_region *region)
{
    const uint64_t first = 1 + writer->counts.voxels;
    for (uint64_t done = 0; done < region->record_count;) {
        const uint32_t bit = (uint32_t)((first + done) % 32);
        const uint64_t left = region->record_count - done;
        const uint32_t count = left < 32 - bit ? (uint32_t)left : 32 - bit;
        BSQ_PASS(bit == 0 ? end_entry(writer) : 0);
        writer->entry_bits |= second_bits(region->records + done, count) << bit;
        done += count;
    }
    return 0;
}

static int nvdb_append_region(struct fmt_nvdb_writer *writer, const struct fmt_nvdb_region *region)
{
    static const struct fmt_nvdb_record background = {0};
    const bool channels = writer->counts.channel_words > 0;
    BSQ_PASS(bsq_check(writer->ctx));
    BSQ_PASS(check_region(writer, region));
    if (region->leaf_count == 0)
        return 0;
    BSQ_PASS(check_limits(writer, region));
    if (writer->counts.voxels == 0)
        BSQ_PASS(nvdb_append_records(writer, false, &background, NULL, 1));
    BSQ_PASS(open_region(writer, region->origin));
    BSQ_PASS(append_leaves(writer, region));
    BSQ_PASS(nvdb_append_records(writer, false, region->records, channels ? region->channels : NULL,
                                 region->record_count));
    BSQ_PASS(nvdb_append_records(writer, true, region->second,
                                 channels ? region->second_channels : NULL, region->second_count));
    BSQ_PASS(append_seconds(writer, region));
    writer->counts.leaves += region->leaf_count;
    writer->counts.voxels += region->record_count;
    writer->counts.seconds += region->second_count;
    return 0;
}

int fmt_nvdb_append(struct fmt_nvdb_writer *writer, const struct fmt_nvdb_region *region)
{
    if (writer->failed == 0)
        writer->failed = nvdb_append_region(writer, region);
    return writer->failed;
}

int fmt_nvdb_writer_finish(struct fmt_nvdb_writer *writer)
{
    BSQ_PASS(writer->failed);
    if (writer->counts.voxels == 0)
        return bsq_fail(writer->ctx, BSQ_EDATA, "%s: the grid has no voxels", writer->path);
    BSQ_PASS(end_entry(writer));
    BSQ_PASS(close_lower(writer));
    BSQ_PASS(close_upper(writer));
    for (int i = 0; i < 2 * NVDB_TRAILER; i++)
        if (writer->stream[i / 2][i % 2].spill)
            XXH3_64bits_update(writer->stream[i / 2][i % 2].written, writer->spill.list[i].buffer,
                               writer->spill.list[i].fill);
    return bsq_spill_evict(&writer->spill, true);
}
