/* tris_open.c - opens a chunk file: its header, materials and table of chunks.
 *
 * Nothing in the file is trusted. Lengths are compared with the file's size before memory is
 * allocated, parts must follow each other without gaps, and a checksum covers each byte. */
#include "formats/chunks/tris_internal.h"
#include "formats/material/channels.h"
#include "formats/material/file_extent.h"
#include "formats/material/tile_files.h"

#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <strings.h>
#include <xxhash.h>

bool fmt_tris_recognise(const char *path, const char *first, uint64_t size)
{
    const size_t length = strlen(path);
    const bool named = length > 5 && strcasecmp(path + length - 5, ".tris") == 0;
    return (size >= 8 || named) && memcmp(first, TRIS_MAGIC, size < 8 ? size : 8) == 0;
}

bool fmt_tris_has_color(const struct fmt_tris_header *header)
{
    bool any = header->attributes & FMT_TRIS_COLORS;
    for (uint32_t i = 0; header->attributes & FMT_TRIS_MATERIALS && i < header->material_count; i++)
        any |= !header->materials[i].colorless;
    return any;
}

int fmt_tris_damaged(const struct fmt_tris_file *file, const char *what)
{
    return bsq_fail(file->ctx, BSQ_EDATA, "%s: damaged chunk file: %s", file->file.path, what);
}

static int tris_check_version(const struct fmt_tris_file *file, uint32_t version)
{
    if (version == FMT_TRIS_VERSION)
        return 0;
    if (version == __builtin_bswap32(FMT_TRIS_VERSION))
        return bsq_fail(
            file->ctx, BSQ_EDATA,
            "%s: chunk file with its bytes in big-endian order: Bisque reads little-endian ones",
            file->file.path);
    if (version > 0 && version < FMT_TRIS_VERSION)
        return bsq_fail(file->ctx, BSQ_EDATA,
                        "%s: version %" PRIu32 " of chunk files is no longer read: sort the scan "
                        "again with bisque-voxelize",
                        file->file.path, version);
    return bsq_fail(file->ctx, BSQ_EDATA,
                    "%s: chunk file of version %" PRIu32 ", this program reads version %u",
                    file->file.path, version, FMT_TRIS_VERSION);
}

/* Checks that the parts follow each other and have space for what the header counts. */
static int check_parts(const struct fmt_tris_file *file, const struct tris_file_header *h)
{
    if (h->chunks_offset < sizeof *h || h->materials_offset < h->chunks_offset ||
        h->table_offset < h->materials_offset || h->file_bytes < h->table_offset ||
        (h->chunks_offset | h->materials_offset | h->table_offset) % 8 != 0)
        return fmt_tris_damaged(file, "parts of the file overlap");
    const uint64_t table_bytes = h->file_bytes - h->table_offset;
    if (table_bytes % sizeof(struct fmt_tris_chunk_info) != 0 ||
        table_bytes / sizeof(struct fmt_tris_chunk_info) != h->chunk_count)
        return fmt_tris_damaged(file, "the chunk table has another length");
    const uint64_t bytes = h->table_offset - h->materials_offset;
    if (h->channel_count > bytes / sizeof(uint32_t) ||
        h->material_count > bytes / tris_material_bytes(h->channel_count))
        return fmt_tris_damaged(file, "too many materials or channels");
    return 0;
}

static int tris_check_header(const struct fmt_tris_file *file, const struct tris_file_header *h)
{
    if (XXH3_64bits(h, offsetof(struct tris_file_header, header_checksum)) != h->header_checksum)
        return fmt_tris_damaged(file, "the header's checksum does not match");
    if (h->file_bytes != file->file.size)
        return bsq_fail(file->ctx, BSQ_EDATA,
                        "%s: damaged chunk file: it has %" PRIu64
                        " bytes, its header says %" PRIu64,
                        file->file.path, file->file.size, h->file_bytes);
    if ((h->attributes & ~TRIS_ATTRIBUTES) != 0 ||
        (h->attributes & FMT_TRIS_FINE_COLORS && !(h->attributes & FMT_TRIS_COLORS)))
        return fmt_tris_damaged(file, "unknown attributes");
    if (h->made_normals >= BSQ_SCAN_NORMALS_FLAT ||
        (h->made_normals != 0 && h->attributes & FMT_TRIS_NORMALS))
        return fmt_tris_damaged(file, "unknown normals");
    if (h->ids > FMT_IDS_COLOR)
        return fmt_tris_damaged(file, "unknown ids");
    return check_parts(file, h);
}

