/* sort.c - sorts a scan's mesh files into a chunk file.
 *
 * Reading keeps vertices as attribute streams (read/) and partitions triangles into buckets by
 * place (partition/). Batches of buckets are sorted, cut into chunks and written (chunk/). Every
 * step streams, and what does not fit in memory goes to temporary files. */
#include "formats/material/channels.h"
#include "base/context.h"
#include "base/job_files.h"
#include "libvoxel/chunk/chunk_writer.h"
#include "libvoxel/normals/normals.h"
#include "libvoxel/partition/partition.h"
#include "libvoxel/sort_limits.h"
#include "libvoxel/temp_tris.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define MIB ((uint64_t)1 << 20)

/* ---- memory ---- */

uint64_t vox_memory_min(unsigned threads)
{
    return 44 * MIB + 8 * MIB * threads;
}

void vox_sort_limits_for(uint64_t budget, unsigned threads, struct sort_limits *limits)
{
    uint64_t least = vox_memory_min(threads);
    uint64_t rest = budget > least ? budget - least : 0;
    *limits = (struct sort_limits){
        .stream_bytes = 8 * MIB + rest / 4 * 3,
        .stream_shift = rest >= 256 * MIB ? STREAM_LARGE_SHIFT : STREAM_SMALL_SHIFT,
        .page_memory = 8 * MIB + (rest < 64 * MIB ? rest / 8 : 8 * MIB),
        .max_page_memory = UINT64_MAX,
        .vertex_bucket_bytes = UINT64_MAX,
        .reserve_bytes = 8 * MIB + MIB / 2 * threads,
        .batch_triangles = 2 << 20,
        .page_bytes = 32768,
        .bucket_levels = 5,
        .index_bytes = 4,
        .slots = 2 * threads,
    };
}

/* ---- reading ---- */

static void report_totals(struct vox_sort_report *report, const struct fmt_mesh_totals *totals)
{
    report->bytes_read = totals->bytes;
    report->vertices = totals->vertices;
    report->faces = totals->faces;
    report->short_faces = totals->short_faces;
    report->skipped_lines = totals->skipped_lines;
}

static int read_batches(struct scan *scan, struct fmt_mesh_reader *reader,
                        const struct vox_sort_options *options, enum partition_passes passes,
                        struct scan_textures *textures, struct partition *out)
{
    const uint64_t bytes = fmt_mesh_bytes(reader);
    bsq_progress_begin(scan->ctx, "reading", "bytes",
                       passes == PARTITION_TWO_PASSES ? 2 * bytes : bytes);
    const int status = vox_partition_read(scan, reader, options->tris_path, passes, out);
    bsq_progress_end(scan->ctx);
    BSQ_PASS(status);
    BSQ_PASS(vox_scan_finish(scan, reader));
    BSQ_PASS(vox_scan_find_materials(scan, reader, options->texture_path, textures,
                                     (enum fmt_ids)options->ids));
    BSQ_PASS(vox_scan_compare_files(scan, options->texture_path));
    BSQ_PASS(vox_scan_warn_colorless(scan));
    vox_tuple_layout_for(scan, &out->layout);
    return 0;
}

/* Takes the origin that the options give, if they do. Errors: those of fmt_tris_open(). */
static int take_origin(struct scan *scan, const struct vox_sort_options *options)
{
    struct fmt_tris_file *file = NULL;
    const double *origin = options->origin;
    int status = 0;
    if (!origin && options->origin_path)
        status = fmt_tris_open(scan->ctx, options->origin_path, &file);
    if (file)
        origin = fmt_tris_get_header(file)->origin;
    scan->origin_given = origin != NULL;
    if (origin)
        memcpy(scan->origin, origin, sizeof scan->origin);
    fmt_tris_close(file);
    return status;
}

/* Makes an empty scan. Errors: BSQ_ENOMEM; those of take_origin(). */
static int begin_scan(struct scan *scan, struct bsq_ctx *ctx,
                      const struct vox_sort_options *options, const struct sort_limits *limits)
{
    int status = vox_scan_init(scan, ctx, limits, options->scan_paths, options->scan_count,
                               options->tris_path);
    scan->channels = options->channels;
    scan->channel_count = options->channel_count;
    scan->tells_unkept = options->tells_unkept;
    return status < 0 ? status : take_origin(scan, options);
}

/* Reads in one pass if samples of the text say that this is possible, and again in two passes if
 * they are wrong. */
