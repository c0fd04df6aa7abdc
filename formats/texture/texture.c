/* texture.c - textures of one file or of a file for each tile.
 *
 * All images are decoded at once, each on one thread. One that fails is decoded again alone: a
 * context keeps the message of its first failure only, and memory may have been short because
 * others were decoded.
 *
 * A lookup in a texture of tiles stays in the tile of its centre, at whose border texels repeat:
 * the neighbour may show another part of the scan. */
#include "formats/texture/texture.h"

#include <inttypes.h>
#include <math.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>

#include "base/context.h"
#include "base/parallel.h"
#include "base/text.h"
#include "formats/material/tile_files.h"
#include "formats/texture/image_rows.h"
#include "formats/texture/pyramid.h"

enum { ALL_TILES = FMT_TILE_COLUMNS * FMT_TILE_ROWS };

/* The image of a file. */
struct image {
    const char *path; /* owned by the texture */
    uint32_t texture;
    int status;   /* 0, or why the file cannot be read */
    char *damage; /* the message then */
    bool has_alpha, told;
    struct fmt_pyramid pyramid;
};

/* What a source is, and all that are equal to it. */
struct texture {
    struct fmt_texture_source source;
    uint32_t first;              /* image; more images follow, in the order of `files` */
    struct fmt_tile_files files; /* empty for a texture of one file */
    /* Of each tile, and at last of what lies outside of all: 1 if a lookup found it missing, 2 if
     * that was told. NULL: the texture has one file. */
    atomic_uchar *missing;
};

struct fmt_textures {
    struct bsq_ctx *ctx;
    struct fmt_blocks blocks;
    bool keeps; /* texels are kept for lookups */
    struct bsq_tally tally;
    struct bsq_texts paths; /* of the sources */
    uint32_t *texture_of;   /* of each source; UINT32_MAX: it has no path */
    struct texture *list;
    uint64_t count, capacity;
    struct image *images;
    uint64_t image_count, image_capacity;
};

/* ---- listing ---- */

static int add_image(struct fmt_textures *t, const char *path)
{
    int status =
        t->image_count < UINT32_MAX
            ? BSQ_GROW(t->ctx, "texture images", t->image_count + 1, &t->images, &t->image_capacity)
            : bsq_fail(t->ctx, BSQ_EDATA, "%s: too many textures", path);
    if (status == 0)
        t->images[t->image_count++] =
            (struct image){.path = path, .texture = (uint32_t)(t->count - 1)};
    return status;
}

/* Adds a texture and its images. path: a copy of the source's */
static int texture_add(struct fmt_textures *t, const struct fmt_texture_source *source,
                       const char *path)
{
    struct bsq_ctx *ctx = t->ctx;
    BSQ_PASS(BSQ_GROW(ctx, "textures", t->count + 1, &t->list, &t->capacity));
    struct texture *texture = &t->list[t->count++];
    *texture = (struct texture){.source = *source, .first = (uint32_t)t->image_count};
    texture->source.path = path;
    if (!fmt_has_tiles(path))
        return add_image(t, path);
    BSQ_PASS(bsq_calloc(ctx, "texture tiles", ALL_TILES + 1, 1, &texture->missing));
    BSQ_PASS(fmt_tile_files_find(ctx, path, &texture->files));
    if (texture->files.count == 0)
        return bsq_fail(ctx, BSQ_ENOINPUT, "%s: no tile of this texture exists", path);
    for (uint64_t i = 0; i < texture->files.count; i++)
        BSQ_PASS(add_image(t, texture->files.list[i].path));
    return 0;
}

