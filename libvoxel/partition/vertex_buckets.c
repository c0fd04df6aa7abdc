/* vertex_buckets.c - see vertex_buckets.h. */
#include "libvoxel/partition/vertex_buckets.h"

#define BLOCK_VERTICES 8192u

/* Where one of so many vertices is in another cell than the one before, they have an order. */
#define VERTICES_BY_CHANGE 8

static int allocate(const struct scan *scan, uint64_t vertices, uint32_t levels,
                    struct vertex_cells *out)
{
    const char *what = "cells of vertices";
    if (levels > VERTEX_CELLS_NARROW_LEVELS)
        return bsq_alloc(scan->ctx, what, vertices, sizeof *out->wide, &out->wide);
    return bsq_alloc(scan->ctx, what, vertices, sizeof *out->narrow, &out->narrow);
}

int vox_vertex_buckets_make(const struct scan *scan, const struct morton_cube *cube,
                            uint32_t levels, struct vertex_cells *out)
{
    const struct column *column = &scan->columns[SCAN_POSITIONS];
    const uint64_t vertices = column_count(column);
    uint64_t changes = 0;
    uint32_t before = 0;
    float(*positions)[3] = NULL;
    *out = (struct vertex_cells){0};
    int status = allocate(scan, vertices, levels, out);
    if (status == 0)
        status = bsq_alloc(scan->ctx, "cells of vertices", BLOCK_VERTICES, sizeof *positions,
                           &positions);
    for (uint64_t done = 0, count; status == 0 && done < vertices; done += count) {
        count = vertices - done < BLOCK_VERTICES ? vertices - done : BLOCK_VERTICES;
        if ((status = bsq_check(scan->ctx)) == 0)
            status = vox_spill_read(&column->spool, sizeof *positions * done,
                                    sizeof *positions * count, positions);
        for (uint64_t i = 0; status == 0 && i < count; i++) {
            uint32_t cell = morton_cell(cube, levels, positions[i]);
            changes += cell != before;
            before = cell;
            if (out->wide)
                out->wide[done + i] = (uint16_t)cell;
            else
                out->narrow[done + i] = (uint8_t)cell;
        }
    }
    out->have_order = changes < vertices / VERTICES_BY_CHANGE;
    bsq_free(scan->ctx, positions);
    return status;
}

void vox_vertex_buckets_free(const struct scan *scan, struct vertex_cells *cells)
{
    bsq_free(scan->ctx, cells->wide);
    bsq_free(scan->ctx, cells->narrow);
    *cells = (struct vertex_cells){0};
}
