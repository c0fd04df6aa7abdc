/* nvdb_commit.c - writes the finished grid file from a writer's temporary files.
 *
 * All counts are known by now, and they determine all offsets: the file is written once, from front
 * to back. It is made in blocks. Writing takes longest, so the next blocks are made while one is
 * written. The tables of internal nodes are filled in here. The children of a level are contiguous:
 * the set bits of all nodes of the level above, in order, are its nodes 0, 1, 2, ... */
#include <string.h>
#include <xxhash.h>

#include "base/parallel.h"
#include "formats/grid/nvdb_writer_internal.h"

/* Larger blocks cost less per byte to write, as long as they stay in the processor's cache. */
enum { BLOCK_BYTES = 1 << 20, BLOCK_COUNT = 3 };

struct block {
    uint8_t *bytes; /* BLOCK_BYTES */
    uint64_t size;
};

struct commit {
    struct fmt_nvdb_writer *writer;
    struct bsq_ctx *ctx;
    struct bsq_output *output;
    struct nvdb_layout layout;
    uint64_t at;        /* offset in the file of the next byte */
    int section;        /* the section that is being made */
    uint64_t done;      /* its bytes made so far */
    XXH3_state_t *hash; /* of these bytes */
    uint8_t *head;      /* section NVDB_HEAD */
    struct nvdb_blind blind[NVDB_SECTION_COUNT];
    struct nvdb_record record;
    uint8_t *node;   /* the internal node that is being made */
    uint64_t child;  /* offset in the file of the next node's first child */
    uint8_t *buffer; /* of all blocks */
};

/* ---- the sources of sections ---- */

/* Nodes and stubs begin with their bounds; a stub's mask follows. */
enum { BOUNDS_BYTES = offsetof(struct nvdb_stub, child_mask) };
static_assert(BOUNDS_BYTES == offsetof(struct nvdb_node, flags), "bounds");

static const struct nvdb_level *level_of(int section)
{
    return section == NVDB_UPPERS   ? &fmt_nvdb_upper
           : section == NVDB_LOWERS ? &fmt_nvdb_lower
                                    : NULL;
}

/* Returns the section's size as it follows from its source. */
static uint64_t source_bytes(const struct commit *commit)
{
    const struct nvdb_level *level = level_of(commit->section);
    if (commit->section == NVDB_RECORD || !commit->writer->stream[commit->section][0].ctx)
        return commit->layout.section[commit->section].size;
    const struct nvdb_stream *streams = commit->writer->stream[commit->section];
    return level ? streams[0].size / nvdb_stub_bytes(level) * level->node_bytes
                 : streams[0].size + streams[1].size;
}

/* ---- the bytes of a section ----
 *
 * Each function makes the next bytes of the section: up to *size, which it sets to their number. */

static int make_from_memory(struct commit *commit, const void *section, uint8_t *to, uint64_t *size)
{
    memcpy(to, (const uint8_t *)section + commit->done, *size);
    XXH3_64bits_update(commit->hash, to, *size);
    return 0;
}

/* Makes a node from its stub. *child is the offset in the file of the node's first child; it is
 * moved to the next node's first child. */
static void expand_node(const struct nvdb_level *level, uint64_t node_offset,
                        const struct nvdb_stub *stub, uint8_t *node, uint64_t *child)
{
    static const uint64_t flags = NVDB_NODE_HAS_BBOX;
    const uint64_t mask_bytes = level->words * sizeof *stub->child_mask;
    int64_t *table = (int64_t *)(node + level->node_bytes) - 64 * level->words;
    memset(node, 0, level->node_bytes);
    memcpy(node, stub, BOUNDS_BYTES);
    memcpy(node + BOUNDS_BYTES, &flags, sizeof(flags));
    memcpy(node + sizeof(struct nvdb_node) + mask_bytes, stub->child_mask, mask_bytes);
    for (uint32_t word = 0; word < level->words; word++) {
        for (uint64_t bits = stub->child_mask[word]; bits; bits &= bits - 1) {
            table[64 * word + (uint32_t)__builtin_ctzll(bits)] = (int64_t)(*child - node_offset);
            *child += level->child_bytes;
        }
    }
}

