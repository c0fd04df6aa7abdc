/* batches.c - see batches.h.
 *
 * Cells are taken in Morton order, as many at a time as memory allows. Each is loaded and sorted by
 * one worker; what results is one sorted sequence, which is cut into chunks that workers build.
 * Triangles after the last cut begin the next batch, so that the cuts do not depend on batches. A
 * cell that is too large for a batch is first divided by the next bits of the key.
 *
 * Where columns are in files, batches read what they need of these before they sort (window.h). Records name elements of
 * the scan until then, and again when they are carried over. */
#include "libvoxel/batches.h"
#include "base/parallel.h"
#include "libvoxel/area.h"
#include "libvoxel/chunk_build.h"
#include "libvoxel/fans.h"

#define CHILD_LEVELS     2u
#define CHILD_PAGE_BYTES 8192u

/* Triangles of one cell, or a part of them, in the batch. */
struct part {
    const struct cells *cells;
    uint32_t cell;
    uint32_t levels; /* by which the cell is known */
    uint64_t offset; /* of its first run in the cell's bytes */
    uint64_t record; /* where in the batch's records */
    uint64_t at;     /* where in its entries */
    uint64_t count;
    uint64_t own;  /* of these: fans bring triangles that belong to other cells */
    uint64_t kept; /* of its own once they are sorted: others have no area */
};

struct batches {
    struct bsq_ctx *ctx;
    const struct scan *scan; /* or the window's view of it */
    const struct scattered *scattered;
    const char *beside;
    struct fmt_tris_writer *writer;
    struct window *window; /* NULL: columns are in memory, or records are values */
    used_word *used;       /* where vertices of records are marked, or NULL: elsewhere */

    uint64_t capacity;   /* records in a batch */
    uint64_t part_limit; /* triangles in a part */
    uint8_t *records, *spare_records;
    struct entry *entries, *scratch;
    struct run_reader *readers; /* one a thread, and one more for dividing cells */
    struct fan_room *fan_rooms; /* the same, where there are fans */
    unsigned reader_count;
    struct part *parts;
    uint64_t part_count, part_capacity;
    uint64_t largest_part;
    uint64_t count;       /* triangles in the batch; the sorted ones carried over come first */
    uint64_t records_end; /* parts leave a gap behind them, see record_gap() */

    struct chunk_slot *slots;
    unsigned slot_count;
    uint64_t cut; /* triangles that are in chunks already */
    struct batches_report report;
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
    return b->scattered->layout.bytes + 2 * sizeof(struct entry) +
           (b->window ? window_triangle_bytes(b->scan) : 0);
}

/* Records between parts, so that loads past a part's end do not touch what another worker writes.
 */
static uint64_t record_gap(const struct batches *b)
{
    return RECORD_SLACK / b->scattered->layout.bytes + 1;
}

/* Slots for chunks in the making: as many as the limits say, or half of what is left has room for;
 * twice as many where that is little, as writing takes long now and then. */
static unsigned count_slots(const struct batches *b, uint64_t left)
{
    uint64_t bytes = chunk_builder_bytes(b->scan->attributes), usual = b->scan->limits->slots;
    uint64_t most = left / 2 / bytes, generous = left / 8 / bytes;
    uint64_t count = usual;
    if (count > most)
        count = most > 1 ? most : 1;
    else if (count < generous)
        count = generous < 2 * usual ? generous : 2 * usual;
    return (unsigned)count;
}

/* Triangles that a batch should have. A small one touches little memory and stays near the core,
 * but threads wait for each other where one ends, so each is to sort several cells of it; and it
 * must not be too small for cells to be sorted whole. Where vertices have no order either, each batch may read
 * them all, so there are to be few. */
static uint64_t wanted_capacity(const struct batches *b)
{
    const struct cells *cells = &b->scattered->cells;
    if (b->window && b->scattered->vertices_lack_order)
        return 8 * b->scan->limits->batch_triangles;
    uint64_t wanted = (uint64_t)bsq_threads(b->ctx) << 18, largest = 0;
    for (uint32_t c = 0; c < cells->cell_count; c++)
        largest = cells->list[c].items > largest ? cells->list[c].items : largest;
    if (wanted < 1 << 19)
        wanted = 1 << 19;
    if (wanted < FMT_TRIS_CHUNK_TRIANGLES + 4 * largest)
        wanted = FMT_TRIS_CHUNK_TRIANGLES + 4 * largest;
    return wanted < b->scan->limits->batch_triangles ? wanted : b->scan->limits->batch_triangles;
}

