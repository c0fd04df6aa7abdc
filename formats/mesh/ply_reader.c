/* ply_reader.c - reads PLY files as an ordered stream of parsed parts.
 *
 * Understood: text and binary of both byte orders, numbers of any type, elements in any order.
 * Vertices have positions, normals, colours and texture coordinates. Faces have any number of
 * corners, colours, texture coordinates of corners and a texture's number; "tristrips" are strips
 * of triangles. Other elements and properties are skipped. */
#include <inttypes.h>
#include <string.h>

#include "base/loss.h"
#include "formats/mesh/mesh_text.h"
#include "formats/mesh/ply_internal.h"
#include "formats/mesh/ply_roles.h"

/* ---- opening ---- */

static bool recognise(const char *head, size_t size)
{
    const size_t mark = fmt_mesh_mark(head, size);
    return size >= mark + 4 && memcmp(head + mark, "ply", 3) == 0 &&
           (head[mark + 3] == '\n' || head[mark + 3] == '\r');
}

/* Leaves the texture coordinates of vertices unread, for files whose corners have their own. */
static void drop_vertex_texcoords(struct ply_header *header)
{
    for (uint32_t e = 0; e < header->element_count; e++) {
        struct ply_element *element = &header->elements[e];
        if (element->kind != PLY_VERTICES)
            continue;
        for (uint32_t i = 0; i < element->property_count; i++) {
            struct ply_property *p = &header->properties[element->first_property + i];
            if (p->role == PLY_S || p->role == PLY_T)
                p->role = PLY_UNUSED;
        }
        element->role[PLY_S] = element->role[PLY_T] = NULL;
    }
}

/* Decides what the properties of a file's header are used for. */
static void choose_use(struct ply_source *source)
{
    const struct ply_element *vertices = fmt_ply_find_element(&source->header, PLY_VERTICES);
    const struct ply_element *faces = fmt_ply_find_element(&source->header, PLY_FACES);
    source->vertex_normals = vertices->role[PLY_NX] != NULL;
    source->corner_texcoords = faces && faces->role[PLY_CORNER_TEXCOORDS];
    if (source->corner_texcoords)
        drop_vertex_texcoords(&source->header);
    source->vertex_texcoords = vertices->role[PLY_S] != NULL;
    if (source->header.texture_count > 0 && (source->corner_texcoords || source->vertex_texcoords))
        source->tags = PLY_TAGS_TEXTURE;
    else if (faces && faces->role[PLY_RED] && !vertices->role[PLY_RED])
        source->tags = PLY_TAGS_COLOR;
}

static int read_header(struct stream_reader *stream, uint32_t number)
{
    struct ply_reader *reader = (struct ply_reader *)stream;
    struct bsq_ctx *ctx = reader->stream.base.ctx;
    struct ply_source *source = &reader->files[number];
    struct fmt_input *input = reader->stream.sources[number].input;
    int status = fmt_input_open(input);
    if (!status)
        status = fmt_ply_header_read(ctx, input, &source->header);
    int closed = fmt_input_close(input);
    status = status ? status : closed;
    if (status)
        return status;
    choose_use(source);
    source->texture_base = reader->texture_count;
    reader->texture_count += source->header.texture_count;
    return 0;
}

static void close_reader(struct fmt_mesh_reader *base)
{
    struct ply_reader *reader = (struct ply_reader *)base;
    for (uint32_t i = 0; reader->files && i < reader->stream.source_count; i++)
        fmt_ply_header_free(base->ctx, &reader->files[i].header);
    bsq_free(base->ctx, reader->files);
    fmt_ply_colors_free(base->ctx, &reader->colors);
    fmt_stream_free(&reader->stream);
}

/* ---- reading ---- */

/* Gives each corner the normal and texture coordinate of its vertex. */
static int copy_vertex_indices(struct bsq_ctx *ctx, const struct ply_source *source,
                               struct mesh_arrays *a)
{
    const bool wanted[FMT_MESH_KIND_COUNT] = {
        [FMT_MESH_NORMAL] = source->vertex_normals, [FMT_MESH_TEXCOORD] = source->vertex_texcoords};
    int status = 0;
    if (a->face_count == 0)
        return 0;
    for (enum fmt_mesh_kind kind = FMT_MESH_TEXCOORD; kind <= FMT_MESH_NORMAL && !status; kind++) {
        if (!wanted[kind])
            continue;
        status = fmt_arrays_reserve_corners(ctx, a, kind, a->corner_count);
        if (status)
            continue;
        a->has_corners[kind] = true;
        memcpy(a->corners[kind], a->corners[FMT_MESH_VERTEX], a->corner_count * sizeof(uint64_t));
    }
    return status;
}

