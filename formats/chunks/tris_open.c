/* tris_open.c - opens a chunk file: its header, materials and table of chunks.
 *
 * Nothing in the file is trusted. Lengths are compared with the file's size before memory is
 * allocated, parts must follow each other without gaps, and a checksum covers each byte. */
#include "formats/chunks/tris_internal.h"
#include "base/channels.h"
#include "base/file_extent.h"
#include "base/job_files.h"
#include "base/path_map.h"
#include "base/tile_files.h"

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

static int check_header(const struct fmt_tris_file *file, const struct tris_file_header *h)
{
    if (h->version == __builtin_bswap32(FMT_TRIS_VERSION))
        return bsq_fail(
            file->ctx, BSQ_EDATA,
            "%s: chunk file with its bytes in big-endian order: Bisque reads little-endian ones",
            file->file.path);
    if (h->version < FMT_TRIS_VERSION || h->version > FMT_TRIS_VERSION_SAMPLES)
        return bsq_fail(file->ctx, BSQ_EDATA,
                        "%s: chunk file of version %" PRIu32
                        ", this program reads versions %u to %u",
                        file->file.path, h->version, FMT_TRIS_VERSION, FMT_TRIS_VERSION_SAMPLES);
    if (XXH3_64bits(h, offsetof(struct tris_file_header, header_checksum)) != h->header_checksum)
        return fmt_tris_damaged(file, "the header's checksum does not match");
    if (h->file_bytes != file->file.size)
        return bsq_fail(file->ctx, BSQ_EDATA,
                        "%s: damaged chunk file: it has %" PRIu64
                        " bytes, its header says %" PRIu64,
                        file->file.path, file->file.size, h->file_bytes);
    if ((h->attributes & ~TRIS_ATTRIBUTES) != 0 || h->reserved != 0)
        return fmt_tris_damaged(file, "unknown attributes");
    if (h->materials_offset < sizeof *h || h->table_offset < h->materials_offset ||
        h->file_bytes < h->table_offset || h->materials_offset % 8 != 0 || h->table_offset % 8 != 0)
        return fmt_tris_damaged(file, "parts of the file overlap");
    uint64_t table_bytes = h->file_bytes - h->table_offset;
    if (table_bytes % sizeof(struct fmt_tris_chunk_info) != 0 ||
        table_bytes / sizeof(struct fmt_tris_chunk_info) != h->chunk_count)
        return fmt_tris_damaged(file, "the chunk table has another length");
    if ((h->table_offset - h->materials_offset) / sizeof(struct tris_material_entry) <
        h->material_count)
        return fmt_tris_damaged(file, "too many materials");
    for (int axis = 0; axis < 3; axis++)
        if (!isfinite(h->origin[axis]))
            return fmt_tris_damaged(file, "the origin is not finite");
    return 0;
}

static void copy_header(struct fmt_tris_header *to, const struct tris_file_header *h)
{
    to->attributes = h->attributes;
    to->triangle_count = h->triangle_count;
    to->chunk_count = h->chunk_count;
    to->source_faces = h->source_faces;
    to->skipped_triangles = h->skipped_triangles;
    to->material_count = h->material_count;
    memcpy(to->origin, h->origin, sizeof to->origin);
    memcpy(to->bounds_min, h->bounds_min, sizeof to->bounds_min);
    memcpy(to->bounds_max, h->bounds_max, sizeof to->bounds_max);
}

static int read_tail(struct fmt_tris_file *file, const struct tris_file_header *h)
{
    uint64_t bytes = h->file_bytes - h->materials_offset;
    const uint64_t materials_bytes = h->table_offset - h->materials_offset;
    int status;
    BSQ_TRY(bsq_alloc(file->ctx, "chunk table", bytes + 1, 1, &file->tail));
    BSQ_TRY(fmt_tris_read_unchanged(file, file->tail, bytes, h->materials_offset));
    if (XXH3_64bits(file->tail, materials_bytes) != h->materials_checksum)
        return fmt_tris_damaged(file, "the materials' checksum does not match");
    if (XXH3_64bits(file->tail + materials_bytes, bytes - materials_bytes) != h->table_checksum)
        return fmt_tris_damaged(file, "the chunk table's checksum does not match");
done:
    return status;
}

/* Notes a texture among the job's inputs; for an extent of a file, that file. */
static int note_texture(const struct fmt_tris_file *file, char *path)
{
    struct bsq_extent extent;
    const size_t length = bsq_extent_parse(path, &extent);
    const char mark = path[length];
    if (length > 0)
        path[length] = '\0';
    int status = bsq_note_texture(file->ctx, path, "the texture that %s names", file->file.path);
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
static bool take(struct cursor *cursor, void *to, uint64_t bytes)
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
    if (!take(cursor, cursor->text, length) || memchr(*out, 0, length))
        return false;
    cursor->text[length] = '\0';
    cursor->text += length + 1;
    return true;
}