/* What chunks in the making leave is for the batch. */
static void divide_memory(struct batches *b)
{
    const struct sort_limits *limits = b->scan->limits;
    const uint64_t carry = FMT_TRIS_CHUNK_TRIANGLES;
    uint64_t used = bsq_memory_used(b->ctx), limit = bsq_memory_limit(b->ctx);
    uint64_t left = limit > used + limits->reserve_bytes ? limit - used - limits->reserve_bytes : 0;
    b->slot_count = count_slots(b, left);
    uint64_t slot_bytes = b->slot_count * chunk_builder_bytes(b->scan->attributes);
    uint64_t carry_bytes = carry * b->scattered->layout.bytes;
    if (b->window)
        carry_bytes += window_bytes(b->scan, bsq_threads(b->ctx)) +
                       (bsq_threads(b->ctx) + 1) * fan_room_bytes(&b->scattered->layout);
    left = left > slot_bytes + carry_bytes ? left - slot_bytes - carry_bytes : 0;
    const uint64_t most = left / triangle_bytes(b), wanted = wanted_capacity(b);
    b->capacity = most < wanted ? most : wanted;
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
    if (b->window) {
        status = window_open(b->window, b->scan, &b->scattered->layout, b->capacity);
        b->scan = &b->window->view;
        b->used = b->window->kinds[FACE_VERTEX].active ? NULL : b->used;
        if (status < 0)
            return status;
    }
    if ((status = bsq_alloc(b->ctx, what, b->capacity * bytes + RECORD_SLACK, 1, &b->records)) <
            0 ||
        (status = bsq_alloc(b->ctx, what, FMT_TRIS_CHUNK_TRIANGLES, bytes, &b->spare_records)) <
            0 ||
        (status = bsq_alloc(b->ctx, what, b->capacity, sizeof *b->entries, &b->entries)) < 0 ||
        (status = bsq_alloc(b->ctx, what, b->capacity, sizeof *b->scratch, &b->scratch)) < 0 ||
        (status = bsq_calloc(b->ctx, what, b->slot_count, sizeof *b->slots, &b->slots)) < 0)
        return status;
    memset(b->records + b->capacity * bytes, 0, RECORD_SLACK);
    b->reader_count = bsq_threads(b->ctx) + 1;
    status = bsq_calloc(b->ctx, what, b->reader_count, sizeof *b->readers, &b->readers);
    for (unsigned i = 0; status == 0 && i < b->reader_count; i++)
        status = run_reader_init(&b->readers[i], b->scan, &b->scattered->layout);
    if (status == 0 && b->scattered->layout.fans)
        status = bsq_calloc(b->ctx, what, b->reader_count, sizeof *b->fan_rooms, &b->fan_rooms);
    for (unsigned i = 0; status == 0 && b->fan_rooms && i < b->reader_count; i++)
        status = fan_room_init(&b->fan_rooms[i], b->ctx, &b->scattered->layout);
    for (unsigned i = 0; status == 0 && i < b->slot_count; i++)
        status = chunk_builder_init(&b->slots[i].builder, b->scan, &b->scattered->layout, b->used);
    return status;
}

static void release(struct batches *b)
{
    for (unsigned i = 0; b->slots && i < b->slot_count; i++)
        chunk_builder_free(&b->slots[i].builder);
    bsq_free(b->ctx, b->slots);
    for (unsigned i = 0; b->readers && i < b->reader_count; i++)
        run_reader_free(&b->readers[i]);
    bsq_free(b->ctx, b->readers);
    bsq_free(b->ctx, b->parts);
    bsq_free(b->ctx, b->scratch);
    bsq_free(b->ctx, b->entries);
    for (unsigned i = 0; b->fan_rooms && i < b->reader_count; i++)
        fan_room_free(&b->fan_rooms[i], b->ctx);
    bsq_free(b->ctx, b->fan_rooms);
    bsq_free(b->ctx, b->spare_records);
    bsq_free(b->ctx, b->records);
    if (b->window)
        window_close(b->window);
}

/* ---- loading and sorting ---- */