/* Lists each distinct source once, in the order of the sources: materials often share a file. */
static int texture_list(struct fmt_textures *t, uint32_t count,
                        void (*source_of)(const void *, uint64_t, struct fmt_texture_source *),
                        const void *arg)
{
    struct bsq_ctx *ctx = t->ctx;
    uint32_t *known = NULL; /* of each path: its textures, by what else a source says */
    uint64_t capacity = 0, paths = 0, path = 0;
    int status = 0;
    for (uint32_t i = 0; i < count; i++) {
        struct fmt_texture_source source = {0};
        source_of(arg, i, &source);
        t->texture_of[i] = UINT32_MAX;
        if (!source.path)
            continue;
        BSQ_TRY(bsq_texts_add(ctx, &t->tally, &t->paths, source.path, &path));
        BSQ_TRY(BSQ_GROW(ctx, "textures", 8 * t->paths.count, &known, &capacity));
        for (; paths < t->paths.count; paths++)
            memset(known + 8 * paths, 0xff, 8 * sizeof *known);
        uint32_t *texture = &known[8 * path + 4 * source.data + 2 * source.alpha + source.srgb];
        if (*texture == UINT32_MAX) {
            *texture = (uint32_t)t->count;
            BSQ_TRY(texture_add(t, &source, t->paths.list[path]));
        }
        t->texture_of[i] = *texture;
    }
done:
    bsq_free(ctx, known);
    return status;
}

/* ---- decoding ---- */

/* Moves the channels that a pyramid keeps to the front of a row. */
static void keep_channels(const struct fmt_rows_info *info, uint32_t first, uint32_t channels,
                          uint8_t *row)
{
    const size_t texel = info->channels * info->sample_bytes, kept = channels * info->sample_bytes;
    const uint8_t *from = row + first * info->sample_bytes;
    for (uint32_t x = 0; kept < texel && x < info->width; x++, from += texel, row += kept)
        memmove(row, from, kept);
}

/* Reads all rows of an image, and keeps them if lookups are wanted. */
static int texture_read_rows(struct fmt_textures *t, struct image *image, struct fmt_rows *rows,
                             uint8_t *row)
{
    const struct fmt_texture_source *source = &t->list[image->texture].source;
    const struct fmt_rows_info *info = &rows->info;
    const uint32_t first = source->alpha && info->alpha > 0 ? (uint32_t)info->alpha : 0;
    struct fmt_pyramid *pyramid = &image->pyramid;
    int status = 0;
    *pyramid = (struct fmt_pyramid){.blocks = &t->blocks,
                                    .width = info->width,
                                    .height = info->height,
                                    .channels = info->channels >= 3 && !source->alpha ? 3 : 1,
                                    .sample_bytes = info->sample_bytes};
    if (t->keeps)
        BSQ_TRY(fmt_pyramid_begin(pyramid, source->data || source->alpha ? 1
                                           : source->srgb                ? 0
                                                                         : info->gamma));
    for (uint32_t y = 0; y < info->height; y++) {
        BSQ_TRY(bsq_check(t->ctx));
        BSQ_TRY(rows->decoder->read(rows->state, row));
        if (!t->keeps)
            continue;
        keep_channels(info, first, pyramid->channels, row);
        BSQ_TRY(fmt_pyramid_add_row(pyramid, row));
    }
done:
    fmt_pyramid_end(pyramid);
    return status;
}

/* sharers: how many images may be decoded at the same time. */
static int texture_decode(struct fmt_textures *t, struct image *image, unsigned sharers)
{
    struct fmt_rows rows;
    uint8_t *row = NULL;
    int status;
    BSQ_TRY(fmt_rows_open(t->ctx, image->path, sharers, &rows));
    image->has_alpha = rows.info.alpha >= 0;
    BSQ_TRY(bsq_alloc(t->ctx, "texture rows", rows.info.width,
                      (uint64_t)rows.info.channels * rows.info.sample_bytes, &row));
    BSQ_TRY(texture_read_rows(t, image, &rows, row));
    BSQ_TRY(bsq_file_check(t->ctx, &rows.input.file));
done:
    bsq_free(t->ctx, row);
    fmt_rows_close(&rows);
    if (status < 0)
        fmt_pyramid_free(&image->pyramid);
    return status;
}

static bool is_fault_of_image(const struct image *image)
{
    return image->status == BSQ_EDATA || image->status == BSQ_ENOINPUT;
}

static int decode_image(void *arg, uint64_t index, unsigned worker)
{
    struct fmt_textures *t = arg;
    struct image *image = &t->images[index];
    (void)worker;
    const uint64_t count = t->image_count, threads = bsq_threads(t->ctx);
    image->status = texture_decode(t, image, (unsigned)(count < threads ? count : threads));
    const bool may_have_been_short = image->status == BSQ_ENOMEM && t->image_count > 1;
    return is_fault_of_image(image) || may_have_been_short ? 0 : image->status;
}

