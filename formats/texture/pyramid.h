/* pyramid.h - images as square cells of several sizes, in memory or in a temporary file; private to
 * this folder.
 *
 * Takes rows of texels; gives averages over boxes. Level 0 has the texels as they are stored in the
 * image's file. The others have averages in linear light: cell (i, j) of level n is the average of
 * the texels [i, i + 1) x [j, j + 1) * 2^n, cut off at the image's right and lower edges. Level 1
 * is left out: a box has at least four cells along each side, so the next one serves its boxes. */
#ifndef FMT_TEXTURE_PYRAMID_H
#define FMT_TEXTURE_PYRAMID_H

#include <pthread.h>

#include "base/file.h"

/* The memory and the file that the images of a set of textures share. Levels are cut into blocks of
 * equal bytes. Images that fit stay in memory. The blocks of all others are in one unnamed file,
 * and read through a cache. */
struct fmt_blocks {
    struct bsq_ctx *ctx;
    pthread_mutex_t lock;
    uint64_t bytes;      /* that images in memory and the cache may take */
    uint64_t resident;   /* bytes of images in memory */
    uint64_t file_count; /* blocks in the file */
    struct bsq_file file;
    uint64_t set_count;
    struct block_set *sets; /* the cache; NULL: there is no file */
    uint8_t *slots;
    struct transfer *transfers;
};

struct fmt_pyramid {
    struct fmt_blocks *blocks;
    uint32_t width, height; /* texels */
    uint32_t channels;      /* 1 or 3 */
    uint32_t sample_bytes;  /* 1, 2: integers; 4: floats in linear light */
    uint32_t level_count;
    struct level *levels;
    const float *table; /* value of each integer in linear light */
    uint8_t *memory;    /* all blocks; NULL: they are in the file */
    uint64_t first;     /* block of the file */
    uint64_t resident;  /* bytes of `memory` */
    uint64_t broken;    /* texels that are not finite, which count as 0 */
};

/* Prepares for images that take at most `bytes` of memory, or 1 MiB if that is more. */
void fmt_blocks_create(struct bsq_ctx *ctx, uint64_t bytes, struct fmt_blocks *blocks);
/* Makes the cache, after the last image. Errors: BSQ_ENOMEM. */
int fmt_blocks_finish(struct fmt_blocks *blocks);
/* Frees what the images share. */
void fmt_blocks_free(struct fmt_blocks *blocks);

/* Begins an image, whose members up to sample_bytes are set and whose others are 0. `gamma` is the
 * exponent that turns its integers into linear light, or 0 for the curve of sRGB. Different threads
 * may add different images. Errors: BSQ_ENOMEM, BSQ_EIO. */
int fmt_pyramid_begin(struct fmt_pyramid *pyramid, double gamma);
/* Adds the next row from the top: width x channels samples. Errors: BSQ_EIO. */
int fmt_pyramid_add_row(struct fmt_pyramid *pyramid, const void *row);
/* Frees what only adding rows needed. */
void fmt_pyramid_end(struct fmt_pyramid *pyramid);
void fmt_pyramid_free(struct fmt_pyramid *pyramid); /* zeros are allowed */

/* Averages a box of width x height texels around (x, y), in linear light. The box is clamped to one
 * texel and to the image's size; the image repeats. out: RGB. Thread-safe. Errors: BSQ_EIO. */
int fmt_pyramid_average(const struct fmt_pyramid *pyramid, double x, double y, double width,
                        double height, float out[3]);

#endif
