/* map_files.c - from the baked image to files.
 *
 * A band of rows at a time: find each texel's source (dilation.c), encode all maps' rows on all
 * threads, hand them to the writers. All files are complete before the first gets its name.
 *
 * Maps have no alpha: every program reads three channels of a normal map, and an alpha channel
 * would make some of them multiply the padding away. Where the rays hit is a map of its own, the
 * mask. */
#include "libbake/maps/map_files.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "base/parallel.h"
#include "formats/image/image_writer.h"
#include "base/clock.h"
#include "libbake/maps/dilation.h"

enum { MAP_KINDS = 3, ATTRIBUTES = 16, BAND_STEP = 64 };
#define BAND_BYTES (UINT64_C(128) << 20) /* more does not make anything faster */

static const char token[] = "<MAP>";

struct kind {
    enum bake_map map;
    const char *name;
    uint32_t channel_count;
    bool data; /* not colour */
};
static const struct kind kinds[MAP_KINDS] = {{BAKE_MAP_NORMAL, "normal", 3, true},
                                             {BAKE_MAP_COLOR, "color", 3, false},
                                             {BAKE_MAP_MASK, "mask", 1, true}};

struct map_file {
    const struct kind *kind;
    uint32_t offset; /* of its values in a texel of the image */
    float background[3];
    struct fmt_image_writer *writer;
    float *rows; /* of the current band, encoded */
};

struct bake_map_files {
    struct bsq_ctx *ctx;
    char *beside; /* an output path */
    uint32_t width, height, padding;
    float green; /* sign of the normal map's green channel */
    uint32_t count;
    struct map_file files[MAP_KINDS];
    struct bake_padding *source; /* while writing */
};

/* ---- names and formats ---- */

/* Chooses image format and sample type by the output's name and the options. Errors: BSQ_EUSAGE. */
static int choose_format(struct bsq_ctx *ctx, const struct bake_options *options,
                         const struct fmt_image_format **format, enum fmt_sample_type *type)
{
    const char *path = options->output_path;
    *format = fmt_image_format_of(path);
    if (!*format)
        return bsq_fail(ctx, BSQ_EUSAGE,
                        "%s: maps are OpenEXR or PNG files: let the name end in .exr or .png",
                        path);
    _Static_assert(BAKE_FLOAT - BAKE_UINT8 == (int)FMT_FLOAT, "the types are in one order");
    *type = options->sample_type == BAKE_SAMPLE_USUAL
                ? (*format)->usual_type
                : (enum fmt_sample_type)(options->sample_type - BAKE_UINT8);
    return fmt_image_check_type(ctx, *format, path, *type);
}

int bake_map_files_check(struct bsq_ctx *ctx, const struct bake_options *options, uint32_t maps)
{
    const char *path = options->output_path;
    const struct fmt_image_format *format;
    enum fmt_sample_type type;
    int status = choose_format(ctx, options, &format, &type);
    if (status < 0)
        return status;
    if ((maps & (maps - 1)) != 0 && !strstr(path, token))
        return bsq_fail(ctx, BSQ_EUSAGE, "%s: several maps need \"%s\" in the output's name", path,
                        token);
    if (options->width == 0 || options->height == 0 || options->width > BAKE_PADDING_MAX_SIDE ||
        options->height > BAKE_PADDING_MAX_SIDE)
        return bsq_fail(ctx, BSQ_EUSAGE, "a map of %u x %u texels: sides must be 1 to %u",
                        options->width, options->height, BAKE_PADDING_MAX_SIDE);
    return 0;
}

uint32_t bake_map_channels(uint32_t maps)
{
    uint32_t channels = 1;
    for (int i = 0; i < MAP_KINDS; ++i)
        if (maps & kinds[i].map && kinds[i].map != BAKE_MAP_MASK)
            channels += kinds[i].channel_count;
    return channels;
}

