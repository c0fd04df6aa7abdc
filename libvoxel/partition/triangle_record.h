/* triangle_record.h - the record of a triangle in a sort batch: three corners and a material.
 *
 * A corner is one index of each kind. The scan's counts give the bytes of an index, at least
 * limits->index_bytes. Records are packed; loads may read RECORD_SLACK bytes past the end. Buckets
 * hold triangles delta coded instead (record_runs.h). */
#ifndef VOX_PARTITION_TRIANGLE_RECORD_H
#define VOX_PARTITION_TRIANGLE_RECORD_H

#include <string.h>

#include "libvoxel/read/scan.h"

#define RECORD_SLACK 8

struct record_layout {
    bool gathered; /* attribute streams are in files; each batch gathers its elements */
    /* Polygons are fans (polygon_fans.h), because positions are in a file. The highest bit of a
     * record's first vertex index says that the triangle continues the previous record's fan. */
    bool fans;
    bool plain; /* a record is three four-byte vertex indices, and a vertex is a position */
    uint32_t index_bytes[FMT_MESH_KIND_COUNT]; /* 0: the kind is not stored */
    uint32_t index_at[FMT_MESH_KIND_COUNT];    /* offset in a corner */
    uint32_t corner_bytes;
    uint32_t material_bytes; /* stored is the number plus one; 0: no materials */
    uint32_t bytes;
};

static inline uint32_t record_index_width(uint64_t last, uint32_t least)
{
    uint32_t bytes = least;
    while (bytes < 8 && last >> (8 * bytes) != 0)
        bytes++;
    return bytes;
}

/* Chooses the layout. The whole scan must have been read, and its materials must be known. */
void vox_record_layout_for(const struct scan *scan, struct record_layout *layout);

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

static inline uint64_t record_vertex_index(const struct record_layout *layout,
                                           const uint8_t *corner)
{
    return record_load(corner, layout->index_bytes[FMT_MESH_VERTEX]);
}

/* Returns the bit of a vertex index that marks fans, for layouts with fans. */
static inline uint64_t record_fan_bit(const struct record_layout *layout)
{
    return (uint64_t)1 << (8 * layout->index_bytes[FMT_MESH_VERTEX] - 1);
}

static inline bool record_continues_fan(const struct record_layout *layout, const uint8_t *record)
{
    return record[layout->index_bytes[FMT_MESH_VERTEX] - 1] >> 7;
}

static inline void record_continue_fan(const struct record_layout *layout, uint8_t *record)
{
    record[layout->index_bytes[FMT_MESH_VERTEX] - 1] |= 0x80;
}

/* Returns the position of a corner. Positions must be in memory. */
static inline const float *record_position(const struct record_layout *layout,
                                           const struct scan *scan, const uint8_t *corner)
{
    return stream_at(&scan->streams[SCAN_POSITIONS], record_vertex_index(layout, corner), 12);
}

/* Returns the triangle's material, or UINT32_MAX if it has none. */
static inline uint32_t record_material(const struct record_layout *layout, const uint8_t *record)
{
    if (layout->material_bytes == 0)
        return UINT32_MAX;
    return (uint32_t)record_load(record + 3 * layout->corner_bytes, layout->material_bytes) - 1;
}

/* All values of a vertex of the chunk file. Equal vertices have equal bytes. */
struct vertex {
    float position[3];
    uint32_t normal; /* SCAN_NO_NORMAL: use the triangle's */
    float texcoord[2];
    uint32_t color;
};

/* Looks up the values of a corner. All streams must be in memory. */
void vox_record_vertex(const struct record_layout *layout, const struct scan *scan,
                       const uint8_t *corner, struct vertex *out);

#endif
