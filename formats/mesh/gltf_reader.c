/* gltf_reader.c - reads glTF 2.0 files, .gltf and GLB, as an ordered stream of parsed parts.
 *
 * A file's JSON says where its elements are, so parts are cut without reading anything: first all
 * vertices, then all faces, each in the order of nodes and primitives. Buffers are read in parts,
 * and memory does not grow with them. */
#include <inttypes.h>
#include <math.h>
#include <string.h>

#include "base/file_part.h"
#include "base/loss.h"
#include "base/srgb.h"
#include "formats/mesh/gltf_internal.h"
#include "formats/mesh/mesh_text.h"

/* ---- opening ---- */

static bool recognise(const char *head, size_t size)
{
    size_t i = fmt_mesh_mark(head, size);
    if (size >= 4 && memcmp(head, "glTF", 4) == 0)
        return true;
    while (i < size && (head[i] == ' ' || head[i] == '\t' || head[i] == '\r' || head[i] == '\n'))
        i++;
    return i < size && head[i] == '{' && memmem(head + i, size - i, "\"asset\"", 7) != NULL;
}

static int read_document(struct gltf_document *document, struct gltf_source *source)
{
    int status = fmt_gltf_check_extensions(document, source);
    if (!status)
        status = fmt_gltf_read_buffers(document, source);
    if (!status)
        status = fmt_gltf_read_accessors(document, source);
    if (!status)
        status = fmt_gltf_read_materials(document, source);
    if (!status)
        status = fmt_gltf_read_meshes(document, source);
    if (!status)
        status = fmt_gltf_read_scene(document, source);
    return status;
}

static int read_file(struct stream_reader *stream, uint32_t number)
{
    struct gltf_reader *reader = (struct gltf_reader *)stream;
    struct gltf_source *source = &reader->files[number];
    struct gltf_document document;
    struct fmt_input *input = reader->stream.sources[number].input;
    int status = fmt_input_open(input);
    if (status)
        return status;
    status = fmt_gltf_open_document(reader->stream.base.ctx, input, &document);
    source->size = document.file.size;
    if (!status)
        status = read_document(&document, source);
    fmt_gltf_close_document(&document);
    const int closed = fmt_input_close(input);
    status = status ? status : closed;
    if (!status && source->material_count > UINT32_MAX - 1 - reader->material_count)
        status = bsq_fail(reader->stream.base.ctx, BSQ_EDATA, "too many materials");
    source->material_base = reader->material_count;
    reader->material_count += source->material_count;
    source->part_base = reader->part_count;
    if (!status &&
        __builtin_add_overflow(reader->part_count, source->part_count, &reader->part_count))
        status = bsq_fail(reader->stream.base.ctx, BSQ_EDATA, "too many elements");
    reader->has_colors |= source->has_colors;
    return status;
}

static void free_source(struct bsq_ctx *ctx, struct gltf_source *source)
{
    bsq_file_close(ctx, &source->own);
    fmt_gltf_free_buffers(ctx, source);
    for (uint32_t i = 0; i < source->material_count; i++) {
        bsq_free(ctx, source->materials[i].name);
        bsq_free(ctx, source->materials[i].texture_path);
        fmt_channels_free(ctx, source->materials[i].channels, source->materials[i].channel_count);
    }
    bsq_free(ctx, source->materials);
    bsq_free(ctx, source->accessors);
    bsq_free(ctx, source->primitives);
    bsq_free(ctx, source->meshes);
    for (uint32_t i = 0; i < source->placement_count; i++)
        bsq_free(ctx, source->placements[i].name);
    bsq_free(ctx, source->placements);
}

static void close_reader(struct fmt_mesh_reader *base)
{
    struct gltf_reader *reader = (struct gltf_reader *)base;
    for (uint32_t i = 0; reader->files && i < reader->stream.source_count; i++)
        free_source(base->ctx, &reader->files[i]);
    bsq_free(base->ctx, reader->files);
    fmt_stream_free(&reader->stream);
}

/* ---- cutting ---- */

static uint64_t count_items(const struct gltf_source *source, const struct stream_part *part)
{
    const struct gltf_primitive *p = &source->primitives[part->carry];
    return part->carry_out == GLTF_FACES ? p->triangles : source->accessors[p->position].count;
}

/* Goes on to the next primitive, placement or kind of elements. Returns false at the end. */
static bool advance(const struct gltf_source *source, struct stream_part *part)
{
    const struct gltf_mesh *mesh = &source->meshes[source->placements[part->kind].mesh];
    part->first_item = 0;
    if (++part->carry < mesh->first + mesh->count)
        return true;
    if (++part->kind == source->placement_count) {
        part->kind = 0;
        part->carry_out++;
    }
    part->carry = source->meshes[source->placements[part->kind].mesh].first;
    return part->carry_out <= GLTF_FACES;
}

