/* part_files.c - the files of a part: for each UDIM tile in which it has blocks, an OpenEXR file
 * with the box of these blocks, before padding. FORMATS.md describes them. */
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "formats/image/exr_read.h"
#include "libbake/job/job.h"
#include "libbake/job/parts.h"

/* ---- names ---- */

char *bake_part_path(const struct bake_job *job, const struct bake_part_file *file)
{
    const struct bake_tile *tile = &job->tiles[file->tile];
    const char *name = bsq_file_name(tile->output_path), *end = strrchr(name, '.');
    const int folder = (int)(bsq_file_name(tile->beside) - tile->beside);
    const int length = end ? (int)(end - name) : (int)strlen(name);
    char word[48], *pattern = NULL;
    snprintf(word, sizeof word, "part-%u-of-%u", file->part, job->options->parts);
    if (asprintf(&pattern, "%.*s%.*s%s.exr", folder, tile->beside, length, name,
                 strstr(name, BAKE_MAP_TOKEN) ? "" : "." BAKE_MAP_TOKEN) < 0)
        return NULL;
    char *path = bake_map_path(pattern, word);
    free(pattern);
    return path;
}

void bake_free_channels(struct bake_channels *channels)
{
    for (uint32_t i = 0; channels->names && i < channels->count; i++)
        free(channels->names[i]);
    free(channels->names);
}

/* Names the values of a map: "height"; "normal.x"; "color.R"; "guide.0". Returns false if there is
 * no memory. */
static bool name_values(const char *map, uint32_t count, bool color, char **out)
{
    for (uint32_t i = 0; i < count; i++)
        if ((count == 1   ? asprintf(&out[i], "%s", map)
             : count == 3 ? asprintf(&out[i], "%s.%c", map, (color ? "RGB" : "xyz")[i])
                          : asprintf(&out[i], "%s.%u", map, i)) < 0) {
            out[i] = NULL;
            return false;
        }
    return true;
}

int bake_name_channels(const struct bake_job *job, struct bake_channels *out)
{
    const uint32_t count = bake_image_channels_for(job->maps);
    char **names = calloc(count, sizeof *names);
    bool good = names && name_values("share", 1, false, names);
    uint32_t at = 1;
    *out = (struct bake_channels){.names = names, .count = count};
    for (unsigned i = 0; good && i < bake_selection_end(job->maps); i++) {
        const uint32_t values = i < BK_MAP_COUNT ? bake_map_values(i) : BK_TRANSFER_VALUES;
        if (!bake_is_selected(job->maps, i))
            continue;
        good = name_values(bake_name_of(job->options, i), values,
                           bake_row_of(job->options, i)->color, names + at);
        at += values;
    }
    if (!good)
        return bsq_fail(job->ctx, BSQ_ENOMEM, "%s: out of memory", job->options->output_path);
    return 0;
}

/* ---- texts of the header ---- */

static const char *const text_names[BAKE_PART_TEXTS] = {
    [BAKE_PART_VERSION] = "bisque:version", [BAKE_PART_NUMBER] = "bisque:part",
    [BAKE_PART_TILE] = "bisque:tile",       [BAKE_PART_INPUTS] = "bisque:inputs",
    [BAKE_PART_OPTIONS] = "bisque:options", [BAKE_PART_COUNTS] = "bisque:counts"};

/* Sets the texts that tell a file of a part from those of other parts and bakes. */
static void expect_texts(const struct bake_job *job, const struct bake_part_file *file,
                         struct bake_part_texts *out)
{
    *out = job->identity;
    snprintf(out->of[BAKE_PART_NUMBER], BAKE_PART_TEXT, "%u/%u", file->part, job->options->parts);
    snprintf(out->of[BAKE_PART_TILE], BAKE_PART_TEXT, "%u (%u/%u)",
             job->tiles[file->tile].udim.number, file->tile + 1, job->udim.count);
}

static void write_counts(const struct bake_part_counts *counts, char *out)
{
    snprintf(out, BAKE_PART_TEXT,
             "%" PRIu64 " %" PRIu64 " %" PRIu64 " %" PRIu64 " %" PRIu64 " %" PRIu64,
             counts->covered_texels, counts->samples, counts->hits, counts->overlapping_samples,
             counts->curvature.texels, counts->curvature.alone);
}

static bool part_read_counts(const char *text, struct bake_part_counts *out)
{
    return sscanf(text, "%" SCNu64 " %" SCNu64 " %" SCNu64 " %" SCNu64 " %" SCNu64 " %" SCNu64,
                  &out->covered_texels, &out->samples, &out->hits, &out->overlapping_samples,
                  &out->curvature.texels, &out->curvature.alone) == 6;
}

/* ---- writing ---- */

enum { DIGITS = FMT_FINGERPRINT_BYTES - 1 /* of the checksum at the end of a file */ };

/* Writes the checksum after the last byte of the image. */
static int part_add_checksum(struct bsq_ctx *ctx, struct bsq_output *output)
{
    char digits[FMT_FINGERPRINT_BYTES];
    struct bsq_file file;
    int status = bsq_output_read(output, &file);
    if (status == 0)
        status = fmt_fingerprint_bytes(ctx, &file, file.size, digits);
    if (status == 0)
        status = bsq_output_write_at(output, digits, DIGITS, file.size);
    bsq_file_close(ctx, &file);
    return status;
}

