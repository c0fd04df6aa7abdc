/* parts.c - a bake in parts: bakes the share of one, or takes the texels of all from their files.
 *
 * Each job measures distances and divides the texels by itself, which gives the same from the same
 * inputs. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "base/job_files.h"
#include "base/parallel.h"
#include "formats/fingerprint.h"
#include "libbake/job/job.h"
#include "libbake/job/parts.h"

enum { LIST_BYTES = 160 /* of numbers in a message */ };

/* ---- the identity of a bake ---- */

static void parts_add_options(XXH3_state_t *state, const struct bsq_option *rows, size_t count,
                              const void *of)
{
    for (const struct bsq_option *row = rows; row < rows + count; row++) {
        const void *at = bsq_option_at(row, of);
        if (row->finishes || row->kind == BSQ_OPTION_INPUT || row->kind == BSQ_OPTION_OUTPUT)
            continue;
        if (row->kind == BSQ_OPTION_TEXT) {
            const char *text = *(const char *const *)at;
            XXH3_128bits_update(state, text ? text : "", text ? strlen(text) + 1 : 0);
        } else if (row->kind == BSQ_OPTION_LIST) {
            const uint32_t length = *(const uint32_t *)((const char *)of + row->count_offset);
            XXH3_128bits_update(state, &length, sizeof length);
            for (uint32_t i = 0; i < length; i++)
                parts_add_options(state, row->rows, row->row_count,
                                  *(const char *const *)at + i * row->element_bytes);
        } else if (row->kind != BSQ_OPTION_NONE) {
            XXH3_128bits_update(state, at, row->bytes);
        }
    }
}

/* Sets the checksum of all options that texels depend on. */
static int identify_options(struct bake_job *job)
{
    size_t count;
    const struct bsq_option *rows = bake_option_rows(&count);
    XXH3_state_t *state;
    BSQ_PASS(fmt_fingerprint_begin(job->ctx, &state));
    parts_add_options(state, rows, count, job->options);
    fmt_fingerprint_end(state, job->identity.of[BAKE_PART_OPTIONS]);
    return 0;
}

/* Adds what an input contains, and what it is for. Its path may be another elsewhere, and so may
 * that of the file that names it. */
static int add_input(struct bsq_ctx *ctx, const struct bsq_noted_input *input, XXH3_state_t *state)
{
    const char *end = strstr(input->role, " that ");
    char hash[FMT_FINGERPRINT_BYTES];
    BSQ_PASS(fmt_fingerprint(ctx, input->path, hash));
    XXH3_128bits_update(state, hash, sizeof hash);
    XXH3_128bits_update(state, input->role,
                        end ? (size_t)(end - input->role) : strlen(input->role));
    return 0;
}

/* Checks that other parts can read a file again, as they cannot read a pipe. NULL is allowed. */
static int parts_check_input(const struct bake_job *job, const char *path)
{
    struct stat info;
    return !path || (stat(path, &info) == 0 && S_ISREG(info.st_mode))
               ? 0
               : bsq_fail(job->ctx, BSQ_EUSAGE,
                          "%s: other parts cannot read it again: it is not a file", path);
}

/* Sets the checksum of all inputs, which the job notes in the same order each time. */
static int identify_inputs(struct bake_job *job)
{
    const struct bake_options *options = job->options;
    struct bsq_noted_input input;
    XXH3_state_t *state = NULL;
    uint64_t next = 0;
    int status;
    BSQ_TRY(fmt_fingerprint_begin(job->ctx, &state));
    BSQ_TRY(parts_check_input(job, options->scan_path));
    for (uint32_t i = 0; i < options->more_scan_count; i++)
        BSQ_TRY(parts_check_input(job, options->more_scan_paths[i]));
    BSQ_TRY(parts_check_input(job, options->mesh_path));
    for (uint32_t i = 0; i < options->more_mesh_count; i++)
        BSQ_TRY(parts_check_input(job, options->more_mesh_paths[i]));
    BSQ_TRY(parts_check_input(job, options->cage_path));
    while ((status = bsq_next_input(job->ctx, &next, &input)) > 0) {
        status = input.opened ? add_input(job->ctx, &input, state) : 0;
        bsq_noted_input_free(&input);
        if (status < 0)
            break;
    }
    fmt_fingerprint_end(state, job->identity.of[BAKE_PART_INPUTS]);
    state = NULL;
done:
    XXH3_freeState(state);
    return status;
}

