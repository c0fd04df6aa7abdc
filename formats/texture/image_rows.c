/* image_rows.c - recognises images by their content, and opens the decoder of their format.
 *
 * A file's first bytes choose a row of the table. OpenImageIO opens many more files, among them
 * videos, streams from the network and plain text; it sees none of them. Some of its plug-ins
 * decode the whole image when they open a file, so the memory for that is found from the header
 * here. The factors were measured with OpenImageIO 2.4.7 (docs/decisions/0035). */
#include "formats/texture/image_rows.h"

#include <inttypes.h>
#include <string.h>
#include "base/bytes.h"

/* An image in an open file, and its first bytes; zeros follow after a short image. */
struct probe {
    struct bsq_ctx *ctx;
    const struct bsq_file *file;
    const struct bsq_part *part; /* of the file: only this is looked at */
    int status;                  /* of the first read that failed, or 0 */
    uint8_t head[64];
};

/* An image that is decoded whole: its size in texels (0: unknown), and the bytes that this takes.
 */
struct whole {
    uint64_t width, height, bytes;
};

struct format {
    const char *name; /* for messages */
    const struct fmt_rows_decoder *decoder;
    const char *program, *plugin; /* if another program decodes it; OpenImageIO's name */
    bool (*recognise)(struct probe *probe);
    struct whole (*whole)(struct probe *probe); /* NULL: the decoder tells */
};

static uint32_t big16(const uint8_t *p)
{
    return (uint32_t)p[0] << 8 | p[1];
}

static uint32_t big32(const uint8_t *p)
{
    return big16(p) << 16 | big16(p + 2);
}

/* Reads `size` bytes; zeros follow after the end of the file. */
static void read_at(struct probe *probe, uint64_t offset, uint8_t *to, uint64_t size)
{
    const uint64_t left = probe->part->size > offset ? probe->part->size - offset : 0;
    memset(to, 0, size);
    size = size < left ? size : left;
    const int status = bsq_part_read(probe->ctx, probe->file, probe->part, to, size, offset);
    probe->status = probe->status < 0 ? probe->status : status;
}

static bool begins(struct probe *probe, const char *magic, size_t size)
{
    return memcmp(probe->head, magic, size) == 0;
}

static struct whole by_texels(uint64_t width, uint64_t height, uint64_t texel_bytes)
{
    struct whole out = {width, height, 0};
    if (__builtin_mul_overflow(width, height, &out.bytes) ||
        __builtin_mul_overflow(out.bytes, texel_bytes, &out.bytes))
        out.bytes = UINT64_MAX;
    return out;
}

/* ---- formats ---- */

static bool is_png(struct probe *probe)
{
    return begins(probe, "\x89PNG\r\n\x1a\n", 8);
}

static bool is_jpeg(struct probe *probe)
{
    return begins(probe, "\xff\xd8\xff", 3);
}

static bool is_tiff(struct probe *probe)
{
    return begins(probe, "II*\0", 4) || begins(probe, "MM\0*", 4) || begins(probe, "II+\0", 4) ||
           begins(probe, "MM\0+", 4);
}

static bool is_exr(struct probe *probe)
{
    return begins(probe, "\x76\x2f\x31\x01", 4);
}

static bool is_jpeg2000(struct probe *probe)
{
    return begins(probe, "\0\0\0\x0cjP  \r\n\x87\n", 12) || begins(probe, "\xff\x4f\xff\x51", 4);
}

/* Returns where the code stream begins (ISO/IEC 15444-1, Annex I), or the end of the file. */
static uint64_t find_codestream(struct probe *probe)
{
    const uint64_t end = probe->part->size;
    uint64_t offset = probe->head[0] == 0xff ? 0 : 12;
    while (offset > 0 && offset < end) {
        uint8_t box[16];
        read_at(probe, offset, box, sizeof box);
        uint64_t size = big32(box);
        const uint64_t header = size == 1 ? 16 : 8;
        if (memcmp(box + 4, "jp2c", 4) == 0)
            return offset + header;
        if (size == 1)
            size = (uint64_t)big32(box + 8) << 32 | big32(box + 12);
        if (size < header || size > end - offset)
            return end;
        offset += size;
    }
    return offset;
}

/* OpenJPEG decodes all samples to 4 bytes. It refuses files without a size. */
static struct whole jpeg2000_whole(struct probe *probe)
{
    uint8_t size[42];
    read_at(probe, find_codestream(probe), size, sizeof size);
    if (memcmp(size, "\xff\x4f\xff\x51", 4) != 0)
        return (struct whole){0};
    const uint32_t right = big32(size + 8), left = big32(size + 16);
    const uint32_t bottom = big32(size + 12), top = big32(size + 20);
    return by_texels(right > left ? right - left : 0, bottom > top ? bottom - top : 0,
                     5 * (uint64_t)big16(size + 40));
}