static void copy_header(struct fmt_tris_file *file, const struct tris_file_header *h)
{
    struct fmt_tris_header *to = &file->header;
    to->attributes = h->attributes;
    to->triangle_count = h->triangle_count;
    to->chunk_count = h->chunk_count;
    to->source_faces = h->source_faces;
    to->skipped_triangles = h->skipped_triangles;
    to->material_count = h->material_count;
    to->ids = (enum fmt_ids)h->ids;
    to->made_normals = (enum bsq_scan_normals)h->made_normals;
    memcpy(to->origin, h->origin, sizeof to->origin);
    memcpy(to->bounds_min, h->bounds_min, sizeof to->bounds_min);
    memcpy(to->bounds_max, h->bounds_max, sizeof to->bounds_max);
    file->chunks_offset = h->chunks_offset;
    file->images_checksum = h->images_checksum;
    file->checksum = h->header_checksum;
}

static int read_tail(struct fmt_tris_file *file, const struct tris_file_header *h)
{
    uint64_t bytes = h->file_bytes - h->materials_offset;
    const uint64_t materials_bytes = h->table_offset - h->materials_offset;
    BSQ_PASS(bsq_alloc(file->ctx, "chunk table", bytes + 1, 1, &file->tail));
    BSQ_PASS(fmt_tris_read_unchanged(file, file->tail, bytes, h->materials_offset));
    if (XXH3_64bits(file->tail, materials_bytes) != h->materials_checksum)
        return fmt_tris_damaged(file, "the materials' checksum does not match");
    if (XXH3_64bits(file->tail + materials_bytes, bytes - materials_bytes) != h->table_checksum)
        return fmt_tris_damaged(file, "the chunk table's checksum does not match");
    return 0;
}

/* Notes a texture among the job's inputs; for an extent of a file, that file. */
static int note_texture(const struct fmt_tris_file *file, char *path)
{
    struct fmt_extent extent;
    const size_t length = fmt_extent_parse(path, &extent);
    const char mark = path[length];
    if (length > 0)
        path[length] = '\0';
    int status = fmt_note_texture(file->ctx, path, "the texture that %s names", file->file.path);
    if (length > 0)
        path[length] = mark;
    return status;
}

/* The materials while they are parsed. */
struct cursor {
    const uint8_t *from;
    uint64_t bytes, at;
    char *text; /* space for the next path or name */
};

/* Copies the next bytes of the file. Returns false if it has fewer. */
static bool tris_take(struct cursor *cursor, void *to, uint64_t bytes)
{
    if (cursor->bytes - cursor->at < bytes)
        return false;
    memcpy(to, cursor->from + cursor->at, bytes);
    cursor->at += bytes;
    return true;
}

/* Points *out to the next `length` bytes as text. Returns false if they are no text. */
static bool take_text(struct cursor *cursor, uint32_t length, char **out)
{
    *out = cursor->text;
    if (!tris_take(cursor, cursor->text, length) || memchr(*out, 0, length))
        return false;
    cursor->text[length] = '\0';
    cursor->text += length + 1;
    return true;
}

/* Names an image that lies in the file. The caller has checked that it has a name. */
static int name_image(struct fmt_tris_file *file, const char *range, char **out)
{
    const uint64_t size = strlen(file->file.path) + strlen(range) + 1;
    struct fmt_extent extent;
    char *name = NULL;
    BSQ_PASS(
        BSQ_GROW(file->ctx, "images", file->image_count + 1, &file->images, &file->image_capacity));
    BSQ_PASS(bsq_alloc(file->ctx, "images", size, 1, &name));
    snprintf(name, size, "%s%s", file->file.path, range);
    file->images[file->image_count++] = *out = name;
    if (fmt_extent_parse(name, &extent) == 0 || extent.base64 ||
        extent.offset < sizeof(struct tris_file_header) || extent.size > file->chunks_offset ||
        extent.offset > file->chunks_offset - extent.size)
        return fmt_tris_damaged(file, "an image is not in the file");
    return 0;
}

/* Reads the path of a texture. */
static int parse_path(struct fmt_tris_file *file, struct cursor *cursor, uint32_t length,
                      char **out)
{
    if (length == TRIS_NO_PATH)
        return 0;
    if (!take_text(cursor, length, out))
        return fmt_tris_damaged(file, "a texture's path is cut off");
    if (**out == '#')
        return name_image(file, *out, out);
    if (**out != '/')
        return fmt_tris_damaged(file, "a texture's path is not absolute");
    return note_texture(file, *out);
}