/* Returns how many elements a part has: its bytes, and the arrays that they become, fit a core's
 * cache. */
static uint64_t usual_items(const struct gltf_source *source, const struct stream_part *part)
{
    const struct gltf_primitive *p = &source->primitives[part->carry];
    const uint32_t accessors[] = {p->position, p->normal, p->texcoord, p->color};
    uint64_t bytes = 32;
    if (part->carry_out == GLTF_FACES)
        return STREAM_PART_BYTES / 24 + 1;
    for (int i = 0; i < 4; i++) {
        const uint64_t stride = accessors[i] == GLTF_NONE
                                    ? 0
                                    : fmt_gltf_stride(source, &source->accessors[accessors[i]]);
        bytes = stride > bytes ? stride : bytes;
    }
    return STREAM_PART_BYTES / bytes + 1;
}

/* The bytes of the file are shared out by elements, as a measure of progress. part->left counts the
 * elements of this and of earlier parts. */
static int cut(struct stream_reader *base, const struct stream_part *before,
               struct stream_slot *slot)
{
    const struct gltf_source *source = &((const struct gltf_reader *)base)->files[before->source];
    const uint64_t size = source->size;
    const uint64_t all = source->total[FMT_MESH_VERTEX] + source->triangles;
    struct stream_part *part = &slot->part;
    if (before->left == all && (all > 0 || before->end > 0))
        return 0;
    slot->loaded = true; /* parsing reads what it needs */
    *part = *before;
    part->end = size;
    if (all == 0)
        return 1;
    part->first_item += before->items;
    if (before->left == 0)
        part->carry = source->meshes[source->placements[0].mesh].first;
    else if (part->first_item == count_items(source, part))
        advance(source, part);
    const uint64_t rest = count_items(source, part) - part->first_item;
    const uint64_t usual = usual_items(source, part);
    part->items = rest < usual ? rest : usual;
    part->left = before->left + part->items;
    part->end = (uint64_t)((unsigned __int128)size * part->left / all);
    return 1;
}

/* ---- reading ---- */

/* Opens the buffers, and prepares what can only be read whole. */
static int open_buffers(struct stream_reader *base, uint32_t number)
{
    struct gltf_source *source = &((struct gltf_reader *)base)->files[number];
    int status =
        source->own.fd < 0 ? fmt_input_whole(base->sources[number].input, &source->own) : 0;
    if (!status)
        status = fmt_gltf_open_buffers(base->base.ctx, source);
    if (!status)
        status = fmt_gltf_unpack(base->base.ctx, source, &source->own);
    return status ? status : fmt_gltf_check_sparse(base->base.ctx, source, &source->own);
}

static int close_buffers(struct stream_reader *base, uint32_t number)
{
    struct gltf_source *source = &((struct gltf_reader *)base)->files[number];
    bsq_file_close(base->base.ctx, &source->own);
    return fmt_gltf_close_buffers(base->base.ctx, source);
}

static int pass(struct stream_reader *base, struct stream_slot *slot,
                struct fmt_mesh_totals *totals)
{
    struct gltf_reader *reader = (struct gltf_reader *)base;
    reader->missing[0] += slot->missing_positions;
    reader->missing[1] += slot->bad_normals;
    reader->missing[2] += slot->missing_texcoords;
    reader->missing[3] += slot->bad_colors;
    totals->materials =
        reader->stream.base.objects ? (uint32_t)reader->part_count : reader->material_count;
    totals->split_vertices = true;
    totals->has_tangents |= reader->files[slot->part.source].has_tangents;
    return 0;
}

struct unread_kind {
    uint64_t count;
    bool loss; /* the scan is poorer by it */
    const char *what;
};

static int warn_kinds(struct bsq_ctx *ctx, const char *path, const struct unread_kind *kinds,
                      size_t count)
{
    int status = 0;
    for (size_t i = 0; i < count && !status; i++) {
        if (kinds[i].count > 0 && kinds[i].loss)
            status = bsq_warn_loss(ctx, "%s: %" PRIu64 " %s", path, kinds[i].count, kinds[i].what);
        else if (kinds[i].count > 0)
            bsq_warn(ctx, "%s: %" PRIu64 " %s", path, kinds[i].count, kinds[i].what);
    }
    return status;
}

