/* tile_sort.c - finds the UDIM tiles that each triangle lies in.
 *
 * Most triangles lie in one tile, which their bounds tell. The others are tested against each tile
 * in their bounds, shrunk on each side by half a texel of the tile there: coordinates that
 * overshoot a tile by less are rounding of the program that unwrapped the mesh. */
#include "libbake/udim/tile_sort.h"

#include <math.h>

enum { TRIANGLES_A_CHECK = 1024 };

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
static bool overlaps(const struct shape *s, const double centre[2], const double half[2])
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
static void add_to_tile(struct bake_tile_sorter *sorter, uint32_t tile, uint64_t triangle,
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
static void shrink_tile(const struct bake_tile_sorter *sorter, uint32_t column, uint32_t row,
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
static void add_to_overlapped(struct bake_tile_sorter *sorter, const struct shape *shape,
                              uint64_t triangle, struct added *added)
{
    uint32_t first[2], end[2];
    overlapped_units(shape->low[0], shape->high[0], COLUMNS, &first[0], &end[0]);
    overlapped_units(shape->low[1], shape->high[1], ROWS, &first[1], &end[1]);
    for (uint32_t row = first[1]; row < end[1]; row++)
        for (uint32_t column = first[0]; column < end[0]; column++) {
            double centre[2], half[2];
            shrink_tile(sorter, column, row, centre, half);
            if (overlaps(shape, centre, half))
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
static bool is_stray(const struct bake_tile_sorter *sorter, const struct shape *s)
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

/* Adds a triangle to its tiles. One that overlaps none by half a texel is in that of its centre. */
static struct added add_to_tiles(struct bake_tile_sorter *sorter, const struct shape *shape,
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

int bake_tile_sort(struct bake_tile_sorter *sorter, uint32_t first_tile, uint64_t *rest)
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
static void take_options(struct bake_tile_sorter *sorter, const struct bake_options *options)
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

int bake_tile_sorter_create(struct bsq_ctx *ctx, const struct bake_options *options,
                            const struct bake_lowmesh *mesh, uint32_t set,
                            struct bake_tile_sorter **out)
{
    int status = bsq_calloc(ctx, "tiles", 1, sizeof **out, out);
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
