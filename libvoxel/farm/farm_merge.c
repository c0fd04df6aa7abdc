/* farm_merge.c - reads part files: the regions of all parts in the order of the grid.
 *
 * Each part has its regions in this order. Their tables are read first and merged, so that parts
 * need not be open at the same time. Regions are read in batches of whole leaves, while the batch
 * before is appended to the grid. */
#include <string.h>
#include <xxhash.h>

#include "base/parallel.h"
#include "base/sort_array.h"
#include "libvoxel/farm/farm_part.h"
#include "libvoxel/voxelize/plan/plan.h"

/* OPEN_PARTS: files that are open at a time. */
enum { BATCHES = 3, LEAVES = 4096, OPEN_PARTS = 64 };

/* A region of any part. */
struct item {
    struct vox_region_key key;
    uint32_t task;
    uint64_t offset; /* in the part */
    struct vox_part_entry entry;
};

struct open_part {
    uint32_t task;
    bool is_open;
    struct bsq_file file;
};

struct vox_parts {
    const struct vox_farm_plan *plan;
    uint32_t flags; /* VOX_PART_COLORS and so on */
    struct item *items;
    uint64_t count, capacity;
    struct open_part open[OPEN_PARTS];
};

/* ---- tables ---- */

static int fail_part(const struct vox_farm_plan *plan, const struct bsq_file *file,
                     const char *what)
{
    return fmt_farm_fail_part(&plan->base, file, what);
}

/* Checks that a part has the regions that the plan gives to its task, in order, and that they fill
 * the file. */
static int check_entries(const struct vox_farm_plan *plan, const struct vox_part_header *header,
                         const struct vox_part_entry *entries, const struct bsq_file *file)
{
    const uint64_t table = header->region_count * sizeof *entries;
    uint64_t left = file->size - sizeof *header - table, leaves = 0, voxels = 0, seconds = 0;
    bool good = true;
    for (uint64_t i = 0; i < header->region_count && good; i++) {
        const struct vox_part_entry *entry = &entries[i];
        const int32_t *o = entry->origin;
        good = ((o[0] | o[1] | o[2]) & (VOX_REGION_SIZE - 1)) == 0 &&
               vox_farm_task_of(plan, o) == header->head.task &&
               (i == 0 ||
                vox_region_before(vox_region_key_of(entry[-1].origin), vox_region_key_of(o)));
        good =
            good && entry->leaf_count >= 1 && entry->leaf_count <= LEAVES && entry->bytes <= left;
        left -= good ? entry->bytes : 0;
        leaves += entry->leaf_count;
        voxels += entry->voxels;
        seconds += entry->seconds;
    }
    good = good && left == 0 && leaves == header->leaves && voxels == header->voxels &&
           seconds == header->seconds &&
           header->region_count <= plan->costs[header->head.task].regions;
    return good ? 0 : fail_part(plan, file, "damaged table of regions");
}

/* Opens a part and reads its table, which the caller frees. Close *file also after a failure. */
static int open_part(const struct vox_farm_plan *plan, uint32_t task,
                     struct vox_part_header *header, struct vox_part_entry **entries,
                     struct bsq_file *file)
{
    struct bsq_ctx *ctx = plan->base.ctx;
    *entries = NULL;
    int status = fmt_farm_part_open(&plan->base, task, header, sizeof *header, file);
    if (status < 0)
        return status;
    if (header->head.own & ~(uint32_t)(VOX_PART_COLORS | VOX_PART_IDS | VOX_PART_CHANNELS) ||
        (!(header->head.own & VOX_PART_CHANNELS)) != (vox_channel_values(&plan->options) == 0))
        return fail_part(plan, file, "damaged header");
    if (header->region_count > (file->size - sizeof *header) / sizeof **entries)
        return fail_part(plan, file, "damaged: its size is wrong");
    const uint64_t bytes = header->region_count * sizeof **entries;
    status = bsq_alloc(ctx, "regions of a part", header->region_count, sizeof **entries, entries);
    if (status == 0)
        status = bsq_file_read(ctx, file, *entries, bytes, file->size - bytes);
    if (status == 0 && XXH3_64bits(*entries, bytes) != header->table_checksum)
        status = fail_part(plan, file, "damaged table of regions");
    return status < 0 ? status : check_entries(plan, header, *entries, file);
}

