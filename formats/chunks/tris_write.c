/* tris_write.c - writes a chunk file: chunks in order, then materials and table, the header last.
 *
 * Attributes are stored as successive arrays, so that a reader can use them in place. Only indices
 * change: they are stored in 16 bits if the vertex count allows it. Encoding needs no state, so
 * workers encode chunks while one thread appends them.
 *
 * The chunks determine the header's counts and bounds, so the header is known only at the end.
 * Until then its place holds zeros, which no reader accepts. */
#include "formats/material/channels.h"
#include "formats/chunks/tris_internal.h"

#include "formats/material/file_extent.h"
#include "formats/material/tile_files.h"

#include <inttypes.h>
#include <math.h>
#include <xxhash.h>

const struct tris_attribute fmt_tris_attributes[TRIS_ATTRIBUTE_COUNT] = {
    {FMT_TRIS_NORMALS, 4, false, offsetof(struct fmt_tris_chunk, normals)},
    {FMT_TRIS_TEXCOORDS, 8, false, offsetof(struct fmt_tris_chunk, texcoords)},
    {FMT_TRIS_COLORS, 4, false, offsetof(struct fmt_tris_chunk, colors)},
    {FMT_TRIS_FINE_COLORS, 4, false, offsetof(struct fmt_tris_chunk, fine_colors)},
    {FMT_TRIS_MATERIALS, 4, true, offsetof(struct fmt_tris_chunk, materials)},
    {FMT_TRIS_SAMPLES, 0, false, offsetof(struct fmt_tris_chunk, samples)},
};

static uint32_t wrap_bits(const struct fmt_uv *uv)
{
    return (uint32_t)(uv->wrap[0] | uv->wrap[1] << 2 | uv->srgb << 4) << TRIS_WRAP_SHIFT;
}

uint32_t fmt_tris_find_channel(const struct fmt_tris_header *header, const char *name)
{
    for (uint32_t c = 0; c < header->channel_count; c++)
        if (strcmp(header->channels[c], name) == 0)
            return c;
    return UINT32_MAX;
}

/* ---- chunks ---- */

uint64_t fmt_tris_encoded_bound(uint32_t attributes, uint32_t triangle_count, uint32_t vertex_count)
{
    return tris_chunk_layout(attributes, triangle_count, vertex_count).bytes;
}

static int chunk_bounds(struct bsq_ctx *ctx, const struct fmt_tris_chunk *chunk,
                        struct fmt_tris_chunk_info *info)
{
    float low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
    float poison[3] = {0}; /* becomes NaN with the first value that is not finite */
    for (uint32_t v = 0; v < chunk->vertex_count; v++)
        for (int axis = 0; axis < 3; axis++) {
            float p = chunk->positions[v][axis];
            poison[axis] += p * 0.0f;
            low[axis] = p < low[axis] ? p : low[axis];
            high[axis] = p > high[axis] ? p : high[axis];
        }
    memcpy(info->bounds_min, low, sizeof low);
    memcpy(info->bounds_max, high, sizeof high);
    if (poison[0] + poison[1] + poison[2] != 0.0f)
        return bsq_fail(ctx, BSQ_EBUG, "a chunk has a vertex position that is not finite");
    return 0;
}

static int store_indices(struct bsq_ctx *ctx, const struct fmt_tris_chunk *chunk,
                         const struct tris_layout *layout, uint8_t *to)
{
    const uint32_t *from = &chunk->triangles[0][0];
    uint32_t count = 3 * chunk->triangle_count, max = 0;
    for (uint32_t i = 0; i < count; i++)
        max = from[i] > max ? from[i] : max;
    if (max >= chunk->vertex_count)
        return bsq_fail(ctx, BSQ_EBUG, "a chunk refers to vertex %u, it has %u", max,
                        chunk->vertex_count);
    if (layout->short_indices) {
        uint16_t *indices = (uint16_t *)(void *)to;
        for (uint32_t i = 0; i < count; i++)
            indices[i] = (uint16_t)from[i];
    } else {
        memcpy(to, from, (size_t)count * 4);
    }
    return 0;
}

