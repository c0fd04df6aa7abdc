/* image_rows.c - recognises images by their content, and opens the decoder of their format.
 *
 * A file's first bytes choose a row of the table. OpenImageIO opens many more files, among them
 * videos, streams from the network and plain text; it sees none of them. Some of its plug-ins
 * decode the whole image when they open a file (docs/decisions/0035): memory for that is reserved
 * before, and the program gets no more. */
#include "formats/texture/image_rows.h"

#include <inttypes.h>
#include <string.h>
#include "base/bytes.h"

/* An image in an open file, and its first bytes; zeros follow after a short image. */
struct probe {
    struct bsq_ctx *ctx;
    const struct bsq_file *file;
    const struct fmt_extent *extent; /* of the file: only this is looked at */
    int status;                      /* of the first read that failed, or 0 */
    uint8_t head[64];
};

struct format {
    const char *name; /* for messages */
    const struct fmt_rows_decoder *decoder;
    const char *program, *plugin; /* if another program decodes it; OpenImageIO's name */
    /* Its first bytes; or else the function tells. */
    struct {
        unsigned size;
        const char *bytes;
    } magics[4];
    bool (*recognise)(struct probe *probe);
};

/* Reads `size` bytes; zeros follow after the end of the file. */
static void rows_read_at(struct probe *probe, uint64_t offset, uint8_t *to, uint64_t size)
{
    const uint64_t left = probe->extent->size > offset ? probe->extent->size - offset : 0;
    memset(to, 0, size);
    size = size < left ? size : left;
    const int status = fmt_extent_read(probe->ctx, probe->file, probe->extent, to, size, offset);
    probe->status = probe->status < 0 ? probe->status : status;
}

/* ---- formats ---- */

static bool is_pnm(struct probe *probe)
{
    const uint8_t *h = probe->head;
    const bool kind = (h[1] >= '1' && h[1] <= '6') || h[1] == 'F' || h[1] == 'f';
    return h[0] == 'P' && kind && (h[2] == ' ' || (h[2] >= '\t' && h[2] <= '\r') || h[2] == '#');
}

static bool is_webp(struct probe *probe)
{
    return memcmp(probe->head, "RIFF", 4) == 0 && memcmp(probe->head + 8, "WEBP", 4) == 0;
}

/* Only version 2 has a mark, at the file's end. The header of version 1 has few values that are
 * possible. */
static bool is_targa(struct probe *probe)
{
    static const char mark[] = "TRUEVISION-XFILE.";
    const uint8_t *h = probe->head;
    uint8_t end[sizeof mark] = {0};
    if (probe->extent->size >= 44)
        rows_read_at(probe, probe->extent->size - sizeof mark, end, sizeof end);
    const bool type = (h[2] >= 1 && h[2] <= 3) || (h[2] >= 9 && h[2] <= 11);
    const bool bits = h[16] == 8 || h[16] == 15 || h[16] == 16 || h[16] == 24 || h[16] == 32;
    const bool possible =
        h[1] <= 1 && type && bits && bsq_little(h + 12, 2) > 0 && bsq_little(h + 14, 2) > 0;
    return possible && (memcmp(end, mark, sizeof mark) == 0 || !(h[17] & 0xc0));
}

static const char no_format[] =
    "it is no PNG, JPEG, TIFF, OpenEXR, JPEG 2000, WebP, BMP, Radiance HDR, PNM or TGA";

static const char oiio[] = "bisque-texture";

/* OpenEXR files that OpenEXR's C API cannot decode. */
static const struct format dwa_format = {"OpenEXR", &fmt_program_rows, oiio, "openexr", {{0}},
                                         NULL};

static bool has_first_bytes(const struct format *format, struct probe *probe)
{
    bool any = format->recognise && format->recognise(probe);
    for (int i = 0; i < 4 && format->magics[i].size > 0; i++)
        any |= memcmp(probe->head, format->magics[i].bytes, format->magics[i].size) == 0;
    return any;
}

/* Returns the format of a file, or NULL. */
static const struct format *find_format(struct probe *probe)
{
#define OIIO &fmt_program_rows, oiio
    static const struct format formats[] = {
        {"PNG", &fmt_png_rows, NULL, NULL, {{8, "\x89PNG\r\n\x1a\n"}}, NULL},
        {"JPEG", &fmt_jpeg_rows, NULL, NULL, {{3, "\xff\xd8\xff"}}, NULL},
        {"TIFF",
         &fmt_program_rows,
         "bisque-tiff",
         "",
         {{4, "II*\0"}, {4, "MM\0*"}, {4, "II+\0"}, {4, "MM\0+"}},
         NULL},
        {"OpenEXR", &fmt_exr_texture_rows, NULL, NULL, {{4, "\x76\x2f\x31\x01"}}, NULL},
        {"JPEG 2000",
         OIIO,
         "jpeg2000",
         {{12, "\0\0\0\x0cjP  \r\n\x87\n"}, {4, "\xff\x4f\xff\x51"}},
         NULL},
        {"WebP", OIIO, "webp", {{0}}, is_webp},
        {"BMP", OIIO, "bmp", {{2, "BM"}}, NULL},
        {"Radiance HDR", OIIO, "hdr", {{10, "#?RADIANCE"}, {6, "#?RGBE"}}, NULL},
        {"PNM", OIIO, "pnm", {{0}}, is_pnm},
        {"TGA", OIIO, "targa", {{0}}, is_targa}, /* matches loosely: last */
    };
    for (size_t i = 0; i < sizeof formats / sizeof *formats; i++)
        if (has_first_bytes(&formats[i], probe))
            return &formats[i];
    return NULL;
}

