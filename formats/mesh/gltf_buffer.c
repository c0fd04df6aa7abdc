/* gltf_buffer.c - buffers, buffer views and accessors of glTF files: ranges of bytes of files, and
 * the elements in them.
 *
 * A buffer is the binary chunk of a GLB file, another file, or a data URI. None is ever held in
 * memory. */
#include <inttypes.h>
#include <string.h>
#include <sys/stat.h>

#include "formats/mesh/gltf_internal.h"
#include "formats/mesh/mesh_text.h"

/* ---- URIs ---- */

/* Decodes %XX in place. A zero byte would end the name, so "%00" stays as it is. */
static void decode_percent(char *text)
{
    char *to = text;
    for (const char *from = text; *from; from++) {
        int value = -1;
        if (*from == '%' && fmt_mesh_hex_digit(from[1]) >= 0 && fmt_mesh_hex_digit(from[2]) >= 0)
            value = 16 * fmt_mesh_hex_digit(from[1]) + fmt_mesh_hex_digit(from[2]);
        if (value > 0)
            from += 2;
        *to++ = value > 0 ? (char)value : *from;
    }
    *to = '\0';
}

/* Returns the length of a URI's scheme, such as 5 of "https:"; 0 if it has none. Drive letters of
 * Windows are no schemes. */
static size_t scheme_length(const char *uri)
{
    size_t length = 0;
    while ((uri[length] | 0x20) >= 'a' && (uri[length] | 0x20) <= 'z')
        length++;
    return length > 1 && uri[length] == ':' ? length + 1 : 0;
}

/* Finds a regular file by exactly this name, relative to the directory of `beside`. */
static int find_exactly(struct bsq_ctx *ctx, const char *beside, const char *name, char **out,
                        bool *exists)
{
    struct stat info;
    BSQ_PASS(fmt_path_beside(ctx, beside, name, out));
    *exists = stat(*out, &info) == 0 && S_ISREG(info.st_mode);
    return 0;
}

int fmt_gltf_uri_path(struct bsq_ctx *ctx, const char *beside, const char *uri, bool exactly,
                      char **out, bool *exists)
{
    int (*find)(struct bsq_ctx *, const char *, const char *, char **, bool *) =
        exactly ? find_exactly : fmt_path_find;
    char *decoded = NULL;
    *out = NULL;
    *exists = false;
    if (strncmp(uri, "file:///", 8) == 0)
        uri += 7;
    if (scheme_length(uri) > 0 || !*uri)
        return 0;
    int status = find(ctx, beside, uri, out, exists); /* some write names as they are */
    if (status || *exists)
        return status ? status : 1;
    bsq_free(ctx, *out);
    *out = NULL;
    status = bsq_text_copy(ctx, uri, &decoded);
    if (!status) {
        decode_percent(decoded);
        status = find(ctx, beside, decoded, out, exists);
    }
    bsq_free(ctx, decoded);
    return status ? status : 1;
}

/* ---- buffers ---- */

int fmt_gltf_measure_data(const struct gltf_item *item, uint64_t offset, uint64_t size,
                          uint64_t *out)
{
    const struct gltf_document *d = item->document;
    char end[2] = {0, 0};
    if (offset > d->file.size || size > d->file.size - offset)
        return fmt_gltf_fail(item, "its data URI is outside of the file");
    int status = size < 2 ? 0 : bsq_file_read(d->ctx, &d->file, end, sizeof end, offset + size - 2);
    if (end[1] == '=')
        size -= end[0] == '=' ? 2 : 1;
    *out = size / 4 * 3 + (size % 4 > 1 ? size % 4 - 1 : 0);
    return status;
}

/* Returns whether a buffer has nothing but what is also compressed in other buffers. */
static bool is_fallback(const json_t *buffer)
{
    const json_t *meshopt = fmt_gltf_extension(buffer, "EXT_meshopt_compression");
    return json_is_true(json_object_get(meshopt, "fallback"));
}

/* Reports that a buffer's path is no regular file. */
static int fail_missing(const struct gltf_item *item, const char *path)
{
    const char *document = item->document->file.path;
    struct stat info;
    if (path && stat(path, &info) == 0)
        return bsq_fail(item->document->ctx, BSQ_ENOINPUT,
                        "%s: not a regular file, which %s names as a buffer", path, document);
    return bsq_fail(item->document->ctx, BSQ_ENOINPUT, "%s: no such buffer, which %s names", path,
                    document);
}

