/* gather_window.h - the vertices of a batch, for attribute streams that are in files.
 *
 * A batch's triangles lie together in space, and so do their vertices in the files of most scans.
 * A batch marks the elements that its corners refer to, reads them in the order of the stream, and
 * renumbers its corners. Later steps work as if the scan had no other vertices. The order of faces
 * does not matter; vertices without order cost each batch a pass over the stream. */
#ifndef VOX_PARTITION_GATHER_WINDOW_H
#define VOX_PARTITION_GATHER_WINDOW_H

#include "libvoxel/partition/partition.h"

/* Columns of one kind of index. */
struct gather_kind {
    bool active;      /* one of them is in a file */
    uint64_t count;   /* of elements in the streams */
    used_word *marks; /* those that the batch refers to */
    uint32_t *ranks;  /* for each word of marks: how many are marked before it */
    uint64_t marked;
};

struct gather_window {
    struct bsq_ctx *ctx;
    const struct scan *scan;
    const struct record_layout *layout;
    struct scan view; /* the scan, but streams of active kinds have the batch's elements alone */
    struct gather_kind kinds[FMT_MESH_KIND_COUNT];
    uint8_t *elements[SCAN_STREAM_COUNT]; /* of the view; its segments */
    uint8_t *buffers;                     /* one a thread */
};

/* Memory that does not depend on the batch, and for each triangle of a batch at most. */
uint64_t vox_gather_bytes(const struct scan *scan, unsigned threads);
uint64_t vox_gather_triangle_bytes(const struct scan *scan);

/* triangles: of a batch, at most. Free with vox_gather_close(), also after failure. */
int vox_gather_open(struct gather_window *window, const struct scan *scan,
                    const struct record_layout *layout, uint64_t triangles);
void vox_gather_close(struct gather_window *window);

/* Forgets what was marked. */
void vox_gather_clear(struct gather_window *window);
/* Marks what the corners of records refer to. From any thread. */
void vox_gather_mark(struct gather_window *window, const uint8_t *records, uint64_t count);
/* Reads what is marked into the view, on all threads, and marks its vertices in `used`. */
int vox_gather_fetch(struct gather_window *window, used_word *used);
/* Indices of the scan, which are marked, become those of the view, and the other way. From any
 * thread, of different records. */
void vox_gather_number(const struct gather_window *window, uint8_t *records, uint64_t count);
void vox_gather_restore(const struct gather_window *window, uint8_t *records, uint64_t count);

/* Number in the view of a marked element. */
static inline uint32_t gather_rank(const struct gather_kind *kind, uint64_t index)
{
    uint64_t below = ((uint64_t)1 << index % 64) - 1;
    uint64_t marks = atomic_load_explicit(&kind->marks[index / 64], memory_order_relaxed);
    return kind->ranks[index / 64] + (uint32_t)__builtin_popcountll(marks & below);
}

/* Position of a marked vertex that was fetched. */
static inline const float *gather_position(const struct gather_window *window, uint64_t vertex)
{
    const struct gather_kind *kind = &window->kinds[FMT_MESH_VERTEX];
    return stream_at(&window->view.streams[SCAN_POSITIONS],
                     kind->active ? gather_rank(kind, vertex) : vertex, 12);
}

#endif
