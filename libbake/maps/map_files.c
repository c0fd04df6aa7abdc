/* map_files.c - writes the baked image to files, one band of rows after another.
 *
 * For each band, dilation.c finds every texel's source, all threads encode the rows of all maps,
 * and the image writers take the rows. All files get their final names together. */
#include <inttypes.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>

#include "base/context.h"
#include "base/parallel.h"
#include "libbake/maps/dilation.h"
#include "libbake/maps/map_encode.h"

enum { BAND_STEP = 64 };
#define BAND_BYTES (UINT64_C(128) << 20) /* larger bands are not faster */

struct map_file {
    unsigned number; /* of the map in the selection */
    bool integers, half;
    atomic_uint_fast64_t limited; /* samples beyond the largest half */
    struct bake_encoder encoder;  /* while writing */
    struct component {            /* of a pack: its channels, while writing */
        struct bake_packed packed;
        struct bake_encoder encoder;
    } * components;
    unsigned component_count; /* 0: a map */
    char *path;
    struct fmt_image_writer *writer;  /* NULL: nothing is written */
    struct bake_thumbnail *thumbnail; /* NULL: none */
    float *rows;                      /* of the current band, encoded */
};

struct bake_map_files {
    struct bsq_ctx *ctx;
    const struct bake_options *options;
    struct bake_traced traced;
    char *beside; /* path of an output; temporary files go to its directory */
    uint32_t maps;
    uint32_t count;
    struct map_file *files;
    struct bake_dilation *dilation; /* while writing */
    uint32_t image_channels;        /* likewise */
    bake_watch_fn *watch;           /* NULL: nobody watches */
    void *watch_arg;
};

/* ---- formats ---- */

/* Returns the sample type that the options name, else the map's usual one if the format stores it,
 * else the format's. */
static enum fmt_sample_type choose_type(const struct bake_options *options,
                                        enum bake_sample_type usual,
                                        const struct fmt_image_format *format)
{
    _Static_assert(BAKE_FLOAT - BAKE_UINT8 == (int)FMT_FLOAT, "the types are in one order");
    if (options->sample_type == BAKE_UINT8_16)
        return usual == BAKE_FLOAT ? FMT_UINT16 : FMT_UINT8;
    if (options->sample_type != BAKE_SAMPLE_USUAL)
        return (enum fmt_sample_type)(options->sample_type - BAKE_UINT8);
    if (usual == BAKE_SAMPLE_USUAL || !(format->sample_types & FMT_SAMPLE_BIT(usual - BAKE_UINT8)))
        return format->usual_type;
    return (enum fmt_sample_type)(usual - BAKE_UINT8);
}

/* Chooses a map's image format and sample type by the output's name and the options. Errors:
 * BSQ_EUSAGE. */
static int maps_choose_format(struct bsq_ctx *ctx, const struct bake_options *options,
                              unsigned number, const struct fmt_image_format **format,
                              enum fmt_sample_type *type)
{
    const char *path = options->output_path;
    *format = fmt_image_format_of(path);
    if (!*format)
        return bsq_fail(ctx, BSQ_EUSAGE,
                        "%s: maps are OpenEXR or PNG files: the name must end in .exr or .png",
                        path);
    *type = choose_type(options, bake_row_of(options, number)->usual_type, *format);
    BSQ_PASS(fmt_image_check_type(ctx, *format, path, *type));
    return fmt_image_check_tiles(ctx, *format, path, options->exr_tile_side);
}

/* Refuses tokens in small letters, which would become part of the files' names. */
static int check_tokens(struct bsq_ctx *ctx, const char *path)
{
    static const char *const tokens[] = {BAKE_MAP_TOKEN, BAKE_UDIM_TOKEN, BAKE_UVTILE_TOKEN,
                                         BAKE_OBJECT_TOKEN, BAKE_MATERIAL_TOKEN};
    for (size_t i = 0; i < sizeof tokens / sizeof *tokens; ++i)
        for (const char *at = path; (at = strcasestr(at, tokens[i])); ++at)
            if (strncmp(at, tokens[i], strlen(tokens[i])) != 0)
                return bsq_fail(ctx, BSQ_EUSAGE,
                                "%s: \"%s\" in the output's name needs capital letters", path,
                                tokens[i]);
    return 0;
}