/* Decodes an image again that failed. What is wrong with its file may be left for later: a tile
 * less, or a texture that is not kept. */
static int decode_again(struct fmt_textures *t, struct image *image)
{
    const bool may_fail = !t->keeps || t->list[image->texture].missing;
    bsq_clear_error(t->ctx);
    image->status = texture_decode(t, image, 1);
    if (!is_fault_of_image(image) || !may_fail || bsq_check(t->ctx) < 0)
        return image->status;
    image->damage = strdup(bsq_error(t->ctx));
    bsq_clear_error(t->ctx);
    return image->damage ? 0 : bsq_fail(t->ctx, BSQ_ENOMEM, "%s: out of memory", image->path);
}

/* If all files of a texture are damaged, returns the image whose damage is reported; otherwise
 * NULL. */
static const struct image *damaged_image(const struct fmt_textures *t,
                                         const struct texture *texture)
{
    const uint64_t count = texture->missing ? texture->files.count : 1;
    for (uint64_t i = 0; i < count; i++)
        if (!t->images[texture->first + i].damage)
            return NULL;
    return &t->images[texture->first + count - 1];
}

static int texture_decode_all(struct fmt_textures *t)
{
    BSQ_PASS(bsq_parallel_for(t->ctx, t->image_count, decode_image, t));
    for (uint64_t i = 0; i < t->image_count; i++)
        if (t->images[i].status < 0)
            BSQ_PASS(decode_again(t, &t->images[i]));
    for (uint64_t i = 0; i < t->count && t->keeps; i++) {
        const struct image *damaged = damaged_image(t, &t->list[i]);
        if (damaged)
            return bsq_fail(t->ctx, damaged->status, "%s", damaged->damage);
    }
    return fmt_blocks_finish(&t->blocks);
}

/* ---- opening and closing ---- */

int fmt_textures_open(struct bsq_ctx *ctx, uint64_t count,
                      void (*source_of)(const void *, uint64_t, struct fmt_texture_source *),
                      const void *arg, uint64_t cache_bytes, struct fmt_textures **out)
{
    struct fmt_textures *t = NULL;
    int status;
    *out = NULL;
    if (count > UINT32_MAX)
        return bsq_fail(ctx, BSQ_EDATA, "too many textures: %" PRIu64, count);
    BSQ_TRY(BSQ_CALLOC(ctx, "textures", 1, &t));
    t->ctx = ctx;
    t->keeps = cache_bytes > 0;
    fmt_blocks_create(ctx, cache_bytes, &t->blocks);
    BSQ_TRY(BSQ_ALLOC(ctx, "textures", count + 1, &t->texture_of));
    BSQ_TRY(texture_list(t, (uint32_t)count, source_of, arg));
    BSQ_TRY(texture_decode_all(t));
    *out = t->count > 0 ? t : NULL;
done:
    if (!*out)
        fmt_textures_close(t);
    return status;
}

void fmt_textures_close(struct fmt_textures *t)
{
    if (!t)
        return;
    struct bsq_ctx *ctx = t->ctx;
    for (uint64_t i = 0; i < t->image_count; i++) {
        fmt_pyramid_free(&t->images[i].pyramid);
        free(t->images[i].damage);
    }
    for (uint64_t i = 0; i < t->count; i++) {
        fmt_tile_files_free(ctx, &t->list[i].files);
        bsq_free(ctx, t->list[i].missing);
    }
    fmt_blocks_free(&t->blocks);
    BSQ_FREE(ctx, t->images, t->list, t->texture_of);
    bsq_texts_free(&t->paths);
    bsq_tally_release(ctx, &t->tally);
    bsq_free(ctx, t);
}

/* ---- lookups ---- */

bool fmt_texture_has_alpha(const struct fmt_textures *t, uint32_t source)
{
    const struct texture *texture = &t->list[t->texture_of[source]];
    const uint64_t count = texture->missing ? texture->files.count : 1;
    bool any = false;
    for (uint64_t i = 0; i < count && !any; i++)
        any = t->images[texture->first + i].has_alpha;
    return any;
}

