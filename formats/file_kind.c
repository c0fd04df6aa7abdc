/* file_kind.c - asks each format whether a file's first bytes are its own. */
#include "formats/file_kind.h"

#include "base/file.h"
#include "formats/chunks/tris.h"
#include "formats/grid/nvdb.h"
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
    int status = fmt_recognise(ctx, path, out);
    if (status == 0 && *out != FMT_KIND_TRIS && *out != FMT_KIND_NVDB)
        status = bsq_fail(ctx, BSQ_EDATA, "%s: neither a chunk file nor a NanoVDB file%s", path,
                          advice(*out));
    return status;
}
