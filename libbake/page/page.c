/* page.c - puts a page together: the frame, three.js, items as they come, figures, and the script.
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <unistd.h>

#include "formats/image/image_writer.h"
#include "formats/program/program.h"
#include "libbake/page/items.h"

/* Where Debian's package libjs-three is installed, and its parts that a page needs. */
#define THREE  "/usr/share/javascript/three/build/three.min.js"
#define LOADER "/usr/share/javascript/three/examples/js/loaders/GLTFLoader.js"

static int page_put(struct bake_page *page, const char *text)
{
    return bsq_output_write(page->output, text, strlen(text));
}

/* Puts JSON, whose texts could otherwise end the script that it is in. */
static int put_json(struct bake_page *page, const char *text)
{
    int status = 0;
    for (size_t length; *text && status == 0; text += length) {
        length = *text == '<' ? 1 : strcspn(text, "<");
        status =
            *text == '<' ? page_put(page, "\\u003c") : bsq_output_write(page->output, text, length);
    }
    return status;
}

/* Puts a file between two texts. */
static int put_file(struct bake_page *page, const char *before, const char *path, const char *after)
{
    struct bsq_file file = BSQ_FILE_CLOSED;
    char *text = NULL;
    int status;
    BSQ_TRY(bsq_file_open(page->ctx, path, &file));
    BSQ_TRY(bsq_alloc(page->ctx, "page", file.size, 1, &text));
    BSQ_TRY(bsq_file_read(page->ctx, &file, text, file.size, 0));
    BSQ_TRY(page_put(page, before));
    BSQ_TRY(bsq_output_write(page->output, text, file.size));
    status = page_put(page, after);
done:
    bsq_free(page->ctx, text);
    bsq_file_close(page->ctx, &file);
    return status;
}

int bake_page_open(struct bsq_ctx *ctx, const char *path, struct bake_page **out)
{
    struct bake_page *page = NULL;
    const size_t length = strlen(path);
    char frame[PATH_MAX];
    int status;
    *out = NULL;
    if (length < 5 || strcasecmp(path + length - 5, ".html") != 0)
        return bsq_fail(ctx, BSQ_EUSAGE, "%s: the report is a page: its name must end in .html",
                        path);
    BSQ_TRY(BSQ_CALLOC(ctx, "page", 1, &page));
    page->ctx = ctx;
    page->path = path;
    BSQ_TRY(fmt_program_find(ctx, "../../share/bisque/report.html", "reports", frame));
    BSQ_TRY(bsq_output_open(ctx, path, &page->output));
    BSQ_TRY(put_file(page, "", frame, ""));
    if (access(THREE, R_OK) == 0 && access(LOADER, R_OK) == 0) {
        BSQ_TRY(put_file(page, "<script>\n", THREE, "</script>\n"));
        BSQ_TRY(put_file(page, "<script>\n", LOADER, "</script>\n"));
    }
    *out = page;
    page = NULL;
done:
    bake_page_close(page);
    return status;
}