int fmt_texture_problem(const struct fmt_textures *t, uint32_t source, const char **text)
{
    const struct image *damaged = damaged_image(t, &t->list[t->texture_of[source]]);
    *text = damaged ? damaged->damage : NULL;
    return damaged ? damaged->status : 0;
}

/* Moves a coordinate to the border between tiles that it misses by rounding only. */
static double settle(float coordinate)
{
    const double u = (double)coordinate, border = rint(u);
    return fabs(u - border) < 1e-5 ? border : u;
}

/* Returns the lower corner of the tile that a coordinate is in; a border ends the tile below. */
static double texture_corner_of(double u)
{
    return fmax(ceil(u) - 1, fmin(floor(u), 0));
}

/* Returns the number of a tile; ALL_TILES if there is none with these whole coordinates. */
static uint32_t tile_number(double u, double v)
{
    const bool inside = u >= 0 && v >= 0 && u < FMT_TILE_COLUMNS && v < FMT_TILE_ROWS;
    return inside ? (uint32_t)u + FMT_TILE_COLUMNS * (uint32_t)v : (uint32_t)ALL_TILES;
}

static int compare_numbers(const void *a, const void *b)
{
    const uint32_t x = *(const uint32_t *)a, y = ((const struct fmt_tile_file *)b)->number;
    return (x > y) - (x < y);
}

/* Returns the image of a tile, or NULL. */
static const struct image *texture_find_image(const struct fmt_textures *t,
                                              const struct texture *texture, uint32_t number)
{
    const struct fmt_tile_files *files = &texture->files;
    const struct fmt_tile_file *file =
        bsearch(&number, files->list, files->count, sizeof *files->list, compare_numbers);
    const struct image *image = file ? &t->images[texture->first + (file - files->list)] : NULL;
    return image && !image->damage ? image : NULL;
}

/* Moves an interval of this width into the unit interval, if it is not wider. */
static double keep_inside(double centre, float width, uint32_t texels)
{
    const double texel = (double)(1.0f / (float)texels);
    const double half = 0.5 * fmin(fmax((double)width, texel), 1.0);
    return (double)(float)fmin(fmax(centre, half), 1.0 - half);
}

static int texture_sample(const struct image *image, double u, double v, float du, float dv,
                          float out[3])
{
    const struct fmt_pyramid *p = &image->pyramid;
    /* Reduce to one period before scaling, so that large coordinates keep their precision in
     * texels. */
    return fmt_pyramid_average(p, (u - floor(u)) * p->width, (ceil(v) - v) * p->height,
                               (double)du * p->width, (double)dv * p->height, out);
}

/* Looks up the tile that a point is in, or that ends there if there is no such file. */
static int sample_tiles(struct fmt_textures *t, struct texture *texture, double u, double v,
                        float du, float dv, float out[3])
{
    const struct image *image = NULL;
    double left = 0, lower = 0;
    for (int i = 0; i < 4 && !image; i++) {
        left = floor(u) - (double)(i & 1);
        lower = floor(v) - (double)(i >> 1);
        if (u - left <= 1 && v - lower <= 1)
            image = texture_find_image(t, texture, tile_number(left, lower));
    }
    if (image)
        return texture_sample(image, keep_inside(u - left, du, image->pyramid.width),
                              keep_inside(v - lower, dv, image->pyramid.height), du, dv, out);
    atomic_uchar *missing =
        &texture->missing[tile_number(texture_corner_of(u), texture_corner_of(v))];
    if (atomic_load_explicit(missing, memory_order_relaxed) == 0)
        atomic_store_explicit(missing, 1, memory_order_relaxed);
    out[0] = out[1] = out[2] = 0;
    return 0;
}

/* Returns a coordinate in the image that has the same texel. */
static double unwrap(enum fmt_wrap wrap, float u, float width, uint32_t texels)
{
    const double x = (double)u;
    if (wrap == FMT_WRAP_REPEAT)
        return x;
    return keep_inside(wrap == FMT_WRAP_MIRROR ? fabs(x - 2 * rint(x / 2)) : x, width, texels);
}