static bool is_bmp(struct probe *probe)
{
    return begins(probe, "BM", 2);
}

static struct whole bmp_whole(struct probe *probe)
{
    const uint8_t *h = probe->head;
    const bool packed =
        bsq_little(h + 14, 4) >= 40 && (bsq_little(h + 30, 4) == 1 || bsq_little(h + 30, 4) == 2);
    uint64_t height = bsq_little(h + 22, 4);
    if (height > INT32_MAX) /* the rows are stored from the top */
        height = (UINT64_C(1) << 32) - height;
    return by_texels(bsq_little(h + 18, 4), height, packed ? 4 : 0);
}

static bool is_hdr(struct probe *probe)
{
    return begins(probe, "#?RADIANCE", 10) || begins(probe, "#?RGBE", 6);
}

static bool is_pnm(struct probe *probe)
{
    const uint8_t *h = probe->head;
    const bool kind = (h[1] >= '1' && h[1] <= '6') || h[1] == 'F' || h[1] == 'f';
    return h[0] == 'P' && kind && (h[2] == ' ' || (h[2] >= '\t' && h[2] <= '\r') || h[2] == '#');
}

static struct whole pnm_whole(struct probe *probe)
{
    return (struct whole){0, 0, probe->part->size};
}

static bool is_webp(struct probe *probe)
{
    return begins(probe, "RIFF", 4) && memcmp(probe->head + 8, "WEBP", 4) == 0;
}

static struct whole webp_whole(struct probe *probe)
{
    const uint8_t *h = probe->head;
    uint64_t width = bsq_little(h + 26, 2) & 0x3fff, height = bsq_little(h + 28, 2) & 0x3fff;
    if (memcmp(h + 12, "VP8X", 4) == 0) {
        width = bsq_little(h + 24, 3) + 1;
        height = bsq_little(h + 27, 3) + 1;
    } else if (memcmp(h + 12, "VP8L", 4) == 0) {
        width = (bsq_little(h + 21, 4) & 0x3fff) + 1;
        height = (bsq_little(h + 21, 4) >> 14 & 0x3fff) + 1;
    }
    struct whole whole = by_texels(width, height, 4);
    whole.bytes += probe->part->size;
    return whole;
}

/* Only version 2 has a mark, at the file's end. The header of version 1 has few values that are
 * possible. */
static bool is_targa(struct probe *probe)
{
    static const char mark[] = "TRUEVISION-XFILE.";
    const uint8_t *h = probe->head;
    uint8_t end[sizeof mark] = {0};
    if (probe->part->size >= 44)
        read_at(probe, probe->part->size - sizeof mark, end, sizeof end);
    const bool type = (h[2] >= 1 && h[2] <= 3) || (h[2] >= 9 && h[2] <= 11);
    const bool bits = h[16] == 8 || h[16] == 15 || h[16] == 16 || h[16] == 24 || h[16] == 32;
    const bool possible =
        h[1] <= 1 && type && bits && bsq_little(h + 12, 2) > 0 && bsq_little(h + 14, 2) > 0;
    return possible && (memcmp(end, mark, sizeof mark) == 0 || !(h[17] & 0xc0));
}

static struct whole targa_whole(struct probe *probe)
{
    return by_texels(bsq_little(probe->head + 12, 2), bsq_little(probe->head + 14, 2), 4);
}

static const char no_format[] =
    "it is no PNG, JPEG, TIFF, OpenEXR, JPEG 2000, WebP, BMP, Radiance HDR, PNM or TGA";

static const char oiio[] = "bisque-texture";

/* OpenEXR files that OpenEXR's C API cannot decode. */
static const struct format dwa_format = {"OpenEXR", &fmt_program_rows, oiio, "openexr", is_exr,
                                         NULL};

/* Returns the format of a file, or NULL. */
static const struct format *find_format(struct probe *probe)
{
    static const struct format formats[] = {
        {"PNG", &fmt_png_rows, NULL, NULL, is_png, NULL},
        {"JPEG", &fmt_jpeg_rows, NULL, NULL, is_jpeg, NULL},
        {"TIFF", &fmt_program_rows, "bisque-tiff", "", is_tiff, NULL},
        {"OpenEXR", &fmt_exr_texture_rows, NULL, NULL, is_exr, NULL},
        {"JPEG 2000", &fmt_program_rows, oiio, "jpeg2000", is_jpeg2000, jpeg2000_whole},
        {"WebP", &fmt_program_rows, oiio, "webp", is_webp, webp_whole},
        {"BMP", &fmt_program_rows, oiio, "bmp", is_bmp, bmp_whole},
        {"Radiance HDR", &fmt_program_rows, oiio, "hdr", is_hdr, NULL},
        {"PNM", &fmt_program_rows, oiio, "pnm", is_pnm, pnm_whole},
        {"TGA", &fmt_program_rows, oiio, "targa", is_targa,
         targa_whole}, /* matches loosely: last */
    };
    for (size_t i = 0; i < sizeof formats / sizeof *formats; i++)
        if (formats[i].recognise(probe))
            return &formats[i];
    return NULL;
}

