/* gather_window.c - see gather_window.h. */
#include "libvoxel/chunk/gather_window.h"
#include "base/parallel.h"

#include <assert.h>

#define WIDEST_ELEMENT 12u
/* One read covers at most a range. It includes up to GAP_WORDS words without marks in a row,
 * because a further call would cost more. */
#define GAP_WORDS    3u
#define BUFFER_BYTES ((uint64_t)64 * GATHER_RANGE_WORDS * WIDEST_ELEMENT)

/* Returns whether a stream of this kind is needed and in a file. */
static bool is_active(const struct scan *scan, enum fmt_mesh_kind kind)
{
    bool active = false;
    for (int i = 0; i < SCAN_STREAM_COUNT; i++)
        active |= scan_kind_of(i) == kind && scan_keeps(scan, i) &&
                  bsq_spill_in_file(&scan->streams[i].spill);
    return active;
}

static uint64_t range_count(const struct gather_kind *kind)
{
    return gather_words(kind->count) / GATHER_RANGE_WORDS + 1;
}

static uint64_t range_end(const struct gather_kind *kind, uint64_t range)
{
    const uint64_t end = (range + 1) * GATHER_RANGE_WORDS, words = gather_words(kind->count);
    return end < words ? end : words;
}

static bool range_has_marks(const struct gather_kind *kind, uint64_t range)
{
    return atomic_load_explicit(&kind->ranges[range], memory_order_relaxed);
}

/* ---- memory ---- */

uint64_t vox_gather_bytes(const struct scan *scan, unsigned threads)
{
    uint64_t bytes = threads * BUFFER_BYTES;
    for (int kind = 0; kind < FMT_MESH_KIND_COUNT; kind++)
        if (is_active(scan, kind))
            bytes += gather_words(scan_count(scan, scan_stream_of(kind))) *
                     (sizeof(gather_word) + sizeof(uint32_t) + 1); /* 1: more than ranges take */
    return bytes;
}

uint64_t vox_gather_triangle_bytes(const struct scan *scan)
{
    uint64_t bytes = 0;
    for (int i = 0; i < SCAN_STREAM_COUNT; i++)
        if (scan_keeps(scan, i) && is_active(scan, scan_kind_of(i)))
            bytes += 3 * scan->streams[i].element_bytes;
    return bytes;
}

/* Opens a stream of the view; it is one page. */
static int window_open_stream(struct gather_window *w, enum scan_stream number, uint64_t triangles)
{
    const struct attribute_stream *from = &w->scan->streams[number];
    struct attribute_stream *stream = &w->view.streams[number];
    const uint64_t most = from->count < 3 * triangles ? from->count : 3 * triangles;
    int status = bsq_alloc(w->ctx, "sorting", most, from->element_bytes, &w->elements[number]);
    *stream = (struct attribute_stream){.element_bytes = from->element_bytes, .shift = 32};
    stream->spill.slabs = &w->elements[number];
    return status;
}

static int open_kind(struct gather_window *w, enum fmt_mesh_kind number)
{
    struct gather_kind *kind = &w->kinds[number];
    kind->active = is_active(w->scan, number);
    kind->count = scan_count(w->scan, scan_stream_of(number));
    if (!kind->active)
        return 0;
    BSQ_PASS(BSQ_CALLOC(w->ctx, "sorting", gather_words(kind->count), &kind->marks));
    BSQ_PASS(BSQ_ALLOC(w->ctx, "sorting", gather_words(kind->count), &kind->ranks));
    BSQ_PASS(BSQ_ALLOC(w->ctx, "sorting", range_count(kind), &kind->range_ranks));
    return BSQ_CALLOC(w->ctx, "sorting", range_count(kind), &kind->ranges);
}

