/* parts.c - a bake in parts: bakes the share of one, or takes the texels of all from their files.
 *
 * Each job measures distances and divides the texels by itself, which gives the same from the same
 * inputs. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <xxhash.h>

#include "base/job_files.h"
#include "base/parallel.h"
#include "formats/fingerprint.h"
#include "libbake/job/job.h"
#include "libbake/job/parts.h"

enum { LIST_BYTES = 160 /* of numbers in a message */ };

/* ---- the identity of a bake ---- */

static int begin_checksum(struct bsq_ctx *ctx, XXH3_state_t **out)
{
    *out = XXH3_createState();
    if (*out && XXH3_128bits_reset(*out) == XXH_OK)
        return 0;
    XXH3_freeState(*out);
    *out = NULL;
    return bsq_fail(ctx, BSQ_ENOMEM, "checksum: out of memory");
}

static void end_checksum(XXH3_state_t *state, char *out)
{
    const XXH128_hash_t hash = XXH3_128bits_digest(state);
    bake_part_digest(&hash, out);
    XXH3_freeState(state);
}

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
    BSQ_PASS(begin_checksum(job->ctx, &state));
    parts_add_options(state, rows, count, job->options);
    end_checksum(state, job->identity.of[BAKE_PART_OPTIONS]);
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
    BSQ_TRY(begin_checksum(job->ctx, &state));
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
    end_checksum(state, job->identity.of[BAKE_PART_INPUTS]);
    state = NULL;
done:
    XXH3_freeState(state);
    return status;
}

/* Finds out what files of parts must say, and which blocks each part has. */
static int prepare(struct bake_job *job)
{
    snprintf(job->identity.of[BAKE_PART_VERSION], BAKE_PART_TEXT, "%s", BSQ_VERSION);
    BSQ_PASS(identify_options(job));
    BSQ_PASS(identify_inputs(job));
    return bake_divide(job);
}

/* ---- boxes ---- */

static bool box_is_empty(const struct bake_box *box)
{
    return box->x_end == 0;
}

/* Adds block b of a tile to a box; zeros are an empty one. */
static void add_block(const struct bake_tile *tile, uint64_t b, struct bake_box *box)
{
    const uint32_t side = tile->blocks.side;
    const uint32_t x = (uint32_t)(b % tile->blocks.columns) * side;
    const uint32_t y = (uint32_t)(b / tile->blocks.columns) * side;
    const uint32_t x_end = tile->options.width - x < side ? tile->options.width : x + side;
    const uint32_t y_end = tile->options.height - y < side ? tile->options.height : y + side;
    if (box_is_empty(box))
        *box = (struct bake_box){x, y, x_end, y_end};
    box->x = x < box->x ? x : box->x;
    box->y = y < box->y ? y : box->y;
    box->x_end = x_end > box->x_end ? x_end : box->x_end;
    box->y_end = y_end > box->y_end ? y_end : box->y_end;
}

static uint64_t block_count(const struct bake_tile *tile)
{
    return (uint64_t)tile->blocks.columns * tile->blocks.rows;
}

/* Returns the box of the job's part in a tile. */
static struct bake_box own_box(const struct bake_tile *tile)
{
    struct bake_box box = {0};
    for (uint64_t b = 0; b < block_count(tile); b++)
        if (tile->blocks.places[b] != BAKE_NO_PLACE)
            add_block(tile, b, &box);
    return box;
}

/* ---- one part ---- */

/* Sets *out if all files of the job's part are there and whole. */
static int is_done(const struct bake_job *job, const struct bake_channels *channels, bool *out)
{
    int status = 0;
    *out = false;
    for (uint32_t t = 0; t < job->udim.count && status == 0; t++) {
        struct bake_part part;
        if (job->tiles[t].blocks.count == 0)
            continue;
        const struct bake_box box = own_box(&job->tiles[t]);
        status = bake_part_open(job, channels, t, job->options->part, &box, &part);
        if (status == 0)
            status = bake_part_read(&part, NULL);
        bake_part_close(&part);
        *out = status == 0;
    }
    if (status == BSQ_ENOMEM || status == BSQ_EINTR)
        return status;
    bsq_clear_error(job->ctx);
    return 0;
}

