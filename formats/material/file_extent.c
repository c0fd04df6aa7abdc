/* file_extent.c - see file_extent.h. */
#include "formats/material/file_extent.h"

#include <inttypes.h>
#include <string.h>
#include <unistd.h>

#include "base/text.h"

/* ---- names ---- */

/* Reads a decimal number up to `*text`'s first other character. Returns false if there is none. */
static bool read_number(const char **text, uint64_t *out)
{
    const char *p = *text;
    *out = 0;
    for (; *p >= '0' && *p <= '9'; p++)
        if (__builtin_mul_overflow(*out, 10, out) ||
            __builtin_add_overflow(*out, (uint64_t)(*p - '0'), out))
            return false;
    bool found = p > *text;
    *text = p;
    return found;
}

/* Reads "#bytes=OFFSET+SIZE" or "#base64=OFFSET,FIRST+SIZE", up to the end of the text. */
static bool read_range(const char *text, struct fmt_extent *out)
{
    *out = (struct fmt_extent){.base64 = strncmp(text, "#base64=", 8) == 0};
    if (!out->base64 && strncmp(text, "#bytes=", 7) != 0)
        return false;
    text += out->base64 ? 8 : 7;
    if (!read_number(&text, &out->offset))
        return false;
    if (out->base64 && (*text++ != ',' || !read_number(&text, &out->first)))
        return false;
    return *text++ == '+' && read_number(&text, &out->size) && *text == '\0' &&
           out->size <= INT64_MAX / 4 && out->first <= INT64_MAX / 4 &&
           out->offset <= INT64_MAX / 4;
}

size_t fmt_extent_parse(const char *name, struct fmt_extent *out)
{
    const char *mark = strrchr(name, '#');
    if (!mark || mark == name || !read_range(mark, out) || access(name, F_OK) == 0)
        return 0;
    return (size_t)(mark - name);
}

int fmt_extent_name(struct bsq_ctx *ctx, const char *path, const struct fmt_extent *extent,
                    char **out)
{
    return extent->base64 ? bsq_text_print(ctx, out, "%s#base64=%" PRIu64 ",%" PRIu64 "+%" PRIu64,
                                           path, extent->offset, extent->first, extent->size)
                          : bsq_text_print(ctx, out, "%s#bytes=%" PRIu64 "+%" PRIu64, path,
                                           extent->offset + extent->first, extent->size);
}

/* ---- base64 ---- */

/* Returns the six bits that a character of base64 stands for, or -1. */
static int bits_of(char c)
{
    if (c >= 'A' && c <= 'Z')
        return c - 'A';
    if (c >= 'a' && c <= 'z')
        return c - 'a' + 26;
    if (c >= '0' && c <= '9')
        return c - '0' + 52;
    return c == '+' ? 62 : c == '/' ? 63 : -1;
}

/* Decodes up to four characters. Returns the number of bytes that they hold, 0 to 3. */
static unsigned decode_group(const char *text, uint64_t length, uint8_t out[3])
{
    uint32_t bits = 0;
    unsigned count = 0;
    while (count < 4 && count < length && bits_of(text[count]) >= 0)
        bits = bits << 6 | (uint32_t)bits_of(text[count++]);
    bits <<= 6 * (4 - count);
    out[0] = (uint8_t)(bits >> 16);
    out[1] = (uint8_t)(bits >> 8);
    out[2] = (uint8_t)bits;
    return count > 0 ? count - 1 : 0;
}

enum { GROUPS = 1024 }; /* decoded at a time */

/* Decodes bytes from the group that holds byte number `at` of the text on, at most `size` bytes.
 * Sets *done to their number; 0: the text has no such byte. */
static int read_groups(struct bsq_ctx *ctx, const struct bsq_file *file, uint64_t text, uint64_t at,
                       uint8_t *to, uint64_t size, uint64_t *done)
{
    char letters[4 * GROUPS];
    uint8_t bytes[3];
    uint64_t skip = at % 3, length = 0, groups = (skip + size + 2) / 3;
    if (groups > GROUPS)
        groups = GROUPS;
    *done = 0;
    BSQ_PASS(bsq_file_read_some(ctx, file, letters, 4 * groups, text + 4 * (at / 3), &length));
    for (uint64_t i = 0; i < groups && *done < size; i++) {
        uint64_t rest = length > 4 * i ? length - 4 * i : 0;
        unsigned have = decode_group(letters + 4 * i, rest, bytes);
        for (uint64_t k = skip; k < have && *done < size; k++)
            to[(*done)++] = bytes[k];
        skip = 0;
        if (have < 3)
            break;
    }
    return 0;
}

/* Reports that the group of four characters at `offset` cannot be decoded. */
static int fail_base64(struct bsq_ctx *ctx, const struct bsq_file *file, uint64_t offset)
{
    char group[4];
    uint64_t got;
    BSQ_PASS(bsq_file_read_some(ctx, file, group, sizeof group, offset, &got));
    return bsq_fail(ctx, BSQ_EDATA, "%s: byte %" PRIu64 ": %s", file->path, offset,
                    memchr(group, '\\', got) ? "escapes in base64 are not read"
                                             : "malformed base64");
}

int fmt_extent_read(struct bsq_ctx *ctx, const struct bsq_file *file,
                    const struct fmt_extent *extent, void *to, uint64_t size, uint64_t at)
{
    if (!extent->base64)
        return bsq_file_read(ctx, file, to, size, extent->offset + extent->first + at);
    uint8_t *next = to;
    at += extent->first;
    while (size > 0) {
        uint64_t done;
        BSQ_PASS(read_groups(ctx, file, extent->offset, at, next, size, &done));
        if (done == 0)
            return fail_base64(ctx, file, extent->offset + at / 3 * 4);
        next += done;
        at += done;
        size -= done;
    }
    return 0;
}

/* ---- copies ---- */

int fmt_extent_open(struct bsq_ctx *ctx, const char *name, struct fmt_extent *extent,
                    struct bsq_file *out)
{
    const size_t length = fmt_extent_parse(name, extent);
    char *path = NULL;
    if (length == 0) {
        int status = bsq_file_open(ctx, name, out);
        *extent = (struct fmt_extent){.size = out->size};
        return status;
    }
    *out = (struct bsq_file)BSQ_FILE_CLOSED;
    BSQ_PASS(bsq_text_print(ctx, &path, "%.*s", (int)length, name));
    const int status = bsq_file_open(ctx, path, out);
    bsq_free(ctx, path);
    return status;
}

int fmt_extent_extract(struct bsq_ctx *ctx, const struct bsq_file *file,
                       const struct fmt_extent *extent, struct bsq_file *out)
{
    uint8_t buffer[16384];
    int status;
    BSQ_TRY(bsq_file_temp(ctx, NULL, "an embedded image", out));
    /* An extent that claims to be larger than its file cannot be copied whole. */
    BSQ_TRY(bsq_require_disk(ctx, NULL, extent->size < file->size ? extent->size : file->size));
    for (uint64_t at = 0; at < extent->size; at += sizeof buffer) {
        uint64_t left = extent->size - at, size = left < sizeof buffer ? left : sizeof buffer;
        BSQ_TRY(bsq_check(ctx));
        BSQ_TRY(fmt_extent_read(ctx, file, extent, buffer, size, at));
        BSQ_TRY(bsq_file_append(ctx, out, buffer, size));
    }
    status = bsq_file_check(ctx, file);
done:
    if (status)
        bsq_file_close(ctx, out);
    return status;
}
