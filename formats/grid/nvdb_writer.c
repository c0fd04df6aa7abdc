/* nvdb_writer.c - takes a grid region by region and keeps its sections in temporary files.
 *
 * Regions come in the file's order, so each leaf, value index and prefix sum is final when it is
 * appended. Only the tables of internal nodes need totals: they hold distances between sections. Of
 * these nodes a stub is kept, and nvdb_commit.c writes them in full. Memory holds two stubs, a
 * buffer for each stream, and a key for each root tile of 4096^3 voxels. */
#include <inttypes.h>
#include <math.h>
#include <string.h>

#include "base/channels.h"
#include "formats/grid/nvdb_writer_internal.h"

/* ---- creation ---- */

static const char *const stream_names[STREAM_COUNT] = {
    "grid upper nodes",
    "grid lower nodes",
    "grid leaves",
    "grid normals",
    "grid planes",
    "grid colours",
    "grid second normals",
    "grid second planes",
    "grid second colours",
    "grid second words",
    "grid ids",
    "grid second ids",
    "grid channels",
    "grid second channels",
};

static bool stream_used(const struct fmt_nvdb_writer *writer, int stream)
{
    bool color = stream == STREAM_COLORS || stream == STREAM_SECOND_COLORS;
    bool id = stream == STREAM_IDS || stream == STREAM_SECOND_IDS;
    bool channels = stream == STREAM_CHANNELS || stream == STREAM_SECOND_CHANNELS;
    return color      ? writer->info.has_color
           : id       ? writer->info.ids != BSQ_IDS_NONE
           : channels ? writer->counts.channel_words > 0
                      : true;
}

/* Counts the values of channels, if the grid has any. */
static int count_channels(struct fmt_nvdb_writer *writer)
{
    const char *list = writer->info.channels;
    if (!list)
        return 0;
    writer->counts.channel_words = bsq_channel_list_values(list, strlen(list));
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
    struct nvdb_stream *stream = &writer->stream[STREAM_CHANNELS];
    if (head.words == 0)
        return 0;
    int status = fmt_nvdb_stream_put(stream, &head, sizeof head);
    if (status == 0)
        status = fmt_nvdb_stream_put(stream, writer->info.channels, head.list_bytes);
    if (status == 0)
        status = fmt_nvdb_stream_put(stream, zeros,
                                     nvdb_channels_head_bytes(head.list_bytes) - sizeof head -
                                         head.list_bytes);
    for (uint32_t i = 0; i < head.words && status == 0; i++)
        status = fmt_nvdb_stream_put(stream, zeros, sizeof(float));
    return status;
}

/* Refuses what fmt_nvdb_check_header() would refuse later. */
static int check_info(struct bsq_ctx *ctx, const char *path, const struct fmt_nvdb_info *info)
{
    if (info->type != FMT_NVDB_MASK && info->type != FMT_NVDB_ONINDEX)
        return bsq_fail(ctx, BSQ_EBUG, "%s: grid type %d cannot be written", path, info->type);
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
    *out = NULL;
    struct fmt_nvdb_writer *writer;
    int status = check_info(ctx, path, info);
    if (status)
        return status;
    status = bsq_calloc(ctx, "grid writer", 1, sizeof(*writer), &writer);
    if (status)
        return status;
    writer->ctx = ctx;
    writer->info = *info;
    writer->counts.type = info->type;
    writer->counts.has_color = info->has_color;
    writer->counts.has_ids = info->ids != BSQ_IDS_NONE;
    fmt_nvdb_bbox_clear(writer->bbox_min, writer->bbox_max);
    uint64_t path_bytes = strlen(path) + 1;
    status = bsq_alloc(ctx, "grid writer", path_bytes, 1, &writer->path);
    if (status)
        goto failed;
    memcpy(writer->path, path, path_bytes);
    status = count_channels(writer);
    if (status)
        goto failed;
    status = bsq_calloc(ctx, "grid upper node", 1, sizeof(*writer->upper), &writer->upper);
    if (status)
        goto failed;
    status = fmt_nvdb_set_names(writer, NULL, 0);
    if (status)
        goto failed;
    status = bsq_output_open(ctx, path, &writer->output);
    for (int i = 0; i < STREAM_COUNT && status == 0; i++) {
        if (stream_used(writer, i))
            status = fmt_nvdb_stream_open(ctx, path, stream_names[i], &writer->stream[i]);
    }
    if (status == 0)
        status = begin_channels(writer);
    writer->info.channels = NULL; /* the caller's */
    if (status)
        goto failed;
    *out = writer;
    return 0;
failed:
    fmt_nvdb_discard(writer);
    return status;
}