/* Reads the next bytes of a stream. At its end, checks that all were as they were written: the grid
 * must not hold anything else that got into the temporary file. */
static int read_stream(struct commit *commit, struct nvdb_stream *stream, void *to, uint64_t size,
                       uint64_t offset)
{
    int status = bsq_file_read(commit->ctx, &stream->file, to, size, offset);
    if (status)
        return status;
    XXH3_64bits_update(stream->read, to, size);
    if (offset + size == stream->size &&
        XXH3_64bits_digest(stream->read) != XXH3_64bits_digest(stream->written))
        return bsq_fail(commit->ctx, BSQ_EIO, "%s: holds other bytes than were written",
                        stream->file.path);
    return 0;
}

/* Makes the next node in memory. */
static int make_node(struct commit *commit, const struct nvdb_level *level)
{
    struct nvdb_stream *stubs = commit->writer->stream[level->section];
    uint64_t number = commit->done / level->node_bytes;
    uint64_t offset = commit->layout.section[level->section].offset + commit->done;
    struct nvdb_stub stub;
    int status =
        read_stream(commit, stubs, &stub, nvdb_stub_bytes(level), number * nvdb_stub_bytes(level));
    if (status == 0)
        expand_node(level, offset, &stub, commit->node, &commit->child);
    return status;
}

static int make_from_nodes(struct commit *commit, const struct nvdb_level *level, uint8_t *to,
                           uint64_t *size)
{
    uint64_t begun = commit->done % level->node_bytes, left = level->node_bytes - begun;
    int status = begun == 0 ? make_node(commit, level) : 0;
    if (status)
        return status;
    *size = *size < left ? *size : left;
    memcpy(to, commit->node + begun, *size);
    XXH3_64bits_update(commit->hash, to, *size);
    return 0;
}

/* The first stream was hashed when it was written. */
static int make_from_streams(struct commit *commit, struct nvdb_stream streams[2], uint8_t *to,
                             uint64_t *size)
{
    const uint64_t first_bytes = streams[0].size;
    if (commit->done < first_bytes) {
        uint64_t left = first_bytes - commit->done;
        *size = *size < left ? *size : left;
        return read_stream(commit, &streams[0], to, *size, commit->done);
    }
    int status = read_stream(commit, &streams[1], to, *size, commit->done - first_bytes);
    if (status == 0)
        XXH3_64bits_update(commit->hash, to, *size);
    return status;
}

static int make_from_section(struct commit *commit, uint8_t *to, uint64_t *size)
{
    const struct nvdb_level *level = level_of(commit->section);
    switch (commit->section) {
    case NVDB_HEAD:
        return make_from_memory(commit, commit->head, to, size);
    case NVDB_BLIND:
        return make_from_memory(commit, commit->blind, to, size);
    case NVDB_NAMES:
        return make_from_memory(commit, commit->writer->names, to, size);
    case NVDB_RECORD:
        return make_from_memory(commit, &commit->record, to, size);
    default:
        return level ? make_from_nodes(commit, level, to, size)
                     : make_from_streams(commit, commit->writer->stream[commit->section], to, size);
    }
}

/* ---- the file ---- */

static int begin_section(struct commit *commit)
{
    const struct nvdb_level *level = level_of(commit->section);
    if (source_bytes(commit) != commit->layout.section[commit->section].size)
        return bsq_fail(commit->ctx, BSQ_EBUG, "%s: section %d has a wrong size",
                        commit->writer->path, commit->section);
    XXH3_64bits_reset(commit->hash);
    if (level)
        commit->child = commit->layout.section[level->child_section].offset;
    else if (commit->section == NVDB_RECORD)
        commit->record.record_checksum = fmt_nvdb_record_checksum(&commit->record);
    else if (commit->writer->stream[commit->section][0].ctx)
        XXH3_copyState(commit->hash, commit->writer->stream[commit->section][0].written);
    return 0;
}