/* ---- opening ---- */

int fmt_rows_unreadable(const struct fmt_rows_input *input, const char *reason)
{
    return input->status < 0 ? input->status
                             : bsq_fail(input->ctx, BSQ_EDATA, "%s: not a readable image: %s",
                                        input->path, reason);
}

int fmt_rows_damaged(const struct fmt_rows_input *input, const char *reason)
{
    return input->status < 0
               ? input->status
               : bsq_fail(input->ctx, BSQ_EDATA, "%s: damaged image: %s", input->path, reason);
}

static ssize_t read_stream(void *cookie, char *to, size_t size)
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
static int reserve(struct fmt_rows *rows, const struct format *format, struct whole need)
{
    struct bsq_ctx *ctx = rows->input.ctx;
    const uint64_t left = bsq_memory_left(ctx);
    char size[64] = "image needs";
    int status;
    if (need.bytes > left) {
        if (need.width > 0)
            snprintf(size, sizeof size, "%" PRIu64 " x %" PRIu64 " texels need", need.width,
                     need.height);
        return bsq_fail(ctx, BSQ_ENOMEM,
                        "%s: this kind of %s file is decoded whole; its %s %" PRIu64
                        " MiB of memory, %" PRIu64 " MiB are left: convert it to tiled TIFF "
                        "(oiiotool IN --tile 64 64 -o OUT.tif)",
                        rows->input.path, format->name, size, (need.bytes >> 20) + 1, left >> 20);
    }
    BSQ_TRY(bsq_reserve(ctx, "decoding a texture", need.bytes));
    rows->reserved_bytes += need.bytes;
done:
    return status;
}

static int open_decoder(struct fmt_rows *rows, const struct format *format, struct whole whole)
{
    struct bsq_ctx *ctx = rows->input.ctx;
    const struct fmt_rows_info *info = &rows->info;
    int status;
    BSQ_TRY(reserve(rows, format, whole));
    rows->input.whole_bytes = whole.bytes;
    rows->input.program = format->program;
    rows->input.plugin = format->plugin;
    rows->decoder = format->decoder;
    if (!format->program) {
        rows->input.stream =
            fopencookie(&rows->input, "r", (cookie_io_functions_t){.read = read_stream});
        if (!rows->input.stream)
            return bsq_fail(ctx, BSQ_ENOMEM, "%s: out of memory", rows->input.path);
    }
    BSQ_TRY(rows->decoder->open(&rows->input, &rows->info, &rows->state));
    if (info->width < 1 || info->height < 1 || info->channels < 1)
        return fmt_rows_unreadable(&rows->input, "it has no texels");
    BSQ_TRY(info->whole
                ? reserve(rows, format, (struct whole){info->width, info->height, info->bytes})
                : bsq_reserve(ctx, "decoding a texture", info->bytes));
    rows->reserved_bytes += info->whole ? 0 : info->bytes;
done:
    return status;
}

/* Replaces the file by a copy of the part that is the image, unless that is all of it. */
static int extract(struct fmt_rows *rows, const struct bsq_part *part)
{
    struct bsq_file whole = rows->input.file;
    if (part->offset == 0 && part->size == whole.size && !part->base64)
        return 0;
    const int status = bsq_part_extract(rows->input.ctx, &whole, part, &rows->input.file);
    bsq_file_close(rows->input.ctx, &whole);
    return status;
}

int fmt_rows_open(struct bsq_ctx *ctx, const char *path, struct fmt_rows *rows)
{
    struct bsq_part part;
    struct probe probe = {.ctx = ctx, .file = &rows->input.file, .part = &part};
    int status;
    *rows = (struct fmt_rows){.input = {.ctx = ctx, .path = path, .file = BSQ_FILE_CLOSED}};
    BSQ_TRY(bsq_part_open(ctx, path, &part, &rows->input.file));
    read_at(&probe, 0, probe.head, sizeof probe.head);
    const struct format *format = find_format(&probe);
    const struct whole whole =
        format && format->whole ? format->whole(&probe) : (struct whole){0, 0, 0};
    BSQ_TRY(probe.status);
    if (format) /* what is no image is not copied: it may be large */
        BSQ_TRY(extract(rows, &part));
    if (!format)
        return fmt_rows_unreadable(&rows->input, no_format);
    status = open_decoder(rows, format, whole);
    if (status == BSQ_RETRY) {
        rows->decoder->close(rows->state);
        rows->state = NULL;
        status = open_decoder(rows, &dwa_format, whole);
    }
done:
    return status;
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
