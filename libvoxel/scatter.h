/* scatter.h - private to the sorter: faces become triangles, collected by cell. */
#ifndef VOX_SCATTER_H
#define VOX_SCATTER_H

#include "libvoxel/split.h"

struct scattered {
    struct record_layout layout;
    struct morton_cube cube;
    uint32_t levels;    /* cells are named by the first 3 * levels bits of the key */
    struct cells cells; /* of runs, see run.h; items are triangles */
    uint64_t triangles; /* in the cells */
    uint64_t degenerate_triangles, unused_vertices;
};

/* Scatters the faces of the store. Free with cells_free(&out->cells), also after failure. */
int scatter_scan(struct scan *scan, const char *beside, struct scattered *out);

/* Makes the cells for about this many triangles. */
int scatter_begin(const struct scan *scan, const char *beside, uint64_t triangles,
                  uint64_t page_memory, struct scattered *out);
/* Moves what a splitter made to the cells. Serial, in the order of the file. */
int scatter_collect(struct scattered *out, const struct splitter *splitter);
/* Vertices of the scan without a bit in `used`. */
uint64_t scatter_unused(const struct scan *scan, const atomic_uint_least64_t *used);

/* Key of a plain record's triangle, see record_layout. */
static inline uint64_t scattered_plain_key(const struct morton_cube *cube,
                                           const struct column *positions, const uint8_t *record)
{
    const float *p[3];
    uint32_t cell[3], index[3];
    memcpy(index, record, sizeof index);
    for (uint32_t k = 0; k < 3; k++)
        p[k] = column_at(positions, index[k], 12);
    morton_cells(cube, p[0], p[1], p[2], cell);
    return morton_key(cell);
}

/* Key of any record's triangle. */
static inline uint64_t scattered_key(const struct scattered *scattered, const struct scan *scan,
                                     const uint8_t *record)
{
    const struct record_layout *layout = &scattered->layout;
    float copies[3][3];
    const float *p[3];
    uint32_t cell[3];
    for (uint32_t k = 0; k < 3; k++)
        p[k] = record_position(layout, scan, record + k * layout->corner_bytes, copies[k]);
    morton_cells(&scattered->cube, p[0], p[1], p[2], cell);
    return morton_key(cell);
}

#endif
