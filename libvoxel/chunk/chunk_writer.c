/* chunk_writer.c - see chunk_writer.h.
 *
 * Buckets are taken in Morton order, as many at a time as memory allows: a batch (sort_batch.h). A
 * sorted batch is cut into chunks, which workers build. Triangles after the last cut begin the next
 * batch, so the cuts do not depend on batches. A bucket that is too large for a batch is divided by
 * the next bits of the key. */
#include "libvoxel/chunk/chunk_writer.h"
#include "base/parallel.h"
#include "libvoxel/chunk/sort_batch.h"
#include "libvoxel/chunk/chunk_build.h"

#define CHILD_LEVELS     2u
#define CHILD_PAGE_BYTES 8192u
/* Triangles that a batch with a single slice leaves unused, at most. */
#define SLICE_GAPS 32u

struct batches {
    struct bsq_ctx *ctx;
    const struct scan *scan;
    const struct partition *partition;
    const char *beside;
    struct fmt_tris_writer *writer;

    struct batch batch;
    uint64_t capacity;    /* triangles in a batch */
    uint64_t slice_limit; /* triangles in a slice */
    uint64_t cut;         /* triangles of the batch that are already in chunks */
    bool last;            /* this is the last batch */

    struct chunk_slot *slots;
    unsigned slot_count;
    struct batches_report report;
};

struct chunk_slot {
    struct chunk_builder builder;
    uint64_t first;
    uint32_t count;
};

/* ---- memory ---- */

/* Returns the number of chunks that are built at once: as the limits say, but they take at most
 * half of the memory left. If there is plenty, up to twice as many, because writes sometimes take
 * long. */
static unsigned chunks_count_slots(const struct batches *b, uint64_t left)
{
    uint64_t bytes = vox_chunk_builder_bytes(b->scan->attributes), usual = b->scan->limits->slots;
    uint64_t most = left / 2 / bytes, generous = left / 8 / bytes;
    uint64_t count = usual;
    if (count > most)
        count = most > 1 ? most : 1;
    else if (count < generous)
        count = generous < 2 * usual ? generous : 2 * usual;
    return (unsigned)count;
}

/* Returns the number of triangles that a batch should have. Small batches stay in caches. But
 * threads wait for each other at the end of a batch, so each thread should sort several of its
 * buckets. A batch must also hold whole buckets. If vertices in a file have no order, each batch
 * may read all of them, so few batches are best. */
static uint64_t wanted_capacity(const struct batches *b)
{
    const struct bsq_spill *buckets = &b->partition->buckets;
    if (b->partition->layout.gathered && b->partition->vertices_lack_order)
        return 8 * b->scan->limits->batch_triangles;
    uint64_t wanted = (uint64_t)bsq_threads(b->ctx) << 18, largest = 0;
    for (uint32_t c = 0; c < buckets->stream_count; c++)
        largest = buckets->list[c].items > largest ? buckets->list[c].items : largest;
    if (wanted < 1 << 19)
        wanted = 1 << 19;
    if (wanted < FMT_TRIS_CHUNK_TRIANGLES + 4 * largest)
        wanted = FMT_TRIS_CHUNK_TRIANGLES + 4 * largest;
    return wanted < b->scan->limits->batch_triangles ? wanted : b->scan->limits->batch_triangles;
}

/* Divides the memory left between chunk builders and the batch. */
static void chunks_divide_memory(struct batches *b)
{
    const struct sort_limits *limits = b->scan->limits;
    const uint64_t carry = FMT_TRIS_CHUNK_TRIANGLES, all = vox_batch_capacity_of_all(b->partition);
    uint64_t left = bsq_memory_left(b->ctx);
    left = left > limits->reserve_bytes ? left - limits->reserve_bytes : 0;
    b->slot_count = chunks_count_slots(b, left);
    uint64_t others = b->slot_count * vox_chunk_builder_bytes(b->scan->attributes) +
                      vox_batch_fixed_bytes(b->scan, b->partition);
    left = left > others ? left - others : 0;
    const uint64_t most = left / vox_batch_triangle_bytes(b->scan, b->partition),
                   wanted = wanted_capacity(b);
    b->capacity = most < wanted ? most : wanted;
    bool enough = b->capacity >= all;
    if (enough)
        b->capacity = all;
    if (b->capacity < carry + 4096)
        b->capacity = carry + 4096;
    b->slice_limit = enough ? all : b->capacity - carry - SLICE_GAPS;
}