int bake_map_files_check(struct bsq_ctx *ctx, const struct bake_options *options, uint32_t maps)
{
    const char *path = options->output_path;
    unsigned count = 0;
    BSQ_PASS(check_tokens(ctx, path));
    for (unsigned i = 0; i < bake_files_end(options, maps); ++i) {
        const struct fmt_image_format *format;
        enum fmt_sample_type type;
        if (!bake_has_file(options, maps, i))
            continue;
        count++;
        BSQ_PASS(maps_choose_format(ctx, options, i, &format, &type));
    }
    if (count > 1 && !strstr(path, BAKE_MAP_TOKEN))
        return bsq_fail(ctx, BSQ_EUSAGE,
                        "%s: several maps need \"" BAKE_MAP_TOKEN "\" in the output's name", path);
    if (options->width == 0 || options->height == 0 || options->width > BAKE_MAX_SIDE ||
        options->height > BAKE_MAX_SIDE)
        return bsq_fail(ctx, BSQ_EUSAGE,
                        "a map of %u x %u texels: its sides must be from 1 to %u texels",
                        options->width, options->height, BAKE_MAX_SIDE);
    return 0;
}

/* ---- opening ---- */

static int maps_open_file(struct bsq_ctx *ctx, const struct bake_options *options, unsigned number,
                          const struct bake_traced *traced, struct map_file *file)
{
    const struct bake_map_row *row = bake_row_of(options, number);
    struct bake_attributes attributes;
    bake_describe_map(options, number, traced, &attributes);
    struct fmt_image_options image = {
        .width = options->width,
        .height = options->height,
        .channel_count = row->channels,
        .color = row->color,
        .exr_tile_side = options->exr_tile_side,
        .rounded = row->rounded,
        .attributes = attributes.list,
        .attribute_count = attributes.count,
    };
    const struct fmt_image_format *format;
    BSQ_PASS(maps_choose_format(ctx, options, number, &format, &image.type));
    file->integers = image.type == FMT_UINT8 || image.type == FMT_UINT16;
    file->half = image.type == FMT_HALF;
    file->path = bake_path_of(options, number);
    if (!file->path)
        return bsq_fail(ctx, BSQ_ENOMEM, "%s: out of memory", options->output_path);
    return options->rows_only ? 0
                              : fmt_image_create(ctx, format, file->path, &image, &file->writer);
}

/* Notes the channels of a file that is a pack. */
static int begin_pack(struct bsq_ctx *ctx, const struct bake_options *options, uint32_t maps,
                      struct map_file *file)
{
    struct bake_packed packed[BAKE_MAX_PACKED];
    if (file->number < bake_selection_end(maps))
        return 0;
    BSQ_PASS(BSQ_CALLOC(ctx, "packed maps", BAKE_MAX_PACKED, &file->components));
    const unsigned number = file->number - bake_selection_end(maps);
    file->component_count = bake_unpack(options, &options->packs[number], packed);
    file->encoder.row = bake_row_of(options, file->number);
    for (unsigned i = 0; i < file->component_count; ++i)
        file->components[i].packed = packed[i];
    return 0;
}

int bake_map_files_open(struct bsq_ctx *ctx, const struct bake_options *options, uint32_t maps,
                        const struct bake_traced *traced, struct bake_map_files **out)
{
    struct bake_map_files *files = NULL;
    int status;
    *out = NULL;
    BSQ_TRY(BSQ_CALLOC(ctx, "map files", 1, &files));
    files->ctx = ctx;
    files->options = options;
    files->traced = *traced;
    files->maps = maps;
    files->beside = bake_path_of(options, bake_first_of(maps));
    if (!files->beside)
        BSQ_TRY(bsq_fail(ctx, BSQ_ENOMEM, "%s: out of memory", options->output_path));
    BSQ_TRY(BSQ_CALLOC(ctx, "map files", bake_files_end(options, maps), &files->files));
    for (unsigned i = 0; i < bake_files_end(options, maps); ++i)
        if (bake_has_file(options, maps, i)) {
            struct map_file *file = &files->files[files->count++];
            file->number = i;
            BSQ_TRY(begin_pack(ctx, options, maps, file));
            BSQ_TRY(maps_open_file(ctx, options, i, traced, file));
        }
    *out = files;
    files = NULL;
done:
    bake_map_files_discard(files);
    return status;
}