/* ---- opening ---- */

int fmt_rows_fail(const struct fmt_rows_input *input, const char *what, const char *reason)
{
    return input->status < 0
               ? input->status
               : bsq_fail(input->ctx, BSQ_EDATA, "%s: %s: %s", input->path, what, reason);
}

static ssize_t rows_read_stream(void *cookie, char *to, size_t size)
{
    struct fmt_rows_input *input = cookie;
    uint64_t got = 0;
    const int status = bsq_file_read_some(input->ctx, &input->file, to, size, input->offset, &got);
    input->offset += got;
    if (status < 0)
        input->status = status;
    return status < 0 ? -1 : (ssize_t)got;
}

/* Reserves memory for decoding. */
static int rows_reserve(struct fmt_rows *rows, uint64_t bytes)
{
    const int status = bsq_reserve(rows->input.ctx, "decoding a texture", bytes);
    rows->reserved_bytes += status == 0 ? bytes : 0;
    return status;
}

/* Reserves memory for an image that a library here decodes whole. */
static int reserve_whole(struct fmt_rows *rows, const char *format)
{
    const struct fmt_rows_info *info = &rows->info;
    const uint64_t left = bsq_memory_left(rows->input.ctx);
    if (info->bytes > left)
        return bsq_fail(rows->input.ctx, BSQ_ENOMEM,
                        "%s: this kind of %s file is decoded whole; its %u x %u texels need "
                        "%" PRIu64 " MiB of memory, %" PRIu64 " MiB are left: convert it to tiled "
                        "TIFF (oiiotool IN --tile 64 64 -o OUT.tif)",
                        rows->input.path, format, info->width, info->height,
                        (info->bytes >> 20) + 1, left >> 20);
    return rows_reserve(rows, info->bytes);
}

static int open_decoder(struct fmt_rows *rows, const struct format *format, unsigned sharers)
{
    struct bsq_ctx *ctx = rows->input.ctx;
    const struct fmt_rows_info *info = &rows->info;
    rows->input.program = format->program;
    rows->input.plugin = format->plugin;
    rows->input.sharers = sharers;
    rows->decoder = format->decoder;
    if (!format->program) {
        rows->input.stream =
            fopencookie(&rows->input, "r", (cookie_io_functions_t){.read = rows_read_stream});
        if (!rows->input.stream)
            return bsq_fail(ctx, BSQ_ENOMEM, "%s: out of memory", rows->input.path);
    }
    BSQ_PASS(rows->decoder->open(&rows->input, &rows->info, &rows->state));
    if (info->width < 1 || info->height < 1 || info->channels < 1)
        return fmt_rows_fail(&rows->input, FMT_ROWS_UNREADABLE, "it has no texels");
    return info->whole ? reserve_whole(rows, format->name) : rows_reserve(rows, info->bytes);
}

/* Replaces the file by a copy of the extent that is the image, unless that is all of it. */
static int extract(struct fmt_rows *rows, const struct fmt_extent *extent)
{
    struct bsq_file whole = rows->input.file;
    if (extent->offset == 0 && extent->size == whole.size && !extent->base64)
        return 0;
    const int status = fmt_extent_extract(rows->input.ctx, &whole, extent, &rows->input.file);
    bsq_file_close(rows->input.ctx, &whole);
    return status;
}

int fmt_rows_open(struct bsq_ctx *ctx, const char *path, unsigned sharers, struct fmt_rows *rows)
{
    struct fmt_extent extent;
    struct probe probe = {.ctx = ctx, .file = &rows->input.file, .extent = &extent};
    *rows = (struct fmt_rows){.input = {.ctx = ctx, .path = path, .file = BSQ_FILE_CLOSED}};
    BSQ_PASS(fmt_extent_open(ctx, path, &extent, &rows->input.file));
    rows_read_at(&probe, 0, probe.head, sizeof probe.head);
    const struct format *format = find_format(&probe);
    BSQ_PASS(probe.status);
    if (format) /* what is no image is not copied: it may be large */
        BSQ_PASS(extract(rows, &extent));
    if (!format)
        return fmt_rows_fail(&rows->input, FMT_ROWS_UNREADABLE, no_format);
    const int status = open_decoder(rows, format, sharers);
    if (status != BSQ_RETRY)
        return status;
    rows->decoder->close(rows->state);
    rows->state = NULL;
    return open_decoder(rows, &dwa_format, sharers);
}

void fmt_rows_close(struct fmt_rows *rows)
{
    if (!rows->input.ctx)
        return;
    if (rows->state)
        rows->decoder->close(rows->state);
    if (rows->input.stream)
        fclose(rows->input.stream);
    bsq_release(rows->input.ctx, rows->reserved_bytes);
    bsq_file_close(rows->input.ctx, &rows->input.file);
}