int vox_gather_open(struct gather_window *w, const struct scan *scan,
                    const struct tuple_layout *layout, uint64_t triangles)
{
    *w = (struct gather_window){.ctx = scan->ctx, .scan = scan, .layout = layout, .view = *scan};
    assert(triangles <= UINT32_MAX / 3);
    BSQ_PASS(bsq_alloc(w->ctx, "sorting", bsq_threads(w->ctx), BUFFER_BYTES, &w->buffers));
    for (int kind = 0; kind < FMT_MESH_KIND_COUNT; kind++)
        BSQ_PASS(open_kind(w, kind));
    for (int i = 0; i < SCAN_STREAM_COUNT; i++)
        if (scan_keeps(scan, i) && w->kinds[scan_kind_of(i)].active)
            BSQ_PASS(window_open_stream(w, i, triangles));
    return 0;
}

void vox_gather_close(struct gather_window *w)
{
    if (!w->ctx)
        return;
    for (int i = 0; i < SCAN_STREAM_COUNT; i++)
        bsq_free(w->ctx, w->elements[i]);
    for (int kind = 0; kind < FMT_MESH_KIND_COUNT; kind++) {
        BSQ_FREE(w->ctx, w->kinds[kind].marks, w->kinds[kind].ranks, w->kinds[kind].range_ranks,
                 w->kinds[kind].ranges);
    }
    bsq_free(w->ctx, w->buffers);
    memset(w, 0, sizeof *w);
}

/* ---- marks ---- */

void vox_gather_clear(struct gather_window *w)
{
    for (int i = 0; i < FMT_MESH_KIND_COUNT; i++) {
        struct gather_kind *kind = &w->kinds[i];
        for (uint64_t range = 0; kind->active && range < range_count(kind); range++) {
            const uint64_t begin = range * GATHER_RANGE_WORDS;
            if (!range_has_marks(kind, range))
                continue;
            memset((void *)(kind->marks + begin), 0,
                   (range_end(kind, range) - begin) * sizeof *kind->marks);
            atomic_store_explicit(&kind->ranges[range], 0, memory_order_relaxed);
        }
    }
}

static inline void window_mark(const struct gather_kind *kind, uint64_t index)
{
    gather_word *word = &kind->marks[index / 64];
    const uint64_t bit = (uint64_t)1 << index % 64;
    if (atomic_load_explicit(word, memory_order_relaxed) & bit)
        return;
    atomic_fetch_or_explicit(word, bit, memory_order_relaxed);
    atomic_store_explicit(&kind->ranges[index / 64 / GATHER_RANGE_WORDS], 1, memory_order_relaxed);
}

static void mark_plain(const struct gather_kind *kind, const uint8_t *tuples, uint64_t count)
{
    for (uint64_t c = 0; c < 3 * count; c++) {
        uint32_t index;
        memcpy(&index, tuples + 4 * c, 4);
        window_mark(kind, index);
    }
}

/* Returns the offset of an index in consecutive tuples. corner: counted over all tuples. */
static inline uint64_t corner_offset(const struct tuple_layout *layout, enum fmt_mesh_kind kind,
                                     uint64_t corner)
{
    return corner / 3 * layout->bytes + corner % 3 * layout->corner_bytes + layout->index_at[kind];
}

/* Returns the bytes of an index of this kind, or 0 if its streams are in memory or not needed. */
static inline uint32_t index_bytes_of(const struct gather_window *w, enum fmt_mesh_kind kind)
{
    return w->kinds[kind].active ? w->layout->index_bytes[kind] : 0;
}

void vox_gather_mark(struct gather_window *w, const uint8_t *tuples, uint64_t count)
{
    if (w->layout->plain) {
        mark_plain(&w->kinds[FMT_MESH_VERTEX], tuples, count);
        return;
    }
    for (int i = 0; i < FMT_MESH_KIND_COUNT; i++) {
        const struct gather_kind *kind = &w->kinds[i];
        const uint32_t bytes = index_bytes_of(w, i);
        for (uint64_t c = 0; bytes > 0 && c < 3 * count; c++) {
            const uint64_t index = tuple_load(tuples + corner_offset(w->layout, i, c), bytes);
            if (index < kind->count) /* others are "none" */
                window_mark(kind, index);
        }
    }
}

