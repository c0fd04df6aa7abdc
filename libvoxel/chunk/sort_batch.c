/* sort_batch.c - see sort_batch.h. One worker reads and sorts each slice. Slices are added in the
 * order of their buckets, so together they are one sorted sequence. */
#include "libvoxel/chunk/sort_batch.h"
#include "base/parallel.h"

#include <math.h>

/* ---- memory ---- */

uint64_t vox_batch_triangle_bytes(const struct scan *scan, const struct partition *partition)
{
    const struct tuple_layout *layout = &partition->layout;
    return layout->bytes + 2 * sizeof(struct entry) +
           (layout->gathered ? vox_gather_triangle_bytes(scan) : 0);
}

uint64_t vox_batch_fixed_bytes(const struct scan *scan, const struct partition *partition)
{
    const struct tuple_layout *layout = &partition->layout;
    const unsigned threads = bsq_threads(scan->ctx);
    uint64_t bytes = FMT_TRIS_CHUNK_TRIANGLES * (uint64_t)layout->bytes;
    if (layout->gathered)
        bytes += vox_gather_bytes(scan, threads);
    return bytes;
}

/* Returns the tuples to leave free between slices: loads past a slice's end must not read what
 * another worker writes. */
static uint64_t tuple_gap(const struct tuple_layout *layout)
{
    return TUPLE_SLACK / layout->bytes + 1;
}

uint64_t vox_batch_capacity_of_all(const struct partition *partition)
{
    return partition->triangles +
           2 * tuple_gap(&partition->layout) * partition->buckets.stream_count;
}

static int open_window(struct batch *b)
{
    int status = vox_gather_open(&b->window, b->scan, &b->partition->layout, b->capacity);
    b->scan = &b->window.view;
    return status;
}

static int open_readers(struct batch *b)
{
    const struct tuple_layout *layout = &b->partition->layout;
    b->reader_count = bsq_threads(b->ctx) + 1;
    BSQ_PASS(BSQ_CALLOC(b->ctx, "sorting", b->reader_count, &b->readers));
    for (unsigned i = 0; i < b->reader_count; i++)
        BSQ_PASS(vox_run_reader_init(&b->readers[i], b->scan, layout));
    return 0;
}

int vox_batch_open(struct batch *b, const struct scan *scan, const struct partition *partition,
                   uint64_t capacity)
{
    const char *what = "sorting";
    const uint32_t bytes = partition->layout.bytes;
    *b = (struct batch){.ctx = scan->ctx,
                        .scan = scan,
                        .partition = partition,
                        .gathered = partition->layout.gathered,
                        .capacity = capacity};
    BSQ_PASS(b->gathered ? open_window(b) : 0);
    BSQ_PASS(bsq_alloc(b->ctx, what, capacity * bytes + TUPLE_SLACK, 1, &b->tuples));
    BSQ_PASS(bsq_alloc(b->ctx, what, FMT_TRIS_CHUNK_TRIANGLES, bytes, &b->spare_tuples));
    BSQ_PASS(BSQ_ALLOC(b->ctx, what, capacity, &b->entries));
    BSQ_PASS(BSQ_ALLOC(b->ctx, what, capacity, &b->scratch));
    memset(b->tuples + capacity * bytes, 0, TUPLE_SLACK);
    return open_readers(b);
}

void vox_batch_close(struct batch *b)
{
    for (unsigned i = 0; b->readers && i < b->reader_count; i++)
        vox_run_reader_free(&b->readers[i]);
    BSQ_FREE(b->ctx, b->readers, b->slices, b->scratch, b->entries, b->spare_tuples, b->tuples);
    vox_gather_close(&b->window);
    memset(b, 0, sizeof *b);
}

/* ---- entries ---- */

/* Returns whether x - y, a component of u x v, is not zero in spite of float32 rounding. */
static inline bool area_differs(float x, float y)
{
    float size = fabsf(x) + fabsf(y);
    return fabsf(x - y) > 1e-5f * size && size > 1e-30f;
}

/* Returns whether float32 is enough to see that the triangle has an area. */
static inline bool area_is_sure(const float *a, const float *b, const float *c)
{
    float u0 = b[0] - a[0], u1 = b[1] - a[1], u2 = b[2] - a[2];
    float v0 = c[0] - a[0], v1 = c[1] - a[1], v2 = c[2] - a[2];
    return area_differs(u1 * v2, u2 * v1) || area_differs(u2 * v0, u0 * v2) ||
           area_differs(u0 * v1, u1 * v0);
}

