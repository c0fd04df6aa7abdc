/* tris_write.c - writes a chunk file: chunks in order, then materials and table, the header last.
 *
 * The chunks determine the header's counts and bounds, so the header is known only at the end.
 * Until then its place holds zeros, which no reader accepts. */
#include "formats/chunks/tris_internal.h"

#include <math.h>
#include <string.h>
#include <xxhash.h>

uint32_t fmt_tris_version(const struct fmt_tris_header *header)
{
    bool moves = false;
    for (uint32_t i = 0; i < header->material_count; i++)
        moves |= header->materials[i].uv.moves;
    return header->channel_count > 0 || moves ? FMT_TRIS_VERSION_CHANNELS
           : header->ids != BSQ_IDS_NONE      ? FMT_TRIS_VERSION_IDS
                                              : FMT_TRIS_VERSION;
}

uint32_t fmt_tris_find_channel(const struct fmt_tris_header *header, const char *name)
{
    for (uint32_t c = 0; c < header->channel_count; c++)
        if (strcmp(header->channels[c], name) == 0)
            return c;
    return UINT32_MAX;
}

struct fmt_tris_writer {
    struct bsq_ctx *ctx;
    struct bsq_output *output;
    struct tris_file_header header;
    char *materials; /* as in the file */
    uint64_t materials_bytes;
    struct tris_table_entry *table;
    uint64_t table_capacity;
};

static void writer_free(struct fmt_tris_writer *writer)
{
    struct bsq_ctx *ctx = writer->ctx;
    bsq_free(ctx, writer->materials);
    bsq_free(ctx, writer->table);
    bsq_free(ctx, writer);
}

/* Copies bytes to *to and moves it past them. */
static void put(char **to, const void *from, size_t bytes)
{
    if (bytes > 0)
        memcpy(*to, from, bytes);
    *to += bytes;
}

static size_t text_length(const char *text)
{
    return text ? strlen(text) : 0;
}

/* Sets *bytes to the size of the materials part without its padding. */
static int measure_materials(const struct fmt_tris_writer *writer,
                             const struct fmt_tris_header *header, uint64_t *bytes)
{
    const bool channels = fmt_tris_version(header) == FMT_TRIS_VERSION_CHANNELS;
    const bool ids = header->ids != BSQ_IDS_NONE || channels;
    *bytes = ids ? sizeof(struct tris_ids_record) : 0;
    *bytes += channels ? sizeof(struct tris_channels_record) : 0;
    for (uint32_t c = 0; c < header->channel_count; c++)
        *bytes += sizeof(uint32_t) + strlen(header->channels[c]);
    for (uint32_t i = 0; i < header->material_count; i++) {
        const size_t path = text_length(header->materials[i].texture_path);
        const size_t name = text_length(header->materials[i].name);
        if (path >= TRIS_NO_PATH || name >= UINT32_MAX)
            return bsq_fail(writer->ctx, BSQ_EUSAGE, "a material's name or path has %zu bytes",
                            path > name ? path : name);
        *bytes += sizeof(struct tris_material_record) + path;
        *bytes += ids ? sizeof(struct tris_name_record) + name : 0;
        *bytes += channels ? sizeof(struct tris_uv_record) : 0;
        for (uint32_t c = 0; c < header->channel_count; c++) {
            const size_t source = text_length(header->materials[i].sources[c].texture_path);
            if (source >= TRIS_NO_PATH)
                return bsq_fail(writer->ctx, BSQ_EUSAGE, "a texture's path has %zu bytes", source);
            *bytes += sizeof(struct tris_source_record) + source;
        }
    }
    return 0;
}

static struct tris_uv_record uv_record(const struct bsq_uv *uv)
{
    static const struct tris_uv_record same = {{1, 1}, {0, 0}};
    return uv->moves ? (struct tris_uv_record){{uv->scale[0], uv->scale[1]},
                                               {uv->offset[0], uv->offset[1]}}
                     : same;
}

