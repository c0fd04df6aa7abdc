/* batches.c - see batches.h.
 *
 * Cells are taken in Morton order, as many at a time as memory allows. Each is loaded and sorted by
 * one worker; what results is one sorted sequence, which is cut into chunks that workers build.
 * Triangles after the last cut begin the next batch, so that the cuts do not depend on batches. A
 * cell that is too large for a batch is first divided by the next bits of the key. */
#include "libvoxel/batches.h"
#include "base/parallel.h"
#include "libvoxel/chunk_build.h"

#define CHILD_LEVELS     2u
#define CHILD_PAGE_BYTES 8192u
#define MOVE_RECORDS     4096u

/* Records of one cell, or a part of them, in the batch. */
struct part {
    const struct cells *cells;
    uint32_t cell;
    uint32_t levels; /* by which the cell is known */
    uint64_t first;  /* record of the cell */
    uint64_t record; /* where in the batch's records */
    uint64_t at;     /* where in its entries */
    uint64_t count;
};

struct batches {
    struct bsq_ctx *ctx;
    const struct scan *scan;
    const struct scattered *scattered;
    const char *beside;
    struct fmt_tris_writer *writer;

    uint64_t capacity;   /* records in a batch */
    uint64_t part_limit; /* triangles in a part */
    uint8_t *records, *spare_records;
    struct entry *entries, *scratch;
    struct part *parts;
    uint64_t part_count, part_capacity;
    uint64_t count;       /* triangles in the batch; the sorted ones carried over come first */
    uint64_t records_end; /* parts leave a gap behind them, see record_gap() */

    struct chunk_slot *slots;
    unsigned slot_count;
    uint64_t cut; /* triangles that are in chunks already */
    uint64_t chunks;
    bool last; /* nothing follows this batch */
};

struct chunk_slot {
    struct chunk_builder builder;
    uint64_t first;
    uint32_t count;
};

/* ---- memory ---- */

static uint64_t triangle_bytes(const struct batches *b)
{
    return b->scattered->layout.bytes + 2 * sizeof(struct entry);
}

/* Records between parts, so that loads past a part's end do not touch what another worker writes.
 */
static uint64_t record_gap(const struct batches *b)
{
    return RECORD_SLACK / b->scattered->layout.bytes + 1;
}

/* Half of what is left for chunks in the making, the rest for the batch. */
static void divide_memory(struct batches *b)
{
    const struct sort_limits *limits = b->scan->limits;
    const uint64_t carry = FMT_TRIS_CHUNK_TRIANGLES;
    uint64_t used = bsq_memory_used(b->ctx), limit = bsq_memory_limit(b->ctx);
    uint64_t left = limit > used + limits->reserve_bytes ? limit - used - limits->reserve_bytes : 0;
    uint64_t slots = left / 2 / chunk_builder_bytes(b->scan->attributes);
    b->slot_count = slots < 1 ? 1 : (unsigned)(slots < limits->slots ? slots : limits->slots);
    uint64_t slot_bytes = b->slot_count * chunk_builder_bytes(b->scan->attributes);
    uint64_t carry_bytes = carry * b->scattered->layout.bytes;
    left = left > slot_bytes + carry_bytes ? left - slot_bytes - carry_bytes : 0;
    b->capacity = left / triangle_bytes(b);
    if (b->capacity > limits->batch_triangles)
        b->capacity = limits->batch_triangles;
    uint64_t all = b->scattered->triangles + 2 * record_gap(b) * b->scattered->cells.cell_count;
    bool enough = b->capacity >= all;
    if (enough)
        b->capacity = all;
    if (b->capacity < carry + 4096)
        b->capacity = carry + 4096;
    b->part_limit = enough ? all : (b->capacity - carry) / 2;
}

static int allocate(struct batches *b)
{
    const char *what = "sorting";
    const uint32_t bytes = b->scattered->layout.bytes;
    int status;
    divide_memory(b);
    if ((status = bsq_alloc(b->ctx, what, b->capacity * bytes + RECORD_SLACK, 1, &b->records)) <
            0 ||
        (status = bsq_alloc(b->ctx, what, FMT_TRIS_CHUNK_TRIANGLES, bytes, &b->spare_records)) <
            0 ||
        (status = bsq_alloc(b->ctx, what, b->capacity, sizeof *b->entries, &b->entries)) < 0 ||
        (status = bsq_alloc(b->ctx, what, b->capacity, sizeof *b->scratch, &b->scratch)) < 0 ||
        (status = bsq_calloc(b->ctx, what, b->slot_count, sizeof *b->slots, &b->slots)) < 0)
        return status;
    memset(b->records + b->capacity * bytes, 0, RECORD_SLACK);
    for (unsigned i = 0; status == 0 && i < b->slot_count; i++)
        status = chunk_builder_init(&b->slots[i].builder, b->scan, &b->scattered->layout);
    return status;
}