/* ---- files ---- */

/* A bake in parts, and the files of its part or, if it is a merge, of all parts: by tile, and of a
 * tile by part. */
struct farm {
    struct bake_job *job;
    struct bake_channels channels;
    struct bake_part_file *files;
    uint64_t count, capacity;
    bool *counted;                    /* the counts of a part are added already */
    uint32_t *missing, missing_count; /* from 1 on; in the tile that is checked */
};

/* Adds block b of a tile to a box; zeros are an empty one. */
static void add_block(const struct bake_tile *tile, uint64_t b, struct bake_box *box)
{
    const uint32_t side = tile->blocks.side;
    const uint32_t x = (uint32_t)(b % tile->blocks.columns) * side;
    const uint32_t y = (uint32_t)(b / tile->blocks.columns) * side;
    const uint32_t x_end = tile->options.width - x < side ? tile->options.width : x + side;
    const uint32_t y_end = tile->options.height - y < side ? tile->options.height : y + side;
    if (box->x_end == 0)
        *box = (struct bake_box){x, y, x_end, y_end};
    box->x = x < box->x ? x : box->x;
    box->y = y < box->y ? y : box->y;
    box->x_end = x_end > box->x_end ? x_end : box->x_end;
    box->y_end = y_end > box->y_end ? y_end : box->y_end;
}

/* Lists the files with blocks of a tile. boxes: space for one of each part. */
static int list_files_of_tile(struct farm *farm, uint32_t number, struct bake_box *boxes)
{
    const struct bake_options *options = farm->job->options;
    const struct bake_tile *tile = &farm->job->tiles[number];
    memset(boxes, 0, options->parts * sizeof *boxes);
    for (uint64_t b = 0; b < (uint64_t)tile->blocks.columns * tile->blocks.rows; b++)
        add_block(tile, b, &boxes[tile->shares[b]]);
    for (uint32_t part = 1; part <= options->parts; part++) {
        const struct bake_box *box = &boxes[part - 1];
        if (box->x_end == 0 || (options->part && part != options->part))
            continue;
        BSQ_PASS(BSQ_GROW(farm->job->ctx, "files of parts", farm->count + 1, &farm->files,
                          &farm->capacity));
        farm->files[farm->count++] = (struct bake_part_file){number, part, *box};
    }
    return bsq_check(farm->job->ctx);
}

/* Finds out what files of parts must say, which blocks each part has, and the files. */
static int prepare(struct farm *farm)
{
    struct bake_job *job = farm->job;
    struct bake_box *boxes = NULL;
    int status;
    snprintf(job->identity.of[BAKE_PART_VERSION], BAKE_PART_TEXT, "%s", BSQ_VERSION);
    BSQ_TRY(identify_options(job));
    BSQ_TRY(identify_inputs(job));
    BSQ_TRY(bake_divide(job));
    BSQ_TRY(BSQ_ALLOC(job->ctx, "parts", job->options->parts, &boxes));
    for (uint32_t t = 0; t < job->udim.count; t++)
        BSQ_TRY(list_files_of_tile(farm, t, boxes));
done:
    bsq_free(job->ctx, boxes);
    return status;
}

/* ---- one part ---- */

/* Sets *out if all files of the job's part are there and whole. */
static int is_done(const struct farm *farm, bool *out)
{
    int status = 0;
    for (uint64_t i = 0; i < farm->count && status == 0; i++) {
        struct bake_part part;
        status = bake_part_open(farm->job, &farm->channels, &farm->files[i], &part);
        if (status == 0)
            status = bake_part_read(&part, NULL);
        bake_part_close(&part);
    }
    *out = farm->count > 0 && status == 0;
    if (status == BSQ_ENOMEM || status == BSQ_EINTR)
        return status;
    bsq_clear_error(farm->job->ctx);
    return 0;
}

