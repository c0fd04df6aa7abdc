/* maps.h - texture maps: the table of maps, the image that is baked, and the files.
 *
 * In: sums of hits, patch by patch (bk_maps.h). They become values of a float image, in memory or
 * in a temporary file. Out: dilated, encoded image files, one for each map. All appear, or none.
 *
 * A sample of a texel is covered if it lies in a triangle of the low-poly mesh. */
#ifndef BAKE_MAPS_MAPS_H
#define BAKE_MAPS_MAPS_H

#include "base/file.h"
#include "formats/image/image_writer.h"
#include "libbake/bake.h"
#include "libbake/kernel/bk_maps.h"
#include "libbake/udim/udim.h"
#include "libbake/raster/raster.h"

/* ---- the table of maps ---- */

/* How a file stores values, in each channel: value = offset + scale * sample. Values are relative
 * to a world position, `origin`. */
struct bake_encoding {
    double scale[3], offset[3]; /* scale 0: there is only one value, which is stored as 1/2 */
    double origin[3];
    double radius;       /* of curvature; else 0 */
    double range;        /* half of the largest scale that an integer file has */
    float background[3]; /* samples of texels without a value */
};

/* Statistics of the magnitudes of a map's values, over the valid texels of all its files. */
struct bake_statistics {
    uint64_t count;
    double largest, sum, squares;
};

/* Adds a value. */
void bake_statistics_add_value(struct bake_statistics *to, float value);
/* Return the mean of the magnitudes, and of their squares; 0 without texels. */
double bake_statistics_mean(const struct bake_statistics *statistics);
double bake_statistics_mean_square(const struct bake_statistics *statistics);

/* What is known when all images of a mesh are complete. */
struct bake_measures {
    struct bake_statistics statistics[BK_MAP_COUNT];
    double curvature_radius; /* world units */
};

/* How maps were traced. */
struct bake_traced {
    double front, back;              /* ray lengths as used, in mesh units */
    const char *sampling;            /* "trilinear", "nearest" or "exact" */
    double scan_min[3], scan_max[3]; /* bounds of the scan, world */
    const char *scans;               /* the names of several scans; NULL: there is one */
    const char *ids;                 /* what ids tell apart, see fmt_ids_text() */
    double image_origin[3];          /* world position that the image's positions are relative to */
};

/* What an encoding may depend on. */
struct bake_encoding_facts {
    const struct bake_options *options;
    const struct bake_traced *traced;
    struct bake_statistics statistics; /* of the map */
    double curvature_radius;
    bool integers; /* the file's samples hold 0 to 1 */
};

/* Texts for a file's header. Numbers live in `text`. */
struct bake_attributes {
    struct fmt_image_attribute list[16];
    uint32_t count;
    char text[4][96];
};

struct bake_map_row {
    const char *summary; /* for --help */
    const char *alias;   /* another name for --maps, or NULL */
    uint32_t channels;   /* of the file: 1 or 3 */
    /* Floats that `resolve` writes, if more than `channels`; a later step reduces them to the first
     * `channels` values. 0: as many as channels. */
    uint32_t values;
    bool by_default;  /* baked if no maps are named and the scan has the colours it needs */
    bool needs_color; /* from the scan */
    bool needs_ids;   /* likewise */
    bool color;       /* values are linear light; otherwise data, which is not transformed */
    bool of_all;      /* samples that missed count as 0, and it is not dilated */
    bool rounded;     /* samples of 8 bits are not dithered */
    /* The sample type if none is asked for; BAKE_SAMPLE_USUAL: the usual type of the format. */
    enum bake_sample_type usual_type;
    /* Turns a texel's sums into its value; weight is 1 / hits. Returns false if the sums give no
     * value; then the texel has no value in any map. NULL: the map shows the share of covered
     * samples that hit, times the transfer map that is part of the mask. It is not dilated. */
    bool (*resolve)(const float *sums, uint32_t channels, float weight, float *value);
    /* Changes *out, which holds scale 1 and zeros; NULL: keeps them. */
    void (*encode)(const struct bake_encoding_facts *facts, struct bake_encoding *out);
    /* The values' unit, for maps whose files say how to decode them; NULL: there is none. */
    const char *unit;
    bool measured;  /* the encoding needs statistics */
    bool positions; /* values in the image are positions relative to bake_traced.image_origin */
    /* Adds the map's own attributes; NULL: there are none. */
    void (*describe)(const struct bake_options *options, const struct bake_traced *traced,
                     struct bake_attributes *out);
};