/* Computes the ranks of marked elements. */
static void rank(struct gather_kind *kind)
{
    uint32_t before = 0;
    for (uint64_t range = 0; range < range_count(kind); range++) {
        kind->range_ranks[range] = before;
        for (uint64_t i = range * GATHER_RANGE_WORDS;
             range_has_marks(kind, range) && i < range_end(kind, range); i++) {
            uint64_t marks = atomic_load_explicit(&kind->marks[i], memory_order_relaxed);
            kind->ranks[i] = before;
            before += (uint32_t)__builtin_popcountll(marks);
        }
    }
    kind->marked = before;
}

/* ---- reading ---- */

struct fetch {
    struct gather_window *window;
    enum scan_stream stream;
};

static uint64_t word_at(const struct gather_kind *kind, uint64_t word)
{
    return atomic_load_explicit(&kind->marks[word], memory_order_relaxed);
}

/* Copies the marked elements of words [first, end) to the view. from: the first word's elements. */
static void window_gather(const struct gather_kind *kind, uint64_t first, uint64_t end,
                          const uint8_t *from, uint32_t bytes, uint8_t *elements)
{
    uint8_t *to = elements + (uint64_t)kind->ranks[first] * bytes;
    for (uint64_t word = first; word < end; word++, from += 64 * bytes)
        for (uint64_t marks = word_at(kind, word); marks;) {
            unsigned at = (unsigned)__builtin_ctzll(marks), run = 64 - at;
            if (~(marks >> at))
                run = (unsigned)__builtin_ctzll(~(marks >> at));
            memcpy(to, from + (uint64_t)at * bytes, (uint64_t)run * bytes);
            to += (uint64_t)run * bytes;
            marks &= at + run < 64 ? UINT64_MAX << (at + run) : 0;
        }
}

/* Returns the end of the words that one read takes, from `first` to `end` at most. Its last word
 * has marks. */
static uint64_t read_end(const struct gather_kind *kind, uint64_t first, uint64_t end)
{
    uint64_t last = first;
    for (uint64_t word = first + 1; word < end && word - last <= GAP_WORDS; word++)
        last = word_at(kind, word) ? word : last;
    return last + 1;
}

/* Scales fine colours in a buffer, and reads the colours beside them to its end. */
static int scale_fine_colors(const struct scan *scan, uint64_t first, uint64_t count,
                             uint32_t *buffer)
{
    const int status = stream_read(&scan->streams[SCAN_COLORS], first, count, buffer + count);
    if (status == 0)
        vox_scan_scale_colors(scan, first, count, buffer + count, buffer);
    return status;
}

static int fetch_range(void *arg, uint64_t number, unsigned worker)
{
    const struct fetch *fetch = arg;
    struct gather_window *w = fetch->window;
    const struct gather_kind *kind = &w->kinds[scan_kind_of(fetch->stream)];
    const struct attribute_stream *stream = &w->scan->streams[fetch->stream];
    const uint32_t bytes = stream->element_bytes;
    uint8_t *buffer = w->buffers + worker * BUFFER_BYTES;
    const uint64_t words = gather_words(kind->count), end = range_end(kind, number);
    if (!range_has_marks(kind, number))
        return 0;
    for (uint64_t word = number * GATHER_RANGE_WORDS; word < end; word++) {
        if (!word_at(kind, word))
            continue;
        uint64_t end_word = read_end(kind, word, end);
        uint64_t count = (end_word < words ? 64 * end_word : kind->count) - 64 * word;
        BSQ_PASS(stream_read(stream, 64 * word, count, buffer));
        if (fetch->stream == SCAN_COLORS)
            vox_scan_scale_colors(w->scan, 64 * word, count, (uint32_t *)(void *)buffer, NULL);
        if (fetch->stream == SCAN_FINE_COLORS)
            BSQ_PASS(scale_fine_colors(w->scan, 64 * word, count, (uint32_t *)(void *)buffer));
        window_gather(kind, word, end_word, buffer, bytes, w->elements[fetch->stream]);
        word = end_word - 1;
    }
    return 0;
}