/* Uses the other file that a URI names. A file of another name could give another shape. Fallbacks
 * are often left behind: one that does not exist has no data. */
static int use_file(const struct gltf_item *item, const char *uri, struct gltf_buffer *out)
{
    struct bsq_ctx *ctx = item->document->ctx;
    bool exists;
    int found = fmt_gltf_uri_path(ctx, fmt_input_beside(item->document->input), uri, true,
                                  &out->path, &exists);
    if (found > 0 && !exists && is_fallback(item->object)) {
        bsq_free(ctx, out->path);
        out->path = NULL;
        out->missing = true;
        return 0;
    }
    if (found > 0 && !exists)
        return fail_missing(item, out->path);
    if (found == 0)
        return fmt_gltf_fail(item, "its URI \"%.60s\" names no file", uri);
    BSQ_PASS(found);
    BSQ_PASS(bsq_note_input(ctx, out->path, "the buffer that %s names", item->document->file.path));
    const int status = bsq_file_open(ctx, out->path, &out->file);
    out->extent.size = out->file.size;
    bsq_file_close(ctx, &out->file);
    return status;
}

int fmt_gltf_read_buffer(const struct gltf_item *item, struct gltf_source *source, void *element)
{
    struct gltf_buffer *out = element;
    const struct gltf_document *d = item->document;
    const char *uri = fmt_gltf_string(item->object, "uri");
    uint64_t length = GLTF_REQUIRED, offset, size;
    *out = (struct gltf_buffer){.file = BSQ_FILE_CLOSED};
    BSQ_PASS(fmt_gltf_number(item, item->object, "byteLength", INT64_MAX / 4, &length));
    if (!uri && fmt_gltf_extension(item->object, "EXT_meshopt_compression")) {
        out->missing = true;
    } else if (!uri) {
        /* Without a URI: the chunk, for the first; or nothing that this reader can read. */
        const bool chunk = item->index == 0 && d->chunk_offset > 0;
        out->extent =
            (struct fmt_extent){.offset = d->chunk_offset, .size = chunk ? d->chunk_bytes : 0};
    } else if (fmt_gltf_find_data(uri, &offset, &size)) {
        out->extent = (struct fmt_extent){.offset = offset, .base64 = true};
        BSQ_PASS(fmt_gltf_measure_data(item, offset, size, &out->extent.size));
    } else {
        BSQ_PASS(use_file(item, uri, out));
    }
    if (length > out->extent.size && !out->missing)
        return fmt_gltf_fail(item,
                             "truncated: it should have %" PRIu64 " bytes, there are %" PRIu64,
                             length, out->extent.size);
    out->extent.size = length;
    source->bytes += out->path ? length : 0;
    return 0;
}

/* ---- views ---- */

enum { MOST_STRIDE = 252 }; /* of the file format */

int fmt_gltf_read_view(const struct gltf_item *item, struct gltf_source *source, void *element)
{
    struct gltf_view *out = element;
    const json_t *meshopt = fmt_gltf_extension(item->object, "EXT_meshopt_compression");
    uint64_t size = GLTF_REQUIRED, offset = 0, stride = 0;
    *out = (struct gltf_view){.buffer = GLTF_NONE};
    BSQ_PASS(fmt_gltf_index(item, item->object, "buffer", "buffers", &out->buffer));
    BSQ_PASS(fmt_gltf_number(item, item->object, "byteLength", INT64_MAX / 4, &size));
    BSQ_PASS(fmt_gltf_number(item, item->object, "byteOffset", INT64_MAX / 4, &offset));
    BSQ_PASS(fmt_gltf_number(item, item->object, "byteStride", MOST_STRIDE, &stride));
    if (out->buffer == GLTF_NONE)
        return fmt_gltf_fail(item, "\"buffer\" is missing");
    const uint64_t bytes = source->buffers[out->buffer].extent.size;
    if (offset > bytes || size > bytes - offset)
        return fmt_gltf_fail(item,
                             "bytes %" PRIu64 " to %" PRIu64 " are outside of buffers[%" PRIu32
                             "], which has %" PRIu64,
                             offset, offset + size, out->buffer, bytes);
    out->offset = offset;
    out->size = size;
    out->stride = (uint32_t)stride;
    if (meshopt)
        return fmt_gltf_read_packed_view(item, source, meshopt, out);
    return source->buffers[out->buffer].missing ? fmt_gltf_fail(item, "its buffer has no data") : 0;
}

