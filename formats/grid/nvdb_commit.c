/* nvdb_commit.c - writes the finished grid file from a writer's temporary file.
 *
 * All counts are known by now, and they determine all offsets. So each section is written by one
 * worker, and several at a time. The tables of internal nodes are filled in here. The children of a
 * level are contiguous: the set bits of all nodes of the level above, in order, are its nodes 0, 1,
 * 2, ... */
#include <string.h>
#include <xxhash.h>

#include "base/parallel.h"
#include "formats/grid/nvdb_writer_internal.h"

/* Larger buffers cost less per byte to write, as long as they stay in the processor's cache. A
 * buffer has space for an upper node. */
enum { BUFFER_BYTES = 1 << 19 };

struct commit {
    struct fmt_nvdb_writer *writer;
    struct fmt_nvdb_layout layout;
    uint8_t *head; /* section NVDB_HEAD */
    struct nvdb_blind blind[NVDB_SECTION_COUNT];
    struct nvdb_trailer trailer;
    uint8_t *buffers; /* BUFFER_BYTES for each worker */
};

/* A section that is being written. */
struct section {
    struct commit *commit;
    int number;
    uint64_t at; /* offset in the file of the next byte */
    XXH3_state_t *hash;
    XXH3_state_t *read;             /* of the bytes of a stream that were read so far */
    struct bsq_spill_cursor cursor; /* in that stream */
    uint8_t *buffer;
};

/* ---- nodes ---- */

/* Nodes and stubs begin with their bounds; a stub's mask follows. */
enum { BOUNDS_BYTES = offsetof(struct nvdb_stub, child_mask) };
static_assert(BOUNDS_BYTES == offsetof(struct nvdb_node, flags), "bounds");

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

static uint64_t stream_bytes(const struct nvdb_stream *stream)
{
    return stream->spill ? stream->spill->list[stream->number].bytes : 0;
}

/* Reads the next bytes of a stream. At its end, checks that all were as they were written: the grid
 * must not hold anything else that got into the temporary file. */
static int nvdb_read_stream(struct section *s, const struct nvdb_stream *stream, void *to,
                            uint64_t size, uint64_t offset)
{
    if (offset == 0) {
        s->cursor = (struct bsq_spill_cursor){0};
        XXH3_64bits_reset(s->read);
    }
    BSQ_PASS(bsq_spill_read(stream->spill, stream->number, offset, size, to, &s->cursor));
    XXH3_64bits_update(s->read, to, size);
    if (offset + size == stream_bytes(stream) &&
        XXH3_64bits_digest(s->read) != XXH3_64bits_digest(stream->written))
        return bsq_fail(stream->spill->ctx, BSQ_EIO, "%s: holds other bytes than were written",
                        stream->spill->file.path);
    return 0;
}

/* ---- sections ---- */

static int nvdb_write_bytes(struct section *s, const void *bytes, uint64_t size)
{
    int status = bsq_output_write_at(s->commit->writer->output, bytes, size, s->at);
    s->at += size;
    return status ? status : bsq_check(s->commit->writer->ctx);
}

static int write_hashed(struct section *s, const void *bytes, uint64_t size)
{
    XXH3_64bits_update(s->hash, bytes, size);
    return nvdb_write_bytes(s, bytes, size);
}

static int write_nodes(struct section *s, const struct nvdb_level *level)
{
    struct nvdb_stream *stubs = s->commit->writer->stream[s->number];
    const uint64_t stub_bytes = nvdb_stub_bytes(level);
    uint64_t child = s->commit->layout.section[level->child_section].offset, fill = 0;
    for (uint64_t at = 0; at < stream_bytes(stubs); at += stub_bytes) {
        struct nvdb_stub stub;
        BSQ_PASS(nvdb_read_stream(s, stubs, &stub, stub_bytes, at));
        if (fill + level->node_bytes > BUFFER_BYTES) {
            BSQ_PASS(write_hashed(s, s->buffer, fill));
            fill = 0;
        }
        expand_node(level, s->at + fill, &stub, s->buffer + fill, &child);
        fill += level->node_bytes;
    }
    return write_hashed(s, s->buffer, fill);
}