static void widen(struct vox_part_totals *totals, const struct vox_part_header *header)
{
    for (int a = 0; a < 3 && header->voxels > 0; a++) {
        if (header->index_min[a] < totals->index_min[a])
            totals->index_min[a] = header->index_min[a];
        if (header->index_max[a] > totals->index_max[a])
            totals->index_max[a] = header->index_max[a];
    }
    totals->regions += header->region_count;
    totals->leaves += header->leaves;
    totals->voxels += header->voxels;
    totals->second_records += header->seconds;
}

struct listing {
    struct vox_parts *parts;
    struct vox_part_totals *totals;
};

/* Adds the regions of a part to the list. */
static int list_part(void *arg, uint32_t task)
{
    struct listing *listing = arg;
    struct vox_parts *parts = listing->parts;
    struct bsq_ctx *ctx = parts->plan->base.ctx;
    struct vox_part_header header;
    struct vox_part_entry *entries;
    struct bsq_file file;
    int status = open_part(parts->plan, task, &header, &entries, &file);
    if (status == 0 && header.head.own != parts->flags)
        status = fail_part(parts->plan, &file, "its records have other colours or ids");
    if (status == 0)
        status = bsq_grow(ctx, "regions of parts", parts->count + header.region_count,
                          sizeof *parts->items, &parts->items, &parts->capacity);
    uint64_t offset = sizeof header;
    for (uint64_t i = 0; status == 0 && entries && i < header.region_count; i++) {
        parts->items[parts->count++] = (struct item){.key = vox_region_key_of(entries[i].origin),
                                                     .task = task,
                                                     .offset = offset,
                                                     .entry = entries[i]};
        offset += entries[i].bytes;
    }
    if (status == 0)
        widen(listing->totals, &header);
    bsq_free(ctx, entries);
    bsq_file_close(ctx, &file);
    return status;
}

static int compare_items(const void *a, const void *b)
{
    const struct item *x = a, *y = b;
    return vox_region_before(x->key, y->key) ? -1 : 1; /* a region is in one part only */
}

/* Returns in how many tiles the regions lie, which are sorted. */
static uint64_t count_tiles(const struct vox_parts *parts)
{
    uint64_t tiles = 0;
    for (uint64_t i = 0; i < parts->count; i++)
        tiles += i == 0 || parts->items[i].key.tile != parts->items[i - 1].key.tile;
    return tiles;
}

int vox_parts_open(const struct vox_farm_plan *plan, bool has_color, bool has_ids,
                   struct vox_part_totals *totals, struct vox_parts **out)
{
    struct vox_parts *parts;
    *totals = (struct vox_part_totals){.index_min = {INT32_MAX, INT32_MAX, INT32_MAX},
                                       .index_max = {INT32_MIN, INT32_MIN, INT32_MIN}};
    *out = NULL;
    int status = bsq_calloc(plan->base.ctx, "parts", 1, sizeof *parts, &parts);
    if (status < 0)
        return status;
    *out = parts;
    parts->plan = plan;
    parts->flags = vox_part_flags(plan, has_color, has_ids);
    struct listing listing = {parts, totals};
    const struct fmt_farm_part_steps steps = {.arg = &listing, .check = list_part};
    status = fmt_farm_parts_check(&plan->base, &steps);
    if (status == 0)
        bsq_sort(parts->items, parts->count, sizeof *parts->items, compare_items);
    totals->tiles = count_tiles(parts);
    return status;
}

static void close_files(struct vox_parts *parts)
{
    for (unsigned i = 0; i < OPEN_PARTS; i++)
        if (parts->open[i].is_open)
            bsq_file_close(parts->plan->base.ctx, &parts->open[i].file);
}

void vox_parts_close(struct vox_parts *parts)
{
    if (!parts)
        return;
    struct bsq_ctx *ctx = parts->plan->base.ctx;
    close_files(parts);
    bsq_free(ctx, parts->items);
    bsq_free(ctx, parts);
}