static int parse(struct stream_reader *reader, struct stream_slot *slot)
{
    const struct ply_source *source = ply_source_of(reader, slot);
    const uint32_t number = slot->part.kind & ~PLY_PART_PIECE;
    if (slot->part.kind == PLY_PART_REST || source->header.elements[number].kind == PLY_OTHER)
        return 0;
    const struct ply_element *element = &source->header.elements[number];
    int status = fmt_stream_load(reader, slot);
    if (status)
        return status;
    status = source->header.encoding == PLY_ASCII
                 ? fmt_ply_parse_text(reader->base.ctx, source, element, slot)
                 : fmt_ply_parse_binary(reader->base.ctx, source, element, slot);
    return status ? status : copy_vertex_indices(reader->base.ctx, source, &slot->arrays);
}

/* Makes texture coordinates of corners count from the start of the file. */
static void number_texcoords(const struct stream_source *source, struct mesh_arrays *a)
{
    uint64_t *corners = a->corners[FMT_MESH_TEXCOORD];
    const uint64_t before = source->count[FMT_MESH_TEXCOORD];
    for (uint64_t i = 0; before > 0 && i < a->corner_count; i++)
        corners[i] = corners[i] == FMT_MESH_NONE ? FMT_MESH_NONE : corners[i] + before;
}

static bool is_blank(char c)
{
    return c == ' ' || c == '\t' || c == '\r' || c == '\n';
}

/* Warns of bytes after the last element, unless they are blank. */
static int warn_rest(struct ply_reader *reader, const struct stream_slot *slot)
{
    struct bsq_ctx *ctx = reader->stream.base.ctx;
    const struct stream_source *source = &reader->stream.sources[slot->part.source];
    const uint64_t bytes = slot->part.end - slot->part.offset;
    char sample[256];
    uint64_t got, blanks = 0;
    int status = fmt_input_read_some(source->input, sample, sizeof sample, slot->part.offset, &got);
    while (!status && blanks < got && is_blank(sample[blanks]))
        blanks++;
    if (!status && blanks < bytes && !reader->read_before)
        status = bsq_warn_loss(ctx, "%s: %" PRIu64 " bytes after the last element not read",
                               source->path, bytes);
    return status;
}

static void count_lost_textures(struct ply_reader *reader, const struct stream_slot *slot)
{
    if (reader->lost_textures == 0 && slot->lost_textures > 0) {
        reader->lost_texture_at = slot->lost_texture_at;
        reader->lost_texture_file = slot->part.source;
    }
    reader->lost_textures += slot->lost_textures;
}

static int pass(struct stream_reader *base, struct stream_slot *slot,
                struct fmt_mesh_totals *totals)
{
    struct ply_reader *reader = (struct ply_reader *)base;
    const struct ply_source *source = ply_source_of(base, slot);
    int status = 0;
    if (slot->part.kind == PLY_PART_REST)
        return warn_rest(reader, slot);
    reader->bad_normals += slot->bad_normals;
    reader->bad_colors += slot->bad_colors;
    reader->bad_texcoords += slot->bad_texcoords;
    reader->clamped_colors += slot->clamped_colors;
    reader->missing_positions += slot->missing_positions;
    reader->missing_texcoords += slot->missing_texcoords;
    count_lost_textures(reader, slot);
    if (source->corner_texcoords)
        number_texcoords(&base->sources[slot->part.source], &slot->arrays);
    if (source->tags != PLY_TAGS_NONE)
        status = fmt_ply_find_materials(reader, source, &slot->arrays);
    totals->materials = reader->texture_count + (uint32_t)reader->colors.count;
    return status;
}

static int warn_lost_textures(const struct ply_reader *reader)
{
    const struct ply_header *header = &reader->files[reader->lost_texture_file].header;
    const bool text = header->encoding == PLY_ASCII;
    if (reader->lost_textures == 0)
        return 0;
    return bsq_warn_loss(
        reader->stream.base.ctx,
        "%s:%s%" PRIu64 ": faces whose texnumber, from 0, is not below the number of textures that "
        "the file names, %u; they have no texture: %" PRIu64 "; this is the first",
        reader->stream.sources[reader->lost_texture_file].path, text ? "" : " byte ",
        reader->lost_texture_at, header->texture_count, reader->lost_textures);
}

static int warn_missing(struct ply_reader *reader)
{
    const struct {
        uint64_t count;
        const char *what;
    } kinds[] = {{reader->missing_positions, "positions"},
                 {reader->bad_normals, "normals"},
                 {reader->bad_colors, "colours"},
                 {reader->missing_texcoords, "texture coordinates"},
                 {reader->bad_texcoords, "texture coordinates of corners"}};
    int status = reader->clamped_colors == 0
                     ? 0
                     : bsq_warn_loss(reader->stream.base.ctx,
                                     "%s: colours out of range were clamped at %" PRIu64 " %s; "
                                     "real numbers range to 1",
                                     reader->stream.sources[0].path, reader->clamped_colors,
                                     reader->clamped_colors == 1 ? "face" : "faces");
    for (size_t i = 0; i < sizeof kinds / sizeof *kinds && !status; i++)
        if (kinds[i].count > 0)
            status =
                bsq_warn_loss(reader->stream.base.ctx,
                              "%s: %" PRIu64 " %s are not finite or incomplete and were left out",
                              reader->stream.sources[0].path, kinds[i].count, kinds[i].what);
    return status;
}