/* Checks before the work that all files of the job's part can be written. */
static int check_files(const struct farm *farm)
{
    const struct bake_job *job = farm->job;
    int status = 0;
    for (uint64_t i = 0; i < farm->count && status == 0; i++) {
        char *path = bake_part_path(job, &farm->files[i]);
        status = path ? bsq_output_check(job->ctx, path)
                      : bsq_fail(job->ctx, BSQ_ENOMEM, "a part: out of memory");
        free(path);
    }
    return status < 0 ? status
                      : bsq_require_descriptors(job->ctx, job->options->output_path, farm->count);
}

static int parts_trace_own(struct bake_job *job)
{
    BSQ_PASS(bake_rasterise(job));
    BSQ_PASS(bake_open_device(job, job->part_texels));
    BSQ_PASS(bake_trace_maps(job));
    if (job->maps & BAKE_MAP_CURVATURE)
        BSQ_PASS(bake_trace_curvature(job));
    bake_end_tracing(job);
    return bake_surface_check(&job->surface);
}

/* Writes all files of the part, which appear together. */
static int write_files(const struct farm *farm)
{
    const struct bake_report *report = farm->job->report;
    const struct bake_part_counts counts = {report->covered_texels, report->samples, report->hits,
                                            report->overlapping_samples, farm->job->curvature};
    struct bsq_output_group group = {0};
    struct bsq_output *output;
    int status = 0;
    for (uint64_t i = 0; i < farm->count; i++) {
        BSQ_TRY(bake_part_write(farm->job, &farm->channels, &farm->files[i], &counts, &output));
        BSQ_TRY(bsq_output_group_add(&group, output));
    }
    status = bsq_output_group_commit(&group);
done:
    bsq_output_group_discard(&group);
    return status;
}

static void end_farm(struct farm *farm)
{
    BSQ_FREE(farm->job->ctx, farm->counted, farm->missing, farm->files);
    bake_free_channels(&farm->channels);
}

int bake_run_part(struct bake_job *job)
{
    struct farm farm = {.job = job};
    int status;
    BSQ_TRY(bake_name_channels(job, &farm.channels));
    BSQ_TRY(bake_set_params(job)); /* which measures distances by triangles in the mesh's order */
    BSQ_TRY(prepare(&farm));
    for (uint32_t t = 0; t < job->udim.count; t++)
        BSQ_TRY(bake_take_share(job, &job->tiles[t]));
    BSQ_TRY(is_done(&farm, &job->report->done));
    if (job->report->done)
        goto done;
    BSQ_TRY(check_files(&farm));
    BSQ_TRY(parts_trace_own(job));
    status = write_files(&farm);
done:
    end_farm(&farm);
    return status;
}

/* ---- all parts ---- */

static void add_counts(struct bake_job *job, const struct bake_part_counts *counts)
{
    job->report->covered_texels += counts->covered_texels;
    job->report->samples += counts->samples;
    job->report->hits += counts->hits;
    job->report->misses += counts->samples - counts->hits;
    job->report->overlapping_samples += counts->overlapping_samples;
    job->curvature.texels += counts->curvature.texels;
    job->curvature.alone += counts->curvature.alone;
}

/* Checks the header of a file, or notes that it is missing. */
static int check_one_part(struct farm *farm, const struct bake_part_file *file)
{
    struct bake_part part;
    int status = bake_part_open(farm->job, &farm->channels, file, &part);
    if (status == 0 && !farm->counted[file->part - 1])
        add_counts(farm->job, &part.counts);
    if (status == BSQ_ENOINPUT) {
        bsq_clear_error(farm->job->ctx);
        farm->missing[farm->missing_count++] = file->part;
        status = 0;
    }
    farm->counted[file->part - 1] = true;
    bake_part_close(&part);
    return status == 0 ? bsq_check(farm->job->ctx) : status;
}