/* Returns whether the corners are repeated or collinear. Exact for coordinates of similar size:
 * products of their differences are exact in double. */
static inline bool area_is_zero(const float *a, const float *b, const float *c)
{
    if (area_is_sure(a, b, c))
        return false;
    double u[3], v[3];
    for (int i = 0; i < 3; i++) {
        u[i] = (double)b[i] - a[i];
        v[i] = (double)c[i] - a[i];
    }
    return u[1] * v[2] == u[2] * v[1] && u[2] * v[0] == u[0] * v[2] && u[0] * v[1] == u[1] * v[0];
}

/* Positions are prefetched this many tuples ahead. */
#define CORNERS_AHEAD 16u

/* Makes entries for the tuples with an area and returns their count. Inlined, so that widths and
 * offsets of a constant layout are constants. */
static inline __attribute__((always_inline)) uint32_t
batch_make_entries(const struct batch *b, const struct tuple_layout *layout, const uint8_t *tuples,
                   uint64_t first, uint32_t count, struct entry *entries)
{
    /* Local copies, so that the compiler knows that writes to `entries` cannot change them. */
    const struct morton_cube cube = b->partition->cube;
    const struct attribute_stream positions = b->scan->streams[SCAN_POSITIONS];
    uint32_t kept = 0;
    for (uint32_t i = 0; i < count; i++) {
        const uint8_t *tuple = tuples + (uint64_t)i * layout->bytes;
        const float *p[3];
        for (uint32_t k = 0; k < 3 && i + CORNERS_AHEAD < count; k++)
            __builtin_prefetch(
                stream_at(&positions,
                          tuple_vertex_index(layout, tuple + CORNERS_AHEAD * layout->bytes +
                                                         k * layout->corner_bytes),
                          12));
        for (uint32_t k = 0; k < 3; k++)
            p[k] = stream_at(&positions,
                             tuple_vertex_index(layout, tuple + k * layout->corner_bytes), 12);
        if (!area_is_zero(p[0], p[1], p[2]))
            entries[kept++] = (struct entry){.key = morton_point_key(&cube, p[0]),
                                             .tuple = (uint32_t)(first + i)};
    }
    return kept;
}

/* Makes entries for `count` tuples of a slice, from its tuple `done` on. */
static void enter_tuples(struct batch *b, struct batch_slice *slice, uint64_t done, uint32_t count)
{
    static const struct tuple_layout plain = {
        .index_bytes = {[FMT_MESH_VERTEX] = 4}, .corner_bytes = 4, .bytes = 12};
    const uint64_t first = slice->tuple + done;
    uint8_t *tuples = b->tuples + first * b->partition->layout.bytes;
    struct entry *to = b->entries + slice->at + slice->kept;
    if (b->gathered)
        vox_gather_number(&b->window, tuples, count);
    slice->kept += b->partition->layout.plain
                       ? batch_make_entries(b, &plain, tuples, first, count, to)
                       : batch_make_entries(b, &b->partition->layout, tuples, first, count, to);
}

/* ---- sorting by key ----
 *
 * A least-significant-digit radix sort orders entries by their upper 20 bits, or by 30 bits if
 * there are many. Few entries then share these bits: seven levels below its own, a bucket of a
 * surface has about 4^7 occupied cells. Such entries are sorted by insertion, or by their next bits
 * if many. */

#define DIGIT_BITS  10u
#define DIGITS_MAX  3u
#define DIGIT_MASK  ((1u << DIGIT_BITS) - 1)
#define SMALL_COUNT 24u
/* Up to this count two digits are enough. An even number of passes ends in `entries`. */
#define TWO_DIGITS_COUNT (1u << 15)

static void insertion_sort(struct entry *entries, uint64_t n)
{
    for (uint64_t i = 1; i < n; i++) {
        struct entry moving = entries[i];
        uint64_t at = i;
        for (; at > 0 && entries[at - 1].key > moving.key; at--)
            entries[at] = entries[at - 1];
        entries[at] = moving;
    }
}

static void count_digits(const struct entry *entries, uint64_t n, uint32_t shift, uint32_t digits,
                         uint32_t counts[DIGITS_MAX][1u << DIGIT_BITS])
{
    memset(counts, 0, digits * sizeof counts[0]);
    for (uint64_t i = 0; i < n; i++) {
        uint64_t key = entries[i].key >> shift;
        for (uint32_t d = 0; d < digits; d++)
            counts[d][key >> d * DIGIT_BITS & DIGIT_MASK]++;
    }
}

