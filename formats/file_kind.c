/* file_kind.c - see file_kind.h. */
#include "formats/file_kind.h"

#include <string.h>

#include "base/file.h"
#include "formats/chunks/tris_internal.h"
#include "formats/mesh/mesh_reader.h"

/* Both kinds, and the file of a machine with the other order of bytes, whose own check names it. */
static bool is_nanovdb(const char *magic)
{
    return memcmp(magic, "NanoVDB", 7) == 0 || memcmp(magic + 1, "BDVonaN", 7) == 0;
}

int fmt_recognise(struct bsq_ctx *ctx, const char *path, enum fmt_kind *out)
{
    struct bsq_file file;
    char head[FMT_MESH_HEAD_BYTES] = {0};
    uint64_t size = 0;
    *out = FMT_KIND_OTHER;
    int status = bsq_file_open(ctx, path, &file);
    if (status == 0)
        status = bsq_file_read_some(ctx, &file, head, sizeof head, 0, &size);
    bsq_file_close(ctx, &file);
    if (status < 0)
        return status;
    if (memcmp(head, TRIS_MAGIC, 8) == 0)
        *out = FMT_KIND_TRIS;
    else if (is_nanovdb(head))
        *out = FMT_KIND_NVDB;
    else if (memcmp(head, " BDV", 4) == 0)
        *out = FMT_KIND_VDB;
    else if (fmt_mesh_recognise(path, head, size))
        *out = FMT_KIND_MESH;
    return 0;
}

/* Returns the end of a message that says what the file is not. */
static const char *advice(enum fmt_kind kind)
{
    if (kind == FMT_KIND_VDB)
        return ", but one of OpenVDB";
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