static void mark_record(const struct batches *b, const uint8_t *record)
{
    const struct record_layout *layout = &b->scattered->layout;
    for (uint32_t k = 0; b->used && k < 3; k++)
        used_mark(b->used, record_vertex_index(layout, record + k * layout->corner_bytes));
}

/* Entries of records with area; returns their number. */
static uint32_t make_entries(const struct batches *b, const uint8_t *records, uint64_t first, uint32_t count,
                             struct entry *entries)
{
    const struct record_layout *layout = &b->scattered->layout;
    const struct morton_cube cube = b->scattered->cube;
    uint32_t kept = 0;
    for (uint32_t i = 0; i < count; i++) {
        const uint8_t *record = records + (uint64_t)i * layout->bytes;
        float copies[3][3];
        const float *p[3];
        for (uint32_t k = 0; k < 3; k++)
            p[k] = record_position(layout, b->scan, record + k * layout->corner_bytes, copies[k]);
        if (area_is_zero(p[0], p[1], p[2]))
            mark_record(b, record);
        else
            entries[kept++] = (struct entry){.key = morton_point_key(&cube, p[0]), .record = (uint32_t)(first + i)};
    }
    return kept;
}

/* The same of plain records, see record_layout: apart for speed, as widths and places are known. */
static uint32_t make_plain_entries(const struct batches *b, const uint8_t *records, uint64_t first, uint32_t count,
                                   struct entry *entries)
{
    /* Copies, which what is written cannot change as far as the compiler knows. */
    const struct morton_cube cube = b->scattered->cube;
    const struct column positions = b->scan->columns[SCAN_POSITIONS];
    uint32_t kept = 0;
    for (uint32_t i = 0; i < count; i++) {
        uint32_t index[3];
        const float *p[3];
        memcpy(index, records + 12 * (uint64_t)i, sizeof index);
        for (uint32_t k = 0; k < 3; k++)
            p[k] = column_at(&positions, index[k], 12);
        if (area_is_zero(p[0], p[1], p[2]))
            mark_record(b, records + 12 * (uint64_t)i);
        else
            entries[kept++] = (struct entry){.key = morton_point_key(&cube, p[0]), .record = (uint32_t)(first + i)};
    }
    return kept;
}

/* Where a worker may sort a part. The same place for one part after the other, so that it stays in
 * the core's cache; but large parts need one each. */
static struct entry *scratch_for(const struct batches *b, const struct part *part, unsigned worker)
{
    uint64_t share = b->capacity / bsq_threads(b->ctx);
    return b->scratch + (b->largest_part <= share ? worker * share : part->at);
}

/* Makes entries of `count` records of a part, `done` behind its first. */
static void enter_records(struct batches *b, struct part *part, uint64_t done, uint32_t count)
{
    const uint64_t first = part->record + done;
    uint8_t *records = b->records + first * b->scattered->layout.bytes;
    struct entry *to = b->entries + part->at + part->kept;
    if (b->window)
        window_number(b->window, records, count);
    part->kept += b->scattered->layout.plain ? make_plain_entries(b, records, first, count, to)
                                             : make_entries(b, records, first, count, to);
}

/* Reads a part's records, and enters them or, where elements have to be fetched first, marks these. */
static int read_part(void *arg, uint64_t index, unsigned worker)
{
    struct batches *b = arg;
    struct part *part = &b->parts[index];
    struct run_reader *reader = &b->readers[worker];
    run_reader_seek(reader, part->cells, part->cell, part->offset);
    part->kept = 0;
    for (uint64_t done = 0; done < part->count;) {
        uint8_t *records = b->records + (part->record + done) * b->scattered->layout.bytes;
        uint32_t count;
        int status = run_reader_next(reader, records, &count);
        if (status < 0)
            return status;
        if (b->window)
            window_mark(b->window, records, count);
        else
            enter_records(b, part, done, count);
        done += count;
    }
    part->own = part->count;
    return 0;
}

/* Triangles of a cell that were read, with their vertices; returns those that are its own. Cells inside of others were
 * given nothing else. */
static uint64_t keep_own(struct batches *b, const struct part *part, uint8_t *records, uint64_t count, unsigned worker)
{
    const struct scattered *scattered = b->scattered;
    if (!b->fan_rooms || part->cells != &scattered->cells)
        return count;
    return fans_split(b->window, &b->fan_rooms[worker], &scattered->cube, part->levels, part->cell, records, count);
}