/* The first stream was hashed when it was written. */
static int write_streams(struct section *s, struct nvdb_stream streams[2])
{
    XXH3_copyState(s->hash, streams[0].written);
    for (int i = 0; i < 2; i++)
        for (uint64_t at = 0, size, bytes = stream_bytes(&streams[i]); at < bytes; at += size) {
            size = bytes - at < BUFFER_BYTES ? bytes - at : BUFFER_BYTES;
            BSQ_PASS(nvdb_read_stream(s, &streams[i], s->buffer, size, at));
            BSQ_PASS(i == 0 ? nvdb_write_bytes(s, s->buffer, size)
                            : write_hashed(s, s->buffer, size));
        }
    return 0;
}

static int nvdb_write_content(struct section *s)
{
    struct commit *commit = s->commit;
    const uint64_t size = commit->layout.section[s->number].size;
    switch (s->number) {
    case NVDB_HEAD:
        return write_hashed(s, commit->head, size);
    case NVDB_UPPERS:
        return write_nodes(s, &fmt_nvdb_upper);
    case NVDB_LOWERS:
        return write_nodes(s, &fmt_nvdb_lower);
    case NVDB_BLIND:
        return write_hashed(s, commit->blind, size);
    case NVDB_NAMES:
        return write_hashed(s, commit->writer->names, size);
    case NVDB_TRAILER:
        commit->trailer.trailer_checksum = fmt_nvdb_trailer_checksum(&commit->trailer);
        return nvdb_write_bytes(s, &commit->trailer, size);
    default:
        return write_streams(s, commit->writer->stream[s->number]);
    }
}

/* Writes a section and the padding before it, and notes its checksum. */
static int write_section(void *arg, uint64_t number, unsigned worker)
{
    static const uint8_t zeros[NVDB_ALIGNMENT];
    struct commit *commit = arg;
    const struct fmt_nvdb_range *range = &commit->layout.section[number];
    const uint64_t before = number > 0 ? range[-1].offset + range[-1].size : 0;
    struct section s = {.commit = commit,
                        .number = (int)number,
                        .at = before,
                        .buffer = commit->buffers + worker * (uint64_t)BUFFER_BYTES,
                        .hash = XXH3_createState(),
                        .read = XXH3_createState()};
    int status = 0;
    if (!s.hash || !s.read)
        BSQ_TRY(bsq_fail(commit->writer->ctx, BSQ_ENOMEM, "no memory for a checksum"));
    XXH3_64bits_reset(s.hash);
    BSQ_TRY(nvdb_write_bytes(&s, zeros, range->offset - before));
    if (range->size > 0)
        BSQ_TRY(nvdb_write_content(&s));
    if (s.at != range->offset + range->size)
        status = bsq_fail(commit->writer->ctx, BSQ_EBUG, "%s: section %d has a wrong size",
                          commit->writer->path, s.number);
    if (s.number < NVDB_TRAILER && nvdb_has_checksum(commit->trailer.flags, s.number))
        *nvdb_checksum(&commit->trailer, s.number) = XXH3_64bits_digest(s.hash);
done:
    XXH3_freeState(s.read);
    XXH3_freeState(s.hash);
    return status;
}

/* ---- the file ---- */

/* Fills in the trailer except for its checksums. */
static void fill_trailer(const struct fmt_nvdb_writer *writer, struct nvdb_trailer *trailer)
{
    const struct fmt_nvdb_info *info = &writer->info;
    memcpy(trailer->magic, NVDB_TRAILER_MAGIC, sizeof(trailer->magic));
    trailer->flags = writer->counts.flags;
    trailer->version = nvdb_trailer_version(trailer->flags);
    trailer->name_bytes = writer->counts.name_bytes;
    trailer->source_triangles = info->source_triangles;
    trailer->second_count = writer->counts.seconds;
    memcpy(trailer->scan_min, info->scan_min, sizeof(trailer->scan_min));
    memcpy(trailer->scan_max, info->scan_max, sizeof(trailer->scan_max));
}