/* Takes how an image wraps, and whether it is sRGB, out of the bits of a source. Returns false if
 * there are unknown bits. */
static bool take_wrap(uint32_t *bits, struct fmt_uv *out)
{
    const uint32_t wraps = *bits >> TRIS_WRAP_SHIFT;
    *bits &= (1u << TRIS_WRAP_SHIFT) - 1;
    out->wrap[0] = wraps & 3;
    out->wrap[1] = wraps >> 2 & 3;
    out->srgb = wraps >> 4 & 1;
    return wraps < 32 && out->wrap[0] < FMT_WRAPS && out->wrap[1] < FMT_WRAPS;
}

static bool tris_all_finite(const float *values, int count)
{
    float poison = 0.0f;
    for (int i = 0; i < count; i++)
        poison += values[i] * 0.0f;
    return poison == 0.0f;
}

/* Reads what a material and a channel of one have first: sets all of *out. Its component are flags
 * of a material, or the component of a channel, at most `most`. */
static int parse_source(struct fmt_tris_file *file, struct cursor *cursor, uint32_t most,
                        struct fmt_tris_source *out)
{
    struct tris_source_entry entry;
    if (!tris_take(cursor, &entry, sizeof entry))
        return fmt_tris_damaged(file, "the materials are cut off");
    const float *scale = entry.scale, *offset = entry.offset;
    const bool known = take_wrap(&entry.bits, &out->uv);
    if (!known || entry.bits > most)
        return fmt_tris_damaged(file, "a material has unknown flags");
    if (!tris_all_finite(entry.value, 3) || !tris_all_finite(scale, 2) ||
        !tris_all_finite(offset, 2))
        return fmt_tris_damaged(file, "a value of a material is not finite");
    out->component = entry.bits;
    out->uv.moves = scale[0] != 1 || scale[1] != 1 || offset[0] != 0 || offset[1] != 0;
    memcpy(out->value, entry.value, sizeof out->value);
    memcpy(out->uv.scale, scale, sizeof out->uv.scale);
    memcpy(out->uv.offset, offset, sizeof out->uv.offset);
    return parse_path(file, cursor, entry.path_bytes, &out->texture_path);
}

/* Reads a name, which has its length before it. Returns false if it is cut off. */
static bool take_name(struct cursor *cursor, char **out)
{
    uint32_t length;
    return tris_take(cursor, &length, sizeof length) && take_text(cursor, length, out);
}

static int parse_material(struct fmt_tris_file *file, struct cursor *cursor,
                          struct fmt_tris_material *m)
{
    const uint32_t count = file->header.channel_count;
    struct fmt_tris_source own = {0};
    BSQ_PASS(parse_source(file, cursor, TRIS_COLORLESS | TRIS_TINTED, &own));
    memcpy(m->diffuse, own.value, sizeof m->diffuse);
    m->colorless = own.component & TRIS_COLORLESS;
    m->tinted = own.component & TRIS_TINTED;
    m->uv = own.uv;
    m->texture_path = own.texture_path;
    if (!take_name(cursor, &m->name))
        return fmt_tris_damaged(file, "a material's name is cut off");
    m->sources = count > 0 ? file->sources + (m - file->header.materials) * (ptrdiff_t)count : NULL;
    for (uint32_t c = 0; c < count; c++)
        BSQ_PASS(parse_source(file, cursor, FMT_CHANNEL_COMPONENTS - 1, &m->sources[c]));
    return 0;
}

/* Reads the names of channels, no two of which are equal. */
static int parse_channels(struct fmt_tris_file *file, uint32_t count, struct cursor *cursor)
{
    struct fmt_tris_header *header = &file->header;
    BSQ_PASS(BSQ_CALLOC(file->ctx, "channels", count + UINT64_C(1), &header->channels));
    for (char *name; header->channel_count < count;) {
        if (!take_name(cursor, &name) || !fmt_is_channel_name(name) ||
            fmt_tris_find_channel(header, name) != UINT32_MAX)
            return fmt_tris_damaged(file, "the name of a channel is none");
        header->channels[header->channel_count++] = name;
    }
    return 0;
}