static void order_part(struct batches *b, struct part *part, unsigned worker)
{
    order_sort(b->entries + part->at, scratch_for(b, part, worker), part->kept,
               MORTON_KEY_BITS - 3 * part->levels);
}

static int sort_part(void *arg, uint64_t index, unsigned worker)
{
    struct batches *b = arg;
    int status = read_part(b, index, worker);
    if (status == 0)
        order_part(b, &b->parts[index], worker);
    return status;
}

/* The same of a part that was read. */
static int sort_fetched(void *arg, uint64_t index, unsigned worker)
{
    struct batches *b = arg;
    struct part *part = &b->parts[index];
    part->own = keep_own(b, part, b->records + part->record * b->scattered->layout.bytes, part->count, worker);
    for (uint64_t done = 0, count; done < part->own; done += count) {
        count = part->own - done < RUN_TRIANGLES ? part->own - done : RUN_TRIANGLES;
        enter_records(b, part, done, (uint32_t)count);
    }
    order_part(b, part, worker);
    return 0;
}

static int sort_window(struct batches *b)
{
    const uint64_t carried = b->part_count > 0 ? b->parts[0].at : b->count;
    window_clear(b->window);
    window_mark(b->window, b->records, carried);
    int status = bsq_parallel_for(b->ctx, b->part_count, read_part, b);
    if (status == 0)
        status = window_fetch(b->window, b->scattered->used);
    if (status < 0)
        return status;
    window_number(b->window, b->records, carried);
    return bsq_parallel_for(b->ctx, b->part_count, sort_fetched, b);
}

/* Triangles that are not kept leave gaps behind the entries of a part. */
static void close_gaps(struct batches *b)
{
    uint64_t end = b->part_count > 0 ? b->parts[0].at : b->count;
    for (uint64_t i = 0; i < b->part_count; i++) {
        const struct part *part = &b->parts[i];
        if (part->at != end)
            memmove(b->entries + end, b->entries + part->at, part->kept * sizeof *b->entries);
        end += part->kept;
        b->report.degenerate += part->own - part->kept;
    }
    bsq_progress_add(b->ctx, b->count - end);
    b->count = end;
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
    b->report.chunks++;
    b->report.triangles += slot->count;
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
    if (b->window)
        window_restore(b->window, b->records, left);
    memmove(b->entries, b->entries + b->cut, left * sizeof *b->entries);
    for (uint64_t i = 0; i < left; i++)
        b->entries[i].record = (uint32_t)i;
    b->count = left;
    b->records_end = left + record_gap(b);
    b->cut = 0;
    b->part_count = b->largest_part = 0;
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
    int status = b->window ? sort_window(b) : bsq_parallel_for(b->ctx, b->part_count, sort_part, b);
    if (status < 0)
        return status;
    close_gaps(b);
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
    b->largest_part = part.count > b->largest_part ? part.count : b->largest_part;
    b->count += part.count;
    b->records_end += part.count + record_gap(b);
    return 0;
}

/* All triangles of the cell have the same key: their order is the scan's. Parts end where runs do.
 */
static int add_in_parts(struct batches *b, const struct part *whole)
{
    struct run_reader *reader = &b->readers[b->reader_count - 1];
    int status = 0;
    run_reader_seek(reader, whole->cells, whole->cell, 0);
    for (uint64_t done = 0; status == 0 && done < whole->count;) {
        struct part part = *whole;
        part.offset = run_reader_tell(reader);
        part.count = 0;
        while (status == 0 && part.count + RUN_TRIANGLES <= b->part_limit &&
               done + part.count < whole->count) {
            uint32_t count = 0;
            status = run_reader_next(reader, NULL, &count);
            part.count += count;
        }
        if (status == 0)
            status = add_part(b, part);
        done += part.count;
    }
    return status;
}

static uint64_t record_key(const struct batches *b, const uint8_t *record)
{
    const struct record_layout *layout = &b->scattered->layout;
    float copy[3];
    const float *position;
    if (b->window)
        position = window_position(b->window, record_vertex_index(layout, record));
    else
        position = record_position(layout, b->scan, record, copy);
    return morton_point_key(&b->scattered->cube, position);
}

