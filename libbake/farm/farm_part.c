/* farm_part.c - part files: the texels of the blocks that one task baked. See FORMATS.md. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <xxhash.h>

#include "base/output.h"
#include "base/parallel.h"
#include "libbake/farm/farm.h"

/* Structures are copied to and from the file as they are. */
_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "the host must be little-endian");

static const char magic[8] = "BSQPART\n";
enum { VERSION = 7, ATTEMPTS = 3, LIST_BYTES = 160 };

struct part_header {
    char magic[8];
    uint32_t version;
    uint32_t channels;
    char plan_id[32];
    uint32_t task, task_count;
    uint32_t block_side;
    uint32_t reserved;
    uint64_t block_count;
    struct bake_farm_found found;
    uint64_t table_checksum;
    uint64_t header_checksum; /* of all bytes before this field */
};
_Static_assert(sizeof(struct part_header) == 136 + 136 * BK_MAP_COUNT, "there is no padding");

struct part_entry {
    uint32_t tile;     /* index in the plan */
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
    return bake_image_channels_for(bake_selection(&plan->options));
}

static uint64_t block_bytes(const struct bake_farm_plan *plan)
{
    return (uint64_t)plan->block_side * plan->block_side * channels_of(plan) * sizeof(float);
}

/* Plans a.json and a may lie side by side, so their parts end differently. */
int bake_farm_path(const struct bake_farm_plan *plan, const char *kind, uint32_t number, char **out)
{
    const char *name = bsq_file_name(plan->path), *end = name + strlen(name) - strlen(".json");
    const bool is_json = end > name && strcmp(end, ".json") == 0;
    const int written =
        is_json ? asprintf(out, "%.*s.%04u.%s", (int)(end - plan->path), plan->path, number, kind)
                : asprintf(out, "%s.%s.%04u", plan->path, kind, number);
    if (written >= 0)
        return 0;
    *out = NULL;
    return bsq_fail(plan->ctx, BSQ_ENOMEM, "%s: out of memory", plan->path);
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

static int check_header(const struct part *part, uint32_t task)
{
    const struct bake_farm_plan *plan = part->plan;
    const struct part_header *header = &part->header;
    char text[64];
    if (memcmp(header->magic, magic, sizeof magic) != 0)
        return fail_part(part, "not a part of a bake");
    snprintf(text, sizeof text, "version %u of parts is unknown", header->version);
    if (header->version != VERSION)
        return fail_part(part, text);
    if (header_checksum(header) != header->header_checksum || header->reserved != 0)
        return fail_part(part, "damaged header");
    if (memcmp(header->plan_id, plan->id, sizeof header->plan_id) != 0)
        return fail_part(part, "a part of another plan");
    if (header->task != task || header->task_count != plan->tasks ||
        header->block_side != plan->block_side || header->channels != channels_of(plan))
        return fail_part(part, "the part of another task");
    return 0;
}

/* Checks that the file has the size that its header gives. */
static int check_size(const struct part *part)
{
    const uint64_t each = block_bytes(part->plan) + sizeof(struct part_entry);
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
        const uint32_t t = entry->tile;
        const bool known = t < plan->tile_count &&
                           entry->block < (uint64_t)plan->tiles[t].columns * plan->tiles[t].rows &&
                           plan->tiles[t].task_of[entry->block] == part->header.task;
        const bool later = i == 0 || entry->tile > entry[-1].tile ||
                           (entry->tile == entry[-1].tile && entry->block > entry[-1].block);
        if (!known || !later)
            return fail_part(part, "damaged table of blocks");
    }
    return 0;
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
    struct bsq_ctx *ctx = plan->ctx;
    char *path;
    int status = bake_farm_path(plan, "part", task, &path);
    *part = (struct part){.plan = plan, .file = BSQ_FILE_CLOSED};
    if (status == 0)
        status = bsq_file_open_as(ctx, path, BSQ_OPEN_OTHER, &part->file);
    free(path);
    if (status < 0)
        return status;
    if (part->file.size < sizeof part->header)
        return fail_part(part, "not a part of a bake");
    BSQ_TRY(bsq_file_read(ctx, &part->file, &part->header, sizeof part->header, 0));
    BSQ_TRY(check_header(part, task));
    BSQ_TRY(check_size(part));
    const uint64_t count = part->header.block_count, bytes = count * sizeof *part->entries;
    BSQ_TRY(bsq_alloc(ctx, "blocks of a part", count, sizeof *part->entries, &part->entries));
    BSQ_TRY(bsq_file_read(ctx, &part->file, part->entries, bytes, part->file.size - bytes));
    if (XXH3_64bits(part->entries, bytes) != part->header.table_checksum)
        return fail_part(part, "damaged table of blocks");
    status = check_entries(part);
done:
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

/* Reads all of a task's part. */
static int check_part(const struct bake_farm_plan *plan, uint32_t task)
{
    struct part part;
    float *texels = NULL;
    int status;
    BSQ_TRY(open_part(plan, task, &part));
    BSQ_TRY(bsq_alloc(plan->ctx, "texels of a block", 1, block_bytes(plan), &texels));
    for (uint64_t i = 0; i < part.header.block_count; i++) {
        BSQ_TRY(bsq_check(plan->ctx));
        BSQ_TRY(read_block(&part, i, texels));
    }
done:
    bsq_free(plan->ctx, texels);
    close_part(&part);
    return status;
}

int bake_farm_part_is_there(const struct bake_farm_plan *plan, uint32_t task, bool *out)
{
    const int status = check_part(plan, task);
    *out = status == 0;
    if (status == BSQ_ENOMEM || status == BSQ_EINTR)
        return status;
    bsq_clear_error(plan->ctx);
    return 0;
}

/* ---- writing ---- */

struct part_writer {
    const struct bake_farm_plan *plan;
    const struct bake_tile *tiles;
    struct part_header header;
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

/* Writes block `slot` of a tile's image, unless it has no covered texels. */
static int write_block(struct part_writer *writer, uint32_t tile, uint32_t block, uint32_t slot)
{
    const uint32_t side = writer->plan->block_side;
    const uint64_t bytes = block_bytes(writer->plan);
    const float *texels = NULL;
    int status = bsq_check(writer->plan->ctx);
    if (status == 0)
        status =
            bake_image_rows(writer->tiles[tile].image, slot * side, side, writer->texels, &texels);
    if (!texels || status < 0 ||
        !is_covered(texels, (uint64_t)side * side, writer->header.channels))
        return status;
    writer->entries[writer->count++] =
        (struct part_entry){.tile = tile, .block = block, .checksum = XXH3_64bits(texels, bytes)};
    return bsq_output_write(writer->output, texels, bytes);
}

static int write_blocks(struct part_writer *writer)
{
    int status = 0;
    for (uint32_t t = 0; t < writer->plan->tile_count; t++) {
        const struct bake_blocks *blocks = &writer->tiles[t].blocks;
        const uint64_t count = (uint64_t)blocks->columns * blocks->rows;
        for (uint64_t b = 0; writer->tiles[t].image && b < count && status == 0; b++)
            if (blocks->slots[b] != BAKE_NO_SLOT)
                status = write_block(writer, t, (uint32_t)b, blocks->slots[b]);
    }
    return status;
}

/* Writes the whole file: first the header without its values, then blocks and table, then the
 * header again. */
static int write_file(struct part_writer *writer, const char *path)
{
    struct part_header *header = &writer->header;
    int status = bsq_output_open(writer->plan->ctx, path, &writer->output);
    if (status < 0)
        return status;
    writer->count = 0;
    BSQ_TRY(bsq_output_write(writer->output, header, sizeof *header));
    BSQ_TRY(write_blocks(writer));
    const uint64_t table_bytes = writer->count * sizeof *writer->entries;
    BSQ_TRY(bsq_output_write(writer->output, writer->entries, table_bytes));
    header->block_count = writer->count;
    header->table_checksum = XXH3_64bits(writer->entries, table_bytes);
    header->header_checksum = header_checksum(header);
    BSQ_TRY(bsq_output_write_at(writer->output, header, sizeof *header, 0));
    return bsq_output_commit(writer->output);
done:
    bsq_output_discard(writer->output);
    return status;
}

/* On file systems whose locks hold on one machine only, the same task on another machine may remove
 * this one's temporary file. Then its part may be there by now; else writing starts again. */
static int write_until_there(struct part_writer *writer, uint32_t task)
{
    const struct bake_farm_plan *plan = writer->plan;
    char *path;
    int status = bake_farm_path(plan, "part", task, &path);
    for (int attempt = 1; status == 0; attempt++) {
        bool there = false;
        status = write_file(writer, path);
        if (status != BSQ_ECANTCREAT || attempt == ATTEMPTS)
            break;
        if (bake_farm_part_is_there(plan, task, &there) < 0 || bsq_check(plan->ctx) < 0)
            break;
        bsq_clear_error(plan->ctx);
        status = 0;
        if (there)
            break;
    }
    free(path);
    return status;
}

int bake_farm_part_write(const struct bake_farm_plan *plan, uint32_t task,
                         const struct bake_tile *tiles, const struct bake_farm_found *found)
{
    struct part_writer writer = {.plan = plan,
                                 .tiles = tiles,
                                 .header = {.version = VERSION,
                                            .channels = channels_of(plan),
                                            .task = task,
                                            .task_count = plan->tasks,
                                            .block_side = plan->block_side,
                                            .found = *found}};
    uint64_t blocks = 0;
    int status;
    memcpy(writer.header.magic, magic, sizeof magic);
    memcpy(writer.header.plan_id, plan->id, sizeof writer.header.plan_id);
    for (uint32_t t = 0; t < plan->tile_count; t++)
        blocks += tiles[t].blocks.count;
    BSQ_TRY(bsq_alloc(plan->ctx, "blocks", blocks, sizeof *writer.entries, &writer.entries));
    BSQ_TRY(bsq_alloc(plan->ctx, "texels of a block", 1, block_bytes(plan), &writer.texels));
    status = write_until_there(&writer, task);
done:
    bsq_free(plan->ctx, writer.texels);
    bsq_free(plan->ctx, writer.entries);
    return status;
}

/* ---- all parts ---- */

/* Fails with the numbers of the missing parts, as many as fit a line. */
static int fail_missing(const struct bake_farm_plan *plan, const uint32_t *missing, uint32_t count)
{
    char list[LIST_BYTES] = "";
    size_t length = 0;
    uint32_t named = 0;
    for (; named < count && length + 32 < sizeof list; named++)
        length += (size_t)snprintf(list + length, sizeof list - length, "%s%u", named ? ", " : "",
                                   missing[named]);
    char *path;
    int status = bake_farm_path(plan, "part", missing[0], &path);
    if (status == 0)
        status =
            bsq_fail(plan->ctx, BSQ_ENOINPUT,
                     "%s: missing; %u of %u parts are missing: those of task%s %s%s", path, count,
                     plan->tasks, count == 1 ? "" : "s", list, named < count ? " ..." : "");
    free(path);
    return status;
}

static void add_found(struct bake_farm_found *to, const struct bake_farm_found *more)
{
    to->counts.covered_texels += more->counts.covered_texels;
    to->counts.samples += more->counts.samples;
    to->counts.hits += more->counts.hits;
    to->counts.overlapping_samples += more->counts.overlapping_samples;
    to->counts.curvature_texels += more->counts.curvature_texels;
    to->counts.curvature_alone += more->counts.curvature_alone;
    for (unsigned i = 0; i < BK_MAP_COUNT; i++)
        bake_statistics_add(&to->statistics[i], &more->statistics[i]);
}

int bake_farm_parts_check(const struct bake_farm_plan *plan, struct bake_farm_found *found)
{
    uint32_t *missing, count = 0;
    int status = bsq_alloc(plan->ctx, "tasks", plan->tasks, sizeof *missing, &missing);
    *found = (struct bake_farm_found){0};
    for (uint32_t task = 0; task < plan->tasks && status == 0; task++) {
        struct part part;
        status = open_part(plan, task, &part);
        if (status == 0)
            add_found(found, &part.header.found);
        close_part(&part);
        if (status == BSQ_ENOINPUT) {
            bsq_clear_error(plan->ctx);
            missing[count++] = task;
            status = 0;
        }
        if (status == 0)
            status = bsq_check(plan->ctx);
    }
    if (status == 0 && count > 0)
        status = fail_missing(plan, missing, count);
    bsq_free(plan->ctx, missing);
    return status;
}

struct reading {
    const struct part *part;
    uint64_t first; /* entry of the tile */
    struct bake_image *image;
    float **texels; /* of a block, one a worker */
};

/* Copies a block to its image, without what lies outside of the map. */
static int copy_block(void *arg, uint64_t i, unsigned worker)
{
    const struct reading *reading = arg;
    const struct part *part = reading->part;
    const struct part_entry *entry = &part->entries[reading->first + i];
    const struct bake_farm_tile *tile = &part->plan->tiles[entry->tile];
    const uint32_t side = part->plan->block_side;
    const uint32_t x = entry->block % tile->columns * side, y = entry->block / tile->columns * side;
    const uint32_t width = tile->width - x < side ? tile->width - x : side;
    const uint32_t height = tile->height - y < side ? tile->height - y : side;
    float *texels = reading->texels[worker];
    int status = read_block(part, reading->first + i, texels);
    for (uint32_t row = 0; row < height && status == 0; row++)
        status = bake_image_write(reading->image, x, y + row, width, 1,
                                  texels + (size_t)row * side * part->header.channels);
    return status;
}

/* Copies the blocks of a tile, which follow each other in a part. */
static int copy_part(const struct bake_farm_plan *plan, uint32_t task, uint32_t tile,
                     const struct reading *shared)
{
    struct reading reading = *shared;
    struct part part;
    uint64_t end;
    int status = open_part(plan, task, &part);
    if (status == 0) {
        reading.part = &part;
        for (reading.first = 0; reading.first < part.header.block_count; reading.first++)
            if (part.entries[reading.first].tile == tile)
                break;
        for (end = reading.first; end < part.header.block_count; end++)
            if (part.entries[end].tile != tile)
                break;
        status = bsq_parallel_for(plan->ctx, end - reading.first, copy_block, &reading);
    }
    close_part(&part);
    return status;
}

int bake_farm_parts_read(const struct bake_farm_plan *plan, uint32_t tile, struct bake_image *image)
{
    struct bsq_ctx *ctx = plan->ctx;
    const struct bake_farm_tile *of = &plan->tiles[tile];
    const unsigned workers = bsq_threads(ctx);
    struct reading reading = {.image = image};
    bool *in_tile = NULL; /* for each task */
    int status;
    bsq_progress_begin(ctx, "reading parts", "parts", plan->tasks);
    BSQ_TRY(bsq_calloc(ctx, "texels of blocks", workers, sizeof *reading.texels, &reading.texels));
    for (unsigned w = 0; w < workers; w++)
        BSQ_TRY(bsq_alloc(ctx, "texels of blocks", 1, block_bytes(plan), &reading.texels[w]));
    BSQ_TRY(bsq_calloc(ctx, "tasks", plan->tasks, sizeof *in_tile, &in_tile));
    for (uint64_t b = 0; b < (uint64_t)of->columns * of->rows; b++)
        in_tile[of->task_of[b]] = true;
    for (uint32_t task = 0; task < plan->tasks; task++) {
        if (in_tile[task])
            BSQ_TRY(copy_part(plan, task, tile, &reading));
        bsq_progress_add(ctx, 1);
    }
done:
    bsq_free(ctx, in_tile);
    for (unsigned w = 0; reading.texels && w < workers; w++)
        bsq_free(ctx, reading.texels[w]);
    bsq_free(ctx, reading.texels);
    bsq_progress_end(ctx);
    return status;
}
