/* gltf_document.c - opens .gltf and GLB files, parses their JSON and reads its values.
 *
 * Jansson allocates from the system. What it can need at most is counted from the text and reserved
 * from the budget before. Base64 data URIs, which can be most of a file, do not get to it. */
#include <assert.h>
#include <inttypes.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "base/bytes.h"
#include "base/text.h"
#include "formats/mesh/gltf_internal.h"
#include "formats/mesh/mesh_text.h"

/* ---- the text ---- */

enum { BLOCK = 16384 };

/* Copies JSON text to memory and shortens data URIs. */
struct shortener {
    struct bsq_ctx *ctx;
    char *text;
    uint64_t size, capacity;
    bool in_string, escaped, in_data;
    uint64_t string_start;           /* in `text`: after the quotation mark */
    uint64_t data_offset, data_size; /* of base64 text, in the file */
};

static void put(struct shortener *s, const char *bytes, uint64_t count)
{
    assert(s->text && s->capacity - s->size >= count);
    memcpy(s->text + s->size, bytes, count);
    s->size += count;
}

/* Returns whether the string so far is the head of a base64 data URI. */
static bool begins_data(const struct shortener *s)
{
    static const char prefix[] = "data:", end[] = ";base64,";
    const uint64_t length = s->size - s->string_start;
    return length >= sizeof prefix - 1 + sizeof end - 1 &&
           memcmp(s->text + s->string_start, prefix, sizeof prefix - 1) == 0 &&
           memcmp(s->text + s->size - (sizeof end - 1), end, sizeof end - 1) == 0;
}

static void end_data(struct shortener *s)
{
    char uri[48];
    const int length =
        snprintf(uri, sizeof uri, "data:#%" PRIu64 "+%" PRIu64, s->data_offset, s->data_size);
    s->in_data = false;
    s->size = s->string_start;
    put(s, uri, (uint64_t)length);
}

/* Takes the character at byte `at` of the file. */
static void take(struct shortener *s, char c, uint64_t at)
{
    if (s->in_data && c != '"') {
        s->data_size++;
        return;
    }
    if (s->in_data)
        end_data(s);
    put(s, &c, 1);
    if (!s->in_string) {
        s->in_string = c == '"';
        s->string_start = s->size;
    } else if (s->escaped) {
        s->escaped = false;
    } else if (c == '"') {
        s->in_string = false;
    } else if (c == ',' && begins_data(s)) {
        s->in_data = true;
        s->data_offset = at + 1;
        s->data_size = 0;
    } else {
        s->escaped = c == '\\';
    }
}

static int read_text(struct gltf_document *d, struct shortener *s)
{
    char block[BLOCK];
    for (uint64_t at = 0; at < d->json_bytes; at += BLOCK) {
        const uint64_t left = d->json_bytes - at, count = left < BLOCK ? left : BLOCK;
        BSQ_PASS(bsq_check(d->ctx));
        BSQ_PASS(bsq_file_read(d->ctx, &d->file, block, count, d->json_offset + at));
        /* A shortened data URI of 47 bytes may stand for one of 15. */
        if (s->size + 4 * count + 64 > s->capacity)
            BSQ_PASS(
                bsq_grow(d->ctx, "JSON text", s->size + 4 * count + 64, 1, &s->text, &s->capacity));
        for (uint64_t i = 0; i < count; i++)
            take(s, block[i], d->json_offset + at + i);
    }
    while (s->size > 0 && s->text[s->size - 1] == '\0') /* padding of some GLB files */
        s->size--;
    return 0;
}

bool fmt_gltf_find_data(const char *uri, uint64_t *offset, uint64_t *size)
{
    char plus = 0, rest = 0;
    return strncmp(uri, "data:#", 6) == 0 && uri[6] >= '0' && uri[6] <= '9' &&
           sscanf(uri + 6, "%" SCNu64 "%c%" SCNu64 "%c", offset, &plus, size, &rest) == 3 &&
           plus == '+';
}

/* ---- parsing ---- */

struct feed {
    struct gltf_document *document;
    const char *text;
    uint64_t left;
    int status;
};

static size_t feed_json(void *to, size_t size, void *arg)
{
    struct feed *feed = arg;
    size = size < feed->left ? size : (size_t)feed->left;
    feed->status = bsq_check(feed->document->ctx);
    if (feed->status)
        return (size_t)-1;
    if (size == 0) /* an empty text has no memory */
        return 0;
    memcpy(to, feed->text, size);
    feed->text += size;
    feed->left -= size;
    return size;
}