/* Fills section NVDB_HEAD with its checksum. */
static void fill_head(const struct fmt_nvdb_writer *writer, const struct fmt_nvdb_layout *layout,
                      uint8_t *head)
{
    fmt_nvdb_fill_fixed(&writer->info, &writer->counts, layout, writer->bbox_min, writer->bbox_max,
                        head);
    uint64_t child = layout->section[NVDB_UPPERS].offset - NVDB_ROOT_OFFSET;
    for (uint32_t i = 0; i < writer->counts.uppers; i++) {
        struct nvdb_root_tile tile = {.key = writer->keys[i], .child = (int64_t)child};
        memcpy(head + NVDB_ROOT_TILES_OFFSET + i * (uint64_t)sizeof(tile), &tile, sizeof(tile));
        child += sizeof(struct nvdb_upper);
    }
    uint32_t checksum[2] = {fmt_nvdb_head_crc(head, layout), UINT32_MAX};
    memcpy(head + FMT_NVDB_GRID_OFFSET + offsetof(struct nvdb_grid_data, checksum), checksum,
           sizeof(checksum));
}

static int nvdb_write_file(struct fmt_nvdb_writer *writer)
{
    struct commit commit = {.writer = writer};
    const struct fmt_nvdb_layout *layout = &commit.layout;
    int status;
    fmt_nvdb_layout_compute(&writer->counts, &commit.layout);
    fmt_nvdb_fill_blind(layout, commit.blind);
    fill_trailer(writer, &commit.trailer);
    BSQ_TRY(
        bsq_alloc(writer->ctx, "grid header", layout->section[NVDB_HEAD].size, 1, &commit.head));
    BSQ_TRY(bsq_alloc(writer->ctx, "grid sections", bsq_threads(writer->ctx), BUFFER_BYTES,
                      &commit.buffers));
    fill_head(writer, layout, commit.head);
    BSQ_TRY(bsq_output_expect(writer->output, layout->file_bytes));
    BSQ_TRY(bsq_parallel_for(writer->ctx, NVDB_TRAILER, write_section, &commit));
    status = write_section(&commit, NVDB_TRAILER, 0);
done:
    BSQ_FREE(writer->ctx, commit.buffers, commit.head);
    return status;
}

/* Syncs the output (index 0) or closes the temporary file. Both take long, so they run in parallel.
 */
static int sync_or_close(void *arg, uint64_t index, unsigned worker)
{
    struct fmt_nvdb_writer *writer = arg;
    (void)worker;
    if (index == 0)
        return bsq_output_sync(writer->output);
    bsq_spill_free(&writer->spill);
    return 0;
}

static void fill_totals(const struct fmt_nvdb_writer *writer, struct fmt_nvdb_totals *totals)
{
    struct fmt_nvdb_layout layout;
    fmt_nvdb_layout_compute(&writer->counts, &layout);
    *totals = (struct fmt_nvdb_totals){
        .voxels = writer->counts.voxels,
        .second_records = writer->counts.seconds,
        .leaves = writer->counts.leaves,
        .lowers = writer->counts.lowers,
        .uppers = writer->counts.uppers,
        .file_bytes = layout.file_bytes,
    };
    memcpy(totals->index_min, writer->bbox_min, sizeof totals->index_min);
    memcpy(totals->index_max, writer->bbox_max, sizeof totals->index_max);
}

int fmt_nvdb_finish(struct fmt_nvdb_writer *writer, struct fmt_nvdb_totals *totals,
                    struct bsq_output **out)
{
    int status;
    *out = NULL;
    BSQ_TRY(fmt_nvdb_writer_finish(writer));
    BSQ_TRY(nvdb_write_file(writer));
    BSQ_TRY(bsq_parallel_for(writer->ctx, 2, sync_or_close, writer));
    fill_totals(writer, totals);
    *out = writer->output;
    writer->output = NULL;
done:
    fmt_nvdb_discard(writer);
    return status;
}
