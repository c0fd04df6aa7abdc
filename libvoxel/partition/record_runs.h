/* record_runs.h - private to the sorter: some triangles of one cell as bytes, on their way into a
 * batch.
 *
 * A cell's bytes are runs one behind the other, each of which can be decoded alone. Corners are
 * coded as corner_delta_code.h says: by their indices where columns are in memory, else by their
 * values, of which only new corners have any. Records as they are follow where a cell is divided
 * once more.
 */
#ifndef VOX_PARTITION_RECORD_RUNS_H
#define VOX_PARTITION_RECORD_RUNS_H

#include "libvoxel/read/corner_delta_code.h"
#include "libvoxel/partition/triangle_record.h"

#define RUN_TRIANGLES 1024u /* at most */

enum run_form {
    /* 1 << kind: indices of this kind, kinds interleaved triangle by triangle */
    RUN_VALUES = 8,
    RUN_RECORDS = 16,
    RUN_FANS =
        32 /* bits of the triangles that belong to the fan of the one before follow the indices */
};

struct run_header {
    uint32_t bytes; /* behind the header */
    uint16_t triangles, form;
    uint32_t material; /* see run_material() */
};

/* Names what material_map is asked for, which is made only when all faces are read. */
static inline uint32_t run_material(uint32_t usemtl, bool lacks_texcoord)
{
    return (usemtl + 1) << 1 | lacks_texcoord; /* FMT_MESH_NO_MATERIAL becomes 0 */
}

/* Bytes of one triangle, at most. */
static inline uint32_t run_triangle_bound(const struct record_layout *layout)
{
    return layout->by_value ? 1 + layout->bytes : FACE_KIND_COUNT * CORNER_CODE_MAX;
}

/* Writes a run of records; `to` has room for RUN_TRIANGLES of them and a header. Returns the end.
 */
uint8_t *vox_run_put_records(const struct record_layout *layout, const uint8_t *records,
                             uint32_t count, uint8_t *to);

/* Reads the runs of a cell in sequence. Each thread has its own. */
struct run_reader {
    const struct scan *scan;
    const struct record_layout *layout;
    uint8_t *buffer;
    uint32_t begin, end; /* what is in the buffer and not used yet */
    const struct cells *cells;
    uint32_t cell;
    uint64_t offset; /* in the cell's bytes, behind what is in the buffer */
    struct cell_cursor cursor;
};

/* Memory of a reader. */
uint64_t vox_run_reader_bytes(const struct record_layout *layout);
int vox_run_reader_init(struct run_reader *reader, const struct scan *scan,
                        const struct record_layout *layout);
void vox_run_reader_free(struct run_reader *reader);

/* Goes to a run. */
void vox_run_reader_seek(struct run_reader *reader, const struct cells *cells, uint32_t cell,
                         uint64_t offset);
/* Where the next run begins. */
static inline uint64_t run_reader_tell(const struct run_reader *reader)
{
    return reader->offset - (reader->end - reader->begin);
}
/* Turns the next run into at most RUN_TRIANGLES records at `to`, RECORD_SLACK bytes more may be
 * written; to NULL: skips it. There must be one. */
int vox_run_reader_next(struct run_reader *reader, uint8_t *to, uint32_t *count);

#endif
