/* udim.c - finds the UDIM tiles of a mesh, and sorts the mesh by tile. One pass over the triangles
 * counts, a second one sorts.
 *
 * Most triangles lie in one tile, which their bounds tell. The others are tested against each tile
 * in their bounds, shrunk on each side by half a texel of the tile there: coordinates that
 * overshoot a tile by less are rounding of the program that unwrapped the mesh. */
#include "libbake/udim/udim.h"

#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

enum { TRIANGLES_A_CHECK = 1024 };

/* Tile i of these has the number BAKE_FIRST_TILE + i. */
enum {
    COLUMNS = 10,
    ROWS = (BAKE_LAST_TILE - BAKE_FIRST_TILE + 1) / COLUMNS,
    TILES = COLUMNS * ROWS
};
_Static_assert(BAKE_FIRST_TILE + TILES - 1 == BAKE_LAST_TILE, "rows of tiles are whole");

/* A mesh, and what is known of its tiles. */
struct tile_sorter {
    struct bsq_ctx *ctx;
    const struct bake_options *options;
    const struct bake_lowmesh *mesh;
    uint64_t begin, end; /* triangles of the mesh to sort */
    bool selected[TILES];
    uint32_t sizes[TILES][2];   /* width and height of each map in texels */
    uint64_t places[TILES];     /* number of triangles; while sorting, place of the next one */
    uint32_t *order;            /* out: triangles by tile; NULL: only count */
    uint64_t flat_triangles;    /* without area in texture space */
    uint64_t outside_triangles; /* partly or wholly outside of the selected tiles */
    uint64_t unused_triangles;  /* wholly outside of them */
    uint64_t stray_triangles;   /* partly or wholly outside of all tiles */
    uint64_t first_stray;
};

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

/* ---- the tiles of a triangle ---- */

/* A triangle in texture space. */
struct shape {
    double u[3], v[3];
    double low[2], high[2];
};

/* Returns false for a triangle without area. Differences of floats and their products are exact in
 * double unless their magnitudes are far apart. */
static bool take_shape(const float (*uv)[2], struct shape *out)
{
    for (int i = 0; i < 3; i++) {
        out->u[i] = uv[i][0];
        out->v[i] = uv[i][1];
    }
    out->low[0] = fmin(out->u[0], fmin(out->u[1], out->u[2]));
    out->low[1] = fmin(out->v[0], fmin(out->v[1], out->v[2]));
    out->high[0] = fmax(out->u[0], fmax(out->u[1], out->u[2]));
    out->high[1] = fmax(out->v[0], fmax(out->v[1], out->v[2]));
    return (out->u[1] - out->u[0]) * (out->v[2] - out->v[0]) !=
           (out->u[2] - out->u[0]) * (out->v[1] - out->v[0]);
}

/* Returns whether a triangle overlaps a rectangle, given by its centre and half its sides: neither
 * a side of the rectangle nor an edge of the triangle separates them. */
static bool udim_overlaps(const struct shape *s, const double centre[2], const double half[2])
{
    for (int k = 0; k < 2; k++)
        if (s->low[k] >= centre[k] + half[k] || s->high[k] <= centre[k] - half[k])
            return false;
    for (int i = 0; i < 3; i++) {
        const int j = (i + 1) % 3, k = (i + 2) % 3;
        const double nu = s->v[i] - s->v[j], nv = s->u[j] - s->u[i];
        const double third = nu * (s->u[k] - s->u[i]) + nv * (s->v[k] - s->v[i]);
        const double middle = nu * (centre[0] - s->u[i]) + nv * (centre[1] - s->v[i]);
        const double reach = fabs(nu) * half[0] + fabs(nv) * half[1];
        if (third > 0 ? middle + reach <= 0 : middle - reach >= 0)
            return false;
    }
    return true;
}

/* Tiles that a triangle was added to. */
struct added {
    uint32_t selected, others;
};