int fmt_tris_encode(struct bsq_ctx *ctx, uint32_t attributes, const struct fmt_tris_chunk *chunk,
                    void *buffer, uint64_t *size, struct fmt_tris_chunk_info *info)
{
    uint32_t nt = chunk->triangle_count, nv = chunk->vertex_count;
    if (nt == 0 || nt > FMT_TRIS_CHUNK_TRIANGLES || nv == 0 || nv > 3 * nt)
        return bsq_fail(ctx, BSQ_EBUG, "a chunk of %u triangles and %u vertices", nt, nv);
    struct tris_layout l = tris_chunk_layout(attributes, nt, nv);
    uint8_t *bytes = buffer;
    memset(info, 0, sizeof *info);
    BSQ_PASS(chunk_bounds(ctx, chunk, info));
    memcpy(bytes, chunk->positions, (size_t)12 * nv);
    struct fmt_tris_chunk in_file = *chunk;
    in_file.positions = (const float(*)[3])(const void *)bytes;
    for (int i = 0; i < TRIS_ATTRIBUTE_COUNT; i++) {
        const struct tris_attribute *attribute = &fmt_tris_attributes[i];
        const void *values;
        memcpy(&values, (const char *)chunk + attribute->member, sizeof values);
        const uint64_t size_bytes = tris_values_bytes(attribute, nt, nv);
        if (attributes & attribute->flag && attribute->bytes > 0) {
            memcpy(bytes + l.values[i], values, size_bytes);
        } else if (attributes & attribute->flag) {
            fmt_tris_make_sample(&in_file, info, bytes + l.values[i]);
            info->sample_checksum = XXH3_64bits(bytes + l.values[i], size_bytes);
        }
    }
    BSQ_PASS(store_indices(ctx, chunk, &l, bytes + l.triangles));
    memset(bytes + l.end, 0, l.bytes - l.end);
    info->checksum = XXH3_64bits(bytes, l.bytes);
    info->size_bytes = *size = l.bytes;
    info->triangle_count = nt;
    info->vertex_count = nv;
    return 0;
}

/* ---- the writer ---- */

void fmt_tris_discard(struct fmt_tris_writer *writer)
{
    if (!writer)
        return;
    bsq_output_discard(writer->output);
    BSQ_FREE(writer->ctx, writer->materials, writer->table);
    for (uint64_t i = 0; i < writer->image_count; i++)
        bsq_free(writer->ctx, writer->images[i].name);
    BSQ_FREE(writer->ctx, writer->images, writer);
}

/* ---- images ---- */

static const char *tris_find_image(const struct fmt_tris_writer *writer, const char *path)
{
    for (uint64_t i = 0; i < writer->image_count; i++)
        if (strcmp(writer->images[i].path, path) == 0)
            return writer->images[i].name;
    return NULL;
}

/* Writes bytes of the images part, and adds them to its checksum. */
static int write_image_bytes(struct fmt_tris_writer *writer, XXH3_state_t *hash, const void *bytes,
                             uint64_t size)
{
    XXH3_64bits_update(hash, bytes, size);
    return bsq_output_write(writer->output, bytes, size);
}

/* Copies the image at `path` into the file, unless it is there or is one of several tiles. */
static int embed(struct fmt_tris_writer *writer, const char *path, XXH3_state_t *hash)
{
    static const uint8_t zeros[8];
    uint8_t buffer[16384];
    struct fmt_extent from, to = {.offset = bsq_output_tell(writer->output)};
    struct bsq_file file = BSQ_FILE_CLOSED;
    int status = 0;
    if (!path || fmt_has_tiles(path) || tris_find_image(writer, path))
        return 0;
    BSQ_TRY(BSQ_GROW(writer->ctx, "images", writer->image_count + 1, &writer->images,
                     &writer->image_capacity));
    BSQ_TRY(fmt_extent_open(writer->ctx, path, &from, &file));
    to.size = from.size;
    for (uint64_t at = 0, size; at < from.size; at += size) {
        size = from.size - at < sizeof buffer ? from.size - at : sizeof buffer;
        BSQ_TRY(bsq_check(writer->ctx));
        BSQ_TRY(fmt_extent_read(writer->ctx, &file, &from, buffer, size, at));
        BSQ_TRY(write_image_bytes(writer, hash, buffer, size));
    }
    BSQ_TRY(bsq_file_check(writer->ctx, &file));
    BSQ_TRY(write_image_bytes(writer, hash, zeros, bsq_align_up(from.size, 8) - from.size));
    BSQ_TRY(fmt_extent_name(writer->ctx, "", &to, &writer->images[writer->image_count].name));
    writer->images[writer->image_count++].path = path;
done:
    bsq_file_close(writer->ctx, &file);
    return status;
}

