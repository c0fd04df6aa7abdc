/* nvdb_join.c - joins a writer's sections to the finished .nvdb file.
 *
 * All counts are known by now, and with them the place of everything: the file is written once,
 * from front to back. Tables of internal nodes are filled in here: children are contiguous, so the
 * child of a node's set bit is the one after that of the bit before, across all nodes of a level.
 */
#include <string.h>
#include <xxhash.h>

#include "formats/nvdb_writer_internal.h"

struct join {
    struct fmt_nvdb_writer *writer;
    struct bsq_ctx *ctx;
    struct bsq_output *output;
    struct nvdb_layout layout;
    struct nvdb_record record;
    XXH3_state_t *hash; /* of the section being written */
    uint8_t *buffer;    /* BUFFER_BYTES */
};

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
enum { BOUNDS_BYTES = 24, BUFFER_BYTES = sizeof(struct nvdb_upper) };
static_assert(offsetof(struct nvdb_upper_stub, child_mask) == BOUNDS_BYTES, "stub");
static_assert(offsetof(struct nvdb_lower_stub, child_mask) == BOUNDS_BYTES, "stub");

static int write_hashed(struct join *join, const void *data, uint64_t size)
{
    XXH3_64bits_update(join->hash, data, (size_t)size);
    return bsq_output_write(join->output, data, size);
}

