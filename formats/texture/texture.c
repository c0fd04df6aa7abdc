/* texture.c - textures of one file or of a file for each tile.
 *
 * Passes files on to the module bisque-texture.so. A lookup in a texture of tiles stays in the tile
 * of its centre, at whose border texels repeat: the neighbour may show another part of the scan. */
#include "formats/texture/texture_module.h"

#include <inttypes.h>
#include <math.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "base/loss.h"
#include "base/parallel.h"
#include "base/tile_files.h"

enum { ALL_TILES = BSQ_TILE_COLUMNS * BSQ_TILE_ROWS };

/* The tiles of a path. Their images are numbers `first` and on, in the order of `files`. */
struct tiles {
    char *path;
    bool data, alpha; /* as in struct fmt_texture_source */
    bool listed;      /* `first` is set */
    uint32_t first;
    struct bsq_tile_files files; /* without damaged ones */
    uint64_t damaged;            /* files that cannot be read */
    char *damage;                /* what is wrong with the first one; NULL: nothing */
    /* Of each tile: 1 if a lookup found it missing, 2 if that was told. */
    atomic_uchar missing[ALL_TILES];
    atomic_uchar outside; /* the same for lookups outside of all tiles */
};

struct fmt_textures {
    struct bsq_ctx *ctx;
    const struct fmt_texture_module *module;
    struct fmt_texture_images *images;
    uint32_t count, image_count;
    uint32_t *image_of;      /* image of each source without tiles */
    struct tiles **tiles_of; /* NULL: without */
    struct tiles **tiles;    /* each once */
    uint64_t tiles_count, tiles_capacity;
};

/* ---- opening ---- */

/* Sources for the module, of files only. */
struct list {
    struct fmt_texture_source *list;
    uint64_t count, capacity;
};

/* Adds a file for a source. */
static int add_source(struct bsq_ctx *ctx, struct list *list, const char *path,
                      const struct fmt_texture_source *source)
{
    int status = list->count < UINT32_MAX
                     ? bsq_grow(ctx, "texture paths", list->count + 1, sizeof *list->list,
                                &list->list, &list->capacity)
                     : bsq_fail(ctx, BSQ_EDATA, "%s: too many textures", path ? path : "");
    if (status == 0)
        list->list[list->count++] = (struct fmt_texture_source){path, source->data, source->alpha};
    return status;
}

/* Finds the tiles of a path. */
static int enter_tiles(struct fmt_textures *textures, const struct fmt_texture_source *source,
                       struct tiles **out)
{
    struct bsq_ctx *ctx = textures->ctx;
    for (uint64_t i = 0; i < textures->tiles_count; i++)
        if (textures->tiles[i]->data == source->data &&
            textures->tiles[i]->alpha == source->alpha &&
            strcmp(textures->tiles[i]->path, source->path) == 0) {
            *out = textures->tiles[i];
            return 0;
        }
    struct tiles *tiles;
    int status = bsq_grow(ctx, "texture tiles", textures->tiles_count + 1, sizeof(void *),
                          &textures->tiles, &textures->tiles_capacity);
    if (status == 0)
        status = bsq_calloc(ctx, "texture tiles", 1, sizeof *tiles, &tiles);
    if (status != 0)
        return status;
    textures->tiles[textures->tiles_count++] = *out = tiles;
    tiles->data = source->data;
    tiles->alpha = source->alpha;
    tiles->path = strdup(source->path);
    status = tiles->path ? bsq_tile_files_find(ctx, source->path, &tiles->files)
                         : bsq_fail(ctx, BSQ_ENOMEM, "%s: out of memory", source->path);
    if (status == 0 && tiles->files.count == 0)
        status = bsq_fail(ctx, BSQ_ENOINPUT, "%s: no tile of this texture exists", source->path);
    return status;
}

/* Adds the files of tiles to the list, once. */
static int list_tiles(struct bsq_ctx *ctx, const struct fmt_texture_source *source,
                      struct tiles *tiles, struct list *list)
{
    int status = 0;
    if (tiles->listed)
        return 0;
    tiles->listed = true;
    tiles->first = (uint32_t)list->count;
    for (uint64_t i = 0; i < tiles->files.count && status == 0; i++)
        status = add_source(ctx, list, tiles->files.list[i].path, source);
    return status;
}

