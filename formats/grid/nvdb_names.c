/* nvdb_names.c - the section of names that ids stand for: a sorted table without repetitions. */
#include <string.h>

#include "formats/grid/nvdb_writer_internal.h"

/* ---- writing ---- */

int fmt_nvdb_set_names(struct fmt_nvdb_writer *writer, const char *const *names, uint64_t count)
{
    const struct nvdb_names_head head = {writer->info.ids, (uint32_t)count};
    uint64_t bytes = sizeof head;
    if (writer->info.ids == BSQ_IDS_NONE)
        return 0;
    for (uint64_t i = 0; i < count; i++)
        bytes += sizeof(uint32_t) + strlen(names[i]);
    if (bytes > UINT32_MAX)
        return bsq_fail(writer->ctx, BSQ_EUSAGE, "%s: the names of ids have 4 GiB", writer->path);
    bsq_free(writer->ctx, writer->names);
    writer->names = NULL;
    int status = bsq_alloc(writer->ctx, "names of ids", bytes, 1, &writer->names);
    if (status)
        return status;
    uint8_t *to = writer->names;
    memcpy(to, &head, sizeof head);
    to += sizeof head;
    for (uint64_t i = 0; i < count; i++) {
        const uint32_t length = (uint32_t)strlen(names[i]);
        memcpy(to, &length, sizeof length);
        memcpy(to + sizeof length, names[i], length);
        to += sizeof length + length;
    }
    writer->counts.name_bytes = bytes;
    return 0;
}

/* ---- reading ---- */

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
