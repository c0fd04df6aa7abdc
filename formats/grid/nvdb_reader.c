/* nvdb_reader.c - recognises and opens grid files, and reads the names that ids stand for. */
#include <string.h>

#include "formats/grid/nvdb_layout_internal.h"

bool fmt_nvdb_recognise(const char first[8])
{
    return memcmp(first, "NanoVDB", 7) == 0 || memcmp(first + 1, "BDVonaN", 7) == 0;
}

bool fmt_vdb_recognise(const char first[8])
{
    return memcmp(first, " BDV", 4) == 0;
}

/* Checks a grid that was mapped, and fills in the rest. Closes it on failure. */
static int check_mapped(struct bsq_ctx *ctx, struct fmt_nvdb_grid *grid)
{
    int status = fmt_nvdb_check_header(ctx, grid);
    if (status == 0)
        status = fmt_nvdb_check_nodes(ctx, grid);
    status = bsq_map_explain(ctx, &grid->map, status);
    if (status)
        fmt_nvdb_close(ctx, grid);
    return status;
}

int fmt_nvdb_open(struct bsq_ctx *ctx, const char *path, struct fmt_nvdb_grid *out)
{
    memset(out, 0, sizeof(*out));
    int status = bsq_map_open(ctx, path, &out->map);
    return status ? status : check_mapped(ctx, out);
}

int fmt_nvdb_open_file(struct bsq_ctx *ctx, struct bsq_file *file, struct fmt_nvdb_grid *out)
{
    memset(out, 0, sizeof(*out));
    int status = bsq_map_file(ctx, file, &out->map);
    return status ? status : check_mapped(ctx, out);
}

void fmt_nvdb_close(struct bsq_ctx *ctx, struct fmt_nvdb_grid *grid)
{
    bsq_map_close(ctx, &grid->map);
    memset(grid, 0, sizeof(*grid));
}

int fmt_nvdb_record_version(const struct fmt_nvdb_grid *grid)
{
    return nvdb_record_version(grid->info.ids != BSQ_IDS_NONE, grid->channel_words > 0);
}

uint64_t fmt_nvdb_second(const struct fmt_nvdb_grid *grid, uint64_t v)
{
    assert(v <= grid->voxel_count);
    const uint32_t *word = grid->seconds[v / 32];
    uint32_t bit = UINT32_C(1) << (v % 32);
    uint64_t second = 1 + grid->voxel_count + word[1] + nvdb_popcount(word[0] & (bit - 1));
    return word[0] & bit && second < grid->record_count ? second : 0;
}

/* ---- names ---- */

/* A name in the file: bytes that another process may change. */
struct name {
    const uint8_t *bytes;
    uint32_t length;
};

/* Finds the name at byte *at of the section and moves *at past it. Returns false if it is cut off.
 */
static bool next_name(const struct fmt_nvdb_grid *grid, uint64_t *at, struct name *out)
{
    const uint64_t left = grid->name_bytes - *at;
    if (left < sizeof out->length)
        return false;
    memcpy(&out->length, grid->names + *at, sizeof out->length);
    if (left - sizeof out->length < out->length)
        return false;
    out->bytes = grid->names + *at + sizeof out->length;
    *at += sizeof out->length + out->length;
    return true;
}

static bool is_before(const struct name *a, const struct name *b)
{
    const uint32_t both = a->length < b->length ? a->length : b->length;
    const int order = memcmp(a->bytes, b->bytes, both);
    return order != 0 ? order < 0 : a->length < b->length;
}

bool fmt_nvdb_check_names(struct fmt_nvdb_grid *grid)
{
    struct nvdb_names_head head;
    struct name last = {0}, name;
    uint64_t at = sizeof head;
    if (grid->name_bytes < sizeof head)
        return false;
    memcpy(&head, grid->names, sizeof head);
    if (head.ids < BSQ_IDS_MATERIAL || head.ids > BSQ_IDS_COLOR ||
        (head.ids == BSQ_IDS_COLOR && head.count > 0))
        return false;
    for (uint32_t i = 0; i < head.count; i++) {
        if (!next_name(grid, &at, &name) || memchr(name.bytes, 0, name.length) ||
            (i > 0 && !is_before(&last, &name)))
            return false;
        last = name;
    }
    grid->info.ids = (enum bsq_ids)head.ids;
    return at == grid->name_bytes;
}

int fmt_nvdb_read_names(struct bsq_ctx *ctx, const struct fmt_nvdb_grid *grid,
                        int (*fn)(void *arg, const char *name), void *arg)
{
    struct name name;
    int status = 0;
    for (uint64_t at = sizeof(struct nvdb_names_head); at < grid->name_bytes && status == 0;) {
        char *text;
        if (!next_name(grid, &at, &name))
            return bsq_fail(ctx, BSQ_EIO, "%s: was changed while it was read", grid->map.path);
        status = bsq_alloc(ctx, "name of an id", (uint64_t)name.length + 1, 1, &text);
        if (status)
            return status;
        memcpy(text, name.bytes, name.length);
        text[name.length] = '\0';
        status = fn(arg, text);
        bsq_free(ctx, text);
    }
    return status;
}