static int join_head(struct join *join)
{
    struct fmt_nvdb_writer *writer = join->writer;
    uint64_t size = join->layout.section[NVDB_HEAD].size;
    uint8_t *head;
    int status = bsq_alloc(join->ctx, "grid header", size, 1, &head);
    if (status)
        return status;
    nvdb_fill_head(&writer->info, &writer->counts, &join->layout, writer->keys, writer->bbox_min,
                   writer->bbox_max, head);
    status = write_hashed(join, head, size);
    bsq_free(join->ctx, head);
    return status;
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

static int join_nodes(struct join *join, const struct node_kind *kind)
{
    const struct nvdb_range *range = &join->layout.section[kind->section];
    uint64_t child = join->layout.section[kind->child_section].offset;
    uint64_t batch = BUFFER_BYTES / kind->node_bytes, count = range->size / kind->node_bytes;
    uint8_t *stubs;
    int status = bsq_alloc(join->ctx, "grid nodes", batch, kind->stub_bytes, &stubs);
    for (uint64_t done = 0; done < count && status == 0; done += batch) {
        uint64_t n = count - done < batch ? count - done : batch;
        status = bsq_file_read(join->ctx, &join->writer->stream[kind->stream].file, stubs,
                               n * kind->stub_bytes, done * kind->stub_bytes);
        if (status)
            break;
        for (uint64_t i = 0; i < n; i++)
            expand_node(kind, range->offset + (done + i) * kind->node_bytes,
                        stubs + i * kind->stub_bytes, join->buffer + i * kind->node_bytes, &child);
        status = write_hashed(join, join->buffer, n * kind->node_bytes);
        if (status == 0)
            status = bsq_check(join->ctx);
    }
    bsq_free(join->ctx, stubs);
    return status;
}

/* Copies a section that was hashed as it came; joining goes on from that hash. */
static int join_stream(struct join *join, int stream)
{
    const struct nvdb_stream *from = &join->writer->stream[stream];
    XXH3_copyState(join->hash, from->hash);
    int status = bsq_check(join->ctx);
    return status ? status : bsq_output_copy(join->output, &from->file, 0, from->file.size);
}

/* Second records go behind the first ones of the same channel. */
static int join_seconds(struct join *join, int stream)
{
    const struct bsq_file *file = &join->writer->stream[stream].file;
    int status = 0;
    for (uint64_t done = 0; done < file->size && status == 0;) {
        uint64_t n = file->size - done < BUFFER_BYTES ? file->size - done : BUFFER_BYTES;
        status = bsq_file_read(join->ctx, file, join->buffer, n, done);
        if (status == 0)
            status = write_hashed(join, join->buffer, n);
        if (status == 0)
            status = bsq_check(join->ctx);
        done += n;
    }
    return status;
}

static int join_channel(struct join *join, int first, int second)
{
    int status = join_stream(join, first);
    return status ? status : join_seconds(join, second);
}

static int join_blind(struct join *join)
{
    struct nvdb_blind blind[NVDB_SECTION_COUNT];
    nvdb_fill_blind(&join->layout, blind);
    return write_hashed(join, blind, join->layout.section[NVDB_BLIND].size);
}

static int join_record(struct join *join)
{
    const struct fmt_nvdb_info *info = &join->writer->info;
    struct nvdb_record *record = &join->record;
    memcpy(record->magic, NVDB_RECORD_MAGIC, sizeof(record->magic));
    record->version = NVDB_RECORD_VERSION;
    record->flags = info->has_color ? NVDB_RECORD_HAS_COLOR : 0;
    record->source_triangles = info->source_triangles;
    record->second_count = join->writer->counts.seconds;
    memcpy(record->scan_min, info->scan_min, sizeof(record->scan_min));
    memcpy(record->scan_max, info->scan_max, sizeof(record->scan_max));
    record->record_checksum = nvdb_record_checksum(record);
    return bsq_output_write(join->output, record, sizeof(*record));
}

static int join_section(struct join *join, enum nvdb_section section)
{
    switch (section) {
    case NVDB_HEAD:
        return join_head(join);
    case NVDB_UPPERS:
        return join_nodes(join, &upper_kind);
    case NVDB_LOWERS:
        return join_nodes(join, &lower_kind);
    case NVDB_LEAVES:
        return join_stream(join, STREAM_LEAVES);
    case NVDB_BLIND:
        return join_blind(join);
    case NVDB_NORMALS:
        return join_channel(join, STREAM_NORMALS, STREAM_SECOND_NORMALS);
    case NVDB_PLANES:
        return join_channel(join, STREAM_PLANES, STREAM_SECOND_PLANES);
    case NVDB_COLORS:
        return join_channel(join, STREAM_COLORS, STREAM_SECOND_COLORS);
    case NVDB_SECONDS:
        return join_stream(join, STREAM_SECOND_WORDS);
    default:
        return join_record(join);
    }
}

static int join_sections(struct join *join)
{
    for (int i = 0; i < NVDB_SECTION_COUNT; i++) {
        const struct nvdb_range *range = &join->layout.section[i];
        XXH3_64bits_reset(join->hash);
        int status = 0;
        if (i >= NVDB_NORMALS)
            status = bsq_output_align(join->output, NVDB_ALIGNMENT);
        if (status == 0 && range->size > 0)
            status = join_section(join, (enum nvdb_section)i);
        if (status)
            return status;
        if (bsq_output_tell(join->output) != range->offset + range->size)
            return bsq_fail(join->ctx, BSQ_EBUG, "%s: section %d has a wrong size",
                            join->writer->path, i);
        if (i < NVDB_RECORD)
            join->record.checksum[i] = XXH3_64bits_digest(join->hash);
    }
    return 0;
}

static int join_file(struct fmt_nvdb_writer *writer)
{
    struct join join = {.writer = writer, .ctx = writer->ctx, .output = writer->output};
    nvdb_layout_compute(&writer->counts, &join.layout);
    int status = bsq_alloc(join.ctx, "grid nodes", BUFFER_BYTES, 1, &join.buffer);
    if (status)
        return status;
    join.hash = XXH3_createState();
    status = join.hash ? join_sections(&join)
                       : bsq_fail(join.ctx, BSQ_ENOMEM, "no memory for a checksum");
    XXH3_freeState(join.hash);
    bsq_free(join.ctx, join.buffer);
    return status;
}

int fmt_nvdb_commit(struct fmt_nvdb_writer *writer, struct fmt_nvdb_totals *totals)
{
    int status = nvdb_writer_finish(writer);
    if (status == 0)
        status = join_file(writer);
    if (status == 0) {
        struct nvdb_layout layout;
        nvdb_layout_compute(&writer->counts, &layout);
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