static const struct kind *find_kind(enum bake_map map)
{
    int i = 0;
    while (i < MAP_KINDS - 1 && kinds[i].map != map)
        ++i;
    return &kinds[i];
}

char *bake_map_path(const char *path, enum bake_map map)
{
    const char *name = find_kind(map)->name, *at;
    size_t name_bytes = strlen(name), token_bytes = sizeof token - 1, length = strlen(path);
    for (at = strstr(path, token); at; at = strstr(at + token_bytes, token))
        length += name_bytes;
    char *out = malloc(length + 1), *to = out;
    while (out && (at = strstr(path, token))) {
        to = mempcpy(to, path, (size_t)(at - path));
        to = mempcpy(to, name, name_bytes);
        path = at + token_bytes;
    }
    if (out)
        strcpy(to, path);
    return out;
}

/* ---- opening ---- */

struct attributes {
    struct fmt_image_attribute list[ATTRIBUTES];
    uint32_t count;
    char front[32], back[32], samples[32];
};

static void add_attribute(struct attributes *attributes, const char *name, const char *value)
{
    attributes->list[attributes->count++] = (struct fmt_image_attribute){name, value};
}

static void describe(const struct bake_options *options, const struct kind *kind,
                     const struct bake_traced *traced, struct attributes *out)
{
    out->count = 0;
    snprintf(out->front, sizeof out->front, "%.9g", traced->front);
    snprintf(out->back, sizeof out->back, "%.9g", traced->back);
    snprintf(out->samples, sizeof out->samples, "%u x %u", options->samples, options->samples);
    add_attribute(out, "software", "Bisque " BSQ_VERSION);
    add_attribute(out, "bisque:version", BSQ_VERSION);
    add_attribute(out, "bisque:map", kind->name);
    if (kind->map == BAKE_MAP_NORMAL) {
        bool object = options->normal_space == BAKE_OBJECT_SPACE;
        add_attribute(out, "bisque:normalSpace", object ? "object" : "tangent");
        add_attribute(out, "bisque:tangents", object ? "none" : "MikkTSpace");
        add_attribute(out, "bisque:green", options->green_down ? "down" : "up");
        add_attribute(out, "bisque:encoding", "n / 2 + 1/2");
    }
    add_attribute(out, "bisque:samples", out->samples);
    add_attribute(out, "bisque:sampling", traced->sampling);
    add_attribute(out, "bisque:front", out->front);
    add_attribute(out, "bisque:back", out->back);
}

static int open_file(struct bsq_ctx *ctx, const struct bake_options *options,
                     const struct bake_traced *traced, struct map_file *file)
{
    struct attributes attributes;
    describe(options, file->kind, traced, &attributes);
    struct fmt_image_options image = {
        .width = options->width,
        .height = options->height,
        .channel_count = file->kind->channel_count,
        .color = !file->kind->data,
        .attributes = attributes.list,
        .attribute_count = attributes.count,
    };
    const struct fmt_image_format *format;
    int status = choose_format(ctx, options, &format, &image.type);
    if (status < 0)
        return status;
    char *path = bake_map_path(options->output_path, file->kind->map);
    if (!path)
        return bsq_fail(ctx, BSQ_ENOMEM, "%s: out of memory", options->output_path);
    status = fmt_image_create(ctx, format, path, &image, &file->writer);
    free(path);
    return status;
}

/* Beyond the padding a normal map is flat: straight up in tangent space, zero in object space. */
static void set_background(struct map_file *file, const struct bake_options *options)
{
    if (file->kind->map != BAKE_MAP_NORMAL)
        return;
    file->background[0] = file->background[1] = 0.5f;
    file->background[2] = options->normal_space == BAKE_TANGENT_SPACE ? 1.0f : 0.5f;
}

