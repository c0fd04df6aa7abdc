/* farm_part.c - part files: the texels of the blocks that one task baked. See FORMATS.md. */
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <xxhash.h>

#include "base/output.h"
#include "base/parallel.h"
#include "libbake/farm/farm.h"

/* Structures are copied to and from the file as they are. */
_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "the host must be little-endian");

#define MAGIC "BSQPART\n"
enum { VERSION = 1, ATTEMPTS = 3, LIST_BYTES = 160 };

struct part_header {
    char magic[8];
    uint32_t version;
    uint32_t channels;
    uint64_t plan_id[2];
    uint32_t task;
    uint32_t task_count;
    uint32_t block_side;
    uint32_t reserved;
    uint64_t block_count;
    uint64_t covered_texels;
    uint64_t samples;
    uint64_t hits;
    uint64_t overlapping_samples;
    uint64_t table_checksum;
    uint64_t header_checksum; /* of all bytes before this field */
};
_Static_assert(sizeof(struct part_header) == 104, "the header has no padding");

struct part_entry {
    uint32_t tile;     /* number of the UDIM tile */
    uint32_t block;    /* in row order */
    uint64_t checksum; /* of the texels */
};
_Static_assert(sizeof(struct part_entry) == 16, "the entry has no padding");

static uint64_t header_checksum(const struct part_header *header)
{
    return XXH3_64bits(header, offsetof(struct part_header, header_checksum));
}

/* Returns the floats of a texel in all parts of a plan. */
static uint32_t channels_of(const struct bake_farm_plan *plan)
{
    return bake_image_channels_for(plan->options.maps);
}

static uint64_t block_bytes(const struct bake_farm_plan *plan)
{
    return (uint64_t)plan->block_side * plan->block_side * channels_of(plan) * sizeof(float);
}

static int fail_memory(const struct bake_farm_plan *plan)
{
    return bsq_fail(plan->ctx, BSQ_ENOMEM, "%s: out of memory", plan->path);
}

/* ---- writing ---- */

struct part_writer {
    const struct bake_farm_plan *plan;
    const struct bake_farm_image *images;
    struct bsq_output *output;
    struct part_entry *entries;
    uint64_t count; /* blocks so far */
    float *texels;  /* of a block */
};

static bool is_covered(const float *texels, uint64_t count, uint32_t channels)
{
    for (uint64_t i = 0; i < count; i++)
        if (texels[i * channels] != BAKE_OUTSIDE)
            return true;
    return false;
}

/* Writes block `slot` of an image, unless it has no covered texels. */
static int write_block(struct part_writer *writer, const struct bake_farm_image *image,
                       uint32_t tile, uint32_t block, uint32_t slot)
{
    const uint32_t side = writer->plan->block_side;
    const uint64_t bytes = block_bytes(writer->plan);
    const float *texels = NULL;
    int status = bsq_check(writer->plan->ctx);
    if (status == 0)
        status = bake_image_rows(image->image, slot * side, side, writer->texels, &texels);
    if (!texels || status < 0 ||
        !is_covered(texels, (uint64_t)side * side, channels_of(writer->plan)))
        return status;
    writer->entries[writer->count++] =
        (struct part_entry){.tile = tile, .block = block, .checksum = XXH3_64bits(texels, bytes)};
    return bsq_output_write(writer->output, texels, bytes);
}

static int write_blocks(struct part_writer *writer)
{
    int status = 0;
    for (uint32_t t = 0; t < writer->plan->tile_count; t++) {
        const struct bake_farm_image *image = &writer->images[t];
        const uint64_t blocks = (uint64_t)image->blocks.columns * image->blocks.rows;
        for (uint64_t b = 0; image->image && b < blocks && status == 0; b++)
            if (image->blocks.slots[b] != BAKE_NO_SLOT)
                status = write_block(writer, image, writer->plan->tiles[t].number, (uint32_t)b,
                                     image->blocks.slots[b]);
    }
    return status;
}

static uint64_t blocks_in(const struct bake_farm_plan *plan, const struct bake_farm_image *images)
{
    uint64_t count = 0;
    for (uint32_t t = 0; t < plan->tile_count; t++)
        count += images[t].blocks.count;
    return count;
}

/* Writes the whole file: first the header without its values, then blocks and table, then the
 * header again. */