/* Sets *out to the open part of a task, which stays open until another one needs its place. */
static int find_file(struct vox_parts *parts, uint32_t task, const struct bsq_file **out)
{
    struct bsq_ctx *ctx = parts->plan->base.ctx;
    struct open_part *open = &parts->open[task % OPEN_PARTS];
    struct vox_part_header header;
    int status = 0;
    if (open->is_open && open->task != task) {
        bsq_file_close(ctx, &open->file);
        open->is_open = false;
    }
    if (!open->is_open) {
        status = fmt_farm_part_open(&parts->plan->base, task, &header, sizeof header, &open->file);
        open->is_open = true; /* to be closed also after a failure */
        open->task = task;
    }
    *out = &open->file;
    return status;
}

/* ---- batches ---- */

/* Leaves of one region. */
struct batch {
    struct fmt_nvdb_region region;
    uint8_t *bytes; /* batch_bytes */
    uint16_t *ids;  /* LEAVES */
    uint64_t (*masks)[8];
    struct fmt_nvdb_record *records, *second; /* as many as batch_bytes can hold */
    float *channels, *second_channels;        /* likewise, each with channel_values */
};

struct reading {
    struct vox_parts *parts;
    int (*append)(void *arg, const struct fmt_nvdb_region *region);
    void *arg;
    struct batch batches[BATCHES];
    uint64_t batch_bytes;
    uint32_t words, channel_values; /* of a record */
    /* Where reading is: the region, its bytes, leaves and records so far, its last leaf. */
    uint64_t item, done, leaves, voxels, seconds;
    uint32_t last_leaf;
    XXH3_state_t *hash;
};

/* Takes the numbers of records. Returns how many have a second one. */
static uint32_t take_records(const struct reading *reading, const uint8_t *bytes,
                             struct fmt_nvdb_record *records, float *channels, uint32_t count)
{
    const uint32_t flags = reading->parts->flags, words = reading->words;
    const uint32_t values = reading->channel_values;
    const uint32_t *from = (const uint32_t *)bytes;
    uint32_t seconds = 0;
    for (uint32_t i = 0; i < count; i++, from += words) {
        unsigned at = 2;
        records[i] = (struct fmt_nvdb_record){.normal = from[0], .plane = from[1]};
        seconds += (from[1] & FMT_NVDB_PLANE_SECOND) != 0;
        if (flags & VOX_PART_COLORS)
            records[i].color = from[at++];
        if (flags & VOX_PART_IDS)
            records[i].id = from[at++];
        if (values > 0)
            memcpy(channels + (uint64_t)i * values, from + at, values * sizeof *channels);
    }
    return seconds;
}

/* Takes the next leaf from at most `size` bytes. Returns its bytes, 0 if it is longer, and
 * UINT64_MAX if it is damaged. */
static uint64_t take_leaf(struct reading *reading, struct batch *batch, const uint8_t *bytes,
                          uint64_t size)
{
    const uint64_t values = reading->channel_values;
    struct fmt_nvdb_region *region = &batch->region;
    struct vox_part_leaf leaf;
    if (size < sizeof leaf)
        return 0;
    memcpy(&leaf, bytes, sizeof leaf);
    const uint32_t voxels = vox_part_voxels(&leaf);
    const uint64_t record = reading->words * sizeof(uint32_t);
    if (voxels == 0 || leaf.second_count > voxels || leaf.number >= LEAVES ||
        (reading->leaves + region->leaf_count > 0 && leaf.number <= reading->last_leaf))
        return UINT64_MAX;
    const uint64_t needed = sizeof leaf + (voxels + leaf.second_count) * record;
    if (size < needed)
        return 0;
    struct fmt_nvdb_record *records = batch->records + region->record_count;
    const uint32_t seconds =
        take_records(reading, bytes + sizeof leaf, records,
                     values > 0 ? batch->channels + region->record_count * values : NULL, voxels);
    take_records(reading, bytes + sizeof leaf + voxels * record,
                 batch->second + region->second_count,
                 values > 0 ? batch->second_channels + region->second_count * values : NULL,
                 leaf.second_count);
    if (seconds != leaf.second_count)
        return UINT64_MAX;
    batch->ids[region->leaf_count] = (uint16_t)leaf.number;
    memcpy(batch->masks[region->leaf_count++], leaf.mask, sizeof leaf.mask);
    region->record_count += voxels;
    region->second_count += seconds;
    reading->last_leaf = leaf.number;
    return needed;
}