void bake_map_files_set_thumbnail(struct bake_map_files *files, enum bake_map map,
                                  struct bake_thumbnail *thumbnail)
{
    for (uint32_t i = 0; i < files->count; ++i)
        if (files->files[i].number < BK_MAP_COUNT && 1u << files->files[i].number == (uint32_t)map)
            files->files[i].thumbnail = thumbnail;
}

void bake_map_files_watch(struct bake_map_files *files, bake_watch_fn *fn, void *arg)
{
    files->watch = fn;
    files->watch_arg = arg;
}

const float *bake_map_rows(const struct bake_map_files *files, uint32_t number)
{
    for (uint32_t i = 0; i < files->count; ++i)
        if (files->files[i].number == number)
            return files->files[i].rows;
    return NULL;
}

/* ---- encoding ---- */

static void report_encoding(const struct bake_encoder *encoder, struct bake_value_encoding *out)
{
    const struct bake_encoding *encoding = &encoder->encoding;
    *out = (struct bake_value_encoding){.unit = encoder->row->unit,
                                        .channels = encoder->row->channels,
                                        .range = encoding->range,
                                        .radius = encoding->radius};
    memcpy(out->scale, encoding->scale, sizeof out->scale);
    memcpy(out->offset, encoding->offset, sizeof out->offset);
    memcpy(out->origin, encoding->origin, sizeof out->origin);
}

/* Transfer maps have no statistics: their values are stored as they are. */
static struct bake_statistics statistics_of(const struct bake_measures *measures, unsigned number)
{
    static const struct bake_statistics none = {0};
    return number < BK_MAP_COUNT ? measures->statistics[number] : none;
}

/* Chooses the encoding of a map in a file. */
static void choose_encoding(const struct bake_map_files *files, const struct map_file *file,
                            unsigned number, const struct bake_measures *measures,
                            struct bake_report *report, struct bake_encoder *out)
{
    const struct bake_encoding_facts facts = {.options = files->options,
                                              .traced = &files->traced,
                                              .statistics = statistics_of(measures, number),
                                              .curvature_radius = measures->curvature_radius,
                                              .integers = file->integers};
    bake_encoder_init(&facts, files->maps, number, out);
    if (number < BK_MAP_COUNT)
        report_encoding(out, &report->encodings[number]);
}

/* Chooses the encodings of all files, and writes to their headers how to decode them. */
static int choose_encodings(struct bake_map_files *files, const struct bake_measures *measures,
                            struct bake_report *report)
{
    int status = 0;
    for (uint32_t i = 0; status == 0 && i < files->count; ++i) {
        struct map_file *file = &files->files[i];
        struct bake_attributes attributes;
        for (unsigned p = 0; p < file->component_count; ++p)
            if (file->components[p].packed.number != BAKE_CONSTANT)
                choose_encoding(files, file, file->components[p].packed.number, measures, report,
                                &file->components[p].encoder);
        if (file->component_count > 0)
            continue;
        choose_encoding(files, file, file->number, measures, report, &file->encoder);
        bake_describe_encoding(&file->encoder, &attributes);
        if (file->writer)
            status = fmt_image_describe(file->writer, attributes.list, attributes.count);
    }
    return status;
}

/* ---- writing ---- */

static uint32_t maps_row_samples(const struct bake_map_files *files, uint32_t file)
{
    return files->options->width * files->files[file].encoder.row->channels;
}