/* Names an image that lies in the file. The caller has checked that it has a name. */
static int name_image(struct fmt_tris_file *file, const char *range, char **out)
{
    const uint64_t size = strlen(file->file.path) + strlen(range) + 1;
    struct bsq_extent extent;
    char *name = NULL;
    int status;
    BSQ_TRY(bsq_grow(file->ctx, "images", file->image_count + 1, sizeof *file->images,
                     &file->images, &file->image_capacity));
    BSQ_TRY(bsq_alloc(file->ctx, "images", size, 1, &name));
    snprintf(name, size, "%s%s", file->file.path, range);
    file->images[file->image_count++] = *out = name;
    file->header.has_images = true;
    if (bsq_extent_parse(name, &extent) == 0 || extent.base64 ||
        extent.offset < sizeof(struct tris_file_header) || extent.size > file->file.size ||
        extent.offset > file->file.size - extent.size)
        return fmt_tris_damaged(file, "an image is not in the file");
done:
    return status;
}

/* Reads the path of a texture. */
static int parse_path(struct fmt_tris_file *file, struct cursor *cursor, uint32_t length,
                      char **out)
{
    char *path;
    if (length == TRIS_NO_PATH)
        return 0;
    if (!take_text(cursor, length, &path))
        return fmt_tris_damaged(file, "a texture's path is cut off");
    if (path[0] == '#')
        return name_image(file, path, out);
    if (path[0] != '/')
        return fmt_tris_damaged(file, "a texture's path is not absolute");
    *out = (char *)(uintptr_t)bsq_map_path(file->ctx, path);
    return *out ? note_texture(file, *out) : BSQ_ENOMEM;
}

/* Takes how an image wraps, and whether it is sRGB, out of the bits that version 4 has it in.
 * Returns false if there are unknown bits. */
static bool take_wrap(uint32_t version, uint32_t *bits, struct bsq_uv *out)
{
    const uint32_t wraps = *bits >> TRIS_WRAP_SHIFT;
    *bits &= (1u << TRIS_WRAP_SHIFT) - 1;
    out->wrap[0] = wraps & 3;
    out->wrap[1] = wraps >> 2 & 3;
    out->srgb = wraps >> 4 & 1;
    return wraps < (version < FMT_TRIS_VERSION_FACTORS ? 1 : 32) && out->wrap[0] < BSQ_WRAPS &&
           out->wrap[1] < BSQ_WRAPS;
}

/* Reads what version 2 has after a material's path. */
static int parse_name(const struct fmt_tris_file *file, uint32_t version, struct cursor *cursor,
                      struct fmt_tris_material *m)
{
    struct tris_name_entry entry;
    if (!take(cursor, &entry, sizeof entry) || !take_text(cursor, entry.name_bytes, &m->name))
        return fmt_tris_damaged(file, "a material's name is cut off");
    m->colorless = entry.flags & TRIS_COLORLESS;
    m->tinted = entry.flags & TRIS_TINTED;
    if (!take_wrap(version, &entry.flags, &m->uv) ||
        entry.flags >
            (version < FMT_TRIS_VERSION_FACTORS ? TRIS_COLORLESS : TRIS_COLORLESS | TRIS_TINTED))
        return fmt_tris_damaged(file, "a material has unknown flags");
    return 0;
}

static bool take_uv(const struct tris_uv_entry *entry, struct bsq_uv *out)
{
    const float *scale = entry->scale, *offset = entry->offset;
    out->moves = scale[0] != 1 || scale[1] != 1 || offset[0] != 0 || offset[1] != 0;
    memcpy(out->scale, scale, sizeof out->scale);
    memcpy(out->offset, offset, sizeof out->offset);
    return isfinite(scale[0]) && isfinite(scale[1]) && isfinite(offset[0]) && isfinite(offset[1]);
}

static int parse_source(struct fmt_tris_file *file, uint32_t version, struct cursor *cursor,
                        struct fmt_tris_source *out)
{
    struct tris_source_entry entry;
    if (!take(cursor, &entry, sizeof entry))
        return fmt_tris_damaged(file, "the channels of a material are cut off");
    memcpy(out->value, entry.value, sizeof out->value);
    const bool good = take_wrap(version, &entry.component, &out->uv);
    out->component = entry.component;
    if (!good || !isfinite(out->value[0]) || !isfinite(out->value[1]) || !isfinite(out->value[2]) ||
        out->component >= BSQ_CHANNEL_COMPONENTS || !take_uv(&entry.uv, &out->uv))
        return fmt_tris_damaged(file, "a channel of a material has a wrong value");
    if (version < FMT_TRIS_VERSION_FACTORS && entry.path_bytes != TRIS_NO_PATH &&
        out->component != BSQ_CHANNEL_CUTOUT)
        out->value[0] = out->value[1] = out->value[2] = 1;
    return parse_path(file, cursor, entry.path_bytes, &out->texture_path);
}