static int chunks_allocate(struct batches *b)
{
    chunks_divide_memory(b);
    BSQ_PASS(vox_batch_open(&b->batch, b->scan, b->partition, b->capacity));
    BSQ_PASS(BSQ_CALLOC(b->ctx, "sorting", b->slot_count, &b->slots));
    for (unsigned i = 0; i < b->slot_count; i++)
        BSQ_PASS(
            vox_chunk_builder_init(&b->slots[i].builder, b->batch.scan, &b->partition->layout));
    return 0;
}

static void chunks_release(struct batches *b)
{
    for (unsigned i = 0; b->slots && i < b->slot_count; i++)
        vox_chunk_builder_free(&b->slots[i].builder);
    bsq_free(b->ctx, b->slots);
    vox_batch_close(&b->batch);
}

/* ---- chunks ---- */

/* Returns the number of entries of the first chunk, from half of FMT_TRIS_CHUNK_TRIANGLES to all of
 * it. Cuts at the end of the largest Morton cell: between the two neighbours whose keys differ in
 * the highest bit, or the first such pair. There must be more than FMT_TRIS_CHUNK_TRIANGLES sorted
 * entries. */
static uint32_t count_of_first(const struct entry *entries)
{
    uint64_t highest = 0; /* all bits up to the highest one that differed so far */
    uint32_t at = FMT_TRIS_CHUNK_TRIANGLES / 2;
    for (uint32_t i = FMT_TRIS_CHUNK_TRIANGLES / 2; i <= FMT_TRIS_CHUNK_TRIANGLES; i++) {
        uint64_t difference = entries[i - 1].key ^ entries[i].key;
        if (difference > highest) {
            highest = UINT64_MAX >> __builtin_clzll(difference);
            at = i;
        }
    }
    return at;
}

static int chunks_produce(void *arg, void *slot_arg, uint64_t sequence)
{
    struct batches *b = arg;
    struct chunk_slot *slot = slot_arg;
    const uint64_t left = b->batch.count - b->cut;
    (void)sequence;
    if (left == 0 || (left <= FMT_TRIS_CHUNK_TRIANGLES && !b->last))
        return 0;
    slot->first = b->cut;
    slot->count = left <= FMT_TRIS_CHUNK_TRIANGLES ? (uint32_t)left
                                                   : count_of_first(b->batch.entries + b->cut);
    b->cut += slot->count;
    return 1;
}

static int chunks_work(void *arg, void *slot_arg, uint64_t sequence, unsigned worker)
{
    const struct batches *b = arg;
    struct chunk_slot *slot = slot_arg;
    (void)sequence;
    (void)worker;
    return vox_chunk_builder_run(&slot->builder, b->batch.tuples, b->batch.entries + slot->first,
                                 slot->count);
}

static int chunks_emit(void *arg, void *slot_arg, uint64_t sequence)
{
    struct batches *b = arg;
    const struct chunk_slot *slot = slot_arg;
    (void)sequence;
    b->report.chunks++;
    b->report.triangles += slot->count;
    bsq_progress_add(b->ctx, slot->count);
    return fmt_tris_append(b->writer, slot->builder.encoded, slot->builder.encoded_bytes,
                           &slot->builder.info);
}

static int write_batch(struct batches *b)
{
    const struct bsq_pipeline pipeline = {.produce = chunks_produce,
                                          .work = chunks_work,
                                          .emit = chunks_emit,
                                          .arg = b,
                                          .slots = b->slots,
                                          .slot_size = sizeof *b->slots,
                                          .slot_count = b->slot_count};
    BSQ_PASS(vox_batch_sort(&b->batch));
    BSQ_PASS(bsq_pipeline_run(b->ctx, &pipeline));
    vox_batch_carry_over(&b->batch, b->cut);
    b->cut = 0;
    return 0;
}

/* ---- buckets in order ---- */

static int add_slice(struct batches *b, const struct batch_slice *slice)
{
    BSQ_PASS(vox_batch_fits(&b->batch, slice->count) ? 0 : write_batch(b));
    return vox_batch_add(&b->batch, slice);
}

/* Adds a bucket in slices that end with a run. All its triangles have the same key, so their order
 * is that of the scan. */
static int add_in_slices(struct batches *b, const struct batch_slice *whole)
{
    struct run_reader *reader = vox_batch_reader(&b->batch);
    vox_run_reader_seek(reader, whole->buckets, whole->bucket, 0);
    for (uint64_t done = 0; done < whole->count;) {
        struct batch_slice slice = *whole;
        slice.offset = run_reader_tell(reader);
        slice.count = 0;
        while (slice.count + RUN_TRIANGLES <= b->slice_limit && done + slice.count < whole->count) {
            uint32_t count = 0;
            BSQ_PASS(vox_run_reader_next(reader, NULL, &count));
            slice.count += count;
        }
        BSQ_PASS(add_slice(b, &slice));
        done += slice.count;
    }
    return 0;
}