/* Encodes a row of a pack: each of its maps, some texels at a time, into its channel. */
static void encode_pack(const struct bake_map_files *files, const struct map_file *file,
                        const float *const *sources, const float *texels, float *out)
{
    enum { TEXELS = 256 };
    const uint32_t channels = file->encoder.row->channels, width = files->options->width;
    float samples[TEXELS] = {0};
    memset(out, 0, (size_t)width * channels * sizeof *out);
    for (unsigned c = 0; c < file->component_count; ++c) {
        const struct component *component = &file->components[c];
        for (uint32_t x = 0; x < width; x += TEXELS) {
            const uint32_t count = width - x < TEXELS ? width - x : TEXELS;
            if (component->packed.number != BAKE_CONSTANT)
                bake_encode_row(&component->encoder, sources + x,
                                texels + (size_t)x * files->image_channels, files->image_channels,
                                count, samples);
            for (uint32_t i = 0; i < count; ++i)
                out[(size_t)(x + i) * channels + c] =
                    component->packed.scale * samples[i] + component->packed.bias;
        }
    }
}

static int encode_row(void *arg, uint64_t row, unsigned worker)
{
    struct bake_map_files *files = arg;
    const float *const *sources;
    const float *texels;
    bake_dilation_row(files->dilation, (uint32_t)row, worker, &sources, &texels);
    for (uint32_t i = 0; i < files->count; ++i) {
        struct map_file *file = &files->files[i];
        float *samples = file->rows + row * maps_row_samples(files, i);
        if (file->component_count > 0)
            encode_pack(files, file, sources, texels, samples);
        else
            bake_encode_row(&file->encoder, sources, texels, files->image_channels,
                            files->options->width, samples);
        const uint32_t beyond =
            file->half ? bake_limit_to_half(samples, maps_row_samples(files, i)) : 0;
        if (beyond > 0)
            atomic_fetch_add_explicit(&file->limited, beyond, memory_order_relaxed);
    }
    return 0;
}

/* Gives rows of a map to the caller of the bake. */
static int give_rows(const struct bake_map_files *files, uint32_t number, uint32_t first_row,
                     uint32_t rows)
{
    const struct map_file *file = &files->files[number];
    const struct bake_rows given = {.map = bake_name_of(files->options, file->number),
                                    .path = file->path,
                                    .width = files->options->width,
                                    .height = files->options->height,
                                    .channels = file->encoder.row->channels,
                                    .light = file->encoder.row->color,
                                    .first = first_row,
                                    .count = rows,
                                    .samples = file->rows};
    const int status = files->options->on_rows(files->options->rows_user, &given);
    return status < 0 ? bsq_fail(files->ctx, status, "%s: the rows were refused", file->path) : 0;
}

static int maps_write_band(struct bake_map_files *files, uint32_t first_row, uint32_t rows)
{
    for (uint32_t i = 0; i < files->count; ++i) {
        struct map_file *file = &files->files[i];
        if (file->thumbnail)
            BSQ_PASS(
                bake_thumbnail_add(files->ctx, file->thumbnail, 3, first_row, rows, file->rows));
        if (files->options->on_rows)
            BSQ_PASS(give_rows(files, i, first_row, rows));
        if (file->writer)
            BSQ_PASS(fmt_image_write_rows(file->writer, file->rows, rows));
    }
    if (files->watch)
        return files->watch(files->watch_arg, files, rows);
    return 0;
}

/* Returns the rows of a band: from a quarter of the memory that is left in the budget, in whole
 * blocks of the writers. */
static uint32_t choose_band_rows(const struct bake_map_files *files, const struct bake_image *image)
{
    uint64_t bytes = bsq_memory_left(files->ctx) / 4;
    uint64_t row_bytes = bake_dilation_row_bytes(image);
    for (uint32_t i = 0; i < files->count; ++i)
        row_bytes += maps_row_samples(files, i) * sizeof(float);
    if (bytes > BAND_BYTES)
        bytes = BAND_BYTES;
    uint64_t rows = bytes / row_bytes;
    if (rows >= files->options->height)
        return files->options->height;
    return rows > BAND_STEP ? (uint32_t)(rows - rows % BAND_STEP) : rows < 16 ? 16 : (uint32_t)rows;
}