static int write_file(struct part_writer *writer, struct part_header *header)
{
    int status = bsq_output_write(writer->output, header, sizeof *header);
    writer->count = 0;
    if (status == 0)
        status = write_blocks(writer);
    if (status == 0)
        status = bsq_output_write(writer->output, writer->entries,
                                  writer->count * sizeof *writer->entries);
    header->block_count = writer->count;
    header->table_checksum = XXH3_64bits(writer->entries, writer->count * sizeof *writer->entries);
    header->header_checksum = header_checksum(header);
    if (status == 0)
        status = bsq_output_write_at(writer->output, header, sizeof *header, 0);
    return status;
}

static int write_and_commit(struct part_writer *writer, const char *path,
                            struct part_header *header)
{
    int status = bsq_output_open(writer->plan->ctx, path, &writer->output);
    if (status < 0)
        return status;
    status = write_file(writer, header);
    if (status == 0)
        return bsq_output_commit(writer->output);
    bsq_output_discard(writer->output);
    return status;
}

static struct part_header header_for(const struct bake_farm_plan *plan, uint32_t task,
                                     const struct bake_farm_counts *counts)
{
    struct part_header header = {.magic = MAGIC,
                                 .version = VERSION,
                                 .channels = channels_of(plan),
                                 .plan_id = {plan->id[0], plan->id[1]},
                                 .task = task,
                                 .task_count = plan->task_count,
                                 .block_side = plan->block_side,
                                 .covered_texels = counts->covered_texels,
                                 .samples = counts->samples,
                                 .hits = counts->hits,
                                 .overlapping_samples = counts->overlapping_samples};
    return header;
}

/* On file systems whose locks hold on one machine only, the same task on another machine may remove
 * this one's temporary file. Then its part may be there by now; else writing starts again. */
int bake_farm_part_write(const struct bake_farm_plan *plan, uint32_t task,
                         const struct bake_farm_image *images,
                         const struct bake_farm_counts *counts)
{
    struct bsq_ctx *ctx = plan->ctx;
    struct part_writer writer = {.plan = plan, .images = images};
    struct part_header header = header_for(plan, task, counts);
    char *path = bake_farm_part_path(plan, task);
    int status = path ? 0 : fail_memory(plan);
    if (status == 0)
        status = bsq_alloc(ctx, "blocks", blocks_in(plan, images), sizeof *writer.entries,
                           &writer.entries);
    if (status == 0)
        status = bsq_alloc(ctx, "texels of a block", 1, block_bytes(plan), &writer.texels);
    for (int attempt = 1; status == 0; attempt++) {
        bool there = false;
        status = write_and_commit(&writer, path, &header);
        if (status != BSQ_ECANTCREAT || attempt == ATTEMPTS)
            break;
        if (bake_farm_part_is_there(plan, task, &there) < 0 || bsq_check(ctx) < 0)
            break;
        bsq_clear_error(ctx);
        status = 0;
        if (there)
            break;
    }
    bsq_free(ctx, writer.texels);
    bsq_free(ctx, writer.entries);
    free(path);
    return status;
}

/* ---- reading ---- */

struct part {
    const struct bake_farm_plan *plan;
    struct bsq_file file;
    struct part_header header;
    struct part_entry *entries;
};

static int fail_part(const struct part *part, const char *what)
{
    return bsq_fail(part->plan->ctx, BSQ_EDATA, "%s: %s: run this task again", part->file.path,
                    what);
}

/* Returns the index of the plan's tile with this number, tile_count if there is none. */
static uint32_t find_tile(const struct bake_farm_plan *plan, uint32_t number)
{
    uint32_t t = 0;
    while (t < plan->tile_count && plan->tiles[t].number != number)
        t++;
    return t;
}

static int check_header(const struct part *part, uint32_t task, uint32_t channels)
{
    const struct bake_farm_plan *plan = part->plan;
    const struct part_header *header = &part->header;
    if (memcmp(header->magic, MAGIC, sizeof header->magic) != 0)
        return fail_part(part, "not a part of a bake");
    if (header->version != VERSION)
        return bsq_fail(plan->ctx, BSQ_EDATA,
                        "%s: version %u of parts is unknown: run this task "
                        "again",
                        part->file.path, header->version);
    if (header->header_checksum != header_checksum(header) || header->reserved != 0)
        return fail_part(part, "damaged header");
    if (header->plan_id[0] != plan->id[0] || header->plan_id[1] != plan->id[1])
        return fail_part(part, "a part of another plan");
    if (header->task != task || header->task_count != plan->task_count ||
        header->block_side != plan->block_side || header->channels != channels)
        return fail_part(part, "the part of another task");
    return 0;
}