/* Distributes at most RUN_TRIANGLES tuples to the children of their bucket. levels: the children's
 * Morton levels. */
static int divide_run(struct batches *b, const uint8_t *tuples, uint32_t count, uint32_t levels,
                      uint8_t *coded, struct bsq_spill *children)
{
    const uint32_t bytes = b->partition->layout.bytes, mask = children->stream_count - 1;
    for (uint32_t first = 0, end; first < count; first = end) {
        uint32_t child = BSQ_SPILL_NONE;
        for (end = first; end < count; end++) {
            uint32_t number = (uint32_t)(vox_batch_key(&b->batch, tuples + end * bytes) >>
                                         (MORTON_KEY_BITS - 3 * levels)) &
                              mask;
            if (end > first && number != child)
                break;
            child = number;
        }
        const struct run_header header = {.bytes = (end - first) * bytes,
                                          .triangles = (uint16_t)(end - first),
                                          .form = RUN_TUPLES,
                                          .material = RUN_BARE_MATERIAL};
        const uint32_t before = run_header_bytes(&header);
        run_header_put(&header, coded);
        memcpy(coded + before, tuples + first * bytes, header.bytes);
        BSQ_PASS(bsq_spill_add(children, child, coded, before + header.bytes));
        children->list[child].items += end - first;
    }
    return 0;
}

/* Distributes a bucket's triangles to its children. The batch must hold only triangles that were
 * carried over. */
static int divide_bucket(struct batches *b, const struct batch_slice *whole, uint32_t levels,
                         struct bsq_spill *children)
{
    const uint32_t bytes = b->partition->layout.bytes;
    uint8_t *coded = NULL;
    int status =
        bsq_alloc(b->ctx, "sorting", RUN_TRIANGLES * (uint64_t)bytes + RUN_HEADER_MAX, 1, &coded);
    vox_run_reader_seek(vox_batch_reader(&b->batch), whole->buckets, whole->bucket, 0);
    for (uint64_t done = 0, count; status == 0 && done < whole->count; done += count) {
        const uint8_t *tuples;
        status = vox_batch_read(&b->batch, whole->count - done, b->slice_limit, &count, &tuples);
        for (uint64_t first = 0, end; status == 0 && first < count; first = end) {
            end = count - first < RUN_TRIANGLES ? count : first + RUN_TRIANGLES;
            status = divide_run(b, tuples + first * bytes, (uint32_t)(end - first), levels, coded,
                                children);
        }
    }
    bsq_free(b->ctx, coded);
    return status;
}

static int add_buckets(struct batches *b, const struct bsq_spill *buckets, uint32_t levels);

static int add_large_bucket(struct batches *b, const struct batch_slice *whole)
{
    uint32_t levels = whole->levels + CHILD_LEVELS;
    struct bsq_spill children = {0};
    if (whole->levels == MORTON_AXIS_BITS)
        return add_in_slices(b, whole);
    if (levels > MORTON_AXIS_BITS)
        levels = MORTON_AXIS_BITS;
    int status;
    BSQ_TRY(b->batch.slice_count > 0 ? write_batch(b) : 0);
    const uint32_t count = 1u << 3 * (levels - whole->levels);
    BSQ_TRY(bsq_spill_init(&children, b->ctx, "sorted tuples", b->beside, count, count,
                           CHILD_PAGE_BYTES, 0));
    BSQ_TRY(divide_bucket(b, whole, levels, &children));
    BSQ_TRY(add_buckets(b, &children, levels));
    status = write_batch(b); /* it reads the children */
done:
    bsq_spill_free(&children);
    return status;
}

static int add_buckets(struct batches *b, const struct bsq_spill *buckets, uint32_t levels)
{
    for (uint32_t c = 0; c < buckets->stream_count; c++) {
        const struct batch_slice slice = {
            .buckets = buckets, .bucket = c, .levels = levels, .count = buckets->list[c].items};
        if (slice.count == 0)
            continue;
        BSQ_PASS(slice.count <= b->slice_limit ? add_slice(b, &slice)
                                               : add_large_bucket(b, &slice));
    }
    return 0;
}

int vox_write_chunks(const struct scan *scan, const struct partition *partition, const char *beside,
                     struct fmt_tris_writer *writer, struct batches_report *report)
{
    struct batches b = {
        .ctx = scan->ctx, .scan = scan, .partition = partition, .beside = beside, .writer = writer};
    int status = chunks_allocate(&b);
    if (status == 0)
        status = add_buckets(&b, &partition->buckets, partition->levels);
    b.last = true;
    if (status == 0)
        status = write_batch(&b);
    b.report.degenerate = b.batch.degenerate;
    *report = b.report;
    chunks_release(&b);
    return status;
}