/* Ends a phase of the work: adds the seconds since *start, and starts the next one. */
static void end_phase(double *start, double *seconds)
{
    const double now = bsq_seconds_now();
    *seconds += now - *start;
    *start = now;
}

/* Dilates, encodes and writes all bands of an image. */
static int write_bands(struct bake_map_files *files, const struct bake_image *image,
                       struct bake_report *report)
{
    const uint32_t band_rows = choose_band_rows(files, image);
    uint32_t first_row, rows;
    double start = bsq_seconds_now();
    for (uint32_t i = 0; i < files->count; ++i)
        BSQ_PASS(bsq_alloc(files->ctx, "rows of a map", band_rows,
                           maps_row_samples(files, i) * sizeof(float), &files->files[i].rows));
    BSQ_PASS(bake_dilation_create(files->ctx, image, band_rows, files->options->padding,
                                  files->beside, &files->dilation));
    for (;;) {
        BSQ_PASS(bake_dilation_next_band(files->dilation, &first_row, &rows));
        if (rows == 0)
            break;
        end_phase(&start, &report->seconds_padding);
        BSQ_PASS(bsq_parallel_for(files->ctx, rows, encode_row, files));
        end_phase(&start, &report->seconds_resolve);
        BSQ_PASS(maps_write_band(files, first_row, rows));
        end_phase(&start, &report->seconds_write);
        bsq_progress_add(files->ctx, rows);
    }
    for (uint32_t i = 0; i < files->count; ++i)
        if (files->files[i].writer)
            BSQ_PASS(fmt_image_finish(files->files[i].writer));
    end_phase(&start, &report->seconds_write);
    return 0;
}

int bake_map_files_write(struct bake_map_files *files, const struct bake_image *image,
                         const struct bake_measures *measures, uint64_t *limited,
                         struct bake_report *report)
{
    BSQ_PASS(choose_encodings(files, measures, report));
    files->image_channels = image->channels;
    bsq_progress_begin(files->ctx, "writing", "rows", files->options->height);
    int status = write_bands(files, image, report);
    bsq_progress_end(files->ctx);
    bake_dilation_free(files->dilation);
    files->dilation = NULL;
    for (uint32_t i = 0; i < files->count; ++i) {
        bsq_free(files->ctx, files->files[i].rows);
        files->files[i].rows = NULL;
        limited[files->files[i].number] += atomic_load(&files->files[i].limited);
    }
    return status;
}

int bake_warn_limited(struct bsq_ctx *ctx, const struct bake_options *options, uint32_t maps,
                      const uint64_t *limited)
{
    int status = 0;
    for (unsigned i = 0; i < bake_files_end(options, maps) && status == 0; ++i)
        if (limited[i] > 0)
            status = bsq_warn_loss(ctx,
                                   "map %s: samples too large for 16 bits: %" PRIu64
                                   "; they became 65504 or -65504: --type float holds them",
                                   bake_name_of(options, i), limited[i]);
    return status;
}

/* ---- ending ---- */

int bake_map_files_hand_over(struct bake_map_files *files, struct bsq_output_group *group)
{
    int status = 0;
    for (uint32_t i = 0; status == 0 && i < files->count; ++i) {
        struct bsq_output *output;
        if (!files->files[i].writer)
            continue;
        status = fmt_image_hand_over(files->files[i].writer, &output);
        files->files[i].writer = NULL;
        if (status == 0)
            status = bsq_output_group_add(group, output);
    }
    bake_map_files_discard(files);
    return status;
}

void bake_map_files_discard(struct bake_map_files *files)
{
    if (!files)
        return;
    for (uint32_t i = 0; i < files->count; ++i) {
        fmt_image_discard(files->files[i].writer);
        free(files->files[i].path);
        bsq_free(files->ctx, files->files[i].components);
    }
    free(files->beside);
    BSQ_FREE(files->ctx, files->files, files);
}