/* ---- bytes ---- */

int fmt_gltf_open_buffers(struct bsq_ctx *ctx, struct gltf_source *source)
{
    for (uint32_t i = 0; i < source->buffer_count; i++)
        if (source->buffers[i].path && source->buffers[i].file.fd < 0)
            BSQ_PASS(bsq_file_open(ctx, source->buffers[i].path, &source->buffers[i].file));
    return 0;
}

int fmt_gltf_close_buffers(struct bsq_ctx *ctx, struct gltf_source *source)
{
    int status = 0;
    for (uint32_t i = 0; i < source->buffer_count; i++) {
        struct bsq_file *file = &source->buffers[i].file;
        if (file->fd >= 0 && !status)
            status = bsq_file_check(ctx, file);
        bsq_file_close(ctx, file);
    }
    return status;
}

void fmt_gltf_free_buffers(struct bsq_ctx *ctx, struct gltf_source *source)
{
    for (uint32_t i = 0; i < source->buffer_count; i++) {
        bsq_file_close(ctx, &source->buffers[i].file);
        bsq_free(ctx, source->buffers[i].path);
    }
    bsq_file_close(ctx, &source->decoded.file);
    BSQ_FREE(ctx, source->buffers, source->views, source->packed);
}

int fmt_gltf_read_bytes(struct bsq_ctx *ctx, const struct gltf_source *source, uint32_t buffer,
                        uint64_t offset, void *to, uint64_t size)
{
    const struct gltf_buffer *from =
        buffer == GLTF_NONE ? &source->decoded : &source->buffers[buffer];
    return fmt_extent_read(ctx, from->file.fd >= 0 ? &from->file : &source->own, &from->extent, to,
                           size, offset);
}

/* ---- accessors: elements of all types ---- */

/* By the code of a component, from GLTF_INT8 on: its bytes, and the integer that stands for 1 in
 * normalized ones. */
static const struct component_type {
    uint32_t bytes;
    double one;
} component_types[] = {{1, 127}, {1, 255},          {2, 32767}, {2, 65535},
                       {0, 1},   {4, 4294967295.0}, {4, 1}};

uint32_t fmt_gltf_component_bytes(enum gltf_component component)
{
    return component_types[component - GLTF_INT8].bytes;
}

static int read_component(const struct gltf_item *item, const json_t *object,
                          enum gltf_component *out)
{
    uint64_t code = GLTF_REQUIRED;
    int status = fmt_gltf_number(item, object, "componentType", INT32_MAX, &code);
    if (!status &&
        (code < GLTF_INT8 || code > GLTF_FLOAT || component_types[code - GLTF_INT8].bytes == 0))
        status = fmt_gltf_fail(item, "unknown componentType %" PRIu64, code);
    *out = status ? GLTF_UINT8 : (enum gltf_component)code;
    return status;
}

static int read_type(const struct gltf_item *item, uint32_t *components)
{
    static const struct {
        const char *name;
        uint32_t components;
    } types[] = {{"SCALAR", 1}, {"VEC2", 2}, {"VEC3", 3}, {"VEC4", 4},
                 {"MAT2", 0},   {"MAT3", 0}, {"MAT4", 0}};
    const char *name = fmt_gltf_string(item->object, "type");
    for (size_t i = 0; name && i < sizeof types / sizeof *types; i++)
        if (strcmp(name, types[i].name) == 0) {
            *components = types[i].components;
            return 0;
        }
    return fmt_gltf_fail(item, "unknown type \"%.20s\"", name ? name : "");
}

/* Checks that the elements of an accessor lie in its view. */
static int check_elements(const struct gltf_item *item, const struct gltf_source *source,
                          const struct gltf_accessor *a)
{
    const uint64_t bytes = (uint64_t)a->components * fmt_gltf_component_bytes(a->component);
    if (a->view == GLTF_NONE || a->components == 0 || a->count == 0)
        return 0;
    const uint64_t size = source->views[a->view].size;
    if (a->offset > size || bytes > size - a->offset ||
        a->count - 1 > (size - a->offset - bytes) / fmt_gltf_stride(source, a))
        return fmt_gltf_fail(item,
                             "%" PRIu64 " elements of %" PRIu64
                             " bytes are too many for bufferViews[%" PRIu32 "], which has %" PRIu64
                             " bytes",
                             a->count, bytes, a->view, size);
    return 0;
}

