/* sort_batch.h - some buckets, or parts of them, in memory and sorted.
 *
 * A batch is filled with vox_batch_add() and sorted. vox_batch_carry_over() then empties it but for
 * the triangles that are not in chunks yet, which begin the next batch. If attribute streams are in
 * files, the batch gathers what its triangles refer to (gather_window.h): records name elements of
 * the scan until the batch is sorted, then elements of batch.scan, and the scan's again when they
 * are carried over. */
#ifndef VOX_CHUNK_SORT_BATCH_H
#define VOX_CHUNK_SORT_BATCH_H

#include "libvoxel/chunk/polygon_fans.h"
#include "libvoxel/chunk/radix_sort.h"
#include "libvoxel/partition/partition.h"

/* Triangles of one bucket, or a part of them. */
struct batch_part {
    const struct buckets *buckets;
    uint32_t bucket;
    uint32_t levels; /* by which the bucket is known */
    uint64_t offset; /* of its first run in the bucket's bytes */
    uint64_t count;
    /* The batch's own. */
    uint64_t record; /* where in its records */
    uint64_t at;     /* where in its entries */
    uint64_t own;    /* triangles: fans bring others, that belong to other buckets */
    uint64_t kept;   /* of its own once they are sorted: others have no area */
};

struct batch {
    struct bsq_ctx *ctx;
    const struct scan *scan; /* or the window's view of it */
    const struct partition *partition;
    used_word *used;     /* where vertices of records are to be marked, or NULL: elsewhere */
    uint64_t count;      /* triangles; once sorted, of entries */
    uint64_t degenerate; /* triangles of all batches that were left out */
    uint8_t *records;
    struct entry *entries;
    /* What follows is the batch's own. */
    struct gather_window window;
    bool gathered; /* streams are in files */
    uint64_t capacity;
    uint8_t *spare_records;
    struct entry *scratch;
    struct run_reader *readers;     /* one a thread, and one more for the caller's */
    struct fan_buffer *fan_buffers; /* the same, where there are fans */
    unsigned reader_count;
    struct batch_part *parts;
    uint64_t part_count, part_capacity;
    uint64_t largest_part;
    uint64_t records_end; /* parts leave a gap behind them */
};

/* Memory of a batch of this many triangles: what each takes, and what it takes besides. */
uint64_t vox_batch_triangle_bytes(const struct scan *scan, const struct partition *partition);
uint64_t vox_batch_fixed_bytes(const struct scan *scan, const struct partition *partition);
/* Room that a batch of all triangles needs, in triangles: parts leave gaps. */
uint64_t vox_batch_capacity_of_all(const struct partition *partition);
/* Free with vox_batch_close(), also after failure. */
int vox_batch_open(struct batch *batch, const struct scan *scan, const struct partition *partition,
                   uint64_t capacity);
void vox_batch_close(struct batch *batch);

/* There is room for so many more triangles in one part. */
bool vox_batch_has_room(const struct batch *batch, uint64_t triangles);
int vox_batch_add(struct batch *batch, const struct batch_part *part);
/* Sorts the batch: entries [0 .. count) then are in order. On all threads. */
int vox_batch_sort(struct batch *batch);
/* Of a sorted batch keeps the entries from `first` on alone, which begin the next one. */
void vox_batch_carry_over(struct batch *batch, uint64_t first);

/* Of a batch that has nothing but what was carried over. The reader is for the caller's own use;
 * what it reads goes where the next part would be, at most as many triangles as there is room for.
 */
struct run_reader *vox_batch_reader(struct batch *batch);
/* Reads runs of a bucket where the reader is, which has `left` triangles left, up to `most`
 * triangles. *count: those read; *records, *own: those that belong to the bucket. Columns in files
 * are at hand for vox_batch_key(). */
int vox_batch_read(struct batch *batch, const struct batch_part *bucket, uint64_t left,
                   uint64_t most, uint64_t *count, const uint8_t **records, uint64_t *own);
uint64_t vox_batch_key(const struct batch *batch, const uint8_t *record);

#endif
