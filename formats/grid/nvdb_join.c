/* nvdb_join.c - joins a writer's sections to the finished .nvdb file.
 *
 * All counts are known by now, and with them the place of everything: the file is written once,
 * from front to back. It is made in blocks; while one is written, which takes longest, the next
 * ones are made. Tables of internal nodes are filled in here: children are contiguous, so the child
 * of a node's set bit is the one after that of the bit before, across all nodes of a level. */
#include <string.h>
#include <xxhash.h>

#include "base/parallel.h"
#include "formats/grid/nvdb_writer_internal.h"

/* The larger a block, the less its bytes cost to write, as long as it stays in the processor's
 * cache until then. */
enum { BLOCK_BYTES = 1 << 20, BLOCK_COUNT = 3 };

struct block {
    uint8_t *bytes; /* BLOCK_BYTES */
    uint64_t size;
};

struct join {
    struct fmt_nvdb_writer *writer;
    struct bsq_ctx *ctx;
    struct bsq_output *output;
    struct nvdb_layout layout;
    int section;        /* being made */
    uint64_t done;      /* bytes of it that were made */
    XXH3_state_t *hash; /* of these */
    uint8_t *head;      /* section NVDB_HEAD */
    struct nvdb_blind blind[NVDB_SECTION_COUNT];
    struct nvdb_record record;
    uint8_t *node;   /* being made */
    uint64_t child;  /* offset in the file of the next node's first child */
    uint8_t *buffer; /* of all blocks */
};

/* ---- where sections come from ---- */

/* What upper and lower nodes differ in. */
struct node_kind {
    int stream;
    enum nvdb_section section, child_section;
    uint64_t node_bytes, stub_bytes, child_bytes;
    uint64_t child_mask, table; /* offsets in the node */
    int words;                  /* of a mask */
};

static const struct node_kind upper_kind = {
    .stream = STREAM_UPPERS,
    .section = NVDB_UPPERS,
    .child_section = NVDB_LOWERS,
    .node_bytes = sizeof(struct nvdb_upper),
    .stub_bytes = sizeof(struct nvdb_upper_stub),
    .child_bytes = sizeof(struct nvdb_lower),
    .child_mask = offsetof(struct nvdb_upper, child_mask),
    .table = offsetof(struct nvdb_upper, table),
    .words = 512,
};
static const struct node_kind lower_kind = {
    .stream = STREAM_LOWERS,
    .section = NVDB_LOWERS,
    .child_section = NVDB_LEAVES,
    .node_bytes = sizeof(struct nvdb_lower),
    .stub_bytes = sizeof(struct nvdb_lower_stub),
    .child_bytes = sizeof(struct nvdb_leaf),
    .child_mask = offsetof(struct nvdb_lower, child_mask),
    .table = offsetof(struct nvdb_lower, table),
    .words = 64,
};

/* Both kinds of node and of stub begin with their bounds; a stub's mask follows them. */
enum { BOUNDS_BYTES = 24 };
static_assert(offsetof(struct nvdb_upper_stub, child_mask) == BOUNDS_BYTES, "stub");
static_assert(offsetof(struct nvdb_lower_stub, child_mask) == BOUNDS_BYTES, "stub");

static const struct node_kind *node_kind(int section)
{
    return section == NVDB_UPPERS ? &upper_kind : section == NVDB_LOWERS ? &lower_kind : NULL;
}

/* What a section that is made of streams begins with, and the second records behind. NULL where
 * there is none. */
struct section_streams {
    const struct nvdb_stream *first, *second;
};

static struct section_streams streams_of(const struct join *join)
{
    const struct nvdb_stream *stream = join->writer->stream;
    switch (join->section) {
    case NVDB_LEAVES:
        return (struct section_streams){.first = &stream[STREAM_LEAVES]};
    case NVDB_NORMALS:
        return (struct section_streams){&stream[STREAM_NORMALS], &stream[STREAM_SECOND_NORMALS]};
    case NVDB_PLANES:
        return (struct section_streams){&stream[STREAM_PLANES], &stream[STREAM_SECOND_PLANES]};
    case NVDB_COLORS:
        if (!join->writer->info.has_color)
            break;
        return (struct section_streams){&stream[STREAM_COLORS], &stream[STREAM_SECOND_COLORS]};
    case NVDB_SECONDS:
        return (struct section_streams){.first = &stream[STREAM_SECOND_WORDS]};
    default:
        break;
    }
    return (struct section_streams){0};
}

/* How large the section will be by what was kept of it. */
static uint64_t kept_bytes(const struct join *join)
{
    const struct node_kind *kind = node_kind(join->section);
    const struct section_streams streams = streams_of(join);
    if (kind)
        return join->writer->stream[kind->stream].file.size / kind->stub_bytes * kind->node_bytes;
    if (streams.first)
        return streams.first->file.size + (streams.second ? streams.second->file.size : 0);
    return join->layout.section[join->section].size;
}