/* Reads what version 3 has after a material's name. */
static int parse_sources(struct fmt_tris_file *file, uint32_t version, struct cursor *cursor,
                         struct fmt_tris_material *m)
{
    const uint32_t count = file->header.channel_count;
    struct tris_uv_entry uv;
    if (!take(cursor, &uv, sizeof uv) || !take_uv(&uv, &m->uv))
        return fmt_tris_damaged(file, "a material's texture coordinates are not finite");
    m->sources = count > 0 ? file->sources + (m - file->header.materials) * (ptrdiff_t)count : NULL;
    int status = 0;
    for (uint32_t c = 0; c < count && status == 0; c++)
        status = parse_source(file, version, cursor, &m->sources[c]);
    return status;
}

static int parse_material(struct fmt_tris_file *file, uint32_t version, struct cursor *cursor,
                          struct fmt_tris_material *m)
{
    struct tris_material_entry entry;
    int status;
    if (!take(cursor, &entry, sizeof entry))
        return fmt_tris_damaged(file, "the materials are cut off");
    memcpy(m->diffuse, entry.diffuse, sizeof m->diffuse);
    if (!isfinite(m->diffuse[0]) || !isfinite(m->diffuse[1]) || !isfinite(m->diffuse[2]))
        return fmt_tris_damaged(file, "a material's colour is not finite");
    BSQ_TRY(parse_path(file, cursor, entry.path_bytes, &m->texture_path));
    if (version >= FMT_TRIS_VERSION_IDS)
        BSQ_TRY(parse_name(file, version, cursor, m));
    if (version >= FMT_TRIS_VERSION_CHANNELS)
        status = parse_sources(file, version, cursor, m);
done:
    return status;
}

static int parse_ids(struct fmt_tris_file *file, uint32_t version, struct cursor *cursor)
{
    struct tris_ids_entry entry;
    if (!take(cursor, &entry, sizeof entry) || entry.reserved != 0 ||
        (entry.ids == BSQ_IDS_NONE && version == FMT_TRIS_VERSION_IDS) || entry.ids > BSQ_IDS_COLOR)
        return fmt_tris_damaged(file, "unknown ids");
    file->header.ids = (enum bsq_ids)entry.ids;
    return 0;
}

/* Reads the name of a channel, which no channel before it has. */
static int parse_channel(struct fmt_tris_file *file, struct cursor *cursor)
{
    struct fmt_tris_header *header = &file->header;
    uint32_t length;
    char *name;
    if (!take(cursor, &length, sizeof length) || !take_text(cursor, length, &name) ||
        !bsq_is_channel_name(name) || fmt_tris_find_channel(header, name) != UINT32_MAX)
        return fmt_tris_damaged(file, "the name of a channel is none");
    header->channels[header->channel_count++] = name;
    return 0;
}

/* Reads the names of channels, and allocates the sources of all materials, for each of which the
 * file must have an entry. */
static int parse_channels(struct fmt_tris_file *file, const struct tris_file_header *h,
                          struct cursor *cursor)
{
    struct tris_channels_entry entry;
    uint64_t sources, bytes;
    if (!take(cursor, &entry, sizeof entry) || entry.reserved != 0 ||
        entry.channel_count > (cursor->bytes - cursor->at) / sizeof(uint32_t) ||
        __builtin_mul_overflow((uint64_t)entry.channel_count, h->material_count, &sources) ||
        __builtin_mul_overflow(sources, sizeof(struct tris_source_entry), &bytes) ||
        bytes > cursor->bytes - cursor->at)
        return fmt_tris_damaged(file, "the channels are cut off");
    int status;
    BSQ_TRY(bsq_calloc(file->ctx, "channels", sources + 1, sizeof *file->sources, &file->sources));
    BSQ_TRY(bsq_calloc(file->ctx, "channels", (uint64_t)entry.channel_count + 1,
                       sizeof *file->header.channels, &file->header.channels));
    for (uint32_t c = 0; c < entry.channel_count; c++)
        BSQ_TRY(parse_channel(file, cursor));
done:
    return status;
}