/* Distributes at most RUN_TRIANGLES records to the children of their cell; `mask` is for their numbers. */
static int divide_run(struct batches *b, const uint8_t *records, uint32_t count, uint32_t levels,
                      uint32_t mask, uint8_t *coded, struct cells *children)
{
    const struct record_layout *layout = &b->scattered->layout;
    const uint32_t bytes = layout->bytes;
    int status = 0;
    for (uint32_t first = 0, end; status == 0 && first < count; first = end) {
        uint32_t child = CELLS_NONE;
        for (end = first; end < count; end++) {
            uint32_t number = (uint32_t)(record_key(b, records + end * bytes) >> (MORTON_KEY_BITS - 3 * levels)) & mask;
            if (end > first && number != child)
                break;
            child = number;
        }
        uint8_t *coded_end =
            run_put_records(layout, records + first * bytes, end - first, coded);
        status = cells_add(children, child, coded, (uint64_t)(coded_end - coded), end - first);
    }
    return status;
}

/* Reads the next records of a cell, of which `left` are left, to where a batch would have them. */
static int read_records(struct batches *b, struct run_reader *reader, uint64_t left, uint64_t *count)
{
    uint8_t *records = b->records + b->records_end * b->scattered->layout.bytes;
    int status = bsq_check(b->ctx);
    *count = 0;
    while (status == 0 && *count < left && *count + RUN_TRIANGLES <= b->part_limit) {
        uint32_t more;
        status = run_reader_next(reader, records + *count * b->scattered->layout.bytes, &more);
        *count += status == 0 ? more : 0;
    }
    if (status < 0 || !b->window)
        return status;
    window_clear(b->window);
    window_mark(b->window, records, *count);
    return window_fetch(b->window, NULL);
}

/* Distributes the triangles of a cell to the cells inside of it. There is nothing else in the batch but what was carried
 * over. */
static int divide_cell(struct batches *b, const struct part *whole, uint32_t levels,
                       struct cells *children)
{
    const uint32_t bytes = b->scattered->layout.bytes;
    const uint32_t mask = (1u << 3 * (levels - whole->levels)) - 1;
    uint8_t *records = b->records + b->records_end * bytes;
    struct run_reader *reader = &b->readers[b->reader_count - 1];
    uint8_t *coded = NULL;
    int status = bsq_alloc(b->ctx, "sorting", RUN_TRIANGLES * (uint64_t)bytes + sizeof(struct run_header), 1, &coded);
    run_reader_seek(reader, whole->cells, whole->cell, 0);
    for (uint64_t done = 0, count; status == 0 && done < whole->count; done += count) {
        status = read_records(b, reader, whole->count - done, &count);
        const uint64_t own = status == 0 ? keep_own(b, whole, records, count, b->reader_count - 1) : 0;
        bsq_progress_add(b->ctx, status == 0 ? count - own : 0);
        for (uint64_t first = 0, end; status == 0 && first < own; first = end) {
            end = own - first < RUN_TRIANGLES ? own : first + RUN_TRIANGLES;
            status = divide_run(b, records + first * bytes, (uint32_t)(end - first), levels, mask, coded, children);
        }
    }
    bsq_free(b->ctx, coded);
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
    int status = b->part_count > 0 ? write_batch(b) : 0;
    if (status < 0)
        return status;
    status = cells_init(&children, b->ctx, b->beside, 1u << 3 * (levels - whole->levels),
                        CHILD_PAGE_BYTES, 0);
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
            .cells = cells, .cell = c, .levels = levels, .count = cells->list[c].items};
        if (part.count == 0)
            continue;
        status = part.count <= b->part_limit ? add_part(b, part) : add_large_cell(b, &part);
    }
    return status;
}

int batches_write(const struct scan *scan, const struct scattered *scattered, const char *beside,
                  struct fmt_tris_writer *writer, struct batches_report *report)
{
    const struct record_layout *layout = &scattered->layout;
    struct window window = {0};
    struct batches b = {
        .ctx = scan->ctx,
        .scan = scan,
        .scattered = scattered,
        .beside = beside,
        .writer = writer,
        .window = layout->windowed ? &window : NULL,
        .used = layout->by_value ? NULL : scattered->used,
    };
    int status = allocate(&b);
    if (status == 0)
        status = add_cells(&b, &scattered->cells, scattered->levels);
    b.last = true;
    if (status == 0)
        status = write_batch(&b);
    *report = b.report;
    release(&b);
    return status;
}