/* Maps that users name are the rows before this one. It stands for no map: its values, the position
 * and the normal of a texel's hits and two values of the filter's own, guide libbake/filter/. */
enum { BAKE_NAMED_MAPS = BK_MAP_guide, BAKE_GUIDE_VALUES = 8 };

/* Rows in the order of BK_MAPS; row i is bit i of enum bake_map. */
extern const struct bake_map_row bake_map_table[];
/* Returns the floats of row i in a texel of the image. */
uint32_t bake_map_values(unsigned i);

/* ---- selections ---- */

/* A selection of maps has the bits of rows and the number of transfer maps, see BK_TRANSFER_SHIFT.
 * Map number i of a selection is row i or, from BK_MAP_COUNT on, a transfer map of the options. */

/* Returns the options' maps, without defaults, and transfer maps as a selection. */
uint32_t bake_selection(const struct bake_options *options);
/* Returns whether rays start at a cage. */
static inline bool bake_has_cage(const struct bake_options *options)
{
    return options->cage_path || options->extrude > 0;
}
/* Returns how many of its texel's rays each sample sends: the same number, so that a texel may send
 * a few more than the options say. */
static inline uint32_t bake_sample_rays(const struct bake_options *options, uint32_t rays)
{
    const uint32_t samples = options->samples * options->samples;
    return (rays + samples - 1) / samples;
}
/* Returns the first number above those of all maps of a selection. */
static inline unsigned bake_selection_end(uint32_t maps)
{
    return BK_MAP_COUNT + bk_transfers(maps);
}
static inline bool bake_is_selected(uint32_t maps, unsigned number)
{
    return number < BK_MAP_COUNT ? maps >> number & 1u : number < bake_selection_end(maps);
}
/* The files of a bake have the numbers of maps and, from bake_selection_end() on, those of packs.
 * Returns the first number above those of all files. */
static inline unsigned bake_files_end(const struct bake_options *options, uint32_t maps)
{
    return bake_selection_end(maps) + options->pack_count;
}
/* What a channel of a packed file shows. */
enum { BAKE_MAX_PACKED = 4 };
#define BAKE_UNPACKED (UINT32_MAX - 1) /* no such map */
#define BAKE_CONSTANT UINT32_MAX
struct bake_packed {
    const char *word; /* of the pack */
    size_t length;
    uint32_t number;   /* of the map; or one of the above */
    float scale, bias; /* sample = scale * the map's sample + bias */
};
/* Reads the words of a pack. Returns their number; 0 if there are none or too many. */
unsigned bake_unpack(const struct bake_options *options, const struct bake_pack *pack,
                     struct bake_packed out[BAKE_MAX_PACKED]);
/* Returns whether a map is selected and has a file of its own, or a pack has this number. */
bool bake_has_file(const struct bake_options *options, uint32_t maps, unsigned number);
/* Returns the row of a map, which transfer maps of one kind share. */
const struct bake_map_row *bake_row_of(const struct bake_options *options, unsigned number);
/* Returns the name that stands for "<MAP>" in file names. */
const char *bake_name_of(const struct bake_options *options, unsigned number);
/* Returns the output path of a map; NULL if there is no memory. The caller frees it. */
char *bake_path_of(const struct bake_options *options, unsigned number);
/* Returns the lowest number in a selection, which is not empty. */
unsigned bake_first_of(uint32_t maps);
/* Returns the offset of a map's values in a texel of the image. */
uint32_t bake_map_offset(uint32_t maps, unsigned number);

/* Name and sums of row i, from BK_MAPS. */
extern const char *const bake_map_names[BK_MAP_COUNT];
extern const uint32_t bake_map_sums[BK_MAP_COUNT];

void bake_add_attribute(struct bake_attributes *attributes, const char *name, const char *value);

/* Returns the maps to bake: those asked for, all that a scan with these attributes can give, or the
 * default ones. Leaves transfer maps out. */
uint32_t bake_choose_maps(uint32_t asked, bool has_color, bool has_ids);

/* Returns the length of rays into the solid, in mesh units. */
double bake_thickness_distance(const struct bake_options *options, const double scan_min[3],
                               const double scan_max[3]);

/* ---- the image ---- */

/* The image that is baked holds floats, texel by texel. Sample 0 is BAKE_OUTSIDE outside all
 * charts, BAKE_MISSED inside a chart without a value, and otherwise the share of the covered
 * samples that hit, in (0, 1]. A texel with a share is valid. The values of the selected maps
 * follow; they are undefined in a texel that is not valid. */
#define BAKE_OUTSIDE 0.0f
#define BAKE_MISSED  (-1.0f)