/* Adds a triangle to a tile. */
static void add_to_tile(struct tile_sorter *sorter, uint32_t tile, uint64_t triangle,
                        struct added *added)
{
    const bool selected = sorter->selected[tile];
    if (sorter->order && selected)
        sorter->order[sorter->places[tile]] = (uint32_t)triangle;
    sorter->places[tile]++;
    added->selected += selected;
    added->others += !selected;
}

/* Returns the whole numbers first <= i < end below `limit` whose unit interval [i, i + 1] overlaps
 * low..high. */
static void overlapped_units(double low, double high, uint32_t limit, uint32_t *first,
                             uint32_t *end)
{
    *first = low > 0 ? (uint32_t)fmin(floor(low), limit) : 0;
    *end = high > 0 ? (uint32_t)fmin(ceil(high), limit) : 0;
}

/* Finds the part of a tile that is farther than half a texel of its neighbours from them. */
static void shrink_tile(const struct tile_sorter *sorter, uint32_t column, uint32_t row,
                        double centre[2], double half[2])
{
    static const uint32_t most[2] = {COLUMNS - 1, ROWS - 1}, steps[2] = {1, COLUMNS};
    const uint32_t place[2] = {column, row}, tile = row * COLUMNS + column;
    for (int k = 0; k < 2; k++) {
        const uint32_t before = place[k] > 0 ? tile - steps[k] : tile;
        const uint32_t after = place[k] < most[k] ? tile + steps[k] : tile;
        const double low = 0.5 / sorter->sizes[before][k], high = 1 - 0.5 / sorter->sizes[after][k];
        centre[k] = place[k] + (low + high) / 2;
        half[k] = (high - low) / 2;
    }
}

/* Adds a triangle to the tiles that it overlaps by half a texel of their neighbours. */
static void add_to_overlapped(struct tile_sorter *sorter, const struct shape *shape,
                              uint64_t triangle, struct added *added)
{
    uint32_t first[2], end[2];
    overlapped_units(shape->low[0], shape->high[0], COLUMNS, &first[0], &end[0]);
    overlapped_units(shape->low[1], shape->high[1], ROWS, &first[1], &end[1]);
    for (uint32_t row = first[1]; row < end[1]; row++)
        for (uint32_t column = first[0]; column < end[0]; column++) {
            double centre[2], half[2];
            shrink_tile(sorter, column, row, centre, half);
            if (udim_overlaps(shape, centre, half))
                add_to_tile(sorter, row * COLUMNS + column, triangle, added);
        }
}

/* Returns the tile that is nearest to the centre of a triangle. */
static uint32_t nearest_tile(const struct shape *shape)
{
    const double u = (shape->u[0] + shape->u[1] + shape->u[2]) / 3;
    const double v = (shape->v[0] + shape->v[1] + shape->v[2]) / 3;
    const uint32_t column = u > 0 ? (uint32_t)fmin(u, COLUMNS - 1) : 0;
    const uint32_t row = v > 0 ? (uint32_t)fmin(v, ROWS - 1) : 0;
    return row * COLUMNS + column;
}

/* Returns whether a triangle leaves the square of all tiles by half a texel or more. */
static bool is_stray(const struct tile_sorter *sorter, const struct shape *s)
{
    if (s->low[0] >= 0 && s->low[1] >= 0 && s->high[0] <= COLUMNS && s->high[1] <= ROWS)
        return false;
    const uint32_t *size = sorter->sizes[nearest_tile(s)];
    const double half[2] = {0.5 / size[0], 0.5 / size[1]};
    return !(s->low[0] > -half[0] && s->low[1] > -half[1] && s->high[0] < COLUMNS + half[0] &&
             s->high[1] < ROWS + half[1]);
}

/* Returns whether one tile holds a triangle. */
static bool fits_tile(const struct shape *s, uint32_t *tile)
{
    const double column = floor(s->low[0]), row = floor(s->low[1]);
    const bool fits = column >= 0 && column < COLUMNS && row >= 0 && row < ROWS &&
                      s->high[0] <= column + 1 && s->high[1] <= row + 1;
    *tile = fits ? (uint32_t)row * COLUMNS + (uint32_t)column : 0;
    return fits;
}

