/* recognise.c - see recognise.h. */
#include "formats/recognise.h"

#include <string.h>

#include "base/file.h"
#include "formats/tris_internal.h"

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

int fmt_recognise_scan(struct bsq_ctx *ctx, const char *path, enum fmt_kind *out)
{
    int status = fmt_recognise(ctx, path, out);
    if (status == 0 && *out != FMT_KIND_TRIS && *out != FMT_KIND_NVDB)
        status = bsq_fail(ctx, BSQ_EDATA, "%s: neither a chunk file nor a NanoVDB file%s", path,
                          *out == FMT_KIND_VDB ? ", but one of OpenVDB" : "");
    return status;
}