void fmt_nvdb_discard(struct fmt_nvdb_writer *writer)
{
    if (!writer)
        return;
    struct bsq_ctx *ctx = writer->ctx;
    bsq_output_discard(writer->output);
    for (int i = 0; i < STREAM_COUNT; i++)
        fmt_nvdb_stream_close(&writer->stream[i]);
    bsq_free(ctx, writer->keys);
    bsq_free(ctx, writer->names);
    bsq_free(ctx, writer->upper);
    bsq_free(ctx, writer->path);
    bsq_free(ctx, writer);
}

struct nvdb_section_streams fmt_nvdb_streams_of(struct fmt_nvdb_writer *writer, int section)
{
    static const struct {
        enum nvdb_section section;
        enum nvdb_writer_stream first, second; /* second: STREAM_COUNT if there is none */
    } rows[] = {
        {NVDB_LEAVES, STREAM_LEAVES, STREAM_COUNT},
        {NVDB_NORMALS, STREAM_NORMALS, STREAM_SECOND_NORMALS},
        {NVDB_PLANES, STREAM_PLANES, STREAM_SECOND_PLANES},
        {NVDB_COLORS, STREAM_COLORS, STREAM_SECOND_COLORS},
        {NVDB_IDS, STREAM_IDS, STREAM_SECOND_IDS},
        {NVDB_CHANNELS, STREAM_CHANNELS, STREAM_SECOND_CHANNELS},
        {NVDB_SECONDS, STREAM_SECOND_WORDS, STREAM_COUNT},
    };
    struct nvdb_stream *stream = writer->stream;
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++)
        if ((int)rows[i].section == section && stream_used(writer, rows[i].first))
            return (struct nvdb_section_streams){
                &stream[rows[i].first],
                rows[i].second == STREAM_COUNT ? NULL : &stream[rows[i].second]};
    return (struct nvdb_section_streams){0};
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
           writer->last_slot == nvdb_upper_slot(origin);
}