int bake_map_files_open(struct bsq_ctx *ctx, const struct bake_options *options, uint32_t maps,
                        const struct bake_traced *traced, struct bake_map_files **out)
{
    *out = NULL;
    int status = bake_map_files_check(ctx, options, maps);
    if (status < 0)
        return status;
    struct bake_map_files *files;
    status = bsq_calloc(ctx, "map files", 1, sizeof *files, &files);
    if (status < 0)
        return status;
    files->ctx = ctx;
    files->width = options->width;
    files->height = options->height;
    files->padding = options->padding;
    files->green =
        options->green_down && options->normal_space == BAKE_TANGENT_SPACE ? -1.0f : 1.0f;
    files->beside = bake_map_path(options->output_path, (enum bake_map)(maps & -maps));
    if (!files->beside)
        status = bsq_fail(ctx, BSQ_ENOMEM, "%s: out of memory", options->output_path);
    uint32_t offset = 1;
    for (int i = 0; status == 0 && i < MAP_KINDS; ++i) {
        if (!(maps & kinds[i].map))
            continue;
        struct map_file *file = &files->files[files->count++];
        file->kind = &kinds[i];
        file->offset = offset;
        offset += file->kind->channel_count;
        set_background(file, options);
        status = open_file(ctx, options, traced, file);
    }
    if (status < 0)
        bake_map_files_discard(files);
    else
        *out = files;
    return status;
}

/* ---- writing ---- */

static void encode_normals(const struct bake_map_files *files, const struct map_file *file,
                           const float *const *sources, float *out)
{
    for (uint32_t x = 0; x < files->width; ++x, out += 3) {
        if (sources[x]) {
            const float *n = sources[x] + file->offset;
            out[0] = 0.5f * n[0] + 0.5f;
            out[1] = 0.5f * files->green * n[1] + 0.5f;
            out[2] = 0.5f * n[2] + 0.5f;
        } else {
            memcpy(out, file->background, sizeof file->background);
        }
    }
}

static void encode_colors(const struct bake_map_files *files, const struct map_file *file,
                          const float *const *sources, float *out)
{
    for (uint32_t x = 0; x < files->width; ++x, out += 3)
        memcpy(out, sources[x] ? sources[x] + file->offset : file->background, 3 * sizeof *out);
}

static void encode_mask(const struct bake_map_files *files, const float *texels, uint32_t channels,
                        float *out)
{
    for (uint32_t x = 0; x < files->width; ++x) {
        float share = texels[(size_t)x * channels];
        out[x] = share > 0.0f ? share : 0.0f;
    }
}

struct encoding {
    struct bake_map_files *files;
    uint32_t channels; /* of the image */
};

static int encode_row(void *arg, uint64_t row, unsigned worker)
{
    const struct encoding *encoding = arg;
    struct bake_map_files *files = encoding->files;
    const float *const *sources;
    const float *texels;
    bake_padding_row(files->source, (uint32_t)row, worker, &sources, &texels);
    for (uint32_t i = 0; i < files->count; ++i) {
        const struct map_file *file = &files->files[i];
        float *out = file->rows + row * files->width * file->kind->channel_count;
        switch (file->kind->map) {
        case BAKE_MAP_NORMAL:
            encode_normals(files, file, sources, out);
            break;
        case BAKE_MAP_COLOR:
            encode_colors(files, file, sources, out);
            break;
        default:
            encode_mask(files, texels, encoding->channels, out);
            break;
        }
    }
    return 0;
}

static int write_band(struct bake_map_files *files, uint32_t first_row, uint32_t rows,
                      struct bake_thumbnail *normal, struct bake_thumbnail *color)
{
    int status = 0;
    for (uint32_t i = 0; status == 0 && i < files->count; ++i) {
        struct map_file *file = &files->files[i];
        struct bake_thumbnail *thumbnail = file->kind->map == BAKE_MAP_NORMAL  ? normal
                                           : file->kind->map == BAKE_MAP_COLOR ? color
                                                                               : NULL;
        if (thumbnail)
            status = bake_thumbnail_add(files->ctx, thumbnail, first_row, rows, file->rows);
        if (status == 0)
            status = fmt_image_write_rows(file->writer, file->rows, rows);
    }
    return status;
}

