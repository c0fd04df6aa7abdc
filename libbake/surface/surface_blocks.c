/* surface_blocks.c - tells where a surface of grids has voxels, from the masks of nodes alone. */
#include <assert.h>

#include "libbake/surface/surface.h"

struct blocks {
    const struct bake_surface *part;
    bake_surface_visit *visit;
    void *arg;
};

static int visit_node(void *arg, uint32_t lower, const int32_t origin[3])
{
    const struct blocks *blocks = arg;
    const struct bake_surface *part = blocks->part;
    double corner[3];
    for (int k = 0; k < 3; k++)
        corner[k] = part->translation[k] + (origin[k] - 0.5) * part->unit;
    blocks->visit(blocks->arg, corner, part->unit, bake_lower_children(&part->grid, lower));
    return 0;
}

void bake_surface_each_block(const struct bake_surface *surface, bake_surface_visit *visit,
                             void *arg)
{
    const uint32_t count = surface->parts ? surface->part_count : 1;
    assert(!bake_surface_has_triangles(surface));
    for (uint32_t p = 0; p < count; p++) {
        struct blocks blocks = {surface->parts ? &surface->parts[p] : surface, visit, arg};
        const struct fmt_nvdb_grid *grid = &blocks.part->grid;
        (void)bake_visit_nodes(grid, grid->index_min, grid->index_max, visit_node, &blocks);
    }
}