/* Copies the images of all materials, unless the file has no name to find them by. */
static int embed_all(struct fmt_tris_writer *writer, const struct fmt_tris_header *header)
{
    XXH3_state_t *hash = XXH3_createState();
    const bool any = header->embeds_images && !writer->temporary;
    int status = 0;
    if (!hash || XXH3_64bits_reset(hash) != XXH_OK) {
        XXH3_freeState(hash);
        return bsq_fail(writer->ctx, BSQ_ENOMEM, "no memory for the checksum of images");
    }
    for (uint32_t m = 0; m < header->material_count && any; m++) {
        BSQ_TRY(embed(writer, header->materials[m].texture_path, hash));
        for (uint32_t c = 0; c < header->channel_count; c++)
            BSQ_TRY(embed(writer, header->materials[m].sources[c].texture_path, hash));
    }
    writer->header.images_checksum = XXH3_64bits_digest(hash);
    writer->header.chunks_offset = bsq_output_tell(writer->output);
done:
    XXH3_freeState(hash);
    return status;
}

/* ---- materials ---- */

/* Appends bytes to the materials. */
static int tris_put(struct fmt_tris_writer *writer, const void *from, uint64_t bytes)
{
    BSQ_PASS(bsq_grow(writer->ctx, "materials", writer->materials_bytes + bytes, 1,
                      &writer->materials, &writer->materials_capacity));
    if (bytes > 0)
        memcpy(writer->materials + writer->materials_bytes, from, bytes);
    writer->materials_bytes += bytes;
    return 0;
}

static uint64_t text_bytes(const char *text)
{
    return text ? strlen(text) : 0;
}

/* Appends an entry, which has the length of a text, and the text; NULL: "". */
static int put_text(struct fmt_tris_writer *writer, const void *entry, uint64_t bytes,
                    const char *text)
{
    const uint64_t length = text_bytes(text);
    if (length >= TRIS_NO_PATH)
        return bsq_fail(writer->ctx, BSQ_EUSAGE, "a material's name or path has %" PRIu64 " bytes",
                        length);
    BSQ_PASS(tris_put(writer, entry, bytes));
    return tris_put(writer, text, length);
}

/* Appends what a material and a channel of one have first. bits: beside those of `uv`. */
static int put_source(struct fmt_tris_writer *writer, const float value[3], uint32_t bits,
                      const struct fmt_uv *uv, const char *texture_path)
{
    const char *image = texture_path ? tris_find_image(writer, texture_path) : NULL;
    const char *path = image ? image : texture_path;
    struct tris_source_entry entry = {.value = {value[0], value[1], value[2]},
                                      .bits = bits | wrap_bits(uv),
                                      .scale = {1, 1},
                                      .path_bytes = path ? (uint32_t)strlen(path) : TRIS_NO_PATH};
    if (uv->moves) {
        memcpy(entry.scale, uv->scale, sizeof entry.scale);
        memcpy(entry.offset, uv->offset, sizeof entry.offset);
    }
    return put_text(writer, &entry, sizeof entry, path);
}

static int put_name(struct fmt_tris_writer *writer, const char *name)
{
    const uint32_t length = (uint32_t)text_bytes(name);
    return put_text(writer, &length, sizeof length, name);
}

static int put_material(struct fmt_tris_writer *writer, const struct fmt_tris_material *m,
                        uint32_t channel_count)
{
    const uint32_t flags = (m->colorless ? TRIS_COLORLESS : 0u) | (m->tinted ? TRIS_TINTED : 0u);
    BSQ_PASS(put_source(writer, m->diffuse, flags, &m->uv, m->texture_path));
    BSQ_PASS(put_name(writer, m->name));
    for (uint32_t c = 0; c < channel_count; c++) {
        const struct fmt_tris_source *s = &m->sources[c];
        BSQ_PASS(put_source(writer, s->value, s->component, &s->uv, s->texture_path));
    }
    return 0;
}

static int encode_materials(struct fmt_tris_writer *writer, const struct fmt_tris_header *header)
{
    static const char zeros[8];
    for (uint32_t c = 0; c < header->channel_count; c++)
        BSQ_PASS(put_name(writer, header->channels[c]));
    for (uint32_t i = 0; i < header->material_count; i++)
        BSQ_PASS(put_material(writer, &header->materials[i], header->channel_count));
    return tris_put(writer, zeros,
                    bsq_align_up(writer->materials_bytes, 8) - writer->materials_bytes);
}