static int parse_text(struct gltf_document *d, const struct shortener *s)
{
    struct feed feed = {.document = d, .text = s->text, .left = s->size};
    json_error_t error;
    const size_t mark = fmt_mesh_mark(s->text, s->size);
    if (mark > 0) { /* an empty text has no memory */
        feed.text += mark;
        feed.left -= mark;
    }
    const uint64_t bound = bsq_json_bound(s->text, s->size);
    BSQ_PASS(bsq_reserve(d->ctx, "the JSON of a glTF file", bound));
    d->json_memory = bound;
    d->root = json_load_callback(feed_json, &feed, JSON_ALLOW_NUL, &error);
    if (feed.status)
        return feed.status;
    if (!d->root)
        return bsq_fail(d->ctx, BSQ_EDATA, "%s: JSON, line %d: %s", d->file.path, error.line,
                        error.text);
    if (!json_is_object(d->root))
        return bsq_fail(d->ctx, BSQ_EDATA, "%s: not a glTF file: its JSON is no object",
                        d->file.path);
    return 0;
}

/* ---- GLB ---- */

enum { GLB_HEADER = 12, GLB_CHUNK_HEADER = 8 };

/* Reads the header of the chunk at `offset`. */
static int read_chunk(struct gltf_document *d, uint64_t offset, uint64_t end, uint32_t *type,
                      uint64_t *size)
{
    uint8_t head[GLB_CHUNK_HEADER];
    BSQ_PASS(bsq_file_read(d->ctx, &d->file, head, sizeof head, offset));
    *size = bsq_little(head, 4);
    *type = (uint32_t)bsq_little(head + 4, 4);
    if (*size > end - offset - GLB_CHUNK_HEADER)
        return bsq_fail(d->ctx, BSQ_EDATA,
                        "%s: byte %" PRIu64 ": truncated: a chunk has %" PRIu64
                        " bytes, the file ends after %" PRIu64,
                        d->file.path, offset, *size, end - offset - GLB_CHUNK_HEADER);
    return 0;
}

static int find_chunks(struct gltf_document *d, const uint8_t *head)
{
    const uint32_t json = 0x4e4f534a, binary = 0x004e4942;
    const uint64_t end = bsq_little(head + 8, 4);
    uint32_t type = 0;
    uint64_t size;
    if (bsq_little(head + 4, 4) != 2)
        return bsq_fail(d->ctx, BSQ_EDATA, "%s: glTF version %" PRIu32 " is not read, only 2",
                        d->file.path, (uint32_t)bsq_little(head + 4, 4));
    if (end > d->file.size || end < GLB_HEADER + GLB_CHUNK_HEADER)
        return bsq_fail(d->ctx, BSQ_EDATA,
                        "%s: truncated: the header counts %" PRIu64 " bytes, the file has %" PRIu64,
                        d->file.path, end, d->file.size);
    BSQ_PASS(read_chunk(d, GLB_HEADER, end, &type, &size));
    if (type != json)
        return bsq_fail(d->ctx, BSQ_EDATA, "%s: the first chunk is not JSON", d->file.path);
    d->json_offset = GLB_HEADER + GLB_CHUNK_HEADER;
    d->json_bytes = size;
    /* Chunks begin at multiples of 4. Unknown ones after the binary chunk are not read. */
    const uint64_t next = bsq_align_up(d->json_offset + size, 4);
    if (next > end || end - next < GLB_CHUNK_HEADER)
        return 0;
    BSQ_PASS(read_chunk(d, next, end, &type, &size));
    if (type == binary) {
        d->chunk_offset = next + GLB_CHUNK_HEADER;
        d->chunk_bytes = size;
    }
    return 0;
}

/* ---- extensions ---- */

/* Returns whether files that need an extension can be read: it is understood, or says nothing about
 * shape and base colour. A name that ends in "_" stands for all names that begin with it. */
static bool is_known(const char *name)
{
    static const char *const known[] = {
        "KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_mesh_quantization",
        "KHR_texture_transform",      "KHR_materials_",          "EXT_texture_webp",
        "KHR_lights_punctual",        "KHR_xmp_json_ld",         "KHR_animation_pointer",
        "KHR_audio_emitter",          "KHR_node_hoverability",   "KHR_node_selectability",
    };
    for (size_t i = 0; name && i < sizeof known / sizeof *known; i++) {
        const size_t length = strlen(known[i]);
        if (known[i][length - 1] == '_' ? strncmp(name, known[i], length) == 0
                                        : strcmp(name, known[i]) == 0)
            return true;
    }
    return false;
}

static int check_extensions(const struct gltf_document *document)
{
    const json_t *required = json_object_get(document->root, "extensionsRequired");
    char unknown[200] = "";
    for (size_t i = 0; i < json_array_size(required); i++) {
        const char *name = json_string_value(json_array_get(required, i));
        const size_t length = strlen(unknown);
        if (!is_known(name))
            snprintf(unknown + length, sizeof unknown - length, "%s%.60s", length > 0 ? ", " : "",
                     name ? name : "?");
    }
    if (unknown[0])
        return bsq_fail(document->ctx, BSQ_EDATA, "%s: needs extensions that are not read: %s",
                        document->file.path, unknown);
    return 0;
}

/* ---- opening ---- */