struct writing {
    const struct bake_job *job;
    const struct bake_tile *tile;
    struct bake_box box;
    const struct bake_channels *channels;
    float *row, *block_row; /* of the box; of a block */
};

/* Copies a row of a block. What lies outside of charts becomes zeros. */
static int copy_block_row(const struct writing *writing, uint32_t place, uint32_t y, uint32_t width,
                          float *to)
{
    const struct bake_image *image = writing->tile->image;
    const uint32_t side = writing->tile->blocks.side, channels = writing->channels->count;
    const float *texels;
    int status = bake_image_rows(image, place * side + y, 1, writing->block_row, &texels);
    for (uint32_t x = 0; x < width && status == 0; x++, texels += image->channels, to += channels) {
        memset(to, 0, channels * sizeof *to);
        memcpy(to, texels, (texels[0] != BAKE_OUTSIDE ? channels : 1) * sizeof *to);
    }
    return status;
}

/* Writes the rows of the box. Blocks of other parts are zeros. */
static int write_rows(const struct writing *writing, struct fmt_image_writer *writer)
{
    const struct bake_blocks *blocks = &writing->tile->blocks;
    const struct bake_box *box = &writing->box;
    const uint32_t side = blocks->side, channels = writing->channels->count;
    for (uint32_t y = box->y; y < box->y_end; y++) {
        BSQ_PASS(bsq_check(writing->job->ctx));
        memset(writing->row, 0, (size_t)(box->x_end - box->x) * channels * sizeof *writing->row);
        for (uint32_t x = box->x; x < box->x_end; x += side) {
            const uint32_t place = blocks->places[y / side * blocks->columns + x / side];
            const uint32_t width = box->x_end - x < side ? box->x_end - x : side;
            if (place != BAKE_NO_PLACE)
                BSQ_PASS(copy_block_row(writing, place, y % side, width,
                                        writing->row + (size_t)(x - box->x) * channels));
        }
        BSQ_PASS(fmt_image_write_rows(writer, writing->row, 1));
    }
    return 0;
}

/* Writes the file's header and texels. */
static int write_image(const struct writing *writing, const char *path,
                       const struct bake_part_texts *texts, struct fmt_image_writer **out)
{
    const struct bake_tile *tile = writing->tile;
    const struct bake_box *box = &writing->box;
    struct fmt_image_attribute attributes[BAKE_PART_TEXTS];
    for (int i = 0; i < BAKE_PART_TEXTS; i++)
        attributes[i] = (struct fmt_image_attribute){text_names[i], texts->of[i]};
    const struct fmt_image_options options = {.width = box->x_end - box->x,
                                              .height = box->y_end - box->y,
                                              .channel_count = writing->channels->count,
                                              .channels =
                                                  (const char *const *)writing->channels->names,
                                              .x = box->x,
                                              .y = box->y,
                                              .full_width = tile->options.width,
                                              .full_height = tile->options.height,
                                              .type = FMT_FLOAT,
                                              .exr_tile_side = tile->blocks.side,
                                              .attributes = attributes,
                                              .attribute_count = BAKE_PART_TEXTS};
    BSQ_PASS(fmt_image_create(writing->job->ctx, &fmt_exr_format, path, &options, out));
    return write_rows(writing, *out);
}

int bake_part_write(const struct bake_job *job, const struct bake_channels *channels,
                    const struct bake_part_file *file, const struct bake_part_counts *counts,
                    struct bsq_output **out)
{
    struct bsq_ctx *ctx = job->ctx;
    struct bake_part_texts texts;
    struct writing writing = {
        .job = job, .tile = &job->tiles[file->tile], .box = file->box, .channels = channels};
    const uint64_t texel = channels->count * sizeof(float);
    struct fmt_image_writer *writer = NULL;
    char *path = bake_part_path(job, file);
    int status;
    BSQ_TRY(path ? 0 : bsq_fail(ctx, BSQ_ENOMEM, "a part: out of memory"));
    BSQ_TRY(bsq_alloc(ctx, "rows of a part", file->box.x_end - file->box.x, texel, &writing.row));
    BSQ_TRY(bsq_alloc(ctx, "rows of a part", writing.tile->blocks.side,
                      writing.tile->image->texel_bytes, &writing.block_row));
    expect_texts(job, file, &texts);
    write_counts(counts, texts.of[BAKE_PART_COUNTS]);
    BSQ_TRY(write_image(&writing, path, &texts, &writer));
    status = fmt_image_hand_over(writer, out);
    writer = NULL;
    if (status == 0)
        status = part_add_checksum(ctx, *out);
    if (status < 0) {
        bsq_output_discard(*out);
        *out = NULL;
    }
done:
    fmt_image_discard(writer);
    BSQ_FREE(ctx, writing.row, writing.block_row);
    free(path);
    return status;
}

/* ---- reading ---- */