/* Warns of colours and textures that choose_use() had no use for. */
static int warn_unused(const struct ply_reader *reader, uint32_t number)
{
    const struct ply_source *source = &reader->files[number];
    const struct ply_element *faces = fmt_ply_find_element(&source->header, PLY_FACES);
    const bool textured = source->tags == PLY_TAGS_TEXTURE;
    struct bsq_ctx *ctx = reader->stream.base.ctx;
    const char *path = reader->stream.sources[number].path;
    int status = 0;
    if (source->header.texture_count > 0 && !textured)
        status = bsq_warn_loss(ctx, "%s: no texture coordinates, so the texture %s is not used",
                               path, source->header.textures[0]);
    if (status == 0 && faces && faces->role[PLY_RED] && source->tags != PLY_TAGS_COLOR)
        status = bsq_warn_loss(ctx, "%s: colours of faces are not used beside %s", path,
                               textured ? "a texture" : "those of vertices");
    return status;
}

static int read_all(struct fmt_mesh_reader *base, const struct fmt_mesh_steps *steps, void *arg,
                    struct fmt_mesh_totals *totals)
{
    struct ply_reader *reader = (struct ply_reader *)base;
    reader->bad_normals = reader->bad_colors = reader->bad_texcoords = 0;
    reader->missing_positions = reader->missing_texcoords = reader->clamped_colors = 0;
    reader->lost_textures = 0;
    int status = fmt_stream_read(&reader->stream, steps, arg, totals);
    if (status || reader->read_before)
        return status;
    reader->read_before = true;
    for (uint32_t i = 0; i < reader->stream.source_count && status == 0; i++) {
        fmt_ply_warn_unread(base->ctx, reader->stream.sources[i].path, &reader->files[i].header);
        status = warn_unused(reader, i);
    }
    if (!status)
        status = warn_lost_textures(reader);
    return status ? status : warn_missing(reader);
}

static int locate_face(struct fmt_mesh_reader *base, uint64_t face, struct fmt_mesh_place *out)
{
    return fmt_stream_locate_face((struct stream_reader *)base, face, out);
}

/* ---- estimating ---- */

/* Adds a file. Faces are taken for triangles. */
static void add_estimate(const struct ply_source *source, uint64_t file_size,
                         struct fmt_mesh_estimate *out)
{
    const struct ply_element *vertices = fmt_ply_find_element(&source->header, PLY_VERTICES);
    const struct ply_element *faces = fmt_ply_find_element(&source->header, PLY_FACES);
    const struct ply_element *strips = fmt_ply_find_element(&source->header, PLY_STRIPS);
    uint64_t triangles = faces ? faces->count : 0;
    if (strips && strips->count > 0)
        triangles += file_size > source->header.bytes ? (file_size - source->header.bytes) / 4 : 0;
    out->vertices += vertices->count;
    out->normals += source->vertex_normals ? vertices->count : 0;
    out->texcoords += source->vertex_texcoords   ? vertices->count
                      : source->corner_texcoords ? 3 * triangles
                                                 : 0;
    out->faces += triangles;
    out->corners += 3 * triangles;
    out->has_colors |= vertices->role[PLY_RED] != NULL;
    out->faces_come_last &=
        !source->corner_texcoords && (!faces || faces > vertices) && (!strips || strips > vertices);
}

static int estimate(const struct fmt_mesh_reader *base, struct fmt_mesh_estimate *out)
{
    const struct ply_reader *reader = (const struct ply_reader *)base;
    *out = (struct fmt_mesh_estimate){.faces_come_last = reader->stream.source_count == 1};
    int status = 0;
    for (uint32_t i = 0; i < reader->stream.source_count && !status; i++) {
        uint64_t bytes;
        bool plain;
        status = fmt_input_guess(reader->stream.sources[i].input, &bytes, &plain);
        add_estimate(&reader->files[i], bytes, out);
    }
    return status;
}

/* ---- the format ---- */

static int prepare(struct stream_reader *stream)
{
    struct ply_reader *reader = (struct ply_reader *)stream;
    return bsq_calloc(stream->base.ctx, "PLY files", stream->source_count, sizeof *reader->files,
                      &reader->files);
}

static int open_reader(struct bsq_ctx *ctx, struct fmt_input *const *inputs, uint32_t input_count,
                       struct fmt_mesh_reader **out)
{
    static const struct stream_format stream = {
        .reader_name = "PLY reader",
        .reader_bytes = sizeof(struct ply_reader),
        .prepare = prepare,
        .begin = read_header,
        .end = close_reader,
        .cut = fmt_ply_cut,
        .parse = parse,
        .pass = pass,
    };
    return fmt_stream_open(ctx, &stream, inputs, input_count, out);
}

const struct fmt_mesh_format fmt_ply_format = {
    .name = "PLY",
    .suffix = ".ply",
    .recognise = recognise,
    .open = open_reader,
    .close = close_reader,
    .read = read_all,
    .estimate = estimate,
    .locate_face = locate_face,
    .read_materials = fmt_ply_read_materials,
    .preview_materials = fmt_ply_read_materials,
};
