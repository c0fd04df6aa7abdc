/* gather_window.h - the elements that a batch uses, for attribute streams that are in files.
 *
 * A batch's triangles are close together in space; in most scans, so are their vertices in the
 * file. The window marks the elements that the batch's corners refer to, reads them in the order of
 * the stream, and renumbers the corners. Later steps then work on a view, a scan that has only
 * these elements. The order of faces does not matter. If vertices have no order, each batch reads
 * most of the stream. */
#ifndef VOX_CHUNK_GATHER_WINDOW_H
#define VOX_CHUNK_GATHER_WINDOW_H

#include <stdatomic.h>

#include "libvoxel/partition/partition.h"

/* Words of marks that are cleared, ranked and read together, if they have marks at all: a batch
 * must not cost a pass over the marks of the whole scan. */
#define GATHER_RANGE_WORDS 256u

typedef atomic_uint_least64_t gather_word;

static inline uint64_t gather_words(uint64_t elements)
{
    return elements / 64 + 1;
}

/* Attribute streams of one kind of index. */
struct gather_kind {
    bool active;        /* one of them is in a file */
    uint64_t count;     /* elements in each stream */
    gather_word *marks; /* a bit for each element: the batch refers to it */
    uint32_t
        *ranks; /* for each word of marks in a range with marks, the marked elements before it */
    uint32_t *range_ranks; /* for each range, the marked elements before it */
    atomic_uchar *ranges;  /* for each range: it has marks */
    uint64_t marked;       /* elements */
};

struct gather_window {
    struct bsq_ctx *ctx;
    const struct scan *scan;
    const struct tuple_layout *layout;
    struct scan view; /* the scan, but streams of active kinds have only marked elements */
    struct gather_kind kinds[FMT_MESH_KIND_COUNT];
    uint8_t *elements[SCAN_STREAM_COUNT]; /* pages of the view's streams */
    uint8_t *buffers;                     /* one for each thread */
};

/* Returns the bytes that do not depend on the batch. */
uint64_t vox_gather_bytes(const struct scan *scan, unsigned threads);
/* Returns the most bytes for each triangle of a batch. */
uint64_t vox_gather_triangle_bytes(const struct scan *scan);

/* Opens a window for batches of up to `triangles` triangles. Close it with vox_gather_close(), also
 * after failure. */
int vox_gather_open(struct gather_window *window, const struct scan *scan,
                    const struct tuple_layout *layout, uint64_t triangles);
void vox_gather_close(struct gather_window *window);

/* Clears all marks. */
void vox_gather_clear(struct gather_window *window);
/* Marks the elements that the tuples' corners refer to. From any thread. */
void vox_gather_mark(struct gather_window *window, const uint8_t *tuples, uint64_t count);
/* Reads the marked elements into the view, on all threads. */
int vox_gather_fetch(struct gather_window *window);
/* Replaces the scan's indices in tuples by the view's. The elements must be marked. From any
 * thread, for different tuples. */
void vox_gather_number(const struct gather_window *window, uint8_t *tuples, uint64_t count);
/* Replaces the view's indices in tuples by the scan's. */
void vox_gather_restore(const struct gather_window *window, uint8_t *tuples, uint64_t count);

/* Returns the index in the view of a marked element. */
static inline uint32_t gather_rank(const struct gather_kind *kind, uint64_t index)
{
    uint64_t below = ((uint64_t)1 << index % 64) - 1;
    uint64_t marks = atomic_load_explicit(&kind->marks[index / 64], memory_order_relaxed);
    return kind->ranks[index / 64] + (uint32_t)__builtin_popcountll(marks & below);
}

/* Returns the position of a marked vertex after vox_gather_fetch(). */
static inline const float *gather_position(const struct gather_window *window, uint64_t vertex)
{
    const struct gather_kind *kind = &window->kinds[FMT_MESH_VERTEX];
    return stream_at(&window->view.streams[SCAN_POSITIONS],
                     kind->active ? gather_rank(kind, vertex) : vertex, 12);
}

#endif