/* ---- bytes of a section ----
 *
 * Each function makes up to *size bytes, those behind what was done; *size becomes how many. */

static int make_from_memory(struct join *join, const void *section, uint8_t *to, uint64_t *size)
{
    memcpy(to, (const uint8_t *)section + join->done, *size);
    XXH3_64bits_update(join->hash, to, *size);
    return 0;
}

/* Expands a stub. *child: offset in the file of the node's first child; moved behind its last. */
static void expand_node(const struct node_kind *kind, uint64_t node_offset, const uint8_t *stub,
                        uint8_t *node, uint64_t *child)
{
    static const uint64_t flags = NVDB_NODE_HAS_BBOX;
    memset(node, 0, kind->node_bytes);
    memcpy(node, stub, BOUNDS_BYTES);
    memcpy(node + BOUNDS_BYTES, &flags, sizeof(flags));
    memcpy(node + kind->child_mask, stub + BOUNDS_BYTES, (size_t)kind->words * 8);
    const uint64_t *mask = (const uint64_t *)(node + kind->child_mask);
    int64_t *table = (int64_t *)(node + kind->table);
    for (int word = 0; word < kind->words; word++) {
        for (uint64_t bits = mask[word]; bits; bits &= bits - 1) {
            table[64 * word + __builtin_ctzll(bits)] = (int64_t)(*child - node_offset);
            *child += kind->child_bytes;
        }
    }
}

/* Makes the whole node that begins here. */
static int make_node(struct join *join, const struct node_kind *kind)
{
    const struct bsq_file *stubs = &join->writer->stream[kind->stream].file;
    uint64_t number = join->done / kind->node_bytes;
    uint64_t offset = join->layout.section[kind->section].offset + join->done;
    uint8_t stub[sizeof(struct nvdb_upper_stub)]; /* or of a lower node, which is smaller */
    int status = bsq_file_read(join->ctx, stubs, stub, kind->stub_bytes, number * kind->stub_bytes);
    if (status == 0)
        expand_node(kind, offset, stub, join->node, &join->child);
    return status;
}

static int make_from_nodes(struct join *join, const struct node_kind *kind, uint8_t *to,
                           uint64_t *size)
{
    uint64_t begun = join->done % kind->node_bytes, left = kind->node_bytes - begun;
    int status = begun == 0 ? make_node(join, kind) : 0;
    if (status)
        return status;
    *size = *size < left ? *size : left;
    memcpy(to, join->node + begun, *size);
    XXH3_64bits_update(join->hash, to, *size);
    return 0;
}

/* The first stream was hashed as it came. */
static int make_from_streams(struct join *join, const struct section_streams *streams, uint8_t *to,
                             uint64_t *size)
{
    const struct bsq_file *first = &streams->first->file;
    if (join->done < first->size) {
        uint64_t left = first->size - join->done;
        *size = *size < left ? *size : left;
        return bsq_file_read(join->ctx, first, to, *size, join->done);
    }
    const struct bsq_file *second = &streams->second->file;
    int status = bsq_file_read(join->ctx, second, to, *size, join->done - first->size);
    if (status == 0)
        XXH3_64bits_update(join->hash, to, *size);
    return status;
}

static int make_from_section(struct join *join, uint8_t *to, uint64_t *size)
{
    const struct node_kind *kind = node_kind(join->section);
    const struct section_streams streams = streams_of(join);
    if (kind)
        return make_from_nodes(join, kind, to, size);
    if (streams.first)
        return make_from_streams(join, &streams, to, size);
    const void *memory = join->section == NVDB_HEAD    ? (const void *)join->head
                         : join->section == NVDB_BLIND ? (const void *)join->blind
                                                       : (const void *)&join->record;
    return make_from_memory(join, memory, to, size);
}

/* ---- the file ---- */

static int begin_section(struct join *join)
{
    const struct node_kind *kind = node_kind(join->section);
    const struct nvdb_stream *first = streams_of(join).first;
    if (kept_bytes(join) != join->layout.section[join->section].size)
        return bsq_fail(join->ctx, BSQ_EBUG, "%s: section %d has a wrong size", join->writer->path,
                        join->section);
    if (first)
        XXH3_copyState(join->hash, first->hash);
    else
        XXH3_64bits_reset(join->hash);
    if (kind)
        join->child = join->layout.section[kind->child_section].offset;
    if (join->section == NVDB_RECORD)
        join->record.record_checksum = fmt_nvdb_record_checksum(&join->record);
    return 0;
}

static void end_section(struct join *join)
{
    if (join->section < NVDB_RECORD)
        join->record.checksum[join->section] = XXH3_64bits_digest(join->hash);
    join->section++;
    join->done = 0;
}