/* Warns of what is not read. Colours matter only if the caller uses them. */
static int warn_unread(const struct gltf_reader *reader, uint32_t file)
{
    struct bsq_ctx *ctx = reader->stream.base.ctx;
    const char *path = reader->stream.sources[file].path;
    const struct gltf_unread *unread = &reader->files[file].unread;
    const struct unread_kind shape[] = {
        {unread->points, false, "primitives of points or lines are not read"},
        {unread->bare, true, "primitives without positions are not read"},
        {unread->rest, true, "indices of incomplete triangles are not read"},
        {unread->outside, true, "nodes with meshes are not in the scene and are not read"},
        {unread->unplaced, true, "meshes are at no node and are not read"},
        {unread->skins, false, "meshes have skins, which are not applied: they are in bind pose"},
        {unread->morphs, true, "meshes have weights of morph targets, which are not applied"},
        {unread->instances, true,
         "nodes have EXT_mesh_gpu_instancing, of which one instance is read"},
    };
    const struct unread_kind colors[] = {
        {unread->images, true, "textures have a format or an address that is not read"},
        {unread->packed_images, true, "textures are inside of a packed file or a pipe: unpack it"},
        {unread->texture_factors, true,
         "materials have a texture, so their colour factor is not used"},
        {unread->texture_colors, true,
         "primitives have a texture, so their vertex colours are not used"},
    };
    int status = warn_kinds(ctx, path, shape, sizeof shape / sizeof *shape);
    if (!status && reader->uses_colors)
        status = warn_kinds(ctx, path, colors, sizeof colors / sizeof *colors);
    return status;
}

static int warn_missing(const struct gltf_reader *reader)
{
    static const char *const kinds[] = {"positions", "normals", "texture coordinates", "colours"};
    int status = 0;
    for (int i = 0; i < 4 && !status; i++)
        if (reader->missing[i] > 0)
            status = bsq_warn_loss(reader->stream.base.ctx,
                                   "%s: %" PRIu64 " %s are not finite and were left out",
                                   reader->stream.sources[0].path, reader->missing[i], kinds[i]);
    return status;
}

static int read_all(struct fmt_mesh_reader *base, const struct fmt_mesh_steps *steps, void *arg,
                    struct fmt_mesh_totals *totals)
{
    struct gltf_reader *reader = (struct gltf_reader *)base;
    if (base->objects && reader->part_count >= FMT_MESH_NO_MATERIAL)
        return bsq_fail(base->ctx, BSQ_EDATA, "%s: too many objects",
                        reader->stream.sources[0].path);
    memset(reader->missing, 0, sizeof reader->missing);
    int status = fmt_stream_read(&reader->stream, steps, arg, totals);
    if (status || reader->read_before)
        return status;
    reader->read_before = true;
    for (uint32_t i = 0; i < reader->stream.source_count && !status; i++)
        status = warn_unread(reader, i);
    return status ? status : warn_missing(reader);
}

static int locate_face(struct fmt_mesh_reader *base, uint64_t face, struct fmt_mesh_place *out)
{
    return fmt_stream_locate_face((struct stream_reader *)base, face, out);
}

static int estimate(const struct fmt_mesh_reader *base, struct fmt_mesh_estimate *out)
{
    const struct gltf_reader *reader = (const struct gltf_reader *)base;
    *out = (struct fmt_mesh_estimate){.faces_come_last = reader->stream.source_count == 1,
                                      .has_colors = reader->has_colors};
    for (uint32_t i = 0; i < reader->stream.source_count; i++) {
        const struct gltf_source *source = &reader->files[i];
        out->vertices += source->total[FMT_MESH_VERTEX];
        out->texcoords += source->total[FMT_MESH_TEXCOORD];
        out->normals += source->total[FMT_MESH_NORMAL];
        out->faces += source->triangles;
    }
    out->corners = 3 * out->faces;
    return 0;
}

/* ---- other files ---- */

/* file: the path of the glTF file */
static int describe_material(struct bsq_ctx *ctx, const char *file,
                             const struct gltf_material *from, struct fmt_material *out)
{
    struct bsq_part part;
    struct fmt_material_channel *opacity;
    out->has_diffuse = from->has_color;
    out->opaque = from->opaque;
    for (int k = 0; k < 3; k++)
        out->diffuse[k] = (float)bsq_linear_to_srgb(from->color[k]);
    int status = fmt_string_copy(ctx, from->name, &out->name);
    if (!status && from->texture_path)
        status = fmt_string_copy(ctx, from->texture_path, &out->texture_path);
    if (!status && from->texture_path && bsq_part_parse(from->texture_path, &part) == 0)
        status = fmt_string_copy(ctx, file, &out->texture_place);
    if (!status && from->channel_count > 0)
        status = fmt_channels_copy(ctx, from->channels, from->channel_count, out);
    if (status || from->opaque)
        return status;
    status = fmt_material_enter_channel(ctx, out, bsq_channel_find("opacity"), &opacity);
    if (status)
        return status;
    const double alpha = from->alpha;
    opacity->value[0] = from->cutout ? (float)(alpha >= from->cutoff) : (float)alpha;
    opacity->has_value = true;
    out->cutout = from->cutout;
    /* 2 is above the alpha of all textures. */
    out->cutoff = alpha > 0.0 ? (float)fmin(fmax(from->cutoff / alpha, 0.0), 2.0)
                              : 2.0f * (1.0f - opacity->value[0]);
    return 0;
}

