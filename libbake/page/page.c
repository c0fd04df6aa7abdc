/* page.c - puts a page together: the frame, three.js, items as they come, figures, and the script.
 */
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <unistd.h>

#include "formats/program/program.h"
#include "libbake/page/items.h"

/* Where Debian's package libjs-three is installed, and its parts that a page needs. */
#define THREE  "/usr/share/javascript/three/build/three.min.js"
#define LOADER "/usr/share/javascript/three/examples/js/loaders/GLTFLoader.js"

static int put(struct bake_page *page, const char *text)
{
    return bsq_output_write(page->output, text, strlen(text));
}

/* Puts JSON, whose texts could otherwise end the script that it is in. */
static int put_json(struct bake_page *page, const char *text)
{
    int status = 0;
    for (size_t length; *text && status == 0; text += length) {
        length = *text == '<' ? 1 : strcspn(text, "<");
        status = *text == '<' ? put(page, "\\u003c") : bsq_output_write(page->output, text, length);
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
    BSQ_TRY(put(page, before));
    BSQ_TRY(bsq_output_write(page->output, text, file.size));
    status = put(page, after);
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
    BSQ_TRY(bsq_calloc(ctx, "page", 1, sizeof *page, &page));
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
    int status = 0;
    for (uint64_t at = 0; at < file->size; at += sizeof in) {
        const uint64_t left = file->size - at, size = left < sizeof in ? left : sizeof in;
        const uint64_t digit_count = (size + 2) / 3 * 4;
        memset(in, 0, sizeof in);
        BSQ_TRY(bsq_file_read(page->ctx, file, in, size, at));
        for (uint64_t i = 0; i < digit_count; i++) {
            const unsigned char *group = in + i / 4 * 3;
            const unsigned bits = (unsigned)group[0] << 16 | (unsigned)group[1] << 8 | group[2];
            out[i] = digits[bits >> (18 - 6 * (i % 4)) & 63];
            if (i > 4 * size / 3)
                out[i] = '=';
        }
        BSQ_TRY(bsq_output_write(page->output, out, digit_count));
    }
done:
    return status;
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
    BSQ_TRY(put(page, "<script type=\"application/json\" class=\"item\">"));
    BSQ_TRY(put_json(page, text));
    BSQ_TRY(put(page, ", \"data\": \""));
    BSQ_TRY(bsq_output_read(output, &file));
    BSQ_TRY(put_base64(page, &file));
    status = put(page, "\"}</script>\n");
done:
    free(text);
    bsq_file_close(page->ctx, &file);
    return status;
}

int bake_page_finish(struct bake_page *page, const char *json)
{
    char script[PATH_MAX];
    int status;
    BSQ_TRY(put(page, "<script type=\"application/json\" id=\"data\">"));
    BSQ_TRY(put_json(page, json));
    BSQ_TRY(put(page, "</script>\n"));
    BSQ_TRY(fmt_program_find(page->ctx, "../../share/bisque/report.js", "reports", script));
    BSQ_TRY(put_file(page, "<script>\n", script, "</script>\n"));
    struct bsq_output *output = page->output;
    page->output = NULL;
    status = bsq_output_commit(output);
done:
    return status;
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
