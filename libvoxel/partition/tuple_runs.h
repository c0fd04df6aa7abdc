/* tuple_runs.h - tuples of triangles, and the runs that make up the bytes of a bucket.
 *
 * A tuple, as sort batches hold them, is three corners and a material. A corner is one index of
 * each kind. The scan's counts give the bytes of an index, at least limits->index_bytes. Tuples
 * are packed; loads may read TUPLE_SLACK bytes past the end.
 *
 * A run is a header and up to RUN_TRIANGLES triangles of one bucket and one material. It can be
 * decoded by itself. Its indices are delta coded (corner_delta_code.h). If a bucket is divided, its
 * children hold runs of uncoded tuples (RUN_TUPLES). */
#ifndef VOX_PARTITION_TUPLE_RUNS_H
#define VOX_PARTITION_TUPLE_RUNS_H

#include <string.h>

#include "libvoxel/read/scan.h"

/* ---- tuples ---- */

#define TUPLE_SLACK 8

struct tuple_layout {
    bool gathered; /* attribute streams are in files; each batch gathers its elements */
    bool plain;    /* a tuple is three four-byte vertex indices, and a vertex is a position */
    uint32_t index_bytes[FMT_MESH_KIND_COUNT]; /* 0: the kind is not stored */
    uint32_t index_at[FMT_MESH_KIND_COUNT];    /* offset in a corner */
    uint32_t corner_bytes;
    uint32_t material_bytes; /* stored is the number plus one; 0: no materials */
    uint32_t bytes;
};

static inline uint32_t tuple_index_width(uint64_t last, uint32_t least)
{
    uint32_t bytes = least;
    while (bytes < 8 && last >> (8 * bytes) != 0)
        bytes++;
    return bytes;
}

/* Chooses the layout. The whole scan must have been read, and its materials must be known. */
void vox_tuple_layout_for(const struct scan *scan, struct tuple_layout *layout);

static inline void tuple_store(uint8_t *at, uint64_t value, uint32_t bytes)
{
    for (uint32_t i = 0; i < bytes; i++)
        at[i] = (uint8_t)(value >> 8 * i);
}

static inline uint64_t tuple_load(const uint8_t *at, uint32_t bytes)
{
    uint64_t value;
    memcpy(&value, at, 8);
    return value & UINT64_MAX >> (64 - 8 * bytes);
}

static inline uint64_t tuple_vertex_index(const struct tuple_layout *layout, const uint8_t *corner)
{
    return tuple_load(corner, layout->index_bytes[FMT_MESH_VERTEX]);
}

/* Returns the position of a corner. Positions must be in memory. */
static inline const float *tuple_position(const struct tuple_layout *layout,
                                          const struct scan *scan, const uint8_t *corner)
{
    return stream_at(&scan->streams[SCAN_POSITIONS], tuple_vertex_index(layout, corner), 12);
}

/* Returns the triangle's material, or UINT32_MAX if it has none. */
static inline uint32_t tuple_material(const struct tuple_layout *layout, const uint8_t *tuple)
{
    if (layout->material_bytes == 0)
        return UINT32_MAX;
    return (uint32_t)tuple_load(tuple + 3 * layout->corner_bytes, layout->material_bytes) - 1;
}

/* All values of a vertex of the chunk file. Equal vertices have equal bytes. */
struct vertex {
    float position[3];
    uint32_t normal; /* SCAN_NO_NORMAL: use the triangle's */
    float texcoord[2];
    uint32_t color, fine_color;
};

/* Looks up the values of a corner. All streams must be in memory. */
void vox_tuple_vertex(const struct tuple_layout *layout, const struct scan *scan,
                      const uint8_t *corner, struct vertex *out);

/* ---- runs ---- */

#define RUN_TRIANGLES 1024u

enum run_form {
    /* 1 << kind: the run has indices of this kind; kinds alternate triangle by triangle */
    RUN_TUPLES = 8 /* uncoded tuples */
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

/* Runs are short if the faces have no order, so a coded header takes four bytes: from the lowest
 * bit on, RUN_BYTES_BITS of the bytes, RUN_COUNT_BITS of the triangles minus one, and the form. The
 * top bit says that the material follows; else the triangles have neither a material nor texture
 * coordinates, or it is not needed. */
#define RUN_BYTES_BITS    17u
#define RUN_COUNT_BITS    10u
#define RUN_FORM_BITS     4u
#define RUN_HAS_MATERIAL  (1u << 31)
#define RUN_BARE_MATERIAL 1u
#define RUN_HEADER_MAX    8u
_Static_assert(RUN_TRIANGLES <= 1u << RUN_COUNT_BITS && RUN_TUPLES < 1u << RUN_FORM_BITS,
               "they must fit in a header");

/* Returns the bytes of a coded header. */
static inline uint32_t run_header_bytes(const struct run_header *header)
{
    return header->material == RUN_BARE_MATERIAL ? 4 : 8;
}

static inline void run_header_put(const struct run_header *header, uint8_t *to)
{
    uint32_t word = header->bytes | (header->triangles - 1u) << RUN_BYTES_BITS |
                    (uint32_t)header->form << (RUN_BYTES_BITS + RUN_COUNT_BITS);
    if (header->material != RUN_BARE_MATERIAL) {
        word |= RUN_HAS_MATERIAL;
        memcpy(to + 4, &header->material, 4);
    }
    memcpy(to, &word, 4);
}

/* Decodes a header. RUN_HEADER_MAX bytes must be readable. */
static inline struct run_header run_header_get(const uint8_t *from)
{
    struct run_header header = {.material = RUN_BARE_MATERIAL};
    uint32_t word;
    memcpy(&word, from, 4);
    if (word & RUN_HAS_MATERIAL)
        memcpy(&header.material, from + 4, 4);
    header.bytes = word & ((1u << RUN_BYTES_BITS) - 1);
    header.triangles = (uint16_t)((word >> RUN_BYTES_BITS & ((1u << RUN_COUNT_BITS) - 1)) + 1);
    header.form = word >> (RUN_BYTES_BITS + RUN_COUNT_BITS) & ((1u << RUN_FORM_BITS) - 1);
    return header;
}

/* Reads the runs of a bucket in sequence. Each thread has its own reader. */
struct run_reader {
    const struct scan *scan;
    const struct tuple_layout *layout;
    uint8_t *buffer;
    uint32_t begin, end; /* unread bytes of the buffer */
    const struct bsq_spill *buckets;
    uint32_t bucket;
    uint64_t offset; /* in the bucket, of the first byte after the buffer */
    struct bsq_spill_cursor cursor;
};

/* Initialises a reader. Free it with vox_run_reader_free(), also after failure. */
int vox_run_reader_init(struct run_reader *reader, const struct scan *scan,
                        const struct tuple_layout *layout);
void vox_run_reader_free(struct run_reader *reader);

/* Moves to the run at `offset` bytes of the bucket. */
void vox_run_reader_seek(struct run_reader *reader, const struct bsq_spill *buckets,
                         uint32_t bucket, uint64_t offset);
/* Returns the offset of the next run. */
static inline uint64_t run_reader_tell(const struct run_reader *reader)
{
    return reader->offset - (reader->end - reader->begin);
}
/* Decodes the next run into at most RUN_TRIANGLES tuples at `to`, and may write TUPLE_SLACK bytes
 * more. Skips the run if `to` is NULL. There must be a next run. */
int vox_run_reader_next(struct run_reader *reader, uint8_t *to, uint32_t *count);

#endif