/* A quarter of what is left of the budget, and whole blocks of the writers. */
static uint32_t choose_band_rows(const struct bake_map_files *files, const struct bake_image *image)
{
    uint64_t bytes = bsq_memory_left(files->ctx) / 4;
    uint64_t row_bytes = bake_padding_row_bytes(image);
    for (uint32_t i = 0; i < files->count; ++i)
        row_bytes += (uint64_t)files->width * files->files[i].kind->channel_count * sizeof(float);
    if (bytes > BAND_BYTES)
        bytes = BAND_BYTES;
    uint64_t rows = bytes / row_bytes;
    if (rows >= files->height)
        return files->height;
    return rows > BAND_STEP ? (uint32_t)(rows - rows % BAND_STEP) : rows < 16 ? 16 : (uint32_t)rows;
}

static int allocate_rows(struct bake_map_files *files, uint32_t band_rows)
{
    int status = 0;
    for (uint32_t i = 0; status == 0 && i < files->count; ++i)
        status =
            bsq_alloc(files->ctx, "rows of a map", (uint64_t)band_rows * files->width,
                      files->files[i].kind->channel_count * sizeof(float), &files->files[i].rows);
    return status;
}

static int finish_files(struct bake_map_files *files)
{
    int status = 0;
    for (uint32_t i = 0; status == 0 && i < files->count; ++i)
        status = fmt_image_finish(files->files[i].writer);
    return status;
}

int bake_map_files_write(struct bake_map_files *files, const struct bake_image *image,
                         struct bake_thumbnail *normal, struct bake_thumbnail *color,
                         double *padding, double *resolve, double *write)
{
    struct encoding encoding = {files, bake_image_channels(image)};
    uint32_t band_rows = choose_band_rows(files, image);
    double start = bsq_seconds_now();
    int status = allocate_rows(files, band_rows);
    if (status == 0)
        status = bake_padding_create(files->ctx, image, band_rows, files->padding, files->beside,
                                     &files->source);
    uint32_t first_row = 0, rows = 1;
    bsq_progress_begin(files->ctx, "writing", "rows", files->height);
    while (status == 0) {
        status = bake_padding_next_band(files->source, &first_row, &rows);
        if (status < 0 || rows == 0)
            break;
        double padded = bsq_seconds_now();
        *padding += padded - start;
        status = bsq_parallel_for(files->ctx, rows, encode_row, &encoding);
        double encoded = bsq_seconds_now();
        *resolve += encoded - padded;
        if (status == 0)
            status = write_band(files, first_row, rows, normal, color);
        start = bsq_seconds_now();
        *write += start - encoded;
        bsq_progress_add(files->ctx, rows);
    }
    bsq_progress_end(files->ctx);
    bake_padding_free(files->source);
    files->source = NULL;
    for (uint32_t i = 0; i < files->count; ++i) {
        bsq_free(files->ctx, files->files[i].rows);
        files->files[i].rows = NULL;
    }
    if (status == 0)
        status = finish_files(files);
    *write += bsq_seconds_now() - start;
    return status;
}

/* ---- ending ---- */

int bake_map_files_commit(struct bake_map_files *files)
{
    int status = 0;
    for (uint32_t i = 0; status == 0 && i < files->count; ++i) {
        struct map_file *file = &files->files[i];
        status = fmt_image_commit(file->writer);
        file->writer = NULL;
    }
    bake_map_files_discard(files);
    return status;
}

void bake_map_files_discard(struct bake_map_files *files)
{
    if (!files)
        return;
    for (uint32_t i = 0; i < files->count; ++i)
        fmt_image_discard(files->files[i].writer);
    free(files->beside);
    bsq_free(files->ctx, files);
}
