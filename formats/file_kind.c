/* file_kind.c - see file_kind.h. */
#include "formats/file_kind.h"

#include <string.h>
#include <strings.h>

#include "base/file.h"
#include "formats/chunks/tris_internal.h"

/* Both kinds, and the file of a machine with the other order of bytes, whose own check names it. */
static bool is_nanovdb(const char magic[8])
{
    return memcmp(magic, "NanoVDB", 7) == 0 || memcmp(magic + 1, "BDVonaN", 7) == 0;
}

int fmt_recognise(struct bsq_ctx *ctx, const char *path, enum fmt_kind *out)
{
    struct bsq_file file;
    char magic[8] = {0};
    uint64_t got;
    *out = FMT_KIND_OTHER;
    int status = bsq_file_open(ctx, path, &file);
    if (status == 0)
        status = bsq_file_read_some(ctx, &file, magic, sizeof magic, 0, &got);
    bsq_file_close(ctx, &file);
    if (status < 0)
        return status;
    if (memcmp(magic, TRIS_MAGIC, sizeof magic) == 0)
        *out = FMT_KIND_TRIS;
    else if (is_nanovdb(magic))
        *out = FMT_KIND_NVDB;
    else if (memcmp(magic, " BDV", 4) == 0)
        *out = FMT_KIND_VDB;
    return 0;
}

/* What else the file is, to be said behind what it is not. An OBJ has no first bytes of its own:
 * its name has to do. */
static const char *otherwise(const char *path, enum fmt_kind kind)
{
    size_t length = strlen(path);
    if (kind == FMT_KIND_VDB)
        return ", but one of OpenVDB";
    if (length >= 4 && strcasecmp(path + length - 4, ".obj") == 0)
        return "; bisque-voxelize makes both from an OBJ file";
    return "";
}

int fmt_recognise_scan(struct bsq_ctx *ctx, const char *path, enum fmt_kind *out)
{
    int status = fmt_recognise(ctx, path, out);
    if (status == 0 && *out != FMT_KIND_TRIS && *out != FMT_KIND_NVDB)
        status = bsq_fail(ctx, BSQ_EDATA, "%s: neither a chunk file nor a NanoVDB file%s", path,
                          otherwise(path, *out));
    return status;
}