int fmt_gltf_read_accessor(const struct gltf_item *item, struct gltf_source *source, void *element)
{
    struct gltf_accessor *out = element;
    out->count = GLTF_REQUIRED;
    BSQ_PASS(fmt_gltf_index(item, item->object, "bufferView", "bufferViews", &out->view));
    BSQ_PASS(fmt_gltf_number(item, item->object, "byteOffset", INT64_MAX / 4, &out->offset));
    BSQ_PASS(fmt_gltf_number(item, item->object, "count", INT64_MAX / 4, &out->count));
    BSQ_PASS(read_component(item, item->object, &out->component));
    BSQ_PASS(read_type(item, &out->components));
    out->normalized = json_is_true(json_object_get(item->object, "normalized"));
    out->sparse = json_object_get(item->object, "sparse") != NULL;
    return check_elements(item, source, out);
}

/* ---- decoding ---- */

uint64_t fmt_gltf_stride(const struct gltf_source *source, const struct gltf_accessor *accessor)
{
    const uint64_t own =
        (uint64_t)accessor->components * fmt_gltf_component_bytes(accessor->component);
    if (accessor->view == GLTF_NONE)
        return own;
    const uint64_t stride = source->views[accessor->view].stride;
    return stride > 0 ? stride : own;
}

/* Converts elements that are `stride` bytes apart; divides them by `limit`. */
#define CONVERT(TYPE)                                                                              \
    for (uint64_t i = 0; i < count; i++)                                                           \
        for (uint32_t c = 0; c < components; c++) {                                                \
            TYPE value;                                                                            \
            memcpy(&value, from + i * stride + c * sizeof value, sizeof value);                    \
            to[i * components + c] = (double)value;                                                \
        }

static void convert(const uint8_t *from, uint64_t stride, enum gltf_component component,
                    uint32_t components, uint64_t count, double *to)
{
    switch (component) {
    case GLTF_INT8:
        CONVERT(int8_t);
        break;
    case GLTF_UINT8:
        CONVERT(uint8_t);
        break;
    case GLTF_INT16:
        CONVERT(int16_t);
        break;
    case GLTF_UINT16:
        CONVERT(uint16_t);
        break;
    case GLTF_UINT32:
        CONVERT(uint32_t);
        break;
    case GLTF_FLOAT:
        CONVERT(float);
        break;
    }
}

/* Makes integers numbers from 0 or -1 to 1. */
static void normalize(const struct gltf_accessor *accessor, double *values, uint64_t count)
{
    if (!accessor->normalized || accessor->component == GLTF_FLOAT)
        return;
    const double limit = component_types[accessor->component - GLTF_INT8].one;
    for (uint64_t i = 0; i < count; i++)
        values[i] = values[i] / limit < -1 ? -1 : values[i] / limit;
}

/* Reads elements [first, first + count) to slot->bytes, and converts them. */
static int read_elements(struct stream_slot *slot, const struct gltf_accessor *a, uint64_t first,
                         uint64_t count, double *to)
{
    const struct gltf_source *source = slot->source->data;
    const struct gltf_view *view = &source->views[a->view];
    const uint64_t stride = fmt_gltf_stride(source, a);
    const uint64_t element = (uint64_t)a->components * fmt_gltf_component_bytes(a->component);
    if (count == 0)
        return 0;
    const uint64_t size = (count - 1) * stride + element;
    BSQ_PASS(fmt_stream_reserve(slot, size));
    BSQ_PASS(fmt_gltf_read_bytes(slot->ctx, source, view->buffer,
                                 view->offset + a->offset + first * stride, slot->bytes, size));
    convert(slot->bytes, stride, a->component, a->components, count, to);
    return 0;
}

int fmt_gltf_decode(struct stream_slot *slot, uint32_t number, uint64_t first, uint64_t count,
                    const double **out)
{
    const struct gltf_source *source = slot->source->data;
    const struct gltf_accessor *accessor = &source->accessors[number];
    const uint64_t values = count * accessor->components, bytes = values * sizeof(double);
    if (bytes > slot->work_capacity)
        BSQ_PASS(bsq_grow(slot->ctx, "elements", bytes, 1, &slot->work, &slot->work_capacity));
    double *to = (double *)(void *)slot->work;
    *out = to;
    if (accessor->view == GLTF_NONE)
        memset(to, 0, bytes);
    else
        BSQ_PASS(read_elements(slot, accessor, first, count, to));
    normalize(accessor, to, values);
    return 0;
}
