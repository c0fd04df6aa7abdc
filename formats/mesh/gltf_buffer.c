/* gltf_buffer.c - buffers and buffer views of glTF files: ranges of bytes of files.
 *
 * A buffer is the binary chunk of a GLB file, another file, or a data URI. None is ever held in
 * memory. */
#include <inttypes.h>
#include <string.h>
#include <sys/stat.h>

#include "base/job_files.h"
#include "base/path_map.h"
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
    const char *mapped = bsq_map_path(ctx, name);
    struct stat info;
    if (!mapped)
        return BSQ_ENOMEM;
    int status = fmt_path_beside(ctx, beside, mapped, out);
    if (status)
        return status;
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

int fmt_gltf_measure_data(const struct gltf_place *place, uint64_t offset, uint64_t size,
                          uint64_t *out)
{
    const struct gltf_document *d = place->document;
    char end[2] = {0, 0};
    if (offset > d->file.size || size > d->file.size - offset)
        return fmt_gltf_fail(place, "its data URI is outside of the file");
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
static int fail_missing(const struct gltf_place *place, const char *path)
{
    const char *document = place->document->file.path;
    struct stat info;
    if (path && stat(path, &info) == 0)
        return bsq_fail(place->document->ctx, BSQ_ENOINPUT,
                        "%s: not a regular file, which %s names as a buffer", path, document);
    return bsq_fail(place->document->ctx, BSQ_ENOINPUT, "%s: no such buffer, which %s names", path,
                    document);
}

/* Uses the other file that a URI names. A file of another name could give another shape. Fallbacks
 * are often left behind: one that does not exist has no data. */
static int use_file(const struct gltf_place *place, const char *uri, struct gltf_buffer *out)
{
    struct bsq_ctx *ctx = place->document->ctx;
    bool exists;
    int found = fmt_gltf_uri_path(ctx, fmt_input_beside(place->document->input), uri, true,
                                  &out->path, &exists);
    if (found > 0 && !exists && is_fallback(place->object)) {
        bsq_free(ctx, out->path);
        out->path = NULL;
        out->missing = true;
        return 0;
    }
    if (found > 0 && !exists)
        return fail_missing(place, out->path);
    if (found == 0)
        return fmt_gltf_fail(place, "its URI \"%.60s\" names no file", uri);
    int status = found < 0 ? found
                           : bsq_note_input(ctx, out->path, "the buffer that %s names",
                                            place->document->file.path);
    if (!status)
        status = bsq_file_open(ctx, out->path, &out->file);
    out->part.size = out->file.size;
    bsq_file_close(ctx, &out->file);
    return status;
}

int fmt_gltf_read_buffer(const struct gltf_place *place, struct gltf_source *source, void *element)
{
    struct gltf_buffer *out = element;
    const struct gltf_document *d = place->document;
    const char *uri = fmt_gltf_string(place->object, "uri");
    uint64_t length = GLTF_REQUIRED, offset, size;
    *out = (struct gltf_buffer){.file = BSQ_FILE_CLOSED};
    int status = fmt_gltf_number(place, place->object, "byteLength", INT64_MAX / 4, &length);
    if (status)
        return status;
    if (!uri && fmt_gltf_extension(place->object, "EXT_meshopt_compression")) {
        out->missing = true;
    } else if (!uri) {
        /* Without a URI: the chunk, for the first; or nothing that this reader can read. */
        const bool chunk = place->index == 0 && d->chunk_offset > 0;
        out->part =
            (struct bsq_part){.offset = d->chunk_offset, .size = chunk ? d->chunk_bytes : 0};
    } else if (fmt_gltf_find_data(uri, &offset, &size)) {
        out->part = (struct bsq_part){.offset = offset, .base64 = true};
        status = fmt_gltf_measure_data(place, offset, size, &out->part.size);
    } else {
        status = use_file(place, uri, out);
    }
    if (status)
        return status;
    if (length > out->part.size && !out->missing)
        return fmt_gltf_fail(place,
                             "truncated: it should have %" PRIu64 " bytes, there are %" PRIu64,
                             length, out->part.size);
    out->part.size = length;
    source->bytes += out->path ? length : 0;
    return 0;
}

/* ---- views ---- */

enum { MOST_STRIDE = 252 }; /* of the file format */

int fmt_gltf_read_view(const struct gltf_place *place, struct gltf_source *source, void *element)
{
    struct gltf_view *out = element;
    const json_t *meshopt = fmt_gltf_extension(place->object, "EXT_meshopt_compression");
    uint64_t size = GLTF_REQUIRED, offset = 0, stride = 0;
    *out = (struct gltf_view){.buffer = GLTF_NONE, .decoded = GLTF_NOT_DECODED};
    int status;
    BSQ_TRY(fmt_gltf_index(place, place->object, "buffer", "buffers", &out->buffer));
    BSQ_TRY(fmt_gltf_number(place, place->object, "byteLength", INT64_MAX / 4, &size));
    BSQ_TRY(fmt_gltf_number(place, place->object, "byteOffset", INT64_MAX / 4, &offset));
    BSQ_TRY(fmt_gltf_number(place, place->object, "byteStride", MOST_STRIDE, &stride));
    if (out->buffer == GLTF_NONE)
        return fmt_gltf_fail(place, "\"buffer\" is missing");
    const uint64_t bytes = source->buffers[out->buffer].part.size;
    if (offset > bytes || size > bytes - offset)
        return fmt_gltf_fail(place,
                             "bytes %" PRIu64 " to %" PRIu64 " are outside of buffers[%" PRIu32
                             "], which has %" PRIu64,
                             offset, offset + size, out->buffer, bytes);
    out->offset = offset;
    out->size = size;
    out->stride = (uint32_t)stride;
    if (meshopt)
        return fmt_gltf_read_packed_view(place, source, meshopt, out);
    status =
        source->buffers[out->buffer].missing ? fmt_gltf_fail(place, "its buffer has no data") : 0;
done:
    return status;
}

/* ---- bytes ---- */

int fmt_gltf_open_buffers(struct bsq_ctx *ctx, struct gltf_source *source)
{
    int status = 0;
    for (uint32_t i = 0; i < source->buffer_count && !status; i++)
        if (source->buffers[i].path && source->buffers[i].file.fd < 0)
            status = bsq_file_open(ctx, source->buffers[i].path, &source->buffers[i].file);
    return status;
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
    bsq_file_close(ctx, &source->decoded);
    bsq_free(ctx, source->buffers);
    bsq_free(ctx, source->views);
    bsq_free(ctx, source->packed);
}

int fmt_gltf_read_bytes(struct bsq_ctx *ctx, const struct gltf_source *source, uint32_t view,
                        uint64_t offset, void *to, uint64_t size)
{
    const struct gltf_view *from = &source->views[view];
    if (from->decoded != GLTF_NOT_DECODED)
        return bsq_file_read(ctx, &source->decoded, to, size, from->decoded + offset);
    const struct gltf_buffer *buffer = &source->buffers[from->buffer];
    return bsq_part_read(ctx, buffer->path ? &buffer->file : &source->own, &buffer->part, to, size,
                         from->offset + offset);
}
