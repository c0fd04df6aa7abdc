/* sort_batch.h - sorts some buckets, or slices of them, in memory.
 *
 * vox_batch_add() fills a batch and vox_batch_sort() sorts it. vox_batch_carry_over() then starts
 * the next batch with the triangles that are not in chunks yet. If attribute streams are in files,
 * the batch gathers the elements of its triangles (gather_window.h). Its tuples then have the
 * indices of batch.scan from sorting to carrying over, and those of the whole scan at other times.
 */
#ifndef VOX_CHUNK_SORT_BATCH_H
#define VOX_CHUNK_SORT_BATCH_H

#include "libvoxel/chunk/gather_window.h"
#include "libvoxel/partition/partition.h"

/* A triangle with an area, by which batches are sorted. */
struct entry {
    uint64_t key;
    uint32_t tuple; /* number in the batch */
    uint32_t unused;
};

/* Triangles of one bucket, or some of them. */
struct batch_slice {
    const struct bsq_spill *buckets;
    uint32_t bucket;
    uint32_t levels; /* Morton levels of the bucket */
    uint64_t offset; /* of its first run in the bucket's bytes */
    uint64_t count;
    /* Set by the batch. */
    uint64_t tuple; /* index of the first tuple */
    uint64_t at;    /* index of the first entry */
    uint64_t kept;  /* triangles with an area */
};

struct batch {
    struct bsq_ctx *ctx;
    const struct scan *scan; /* or the window's view of it */
    const struct partition *partition;
    uint64_t count;      /* triangles; after sorting, entries */
    uint64_t degenerate; /* triangles of all batches that were left out */
    uint8_t *tuples;
    struct entry *entries;
    /* Private. */
    struct gather_window window;
    bool gathered; /* streams are in files */
    uint64_t capacity;
    uint8_t *spare_tuples;
    struct entry *scratch;
    struct run_reader *readers; /* one for each thread, and one for the caller */
    unsigned reader_count;
    struct batch_slice *slices;
    uint64_t slice_count, slice_capacity;
    uint64_t largest_slice;
    uint64_t tuples_end; /* with the gap after the last slice */
};

/* Returns the bytes for each triangle of a batch's capacity. */
uint64_t vox_batch_triangle_bytes(const struct scan *scan, const struct partition *partition);
/* Returns the bytes that do not depend on its capacity. */
uint64_t vox_batch_fixed_bytes(const struct scan *scan, const struct partition *partition);
/* Returns the capacity of a batch for all triangles, including the gaps between slices. */
uint64_t vox_batch_capacity_of_all(const struct partition *partition);
/* Opens a batch of up to `capacity` triangles. Close it with vox_batch_close(), also after
 * failure. */
int vox_batch_open(struct batch *batch, const struct scan *scan, const struct partition *partition,
                   uint64_t capacity);
void vox_batch_close(struct batch *batch);

/* Returns whether the batch has capacity left for a slice of this many triangles. */
bool vox_batch_fits(const struct batch *batch, uint64_t triangles);
/* Adds a slice that fits. It is read when the batch is sorted. */
int vox_batch_add(struct batch *batch, const struct batch_slice *slice);
/* Reads and sorts all slices, on all threads. Entries [0, count) are then in order. */
int vox_batch_sort(struct batch *batch);
/* Begins the next batch with the entries of this sorted one from `first` on. */
void vox_batch_carry_over(struct batch *batch, uint64_t first);

/* Returns a reader for the caller's use. Only for a batch that holds nothing but triangles that
 * were carried over. */
struct run_reader *vox_batch_reader(struct batch *batch);
/* Reads up to `most` triangles of whole runs at the reader's place in the bucket, which has `left`
 * triangles left. The free capacity must be enough. Gathers their elements for vox_batch_key(). */
int vox_batch_read(struct batch *batch, uint64_t left, uint64_t most, uint64_t *count,
                   const uint8_t **tuples);
/* Returns the Morton key of a tuple from vox_batch_read(). */
uint64_t vox_batch_key(const struct batch *batch, const uint8_t *tuple);

#endif