/* Begins a batch of the region at hand. */
static void begin_batch(const struct reading *reading, struct batch *batch)
{
    batch->region = (struct fmt_nvdb_region){.leaf_ids = batch->ids,
                                             .masks = (const uint64_t(*)[8])batch->masks,
                                             .records = batch->records,
                                             .second = batch->second,
                                             .channels = batch->channels,
                                             .second_channels = batch->second_channels};
    memcpy(batch->region.origin, reading->parts->items[reading->item].entry.origin,
           sizeof batch->region.origin);
}

/* Checks a region whose bytes are all read, and goes to the next one. */
static bool end_region(struct reading *reading)
{
    const struct vox_part_entry *entry = &reading->parts->items[reading->item].entry;
    const bool good = reading->leaves == entry->leaf_count && reading->voxels == entry->voxels &&
                      reading->seconds == entry->seconds &&
                      XXH3_64bits_digest(reading->hash) == entry->checksum;
    reading->item++;
    reading->done = reading->leaves = reading->voxels = reading->seconds = 0;
    return good;
}

/* Takes all whole leaves of a batch's bytes. Returns the bytes taken; 0 if they are damaged. */
static uint64_t take_leaves(struct reading *reading, struct batch *batch, uint64_t size)
{
    uint64_t taken = 0;
    while (taken < size && batch->region.leaf_count < LEAVES) {
        const uint64_t bytes = take_leaf(reading, batch, batch->bytes + taken, size - taken);
        if (bytes == UINT64_MAX)
            return 0;
        if (bytes == 0)
            break;
        taken += bytes;
    }
    return taken;
}

static int read_batch(void *arg, void *slot, uint64_t sequence)
{
    struct reading *reading = arg;
    struct batch *batch = *(struct batch **)slot = &reading->batches[sequence % BATCHES];
    const struct vox_parts *parts = reading->parts;
    const struct bsq_file *file;
    if (reading->item == parts->count)
        return 0;
    const struct item *item = &parts->items[reading->item];
    const uint64_t left = item->entry.bytes - reading->done;
    const uint64_t size = left < reading->batch_bytes ? left : reading->batch_bytes;
    int status = find_file(reading->parts, item->task, &file);
    if (status == 0)
        status = bsq_file_read(parts->plan->base.ctx, file, batch->bytes, size,
                               item->offset + reading->done);
    if (status < 0)
        return status;
    if (reading->done == 0)
        XXH3_64bits_reset(reading->hash);
    begin_batch(reading, batch);
    const uint64_t taken = take_leaves(reading, batch, size);
    XXH3_64bits_update(reading->hash, batch->bytes, taken);
    reading->done += taken;
    reading->leaves += batch->region.leaf_count;
    reading->voxels += batch->region.record_count;
    reading->seconds += batch->region.second_count;
    if (taken == 0 || (reading->done == item->entry.bytes && !end_region(reading)))
        return fail_part(parts->plan, file, "damaged voxels");
    return 1;
}

static int append_batch(void *arg, void *slot, uint64_t sequence)
{
    const struct reading *reading = arg;
    const struct batch *batch = *(struct batch *const *)slot;
    (void)sequence;
    bsq_progress_add(reading->parts->plan->base.ctx, batch->region.record_count);
    return reading->append(reading->arg, &batch->region);
}