/* Makes up to *size bytes of the file, at offset `at` in it; *size becomes how many. */
static int make_bytes(struct join *join, uint64_t at, uint8_t *to, uint64_t *size)
{
    const struct nvdb_range *range = &join->layout.section[join->section];
    uint64_t padding = at < range->offset ? range->offset - at : 0;
    if (padding > 0) {
        *size = *size < padding ? *size : padding;
        memset(to, 0, *size);
        return 0;
    }
    int status = join->done == 0 ? begin_section(join) : 0;
    if (status)
        return status;
    uint64_t left = range->size - join->done;
    *size = *size < left ? *size : left;
    if (*size > 0)
        status = make_from_section(join, to, size);
    join->done += *size;
    if (join->done == range->size)
        end_section(join);
    return status;
}

static int make_block(void *arg, void *slot, uint64_t sequence)
{
    struct join *join = arg;
    struct block *block = slot;
    int status = 0;
    block->bytes = join->buffer + sequence % BLOCK_COUNT * BLOCK_BYTES;
    block->size = 0;
    while (status == 0 && block->size < BLOCK_BYTES && join->section < NVDB_SECTION_COUNT) {
        uint64_t size = BLOCK_BYTES - block->size;
        status = make_bytes(join, sequence * BLOCK_BYTES + block->size, block->bytes + block->size,
                            &size);
        block->size += size;
    }
    return status ? status : block->size > 0;
}

static int write_block(void *arg, void *slot, uint64_t sequence)
{
    struct join *join = arg;
    const struct block *block = slot;
    (void)sequence;
    return bsq_output_write(join->output, block->bytes, block->size);
}

static int join_blocks(struct join *join)
{
    struct block blocks[BLOCK_COUNT];
    struct bsq_pipeline pipeline = {
        .produce = make_block,
        .emit = write_block,
        .arg = join,
        .slots = blocks,
        .slot_size = sizeof(blocks[0]),
        .slot_count = BLOCK_COUNT,
    };
    return bsq_pipeline_run(join->ctx, &pipeline);
}

/* The record but for its checksums. */
static void fill_record(const struct fmt_nvdb_writer *writer, struct nvdb_record *record)
{
    const struct fmt_nvdb_info *info = &writer->info;
    memcpy(record->magic, NVDB_RECORD_MAGIC, sizeof(record->magic));
    record->version = NVDB_RECORD_VERSION;
    record->flags = info->has_color ? NVDB_RECORD_HAS_COLOR : 0;
    record->source_triangles = info->source_triangles;
    record->second_count = writer->counts.seconds;
    memcpy(record->scan_min, info->scan_min, sizeof(record->scan_min));
    memcpy(record->scan_max, info->scan_max, sizeof(record->scan_max));
}

static int set_up(struct join *join)
{
    struct fmt_nvdb_writer *writer = join->writer;
    fmt_nvdb_layout_compute(&writer->counts, &join->layout);
    fmt_nvdb_fill_blind(&join->layout, join->blind);
    fill_record(writer, &join->record);
    int status =
        bsq_alloc(join->ctx, "grid header", join->layout.section[NVDB_HEAD].size, 1, &join->head);
    if (status == 0)
        status = bsq_alloc(join->ctx, "grid nodes", sizeof(struct nvdb_upper), 1, &join->node);
    if (status == 0)
        status = bsq_alloc(join->ctx, "joining", BLOCK_COUNT, BLOCK_BYTES, &join->buffer);
    if (status)
        return status;
    fmt_nvdb_fill_head(&writer->info, &writer->counts, &join->layout, writer->keys,
                       writer->bbox_min, writer->bbox_max, join->head);
    join->hash = XXH3_createState();
    return join->hash ? 0 : bsq_fail(join->ctx, BSQ_ENOMEM, "no memory for a checksum");
}

static int join_file(struct fmt_nvdb_writer *writer)
{
    struct join join = {.writer = writer, .ctx = writer->ctx, .output = writer->output};
    int status = set_up(&join);
    if (status == 0)
        status = bsq_output_expect(join.output, join.layout.file_bytes);
    if (status == 0)
        status = join_blocks(&join);
    XXH3_freeState(join.hash);
    bsq_free(join.ctx, join.buffer);
    bsq_free(join.ctx, join.node);
    bsq_free(join.ctx, join.head);
    return status;
}

/* Waiting for the disk is a good time to let go of the temporary files: either takes a while. */
static int sync_or_close(void *arg, uint64_t index, unsigned worker)
{
    struct fmt_nvdb_writer *writer = arg;
    (void)worker;
    if (index == 0)
        return bsq_output_sync(writer->output);
    fmt_nvdb_stream_close(&writer->stream[index - 1]);
    return 0;
}

int fmt_nvdb_commit(struct fmt_nvdb_writer *writer, struct fmt_nvdb_totals *totals)
{
    int status = fmt_nvdb_writer_finish(writer);
    if (status == 0)
        status = join_file(writer);
    if (status == 0)
        status = bsq_parallel_for(writer->ctx, 1 + STREAM_COUNT, sync_or_close, writer);
    if (status == 0) {
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
        status = bsq_output_commit(writer->output);
        writer->output = NULL;
    }
    fmt_nvdb_discard(writer);
    return status;
}