static void release(struct batches *b)
{
    for (unsigned i = 0; b->slots && i < b->slot_count; i++)
        chunk_builder_free(&b->slots[i].builder);
    bsq_free(b->ctx, b->slots);
    bsq_free(b->ctx, b->parts);
    bsq_free(b->ctx, b->scratch);
    bsq_free(b->ctx, b->entries);
    bsq_free(b->ctx, b->spare_records);
    bsq_free(b->ctx, b->records);
}

/* ---- loading and sorting ---- */

static int sort_part(void *arg, uint64_t index, unsigned worker)
{
    struct batches *b = arg;
    const struct part *part = &b->parts[index];
    const uint32_t bytes = b->scattered->layout.bytes;
    struct cell_cursor cursor = {0};
    (void)worker;
    int status = cells_read(part->cells, part->cell, part->first, part->count,
                            b->records + part->record * bytes, &cursor);
    if (status < 0)
        return status;
    for (uint64_t i = 0; i < part->count; i++) {
        const uint8_t *record = b->records + (part->record + i) * bytes;
        b->entries[part->at + i] =
            (struct entry){.key = scattered_key(b->scattered, b->scan, record),
                           .record = (uint32_t)(part->record + i)};
    }
    order_sort(b->entries + part->at, b->scratch + part->at, part->count,
               MORTON_KEY_BITS - 3 * part->levels);
    return 0;
}

/* ---- chunks ---- */

static int produce(void *arg, void *slot_arg, uint64_t sequence)
{
    struct batches *b = arg;
    struct chunk_slot *slot = slot_arg;
    const uint64_t left = b->count - b->cut;
    (void)sequence;
    if (left == 0 || (left <= FMT_TRIS_CHUNK_TRIANGLES && !b->last))
        return 0;
    slot->first = b->cut;
    slot->count =
        left <= FMT_TRIS_CHUNK_TRIANGLES ? (uint32_t)left : order_cut(b->entries + b->cut);
    b->cut += slot->count;
    return 1;
}

static int work(void *arg, void *slot_arg, uint64_t sequence, unsigned worker)
{
    const struct batches *b = arg;
    struct chunk_slot *slot = slot_arg;
    (void)sequence;
    (void)worker;
    return chunk_builder_run(&slot->builder, b->records, b->entries + slot->first, slot->count);
}

static int emit(void *arg, void *slot_arg, uint64_t sequence)
{
    struct batches *b = arg;
    const struct chunk_slot *slot = slot_arg;
    (void)sequence;
    b->chunks++;
    bsq_progress_add(b->ctx, slot->count);
    return fmt_tris_append(b->writer, slot->builder.encoded, slot->builder.encoded_bytes,
                           &slot->builder.info);
}

/* Moves what is left after the last cut to the batch's beginning, records in sorted order. */
static void carry_over(struct batches *b)
{
    const uint32_t bytes = b->scattered->layout.bytes;
    uint64_t left = b->count - b->cut;
    for (uint64_t i = 0; i < left; i++)
        memcpy(b->spare_records + i * bytes,
               b->records + (uint64_t)b->entries[b->cut + i].record * bytes, bytes);
    memcpy(b->records, b->spare_records, left * bytes);
    memmove(b->entries, b->entries + b->cut, left * sizeof *b->entries);
    for (uint64_t i = 0; i < left; i++)
        b->entries[i].record = (uint32_t)i;
    b->count = left;
    b->records_end = left + record_gap(b);
    b->cut = 0;
    b->part_count = 0;
}

static int write_batch(struct batches *b)
{
    const struct bsq_pipeline pipeline = {.produce = produce,
                                          .work = work,
                                          .emit = emit,
                                          .arg = b,
                                          .slots = b->slots,
                                          .slot_size = sizeof *b->slots,
                                          .slot_count = b->slot_count};
    int status = bsq_parallel_for(b->ctx, b->part_count, sort_part, b);
    if (status == 0)
        status = bsq_pipeline_run(b->ctx, &pipeline);
    if (status == 0)
        carry_over(b);
    return status;
}

