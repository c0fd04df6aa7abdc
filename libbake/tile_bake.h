/* tile_bake.h - the maps of one UDIM tile: their samples, image and files; private to libbake/. */
#ifndef BAKE_TILE_BAKE_H
#define BAKE_TILE_BAKE_H

#include "libbake/maps/maps.h"
#include "libbake/skew/skew.h"
#include "libbake/surface/surface.h"
#include "libbake/udim/udim.h"

struct bake_tile {
    struct bake_udim_tile place;
    const char *object, *material; /* that have maps of their own, or NULL */
    struct bake_options options;   /* the job's, with the size and output path of this tile */
    uint32_t maps;
    char *output_path;
    char *beside;       /* the path of one map; temporary files go to its directory */
    uint32_t tile_size; /* side of the raster's tiles in texels */
    bool in_blocks;     /* bakes `blocks` only, into an image of them */
    struct bake_blocks blocks;
    struct bake_skew_image skew;
    struct bake_raster *raster;
    struct bake_image *image;
    struct bake_map_files *files;
    struct bake_thumbnail normal, color, missed; /* `texels` is NULL if there is none */
};

struct bake_run;

/* Sets the size and output path of a tile of a set; NULL: of the whole mesh. Call bake_tile_end()
 * also after a failure. Errors: BSQ_ENOMEM. */
int bake_tile_begin(struct bsq_ctx *ctx, const struct bake_options *options, uint32_t maps,
                    const struct bake_low_set *set, const struct bake_udim_tile *place,
                    struct bake_tile *out);
void bake_tile_end(struct bsq_ctx *ctx, struct bake_tile *tile); /* zeroed: allowed */

/* Sorts the tile's triangles for sampling and writes them to job->triangles. Adds to the report's
 * degenerate_uv_triangles. Errors: those of bake_raster_create(). */
int bake_tile_rasterise(const struct bake_run *job, struct bake_tile *tile);

/* Traces all samples into the tile's image, which takes at most `memory_bytes`, or is in a
 * temporary file. Frees the raster, unless curvature needs objects of texels. Errors: those of
 * bake_image_create(), bake_trace_grid_tiles() and bake_trace_ray_tiles(). */
int bake_tile_trace(const struct bake_run *job, struct bake_tile *tile, uint64_t memory_bytes);

struct bake_tile_of_job {
    const struct bake_run *job;
    const struct bake_tile *tile;
};
/* Writes the object of each texel of a part of the tile's image: that of its first sample in a
 * triangle, BAKE_NO_OBJECT without one. arg: struct bake_tile_of_job, whose raster must be there.
 * Must not be called from parallel work. Errors: those of bake_raster_fill(); BSQ_ENOMEM. */
#define BAKE_NO_OBJECT UINT32_MAX
int bake_tile_objects(const void *arg, uint32_t x, uint32_t y, uint32_t width, uint32_t height,
                      uint32_t *out);

/* Creates the tile's image, which takes at most `memory_bytes`, or is in a temporary file. Errors:
 * those of bake_image_create(). */
int bake_tile_create_image(struct bsq_ctx *ctx, struct bake_tile *tile, uint64_t memory_bytes);

/* Returns the number of the tile's files. */
unsigned bake_tile_file_count(const struct bake_tile *tile);

/* Checks that the tile's files can be created, are no inputs, and are neither the preview nor the
 * file `other`, which may be NULL. Errors: BSQ_EUSAGE, BSQ_ECANTCREAT, BSQ_ENOMEM. */
int bake_tile_check_files(struct bsq_ctx *ctx, const struct bake_tile *tile, const char *other);

/* Creates the tile's files under temporary names, unless they are. Errors: those of
 * bake_map_files_open(). */
int bake_tile_open_files(struct bsq_ctx *ctx, struct bake_tile *tile,
                         const struct bake_traced *traced);

/* Creates thumbnails with sides of at most `side` texels: those of normals and colours, which
 * bake_map_files_write() fills, and that of misses. The files must be open and the image traced.
 * Errors: those of bake_thumbnail_create() and bake_image_rows(). */
int bake_tile_create_thumbnails(struct bsq_ctx *ctx, struct bake_tile *tile, uint32_t side);

#endif