/* Checks that the file has the size that its header gives. */
static int check_size(const struct part *part)
{
    const uint64_t bytes = block_bytes(part->plan);
    const uint64_t each = bytes + sizeof(struct part_entry);
    const uint64_t rest = part->file.size - sizeof part->header;
    if (rest % each != 0 || rest / each != part->header.block_count)
        return fail_part(part, "damaged: its size is wrong");
    return 0;
}

/* Checks that the blocks are those of the task, each once. */
static int check_entries(const struct part *part)
{
    const struct bake_farm_plan *plan = part->plan;
    for (uint64_t i = 0; i < part->header.block_count; i++) {
        const struct part_entry *entry = &part->entries[i];
        const uint32_t t = find_tile(plan, entry->tile);
        const bool known = t < plan->tile_count &&
                           entry->block < (uint64_t)plan->tiles[t].columns * plan->tiles[t].rows &&
                           plan->tiles[t].tasks[entry->block] == part->header.task;
        const bool later = i == 0 || entry->tile > entry[-1].tile ||
                           (entry->tile == entry[-1].tile && entry->block > entry[-1].block);
        if (!known || !later)
            return fail_part(part, "damaged table of blocks");
    }
    return 0;
}

static int read_table(struct part *part)
{
    struct bsq_ctx *ctx = part->plan->ctx;
    const uint64_t count = part->header.block_count, bytes = count * sizeof *part->entries;
    int status = bsq_alloc(ctx, "blocks of a part", count, sizeof *part->entries, &part->entries);
    if (status == 0)
        status = bsq_file_read(ctx, &part->file, part->entries, bytes, part->file.size - bytes);
    if (status == 0 && XXH3_64bits(part->entries, bytes) != part->header.table_checksum)
        status = fail_part(part, "damaged table of blocks");
    return status < 0 ? status : check_entries(part);
}

static void close_part(struct part *part)
{
    bsq_free(part->plan->ctx, part->entries);
    part->entries = NULL;
    bsq_file_close(part->plan->ctx, &part->file);
}

/* Opens the part of a task and checks all but its texels. Close it also after a failure. */
static int open_part(const struct bake_farm_plan *plan, uint32_t task, struct part *part)
{
    *part = (struct part){.plan = plan, .file = BSQ_FILE_CLOSED};
    char *path = bake_farm_part_path(plan, task);
    if (!path)
        return fail_memory(plan);
    int status = bsq_file_open_as(plan->ctx, path, BSQ_OPEN_OTHER, &part->file);
    if (status == 0 && part->file.size < sizeof part->header)
        status = fail_part(part, "not a part of a bake");
    if (status == 0)
        status = bsq_file_read(plan->ctx, &part->file, &part->header, sizeof part->header, 0);
    if (status == 0)
        status = check_header(part, task, channels_of(plan));
    if (status == 0)
        status = check_size(part);
    if (status == 0)
        status = read_table(part);
    free(path);
    return status;
}

/* Reads the texels of block i and checks them. */
static int read_block(const struct part *part, uint64_t i, float *texels)
{
    const uint64_t bytes = block_bytes(part->plan);
    int status =
        bsq_file_read(part->plan->ctx, &part->file, texels, bytes, sizeof part->header + i * bytes);
    if (status == 0 && XXH3_64bits(texels, bytes) != part->entries[i].checksum)
        status = fail_part(part, "damaged texels");
    return status;
}

/* Reads all texels of a part, to check them. */
static int check_blocks(const struct part *part)
{
    float *texels;
    int status =
        bsq_alloc(part->plan->ctx, "texels of a block", 1, block_bytes(part->plan), &texels);
    for (uint64_t i = 0; i < part->header.block_count && status == 0; i++) {
        status = bsq_check(part->plan->ctx);
        if (status == 0)
            status = read_block(part, i, texels);
    }
    bsq_free(part->plan->ctx, texels);
    return status;
}

int bake_farm_part_is_there(const struct bake_farm_plan *plan, uint32_t task, bool *out)
{
    struct part part;
    int status = open_part(plan, task, &part);
    if (status == 0)
        status = check_blocks(&part);
    close_part(&part);
    *out = status == 0;
    if (status == BSQ_ENOMEM || status == BSQ_EINTR)
        return status;
    bsq_clear_error(plan->ctx);
    return 0;
}

/* ---- all parts ---- */