static int parse_materials(struct fmt_tris_file *file, const struct tris_file_header *h)
{
    const uint64_t bytes = h->table_offset - h->materials_offset, count = h->material_count;
    struct cursor cursor = {.from = file->tail, .bytes = bytes};
    /* The header's check has shown that nothing here has many times the bytes of the part. */
    BSQ_PASS(BSQ_CALLOC(file->ctx, "materials", count + 1, &file->header.materials));
    BSQ_PASS(BSQ_CALLOC(file->ctx, "channels", count * h->channel_count + 1, &file->sources));
    /* Each path and name loses the length before it and gains a terminator, so all fit `bytes`. */
    BSQ_PASS(bsq_alloc(file->ctx, "materials", bytes + 1, 1, &file->paths));
    cursor.text = file->paths;
    BSQ_PASS(parse_channels(file, h->channel_count, &cursor));
    for (uint32_t i = 0; i < count; i++) {
        BSQ_PASS(i % 1024 == 0 ? bsq_check(file->ctx) : 0);
        BSQ_PASS(parse_material(file, &cursor, &file->header.materials[i]));
    }
    if (bsq_align_up(cursor.at, 8) != bytes)
        return fmt_tris_damaged(file, "the materials have another length");
    while (cursor.at < bytes)
        if (file->tail[cursor.at++] != 0)
            return fmt_tris_damaged(file, "the padding after the materials is not zero");
    return 0;
}

static bool bounds_valid(const float min[3], const float max[3])
{
    for (int axis = 0; axis < 3; axis++)
        if (!isfinite(min[axis]) || !isfinite(max[axis]) || min[axis] > max[axis])
            return false;
    return true;
}

static bool chunk_info_valid(uint32_t attributes, const struct fmt_tris_chunk_info *info)
{
    uint32_t nt = info->triangle_count, nv = info->vertex_count;
    return nt > 0 && nt <= FMT_TRIS_CHUNK_TRIANGLES && nv > 0 && nv <= 3 * nt &&
           info->size_bytes == tris_chunk_layout(attributes, nt, nv).bytes &&
           (attributes & FMT_TRIS_SAMPLES || info->sample_checksum == 0) &&
           bounds_valid(info->bounds_min, info->bounds_max);
}

/* Checks the places of normals, which follow each other: those of all vertices, then all creases.
 * chunks_end: where the chunks end. */
static int check_normals_places(struct fmt_tris_file *file, const struct tris_file_header *h,
                                uint64_t chunks_end)
{
    const bool made = h->made_normals != 0;
    uint64_t normals = chunks_end, creases = chunks_end;
    bool valid = true;
    for (uint64_t i = 0; i < h->chunk_count && made; i++)
        creases += file->chunks[i].vertex_count * sizeof(uint64_t);
    for (uint64_t i = 0; i < h->chunk_count; i++) {
        const struct fmt_tris_chunk_info *info = &file->chunks[i];
        valid &= info->normals_offset == (made ? normals : 0) &&
                 info->creases_offset == (made ? creases : 0) &&
                 (made || info->normals_checksum == 0) &&
                 info->crease_count <= (made ? info->vertex_count : 0) && info->reserved == 0;
        normals += info->vertex_count * sizeof(uint64_t);
        creases += info->crease_count * sizeof(struct fmt_tris_crease);
        if (made && fmt_tris_normals_size(info) > file->normals_size_max)
            file->normals_size_max = fmt_tris_normals_size(info);
    }
    if (!valid)
        return fmt_tris_damaged(file, "the places of normals are not valid");
    return creases == h->materials_offset
               ? 0
               : fmt_tris_damaged(file, "the chunk table does not cover the file");
}

static int parse_table(struct fmt_tris_file *file, const struct tris_file_header *h)
{
    BSQ_PASS(BSQ_ALLOC(file->ctx, "chunk table", h->chunk_count + 1, &file->chunks));
    memcpy(file->chunks, file->tail + (h->table_offset - h->materials_offset),
           h->chunk_count * sizeof *file->chunks);
    uint64_t offset = h->chunks_offset, triangles = 0;
    for (uint64_t i = 0; i < h->chunk_count; i++) {
        const struct fmt_tris_chunk_info *info = &file->chunks[i];
        if (info->offset != offset || info->first_triangle != triangles ||
            !chunk_info_valid(h->attributes, info))
            return bsq_fail(file->ctx, BSQ_EDATA,
                            "%s: damaged chunk file: entry %" PRIu64 " of the table is not valid",
                            file->file.path, i);
        offset += info->size_bytes;
        triangles += info->triangle_count;
        uint64_t bytes = tris_load_size(h->attributes, info);
        if (bytes > file->load_size_max)
            file->load_size_max = bytes;
    }
    if (triangles != h->triangle_count)
        return fmt_tris_damaged(file, "the chunk table does not cover the file");
    return check_normals_places(file, h, offset);
}