int fmt_texture_sample(struct fmt_textures *t, uint32_t source, const uint8_t wrap[2], float u,
                       float v, float du, float dv, float out[3])
{
    struct texture *texture = &t->list[t->texture_of[source]];
    const struct image *image = &t->images[texture->first];
    const struct fmt_pyramid *p = &image->pyramid;
    return texture->missing
               ? sample_tiles(t, texture, settle(u), settle(v), du, dv, out)
               : texture_sample(image, unwrap((enum fmt_wrap)wrap[0], u, du, p->width),
                                unwrap((enum fmt_wrap)wrap[1], v, dv, p->height), du, dv, out);
}

/* ---- losses ---- */

int fmt_textures_tell_damage(const struct fmt_textures *t)
{
    for (uint64_t i = 0; i < t->count; i++) {
        const struct texture *texture = &t->list[i];
        const char *first = NULL;
        uint64_t count = 0;
        for (uint64_t f = 0; f < texture->files.count && !damaged_image(t, texture); f++) {
            const char *damage = t->images[texture->first + f].damage;
            first = first ? first : damage;
            count += damage != NULL;
        }
        if (count > 0)
            BSQ_PASS(bsq_warn_loss(t->ctx, "%s: %" PRIu64 " %s not used; the first: %s",
                                   texture->source.path, count,
                                   count == 1 ? "tile is" : "tiles are", first));
    }
    return 0;
}

/* Warns of texels of a file that are not finite, once for all images of this file. */
static int tell_broken(struct fmt_textures *t, const struct image *image)
{
    if (image->pyramid.broken == 0 || image->told)
        return 0;
    for (uint64_t i = 0; i < t->image_count; i++)
        t->images[i].told |= strcmp(t->images[i].path, image->path) == 0;
    return bsq_warn_loss(t->ctx, "%s: texels that are not finite: %" PRIu64 "; they count as 0",
                         image->path, image->pyramid.broken);
}

/* Marks a missing tile as told in all textures of this path. Returns whether it was told before. */
static bool mark_told(struct fmt_textures *t, const char *path, uint32_t tile)
{
    bool before = false;
    for (uint64_t i = 0; i < t->count; i++) {
        struct texture *texture = &t->list[i];
        if (!texture->missing || strcmp(texture->source.path, path) != 0)
            continue;
        before |= texture->missing[tile] == 2;
        texture->missing[tile] = 2;
    }
    return before;
}

/* Takes the tiles that were found missing and not told yet. Writes the first numbers to `names`.
 * Returns how many there are. */
static uint32_t take_missing(struct fmt_textures *t, const struct texture *texture, char *names,
                             size_t size)
{
    enum { SHOWN = 5 };
    uint32_t count = 0;
    size_t length = 0;
    for (uint32_t tile = 0; tile < ALL_TILES; tile++) {
        if (texture->missing[tile] != 1 || mark_told(t, texture->source.path, tile))
            continue;
        if (count++ < SHOWN)
            length += (size_t)snprintf(names + length, size - length, "%s%u",
                                       length > 0 ? ", " : "", 1001 + tile);
        else if (count == SHOWN + 1)
            snprintf(names + length, size - length, ", ...");
    }
    return count;
}

static int tell_missing(struct fmt_textures *t, const struct texture *texture)
{
    char names[80] = "";
    if (!texture->missing)
        return 0;
    const char *path = texture->source.path;
    const uint32_t count = take_missing(t, texture, names, sizeof names);
    if (count > 0)
        BSQ_PASS(bsq_warn_loss(t->ctx,
                               "%s: %u %s no file that can be read: %s; the scan is black there",
                               path, count, count == 1 ? "tile has" : "tiles have", names));
    if (texture->missing[ALL_TILES] == 1 && !mark_told(t, path, ALL_TILES))
        BSQ_PASS(bsq_warn_loss(t->ctx, "%s: the scan is black where it lies outside of all tiles",
                               path));
    return 0;
}

int fmt_textures_tell_losses(struct fmt_textures *t)
{
    for (uint64_t i = 0; t && i < t->image_count; i++)
        BSQ_PASS(tell_broken(t, &t->images[i]));
    for (uint64_t i = 0; t && i < t->count; i++)
        BSQ_PASS(tell_missing(t, &t->list[i]));
    return 0;
}