/* Lists all files. */
static int list_files(struct fmt_textures *textures, const struct fmt_texture_source *sources,
                      struct list *list)
{
    int status = 0;
    list->count = 0;
    for (uint64_t i = 0; i < textures->tiles_count; i++)
        textures->tiles[i]->listed = false;
    for (uint32_t i = 0; i < textures->count && status == 0; i++) {
        textures->image_of[i] = (uint32_t)list->count;
        status = textures->tiles_of[i]
                     ? list_tiles(textures->ctx, &sources[i], textures->tiles_of[i], list)
                     : add_source(textures->ctx, list, sources[i].path, &sources[i]);
    }
    return status;
}

static int open_list(struct fmt_textures *textures, const struct list *list, uint64_t cache_bytes)
{
    textures->image_count = (uint32_t)list->count;
    return textures->module->open(&fmt_host_functions, textures->ctx, list->list,
                                  textures->image_count, cache_bytes, &textures->images);
}

/* ---- damaged tiles ---- */

/* Opens one file alone. *damaged: it cannot be read; this is no error then. */
static int probe(struct fmt_textures *textures, struct tiles *tiles, const char *path,
                 uint64_t cache_bytes, bool *damaged)
{
    struct bsq_ctx *ctx = textures->ctx;
    const struct fmt_texture_source source = {path, tiles->data, tiles->alpha};
    struct fmt_texture_images *images = NULL;
    int status = textures->module->open(&fmt_host_functions, ctx, &source, 1, cache_bytes, &images);
    if (images)
        textures->module->close(images);
    *damaged = status == BSQ_EDATA || status == BSQ_ENOINPUT;
    if (!*damaged || bsq_check(ctx) != 0)
        return status;
    if (!tiles->damage && !(tiles->damage = strdup(bsq_error(ctx))))
        return status;
    bsq_clear_error(ctx);
    return 0;
}

/* Leaves out the tiles that cannot be read. Those of other textures are kept, and so is one file of
 * each texture at least: its error is that of the texture. */
static int leave_damaged(struct fmt_textures *textures, struct tiles *tiles, uint64_t cache_bytes)
{
    struct bsq_tile_files *files = &tiles->files;
    uint64_t kept = 0;
    int status = 0;
    for (uint64_t i = 0; i < files->count; i++) {
        bool damaged = false;
        if (status == 0)
            status = probe(textures, tiles, files->list[i].path, cache_bytes, &damaged);
        if (!damaged || status != 0 || (kept == 0 && i + 1 == files->count)) {
            files->list[kept++] = files->list[i];
            continue;
        }
        bsq_free(textures->ctx, files->list[i].path);
        tiles->damaged++;
    }
    files->count = kept;
    return status;
}

/* Opens all files, without tiles that are damaged if there are such. */
static int open_files(struct fmt_textures *textures, const struct fmt_texture_source *sources,
                      uint64_t cache_bytes, struct list *list)
{
    struct bsq_ctx *ctx = textures->ctx;
    int status = list_files(textures, sources, list);
    if (status == 0)
        status = open_list(textures, list, cache_bytes);
    if ((status != BSQ_EDATA && status != BSQ_ENOINPUT) || textures->tiles_count == 0 ||
        bsq_check(ctx) != 0)
        return status;
    bsq_clear_error(ctx);
    status = 0;
    for (uint64_t i = 0; i < textures->tiles_count && status == 0; i++)
        status = leave_damaged(textures, textures->tiles[i], cache_bytes);
    if (status == 0)
        status = list_files(textures, sources, list);
    return status == 0 ? open_list(textures, list, cache_bytes) : status;
}

/* ---- opening and closing ---- */

/* Finds the tiles of all sources. */
static int find_tiles(struct fmt_textures *textures, const struct fmt_texture_source *sources)
{
    int status = 0;
    for (uint32_t i = 0; i < textures->count && status == 0; i++)
        if (sources[i].path && bsq_has_tiles(sources[i].path))
            status = enter_tiles(textures, &sources[i], &textures->tiles_of[i]);
    return status;
}