static int read_passes(struct scan *scan, struct fmt_mesh_reader *reader,
                       const struct vox_sort_options *options, bool one_pass,
                       struct scan_textures *textures, struct partition *out)
{
    struct bsq_ctx *ctx = scan->ctx;
    const struct sort_limits *limits = scan->limits;
    const enum partition_passes passes = one_pass ? PARTITION_ONE_PASS : PARTITION_TWO_PASSES;
    int status = read_batches(scan, reader, options, passes, textures, out);
    if (status != BSQ_RETRY)
        return status;
    vox_partition_free(out);
    vox_scan_free(scan);
    BSQ_PASS(begin_scan(scan, ctx, options, limits));
    return read_batches(scan, reader, options, PARTITION_TWO_PASSES, textures, out);
}

/* Adds a name to a list of VOX_NAMES_BYTES bytes. */
static void sort_add_name(char *list, const char *name)
{
    const size_t length = strlen(list);
    snprintf(list + length, VOX_NAMES_BYTES - length, "%s%s", length > 0 ? "," : "", name);
}

static void report_scan(const struct scan *scan, const struct vox_sort_options *options,
                        struct vox_sort_report *report)
{
    const char *outer = vox_scan_find_texture(scan, options->embed_textures);
    report_totals(report, &scan->totals);
    report->broken_faces = scan->lost[FMT_MESH_VERTEX].count;
    report->lost_corners = scan->lost[FMT_MESH_TEXCOORD].count + scan->lost[FMT_MESH_NORMAL].count;
    memcpy(report->origin, scan->origin, sizeof report->origin);
    report->has_colors = (scan->attributes & FMT_TRIS_COLORS) != 0;
    report->has_fine_colors = (scan->attributes & FMT_TRIS_FINE_COLORS) != 0;
    report->has_normals = (scan->attributes & FMT_TRIS_NORMALS) != 0;
    report->has_texcoords = (scan->attributes & FMT_TRIS_TEXCOORDS) != 0;
    report->unused_texcoords = !report->has_texcoords && scan_count(scan, SCAN_TEXCOORDS) > 0;
    report->double_sided = scan->double_sided;
    report->uses_textures = vox_scan_find_texture(scan, false) != NULL;
    if (outer)
        sort_add_name(report->outer_texture, outer);
    for (uint32_t i = 0; i < scan->material_count; i++)
        report->has_material_colors |=
            !scan->materials[i].texture_path && !scan->materials[i].colorless;
    for (uint32_t c = 0; c < scan->channel_count; c++)
        sort_add_name(report->kept_channels, scan->channels[c].name);
    for (unsigned i = 0; fmt_channel_at(i); i++)
        if (scan->unkept >> i & 1)
            sort_add_name(report->unkept_channels, fmt_channel_at(i)->name);
}

static int read_scan(struct scan *scan, const struct sort_limits *limits,
                     const struct vox_sort_options *options, struct vox_sort_report *report,
                     struct partition *out)
{
    struct fmt_mesh_reader *reader = NULL;
    struct bsq_ctx *ctx = scan->ctx;
    struct fmt_mesh_hints hints = {0};
    struct scan_textures textures = {.channels = options->channels,
                                     .channel_count = options->channel_count,
                                     .only_channels = options->texture_path != NULL};
    const double start = bsq_seconds_now();
    int status;
    const struct fmt_mesh_inputs inputs = {.paths = options->scan_paths,
                                           .sources = options->sources,
                                           .path_count = options->scan_count,
                                           .placements = options->placements,
                                           .beside = options->tris_path,
                                           .pipes = true};
    BSQ_TRY(fmt_mesh_open_inputs(ctx, &inputs, &reader));
    if (options->ids == VOX_IDS_OBJECT)
        fmt_mesh_use_objects(reader);
    BSQ_TRY(fmt_mesh_look(reader, &hints));
    BSQ_TRY(
        vox_textures_preview(ctx, reader, options->texture_path, hints.has_texcoords, &textures));
    status = read_passes(scan, reader, options, hints.faces_come_last && !limits->two_passes,
                         &textures, out);
done:
    vox_textures_free(ctx, &textures);
    fmt_mesh_close(reader);
    report_scan(scan, options, report);
    report->seconds_read = bsq_seconds_now() - start;
    return status;
}

/* ---- sorting ---- */

/* Returns whether the chunk file gets the name tris_path. */
static bool names_tris(const struct vox_sort_options *options)
{
    return !options->temp_tris || options->keeps_tris;
}

static int commit(const struct vox_sort_options *options, struct fmt_tris_writer *writer,
                  struct bsq_ctx *ctx, struct vox_sort_report *report)
{
    struct bsq_file file = BSQ_FILE_CLOSED,
                    *out = options->temp_tris ? &options->temp_tris->file : &file;
    int status = fmt_tris_commit(writer, out);
    report->tris_bytes = out->size;
    if (!options->temp_tris)
        bsq_file_close(ctx, &file);
    return status;
}

