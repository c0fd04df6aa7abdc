/* scatter.h - private to the sorter: faces become records of triangles, collected by cell. */
#ifndef VOX_SCATTER_H
#define VOX_SCATTER_H

#include "libvoxel/morton.h"
#include "libvoxel/record.h"

struct scattered {
    struct record_layout layout;
    struct morton_cube cube;
    uint32_t levels; /* cells are named by the first 3 * levels bits of the key */
    uint64_t page_bytes;
    struct cells cells;
    uint64_t triangles; /* in the cells */
    uint64_t degenerate_triangles, unused_vertices;
};

/* Free with cells_free(&out->cells), also after failure. */
int scatter_scan(struct scan *scan, const char *beside, struct scattered *out);

/* Key of a record's triangle. */
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