int fmt_textures_open(struct bsq_ctx *ctx, const struct fmt_texture_source *sources, uint32_t count,
                      uint64_t cache_bytes, struct fmt_textures **out)
{
    const struct fmt_module *module;
    struct fmt_textures *textures = NULL;
    struct list list = {0};
    int status = fmt_module_open(ctx, "texture", "textures", &module);
    *out = NULL;
    if (status == 0)
        status = bsq_calloc(ctx, "textures", 1, sizeof *textures, &textures);
    if (status != 0)
        return status;
    textures->ctx = ctx;
    textures->module = (const struct fmt_texture_module *)module;
    textures->count = count;
    status = bsq_calloc(ctx, "textures", count + UINT64_C(1), sizeof *textures->image_of,
                        &textures->image_of);
    if (status == 0)
        status =
            bsq_calloc(ctx, "textures", count + UINT64_C(1), sizeof(void *), &textures->tiles_of);
    if (status == 0)
        status = find_tiles(textures, sources);
    if (status == 0)
        status = open_files(textures, sources, cache_bytes, &list);
    bsq_free(ctx, list.list);
    if (status < 0)
        fmt_textures_close(textures);
    else
        *out = textures;
    return status;
}

int fmt_textures_open_each(struct bsq_ctx *ctx, uint64_t count,
                           void (*source_of)(const void *arg, uint64_t index,
                                             struct fmt_texture_source *out),
                           const void *arg, uint64_t cache_bytes, struct fmt_textures **out)
{
    struct fmt_texture_source *sources = NULL;
    bool any = false;
    int status;
    *out = NULL;
    if (count > UINT32_MAX)
        return bsq_fail(ctx, BSQ_EDATA, "too many textures: %" PRIu64, count);
    BSQ_TRY(bsq_calloc(ctx, "texture paths", count + 1, sizeof *sources, &sources));
    for (uint64_t i = 0; i < count; i++) {
        source_of(arg, i, &sources[i]);
        any |= sources[i].path != NULL;
    }
    if (any)
        BSQ_TRY(fmt_textures_open(ctx, sources, (uint32_t)count, cache_bytes, out));
done:
    bsq_free(ctx, sources);
    return status;
}

void fmt_textures_close(struct fmt_textures *textures)
{
    if (!textures)
        return;
    struct bsq_ctx *ctx = textures->ctx;
    /* OpenImageIO keeps the last tiles and files of a cache in each thread. A later cache at the
     * same address would find them. */
    bsq_threads_end(ctx);
    if (textures->images)
        textures->module->close(textures->images);
    for (uint64_t i = 0; i < textures->tiles_count; i++) {
        bsq_tile_files_free(ctx, &textures->tiles[i]->files);
        free(textures->tiles[i]->path);
        free(textures->tiles[i]->damage);
        bsq_free(ctx, textures->tiles[i]);
    }
    bsq_free(ctx, textures->tiles);
    bsq_free(ctx, textures->tiles_of);
    bsq_free(ctx, textures->image_of);
    bsq_free(ctx, textures);
}

/* ---- lookups ---- */

void fmt_texture_size(const struct fmt_textures *textures, uint32_t image, uint32_t *width,
                      uint32_t *height)
{
    textures->module->size(textures->images, textures->image_of[image], width, height);
}

bool fmt_texture_has_alpha(const struct fmt_textures *textures, uint32_t image)
{
    const struct tiles *tiles = textures->tiles_of[image];
    const uint32_t first = tiles ? tiles->first : textures->image_of[image];
    const uint64_t count = tiles ? tiles->files.count : 1;
    bool any = false;
    for (uint64_t i = 0; i < count && !any; i++)
        any = textures->module->has_alpha(textures->images, first + (uint32_t)i);
    return any;
}

/* Moves a coordinate to the border between tiles that it misses by rounding only. */
static double settle(float coordinate)
{
    const double u = (double)coordinate, border = rint(u);
    return fabs(u - border) < 1e-5 ? border : u;
}