/* Adds a triangle to its tiles. One that overlaps no tile by half a texel is in the tile of its
 * centre. */
static struct added add_to_tiles(struct tile_sorter *sorter, const struct shape *shape,
                                 uint64_t triangle, bool stray)
{
    struct added added = {0};
    uint32_t tile = 0;
    const bool fits = fits_tile(shape, &tile);
    if (!fits)
        add_to_overlapped(sorter, shape, triangle, &added);
    if (fits || (added.selected + added.others == 0 && !stray))
        add_to_tile(sorter, fits ? tile : nearest_tile(shape), triangle, &added);
    return added;
}

/* Counts the triangles of each tile, and all others. With an order, writes each triangle to the
 * place of each selected tile that it is in, those without area to `first_tile`, and those in no
 * selected tile to the places from *rest on, which it advances. Those without area go there too if
 * `first_tile` is TILES. */
static int sort_by_tile(struct tile_sorter *sorter, uint32_t first_tile, uint64_t *rest)
{
    int status = 0;
    for (uint64_t t = sorter->begin; t < sorter->end && status == 0; t++) {
        struct shape shape;
        if (t % TRIANGLES_A_CHECK == 0)
            status = bsq_check(sorter->ctx);
        if (!take_shape((const float(*)[2])sorter->mesh->texcoords[t], &shape)) {
            sorter->flat_triangles++;
            if (sorter->order && first_tile == TILES)
                sorter->order[(*rest)++] = (uint32_t)t;
            else if (sorter->order)
                add_to_tile(sorter, first_tile, t, &(struct added){0});
            continue;
        }
        const bool stray = is_stray(sorter, &shape);
        const struct added added = add_to_tiles(sorter, &shape, t, stray);
        if (stray && sorter->stray_triangles++ == 0)
            sorter->first_stray = t;
        sorter->outside_triangles += stray || added.others > 0;
        sorter->unused_triangles += added.selected == 0;
        if (sorter->order && added.selected == 0)
            sorter->order[(*rest)++] = (uint32_t)t;
    }
    return status;
}

/* Takes from the options which tiles are selected, and the sizes of their maps. */
static void take_options(struct tile_sorter *sorter, const struct bake_options *options)
{
    for (uint32_t tile = 0; tile < TILES; tile++) {
        sorter->selected[tile] = options->tile_range_count == 0;
        sorter->sizes[tile][0] = options->width;
        sorter->sizes[tile][1] = options->height;
    }
    for (uint32_t i = 0; i < options->tile_range_count; i++) {
        const struct bake_tile_range *range = &options->tile_ranges[i];
        for (uint32_t number = range->first; number <= range->last; number++)
            sorter->selected[number - BAKE_FIRST_TILE] = true;
    }
    for (uint32_t i = 0; i < options->tile_size_count; i++) {
        uint32_t *size = sorter->sizes[options->tile_sizes[i].tile - BAKE_FIRST_TILE];
        size[0] = options->tile_sizes[i].width;
        size[1] = options->tile_sizes[i].height;
    }
}

/* Creates a sorter of a set's triangles, which knows the tiles that options->tile_ranges selects,
 * and the sizes of all tiles. The options are checked. Free it with bsq_free(). */
static int create_sorter(struct bsq_ctx *ctx, const struct bake_options *options,
                         const struct bake_lowmesh *mesh, uint32_t set, struct tile_sorter **out)
{
    int status = BSQ_CALLOC(ctx, "tiles", 1, out);
    if (status < 0)
        return status;
    (*out)->ctx = ctx;
    (*out)->options = options;
    (*out)->mesh = mesh;
    (*out)->begin = mesh->set_count > 0 ? mesh->sets[set].first : 0;
    (*out)->end =
        mesh->set_count > 0 ? (*out)->begin + mesh->sets[set].count : mesh->triangle_count;
    take_options(*out, options);
    return 0;
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

static int fail_stray(const struct tile_sorter *sorter, const char *tiles)
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
static int udim_check_tiles(const struct tile_sorter *sorter, uint32_t count)
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
    BSQ_PASS(BSQ_GROW(ctx, "tiles", out->count + UINT64_C(1), &out->tiles, &out->capacity));
    const struct bake_udim_tile *last = out->count > 0 ? &out->tiles[out->count - 1] : NULL;
    out->tiles[out->count] = *tile;
    out->tiles[out->count++].first = last ? last->first + last->count : 0;
    return 0;
}