static int list_materials(struct fmt_mesh_reader *base, struct fmt_materials *out)
{
    const struct gltf_reader *reader = (const struct gltf_reader *)base;
    int status = bsq_calloc(base->ctx, "materials", (uint64_t)reader->material_count + 1,
                            sizeof *out->list, &out->list);
    for (uint32_t file = 0; file < reader->stream.source_count && !status; file++)
        for (uint32_t i = 0; i < reader->files[file].material_count && !status; i++)
            status = describe_material(base->ctx, reader->stream.sources[file].path,
                                       &reader->files[file].materials[i], &out->list[out->count++]);
    if (status)
        fmt_materials_free(base->ctx, out);
    return status;
}

/* Describes the material and the object of a primitive at a node. */
static int describe_part(struct bsq_ctx *ctx, const char *file, const struct gltf_source *source,
                         const struct gltf_placement *placement,
                         const struct gltf_primitive *primitive, struct fmt_material *out)
{
    int status = 0;
    for (int k = 0; k < 3; k++)
        out->diffuse[k] = 0.8f;
    if (primitive->material != GLTF_NONE)
        status = describe_material(ctx, file, &source->materials[primitive->material], out);
    else
        status = fmt_string_copy(ctx, "", &out->name);
    return status ? status : fmt_string_copy(ctx, placement->name, &out->object);
}

/* Lists the parts: the primitives of each placement, in the order of their numbers. */
static int list_parts(struct fmt_mesh_reader *base, struct fmt_materials *out)
{
    const struct gltf_reader *reader = (const struct gltf_reader *)base;
    int status =
        bsq_calloc(base->ctx, "materials", reader->part_count + 1, sizeof *out->list, &out->list);
    for (uint32_t file = 0; file < reader->stream.source_count && !status; file++) {
        const struct gltf_source *source = &reader->files[file];
        for (uint32_t i = 0; i < source->placement_count && !status; i++) {
            const struct gltf_placement *placement = &source->placements[i];
            const struct gltf_mesh *mesh = &source->meshes[placement->mesh];
            status = bsq_check(base->ctx);
            for (uint32_t k = 0; k < mesh->count && !status; k++)
                status =
                    describe_part(base->ctx, reader->stream.sources[file].path, source, placement,
                                  &source->primitives[mesh->first + k], &out->list[out->count++]);
        }
    }
    if (status)
        fmt_materials_free(base->ctx, out);
    return status;
}

static int read_materials(struct fmt_mesh_reader *base, struct fmt_materials *out)
{
    return base->objects ? list_parts(base, out) : list_materials(base, out);
}

static int preview_materials(struct fmt_mesh_reader *base, struct fmt_materials *out)
{
    ((struct gltf_reader *)base)->uses_colors = true;
    return list_materials(base, out);
}

static const char *dependency(const struct fmt_mesh_reader *base, uint32_t index)
{
    const struct gltf_reader *reader = (const struct gltf_reader *)base;
    for (uint32_t file = 0; file < reader->stream.source_count; file++)
        for (uint32_t i = 0; i < reader->files[file].buffer_count; i++)
            if (reader->files[file].buffers[i].path && index-- == 0)
                return reader->files[file].buffers[i].path;
    return NULL;
}

/* ---- the format ---- */

static int prepare(struct stream_reader *stream)
{
    struct gltf_reader *reader = (struct gltf_reader *)stream;
    int status = bsq_calloc(stream->base.ctx, "glTF files", stream->source_count,
                            sizeof *reader->files, &reader->files);
    for (uint32_t i = 0; i < stream->source_count && !status; i++)
        reader->files[i].own = reader->files[i].decoded = (struct bsq_file)BSQ_FILE_CLOSED;
    return status;
}

static int open_reader(struct bsq_ctx *ctx, struct fmt_input *const *inputs, uint32_t input_count,
                       struct fmt_mesh_reader **out)
{
    static const struct stream_format stream = {
        .reader_name = "glTF reader",
        .reader_bytes = sizeof(struct gltf_reader),
        .prepare = prepare,
        .begin = read_file,
        .end = close_reader,
        .open = open_buffers,
        .close = close_buffers,
        .cut = cut,
        .parse = fmt_gltf_parse,
        .pass = pass,
    };
    return fmt_stream_open(ctx, &stream, inputs, input_count, out);
}

const struct fmt_mesh_format fmt_gltf_format = {
    .name = "glTF",
    .suffix = ".gltf",
    .recognise = recognise,
    .open = open_reader,
    .close = close_reader,
    .read = read_all,
    .estimate = estimate,
    .locate_face = locate_face,
    .read_materials = read_materials,
    .preview_materials = preview_materials,
    .dependency = dependency,
};