/* ---- cells in order ---- */

static int add_part(struct batches *b, struct part part)
{
    int status = 0;
    if (b->records_end + part.count + record_gap(b) > b->capacity)
        status = write_batch(b);
    if (status == 0)
        status = bsq_grow(b->ctx, "sorting", b->part_count + 1, sizeof *b->parts, &b->parts,
                          &b->part_capacity);
    if (status < 0)
        return status;
    part.at = b->count;
    part.record = b->records_end;
    b->parts[b->part_count++] = part;
    b->count += part.count;
    b->records_end += part.count + record_gap(b);
    return 0;
}

/* All triangles of the cell have the same key: their order is the scan's. */
static int add_in_parts(struct batches *b, const struct part *whole)
{
    int status = 0;
    for (uint64_t done = 0; status == 0 && done < whole->count;) {
        struct part part = *whole;
        part.first = whole->first + done;
        part.count = whole->count - done < b->part_limit ? whole->count - done : b->part_limit;
        status = add_part(b, part);
        done += part.count;
    }
    return status;
}

/* Distributes the records of a cell to the cells inside of it. */
static int divide_cell(struct batches *b, const struct part *whole, uint32_t levels,
                       struct cells *children)
{
    const uint32_t bytes = b->scattered->layout.bytes;
    const uint32_t mask = (1u << 3 * (levels - whole->levels)) - 1;
    struct cell_cursor cursor = {0};
    uint8_t *buffer;
    int status =
        bsq_alloc(b->ctx, "sorting", MOVE_RECORDS * (uint64_t)bytes + RECORD_SLACK, 1, &buffer);
    for (uint64_t done = 0; status == 0 && done < whole->count;) {
        uint64_t count = whole->count - done < MOVE_RECORDS ? whole->count - done : MOVE_RECORDS;
        if ((status = bsq_check(b->ctx)) == 0)
            status = cells_read(whole->cells, whole->cell, done, count, buffer, &cursor);
        for (uint64_t i = 0; status == 0 && i < count; i++) {
            uint64_t key = scattered_key(b->scattered, b->scan, buffer + i * bytes);
            uint32_t child = (uint32_t)(key >> (MORTON_KEY_BITS - 3 * levels)) & mask;
            status = cells_add(children, child, buffer + i * bytes, 1);
        }
        done += count;
    }
    bsq_free(b->ctx, buffer);
    return status;
}

static int add_cells(struct batches *b, const struct cells *cells, uint32_t levels);

static int add_large_cell(struct batches *b, const struct part *whole)
{
    uint32_t levels = whole->levels + CHILD_LEVELS;
    struct cells children;
    if (whole->levels == MORTON_AXIS_BITS)
        return add_in_parts(b, whole);
    if (levels > MORTON_AXIS_BITS)
        levels = MORTON_AXIS_BITS;
    int status = cells_init(&children, b->ctx, b->beside, 1u << 3 * (levels - whole->levels),
                            b->scattered->layout.bytes, CHILD_PAGE_BYTES, 0);
    if (status == 0)
        status = divide_cell(b, whole, levels, &children);
    if (status == 0)
        status = add_cells(b, &children, levels);
    if (status == 0)
        status = write_batch(b); /* before its cells are gone */
    cells_free(&children);
    return status;
}

static int add_cells(struct batches *b, const struct cells *cells, uint32_t levels)
{
    int status = 0;
    for (uint32_t c = 0; status == 0 && c < cells->cell_count; c++) {
        struct part part = {
            .cells = cells, .cell = c, .levels = levels, .count = cells->list[c].records};
        if (part.count == 0)
            continue;
        status = part.count <= b->part_limit ? add_part(b, part) : add_large_cell(b, &part);
    }
    return status;
}

int batches_write(const struct scan *scan, const struct scattered *scattered, const char *beside,
                  struct fmt_tris_writer *writer, uint64_t *chunks)
{
    struct batches b = {
        .ctx = scan->ctx, .scan = scan, .scattered = scattered, .beside = beside, .writer = writer};
    int status = allocate(&b);
    if (status == 0)
        status = add_cells(&b, &scattered->cells, scattered->levels);
    b.last = true;
    if (status == 0)
        status = write_batch(&b);
    *chunks = b.chunks;
    release(&b);
    return status;
}