static int fail_without_area(const struct scan *scan, uint64_t triangles)
{
    if (triangles == 1)
        return bsq_fail(scan->ctx, BSQ_EDATA, "%s: the scan's only triangle has no area",
                        scan->paths[0]);
    return bsq_fail(scan->ctx, BSQ_EDATA, "%s: none of the scan's %llu triangles has an area",
                    scan->paths[0], (unsigned long long)triangles);
}

_Static_assert((int)VOX_IDS_MATERIAL == (int)FMT_IDS_MATERIAL &&
                   (int)VOX_IDS_OBJECT == (int)FMT_IDS_OBJECT &&
                   (int)VOX_IDS_COLOR == (int)FMT_IDS_COLOR,
               "both have one order");

/* Writes the chunks to *out, which the caller commits or discards. */
static int write_chunks(const struct scan *scan, const struct partition *partition,
                        const struct vox_sort_options *options, struct vox_sort_report *report,
                        struct fmt_tris_writer **out)
{
    struct fmt_tris_header header = {
        .attributes = scan_stored_attributes(scan),
        .source_faces = scan->totals.faces,
        .origin = {scan->origin[0], scan->origin[1], scan->origin[2]},
        .material_count = scan->material_count,
        .materials = scan->materials,
        .ids = scan->ids,
        .channel_count = scan->channel_count,
        .embeds_images = options->embed_textures,
    };
    struct fmt_tris_writer *writer = NULL;
    struct batches_report batches = {0};
    int status;
    BSQ_TRY(BSQ_CALLOC(scan->ctx, "channels", scan->channel_count + UINT64_C(1), &header.channels));
    for (uint32_t c = 0; c < scan->channel_count; c++)
        header.channels[c] = (char *)(uintptr_t)scan->channels[c].name;
    BSQ_TRY(names_tris(options)
                ? fmt_tris_create(scan->ctx, options->tris_path, &header, &writer)
                : fmt_tris_create_temp(scan->ctx, options->tris_path, &header, &writer));
    status = vox_write_chunks(scan, partition, options->tris_path, writer, &batches);
    report->chunks = batches.chunks;
    report->triangles = batches.triangles;
    report->degenerate_triangles = batches.degenerate;
    BSQ_TRY(status);
    if (batches.triangles == 0)
        BSQ_TRY(fail_without_area(scan, batches.degenerate));
    fmt_tris_skip(writer, batches.degenerate);
    *out = writer;
    writer = NULL;
done:
    fmt_tris_discard(writer);
    bsq_free(scan->ctx, header.channels);
    return status;
}

static int sort_scan(const struct scan *scan, const struct vox_sort_options *options,
                     const struct partition *partition, struct vox_sort_report *report,
                     struct fmt_tris_writer **out)
{
    double start = bsq_seconds_now();
    bsq_progress_begin(scan->ctx, "writing", "triangles", partition->triangles);
    int status = write_chunks(scan, partition, options, report, out);
    bsq_progress_end(scan->ctx);
    report->seconds_sort = bsq_seconds_now() - start;
    return status;
}

/* Makes the normals of a scan that has none. */
static int sort_make_normals(struct bsq_ctx *ctx, const struct vox_sort_options *options,
                             struct fmt_tris_writer *writer, struct vox_sort_report *report)
{
    const double start = bsq_seconds_now();
    const enum bsq_scan_normals weights = options->scan_normals == BSQ_SCAN_NORMALS_AUTO
                                              ? BSQ_SCAN_NORMALS_SMOOTH
                                              : options->scan_normals;
    if (report->has_normals || weights == BSQ_SCAN_NORMALS_FLAT)
        return 0;
    const int status = vox_write_normals(ctx, writer, weights, options->tris_path);
    report->seconds_sort += bsq_seconds_now() - start;
    return status;
}

static int sort_check_channels(struct bsq_ctx *ctx, const struct vox_sort_options *options)
{
    for (uint32_t i = 0; i < options->channel_count; i++) {
        const char *name = options->channels[i].name;
        if (!fmt_is_channel_name(name))
            return bsq_fail(ctx, BSQ_EUSAGE,
                            "\"%s\" cannot be a channel: names have lower-case letters, digits and "
                            "_, with a letter first",
                            name);
        if (fmt_is_map_name(name))
            return bsq_fail(ctx, BSQ_EUSAGE, "channel %s: there is a map of this name", name);
        for (uint32_t j = 0; j < i; j++)
            if (strcmp(options->channels[j].name, name) == 0)
                return bsq_fail(ctx, BSQ_EUSAGE, "channel %s is named twice", name);
    }
    return 0;
}