/* Checks before the work that all files of the job's part can be written. */
static int check_files(const struct bake_job *job)
{
    uint64_t count = 0;
    int status = 0;
    for (uint32_t t = 0; t < job->udim.count && status == 0; t++) {
        if (job->tiles[t].blocks.count == 0)
            continue;
        char *path = bake_part_path(job, &job->tiles[t], job->options->part);
        status = path ? bsq_output_check(job->ctx, path)
                      : bsq_fail(job->ctx, BSQ_ENOMEM, "a part: out of memory");
        free(path);
        count++;
    }
    return status < 0 ? status
                      : bsq_require_descriptors(job->ctx, job->options->output_path, count);
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
static int write_files(const struct bake_job *job, const struct bake_channels *channels)
{
    const struct bake_report *report = job->report;
    const struct bake_part_counts counts = {report->covered_texels, report->samples, report->hits,
                                            report->overlapping_samples, job->curvature};
    struct bsq_output_group group = {0};
    struct bsq_output *output;
    int status = 0;
    for (uint32_t t = 0; t < job->udim.count; t++) {
        if (job->tiles[t].blocks.count == 0)
            continue;
        const struct bake_box box = own_box(&job->tiles[t]);
        BSQ_TRY(bake_part_write(job, channels, t, &box, &counts, &output));
        BSQ_TRY(bsq_output_group_add(&group, output));
    }
    status = bsq_output_group_commit(&group);
done:
    bsq_output_group_discard(&group);
    return status;
}

int bake_run_part(struct bake_job *job)
{
    struct bake_channels channels;
    int status;
    BSQ_TRY(bake_name_channels(job, &channels));
    BSQ_TRY(bake_set_params(job)); /* which measures distances by triangles in the mesh's order */
    BSQ_TRY(prepare(job));
    for (uint32_t t = 0; t < job->udim.count; t++)
        BSQ_TRY(bake_take_share(job, &job->tiles[t]));
    BSQ_TRY(is_done(job, &channels, &job->report->done));
    if (job->report->done)
        goto done;
    BSQ_TRY(check_files(job));
    BSQ_TRY(parts_trace_own(job));
    status = write_files(job, &channels);
done:
    bake_free_channels(&channels);
    return status;
}

/* ---- all parts ---- */

/* The parts that have blocks in a tile. */
struct tile_parts {
    struct bake_job *job;
    struct bake_channels channels;
    uint32_t tile;
    struct bake_box *boxes;           /* of all parts */
    uint32_t *list, count;            /* those with a box, from 0 on */
    bool *counted;                    /* the counts of a part are added already */
    uint32_t *missing, missing_count; /* from 1 on */
};

static int list_parts(struct tile_parts *of)
{
    const struct bake_tile *tile = &of->job->tiles[of->tile];
    const uint32_t parts = of->job->options->parts;
    memset(of->boxes, 0, parts * sizeof *of->boxes);
    for (uint64_t b = 0; b < block_count(tile); b++)
        add_block(tile, b, &of->boxes[tile->shares[b]]);
    of->count = 0;
    for (uint32_t i = 0; i < parts; i++)
        if (!box_is_empty(&of->boxes[i]))
            of->list[of->count++] = i;
    return bsq_check(of->job->ctx);
}

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

/* Checks the headers of a tile's parts, and notes those that are missing. */
static int check_tile(struct tile_parts *of)
{
    int status = list_parts(of);
    for (uint32_t i = 0; i < of->count && status == 0; i++) {
        const uint32_t share = of->list[i];
        struct bake_part part;
        status =
            bake_part_open(of->job, &of->channels, of->tile, share + 1, &of->boxes[share], &part);
        if (status == 0 && !of->counted[share])
            add_counts(of->job, &part.counts);
        if (status == BSQ_ENOINPUT) {
            bsq_clear_error(of->job->ctx);
            if (of->missing_count == 0 || of->missing[of->missing_count - 1] != share + 1)
                of->missing[of->missing_count++] = share + 1;
            status = 0;
        }
        of->counted[share] = true;
        bake_part_close(&part);
        if (status == 0)
            status = bsq_check(of->job->ctx);
    }
    return status;
}

/* Fails with the numbers of a tile's missing parts, as many as fit a line. */
static int parts_fail_missing(const struct tile_parts *of)
{
    const struct bake_job *job = of->job;
    char list[LIST_BYTES] = "";
    size_t length = 0;
    uint32_t named = 0;
    for (; named < of->missing_count && length + 32 < sizeof list; named++)
        length += (size_t)snprintf(list + length, sizeof list - length, "%s%u", named ? ", " : "",
                                   of->missing[named]);
    char *path = bake_part_path(job, &job->tiles[of->tile], of->missing[0]);
    const int status = bsq_fail(
        job->ctx, BSQ_ENOINPUT, "%s: missing; of %u parts, %u %s missing: %s%s",
        path ? path : "a part", job->options->parts, of->missing_count,
        of->missing_count == 1 ? "is" : "are", list, named < of->missing_count ? " ..." : "");
    free(path);
    return status;
}

static int parts_read_one(void *arg, uint64_t i, unsigned worker)
{
    const struct tile_parts *of = arg;
    const uint32_t share = of->list[i];
    struct bake_part part;
    (void)worker;
    int status =
        bake_part_open(of->job, &of->channels, of->tile, share + 1, &of->boxes[share], &part);
    if (status == 0)
        status = bake_part_read(&part, of->job->tiles[of->tile].image);
    bake_part_close(&part);
    bsq_progress_add(of->job->ctx, 1);
    return status;
}

/* Takes the texels of a tile. Their images share half of the memory that is left, as in a bake
 * without parts. */
static int read_tile(struct tile_parts *of, uint64_t memory_bytes)
{
    struct bake_job *job = of->job;
    struct bake_tile *tile = &job->tiles[of->tile];
    int status;
    BSQ_TRY(list_parts(of));
    BSQ_TRY(bake_tile_create_image(job->ctx, tile, false, memory_bytes));
    bsq_progress_begin(job->ctx, "reading parts", "parts", of->count);
    status = bsq_parallel_for(job->ctx, of->count, parts_read_one, of);
    bsq_progress_end(job->ctx);
    if (status == 0)
        status = bake_image_measure(job->ctx, tile->image, job->maps, job->measures.statistics);
    if (tile->skipped) {
        bake_image_free(tile->image);
        tile->image = NULL;
    }
done:
    return status;
}

static int read_tiles(struct tile_parts *of)
{
    struct bake_job *job = of->job;
    const uint64_t reserve = bsq_memory_left(job->ctx) / 2;
    for (of->tile = 0; of->tile < job->udim.count; of->tile++) {
        of->missing_count = 0;
        BSQ_PASS(check_tile(of));
        if (of->missing_count > 0)
            return parts_fail_missing(of);
    }
    BSQ_PASS(bake_check_hits(job));
    for (of->tile = 0; of->tile < job->udim.count; of->tile++) {
        const uint64_t left = bsq_memory_left(job->ctx),
                       share = left > reserve ? left - reserve : 0;
        BSQ_PASS(read_tile(of, share / (job->udim.count - of->tile)));
    }
    return 0;
}

int bake_take_parts(struct bake_job *job)
{
    const uint32_t parts = job->options->parts;
    struct tile_parts of = {.job = job};
    int status;
    BSQ_TRY(bake_name_channels(job, &of.channels));
    BSQ_TRY(prepare(job));
    BSQ_TRY(BSQ_ALLOC(job->ctx, "parts", parts, &of.boxes));
    BSQ_TRY(BSQ_ALLOC(job->ctx, "parts", parts, &of.list));
    BSQ_TRY(BSQ_ALLOC(job->ctx, "parts", parts, &of.missing));
    BSQ_TRY(BSQ_CALLOC(job->ctx, "parts", parts, &of.counted));
    BSQ_TRY(read_tiles(&of));
    snprintf(job->report->device, sizeof job->report->device, "%u part%s", parts,
             parts == 1 ? "" : "s");
    if (job->maps & BAKE_MAP_CURVATURE) {
        bake_choose_radius(job);
        status = bake_warn_of_radius(job->ctx, &job->curvature, job->measures.curvature_radius);
    }
    bake_end_tracing(job);
done:
    BSQ_FREE(job->ctx, of.counted, of.missing, of.list, of.boxes);
    bake_free_channels(&of.channels);
    return status;
}