static int parse_materials(struct fmt_tris_file *file, const struct tris_file_header *h)
{
    const uint64_t bytes = h->table_offset - h->materials_offset;
    struct cursor cursor = {.from = file->tail, .bytes = bytes};
    int status;
    BSQ_TRY(bsq_calloc(file->ctx, "materials", (uint64_t)h->material_count + 1,
                       sizeof *file->header.materials, &file->header.materials));
    /* Each path and name loses the entry before it and gains a terminator, so all fit `bytes`. */
    BSQ_TRY(bsq_alloc(file->ctx, "materials", bytes + 1, 1, &file->paths));
    cursor.text = file->paths;
    if (h->version >= FMT_TRIS_VERSION_IDS)
        BSQ_TRY(parse_ids(file, h->version, &cursor));
    if (h->version >= FMT_TRIS_VERSION_CHANNELS)
        BSQ_TRY(parse_channels(file, h, &cursor));
    for (uint32_t i = 0; i < h->material_count; i++) {
        BSQ_TRY(i % 1024 == 0 ? bsq_check(file->ctx) : 0);
        BSQ_TRY(parse_material(file, h->version, &cursor, &file->header.materials[i]));
    }
    if (fmt_tris_version(&file->header) != h->version)
        return fmt_tris_damaged(file, "the version is higher than the content needs");
    if (bsq_align_up(cursor.at, 8) != bytes)
        return fmt_tris_damaged(file, "the materials have another length");
    while (cursor.at < bytes)
        if (file->tail[cursor.at++] != 0)
            return fmt_tris_damaged(file, "the padding after the materials is not zero");
done:
    return status;
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
           bounds_valid(info->bounds_min, info->bounds_max);
}

static int parse_table(struct fmt_tris_file *file, const struct tris_file_header *h)
{
    int status = bsq_alloc(file->ctx, "chunk table", h->chunk_count + 1, sizeof *file->chunks,
                           &file->chunks);
    if (status < 0)
        return status;
    memcpy(file->chunks, file->tail + (h->table_offset - h->materials_offset),
           h->chunk_count * sizeof *file->chunks);
    uint64_t offset = sizeof *h, triangles = 0;
    if (file->header.has_images && h->chunk_count > 0)
        offset = file->images_end = file->chunks[0].offset;
    if (offset % 8 != 0 || offset < sizeof *h || offset > h->materials_offset)
        return fmt_tris_damaged(file, "the images overlap other parts");
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
    if (offset != h->materials_offset || triangles != h->triangle_count)
        return fmt_tris_damaged(file, "the chunk table does not cover the file");
    return 0;
}

static int check_bounds(const struct fmt_tris_file *file)
{
    const struct fmt_tris_header *h = &file->header;
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
    struct tris_file_header h;
    uint64_t got;
    int status;
    BSQ_TRY(bsq_file_read_some(file->ctx, &file->file, &h, sizeof h, 0, &got));
    if (memcmp(h.magic, TRIS_MAGIC, got < sizeof h.magic ? got : sizeof h.magic) != 0)
        return bsq_fail(file->ctx, BSQ_EDATA, "%s: not a chunk file", file->file.path);
    if (got < sizeof h)
        return fmt_tris_damaged(file, "the header is cut off");
    BSQ_TRY(check_header(file, &h));
    copy_header(&file->header, &h);
    file->checksum = h.header_checksum;
    BSQ_TRY(read_tail(file, &h));
    BSQ_TRY(parse_materials(file, &h));
    BSQ_TRY(parse_table(file, &h));
    status = check_bounds(file);
done:
    return status;
}

/* Takes ownership of `input`, also on failure. */
static int open_file(struct bsq_ctx *ctx, struct bsq_file *input, struct fmt_tris_file **out)
{
    struct fmt_tris_file *file;
    int status = bsq_calloc(ctx, "chunk file", 1, sizeof *file, &file);
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
    int status = bsq_file_open(ctx, path, &input);
    return status < 0 ? status : open_file(ctx, &input, out);
}

int fmt_tris_open_temp(struct bsq_ctx *ctx, const struct bsq_file *temp, struct fmt_tris_file **out)
{
    struct bsq_file input;
    *out = NULL;
    int status = bsq_file_duplicate(ctx, temp, &input);
    return status < 0 ? status : open_file(ctx, &input, out);
}

void fmt_tris_close(struct fmt_tris_file *file)
{
    if (!file)
        return;
    struct bsq_ctx *ctx = file->ctx;
    fmt_tris_close_parts(file);
    bsq_file_close(ctx, &file->file);
    bsq_free(ctx, file->header.materials);
    bsq_free(ctx, file->header.channels);
    bsq_free(ctx, file->sources);
    bsq_free(ctx, file->chunks);
    bsq_free(ctx, file->paths);
    for (uint64_t i = 0; i < file->image_count; i++)
        bsq_free(ctx, file->images[i]);
    bsq_free(ctx, file->images);
    bsq_free(ctx, file);
}

const struct fmt_tris_header *fmt_tris_get_header(const struct fmt_tris_file *file)
{
    return &file->header;
}

const struct fmt_tris_chunk_info *fmt_tris_chunks(const struct fmt_tris_file *file)
{
    return file->chunks;
}
