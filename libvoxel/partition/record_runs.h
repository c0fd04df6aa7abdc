/* record_runs.h - runs, of which a bucket's bytes consist.
 *
 * A run is a header and up to RUN_TRIANGLES triangles of one bucket and one material. It can be
 * decoded by itself. Its indices are delta coded (corner_delta_code.h). If a bucket is divided, its
 * children hold runs of uncoded records (RUN_RECORDS). */
#ifndef VOX_PARTITION_RECORD_RUNS_H
#define VOX_PARTITION_RECORD_RUNS_H

#include "libvoxel/partition/buckets.h"
#include "libvoxel/partition/triangle_record.h"

#define RUN_TRIANGLES 1024u
/* Corners of the largest polygon that can be a fan: a fan must fit in one run. */
#define FAN_CORNERS (RUN_TRIANGLES + 2)

enum run_form {
    /* 1 << kind: the run has indices of this kind; kinds alternate triangle by triangle */
    RUN_RECORDS = 8, /* uncoded records */
    RUN_FANS = 16    /* after the indices, a bit for each triangle: it continues a fan */
};

struct run_header {
    uint32_t bytes; /* without the header */
    uint16_t triangles, form;
    uint32_t material; /* see run_material() */
};

/* Returns the code of an entry of scan->material_map, which is made after all faces were read. */
static inline uint32_t run_material(uint32_t usemtl, bool lacks_texcoord)
{
    return (usemtl + 1) << 1 | lacks_texcoord; /* FMT_MESH_NO_MATERIAL becomes 0 */
}

/* Writes a run of up to RUN_TRIANGLES records and returns its end. */
uint8_t *vox_run_put_records(const struct record_layout *layout, const uint8_t *records,
                             uint32_t count, uint8_t *to);

/* Reads the runs of a bucket in sequence. Each thread has its own reader. */
struct run_reader {
    const struct scan *scan;
    const struct record_layout *layout;
    uint8_t *buffer;
    uint32_t begin, end; /* unread bytes of the buffer */
    const struct buckets *buckets;
    uint32_t bucket;
    uint64_t offset; /* in the bucket, of the first byte after the buffer */
    struct bucket_cursor cursor;
};

/* Initialises a reader. Free it with vox_run_reader_free(), also after failure. */
int vox_run_reader_init(struct run_reader *reader, const struct scan *scan,
                        const struct record_layout *layout);
void vox_run_reader_free(struct run_reader *reader);

/* Moves to the run at `offset` bytes of the bucket. */
void vox_run_reader_seek(struct run_reader *reader, const struct buckets *buckets, uint32_t bucket,
                         uint64_t offset);
/* Returns the offset of the next run. */
static inline uint64_t run_reader_tell(const struct run_reader *reader)
{
    return reader->offset - (reader->end - reader->begin);
}
/* Decodes the next run into at most RUN_TRIANGLES records at `to`, and may write RECORD_SLACK bytes
 * more. Skips the run if `to` is NULL. There must be a next run. */
int vox_run_reader_next(struct run_reader *reader, uint8_t *to, uint32_t *count);

#endif