/* Returns the lower corner of the tile that a coordinate is in; a border ends the tile below. */
static double corner_of(double u)
{
    return fmax(ceil(u) - 1, fmin(floor(u), 0));
}

/* Returns the number of a tile; ALL_TILES if there is none with these whole coordinates. */
static uint32_t tile_number(double u, double v)
{
    const bool inside = u >= 0 && v >= 0 && u < BSQ_TILE_COLUMNS && v < BSQ_TILE_ROWS;
    return inside ? (uint32_t)u + BSQ_TILE_COLUMNS * (uint32_t)v : (uint32_t)ALL_TILES;
}

static int compare_numbers(const void *a, const void *b)
{
    const uint32_t x = *(const uint32_t *)a, y = ((const struct bsq_tile_file *)b)->number;
    return (x > y) - (x < y);
}

static const struct bsq_tile_file *find_file(const struct tiles *tiles, uint32_t number)
{
    return tiles->files.count > 0 ? bsearch(&number, tiles->files.list, tiles->files.count,
                                            sizeof *tiles->files.list, compare_numbers)
                                  : NULL;
}

/* Moves an interval of this width into the unit interval, if it is not wider. */
static float keep_inside(double centre, float width, float texel)
{
    const double half = 0.5 * fmin(fmax((double)width, (double)texel), 1.0);
    return (float)fmin(fmax(centre, half), 1.0 - half);
}

/* Finds the tile of a point: the one that it is in, or that ends there if there is no such file. */
static const struct bsq_tile_file *find_tile(struct tiles *tiles, double u, double v,
                                             double corner[2])
{
    const struct bsq_tile_file *file = NULL;
    for (int i = 0; i < 4 && !file; i++) {
        corner[0] = floor(u) - (double)(i & 1);
        corner[1] = floor(v) - (double)(i >> 1);
        if (u - corner[0] <= 1 && v - corner[1] <= 1)
            file = find_file(tiles, tile_number(corner[0], corner[1]));
    }
    return file;
}

static int sample_tiles(struct fmt_textures *textures, struct tiles *tiles, double u, double v,
                        float du, float dv, float out[3])
{
    double corner[2];
    uint32_t width, height;
    const struct bsq_tile_file *file = find_tile(tiles, u, v, corner);
    if (!file) {
        const uint32_t number = tile_number(corner_of(u), corner_of(v));
        atomic_uchar *missing = number < ALL_TILES ? &tiles->missing[number] : &tiles->outside;
        if (atomic_load_explicit(missing, memory_order_relaxed) == 0)
            atomic_store_explicit(missing, 1, memory_order_relaxed);
        out[0] = out[1] = out[2] = 0;
        return 0;
    }
    const uint32_t image = tiles->first + (uint32_t)(file - tiles->files.list);
    textures->module->size(textures->images, image, &width, &height);
    return textures->module->sample(
        textures->images, image, keep_inside(u - corner[0], du, 1.0f / (float)width),
        keep_inside(v - corner[1], dv, 1.0f / (float)height), du, dv, out);
}

int fmt_texture_sample(struct fmt_textures *textures, uint32_t image, float u, float v, float du,
                       float dv, float out[3])
{
    struct tiles *tiles = textures->tiles_of[image];
    return tiles ? sample_tiles(textures, tiles, settle(u), settle(v), du, dv, out)
                 : textures->module->sample(textures->images, textures->image_of[image], u, v, du,
                                            dv, out);
}

/* ---- losses ---- */

/* Sets of textures that are told together, and the files whose texels were told. */
struct losses {
    struct fmt_textures *const *sets; /* entries may be NULL */
    uint32_t count;
    const char **told;
    uint64_t told_count, told_capacity;
};

static bool was_told(const struct losses *losses, const char *path)
{
    bool told = false;
    for (uint64_t i = 0; i < losses->told_count && !told; i++)
        told = strcmp(losses->told[i], path) == 0;
    return told;
}