/* Reads asset.version. Files of versions 2.x can be read by readers of 2.0. */
static int check_version(struct gltf_document *d)
{
    const json_t *asset = json_object_get(d->root, "asset");
    const char *version = fmt_gltf_string(asset, "version");
    const char *least = fmt_gltf_string(asset, "minVersion");
    if (!version)
        return bsq_fail(d->ctx, BSQ_EDATA, "%s: not a glTF file: it has no asset.version",
                        d->file.path);
    if (strncmp(version, "2.", 2) != 0 || (least && strcmp(least, "2.0") != 0))
        return bsq_fail(d->ctx, BSQ_EDATA, "%s: glTF version %.20s is not read, only 2.0",
                        d->file.path, least ? least : version);
    return 0;
}

int fmt_gltf_open_document(struct bsq_ctx *ctx, struct fmt_input *input, struct gltf_document *out)
{
    struct shortener text = {.ctx = ctx};
    uint8_t head[GLB_HEADER] = {0};
    uint64_t got = 0;
    *out = (struct gltf_document){.ctx = ctx, .input = input, .file = BSQ_FILE_CLOSED};
    int status;
    BSQ_TRY(fmt_input_whole(input, &out->file));
    BSQ_TRY(bsq_file_read_some(ctx, &out->file, head, sizeof head, 0, &got));
    out->json_bytes = out->file.size;
    if (got == sizeof head && memcmp(head, "glTF", 4) == 0)
        BSQ_TRY(find_chunks(out, head));
    BSQ_TRY(read_text(out, &text));
    BSQ_TRY(parse_text(out, &text));
    BSQ_TRY(check_version(out));
    status = check_extensions(out);
done:
    bsq_free(ctx, text.text);
    return status;
}

void fmt_gltf_close_document(struct gltf_document *document)
{
    if (document->root)
        json_decref(document->root);
    bsq_release(document->ctx, document->json_memory);
    bsq_file_close(document->ctx, &document->file);
}

/* ---- values ---- */

struct gltf_item fmt_gltf_element(struct gltf_document *document, const char *array, uint64_t index)
{
    const json_t *list = json_object_get(document->root, array);
    return (struct gltf_item){.document = document,
                              .array = array,
                              .index = index,
                              .object = json_array_get(list, index)};
}

uint64_t fmt_gltf_count(const struct gltf_document *document, const char *array)
{
    return json_array_size(json_object_get(document->root, array));
}

int fmt_gltf_fail(const struct gltf_item *item, const char *format, ...)
{
    char text[300];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    return bsq_fail(item->document->ctx, BSQ_EDATA, "%s: %s[%" PRIu64 "]: %s",
                    item->document->file.path, item->array, item->index, text);
}

bool fmt_gltf_whole(const json_t *value, uint64_t most, uint64_t *out)
{
    if (json_is_integer(value)) {
        const json_int_t number = json_integer_value(value);
        *out = (uint64_t)number;
        return number >= 0 && *out <= most;
    }
    const double real = json_real_value(value); /* 0 if it is none */
    if (!json_is_real(value) || !(real >= 0 && real < 9007199254740992.0) || real != floor(real))
        return false;
    *out = (uint64_t)real;
    return *out <= most;
}

int fmt_gltf_number(const struct gltf_item *item, const json_t *object, const char *key,
                    uint64_t most, uint64_t *out)
{
    const json_t *value = json_object_get(object, key);
    if (!value && *out == GLTF_REQUIRED)
        return fmt_gltf_fail(item, "\"%s\" is missing", key);
    if (!value)
        return 0;
    if (!fmt_gltf_whole(value, most, out))
        return fmt_gltf_fail(item, "\"%s\" is no whole number from 0 to %" PRIu64, key, most);
    return 0;
}

int fmt_gltf_index(const struct gltf_item *item, const json_t *object, const char *key,
                   const char *array, uint32_t *out)
{
    const uint64_t count = fmt_gltf_count(item->document, array);
    uint64_t index = GLTF_NONE;
    int status = fmt_gltf_number(item, object, key, INT32_MAX, &index);
    if (!status && index != GLTF_NONE && index >= count)
        status = fmt_gltf_fail(item, "\"%s\" refers to %s[%" PRIu64 "], the file has %" PRIu64, key,
                               array, index, count);
    *out = status ? GLTF_NONE : (uint32_t)index;
    return status;
}

int fmt_gltf_numbers(const struct gltf_item *item, const json_t *object, const char *key,
                     unsigned count, double *out)
{
    const json_t *list = json_object_get(object, key);
    if (!list)
        return 0;
    if (json_array_size(list) != count)
        return fmt_gltf_fail(item, "\"%s\" is no list of %u numbers", key, count);
    for (unsigned i = 0; i < count; i++) {
        const json_t *value = json_array_get(list, i);
        if (!json_is_number(value))
            return fmt_gltf_fail(item, "\"%s\" is no list of %u numbers", key, count);
        out[i] = json_number_value(value);
    }
    return 0;
}

const char *fmt_gltf_string(const json_t *object, const char *key)
{
    return json_string_value(json_object_get(object, key));
}

const json_t *fmt_gltf_extension(const json_t *object, const char *name)
{
    return json_object_get(json_object_get(object, "extensions"), name);
}