/* Turns counts of one digit into first positions. False: all entries have the same digit. */
static bool start_positions(uint32_t counts[1u << DIGIT_BITS], uint64_t n)
{
    uint32_t sum = 0;
    for (uint32_t i = 0; i <= DIGIT_MASK; i++) {
        uint32_t count = counts[i];
        if (count == n)
            return false;
        counts[i] = sum;
        sum += count;
    }
    return true;
}

static void sort_digits(struct entry *entries, struct entry *scratch, uint64_t n, uint32_t shift,
                        uint32_t digits)
{
    uint32_t counts[DIGITS_MAX][1u << DIGIT_BITS];
    struct entry *from = entries, *to = scratch;
    count_digits(entries, n, shift, digits, counts);
    for (uint32_t d = 0; d < digits; d++) {
        if (!start_positions(counts[d], n))
            continue;
        for (uint64_t i = 0; i < n; i++)
            to[counts[d][from[i].key >> (shift + d * DIGIT_BITS) & DIGIT_MASK]++] = from[i];
        struct entry *filled = to;
        to = from;
        from = filled;
    }
    if (from != entries)
        memcpy(entries, from, n * sizeof *entries);
}

/* Sorts by key; entries with equal keys keep their order. Keys may differ only in their low `bits`
 * bits. scratch: n entries. */
static void radix_sort(struct entry *entries, struct entry *scratch, uint64_t n, uint32_t bits)
{
    if (n <= SMALL_COUNT) {
        insertion_sort(entries, n);
        return;
    }
    uint32_t digits = n <= TWO_DIGITS_COUNT ? 2 : DIGITS_MAX;
    uint32_t shift = bits > digits * DIGIT_BITS ? bits - digits * DIGIT_BITS : 0;
    sort_digits(entries, scratch, n, shift, digits);
    for (uint64_t begin = 0, end; shift > 0 && begin < n; begin = end) {
        uint64_t prefix = entries[begin].key >> shift;
        for (end = begin + 1; end < n && entries[end].key >> shift == prefix; end++)
            ;
        if (end - begin > 1)
            radix_sort(entries + begin, scratch, end - begin, shift);
    }
}

/* ---- slices ---- */

bool vox_batch_fits(const struct batch *b, uint64_t triangles)
{
    return b->tuples_end + triangles + tuple_gap(&b->partition->layout) <= b->capacity;
}

int vox_batch_add(struct batch *b, const struct batch_slice *slice)
{
    BSQ_PASS(BSQ_GROW(b->ctx, "sorting", b->slice_count + 1, &b->slices, &b->slice_capacity));
    struct batch_slice *added = &b->slices[b->slice_count++];
    *added = *slice;
    added->at = b->count;
    added->tuple = b->tuples_end;
    b->largest_slice = slice->count > b->largest_slice ? slice->count : b->largest_slice;
    b->count += slice->count;
    b->tuples_end += slice->count + tuple_gap(&b->partition->layout);
    return 0;
}

/* Reads a slice's tuples and makes their entries, of several runs at a time if these are short:
 * tuples that were just written cost a wait. If elements must be gathered first, only marks
 * these. */
static int read_slice(void *arg, uint64_t index, unsigned worker)
{
    struct batch *b = arg;
    struct batch_slice *slice = &b->slices[index];
    struct run_reader *reader = &b->readers[worker];
    vox_run_reader_seek(reader, slice->buckets, slice->bucket, slice->offset);
    slice->kept = 0;
    for (uint64_t done = 0, entered = 0; done < slice->count;) {
        uint8_t *tuples = b->tuples + (slice->tuple + done) * b->partition->layout.bytes;
        uint32_t count;
        BSQ_PASS(vox_run_reader_next(reader, tuples, &count));
        done += count;
        if (b->gathered)
            vox_gather_mark(&b->window, tuples, count);
        else if (done - entered >= RUN_TRIANGLES || done == slice->count) {
            enter_tuples(b, slice, entered, (uint32_t)(done - entered));
            entered = done;
        }
    }
    return 0;
}

/* Returns scratch memory to sort a slice. A worker uses the same memory for all its slices, so it
 * stays in the core's cache; but large slices need memory of their own. */
static struct entry *scratch_for(const struct batch *b, const struct batch_slice *slice,
                                 unsigned worker)
{
    uint64_t share = b->capacity / bsq_threads(b->ctx);
    return b->scratch + (b->largest_slice <= share ? worker * share : slice->at);
}