/* Adds the selected tiles that triangles of a set lie in. */
static int list_tiles(struct tile_sorter *sorter, uint32_t set, struct bake_udim *out)
{
    uint32_t count = 0;
    if (sorter->flat_triangles == sorter->end - sorter->begin) {
        sorter->places[0] = sorter->flat_triangles;
        sorter->flat_triangles = sorter->selected[0] ? 0 : sorter->flat_triangles;
    }
    for (uint32_t tile = 0; tile < TILES; tile++)
        count += sorter->places[tile] > 0 && sorter->selected[tile];
    int status = udim_check_tiles(sorter, count);
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

/* Finds the tiles of a set, and counts the triangles in each tile. */
static int find_tiles_of_set(struct bsq_ctx *ctx, const struct bake_options *options,
                             const struct bake_lowmesh *mesh, uint32_t set,
                             uint64_t triangles[TILES], struct bake_udim *out)
{
    struct tile_sorter *sorter;
    BSQ_PASS(create_sorter(ctx, options, mesh, set, &sorter));
    int status = sort_by_tile(sorter, 0, NULL);
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
    for (uint32_t i = 0; i < options->tile_size_count; i++)
        BSQ_PASS(check_range(ctx, options, triangles, options->tile_sizes[i].tile,
                             options->tile_sizes[i].tile));
    for (uint32_t i = 0; i < options->tile_range_count; i++)
        BSQ_PASS(check_range(ctx, options, triangles, options->tile_ranges[i].first,
                             options->tile_ranges[i].last));
    return 0;
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
    int status = BSQ_CALLOC(ctx, "tiles", TILES, &triangles);
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
    struct tile_sorter *sorter;
    BSQ_PASS(create_sorter(ctx, options, mesh, set, &sorter));
    uint32_t first = TILES;
    for (; *tile < udim->count && udim->tiles[*tile].set == set; ++*tile) {
        const uint32_t number = udim->tiles[*tile].number - BAKE_FIRST_TILE;
        first = first == TILES ? number : first;
        sorter->places[number] = udim->tiles[*tile].first;
    }
    sorter->order = order;
    int status = sort_by_tile(sorter, first, rest);
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
    int status = BSQ_ALLOC(ctx, "triangles by tile", count, &order);
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

/* ---- areas ---- */

/* Adds a triangle's area in world units and in texels. */
static void add_areas(const struct bake_lowmesh *mesh, uint64_t triangle, double texels_a_tile,
                      double *world, double *texels)
{
    float(*t)[2] = mesh->texcoords[triangle];
    double u[2], v[2];
    for (int k = 0; k < 2; ++k) {
        u[k] = (double)t[1][k] - (double)t[0][k];
        v[k] = (double)t[2][k] - (double)t[0][k];
    }
    *world += bake_lowmesh_area(mesh, triangle);
    *texels += 0.5 * fabs(u[0] * v[1] - u[1] * v[0]) * texels_a_tile;
}

double bake_udim_texel(const struct bake_options *options, const struct bake_lowmesh *mesh,
                       const struct bake_udim *udim)
{
    double world = 0, texels = 0;
    for (uint32_t i = 0; i < udim->count; ++i) {
        const struct bake_udim_tile *tile = &udim->tiles[i];
        uint32_t width, height;
        bake_tile_size_of(options, tile->number, &width, &height);
        for (uint64_t t = tile->first; t < tile->first + tile->count; ++t)
            add_areas(mesh, t, (double)width * (double)height, &world, &texels);
    }
    return texels > 0 ? sqrt(world / texels) : 0;
}