/* Fails with the numbers of the missing parts, as many as fit a line. */
static int fail_missing(const struct bake_farm_plan *plan, const uint32_t *missing, uint32_t count)
{
    char list[LIST_BYTES] = "";
    size_t length = 0;
    uint32_t named = 0;
    while (named < count && length + 32 < sizeof list) {
        length += (size_t)snprintf(list + length, sizeof list - length, "%s%u", named ? ", " : "",
                                   missing[named]);
        named++;
    }
    char *path = bake_farm_part_path(plan, missing[0]);
    const int status = bsq_fail(plan->ctx, BSQ_ENOINPUT,
                                "%s: missing; %u of %u parts are missing: those of task%s %s%s",
                                path ? path : plan->path, count, plan->task_count,
                                count == 1 ? "" : "s", list, named < count ? " ..." : "");
    free(path);
    return status;
}

int bake_farm_parts_check(const struct bake_farm_plan *plan)
{
    uint32_t *missing, count = 0;
    int status = bsq_alloc(plan->ctx, "tasks", plan->task_count, sizeof *missing, &missing);
    for (uint32_t task = 0; task < plan->task_count && status == 0; task++) {
        struct part part;
        status = open_part(plan, task, &part);
        if (status == BSQ_ENOINPUT) {
            bsq_clear_error(plan->ctx);
            missing[count++] = task;
            status = 0;
        }
        close_part(&part);
    }
    if (status == 0 && count > 0)
        status = fail_missing(plan, missing, count);
    bsq_free(plan->ctx, missing);
    return status;
}

struct reading {
    const struct part *part;
    const struct bake_farm_image *images; /* one a tile */
    float **texels;                       /* of a block, one a worker */
};

/* Copies a block to its image, without what lies outside of the map. */
static int copy_block(void *arg, uint64_t i, unsigned worker)
{
    const struct reading *reading = arg;
    const struct part *part = reading->part;
    const struct part_entry *entry = &part->entries[i];
    const uint32_t t = find_tile(part->plan, entry->tile), side = part->plan->block_side;
    const struct bake_farm_tile *tile = &part->plan->tiles[t];
    const uint32_t x = entry->block % tile->columns * side, y = entry->block / tile->columns * side;
    const uint32_t width = tile->width - x < side ? tile->width - x : side;
    const uint32_t height = tile->height - y < side ? tile->height - y : side;
    float *texels = reading->texels[worker];
    int status = read_block(part, i, texels);
    for (uint32_t row = 0; row < height && status == 0; row++)
        status = bake_image_write(reading->images[t].image, x, y + row, width, 1,
                                  texels + (size_t)row * side * part->header.channels);
    return status;
}

static void add_counts(struct bake_farm_counts *counts, const struct part_header *header)
{
    counts->covered_texels += header->covered_texels;
    counts->samples += header->samples;
    counts->hits += header->hits;
    counts->overlapping_samples += header->overlapping_samples;
}

static int copy_part(const struct bake_farm_plan *plan, uint32_t task, const struct reading *all,
                     struct bake_farm_counts *counts)
{
    struct part part;
    struct reading reading = {.part = &part, .images = all->images, .texels = all->texels};
    int status = open_part(plan, task, &part);
    if (status == 0)
        status = bsq_parallel_for(plan->ctx, part.header.block_count, copy_block, &reading);
    if (status == 0)
        add_counts(counts, &part.header);
    close_part(&part);
    return status;
}

int bake_farm_parts_read(const struct bake_farm_plan *plan, const struct bake_farm_image *images,
                         struct bake_farm_counts *counts)
{
    struct bsq_ctx *ctx = plan->ctx;
    const unsigned workers = bsq_threads(ctx);
    struct reading reading = {.images = images};
    *counts = (struct bake_farm_counts){0};
    bsq_progress_begin(ctx, "reading parts", "parts", plan->task_count);
    int status =
        bsq_calloc(ctx, "texels of blocks", workers, sizeof *reading.texels, &reading.texels);
    for (unsigned w = 0; w < workers && status == 0; w++)
        status = bsq_alloc(ctx, "texels of blocks", 1, block_bytes(plan), &reading.texels[w]);
    for (uint32_t task = 0; task < plan->task_count && status == 0; task++) {
        status = copy_part(plan, task, &reading, counts);
        bsq_progress_add(ctx, 1);
    }
    for (unsigned w = 0; reading.texels && w < workers; w++)
        bsq_free(ctx, reading.texels[w]);
    bsq_free(ctx, reading.texels);
    bsq_progress_end(ctx);
    return status;
}