int vox_sort_with_limits(struct bsq_ctx *ctx, const struct vox_sort_options *options,
                         const struct sort_limits *limits, struct vox_sort_report *report)
{
    struct scan scan;
    struct partition partition = {0};
    struct fmt_tris_writer *writer = NULL;
    uint64_t temp_before = bsq_temp_bytes(ctx);
    if (bsq_clear_report(ctx, "vox_sort_report", report, sizeof *report) < 0)
        return BSQ_EUSAGE;
    int status;
    BSQ_PASS(bsq_check_size(ctx, "vox_sort_options", options->size, sizeof *options));
    BSQ_TRY(begin_scan(&scan, ctx, options, limits));
    BSQ_TRY(sort_check_channels(ctx, options));
    BSQ_TRY(names_tris(options) ? bsq_note_output(ctx, options->tris_path) : 0);
    BSQ_TRY(read_scan(&scan, limits, options, report, &partition));
    status = sort_scan(&scan, options, &partition, report, &writer);
done:
    vox_partition_free(&partition);
    vox_scan_free(&scan);
    if (status == 0)
        status = sort_make_normals(ctx, options, writer, report);
    if (status == 0)
        status = commit(options, writer, ctx, report);
    else
        fmt_tris_discard(writer);
    report->temp_bytes = bsq_temp_bytes(ctx) - temp_before;
    return status;
}

void vox_sort_defaults(struct vox_sort_options *options)
{
    *options = (struct vox_sort_options){.size = sizeof *options, .tells_unkept = true};
}

/* A handle is a few bytes and a job may have a budget of only vox_memory_min(), so it is not
 * counted. */
int vox_temp_tris_create(struct bsq_ctx *ctx, struct vox_temp_tris **out)
{
    *out = malloc(sizeof **out);
    if (!*out)
        return bsq_fail_errno(ctx, BSQ_ENOMEM, ENOMEM, "chunk file");
    **out = (struct vox_temp_tris){.ctx = ctx, .file = BSQ_FILE_CLOSED};
    return 0;
}

void vox_temp_tris_close(struct vox_temp_tris *temp)
{
    if (!temp)
        return;
    bsq_file_close(temp->ctx, &temp->file);
    free(temp);
}

int vox_sort(struct bsq_ctx *ctx, const struct vox_sort_options *options,
             struct vox_sort_report *report)
{
    struct sort_limits limits;
    uint64_t budget = bsq_memory_left(ctx), least = vox_memory_min(bsq_threads(ctx));
    if (budget < least)
        return bsq_fail(ctx, BSQ_ENOMEM,
                        "sorting with %u threads needs at least %llu MiB of memory, it may use "
                        "%llu MiB",
                        bsq_threads(ctx), (unsigned long long)(least / MIB),
                        (unsigned long long)(budget / MIB));
    vox_sort_limits_for(budget, bsq_threads(ctx), &limits);
    return vox_sort_with_limits(ctx, options, &limits, report);
}

/* ---- parsing alone ---- */

static int count_batch(void *ctx, const struct fmt_mesh_batch *batch)
{
    bsq_progress_add(ctx, batch->byte_size);
    return 0;
}

int vox_parse(struct bsq_ctx *ctx, const struct vox_sort_options *options,
              struct vox_sort_report *report)
{
    struct fmt_mesh_reader *reader = NULL;
    struct fmt_mesh_totals totals = {0};
    const double start = bsq_seconds_now();
    const struct fmt_mesh_inputs inputs = {
        .paths = options->scan_paths, .path_count = options->scan_count, .pipes = true};
    int status;
    BSQ_TRY(bsq_clear_report(ctx, "vox_sort_report", report, sizeof *report));
    BSQ_TRY(bsq_check_size(ctx, "vox_sort_options", options->size, sizeof *options));
    BSQ_TRY(fmt_mesh_open_inputs(ctx, &inputs, &reader));
    bsq_progress_begin(ctx, "reading", "bytes", fmt_mesh_bytes(reader));
    status = fmt_mesh_read(reader, count_batch, ctx, &totals);
    bsq_progress_end(ctx);
    report->triangles = totals.corners - 2 * totals.faces;
    report->seconds_read = bsq_seconds_now() - start;
    report_totals(report, &totals);
done:
    fmt_mesh_close(reader);
    return status;
}
