/* obj_sample.c - estimates the size and layout of a scan from samples of its text. */
#include "formats/mesh/obj_internal.h"
#include "formats/mesh/obj_number.h"

#include <string.h>

enum { SAMPLES = 32, SAMPLE_BYTES = 8192 };

/* Counts over the samples of one file. Lines that a sample cuts off at its ends are left out. */
struct counts {
    uint64_t bytes, vertices, texcoords, normals, faces, corners;
    bool colors, face_seen, element_follows_face;
};

/* Returns the number of words in text[0..end). */
static uint64_t count_words(const char *text, const char *end)
{
    uint64_t words = 0;
    bool inside = false;
    for (; text < end; text++) {
        bool blank = *text == ' ' || *text == '\t' || *text == '\r';
        words += !blank && !inside;
        inside = !blank;
    }
    return words;
}

static void count_line(struct counts *counts, const char *text, const char *end)
{
    uint64_t words = count_words(text, end);
    counts->bytes += (uint64_t)(end - text) + 1;
    if (words < 2)
        return;
    if (text[0] == 'f' && words >= 4) {
        counts->faces++;
        counts->corners += words - 1;
        counts->face_seen = true;
    } else if (text[0] == '#' && end - text > 6 && !memcmp(text, "#MRGB ", 6)) {
        counts->element_follows_face |= counts->face_seen;
        counts->colors = true;
    } else if (text[0] == 'v') {
        counts->element_follows_face |= counts->face_seen;
        counts->texcoords += text[1] == 't';
        counts->normals += text[1] == 'n';
        counts->vertices += text[1] == ' ' || text[1] == '\t';
        counts->colors |= words >= 7 && text[1] != 't' && text[1] != 'n';
    }
}

static void count_sample(struct counts *counts, const char *text, uint64_t size, bool at_start)
{
    const char *p = text, *limit = text + size, *end;
    if (!at_start && (p = memchr(text, '\n', size)) != NULL)
        p++;
    for (; p && (end = memchr(p, '\n', (size_t)(limit - p))) != NULL; p = end + 1)
        count_line(counts, p, end);
}

/* Samples a plain file all over. */
static int sample_file(struct fmt_input *input, struct counts *counts)
{
    const uint64_t size = fmt_input_size(input);
    int status = fmt_input_open(input);
    if (status < 0)
        return status;
    uint64_t step = size / SAMPLES > SAMPLE_BYTES ? size / SAMPLES : SAMPLE_BYTES;
    for (uint64_t offset = 0; status == 0 && offset < size; offset += step) {
        char text[SAMPLE_BYTES + OBJ_TEXT_PADDING];
        uint64_t got;
        status = fmt_input_read_some(input, text, SAMPLE_BYTES, offset, &got);
        if (status == 0)
            count_sample(counts, text, got, offset == 0);
    }
    int closed = fmt_input_close(input);
    return status ? status : closed;
}

/* Samples the start of a packed file or a pipe. In most scans it has only vertices; then the faces
 * are taken for two triangles a vertex, as closed surfaces have. */
static int sample_start(struct bsq_ctx *ctx, struct fmt_input *input, struct counts *counts)
{
    char *text;
    uint64_t got = 0;
    int status = bsq_alloc(ctx, "sample", FMT_INPUT_SAMPLE_BYTES + OBJ_TEXT_PADDING, 1, &text);
    if (status == 0)
        status = fmt_input_peek(input, text, FMT_INPUT_SAMPLE_BYTES, &got);
    if (status == 0)
        count_sample(counts, text, got, true);
    bsq_free(ctx, text);
    if (counts->faces == 0 && got == FMT_INPUT_SAMPLE_BYTES) {
        const uint64_t bytes_of_face = 24;
        counts->faces = 2 * counts->vertices;
        counts->corners = 3 * counts->faces;
        counts->bytes += counts->faces * bytes_of_face;
    }
    return status;
}

int fmt_obj_estimate(const struct stream_source *source, uint64_t bytes, bool plain,
                     struct fmt_mesh_estimate *out)
{
    struct counts counts = {0};
    int status = plain ? sample_file(source->input, &counts)
                       : sample_start(source->ctx, source->input, &counts);
    double scale = counts.bytes > 0 ? (double)bytes / (double)counts.bytes : 0.0;
    out->vertices += (uint64_t)(scale * (double)counts.vertices);
    out->texcoords += (uint64_t)(scale * (double)counts.texcoords);
    out->normals += (uint64_t)(scale * (double)counts.normals);
    out->faces += (uint64_t)(scale * (double)counts.faces);
    out->corners += (uint64_t)(scale * (double)counts.corners);
    out->has_colors |= counts.colors;
    out->faces_come_last &= !counts.element_follows_face;
    return status;
}