static int make_batches(struct reading *reading)
{
    struct bsq_ctx *ctx = reading->parts->plan->base.ctx;
    const struct vox_parts *parts = reading->parts;
    int status = 0;
    reading->words = vox_part_words(parts->plan, parts->flags);
    reading->channel_values = vox_channel_values(&parts->plan->options);
    reading->batch_bytes = vox_part_buffer_bytes(reading->words);
    const uint64_t records = reading->batch_bytes / (reading->words * sizeof(uint32_t));
    const uint64_t values = reading->channel_values * sizeof(float);
    for (int i = 0; i < BATCHES && status == 0; i++) {
        struct batch *batch = &reading->batches[i];
        status = bsq_alloc(ctx, "regions of parts", reading->batch_bytes, 1, &batch->bytes);
        if (status == 0)
            status = bsq_alloc(ctx, "regions of parts", LEAVES, sizeof *batch->ids, &batch->ids);
        if (status == 0)
            status =
                bsq_alloc(ctx, "regions of parts", LEAVES, sizeof *batch->masks, &batch->masks);
        if (status == 0)
            status = bsq_alloc(ctx, "regions of parts", records, sizeof *batch->records,
                               &batch->records);
        if (status == 0)
            status =
                bsq_alloc(ctx, "regions of parts", records, sizeof *batch->second, &batch->second);
        if (status == 0 && values > 0)
            status = bsq_alloc(ctx, "regions of parts", records, values, &batch->channels);
        if (status == 0 && values > 0)
            status = bsq_alloc(ctx, "regions of parts", records, values, &batch->second_channels);
    }
    reading->hash = XXH3_createState();
    return status < 0 || reading->hash ? status : fmt_farm_fail_memory(&reading->parts->plan->base);
}

static void free_batches(struct reading *reading)
{
    struct bsq_ctx *ctx = reading->parts->plan->base.ctx;
    for (int i = 0; i < BATCHES; i++) {
        bsq_free(ctx, reading->batches[i].bytes);
        bsq_free(ctx, reading->batches[i].ids);
        bsq_free(ctx, reading->batches[i].masks);
        bsq_free(ctx, reading->batches[i].records);
        bsq_free(ctx, reading->batches[i].second);
        bsq_free(ctx, reading->batches[i].channels);
        bsq_free(ctx, reading->batches[i].second_channels);
    }
    XXH3_freeState(reading->hash);
}

int vox_parts_read(struct vox_parts *parts,
                   int (*append)(void *arg, const struct fmt_nvdb_region *region), void *arg)
{
    struct reading reading = {.parts = parts, .append = append, .arg = arg};
    struct batch *slots[BATCHES];
    const struct bsq_pipeline pipeline = {.produce = read_batch,
                                          .emit = append_batch,
                                          .arg = &reading,
                                          .slots = slots,
                                          .slot_size = sizeof slots / BATCHES,
                                          .slot_count = BATCHES};
    uint64_t voxels = 0;
    for (uint64_t i = 0; i < parts->count; i++)
        voxels += parts->items[i].entry.voxels;
    int status = make_batches(&reading);
    bsq_progress_begin(parts->plan->base.ctx, "reading parts", "voxels", voxels);
    if (status == 0)
        status = bsq_pipeline_run(parts->plan->base.ctx, &pipeline);
    bsq_progress_end(parts->plan->base.ctx);
    free_batches(&reading);
    return status;
}

/* ---- one part ---- */

static int drop_region(void *arg, const struct fmt_nvdb_region *region)
{
    (void)arg;
    (void)region;
    return 0;
}

int vox_part_check(const struct vox_farm_plan *plan, uint32_t task)
{
    struct vox_part_header header;
    struct vox_part_entry *entries;
    struct bsq_file file;
    struct vox_part_totals totals = {0};
    struct vox_parts parts = {.plan = plan};
    struct listing listing = {&parts, &totals};
    int status = open_part(plan, task, &header, &entries, &file);
    bsq_free(plan->base.ctx, entries);
    bsq_file_close(plan->base.ctx, &file);
    if (status < 0)
        return status;
    parts.flags = header.head.own;
    status = list_part(&listing, task);
    if (status == 0)
        status = vox_parts_read(&parts, drop_region, NULL);
    close_files(&parts);
    bsq_free(plan->base.ctx, parts.items);
    return status;
}