/* Checks the order, leaves and counts of a region before anything of it is kept. */
static int check_region(struct fmt_nvdb_writer *writer, const struct fmt_nvdb_region *region)
{
    const int32_t *origin = region->origin;
    if ((origin[0] | origin[1] | origin[2]) & (NVDB_LOWER_DIM - 1))
        return fail_region(writer, region, "origin is not a multiple of 128");
    if (writer->counts.uppers) {
        uint64_t key = nvdb_root_key(origin), last = writer->keys[writer->counts.uppers - 1];
        bool before = key < last || (key == last && nvdb_upper_slot(origin) < writer->last_slot);
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
    const struct nvdb_lower_stub *lower = &writer->lower;
    struct nvdb_upper_stub *upper = writer->upper;
    if (writer->counts.lowers == 0)
        return 0;
    fmt_nvdb_bbox_extend(upper->bbox_min, upper->bbox_max, lower->bbox_min, lower->bbox_max);
    fmt_nvdb_bbox_extend(writer->bbox_min, writer->bbox_max, lower->bbox_min, lower->bbox_max);
    return fmt_nvdb_stream_put(&writer->stream[STREAM_LOWERS], lower, sizeof(*lower));
}

/* Writes the stub of the open upper node. */
static int close_upper(struct fmt_nvdb_writer *writer)
{
    if (writer->counts.uppers == 0)
        return 0;
    return fmt_nvdb_stream_put(&writer->stream[STREAM_UPPERS], writer->upper,
                               sizeof(*writer->upper));
}

/* Opens the upper node of a region unless it is open already. */
static int open_upper(struct fmt_nvdb_writer *writer, const int32_t origin[3])
{
    uint32_t count = writer->counts.uppers;
    uint64_t key = nvdb_root_key(origin);
    if (count > 0 && writer->keys[count - 1] == key)
        return 0;
    int status = close_upper(writer);
    if (status)
        return status;
    status = bsq_grow(writer->ctx, "grid root tiles", (uint64_t)count + 1, sizeof(*writer->keys),
                      &writer->keys, &writer->keys_capacity);
    if (status)
        return status;
    writer->keys[count] = key;
    writer->counts.uppers = count + 1;
    memset(writer->upper, 0, sizeof(*writer->upper));
    fmt_nvdb_bbox_clear(writer->upper->bbox_min, writer->upper->bbox_max);
    return 0;
}

/* Opens the nodes of a region unless they are open already. */
static int open_region(struct fmt_nvdb_writer *writer, const int32_t origin[3])
{
    if (is_open(writer, origin))
        return 0;
    int status = close_lower(writer);
    if (status == 0)
        status = open_upper(writer, origin);
    if (status)
        return status;
    uint32_t slot = nvdb_upper_slot(origin);
    writer->last_slot = slot;
    writer->upper->child_mask[slot >> 6] |= UINT64_C(1) << (slot & 63);
    memset(&writer->lower, 0, sizeof(writer->lower));
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
    struct nvdb_lower_stub *lower = &writer->lower;
    uint64_t value = 1 + writer->counts.voxels;
    struct nvdb_stream *leaves = &writer->stream[STREAM_LEAVES];
    for (uint32_t i = 0; i < region->leaf_count; i++) {
        struct nvdb_leaf *leaf;
        int status = fmt_nvdb_stream_reserve(leaves, sizeof(*leaf), &leaf);
        if (status)
            return status;
        int32_t origin[3], bbox_max[3];
        leaf_origin(region->origin, region->leaf_ids[i], origin);
        uint32_t count = fmt_nvdb_leaf_bounds(origin, region->masks[i], leaf->bbox_min, bbox_max);
        for (int axis = 0; axis < 3; axis++)
            leaf->bbox_dif[axis] = (uint8_t)(bbox_max[axis] - leaf->bbox_min[axis]);
        leaf->flags = NVDB_NODE_HAS_BBOX;
        memcpy(leaf->mask, region->masks[i], sizeof(leaf->mask));
        leaf->offset = value;
        leaf->prefix_sum = fmt_nvdb_prefix_sum(leaf->mask);
        leaves->fill += sizeof(*leaf);
        value += count;
        fmt_nvdb_bbox_extend(lower->bbox_min, lower->bbox_max, leaf->bbox_min, bbox_max);
        lower->child_mask[region->leaf_ids[i] >> 6] |= UINT64_C(1) << (region->leaf_ids[i] & 63);
    }
    writer->last_leaf = region->leaf_ids[region->leaf_count - 1];
    return 0;
}

/* Appends a member of records, at byte `member` of each, to a stream. */
static int append_channel(struct nvdb_stream *stream, const struct fmt_nvdb_record *records,
                          uint64_t count, size_t member)
{
    const uint64_t most = NVDB_STREAM_BYTES / sizeof(uint32_t);
    for (uint64_t done = 0; done < count;) {
        uint64_t n = count - done < most ? count - done : most;
        uint32_t *to;
        int status = fmt_nvdb_stream_reserve(stream, n * sizeof *to, &to);
        if (status)
            return status;
        stream->fill += n * sizeof *to;
        for (uint64_t i = 0; i < n; i++)
            memcpy(&to[i], (const uint8_t *)&records[done + i] + member, sizeof *to);
        done += n;
    }
    return 0;
}

/* Splits records into channels: first or second records. */
static int append_records(struct fmt_nvdb_writer *writer, bool second,
                          const struct fmt_nvdb_record *records, uint64_t count)
{
    static const struct {
        enum nvdb_writer_stream first, second;
        size_t member;
    } channels[] = {
        {STREAM_NORMALS, STREAM_SECOND_NORMALS, offsetof(struct fmt_nvdb_record, normal)},
        {STREAM_PLANES, STREAM_SECOND_PLANES, offsetof(struct fmt_nvdb_record, plane)},
        {STREAM_COLORS, STREAM_SECOND_COLORS, offsetof(struct fmt_nvdb_record, color)},
        {STREAM_IDS, STREAM_SECOND_IDS, offsetof(struct fmt_nvdb_record, id)},
    };
    int status = 0;
    for (size_t c = 0; c < sizeof channels / sizeof *channels && status == 0; c++) {
        const enum nvdb_writer_stream stream = second ? channels[c].second : channels[c].first;
        if (stream_used(writer, stream))
            status = append_channel(&writer->stream[stream], records, count, channels[c].member);
    }
    return status;
}

/* Appends the channels of a region. */
static int append_channels(struct fmt_nvdb_writer *writer, const struct fmt_nvdb_region *region)
{
    const uint64_t bytes = writer->counts.channel_words * sizeof *region->channels;
    if (bytes == 0)
        return 0;
    int status = fmt_nvdb_stream_put(&writer->stream[STREAM_CHANNELS], region->channels,
                                     region->record_count * bytes);
    return status ? status
                  : fmt_nvdb_stream_put(&writer->stream[STREAM_SECOND_CHANNELS],
                                        region->second_channels, region->second_count * bytes);
}

/* Writes the open entry of section NVDB_SECONDS. */
static int end_entry(struct fmt_nvdb_writer *writer)
{
    uint32_t *entry;
    struct nvdb_stream *stream = &writer->stream[STREAM_SECOND_WORDS];
    int status = fmt_nvdb_stream_reserve(stream, 8, &entry);
    if (status)
        return status;
    entry[0] = writer->entry_bits;
    entry[1] = writer->entry_rank;
    stream->fill += 8;
    writer->entry_rank += nvdb_popcount(writer->entry_bits);
    writer->entry_bits = 0;
    return 0;
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
        int status = bit == 0 ? end_entry(writer) : 0;
        if (status)
            return status;
        writer->entry_bits |= second_bits(region->records + done, count) << bit;
        done += count;
    }
    return 0;
}