static void end_section(struct commit *commit)
{
    bool of_ids = commit->section == NVDB_IDS || commit->section == NVDB_NAMES;
    if (commit->section == NVDB_CHANNELS && commit->writer->counts.channel_words > 0)
        commit->record.channels_checksum = XXH3_64bits_digest(commit->hash);
    if (commit->section < NVDB_CHANNELS && (commit->writer->counts.has_ids || !of_ids))
        commit->record.checksum[commit->section] = XXH3_64bits_digest(commit->hash);
    commit->section++;
    commit->done = 0;
}

/* Makes up to *size bytes; sets *size to their number. */
static int make_bytes(struct commit *commit, uint8_t *to, uint64_t *size)
{
    const struct nvdb_range *range = &commit->layout.section[commit->section];
    uint64_t padding = commit->at < range->offset ? range->offset - commit->at : 0;
    if (padding > 0) {
        *size = *size < padding ? *size : padding;
        memset(to, 0, *size);
        return 0;
    }
    int status = commit->done == 0 ? begin_section(commit) : 0;
    if (status)
        return status;
    uint64_t left = range->size - commit->done;
    *size = *size < left ? *size : left;
    if (*size > 0)
        status = make_from_section(commit, to, size);
    commit->done += *size;
    if (commit->done == range->size)
        end_section(commit);
    return status;
}

static int make_block(void *arg, void *slot, uint64_t sequence)
{
    struct commit *commit = arg;
    struct block *block = slot;
    int status = 0;
    block->bytes = commit->buffer + sequence % BLOCK_COUNT * BLOCK_BYTES;
    block->size = 0;
    while (status == 0 && block->size < BLOCK_BYTES && commit->section < NVDB_SECTION_COUNT) {
        uint64_t size = BLOCK_BYTES - block->size;
        status = make_bytes(commit, block->bytes + block->size, &size);
        block->size += size;
        commit->at += size;
    }
    return status ? status : block->size > 0;
}

static int write_block(void *arg, void *slot, uint64_t sequence)
{
    struct commit *commit = arg;
    const struct block *block = slot;
    (void)sequence;
    return bsq_output_write(commit->output, block->bytes, block->size);
}

static int write_blocks(struct commit *commit)
{
    struct block blocks[BLOCK_COUNT];
    struct bsq_pipeline pipeline = {
        .produce = make_block,
        .emit = write_block,
        .arg = commit,
        .slots = blocks,
        .slot_size = sizeof(blocks[0]),
        .slot_count = BLOCK_COUNT,
    };
    return bsq_pipeline_run(commit->ctx, &pipeline);
}

/* Fills in the record "bisque" except for its checksums. */
static void fill_record(const struct fmt_nvdb_writer *writer, struct nvdb_record *record)
{
    const struct fmt_nvdb_info *info = &writer->info;
    memcpy(record->magic, NVDB_RECORD_MAGIC, sizeof(record->magic));
    const bool ids = info->ids != BSQ_IDS_NONE;
    const bool channels = writer->counts.channel_words > 0;
    record->version = (uint32_t)nvdb_record_version(ids, channels);
    record->flags = (info->has_color ? NVDB_RECORD_HAS_COLOR : 0) |
                    (ids ? NVDB_RECORD_HAS_IDS : 0) | (channels ? NVDB_RECORD_HAS_CHANNELS : 0);
    record->name_bytes = writer->counts.name_bytes;
    record->source_triangles = info->source_triangles;
    record->second_count = writer->counts.seconds;
    memcpy(record->scan_min, info->scan_min, sizeof(record->scan_min));
    memcpy(record->scan_max, info->scan_max, sizeof(record->scan_max));
}