static int fetch_stream(struct gather_window *w, enum scan_stream number)
{
    const struct gather_kind *kind = &w->kinds[scan_kind_of(number)];
    struct fetch fetch = {w, number};
    w->view.streams[number].count = kind->marked;
    return bsq_parallel_for(w->ctx, range_count(kind), fetch_range, &fetch);
}

int vox_gather_fetch(struct gather_window *w)
{
    for (int i = 0; i < FMT_MESH_KIND_COUNT; i++)
        if (w->kinds[i].active)
            rank(&w->kinds[i]);
    for (int i = 0; i < SCAN_STREAM_COUNT; i++)
        if (w->elements[i])
            BSQ_PASS(fetch_stream(w, i));
    return 0;
}

/* ---- numbers ---- */

static void number_plain(const struct gather_kind *kind, uint8_t *tuples, uint64_t count)
{
    for (uint64_t c = 0; c < 3 * count; c++) {
        uint32_t index;
        memcpy(&index, tuples + 4 * c, 4);
        index = gather_rank(kind, index);
        memcpy(tuples + 4 * c, &index, 4);
    }
}

void vox_gather_number(const struct gather_window *w, uint8_t *tuples, uint64_t count)
{
    if (w->layout->plain) {
        number_plain(&w->kinds[FMT_MESH_VERTEX], tuples, count);
        return;
    }
    for (int i = 0; i < FMT_MESH_KIND_COUNT; i++) {
        const struct gather_kind *kind = &w->kinds[i];
        const uint32_t bytes = index_bytes_of(w, i);
        for (uint64_t c = 0; bytes > 0 && c < 3 * count; c++) {
            uint8_t *at = tuples + corner_offset(w->layout, i, c);
            uint64_t index = tuple_load(at, bytes);
            if (index < kind->count)
                tuple_store(at, gather_rank(kind, index), bytes);
        }
    }
}

/* Returns the last of `count` ranks that is at most `number`. The first one must be. */
static uint64_t last_up_to(const uint32_t *ranks, uint64_t count, uint32_t number)
{
    uint64_t low = 0, high = count;
    while (high - low > 1) {
        uint64_t middle = low + (high - low) / 2;
        *(ranks[middle] <= number ? &low : &high) = middle;
    }
    return low;
}

/* Returns the marked element with this rank. */
static uint64_t element_of_rank(const struct gather_kind *kind, uint32_t number)
{
    const uint64_t range = last_up_to(kind->range_ranks, range_count(kind), number);
    const uint64_t begin = range * GATHER_RANGE_WORDS;
    const uint64_t word =
        begin + last_up_to(kind->ranks + begin, range_end(kind, range) - begin, number);
    uint64_t marks = word_at(kind, word);
    for (uint32_t before = kind->ranks[word]; before < number; before++)
        marks &= marks - 1;
    return 64 * word + (uint64_t)__builtin_ctzll(marks);
}

/* Neighbours among sorted triangles share vertices, so most searches repeat a recent one. */
#define RECENT_BITS 11u

void vox_gather_restore(const struct gather_window *w, uint8_t *tuples, uint64_t count)
{
    struct {
        uint64_t element;
        uint32_t rank;
    } recent[1u << RECENT_BITS];
    for (int i = 0; i < FMT_MESH_KIND_COUNT; i++) {
        const struct gather_kind *kind = &w->kinds[i];
        const uint32_t bytes = index_bytes_of(w, i);
        memset(recent, 0xff, sizeof recent);
        for (uint64_t c = 0; bytes > 0 && c < 3 * count; c++) {
            uint8_t *at = tuples + corner_offset(w->layout, i, c);
            const uint64_t index = tuple_load(at, bytes);
            const uint32_t slot = index & ((1u << RECENT_BITS) - 1);
            if (index >= kind->marked)
                continue;
            if (recent[slot].rank != index) {
                recent[slot].rank = (uint32_t)index;
                recent[slot].element = element_of_rank(kind, (uint32_t)index);
            }
            tuple_store(at, recent[slot].element, bytes);
        }
    }
}
