/* farm_part.c - part files: the texels of the blocks that one task baked. See FORMATS.md. */

#include <xxhash.h>

#include "base/parallel.h"
#include "libbake/farm/farm.h"

/* Structures are copied to and from the file as they are. */
_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "the host must be little-endian");

struct part_header {
    struct fmt_farm_part_head head; /* `own` is the number of channels */
    uint32_t block_side;
    uint32_t reserved;
    uint64_t block_count;
    uint64_t covered_texels;
    uint64_t samples;
    uint64_t hits;
    uint64_t overlapping_samples;
    uint64_t curvature_texels;
    uint64_t curvature_alone;
    uint64_t table_checksum;
    uint64_t header_checksum; /* of all bytes before this field */
};
_Static_assert(sizeof(struct part_header) == 120, "the header has no padding");

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

/* ---- writing ---- */

struct part_writer {
    const struct bake_farm_plan *plan;
    const struct bake_farm_image *images;
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

/* Writes block `slot` of an image, unless it has no covered texels. */
static int write_block(struct part_writer *writer, const struct bake_farm_image *image,
                       uint32_t tile, uint32_t block, uint32_t slot)
{
    const uint32_t side = writer->plan->block_side;
    const uint64_t bytes = block_bytes(writer->plan);
    const float *texels = NULL;
    int status = bsq_check(writer->plan->base.ctx);
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
                status = write_block(writer, image, t, (uint32_t)b, image->blocks.slots[b]);
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

static int check_part(void *arg, uint32_t task);

/* Writes the whole file: first the header without its values, then blocks and table, then the
 * header again. */
static int write_part(void *arg, struct bsq_output *output)
{
    struct part_writer *writer = arg;
    struct part_header *header = &writer->header;
    writer->output = output;
    writer->count = 0;
    int status = bsq_output_write(output, header, sizeof *header);
    if (status == 0)
        status = write_blocks(writer);
    if (status == 0)
        status = bsq_output_write(output, writer->entries, writer->count * sizeof *writer->entries);
    header->block_count = writer->count;
    header->table_checksum = XXH3_64bits(writer->entries, writer->count * sizeof *writer->entries);
    header->header_checksum = header_checksum(header);
    if (status == 0)
        status = bsq_output_write_at(output, header, sizeof *header, 0);
    return status;
}

static struct part_header header_for(const struct bake_farm_plan *plan, uint32_t task,
                                     const struct bake_farm_counts *counts)
{
    struct part_header header = {.head = fmt_farm_part_head(&plan->base, task, channels_of(plan)),
                                 .block_side = plan->block_side,
                                 .covered_texels = counts->covered_texels,
                                 .samples = counts->samples,
                                 .hits = counts->hits,
                                 .overlapping_samples = counts->overlapping_samples,
                                 .curvature_texels = counts->curvature_texels,
                                 .curvature_alone = counts->curvature_alone};
    return header;
}

int bake_farm_part_write(const struct bake_farm_plan *plan, uint32_t task,
                         const struct bake_farm_image *images,
                         const struct bake_farm_counts *counts)
{
    struct bsq_ctx *ctx = plan->base.ctx;
    struct part_writer writer = {
        .plan = plan, .images = images, .header = header_for(plan, task, counts)};
    const struct fmt_farm_part_steps steps = {&writer, write_part, check_part};
    int status =
        bsq_alloc(ctx, "blocks", blocks_in(plan, images), sizeof *writer.entries, &writer.entries);
    if (status == 0)
        status = bsq_alloc(ctx, "texels of a block", 1, block_bytes(plan), &writer.texels);
    if (status == 0)
        status = fmt_farm_part_write(&plan->base, task, &steps);
    bsq_free(ctx, writer.texels);
    bsq_free(ctx, writer.entries);
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
    return fmt_farm_fail_part(&part->plan->base, &part->file, what);
}

static int check_header(const struct part *part)
{
    const struct part_header *header = &part->header;
    if (header->reserved != 0)
        return fail_part(part, "damaged header");
    if (header->block_side != part->plan->block_side || header->head.own != channels_of(part->plan))
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
        const uint32_t t = entry->tile;
        const bool known = t < plan->tile_count &&
                           entry->block < (uint64_t)plan->tiles[t].columns * plan->tiles[t].rows &&
                           plan->tiles[t].tasks[entry->block] == part->header.head.task;
        const bool later = i == 0 || entry->tile > entry[-1].tile ||
                           (entry->tile == entry[-1].tile && entry->block > entry[-1].block);
        if (!known || !later)
            return fail_part(part, "damaged table of blocks");
    }
    return 0;
}

static int read_table(struct part *part)
{
    struct bsq_ctx *ctx = part->plan->base.ctx;
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
    bsq_free(part->plan->base.ctx, part->entries);
    part->entries = NULL;
    bsq_file_close(part->plan->base.ctx, &part->file);
}

/* Opens the part of a task and checks all but its texels. Close it also after a failure. */
static int open_part(const struct bake_farm_plan *plan, uint32_t task, struct part *part)
{
    *part = (struct part){.plan = plan};
    int status =
        fmt_farm_part_open(&plan->base, task, &part->header, sizeof part->header, &part->file);
    if (status == 0)
        status = check_header(part);
    if (status == 0)
        status = check_size(part);
    return status < 0 ? status : read_table(part);
}

/* Reads the texels of block i and checks them. */
static int read_block(const struct part *part, uint64_t i, float *texels)
{
    const uint64_t bytes = block_bytes(part->plan);
    int status = bsq_file_read(part->plan->base.ctx, &part->file, texels, bytes,
                               sizeof part->header + i * bytes);
    if (status == 0 && XXH3_64bits(texels, bytes) != part->entries[i].checksum)
        status = fail_part(part, "damaged texels");
    return status;
}

/* Reads all texels of a part, to check them. */
static int check_blocks(const struct part *part)
{
    float *texels;
    int status =
        bsq_alloc(part->plan->base.ctx, "texels of a block", 1, block_bytes(part->plan), &texels);
    for (uint64_t i = 0; i < part->header.block_count && status == 0; i++) {
        status = bsq_check(part->plan->base.ctx);
        if (status == 0)
            status = read_block(part, i, texels);
    }
    bsq_free(part->plan->base.ctx, texels);
    return status;
}

/* Checks all of a task's part. arg: a part_writer of its plan. */
static int check_part(void *arg, uint32_t task)
{
    const struct part_writer *writer = arg;
    struct part part;
    int status = open_part(writer->plan, task, &part);
    if (status == 0)
        status = check_blocks(&part);
    close_part(&part);
    return status;
}

int bake_farm_part_is_there(const struct bake_farm_plan *plan, uint32_t task, bool *out)
{
    struct part_writer of = {.plan = plan};
    const struct fmt_farm_part_steps steps = {&of, write_part, check_part};
    return fmt_farm_part_is_there(&plan->base, task, &steps, out);
}

/* ---- all parts ---- */

/* Checks all but the texels of a task's part. arg: the plan. */
static int check_table(void *arg, uint32_t task)
{
    struct part part;
    int status = open_part(arg, task, &part);
    close_part(&part);
    return status;
}

int bake_farm_parts_check(const struct bake_farm_plan *plan)
{
    const struct fmt_farm_part_steps steps = {.arg = (void *)(uintptr_t)plan, .check = check_table};
    return fmt_farm_parts_check(&plan->base, &steps);
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
    const uint32_t t = entry->tile, side = part->plan->block_side;
    const struct bake_farm_tile *tile = &part->plan->tiles[t];
    const uint32_t x = entry->block % tile->columns * side, y = entry->block / tile->columns * side;
    const uint32_t width = tile->width - x < side ? tile->width - x : side;
    const uint32_t height = tile->height - y < side ? tile->height - y : side;
    float *texels = reading->texels[worker];
    int status = read_block(part, i, texels);
    for (uint32_t row = 0; row < height && status == 0; row++)
        status = bake_image_write(reading->images[t].image, x, y + row, width, 1,
                                  texels + (size_t)row * side * part->header.head.own);
    return status;
}

static void add_counts(struct bake_farm_counts *counts, const struct part_header *header)
{
    counts->covered_texels += header->covered_texels;
    counts->samples += header->samples;
    counts->hits += header->hits;
    counts->overlapping_samples += header->overlapping_samples;
    counts->curvature_texels += header->curvature_texels;
    counts->curvature_alone += header->curvature_alone;
}

static int copy_part(const struct bake_farm_plan *plan, uint32_t task, const struct reading *all,
                     struct bake_farm_counts *counts)
{
    struct part part;
    struct reading reading = {.part = &part, .images = all->images, .texels = all->texels};
    int status = open_part(plan, task, &part);
    if (status == 0)
        status = bsq_parallel_for(plan->base.ctx, part.header.block_count, copy_block, &reading);
    if (status == 0)
        add_counts(counts, &part.header);
    close_part(&part);
    return status;
}

int bake_farm_parts_read(const struct bake_farm_plan *plan, const struct bake_farm_image *images,
                         struct bake_farm_counts *counts)
{
    struct bsq_ctx *ctx = plan->base.ctx;
    const unsigned workers = bsq_threads(ctx);
    struct reading reading = {.images = images};
    *counts = (struct bake_farm_counts){0};
    bsq_progress_begin(ctx, "reading parts", "parts", plan->base.task_count);
    int status =
        bsq_calloc(ctx, "texels of blocks", workers, sizeof *reading.texels, &reading.texels);
    for (unsigned w = 0; w < workers && status == 0; w++)
        status = bsq_alloc(ctx, "texels of blocks", 1, block_bytes(plan), &reading.texels[w]);
    for (uint32_t task = 0; task < plan->base.task_count && status == 0; task++) {
        status = copy_part(plan, task, &reading, counts);
        bsq_progress_add(ctx, 1);
    }
    for (unsigned w = 0; reading.texels && w < workers; w++)
        bsq_free(ctx, reading.texels[w]);
    bsq_free(ctx, reading.texels);
    bsq_progress_end(ctx);
    return status;
}