/* ---- the file ---- */

/* Creates the file `path` or, if `path` is NULL, a temporary file beside the file `beside`. */
static int tris_create(struct bsq_ctx *ctx, const char *path, const char *beside,
                       const struct fmt_tris_header *header, struct fmt_tris_writer **out)
{
    static const struct tris_file_header zeros;
    struct fmt_tris_writer *writer = NULL;
    int status;
    *out = NULL;
    BSQ_TRY(BSQ_CALLOC(ctx, "chunk file", 1, &writer));
    writer->ctx = ctx;
    writer->temporary = !path;
    struct tris_file_header *h = &writer->header;
    memcpy(h->magic, TRIS_MAGIC, sizeof h->magic);
    h->version = FMT_TRIS_VERSION;
    h->attributes = header->attributes;
    h->source_faces = header->source_faces;
    h->material_count = header->material_count;
    h->channel_count = header->channel_count;
    h->ids = header->ids;
    memcpy(h->origin, header->origin, sizeof h->origin);
    BSQ_TRY(path ? bsq_output_open(ctx, path, &writer->output)
                 : bsq_output_open_temp(ctx, beside, "chunks", &writer->output));
    BSQ_TRY(bsq_output_write(writer->output, &zeros, sizeof zeros));
    BSQ_TRY(embed_all(writer, header));
    BSQ_TRY(encode_materials(writer, header));
    *out = writer;
    return 0;
done:
    fmt_tris_discard(writer);
    return status;
}

int fmt_tris_create(struct bsq_ctx *ctx, const char *path, const struct fmt_tris_header *header,
                    struct fmt_tris_writer **out)
{
    return tris_create(ctx, path, NULL, header, out);
}

int fmt_tris_create_temp(struct bsq_ctx *ctx, const char *beside,
                         const struct fmt_tris_header *header, struct fmt_tris_writer **out)
{
    return tris_create(ctx, NULL, beside, header, out);
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
    BSQ_PASS(BSQ_GROW(writer->ctx, "chunk table", h->chunk_count + 1, &writer->table,
                      &writer->table_capacity));
    struct fmt_tris_chunk_info *entry = &writer->table[h->chunk_count];
    *entry = *info;
    entry->normals_offset = entry->creases_offset = entry->normals_checksum = 0;
    entry->crease_count = entry->reserved = 0;
    entry->offset = bsq_output_tell(writer->output);
    entry->size_bytes = size;
    entry->first_triangle = h->triangle_count;
    BSQ_PASS(bsq_output_write(writer->output, encoded, size));
    extend_bounds(h, info);
    h->chunk_count++;
    h->triangle_count += info->triangle_count;
    return 0;
}

void fmt_tris_skip(struct fmt_tris_writer *writer, uint64_t triangles)
{
    writer->header.skipped_triangles += triangles;
}

/* Writes materials, table and header. */
static int tris_finish(struct fmt_tris_writer *writer)
{
    struct tris_file_header *h = &writer->header;
    const uint64_t table_bytes = h->chunk_count * sizeof *writer->table;
    h->materials_offset = bsq_output_tell(writer->output);
    h->table_offset = h->materials_offset + writer->materials_bytes;
    h->file_bytes = h->table_offset + table_bytes;
    h->materials_checksum = XXH3_64bits(writer->materials, writer->materials_bytes);
    h->table_checksum = XXH3_64bits(writer->table, table_bytes);
    h->header_checksum = XXH3_64bits(h, offsetof(struct tris_file_header, header_checksum));
    BSQ_PASS(bsq_output_write(writer->output, writer->materials, writer->materials_bytes));
    BSQ_PASS(bsq_output_write(writer->output, writer->table, table_bytes));
    return bsq_output_write_at(writer->output, h, sizeof *h, 0);
}

int fmt_tris_commit(struct fmt_tris_writer *writer, struct bsq_file *out)
{
    int status;
    if (out)
        *out = (struct bsq_file)BSQ_FILE_CLOSED;
    BSQ_TRY(tris_finish(writer));
    if (out && !writer->temporary)
        BSQ_TRY(bsq_output_read(writer->output, out));
    status = writer->temporary ? bsq_output_keep_temp(writer->output, out)
                               : bsq_output_commit(writer->output);
    writer->output = NULL;
    if (status < 0 && out)
        bsq_file_close(writer->ctx, out);
done:
    fmt_tris_discard(writer);
    return status;
}
