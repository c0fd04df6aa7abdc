/* udim.c - finds the UDIM tiles of a mesh, and sorts the mesh by tile. One pass over the triangles
 * counts, a second one sorts. */
#include "libbake/udim/udim.h"

#include <inttypes.h>
#include <math.h>
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

/* Returns the subject of messages. Tiles do not tell which of several files they are from. */
static const char *mesh_name(const struct bake_options *options)
{
    return options->more_mesh_count > 0 ? "the low-poly mesh" : options->mesh_path;
}

/* ---- finding ---- */

/* Writes the numbers of the tiles with triangles: "1001, 1002 and 5 more". triangles: of each tile.
 */
static void name_tiles(const uint64_t triangles[TILES], char *out, size_t size)
{
    uint32_t left = 0;
    size_t used = 0;
    snprintf(out, size, "no tile");
    for (uint32_t tile = 0; tile < TILES; tile++) {
        if (triangles[tile] == 0)
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

/* Returns how far texture coordinates lie outside of the square of all tiles; negative if inside.
 */
static float distance_outside(const float uv[2])
{
    return fmaxf(fmaxf(-uv[0], uv[0] - COLUMNS), fmaxf(-uv[1], uv[1] - ROWS));
}

/* Returns the corner of a triangle that lies farthest outside of all tiles. */
static const float *stray_corner(const float (*uv)[2])
{
    const float *farthest = uv[0];
    for (int i = 1; i < 3; i++)
        if (distance_outside(uv[i]) > distance_outside(farthest))
            farthest = uv[i];
    return farthest;
}

static int fail_stray(const struct bake_tile_sorter *sorter, const char *tiles)
{
    const float *uv = stray_corner(sorter->mesh->texcoords[sorter->first_stray]);
    return bsq_fail(sorter->ctx, BSQ_EUSAGE,
                    "%s: %" PRIu64 " triangles have texture coordinates outside of all UDIM tiles, "
                    "the first at (%g, %g); to leave them out, select tiles to bake (--tiles); "
                    "there are triangles in %s",
                    mesh_name(sorter->options), sorter->stray_triangles, (double)uv[0],
                    (double)uv[1], tiles);
}

/* Checks the options against the tiles in use, of which `count` are selected. */
static int check_tiles(const struct bake_tile_sorter *sorter, uint32_t count)
{
    const struct bake_options *o = sorter->options;
    char tiles[200];
    name_tiles(sorter->places, tiles, sizeof tiles);
    if (sorter->stray_triangles > 0 && o->tile_range_count == 0)
        return fail_stray(sorter, tiles);
    if (count > 1 && !strstr(o->output_path, BAKE_UDIM_TOKEN) &&
        !strstr(o->output_path, BAKE_UVTILE_TOKEN))
        return bsq_fail(sorter->ctx, BSQ_EUSAGE,
                        "%s is in several UDIM tiles: %s; to bake all, put \"" BAKE_UDIM_TOKEN
                        "\" into the output's name; to bake one, select it (--tiles)",
                        mesh_name(o), tiles);
    return 0;
}

/* Adds a tile, whose triangles follow those of all others. */
static int add_tile(struct bsq_ctx *ctx, const struct bake_udim_tile *tile, struct bake_udim *out)
{
    int status = bsq_grow(ctx, "tiles", out->count + UINT64_C(1), sizeof *out->tiles, &out->tiles,
                          &out->capacity);
    if (status < 0)
        return status;
    const struct bake_udim_tile *last = out->count > 0 ? &out->tiles[out->count - 1] : NULL;
    out->tiles[out->count] = *tile;
    out->tiles[out->count++].first = last ? last->first + last->count : 0;
    return 0;
}

/* Adds the selected tiles that triangles of a set lie in. */
static int list_tiles(struct bake_tile_sorter *sorter, uint32_t set, struct bake_udim *out)
{
    uint32_t count = 0;
    if (sorter->flat_triangles == sorter->end - sorter->begin) {
        sorter->places[0] = sorter->flat_triangles;
        sorter->flat_triangles = sorter->selected[0] ? 0 : sorter->flat_triangles;
    }
    for (uint32_t tile = 0; tile < TILES; tile++)
        count += sorter->places[tile] > 0 && sorter->selected[tile];
    int status = check_tiles(sorter, count);
    for (uint32_t tile = 0; tile < TILES && status == 0; tile++) {
        if (sorter->places[tile] == 0 || !sorter->selected[tile])
            continue;
        const uint64_t flat = sorter->flat_triangles;
        status = add_tile(sorter->ctx,
                          &(struct bake_udim_tile){.number = BAKE_FIRST_TILE + tile,
                                                   .set = set,
                                                   .count = sorter->places[tile] + flat},
                          out);
        sorter->flat_triangles = 0;
    }
    out->outside_triangles += sorter->outside_triangles;
    out->unused_triangles += sorter->unused_triangles + sorter->flat_triangles;
    return status;
}

/* Finds the tiles of a set. Adds the number of its triangles to that of each tile. */
static int find_tiles_of_set(struct bsq_ctx *ctx, const struct bake_options *options,
                             const struct bake_lowmesh *mesh, uint32_t set,
                             uint64_t triangles[TILES], struct bake_udim *out)
{
    struct bake_tile_sorter *sorter;
    int status = bake_tile_sorter_create(ctx, options, mesh, set, &sorter);
    if (status < 0)
        return status;
    status = bake_tile_sort(sorter, 0, NULL);
    if (status == 0)
        status = list_tiles(sorter, set, out);
    for (uint32_t tile = 0; tile < TILES; tile++)
        triangles[tile] += sorter->places[tile];
    bsq_free(ctx, sorter);
    return status;
}

static bool is_any_used(const uint64_t triangles[TILES], uint32_t first, uint32_t last)
{
    for (uint32_t number = first; number <= last; number++)
        if (triangles[number - BAKE_FIRST_TILE] > 0)
            return true;
    return false;
}

/* Checks that one of the tiles `first` to `last`, which options name, is in use. */
static int check_range(struct bsq_ctx *ctx, const struct bake_options *options,
                       const uint64_t triangles[TILES], uint32_t first, uint32_t last)
{
    char tiles[200];
    if (is_any_used(triangles, first, last))
        return 0;
    name_tiles(triangles, tiles, sizeof tiles);
    if (first == last)
        return bsq_fail(ctx, BSQ_EUSAGE, "%s: no triangle is in tile %u; there are triangles in %s",
                        mesh_name(options), first, tiles);
    return bsq_fail(ctx, BSQ_EUSAGE,
                    "%s: no triangle is in tiles %u to %u; there are triangles in %s",
                    mesh_name(options), first, last, tiles);
}

/* Checks that the tiles that options name are in use: each that has a size of its own, and one of
 * each selected range. */
static int check_named_tiles(struct bsq_ctx *ctx, const struct bake_options *options,
                             const uint64_t triangles[TILES])
{
    int status = 0;
    for (uint32_t i = 0; i < options->tile_size_count && status == 0; i++)
        status = check_range(ctx, options, triangles, options->tile_sizes[i].tile,
                             options->tile_sizes[i].tile);
    for (uint32_t i = 0; i < options->tile_range_count && status == 0; i++)
        status = check_range(ctx, options, triangles, options->tile_ranges[i].first,
                             options->tile_ranges[i].last);
    return status;
}

/* Returns the number of sets, at least one. */
static uint32_t sets_of(const struct bake_lowmesh *mesh)
{
    return mesh->set_count > 0 ? mesh->set_count : 1;
}

int bake_udim_find(struct bsq_ctx *ctx, const struct bake_options *options,
                   const struct bake_lowmesh *mesh, struct bake_udim *out)
{
    uint64_t *triangles = NULL;
    *out = (struct bake_udim){0};
    int status = bsq_calloc(ctx, "tiles", TILES, sizeof *triangles, &triangles);
    for (uint32_t set = 0; set < sets_of(mesh) && status == 0; set++)
        status = find_tiles_of_set(ctx, options, mesh, set, triangles, out);
    if (status == 0)
        status = check_named_tiles(ctx, options, triangles);
    bsq_free(ctx, triangles);
    return status;
}

void bake_udim_free(struct bsq_ctx *ctx, struct bake_udim *udim)
{
    bsq_free(ctx, udim->tiles);
    *udim = (struct bake_udim){0};
}

/* ---- arranging ---- */

/* Writes the triangles of a set to the places of its tiles, which are *tile and those that follow
 * it. Advances *tile past them, and *rest past those that are in no tile to bake. */
static int sort_set(struct bsq_ctx *ctx, const struct bake_options *options,
                    const struct bake_udim *udim, const struct bake_lowmesh *mesh, uint32_t set,
                    uint32_t *order, uint32_t *tile, uint64_t *rest)
{
    struct bake_tile_sorter *sorter;
    int status = bake_tile_sorter_create(ctx, options, mesh, set, &sorter);
    if (status < 0)
        return status;
    uint32_t first = TILES;
    for (; *tile < udim->count && udim->tiles[*tile].set == set; ++*tile) {
        const uint32_t number = udim->tiles[*tile].number - BAKE_FIRST_TILE;
        first = first == TILES ? number : first;
        sorter->places[number] = udim->tiles[*tile].first;
    }
    sorter->order = order;
    status = bake_tile_sort(sorter, first, rest);
    bsq_free(ctx, sorter);
    return status;
}

static int sort_mesh(struct bsq_ctx *ctx, const struct bake_options *options,
                     const struct bake_udim *udim, struct bake_lowmesh *mesh)
{
    const struct bake_udim_tile *last = &udim->tiles[udim->count - 1];
    uint64_t rest = last->first + last->count;
    const uint64_t count = rest + udim->unused_triangles;
    uint32_t *order = NULL, tile = 0;
    if (count > UINT32_MAX)
        return bsq_fail(ctx, BSQ_EDATA, "%s: %" PRIu64 " triangles in UDIM tiles, %u are supported",
                        mesh_name(options), count, UINT32_MAX);
    int status = bsq_alloc(ctx, "triangles by tile", count, sizeof *order, &order);
    for (uint32_t set = 0; set < sets_of(mesh) && status == 0; set++)
        status = sort_set(ctx, options, udim, mesh, set, order, &tile, &rest);
    if (status == 0)
        status = bake_lowmesh_reorder(ctx, order, count, mesh);
    bsq_free(ctx, order);
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
