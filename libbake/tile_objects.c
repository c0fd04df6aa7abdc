/* tile_objects.c - tells which object of the low-poly mesh each texel of a tile shows. The raster
 * is filled again for it: objects of all texels would need memory that grows with the map. */
#include "libbake/tile_bake.h"

#include <string.h>

#include "base/parallel.h"

/* A part of a tile's image whose objects are wanted. */
struct window {
    const struct bake_tile_scene *scene;
    const struct bake_tile *tile;
    uint32_t x, y, width, height; /* texels of the image */
    uint32_t *objects;            /* of its texels, BAKE_NO_OBJECT until one is known */
};

static bool overlaps(const struct window *window, const struct bk_tile *place)
{
    const uint64_t n = window->tile->options.samples;
    return place->x < (window->x + (uint64_t)window->width) * n &&
           place->x + (uint64_t)place->width > window->x * n &&
           place->y < (window->y + (uint64_t)window->height) * n &&
           place->y + (uint64_t)place->height > window->y * n;
}

/* Takes a sample of a triangle at (x, y) of the image's samples. */
static void take_sample(const struct window *window, uint32_t triangle, uint32_t x, uint32_t y)
{
    const uint32_t n = window->tile->options.samples;
    const uint32_t column = x / n - window->x, row = y / n - window->y; /* may wrap around */
    if (triangle == BK_NO_TRIANGLE || column >= window->width || row >= window->height)
        return;
    uint32_t *object = &window->objects[(uint64_t)row * window->width + column];
    if (*object == BAKE_NO_OBJECT)
        *object = window->scene->mesh->object_of[triangle];
}

static int take_raster_tile(const struct window *window, uint32_t index, uint32_t *triangles)
{
    const struct bake_tile *tile = window->tile;
    struct bk_tile place = bake_raster_tile(tile->raster, index);
    uint64_t overlapping;
    if (tile->in_blocks)
        bake_blocks_to_image(&tile->sample_blocks, &place.x, &place.y);
    if (!overlaps(window, &place))
        return 0;
    int status = bake_raster_fill(tile->raster, index, triangles, &overlapping);
    for (uint32_t y = 0; y < place.height && status == 0; y++)
        for (uint32_t x = 0; x < place.width; x++)
            take_sample(window, triangles[(uint64_t)y * place.width + x], place.x + x, place.y + y);
    return status;
}

int bake_tile_objects(const struct bake_tile_scene *scene, const struct bake_tile *tile, uint32_t x,
                      uint32_t y, uint32_t width, uint32_t height, uint32_t *out)
{
    const struct window window = {scene, tile, x, y, width, height, out};
    const uint32_t count = bake_raster_tile_count(tile->raster);
    uint32_t *triangles;
    memset(out, 0xff, (size_t)width * height * sizeof *out);
    int status = bsq_alloc(scene->ctx, "samples of a tile", bake_tile_entries(tile),
                           sizeof *triangles, &triangles);
    /* One after the other: two raster tiles may share a texel, whose first sample counts. */
    for (uint32_t i = 0; i < count && status == 0; i++)
        status = take_raster_tile(&window, i, triangles);
    bsq_free(scene->ctx, triangles);
    return status;
}
