/* vertex_cells.c - see vertex_cells.h. */
#include "libvoxel/vertex_cells.h"

#define BLOCK_VERTICES 8192u

/* Where one of so many vertices is in another cell than the one before, they have an order. */
#define VERTICES_BY_CHANGE 8

int vertex_cells_make(const struct scan *scan, const struct morton_cube *cube, uint32_t levels,
                      struct vertex_cells *out)
{
    const struct column *column = &scan->columns[SCAN_POSITIONS];
    const uint64_t vertices = column_count(column);
    uint64_t changes = 0;
    uint16_t before = 0;
    float(*positions)[3] = NULL;
    *out = (struct vertex_cells){0};
    int status =
        bsq_alloc(scan->ctx, "cells of vertices", vertices, sizeof *out->cells, &out->cells);
    if (status == 0)
        status = bsq_alloc(scan->ctx, "cells of vertices", BLOCK_VERTICES, sizeof *positions,
                           &positions);
    for (uint64_t done = 0, count; status == 0 && done < vertices; done += count) {
        count = vertices - done < BLOCK_VERTICES ? vertices - done : BLOCK_VERTICES;
        if ((status = bsq_check(scan->ctx)) == 0)
            status = spool_read(&column->spool, sizeof *positions * done, sizeof *positions * count,
                                positions);
        for (uint64_t i = 0; status == 0 && i < count; i++) {
            uint16_t cell = (uint16_t)morton_cell(cube, levels, positions[i]);
            changes += cell != before;
            out->cells[done + i] = before = cell;
        }
    }
    out->have_order = changes < vertices / VERTICES_BY_CHANGE;
    bsq_free(scan->ctx, positions);
    return status;
}

void vertex_cells_free(const struct scan *scan, struct vertex_cells *cells)
{
    bsq_free(scan->ctx, cells->cells);
    cells->cells = NULL;
}