/* Fails with the numbers of a tile's missing parts, as many as fit a line. */
static int parts_fail_missing(const struct farm *farm, uint32_t tile)
{
    const struct bake_job *job = farm->job;
    char list[LIST_BYTES] = "";
    size_t length = 0;
    uint32_t named = 0;
    for (; named < farm->missing_count && length + 32 < sizeof list; named++)
        length += (size_t)snprintf(list + length, sizeof list - length, "%s%u", named ? ", " : "",
                                   farm->missing[named]);
    char *path = bake_part_path(job, &(struct bake_part_file){tile, farm->missing[0], {0}});
    const int status = bsq_fail(
        job->ctx, BSQ_ENOINPUT, "%s: missing; of %u parts, %u %s missing: %s%s",
        path ? path : "a part", job->options->parts, farm->missing_count,
        farm->missing_count == 1 ? "is" : "are", list, named < farm->missing_count ? " ..." : "");
    free(path);
    return status;
}

/* Files of one tile. */
struct tile_files {
    const struct farm *farm;
    const struct bake_part_file *files;
};

static int parts_read_one(void *arg, uint64_t i, unsigned worker)
{
    const struct tile_files *of = arg;
    const struct bake_part_file *file = &of->files[i];
    struct bake_job *job = of->farm->job;
    struct bake_part part;
    (void)worker;
    int status = bake_part_open(job, &of->farm->channels, file, &part);
    if (status == 0)
        status = bake_part_read(&part, job->tiles[file->tile].image);
    bake_part_close(&part);
    bsq_progress_add(job->ctx, 1);
    return status;
}

/* Takes the texels of a tile from `count` files. Their images share half of the memory that is
 * left, as in a bake without parts. */
static int read_tile(const struct farm *farm, const struct bake_part_file *files, uint64_t count,
                     uint64_t memory_bytes)
{
    struct bake_job *job = farm->job;
    struct bake_tile *tile = &job->tiles[files->tile];
    struct tile_files of = {farm, files};
    BSQ_PASS(bake_tile_create_image(job->ctx, tile, false, memory_bytes));
    bsq_progress_begin(job->ctx, "reading parts", "parts", count);
    int status = bsq_parallel_for(job->ctx, count, parts_read_one, &of);
    bsq_progress_end(job->ctx);
    if (status == 0)
        status = bake_image_measure(job->ctx, tile->image, job->maps, job->measures.statistics);
    if (tile->skipped) {
        bake_image_free(tile->image);
        tile->image = NULL;
    }
    return status;
}

static int read_tiles(struct farm *farm)
{
    struct bake_job *job = farm->job;
    const uint64_t reserve = bsq_memory_left(job->ctx) / 2;
    for (uint64_t i = 0; i < farm->count; i++) {
        const uint32_t tile = farm->files[i].tile;
        BSQ_PASS(check_one_part(farm, &farm->files[i]));
        const bool last = i + 1 == farm->count || farm->files[i + 1].tile != tile;
        if (last && farm->missing_count > 0)
            return parts_fail_missing(farm, tile);
    }
    BSQ_PASS(bake_check_hits(job));
    for (uint64_t first = 0, end; first < farm->count; first = end) {
        const uint32_t tile = farm->files[first].tile;
        const uint64_t left = bsq_memory_left(job->ctx),
                       share = left > reserve ? left - reserve : 0;
        for (end = first + 1; end < farm->count && farm->files[end].tile == tile;)
            end++;
        BSQ_PASS(
            read_tile(farm, &farm->files[first], end - first, share / (job->udim.count - tile)));
    }
    return 0;
}

int bake_take_parts(struct bake_job *job)
{
    const uint32_t parts = job->options->parts;
    struct farm farm = {.job = job};
    int status;
    BSQ_TRY(bake_name_channels(job, &farm.channels));
    BSQ_TRY(prepare(&farm));
    BSQ_TRY(BSQ_ALLOC(job->ctx, "parts", parts, &farm.missing));
    BSQ_TRY(BSQ_CALLOC(job->ctx, "parts", parts, &farm.counted));
    BSQ_TRY(read_tiles(&farm));
    snprintf(job->report->device, sizeof job->report->device, "%u part%s", parts,
             parts == 1 ? "" : "s");
    if (job->maps & BAKE_MAP_CURVATURE) {
        bake_choose_radius(job);
        status = bake_warn_of_radius(job->ctx, &job->curvature, job->measures.curvature_radius);
    }
    bake_end_tracing(job);
done:
    end_farm(&farm);
    return status;
}
