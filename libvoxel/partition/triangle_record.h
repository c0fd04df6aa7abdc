/* triangle_record.h - private to the sorter: a triangle on its way into the sorted file.
 *
 * Three corners and a material. A corner is its indices, each in as few bytes as the scan's counts
 * need, four at least; or its values, where columns are in files and faces were joined with them
 * (hash_join.h). Records are packed; loads may read RECORD_SLACK bytes past the end. Outside of
 * batches they are coded, see record_runs.h. */
#ifndef VOX_PARTITION_TRIANGLE_RECORD_H
#define VOX_PARTITION_TRIANGLE_RECORD_H

#include <string.h>

#include "libvoxel/partition/buckets.h"
#include "libvoxel/read/scan.h"

#define RECORD_SLACK 8

struct record_layout {
    bool by_value;
    bool windowed; /* by index, and columns are in files: see gather_window.h */
    bool fans;     /* polygons come as fans, see polygon_fans.h: the highest bit of a first vertex
                    * number says that its triangle     belongs to the fan of the one before */
    bool plain;    /* a record is three four-byte vertex numbers and vertices are positions */
    /* Of an index; 0: the kind is not stored. Only where !by_value. */
    uint32_t index_bytes[FACE_KIND_COUNT];
    /* Where in a corner: an index by its kind, or a value by its column. */
    uint32_t index_at[FACE_KIND_COUNT];
    uint32_t value_at[SCAN_COLUMN_COUNT];
    uint32_t corner_bytes;
    uint32_t material_bytes; /* of the number plus one; 0: no materials */
    uint32_t bytes;
};

/* Values of the corners of a group; absent attributes are NULL. */
struct corner_values {
    float (*positions)[3];
    uint32_t *colors;
    float (*texcoords)[2];
    uint32_t *normals;
};

static inline uint32_t record_index_width(uint64_t last, uint32_t least)
{
    uint32_t bytes = least;
    while (bytes < 8 && last >> (8 * bytes) != 0)
        bytes++;
    return bytes;
}

/* A column that the sorted file needs is in a file. */
bool vox_record_columns_spilled(const struct scan *scan);
void vox_record_layout_for(const struct scan *scan, bool by_value, struct record_layout *layout);

static inline void record_store(uint8_t *at, uint64_t value, uint32_t bytes)
{
    for (uint32_t i = 0; i < bytes; i++)
        at[i] = (uint8_t)(value >> 8 * i);
}

static inline uint64_t record_load(const uint8_t *at, uint32_t bytes)
{
    uint64_t value;
    memcpy(&value, at, 8);
    return value & UINT64_MAX >> (64 - 8 * bytes);
}

/* Vertex number of a corner that is not by value. */
static inline uint64_t record_vertex_index(const struct record_layout *layout,
                                           const uint8_t *corner)
{
    return record_load(corner, layout->index_bytes[FACE_VERTEX]);
}

/* Of layouts with fans. */
static inline uint64_t record_fan_bit(const struct record_layout *layout)
{
    return (uint64_t)1 << (8 * layout->index_bytes[FACE_VERTEX] - 1);
}

static inline bool record_continues_fan(const struct record_layout *layout, const uint8_t *record)
{
    return record[layout->index_bytes[FACE_VERTEX] - 1] >> 7;
}

static inline void record_continue_fan(const struct record_layout *layout, uint8_t *record)
{
    record[layout->index_bytes[FACE_VERTEX] - 1] |= 0x80;
}

/* Position of a corner; `copy` is where it is put if it does not lie aligned. */
static inline const float *record_position(const struct record_layout *layout,
                                           const struct scan *scan, const uint8_t *corner,
                                           float copy[3])
{
    if (!layout->by_value)
        return column_at(&scan->columns[SCAN_POSITIONS], record_vertex_index(layout, corner), 12);
    memcpy(copy, corner, 12);
    return copy;
}

/* UINT32_MAX: none */
static inline uint32_t record_material(const struct record_layout *layout, const uint8_t *record)
{
    if (layout->material_bytes == 0)
        return UINT32_MAX;
    return (uint32_t)record_load(record + 3 * layout->corner_bytes, layout->material_bytes) - 1;
}

/* All of a vertex of the sorted file. Equal vertices have equal bytes. */
struct vertex {
    float position[3];
    uint32_t normal; /* SCAN_NO_NORMAL: the triangle's is to be used */
    float texcoord[2];
    uint32_t color;
};

void vox_record_vertex(const struct record_layout *layout, const struct scan *scan,
                       const uint8_t *corner, struct vertex *out);

#endif