static int append(struct fmt_nvdb_writer *writer, const struct fmt_nvdb_region *region)
{
    static const struct fmt_nvdb_record background = {0};
    int status = bsq_check(writer->ctx);
    if (status == 0)
        status = check_region(writer, region);
    if (status || region->leaf_count == 0)
        return status;
    status = check_limits(writer, region);
    if (status == 0 && writer->counts.voxels == 0)
        status = append_records(writer, false, &background, 1);
    if (status == 0)
        status = open_region(writer, region->origin);
    if (status == 0)
        status = append_leaves(writer, region);
    if (status == 0)
        status = append_records(writer, false, region->records, region->record_count);
    if (status == 0)
        status = append_records(writer, true, region->second, region->second_count);
    if (status == 0)
        status = append_channels(writer, region);
    if (status == 0)
        status = append_seconds(writer, region);
    writer->counts.leaves += region->leaf_count;
    writer->counts.voxels += region->record_count;
    writer->counts.seconds += region->second_count;
    return status;
}

int fmt_nvdb_append(struct fmt_nvdb_writer *writer, const struct fmt_nvdb_region *region)
{
    if (writer->failed == 0)
        writer->failed = append(writer, region);
    return writer->failed;
}

int fmt_nvdb_writer_finish(struct fmt_nvdb_writer *writer)
{
    int status = writer->failed;
    if (status)
        return status;
    if (writer->counts.voxels == 0)
        return bsq_fail(writer->ctx, BSQ_EDATA, "%s: the grid has no voxels", writer->path);
    status = end_entry(writer);
    if (status == 0)
        status = close_lower(writer);
    if (status == 0)
        status = close_upper(writer);
    for (int i = 0; i < STREAM_COUNT && status == 0; i++)
        if (stream_used(writer, i))
            status = fmt_nvdb_stream_end(&writer->stream[i]);
    return status;
}