/* Its members do not change. */
struct bake_image {
    struct bsq_ctx *ctx;
    uint32_t width, height, channels;
    size_t texel_bytes;
    float *samples; /* NULL: the image is in `file` */
    struct bsq_file file;
    const struct bake_blocks *blocks; /* NULL: an ordinary image */
};

struct bake_image_options {
    uint32_t width, height; /* texels */
    uint32_t channels;      /* floats a texel: bake_image_channels_for() */
    uint64_t memory_bytes;  /* a larger image goes to a temporary file */
    const char *beside;     /* output path; temporary files go beside it, see bsq_file_temp() */
    /* Holds these blocks only, each of full size, one below the other: block n has the rows from
     * n * side on. Then width and height are those of all of them. NULL: an ordinary image. */
    const struct bake_blocks *blocks;
};

/* Returns the floats that an image's texel has for these maps. */
uint32_t bake_image_channels_for(uint32_t maps);

/* Creates an image of zeros. */
int bake_image_create(struct bsq_ctx *ctx, const struct bake_image_options *options,
                      struct bake_image **out);
void bake_image_free(struct bake_image *image); /* NULL is allowed */

/* Stores a rectangle of texels, interleaved, row by row. Several threads may write disjoint ones.
 */
int bake_image_write(struct bake_image *image, uint32_t x, uint32_t y, uint32_t width,
                     uint32_t height, const float *samples);

/* Stores a patch of the map likewise. For an image of blocks, (x, y) is the patch's place in the
 * map, and the patch lies in one of the blocks. */
int bake_image_write_patch(struct bake_image *image, const struct bk_patch *patch,
                           const float *samples);

/* Points *rows at `count` rows from `y` on: at the image itself if it is in memory, otherwise at
 * `buffer` (count * width * channels floats) after reading. */
int bake_image_rows(const struct bake_image *image, uint32_t y, uint32_t count, float *buffer,
                    const float **rows);

/* Calls fn for bands of at most `band_rows` rows of an image, from top to bottom. With `change`, it
 * may change the texels, which are then stored. Returns the first failure. Errors: BSQ_ENOMEM,
 * BSQ_EIO, and those of fn. */
typedef int bake_band_fn(void *arg, uint32_t first_row, uint32_t rows, float *texels);
int bake_image_bands(struct bsq_ctx *ctx, struct bake_image *image, uint32_t band_rows, bool change,
                     bake_band_fn *fn, void *arg);

/* Adds the magnitudes of the values of maps whose rows are `measured`. Errors: BSQ_ENOMEM, BSQ_EIO.
 */
int bake_image_measure(struct bsq_ctx *ctx, struct bake_image *image, uint32_t maps,
                       struct bake_statistics statistics[BK_MAP_COUNT]);

/* ---- patches ---- */

/* What tracing a map's patches needs, on a grid or on triangles. */
struct bake_patches {
    const struct bake_raster *raster;
    const struct bk_triangle *triangles; /* of the low-poly mesh */
    uint32_t triangle_count;
    const struct bk_params *params;
    /* Of bake_image_channels_for(params->maps) channels, or of one more: the object of each texel,
     * as bits. */
    struct bake_image *image;
    uint32_t patch_side; /* side in texels */
};

/* Returns a side for patches: large if there is work for all threads, small if memory is short.
 * maps: a selection of maps. */
uint32_t bake_patch_side(struct bsq_ctx *ctx, uint32_t width, uint32_t height, uint32_t samples,
                         uint32_t maps);

/* Buffers of one worker for one patch, and its counts for the report. */
struct bake_patch_worker {
    uint32_t *sample_triangles; /* of a patch, as bake_raster_fill() writes them */
    float *texels;              /* sums, texel_floats each */
    float *resolved;            /* image channels of a patch's texels */
    uint64_t covered_texels, samples, hits, overlaps;
};

struct bake_patch_workers {
    struct bake_patch_worker *workers; /* one a thread; NULL: none yet */
    uint32_t channels;                 /* of the image */
    uint32_t texel_floats;
    uint32_t more; /* of these at the end, which the image has too */
    uint32_t maps; /* bits of enum bake_map */
};

/* Creates zeroed counts and buffers, with sums of `texel_count` texels, and begins the progress
 * "tracing" with the texels of all patches. Call bake_patch_workers_end() also after a failure. */
int bake_patch_workers_begin(struct bsq_ctx *ctx, const struct bake_patches *patches,
                             uint64_t texel_count, struct bake_patch_workers *out);

/* Adds the worker's first `count` texels to its counts, and writes them to `out` as the image
 * stores them. */
