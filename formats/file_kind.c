/* file_kind.c - asks each format whether a file's first bytes are its own, and verifies files by
 * the checks of their formats. */
#include "formats/file_kind.h"

#include "formats/chunks/tris.h"
#include "formats/grid/nvdb.h"

#include "base/file.h"
#include "formats/input/input.h"
#include "formats/mesh/mesh_reader.h"

int fmt_recognise(struct bsq_ctx *ctx, const char *path, enum fmt_kind *out)
{
    struct bsq_file file;
    char head[FMT_MESH_HEAD_BYTES] = {0};
    uint64_t size = 0;
    *out = fmt_input_is_pipe(path) ? FMT_KIND_PIPE : FMT_KIND_OTHER;
    if (*out == FMT_KIND_PIPE)
        return 0;
    int status = bsq_file_open(ctx, path, &file);
    if (status == 0)
        status = bsq_file_read_some(ctx, &file, head, sizeof head, 0, &size);
    bsq_file_close(ctx, &file);
    if (status < 0)
        return status;
    if (fmt_tris_recognise(path, head, size))
        *out = FMT_KIND_TRIS;
    else if (fmt_nvdb_recognise(head))
        *out = FMT_KIND_NVDB;
    else if (fmt_vdb_recognise(head))
        *out = FMT_KIND_VDB;
    else if (fmt_mesh_recognise(path, head, size))
        *out = FMT_KIND_MESH;
    return 0;
}

/* Returns the end of a message that says what the file is not. */
static const char *advice(enum fmt_kind kind)
{
    if (kind == FMT_KIND_VDB)
        return ", but an OpenVDB file";
    if (kind == FMT_KIND_PIPE)
        return ", but a pipe";
    return kind == FMT_KIND_MESH ? "; bisque-voxelize makes both from a mesh" : "";
}

int fmt_recognise_scan(struct bsq_ctx *ctx, const char *path, enum fmt_kind *out)
{
    BSQ_PASS(fmt_recognise(ctx, path, out));
    if (*out != FMT_KIND_TRIS && *out != FMT_KIND_NVDB)
        return bsq_fail(ctx, BSQ_EDATA, "%s: neither a chunk file nor a NanoVDB file%s", path,
                        advice(*out));
    return 0;
}

static int verify_tris(struct bsq_ctx *ctx, const char *path, struct fmt_verify_report *report)
{
    struct fmt_tris_file *file;
    BSQ_PASS(fmt_tris_open(ctx, path, &file));
    const struct fmt_tris_header *header = fmt_tris_get_header(file);
    report->version = FMT_TRIS_VERSION;
    report->triangles = header->triangle_count;
    report->chunks = header->chunk_count;
    bsq_progress_begin(ctx, "verifying", "bytes", report->file_bytes);
    int status = fmt_tris_verify(file, &report->vertices);
    bsq_progress_end(ctx);
    fmt_tris_close(file);
    return status;
}

static int verify_nvdb(struct bsq_ctx *ctx, const char *path, struct fmt_verify_report *report)
{
    struct fmt_nvdb_grid grid;
    BSQ_PASS(fmt_nvdb_open(ctx, path, &grid));
    report->version = (uint32_t)fmt_nvdb_trailer_version(&grid);
    report->triangles = grid.info.source_triangles;
    report->voxels = grid.voxel_count;
    report->second_records = grid.record_count - 1 - grid.voxel_count;
    report->voxel_size = grid.info.voxel_size;
    report->has_color = grid.info.has_color;
    bsq_progress_begin(ctx, "verifying", "bytes", report->file_bytes);
    int status = fmt_nvdb_verify(ctx, &grid);
    bsq_progress_end(ctx);
    fmt_nvdb_close(ctx, &grid);
    return status;
}

int fmt_verify(struct bsq_ctx *ctx, const char *path, struct fmt_verify_report *report)
{
    struct bsq_file file;
    BSQ_PASS(bsq_clear_report(ctx, "fmt_verify_report", report, sizeof *report));
    BSQ_PASS(fmt_recognise_scan(ctx, path, &report->kind));
    BSQ_PASS(bsq_file_open(ctx, path, &file));
    report->file_bytes = file.size;
    bsq_file_close(ctx, &file);
    return report->kind == FMT_KIND_TRIS ? verify_tris(ctx, path, report)
                                         : verify_nvdb(ctx, path, report);
}