static void order_slice(struct batch *b, struct batch_slice *slice, unsigned worker)
{
    radix_sort(b->entries + slice->at, scratch_for(b, slice, worker), slice->kept,
               MORTON_KEY_BITS - 3 * slice->levels);
}

static int sort_slice(void *arg, uint64_t index, unsigned worker)
{
    struct batch *b = arg;
    int status = read_slice(b, index, worker);
    if (status == 0)
        order_slice(b, &b->slices[index], worker);
    return status;
}

/* Sorts a slice that was read and whose elements were fetched. */
static int sort_fetched(void *arg, uint64_t index, unsigned worker)
{
    struct batch *b = arg;
    struct batch_slice *slice = &b->slices[index];
    for (uint64_t done = 0, count; done < slice->count; done += count) {
        count = slice->count - done < RUN_TRIANGLES ? slice->count - done : RUN_TRIANGLES;
        enter_tuples(b, slice, done, (uint32_t)count);
    }
    order_slice(b, slice, worker);
    return 0;
}

static int sort_gathered(struct batch *b, uint64_t carried)
{
    vox_gather_clear(&b->window);
    vox_gather_mark(&b->window, b->tuples, carried);
    BSQ_PASS(bsq_parallel_for(b->ctx, b->slice_count, read_slice, b));
    BSQ_PASS(vox_gather_fetch(&b->window));
    vox_gather_number(&b->window, b->tuples, carried);
    return bsq_parallel_for(b->ctx, b->slice_count, sort_fetched, b);
}

/* Closes the gaps that triangles without area leave after slices. */
static void close_gaps(struct batch *b, uint64_t carried)
{
    uint64_t end = carried;
    for (uint64_t i = 0; i < b->slice_count; i++) {
        const struct batch_slice *slice = &b->slices[i];
        if (slice->at != end)
            memmove(b->entries + end, b->entries + slice->at, slice->kept * sizeof *b->entries);
        end += slice->kept;
        b->degenerate += slice->count - slice->kept;
    }
    bsq_progress_add(b->ctx, b->count - end);
    b->count = end;
}

int vox_batch_sort(struct batch *b)
{
    const uint64_t carried = b->slice_count > 0 ? b->slices[0].at : b->count;
    int status = b->gathered ? sort_gathered(b, carried)
                             : bsq_parallel_for(b->ctx, b->slice_count, sort_slice, b);
    if (status == 0)
        close_gaps(b, carried);
    return status;
}

void vox_batch_carry_over(struct batch *b, uint64_t first)
{
    const uint32_t bytes = b->partition->layout.bytes;
    const uint64_t left = b->count - first;
    for (uint64_t i = 0; i < left; i++)
        memcpy(b->spare_tuples + i * bytes,
               b->tuples + (uint64_t)b->entries[first + i].tuple * bytes, bytes);
    memcpy(b->tuples, b->spare_tuples, left * bytes);
    if (b->gathered)
        vox_gather_restore(&b->window, b->tuples, left);
    memmove(b->entries, b->entries + first, left * sizeof *b->entries);
    for (uint64_t i = 0; i < left; i++)
        b->entries[i].tuple = (uint32_t)i;
    b->count = left;
    b->tuples_end = left + tuple_gap(&b->partition->layout);
    b->slice_count = b->largest_slice = 0;
}

/* ---- buckets that are not sorted but divided ---- */

struct run_reader *vox_batch_reader(struct batch *b)
{
    return &b->readers[b->reader_count - 1];
}

int vox_batch_read(struct batch *b, uint64_t left, uint64_t most, uint64_t *count,
                   const uint8_t **out)
{
    uint8_t *tuples = b->tuples + b->tuples_end * b->partition->layout.bytes;
    *out = tuples;
    *count = 0;
    BSQ_PASS(bsq_check(b->ctx));
    while (*count < left && *count + RUN_TRIANGLES <= most) {
        uint32_t more;
        BSQ_PASS(vox_run_reader_next(vox_batch_reader(b),
                                     tuples + *count * b->partition->layout.bytes, &more));
        *count += more;
    }
    if (!b->gathered)
        return 0;
    vox_gather_clear(&b->window);
    vox_gather_mark(&b->window, tuples, *count);
    return vox_gather_fetch(&b->window);
}

uint64_t vox_batch_key(const struct batch *b, const uint8_t *tuple)
{
    const struct tuple_layout *layout = &b->partition->layout;
    const float *position = b->gathered
                                ? gather_position(&b->window, tuple_vertex_index(layout, tuple))
                                : tuple_position(layout, b->scan, tuple);
    return morton_point_key(&b->partition->cube, position);
}