/* Puts a file as base64 (RFC 4648). */
static int put_base64(struct bake_page *page, const struct bsq_file *file)
{
    static const char digits[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    unsigned char in[3 * 4096];
    char out[sizeof in / 3 * 4];
    for (uint64_t at = 0; at < file->size; at += sizeof in) {
        const uint64_t left = file->size - at, size = left < sizeof in ? left : sizeof in;
        const uint64_t digit_count = (size + 2) / 3 * 4;
        memset(in, 0, sizeof in);
        BSQ_PASS(bsq_file_read(page->ctx, file, in, size, at));
        for (uint64_t i = 0; i < digit_count; i++) {
            const unsigned char *group = in + i / 4 * 3;
            const unsigned bits = (unsigned)group[0] << 16 | (unsigned)group[1] << 8 | group[2];
            out[i] = digits[bits >> (18 - 6 * (i % 4)) & 63];
            if (i > 4 * size / 3)
                out[i] = '=';
        }
        BSQ_PASS(bsq_output_write(page->output, out, digit_count));
    }
    return 0;
}

int bake_page_add(struct bake_page *page, json_t *head, struct bsq_output *output)
{
    struct bsq_file file = BSQ_FILE_CLOSED;
    char *text = head ? json_dumps(head, JSON_ENSURE_ASCII) : NULL;
    int status = 0;
    json_decref(head);
    if (!text)
        return bsq_fail(page->ctx, BSQ_ENOMEM, "%s: out of memory", page->path);
    text[strlen(text) - 1] = '\0'; /* the brace */
    BSQ_TRY(page_put(page, "<script type=\"application/json\" class=\"item\">"));
    BSQ_TRY(put_json(page, text));
    BSQ_TRY(page_put(page, ", \"data\": \""));
    BSQ_TRY(bsq_output_read(output, &file));
    BSQ_TRY(put_base64(page, &file));
    status = page_put(page, "\"}</script>\n");
done:
    free(text);
    bsq_file_close(page->ctx, &file);
    return status;
}

/* ---- pictures ---- */

enum { LARGEST_SIDE = 1024 };

int bake_page_begin_picture(struct bsq_ctx *ctx, uint32_t width, uint32_t height,
                            struct bake_page_picture *out)
{
    const uint32_t side = bake_thumbnail_side(LARGEST_SIDE, bsq_memory_left(ctx) / 16);
    for (int k = 0; k < 3; k++) {
        out->low[k] = INFINITY;
        out->high[k] = -INFINITY;
    }
    return bake_thumbnail_create(ctx, width, height, side, &out->texels);
}

int bake_page_take_rows(struct bsq_ctx *ctx, struct bake_page_picture *picture, uint32_t channels,
                        uint32_t first_row, uint32_t rows, const float *samples)
{
    const uint64_t texels = (uint64_t)rows * picture->texels.full_width;
    for (uint64_t i = 0; i < texels; i++)
        for (uint32_t k = 0; k < 3; k++) {
            const float value = samples[i * channels + (channels >= 3 ? k : 0)];
            if (isfinite(value)) {
                picture->low[k] = fminf(picture->low[k], value);
                picture->high[k] = fmaxf(picture->high[k], value);
            }
        }
    return bake_thumbnail_add(ctx, &picture->texels, channels, first_row, rows, samples);
}

/* Maps the range of each channel to 0 to 1, unless it lies in there. What is not finite is 0. */
static void page_normalise(struct bake_page_picture *picture)
{
    const uint64_t texels = (uint64_t)picture->texels.width * picture->texels.height;
    for (int k = 0; k < 3; k++) {
        float *low = &picture->low[k], *high = &picture->high[k];
        if (picture->color || (*low >= 0 && *high <= 1)) {
            *low = 0;
            *high = 1;
        }
        const float scale = *high > *low ? 1 / (*high - *low) : 0;
        for (uint64_t i = 0; i < texels; i++) {
            float *texel = &picture->texels.texels[i][k];
            *texel = isfinite(*texel) ? (*texel - *low) * scale : 0;
        }
    }
}

int bake_page_add_picture(struct bake_page *page, json_t *head, struct bake_page_picture *picture)
{
    const struct bake_thumbnail *texels = &picture->texels;
    const struct fmt_image_options options = {.width = texels->width,
                                              .height = texels->height,
                                              .channel_count = 3,
                                              .type = FMT_UINT8,
                                              .color = picture->color,
                                              .rounded = true,
                                              .temporary = true};
    struct fmt_image_writer *writer = NULL;
    struct bsq_output *output = NULL;
    int status;
    float *low = picture->low, *high = picture->high;
    for (int k = 0; k < 3; k++)
        if (!(low[k] <= high[k])) /* no value is finite */
            low[k] = high[k] = 0;
    json_object_set_new(
        head, "range",
        json_pack("[[f,f],[f,f],[f,f]]", low[0], high[0], low[1], high[1], low[2], high[2]));
    page_normalise(picture);
    BSQ_TRY(fmt_image_create(page->ctx, &fmt_png_format, page->path, &options, &writer));
    BSQ_TRY(fmt_image_write_rows(writer, texels->texels[0], texels->height));
    status = fmt_image_hand_over(writer, &output);
    writer = NULL;
    if (status == 0)
        status = bake_page_add(page, json_incref(head), output);
done:
    fmt_image_discard(writer);
    bsq_output_discard(output);
    json_decref(head);
    return status;
}

/* ---- rows of a bake ---- */

int bake_page_take(void *user, const struct bake_rows *rows)
{
    struct bake_page *page = user;
    struct bake_page_picture *picture = page->pictures;
    int status;
    while (picture && strcmp(picture->path, rows->path) != 0)
        picture = picture->next;
    if (!picture) {
        BSQ_TRY(BSQ_CALLOC(page->ctx, "page", 1, &picture));
        picture->next = page->pictures;
        page->pictures = picture;
        picture->path = rows->path;
        picture->color = rows->light;
        BSQ_TRY(bake_page_begin_picture(page->ctx, rows->width, rows->height, picture));
    }
    BSQ_TRY(bake_page_take_rows(page->ctx, picture, rows->channels, rows->first, rows->count,
                                rows->samples));
    if (rows->first + rows->count < rows->height)
        return 0;
    char *path = bsq_escape(rows->path, true);
    json_t *head = json_pack("{s:s, s:s, s:s, s:i, s:i, s:i}", "kind", "map", "name", rows->map,
                             "path", path ? path : "", "width", (int)rows->width, "height",
                             (int)rows->height, "channels", (int)rows->channels);
    free(path);
    status = bake_page_add_picture(page, head, picture);
    bake_thumbnail_free(page->ctx, &picture->texels);
done:
    return status;
}

int bake_page_finish(struct bake_page *page, const char *json)
{
    char script[PATH_MAX];
    BSQ_PASS(page_put(page, "<script type=\"application/json\" id=\"data\">"));
    BSQ_PASS(put_json(page, json));
    BSQ_PASS(page_put(page, "</script>\n"));
    BSQ_PASS(fmt_program_find(page->ctx, "../../share/bisque/report.js", "reports", script));
    BSQ_PASS(put_file(page, "<script>\n", script, "</script>\n"));
    struct bsq_output *output = page->output;
    page->output = NULL;
    return bsq_output_commit(output);
}

void bake_page_close(struct bake_page *page)
{
    if (!page)
        return;
    for (struct bake_page_picture *picture; (picture = page->pictures);
         bsq_free(page->ctx, picture)) {
        page->pictures = picture->next;
        bake_thumbnail_free(page->ctx, &picture->texels);
    }
    bsq_output_discard(page->output);
    bsq_free(page->ctx, page);
}