/* Fills section NVDB_HEAD with its checksum. */
static void fill_head(const struct fmt_nvdb_writer *writer, const struct nvdb_layout *layout,
                      uint8_t *head)
{
    fmt_nvdb_fill_fixed(&writer->info, &writer->counts, layout, writer->bbox_min, writer->bbox_max,
                        head);
    uint64_t child = layout->section[NVDB_UPPERS].offset - layout->root;
    for (uint32_t i = 0; i < writer->counts.uppers; i++) {
        struct nvdb_tile tile = {.key = writer->keys[i], .child = (int64_t)child};
        memcpy(head + layout->tiles + i * (uint64_t)sizeof(tile), &tile, sizeof(tile));
        child += sizeof(struct nvdb_upper);
    }
    uint32_t checksum[2] = {fmt_nvdb_head_crc(head, layout), UINT32_MAX};
    memcpy(head + FMT_NVDB_GRID_OFFSET + offsetof(struct nvdb_grid_data, checksum), checksum,
           sizeof(checksum));
}

static int set_up(struct commit *commit)
{
    struct fmt_nvdb_writer *writer = commit->writer;
    int status;
    fmt_nvdb_layout_compute(&writer->counts, &commit->layout);
    fmt_nvdb_fill_blind(&commit->layout, commit->blind);
    fill_record(writer, &commit->record);
    BSQ_TRY(bsq_alloc(commit->ctx, "grid header", commit->layout.section[NVDB_HEAD].size, 1,
                      &commit->head));
    BSQ_TRY(bsq_alloc(commit->ctx, "grid nodes", sizeof(struct nvdb_upper), 1, &commit->node));
    BSQ_TRY(bsq_alloc(commit->ctx, "grid blocks", BLOCK_COUNT, BLOCK_BYTES, &commit->buffer));
    fill_head(writer, &commit->layout, commit->head);
    commit->hash = XXH3_createState();
    if (!commit->hash)
        status = bsq_fail(commit->ctx, BSQ_ENOMEM, "no memory for a checksum");
done:
    return status;
}

static int write_file(struct fmt_nvdb_writer *writer)
{
    struct commit commit = {.writer = writer, .ctx = writer->ctx, .output = writer->output};
    int status;
    BSQ_TRY(set_up(&commit));
    BSQ_TRY(bsq_output_expect(commit.output, commit.layout.file_bytes));
    status = write_blocks(&commit);
done:
    XXH3_freeState(commit.hash);
    bsq_free(commit.ctx, commit.buffer);
    bsq_free(commit.ctx, commit.node);
    bsq_free(commit.ctx, commit.head);
    return status;
}

/* Syncs the output (index 0) or closes a temporary file. Both take long, so they run in parallel.
 */
static int sync_or_close(void *arg, uint64_t index, unsigned worker)
{
    struct fmt_nvdb_writer *writer = arg;
    (void)worker;
    if (index == 0)
        return bsq_output_sync(writer->output);
    fmt_nvdb_stream_close(&writer->stream[(index - 1) / 2][(index - 1) % 2]);
    return 0;
}

static void fill_totals(const struct fmt_nvdb_writer *writer, struct fmt_nvdb_totals *totals)
{
    struct nvdb_layout layout;
    fmt_nvdb_layout_compute(&writer->counts, &layout);
    *totals = (struct fmt_nvdb_totals){
        .voxels = writer->counts.voxels,
        .second_records = writer->counts.seconds,
        .leaves = writer->counts.leaves,
        .lowers = writer->counts.lowers,
        .uppers = writer->counts.uppers,
        .file_bytes = layout.file_bytes,
    };
}

int fmt_nvdb_finish(struct fmt_nvdb_writer *writer, struct fmt_nvdb_totals *totals,
                    struct bsq_output **out)
{
    int status;
    *out = NULL;
    BSQ_TRY(fmt_nvdb_writer_finish(writer));
    BSQ_TRY(write_file(writer));
    BSQ_TRY(bsq_parallel_for(writer->ctx, 1 + 2 * NVDB_RECORD, sync_or_close, writer));
    fill_totals(writer, totals);
    *out = writer->output;
    writer->output = NULL;
done:
    fmt_nvdb_discard(writer);
    return status;
}