static int tell_broken(struct losses *losses, struct fmt_textures *textures, uint32_t image)
{
    const char *path;
    const uint64_t texels = textures->module->take_broken(textures->images, image, &path);
    if (texels == 0 || was_told(losses, path))
        return 0;
    int status = bsq_grow(textures->ctx, "texture paths", losses->told_count + 1,
                          sizeof *losses->told, &losses->told, &losses->told_capacity);
    if (status < 0)
        return status;
    losses->told[losses->told_count++] = path;
    return bsq_warn_loss(textures->ctx,
                         "%s: texels that are not finite: %" PRIu64 "; they count as 0", path,
                         texels);
}

/* tile: ALL_TILES for what lies outside of all tiles. */
static atomic_uchar *missing_of(struct tiles *tiles, uint32_t tile)
{
    return tile < ALL_TILES ? &tiles->missing[tile] : &tiles->outside;
}

/* Marks a missing tile as told in all entries of this path. Returns whether it was told before. */
static bool mark_told(const struct losses *losses, const char *path, uint32_t tile)
{
    bool before = false;
    for (uint32_t s = 0; s < losses->count; s++)
        for (uint64_t i = 0; losses->sets[s] && i < losses->sets[s]->tiles_count; i++) {
            struct tiles *tiles = losses->sets[s]->tiles[i];
            if (strcmp(tiles->path, path) != 0)
                continue;
            before = before || *missing_of(tiles, tile) == 2;
            *missing_of(tiles, tile) = 2;
        }
    return before;
}

/* Takes the tiles that were found missing and not told yet. Writes the first numbers to `names`.
 * Returns how many there are. */
static uint32_t take_missing(const struct losses *losses, struct tiles *tiles, char *names,
                             size_t size)
{
    enum { SHOWN = 5 };
    uint32_t count = 0;
    size_t length = 0;
    for (uint32_t t = 0; t < ALL_TILES; t++) {
        if (*missing_of(tiles, t) != 1 || mark_told(losses, tiles->path, t))
            continue;
        if (count++ < SHOWN)
            length += (size_t)snprintf(names + length, size - length, "%s%u",
                                       length > 0 ? ", " : "", 1001 + t);
        else if (count == SHOWN + 1)
            snprintf(names + length, size - length, ", ...");
    }
    return count;
}

static int tell_missing(const struct losses *losses, struct bsq_ctx *ctx, struct tiles *tiles)
{
    char names[80] = "";
    const uint32_t count = take_missing(losses, tiles, names, sizeof names);
    int status =
        count == 0
            ? 0
            : bsq_warn_loss(ctx, "%s: %u %s no file that can be read: %s; the scan is black there",
                            tiles->path, count, count == 1 ? "tile has" : "tiles have", names);
    if (status == 0 && tiles->outside == 1 && !mark_told(losses, tiles->path, ALL_TILES))
        status = bsq_warn_loss(ctx, "%s: the scan is black where it lies outside of all tiles",
                               tiles->path);
    return status;
}

int fmt_textures_tell_damage(const struct fmt_textures *textures)
{
    int status = 0;
    for (uint64_t i = 0; i < textures->tiles_count && status == 0; i++) {
        const struct tiles *tiles = textures->tiles[i];
        if (tiles->damaged > 0)
            status = bsq_warn_loss(textures->ctx, "%s: %" PRIu64 " %s not used; the first: %s",
                                   tiles->path, tiles->damaged,
                                   tiles->damaged == 1 ? "tile is" : "tiles are", tiles->damage);
    }
    return status;
}

int fmt_textures_tell_losses(struct fmt_textures *const *sets, uint32_t count)
{
    struct losses losses = {.sets = sets, .count = count};
    struct bsq_ctx *ctx = NULL;
    int status = 0;
    for (uint32_t s = 0; s < count; s++) {
        struct fmt_textures *textures = sets[s];
        if (!textures)
            continue;
        ctx = textures->ctx;
        for (uint32_t i = 0; i < textures->image_count && status == 0; i++)
            status = tell_broken(&losses, textures, i);
        for (uint64_t i = 0; i < textures->tiles_count && status == 0; i++)
            status = tell_missing(&losses, ctx, textures->tiles[i]);
    }
    if (losses.told)
        bsq_free(ctx, losses.told);
    return status;
}
