/* udim.c - finds the UDIM tiles of a mesh, and sorts the mesh by tile. One pass over the triangles
 * counts, a second one sorts. */
#include "libbake/udim/udim.h"

#include <inttypes.h>
#include <stdio.h>
#include <string.h>

#include "libbake/udim/tile_sort.h"

uint32_t bake_udim_column(uint32_t number)
{
    return (number - BAKE_FIRST_TILE) % COLUMNS;
}

uint32_t bake_udim_row(uint32_t number)
{
    return (number - BAKE_FIRST_TILE) / COLUMNS;
}

void bake_tile_size_of(const struct bake_options *options, uint32_t number, uint32_t *width,
                       uint32_t *height)
{
    *width = options->width;
    *height = options->height;
    for (uint32_t i = 0; i < options->tile_size_count; i++)
        if (options->tile_sizes[i].tile == number) {
            *width = options->tile_sizes[i].width;
            *height = options->tile_sizes[i].height;
        }
}

/* ---- finding ---- */

/* Writes the numbers of the tiles with triangles: "1001, 1002 and 5 more". */
static void name_tiles(const struct bake_tile_sorter *sorter, char *out, size_t size)
{
    uint32_t left = 0;
    size_t used = 0;
    snprintf(out, size, "no tile");
    for (uint32_t tile = 0; tile < TILES; tile++) {
        if (sorter->places[tile] == 0)
            continue;
        if (used + 32 > size)
            left++;
        else
            used += (size_t)snprintf(out + used, size - used, "%s%u", used ? ", " : "",
                                     BAKE_FIRST_TILE + tile);
    }
    if (left)
        snprintf(out + used, size - used, " and %u more", left);
}

static int fail_stray(const struct bake_tile_sorter *sorter, const char *tiles)
{
    const float *uv = sorter->mesh->texcoords[sorter->first_stray][0];
    return bsq_fail(sorter->ctx, BSQ_EUSAGE,
                    "%s: %" PRIu64 " triangles have texture coordinates outside of all UDIM tiles, "
                    "the first at (%g, %g); to leave them out, select tiles to bake (--tiles); "
                    "there are triangles in %s",
                    sorter->options->mesh_path, sorter->stray_triangles, (double)uv[0],
                    (double)uv[1], tiles);
}

/* Checks the options against the tiles in use, of which `count` are selected. */
static int check_tiles(const struct bake_tile_sorter *sorter, uint32_t count)
{
    const struct bake_options *o = sorter->options;
    char tiles[200];
    name_tiles(sorter, tiles, sizeof tiles);
    if (sorter->stray_triangles > 0 && o->tile_range_count == 0)
        return fail_stray(sorter, tiles);
    if (count == 0)
        return bsq_fail(sorter->ctx, BSQ_EUSAGE,
                        "%s: no triangle is in the selected tiles; there are triangles in %s",
                        o->mesh_path, tiles);
    if (count > 1 && !strstr(o->output_path, BAKE_UDIM_TOKEN) &&
        !strstr(o->output_path, BAKE_UVTILE_TOKEN))
        return bsq_fail(sorter->ctx, BSQ_EUSAGE,
                        "%s is in several UDIM tiles: %s; to bake all, put \"" BAKE_UDIM_TOKEN
                        "\" into the output's name; to bake one, select it (--tiles)",
                        o->mesh_path, tiles);
    return 0;
}

/* Lists the selected tiles that have triangles. */
static int list_tiles(struct bake_tile_sorter *sorter, struct bake_udim *out)
{
    uint32_t count = 0;
    if (sorter->flat_triangles == sorter->mesh->triangle_count) {
        sorter->places[0] = sorter->flat_triangles;
        sorter->flat_triangles = 0;
    }
    for (uint32_t tile = 0; tile < TILES; tile++)
        count += sorter->places[tile] > 0 && sorter->selected[tile];
    int status = check_tiles(sorter, count);
    if (status == 0)
        status = bsq_calloc(sorter->ctx, "tiles", count, sizeof *out->tiles, &out->tiles);
    if (status < 0)
        return status;
    uint64_t first = 0;
    for (uint32_t tile = 0; tile < TILES; tile++) {
        if (sorter->places[tile] == 0 || !sorter->selected[tile])
            continue;
        struct bake_udim_tile *to = &out->tiles[out->count++];
        to->number = BAKE_FIRST_TILE + tile;
        to->first = first;
        to->count = sorter->places[tile] + (out->count == 1 ? sorter->flat_triangles : 0);
        first += to->count;
    }
    return 0;
}

