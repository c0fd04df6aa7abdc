/* join.c - writes chunk files as one, and gives it vertex normals. */
#include "base/context.h"
#include "base/job_files.h"
#include "base/parallel.h"
#include "libvoxel/normals/normals.h"
#include "libvoxel/temp_tris.h"

#include <string.h>

/* A chunk under way: that of the slot's sequence number. */
struct join_slot {
    uint64_t size;
    void *scratch, *encoded;
    struct fmt_tris_chunk_info info;
};

struct joining {
    struct bsq_ctx *ctx;
    const struct fmt_tris_file *file;
    const struct fmt_tris_header *header;
    struct fmt_tris_writer *writer;
};

static int join_produce(void *arg, void *slot, uint64_t sequence)
{
    (void)slot;
    return sequence < ((const struct joining *)arg)->header->chunk_count;
}

static int join_work(void *arg, void *slot, uint64_t sequence, unsigned worker)
{
    const struct joining *j = arg;
    struct join_slot *s = slot;
    struct fmt_tris_chunk chunk;
    (void)worker;
    const int status = fmt_tris_load(j->file, sequence, s->scratch, &chunk);
    return status < 0 ? status
                      : fmt_tris_encode(j->ctx, j->header->attributes, &chunk, s->encoded, &s->size,
                                        &s->info);
}

static int join_emit(void *arg, void *slot, uint64_t sequence)
{
    const struct joining *j = arg;
    const struct join_slot *s = slot;
    (void)sequence;
    bsq_progress_add(j->ctx, s->info.triangle_count);
    return fmt_tris_append(j->writer, s->encoded, s->size, &s->info);
}

/* Copies all chunks. */
static int copy_chunks(struct joining *j)
{
    const struct fmt_tris_chunk_info *infos = fmt_tris_chunks(j->file);
    struct join_slot *slots = NULL;
    uint64_t encoded = 0;
    int status;
    for (uint64_t i = 0; i < j->header->chunk_count; i++) {
        const uint64_t bytes = fmt_tris_encoded_bound(
            j->header->attributes, infos[i].triangle_count, infos[i].vertex_count);
        encoded = bytes > encoded ? bytes : encoded;
    }
    const uint64_t usual = UINT64_C(2) * bsq_threads(j->ctx),
                   fits = bsq_memory_share(j->ctx, "chunks", 2) /
                          (fmt_tris_load_size_max(j->file) + encoded);
    const uint64_t count = fits < 1 ? 1 : fits < usual ? fits : usual;
    BSQ_TRY(bsq_calloc(j->ctx, "chunks", count, sizeof *slots, &slots));
    for (uint64_t i = 0; i < count; i++) {
        BSQ_TRY(bsq_alloc(j->ctx, "chunks", fmt_tris_load_size_max(j->file), 1, &slots[i].scratch));
        BSQ_TRY(bsq_alloc(j->ctx, "chunks", encoded, 1, &slots[i].encoded));
    }
    const struct bsq_pipeline pipeline = {.produce = join_produce,
                                          .work = join_work,
                                          .emit = join_emit,
                                          .arg = j,
                                          .slots = slots,
                                          .slot_size = sizeof *slots,
                                          .slot_count = (unsigned)count};
    status = bsq_pipeline_run(j->ctx, &pipeline);
done:
    for (uint64_t i = 0; slots && i < count; i++) {
        bsq_free(j->ctx, slots[i].scratch);
        bsq_free(j->ctx, slots[i].encoded);
    }
    bsq_free(j->ctx, slots);
    return status;
}

/* Makes the normals of the new file, unless the scan has its own. */
static int join_normals(struct joining *j, const struct vox_join_options *options)
{
    enum bsq_scan_normals weights = options->scan_normals;
    if (weights == BSQ_SCAN_NORMALS_AUTO)
        weights = fmt_tris_parts_normals(j->file);
    if (j->header->attributes & FMT_TRIS_NORMALS || weights == BSQ_SCAN_NORMALS_AUTO ||
        weights == BSQ_SCAN_NORMALS_FLAT)
        return 0;
    return vox_write_normals(j->ctx, j->writer, weights, options->output_path);
}

static void report_join(const struct joining *j, struct vox_sort_report *report)
{
    report->triangles = j->header->triangle_count;
    report->chunks = j->header->chunk_count;
    report->has_normals = (j->header->attributes & FMT_TRIS_NORMALS) != 0;
    report->has_texcoords = (j->header->attributes & FMT_TRIS_TEXCOORDS) != 0;
    report->has_colors = (j->header->attributes & FMT_TRIS_COLORS) != 0;
    memcpy(report->origin, j->header->origin, sizeof report->origin);
}

int vox_join(struct bsq_ctx *ctx, const struct vox_join_options *options,
             struct vox_sort_report *report)
{
    const double start = bsq_seconds_now();
    const uint64_t temp_before = bsq_temp_bytes(ctx);
    struct fmt_tris_file *file = NULL;
    struct bsq_file made = BSQ_FILE_CLOSED;
    struct joining j = {.ctx = ctx};
    int status;
    BSQ_TRY(bsq_clear_report(ctx, "vox_sort_report", report, sizeof *report));
    BSQ_TRY(bsq_check_size(ctx, "vox_join_options", options->size, sizeof *options));
    BSQ_TRY(bsq_note_output(ctx, options->output_path));
    BSQ_TRY(fmt_tris_open_parts(ctx, options->tris_paths, options->tris_count,
                                options->temp_tris ? &options->temp_tris->file : NULL, &file));
    j.file = file;
    j.header = fmt_tris_get_header(file);
    struct fmt_tris_header header = *j.header;
    header.embeds_images = fmt_tris_has_images(file);
    BSQ_TRY(fmt_tris_create(ctx, options->output_path, &header, &j.writer));
    bsq_progress_begin(ctx, "writing", "triangles", header.triangle_count);
    status = copy_chunks(&j);
    bsq_progress_end(ctx);
    BSQ_TRY(status);
    fmt_tris_skip(j.writer, header.skipped_triangles);
    BSQ_TRY(join_normals(&j, options));
    report_join(&j, report);
    status = fmt_tris_commit(j.writer, &made);
    j.writer = NULL;
    report->tris_bytes = made.size;
done:
    fmt_tris_discard(j.writer);
    bsq_file_close(ctx, &made);
    fmt_tris_close(file);
    report->temp_bytes = bsq_temp_bytes(ctx) - temp_before;
    report->seconds_sort = bsq_seconds_now() - start;
    return status;
}