/* Writes what version 3 has after a material's name. */
static void put_channels(const struct fmt_tris_header *header, const struct fmt_tris_material *m,
                         char **to)
{
    const struct tris_uv_record uv = uv_record(&m->uv);
    put(to, &uv, sizeof uv);
    for (uint32_t c = 0; c < header->channel_count; c++) {
        const struct fmt_tris_source *source = &m->sources[c];
        const size_t path = text_length(source->texture_path);
        const struct tris_source_record record = {
            .value = {source->value[0], source->value[1], source->value[2]},
            .component = source->component,
            .uv = uv_record(&source->uv),
            .path_bytes = source->texture_path ? (uint32_t)path : TRIS_NO_PATH};
        put(to, &record, sizeof record);
        put(to, source->texture_path, path);
    }
}

/* named, channels: whether the file has names of materials, and values of channels. */
static void put_material(const struct fmt_tris_header *header, const struct fmt_tris_material *m,
                         bool named, bool channels, char **to)
{
    const size_t path = text_length(m->texture_path), name = text_length(m->name);
    const struct tris_material_record record = {{m->diffuse[0], m->diffuse[1], m->diffuse[2]},
                                                m->texture_path ? (uint32_t)path : TRIS_NO_PATH};
    const struct tris_name_record name_record = {m->colorless ? TRIS_COLORLESS : 0, (uint32_t)name};
    put(to, &record, sizeof record);
    put(to, m->texture_path, path);
    if (!named)
        return;
    put(to, &name_record, sizeof name_record);
    put(to, m->name, name);
    if (channels)
        put_channels(header, m, to);
}

static int encode_materials(struct fmt_tris_writer *writer, const struct fmt_tris_header *header)
{
    const struct tris_ids_record ids = {.ids = header->ids};
    uint64_t bytes;
    int status = measure_materials(writer, header, &bytes);
    if (status < 0)
        return status;
    writer->materials_bytes = bsq_align_up(bytes, 8);
    status =
        bsq_calloc(writer->ctx, "materials", writer->materials_bytes + 1, 1, &writer->materials);
    if (status < 0)
        return status;
    char *to = writer->materials;
    const struct tris_channels_record channels = {.channel_count = header->channel_count};
    const bool has_channels = fmt_tris_version(header) == FMT_TRIS_VERSION_CHANNELS;
    const bool has_names = ids.ids != BSQ_IDS_NONE || has_channels;
    if (has_names)
        put(&to, &ids, sizeof ids);
    if (has_channels)
        put(&to, &channels, sizeof channels);
    for (uint32_t c = 0; c < header->channel_count; c++) {
        const uint32_t length = (uint32_t)strlen(header->channels[c]);
        put(&to, &length, sizeof length);
        put(&to, header->channels[c], length);
    }
    for (uint32_t i = 0; i < header->material_count; i++)
        put_material(header, &header->materials[i], has_names, has_channels, &to);
    return 0;
}

/* Creates the file `path` or, if `path` is NULL, a temporary file beside the file `beside`. */
static int create(struct bsq_ctx *ctx, const char *path, const char *beside,
                  const struct fmt_tris_header *header, struct fmt_tris_writer **out)
{
    static const struct tris_file_header zeros;
    struct fmt_tris_writer *writer;
    *out = NULL;
    int status = bsq_calloc(ctx, "chunk file", 1, sizeof *writer, &writer);
    if (status < 0)
        return status;
    writer->ctx = ctx;
    struct tris_file_header *h = &writer->header;
    memcpy(h->magic, TRIS_MAGIC, sizeof h->magic);
    h->version = fmt_tris_version(header);
    h->attributes = header->attributes;
    h->source_faces = header->source_faces;
    h->material_count = header->material_count;
    memcpy(h->origin, header->origin, sizeof h->origin);
    if ((status = encode_materials(writer, header)) < 0 ||
        (status = path ? bsq_output_open(ctx, path, &writer->output)
                       : bsq_output_open_temp(ctx, beside, "chunks", &writer->output)) < 0 ||
        (status = bsq_output_write(writer->output, &zeros, sizeof zeros)) < 0) {
        fmt_tris_discard(writer);
        return status;
    }
    *out = writer;
    return 0;
}

int fmt_tris_create(struct bsq_ctx *ctx, const char *path, const struct fmt_tris_header *header,
                    struct fmt_tris_writer **out)
{
    return create(ctx, path, NULL, header, out);
}

int fmt_tris_create_temp(struct bsq_ctx *ctx, const char *beside,
                         const struct fmt_tris_header *header, struct fmt_tris_writer **out)
{
    return create(ctx, NULL, beside, header, out);
}