int bake_udim_find(struct bsq_ctx *ctx, const struct bake_options *options,
                   const struct bake_lowmesh *mesh, struct bake_udim *out)
{
    struct bake_tile_sorter *sorter;
    *out = (struct bake_udim){0};
    int status = bake_tile_sorter_create(ctx, options, mesh, &sorter);
    if (status < 0)
        return status;
    status = bake_tile_sort(sorter, 0, 0);
    if (status == 0)
        status = list_tiles(sorter, out);
    out->outside_triangles = sorter->outside_triangles;
    out->unused_triangles = sorter->unused_triangles;
    bsq_free(ctx, sorter);
    return status;
}

void bake_udim_free(struct bsq_ctx *ctx, struct bake_udim *udim)
{
    bsq_free(ctx, udim->tiles);
    *udim = (struct bake_udim){0};
}

/* ---- arranging ---- */

/* Replaces an array of `size` bytes a triangle by its entries in a new order. */
static int reorder(struct bsq_ctx *ctx, const uint32_t *order, uint64_t count, size_t size,
                   void *array)
{
    char *from, *to;
    memcpy(&from, array, sizeof from);
    int status = bsq_alloc(ctx, "triangles by tile", count, size, &to);
    if (status < 0)
        return status;
    for (uint64_t i = 0; i < count; i++)
        memcpy(to + i * size, from + order[i] * size, size);
    bsq_free(ctx, from);
    memcpy(array, &to, sizeof to);
    return 0;
}

static int reorder_mesh(struct bsq_ctx *ctx, const uint32_t *order, uint64_t count,
                        struct bake_lowmesh *mesh)
{
    int status = reorder(ctx, order, count, sizeof *mesh->positions, &mesh->positions);
    if (status == 0)
        status = reorder(ctx, order, count, sizeof *mesh->normals, &mesh->normals);
    if (status == 0)
        status = reorder(ctx, order, count, sizeof *mesh->texcoords, &mesh->texcoords);
    if (status == 0)
        status = reorder(ctx, order, count, sizeof *mesh->tangents, &mesh->tangents);
    if (status == 0)
        status = reorder(ctx, order, count, sizeof *mesh->directions, &mesh->directions);
    if (status == 0)
        mesh->triangle_count = count;
    return status;
}

static int sort_mesh(struct bsq_ctx *ctx, const struct bake_options *options,
                     const struct bake_udim *udim, struct bake_lowmesh *mesh)
{
    const struct bake_udim_tile *last = &udim->tiles[udim->count - 1];
    const uint64_t end = last->first + last->count, count = end + udim->unused_triangles;
    struct bake_tile_sorter *sorter;
    uint32_t *order = NULL;
    if (count > UINT32_MAX)
        return bsq_fail(ctx, BSQ_EDATA, "%s: %" PRIu64 " triangles in UDIM tiles, %u are supported",
                        options->mesh_path, count, UINT32_MAX);
    int status = bake_tile_sorter_create(ctx, options, mesh, &sorter);
    if (status < 0)
        return status;
    for (uint32_t i = 0; i < udim->count; i++)
        sorter->places[udim->tiles[i].number - BAKE_FIRST_TILE] = udim->tiles[i].first;
    status = bsq_alloc(ctx, "triangles by tile", count, sizeof *order, &order);
    sorter->order = order;
    if (status == 0)
        status = bake_tile_sort(sorter, udim->tiles[0].number - BAKE_FIRST_TILE, end);
    if (status == 0)
        status = reorder_mesh(ctx, order, count, mesh);
    bsq_free(ctx, order);
    bsq_free(ctx, sorter);
    return status;
}

/* Makes texture coordinates relative to a tile. Floats near the tile lose nothing by it. */
static void shift(const struct bake_udim_tile *tile, struct bake_lowmesh *mesh)
{
    const float origin[2] = {(float)bake_udim_column(tile->number),
                             (float)bake_udim_row(tile->number)};
    for (uint64_t t = tile->first; t < tile->first + tile->count; t++)
        for (int i = 0; i < 3; i++)
            for (int k = 0; k < 2; k++)
                mesh->texcoords[t][i][k] -= origin[k];
}

int bake_udim_arrange(struct bsq_ctx *ctx, const struct bake_options *options,
                      struct bake_udim *udim, struct bake_lowmesh *mesh)
{
    int status = 0;
    if (udim->count > 1 || udim->tiles[0].count != mesh->triangle_count)
        status = sort_mesh(ctx, options, udim, mesh);
    for (uint32_t i = 0; i < udim->count && status == 0; i++)
        shift(&udim->tiles[i], mesh);
    return status;
}