static int part_refuse(const struct bake_part *part, const char *what)
{
    return bsq_fail(part->job->ctx, BSQ_EDATA, "%s: %s: bake this part again", part->path, what);
}

/* Checks that a file is the part of this bake that its name says. */
static int check_texts(const struct bake_part *part)
{
    static const char *const what[BAKE_PART_COUNTS] = {
        [BAKE_PART_VERSION] = "a part by another version of Bisque",
        [BAKE_PART_NUMBER] = "another part",
        [BAKE_PART_TILE] = "a part of another tile",
        [BAKE_PART_INPUTS] = "a part of a bake with other inputs",
        [BAKE_PART_OPTIONS] = "a part of a bake with other options"};
    const struct fmt_exr_image *image = fmt_exr_rows_image(part->rows);
    const struct bake_box *box = &part->of.box;
    for (int i = 0; i < BAKE_PART_TEXTS; i++) {
        const char *text = fmt_exr_image_attribute(image, text_names[i]);
        if (!text || strlen(text) >= BAKE_PART_TEXT)
            return part_refuse(part, "not a part of a bake");
    }
    for (int i = 0; i < BAKE_PART_COUNTS; i++)
        if (strcmp(fmt_exr_image_attribute(image, text_names[i]), part->texts.of[i]) != 0)
            return part_refuse(part, what[i]);
    if (image->x != (int32_t)box->x || image->y != (int32_t)box->y ||
        image->width != box->x_end - box->x || image->height != box->y_end - box->y ||
        fmt_exr_tile_side(part->rows) != part->job->tiles[part->of.tile].blocks.side)
        return part_refuse(part, "damaged: it has another size");
    return 0;
}

void bake_part_close(struct bake_part *part)
{
    fmt_exr_rows_close(part->rows);
    bsq_file_close(part->job->ctx, &part->file);
    free(part->path);
    part->rows = NULL;
    part->path = NULL;
}

int bake_part_open(const struct bake_job *job, const struct bake_channels *channels,
                   const struct bake_part_file *file, struct bake_part *part)
{
    *part =
        (struct bake_part){.job = job, .channels = channels, .of = *file, .file = BSQ_FILE_CLOSED};
    part->path = bake_part_path(job, file);
    if (!part->path)
        return bsq_fail(job->ctx, BSQ_ENOMEM, "a part: out of memory");
    expect_texts(job, file, &part->texts);
    BSQ_PASS(bsq_file_open_as(job->ctx, part->path, BSQ_OPEN_OTHER, &part->file));
    BSQ_PASS(fmt_exr_tiles_open(job->ctx, part->path, &part->file,
                                (const char *const *)channels->names, channels->count,
                                &part->rows));
    BSQ_PASS(check_texts(part));
    const struct fmt_exr_image *image = fmt_exr_rows_image(part->rows);
    if (!part_read_counts(fmt_exr_image_attribute(image, text_names[BAKE_PART_COUNTS]),
                          &part->counts))
        return part_refuse(part, "damaged: its counts are no numbers");
    return 0;
}

/* Checks the bytes of the file. */
static int check_bytes(const struct bake_part *part)
{
    struct bsq_ctx *ctx = part->job->ctx;
    char found[FMT_FINGERPRINT_BYTES], digits[FMT_FINGERPRINT_BYTES] = "";
    const uint64_t size = part->file.size;
    if (size <= DIGITS)
        return part_refuse(part, "not a part of a bake");
    BSQ_PASS(fmt_fingerprint_bytes(ctx, &part->file, size - DIGITS, found));
    BSQ_PASS(bsq_file_read(ctx, &part->file, digits, DIGITS, size - DIGITS));
    if (strcmp(found, digits) != 0)
        return part_refuse(part, "damaged: its checksum does not fit");
    return 0;
}

/* Copies a block to the image. x, y: in the map. */
static int read_block(const struct bake_part *part, uint32_t x, uint32_t y,
                      struct bake_image *image)
{
    const struct bake_box *box = &part->of.box;
    const uint32_t side = part->job->tiles[part->of.tile].blocks.side;
    const uint32_t width = box->x_end - x < side ? box->x_end - x : side;
    const uint32_t height = box->y_end - y < side ? box->y_end - y : side;
    const float *texels;
    BSQ_PASS(fmt_exr_tile_read(part->rows, (x - box->x) / side, (y - box->y) / side, &texels));
    for (uint32_t i = 0; i < height; i++)
        BSQ_PASS(bake_image_write(image, x, y + i, width, 1,
                                  texels + (size_t)i * side * part->channels->count));
    return 0;
}

int bake_part_read(const struct bake_part *part, struct bake_image *image)
{
    const struct bake_tile *tile = &part->job->tiles[part->of.tile];
    const struct bake_box *box = &part->of.box;
    const uint32_t side = tile->blocks.side;
    int status = check_bytes(part);
    for (uint32_t y = box->y; y < box->y_end && image && status == 0; y += side)
        for (uint32_t x = box->x; x < box->x_end && status == 0; x += side)
            if (tile->shares[y / side * tile->blocks.columns + x / side] + 1 == part->of.part)
                status = read_block(part, x, y, image);
    return status;
}