static void extend_bounds(struct tris_file_header *header, const struct fmt_tris_chunk_info *info)
{
    bool first = header->chunk_count == 0;
    for (int axis = 0; axis < 3; axis++) {
        if (first || info->bounds_min[axis] < header->bounds_min[axis])
            header->bounds_min[axis] = info->bounds_min[axis];
        if (first || info->bounds_max[axis] > header->bounds_max[axis])
            header->bounds_max[axis] = info->bounds_max[axis];
    }
}

int fmt_tris_append(struct fmt_tris_writer *writer, const void *encoded, uint64_t size,
                    const struct fmt_tris_chunk_info *info)
{
    struct tris_file_header *h = &writer->header;
    int status = bsq_grow(writer->ctx, "chunk table", h->chunk_count + 1, sizeof *writer->table,
                          &writer->table, &writer->table_capacity);
    if (status < 0)
        return status;
    struct tris_table_entry *entry = &writer->table[h->chunk_count];
    entry->offset = bsq_output_tell(writer->output);
    entry->size_bytes = size;
    entry->first_triangle = h->triangle_count;
    entry->triangle_count = info->triangle_count;
    entry->vertex_count = info->vertex_count;
    memcpy(entry->bounds_min, info->bounds_min, sizeof entry->bounds_min);
    memcpy(entry->bounds_max, info->bounds_max, sizeof entry->bounds_max);
    if ((status = bsq_output_write(writer->output, encoded, size)) < 0)
        return status;
    extend_bounds(h, info);
    h->chunk_count++;
    h->triangle_count += info->triangle_count;
    return 0;
}

void fmt_tris_skip(struct fmt_tris_writer *writer, uint64_t triangles)
{
    writer->header.skipped_triangles += triangles;
}

uint64_t fmt_tris_written(const struct fmt_tris_writer *writer)
{
    return bsq_output_tell(writer->output);
}

/* Writes materials, table and header. */
static int finish(struct fmt_tris_writer *writer)
{
    struct tris_file_header *h = &writer->header;
    uint64_t table_bytes = h->chunk_count * sizeof *writer->table;
    h->materials_offset = bsq_output_tell(writer->output);
    h->table_offset = h->materials_offset + writer->materials_bytes;
    h->file_bytes = h->table_offset + table_bytes;
    h->materials_checksum = XXH3_64bits(writer->materials, writer->materials_bytes);
    h->table_checksum = XXH3_64bits(writer->table, table_bytes);
    h->header_checksum = XXH3_64bits(h, offsetof(struct tris_file_header, header_checksum));
    int status;
    if ((status = bsq_output_write(writer->output, writer->materials, writer->materials_bytes)) <
            0 ||
        (status = bsq_output_write(writer->output, writer->table, table_bytes)) < 0 ||
        (status = bsq_output_write_at(writer->output, h, sizeof *h, 0)) < 0)
        return status;
    return 0;
}

int fmt_tris_commit(struct fmt_tris_writer *writer)
{
    int status = finish(writer);
    if (status < 0) {
        fmt_tris_discard(writer);
        return status;
    }
    status = bsq_output_commit(writer->output);
    writer_free(writer);
    return status;
}

int fmt_tris_commit_open(struct fmt_tris_writer *writer, struct bsq_file *out)
{
    *out = (struct bsq_file)BSQ_FILE_CLOSED;
    int status = finish(writer);
    if (status == 0)
        status = bsq_output_read(writer->output, out);
    if (status < 0) {
        fmt_tris_discard(writer);
        return status;
    }
    struct bsq_ctx *ctx = writer->ctx;
    status = bsq_output_commit(writer->output);
    writer_free(writer);
    if (status < 0)
        bsq_file_close(ctx, out);
    return status;
}

int fmt_tris_keep_temp(struct fmt_tris_writer *writer, struct bsq_file *out)
{
    *out = (struct bsq_file)BSQ_FILE_CLOSED;
    int status = finish(writer);
    if (status < 0) {
        fmt_tris_discard(writer);
        return status;
    }
    status = bsq_output_keep_temp(writer->output, out);
    writer_free(writer);
    return status;
}

void fmt_tris_discard(struct fmt_tris_writer *writer)
{
    if (!writer)
        return;
    bsq_output_discard(writer->output);
    writer_free(writer);
}