void bake_patch_worker_resolve(const struct bake_patch_workers *workers,
                               struct bake_patch_worker *worker, uint32_t count, float *out);

/* Adds all counts to the report's covered_texels, samples, hits, misses and overlapping_samples,
 * ends the progress and frees the buffers. */
void bake_patch_workers_end(struct bsq_ctx *ctx, struct bake_patch_workers *workers,
                            struct bake_report *report);

/* ---- thumbnails ---- */

/* A map made smaller by averaging, as texture of the preview. */
struct bake_thumbnail {
    uint32_t full_width, full_height; /* of the map */
    uint32_t factor;                  /* texels of the map along a side of one texel here */
    uint32_t width, height;
    float (*texels)[3]; /* NULL: there is no such map */
};

/* Returns a side in texels: `most`, halved until the thumbnail of a square map fits in `bytes`. */
uint32_t bake_thumbnail_side(uint32_t most, uint64_t bytes);
/* Creates a black thumbnail with sides of at most `side` texels. Free with bake_thumbnail_free().
 */
int bake_thumbnail_create(struct bsq_ctx *ctx, uint32_t full_width, uint32_t full_height,
                          uint32_t side, struct bake_thumbnail *out);
/* Creates the thumbnail of an image's misses. Channel 0 has the share of texels inside charts
 * without a value, channel 1 that of texels with one, channel 2 is 0. Must not be called from
 * parallel work. Errors: BSQ_ENOMEM, and those of bake_image_rows(). */
int bake_thumbnail_of_missed(struct bsq_ctx *ctx, struct bake_image *image, uint32_t side,
                             struct bake_thumbnail *out);
void bake_thumbnail_free(struct bsq_ctx *ctx, struct bake_thumbnail *thumbnail);

/* Adds rows of the map; a map of one channel has it for all three, and those after the third are
 * left out. Every row must be added exactly once. */
int bake_thumbnail_add(struct bsq_ctx *ctx, struct bake_thumbnail *thumbnail, uint32_t channels,
                       uint32_t first_row, uint32_t rows, const float *samples);

/* Returns the bilinear mean at texture coordinates (v upwards), clamped at the borders. */
void bake_thumbnail_sample(const struct bake_thumbnail *thumbnail, float u, float v, float out[3]);

/* ---- files ---- */

struct bake_map_files;

/* Checks output path, sample type and size for these maps. Errors: BSQ_EUSAGE. */
int bake_map_files_check(struct bsq_ctx *ctx, const struct bake_options *options, uint32_t maps);

/* Creates the files under temporary names, so that a directory that cannot be written to is known
 * before the work. options must outlive them. Errors: BSQ_ECANTCREAT, BSQ_ENOMEM. */
int bake_map_files_open(struct bsq_ctx *ctx, const struct bake_options *options, uint32_t maps,
                        const struct bake_traced *traced, struct bake_map_files **out);

/* Makes bake_map_files_write() fill a thumbnail of a map of three channels. */
void bake_map_files_set_thumbnail(struct bake_map_files *files, enum bake_map map,
                                  struct bake_thumbnail *thumbnail);

/* Makes bake_map_files_write() call fn for each band of rows, from top to bottom. There,
 * bake_map_rows() returns the band's rows of a map as they are written, or NULL if the map has no
 * file. */
typedef int bake_watch_fn(void *arg, const struct bake_map_files *files, uint32_t rows);
void bake_map_files_watch(struct bake_map_files *files, bake_watch_fn *fn, void *arg);
const float *bake_map_rows(const struct bake_map_files *files, uint32_t number);

/* Dilates, encodes and writes all rows of the image. measures: of all images of the mesh. Sets
 * the report's encodings. Adds to the report's seconds_padding, seconds_resolve and seconds_write.
 * Samples of 16-bit floats are limited to what these can hold; limited: one number for each map of
 * the selection, to which their counts are added. */
int bake_map_files_write(struct bake_map_files *files, const struct bake_image *image,
                         const struct bake_measures *measures, uint64_t *limited,
                         struct bake_report *report);

/* Warns of each map with samples that were limited. limited: over all images of the mesh, from
 * bake_map_files_write(). Errors: BSQ_EDATA in a strict job. */
int bake_warn_limited(struct bsq_ctx *ctx, const struct bake_options *options, uint32_t maps,
                      const uint64_t *limited);

/* Adds all complete files to a group of outputs; frees `files` in any case. */
int bake_map_files_hand_over(struct bake_map_files *files, struct bsq_output_group *group);
void bake_map_files_discard(struct bake_map_files *files); /* NULL is allowed */

#endif