static int check_bounds(const struct fmt_tris_file *file)
{
    const struct fmt_tris_header *h = &file->header;
    for (int axis = 0; axis < 3; axis++)
        if (!isfinite(h->origin[axis]))
            return fmt_tris_damaged(file, "the origin is not finite");
    if (!bounds_valid(h->bounds_min, h->bounds_max))
        return fmt_tris_damaged(file, "the bounds are not valid");
    for (uint64_t i = 0; i < h->chunk_count; i++)
        for (int axis = 0; axis < 3; axis++)
            if (file->chunks[i].bounds_min[axis] < h->bounds_min[axis] ||
                file->chunks[i].bounds_max[axis] > h->bounds_max[axis])
                return fmt_tris_damaged(file, "a chunk is outside of the bounds");
    return 0;
}

static int open_parts(struct fmt_tris_file *file)
{
    struct tris_file_header h = {0};
    uint64_t got;
    BSQ_PASS(bsq_file_read_some(file->ctx, &file->file, &h, sizeof h, 0, &got));
    if (memcmp(h.magic, TRIS_MAGIC, got < sizeof h.magic ? got : sizeof h.magic) != 0)
        return bsq_fail(file->ctx, BSQ_EDATA, "%s: not a chunk file", file->file.path);
    if (got >= offsetof(struct tris_file_header, attributes))
        BSQ_PASS(tris_check_version(file, h.version));
    if (got < sizeof h)
        return fmt_tris_damaged(file, "the header is cut off");
    BSQ_PASS(tris_check_header(file, &h));
    copy_header(file, &h);
    BSQ_PASS(read_tail(file, &h));
    BSQ_PASS(parse_materials(file, &h));
    BSQ_PASS(parse_table(file, &h));
    return check_bounds(file);
}

/* Takes ownership of `input`, also on failure. */
static int tris_open_file(struct bsq_ctx *ctx, struct bsq_file *input, struct fmt_tris_file **out)
{
    struct fmt_tris_file *file;
    int status = BSQ_CALLOC(ctx, "chunk file", 1, &file);
    if (status < 0) {
        bsq_file_close(ctx, input);
        return status;
    }
    file->ctx = ctx;
    file->file = *input;
    status = open_parts(file);
    bsq_free(ctx, file->tail);
    file->tail = NULL;
    if (status < 0)
        fmt_tris_close(file);
    else
        *out = file;
    return status;
}

int fmt_tris_open(struct bsq_ctx *ctx, const char *path, struct fmt_tris_file **out)
{
    struct bsq_file input;
    *out = NULL;
    BSQ_PASS(bsq_file_open(ctx, path, &input));
    return tris_open_file(ctx, &input, out);
}

int fmt_tris_open_temp(struct bsq_ctx *ctx, const struct bsq_file *temp, struct fmt_tris_file **out)
{
    struct bsq_file input;
    *out = NULL;
    BSQ_PASS(bsq_file_duplicate(ctx, temp, &input));
    return tris_open_file(ctx, &input, out);
}

void fmt_tris_release(struct fmt_tris_file *file)
{
    bsq_file_close(file->ctx, &file->file);
}

void fmt_tris_close(struct fmt_tris_file *file)
{
    if (!file)
        return;
    struct bsq_ctx *ctx = file->ctx;
    bsq_file_close(ctx, &file->file);
    BSQ_FREE(ctx, file->header.materials, file->header.channels, file->sources, file->chunks,
             file->paths);
    for (uint64_t i = 0; i < file->image_count; i++)
        bsq_free(ctx, file->images[i]);
    BSQ_FREE(ctx, file->images, file);
}

const char *fmt_tris_normals_text(enum bsq_scan_normals weights)
{
    return weights == BSQ_SCAN_NORMALS_AREA    ? "area"
           : weights == BSQ_SCAN_NORMALS_ANGLE ? "angle"
           : weights == BSQ_SCAN_NORMALS_MAX   ? "max"
                                               : NULL;
}

bool fmt_tris_has_images(const struct fmt_tris_file *file)
{
    return file->image_count > 0;
}

const struct fmt_tris_header *fmt_tris_get_header(const struct fmt_tris_file *file)
{
    return &file->header;
}

uint64_t fmt_tris_checksum(const struct fmt_tris_file *file)
{
    return file->checksum;
}

const struct fmt_tris_chunk_info *fmt_tris_chunks(const struct fmt_tris_file *file)
{
    return file->chunks;
}
