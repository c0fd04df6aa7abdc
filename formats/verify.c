/* verify.c - recognises a file and passes it to the checks of its format. */
#include "formats/verify.h"

#include <string.h>

#include "base/file.h"
#include "formats/file_kind.h"

static int verify_tris(struct bsq_ctx *ctx, const char *path, struct fmt_verify_report *report)
{
    struct fmt_tris_file *file;
    int status = fmt_tris_open(ctx, path, &file);
    if (status < 0)
        return status;
    const struct fmt_tris_header *header = fmt_tris_get_header(file);
    report->kind = FMT_VERIFY_TRIS;
    report->version = fmt_tris_version(header);
    report->triangles = header->triangle_count;
    report->chunks = header->chunk_count;
    bsq_progress_begin(ctx, "verifying", "bytes", report->file_bytes);
    status = fmt_tris_verify(file, &report->vertices);
    bsq_progress_end(ctx);
    fmt_tris_close(file);
    return status;
}

static int verify_nvdb(struct bsq_ctx *ctx, const char *path, struct fmt_verify_report *report)
{
    struct fmt_nvdb_grid grid;
    int status = fmt_nvdb_open(ctx, path, &grid);
    if (status < 0)
        return status;
    report->kind = FMT_VERIFY_NVDB;
    report->version = (uint32_t)fmt_nvdb_record_version(&grid);
    fmt_nvdb_version(grid.info.type, report->nanovdb_version);
    report->type = grid.info.type;
    report->triangles = grid.info.source_triangles;
    report->voxels = grid.voxel_count;
    report->second_records = grid.record_count - 1 - grid.voxel_count;
    report->voxel_size = grid.info.voxel_size;
    report->has_color = grid.info.has_color;
    bsq_progress_begin(ctx, "verifying", "bytes", report->file_bytes);
    status = fmt_nvdb_verify(ctx, &grid);
    bsq_progress_end(ctx);
    fmt_nvdb_close(ctx, &grid);
    return status;
}

int fmt_verify(struct bsq_ctx *ctx, const char *path, struct fmt_verify_report *report)
{
    struct bsq_file file;
    enum fmt_kind kind;
    memset(report, 0, sizeof *report);
    int status = fmt_recognise_scan(ctx, path, &kind);
    if (status == 0 && (status = bsq_file_open(ctx, path, &file)) == 0) {
        report->file_bytes = file.size;
        bsq_file_close(ctx, &file);
    }
    if (status < 0)
        return status;
    return kind == FMT_KIND_TRIS ? verify_tris(ctx, path, report) : verify_nvdb(ctx, path, report);
}
