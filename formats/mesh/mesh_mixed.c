/* mesh_mixed.c - one scan from files of several formats.
 *
 * Each run of files of one format has a reader of its own; a format that reads single files has one
 * for each file. The readers deliver their blocks one after the other, and this file renumbers
 * them: files, elements, faces and materials count over the whole scan. */
#include <string.h>

#include "formats/mesh/mesh_format.h"

/* A run of files, and what earlier parts have. */
struct mixed_part {
    struct fmt_mesh_reader *reader;
    uint32_t first_input, input_count;
    struct fmt_mesh_totals before;
};

struct mixed_reader {
    struct fmt_mesh_reader base; /* must be first */
    struct mixed_part *parts;
    uint32_t part_count;
};

/* One reading of one part. */
struct mixed_job {
    const struct mixed_part *part;
    const struct fmt_mesh_steps *steps;
    void *arg;
    uint64_t *sequence; /* of the next block of the scan */
};

/* ---- opening ---- */

static void close_reader(struct fmt_mesh_reader *base)
{
    struct mixed_reader *mixed = (struct mixed_reader *)base;
    struct bsq_ctx *ctx = base->ctx;
    for (uint32_t i = 0; i < mixed->part_count; i++)
        if (mixed->parts[i].reader)
            mixed->parts[i].reader->format->close(mixed->parts[i].reader);
    bsq_free(ctx, mixed->parts);
    bsq_free(ctx, mixed);
}

/* Opens the next part: the files from `first` on that one reader takes. */
static int open_part(struct mixed_reader *mixed, struct fmt_input *const *inputs,
                     const struct fmt_mesh_format *const *formats, uint32_t count, uint32_t first)
{
    struct mixed_part *part = &mixed->parts[mixed->part_count++];
    const struct fmt_mesh_format *format = formats[first];
    part->first_input = first;
    part->input_count = 1;
    while (!format->single && first + part->input_count < count &&
           formats[first + part->input_count] == format)
        part->input_count++;
    int status = format->open(mixed->base.ctx, inputs + first, part->input_count, &part->reader);
    if (status == 0)
        part->reader->format = format;
    return status;
}

int fmt_mesh_open_mixed(struct bsq_ctx *ctx, struct fmt_input *const *inputs,
                        const struct fmt_mesh_format *const *formats, uint32_t input_count,
                        struct fmt_mesh_reader **out)
{
    struct mixed_reader *mixed;
    int status = bsq_calloc(ctx, "mesh readers", 1, sizeof *mixed, &mixed);
    if (status)
        return status;
    mixed->base.ctx = ctx;
    status = bsq_calloc(ctx, "mesh readers", input_count, sizeof *mixed->parts, &mixed->parts);
    for (uint32_t i = 0; i < input_count && !status;
         i += mixed->parts[mixed->part_count - 1].input_count)
        status = open_part(mixed, inputs, formats, input_count, i);
    if (status)
        close_reader(&mixed->base);
    else
        *out = &mixed->base;
    return status;
}

/* ---- reading ---- */

static void add_totals(struct fmt_mesh_totals *to, const struct fmt_mesh_totals *from)
{
    to->bytes += from->bytes;
    to->vertices += from->vertices;
    to->texcoords += from->texcoords;
    to->normals += from->normals;
    to->faces += from->faces;
    to->corners += from->corners;
    to->materials += from->materials;
    to->skipped_lines += from->skipped_lines;
    to->short_faces += from->short_faces;
    to->has_tangents |= from->has_tangents;
    to->split_vertices |= from->split_vertices;
    to->unread_colors = to->unread_colors ? to->unread_colors : from->unread_colors;
}

static void shift_corners(const uint64_t *corners, uint64_t count, uint64_t base)
{
    uint64_t *own = (uint64_t *)corners;
    for (uint64_t i = 0; own && base > 0 && i < count; i++)
        own[i] = own[i] == FMT_MESH_NONE ? FMT_MESH_NONE : own[i] + base;
}

static uint32_t shift_material(uint32_t material, uint32_t base)
{
    return material == FMT_MESH_NO_MATERIAL ? material : material + base;
}

/* Makes the numbers of a block count over the scan. Two kinds of indices may share an array. */
static void renumber(struct fmt_mesh_block *block, const struct mixed_part *part)
{
    const struct fmt_mesh_totals *before = &part->before;
    const uint64_t *vertices = block->corner_vertices, *texcoords = block->corner_texcoords,
                   *normals = block->corner_normals;
    struct fmt_mesh_material_change *changes =
        (struct fmt_mesh_material_change *)block->material_changes;
    block->file += part->first_input;
    block->vertex_base += before->vertices;
    block->late_color_base += before->vertices;
    block->texcoord_base += before->texcoords;
    block->normal_base += before->normals;
    block->face_base += before->faces;
    shift_corners(vertices, block->corner_count, before->vertices);
    shift_corners(texcoords, block->corner_count, before->texcoords);
    shift_corners(normals, block->corner_count, before->normals);
    block->material_at_start = shift_material(block->material_at_start, before->materials);
    for (uint64_t i = 0; i < block->material_change_count; i++)
        changes[i].material = shift_material(changes[i].material, before->materials);
}

static int on_block(void *arg, const struct fmt_mesh_block *block)
{
    const struct mixed_job *job = arg;
    struct fmt_mesh_block *own = (struct fmt_mesh_block *)block;
    renumber(own, job->part);
    own->sequence = (*job->sequence)++;
    return job->steps->on_block ? job->steps->on_block(job->arg, own) : 0;
}

static int follow(void *arg, const struct fmt_mesh_block *block, unsigned slot)
{
    const struct mixed_job *job = arg;
    return job->steps->follow(job->arg, block, slot);
}

static int finish(void *arg, const struct fmt_mesh_block *block, unsigned slot)
{
    const struct mixed_job *job = arg;
    return job->steps->finish(job->arg, block, slot);
}

static int read_all(struct fmt_mesh_reader *base, const struct fmt_mesh_steps *steps, void *arg,
                    struct fmt_mesh_totals *totals)
{
    struct mixed_reader *mixed = (struct mixed_reader *)base;
    const struct fmt_mesh_steps own = {.on_block = on_block,
                                       .follow = steps->follow ? follow : NULL,
                                       .finish = steps->follow ? finish : NULL};
    uint64_t sequence = 0;
    int status = 0;
    for (uint32_t i = 0; i < mixed->part_count && !status; i++) {
        struct mixed_part *part = &mixed->parts[i];
        struct mixed_job job = {.part = part, .steps = steps, .arg = arg, .sequence = &sequence};
        struct fmt_mesh_totals found = {0};
        part->before = *totals;
        part->reader->objects = base->objects;
        status = part->reader->format->read(part->reader, &own, &job, &found);
        if (!status && found.materials >= UINT32_MAX - totals->materials)
            status = bsq_fail(base->ctx, BSQ_EDATA, "%s: too many materials",
                              fmt_input_path(base->inputs[part->first_input]));
        add_totals(totals, &found);
    }
    return status;
}

static int estimate(const struct fmt_mesh_reader *base, struct fmt_mesh_estimate *out)
{
    const struct mixed_reader *mixed = (const struct mixed_reader *)base;
    int status = 0;
    *out = (struct fmt_mesh_estimate){0};
    for (uint32_t i = 0; i < mixed->part_count && !status; i++) {
        struct fmt_mesh_estimate found = {0};
        status = mixed->parts[i].reader->format->estimate(mixed->parts[i].reader, &found);
        out->vertices += found.vertices;
        out->texcoords += found.texcoords;
        out->normals += found.normals;
        out->faces += found.faces;
        out->corners += found.corners;
        out->has_colors |= found.has_colors;
    }
    return status;
}

static int locate_face(struct fmt_mesh_reader *base, uint64_t face, struct fmt_mesh_place *out)
{
    const struct mixed_reader *mixed = (const struct mixed_reader *)base;
    const struct mixed_part *part = mixed->parts;
    while (part + 1 < mixed->parts + mixed->part_count && part[1].before.faces <= face)
        part++;
    int status = part->reader->format->locate_face(part->reader, face - part->before.faces, out);
    out->base[FMT_MESH_VERTEX] += part->before.vertices;
    out->base[FMT_MESH_TEXCOORD] += part->before.texcoords;
    out->base[FMT_MESH_NORMAL] += part->before.normals;
    out->first_face += part->before.faces;
    return status;
}

/* ---- materials ---- */

typedef int describe(struct fmt_mesh_reader *reader, struct fmt_materials *out);

/* Moves the materials of a part to the end of the list. */
static int append(struct bsq_ctx *ctx, struct fmt_materials *part, uint64_t *capacity,
                  struct fmt_materials *out)
{
    const uint64_t count = (uint64_t)out->count + part->count;
    int status = count < UINT32_MAX ? 0 : bsq_fail(ctx, BSQ_EDATA, "too many materials");
    if (!status && count > *capacity)
        status = bsq_grow(ctx, "materials", count, sizeof *out->list, &out->list, capacity);
    if (status || part->count == 0)
        return status;
    memcpy(out->list + out->count, part->list, part->count * sizeof *part->list);
    out->count = (uint32_t)count;
    part->count = 0;
    return 0;
}

/* Lists the materials of all parts: each part's in the order of its numbers. */
static int list_materials(struct fmt_mesh_reader *base, bool preview, struct fmt_materials *out)
{
    struct mixed_reader *mixed = (struct mixed_reader *)base;
    uint64_t capacity = 0;
    int status = 0;
    for (uint32_t i = 0; i < mixed->part_count && !status; i++) {
        struct fmt_mesh_reader *reader = mixed->parts[i].reader;
        describe *list =
            preview ? reader->format->preview_materials : reader->format->read_materials;
        struct fmt_materials found = {0};
        status = list ? list(reader, &found) : 0;
        if (!status)
            status = append(base->ctx, &found, &capacity, out);
        fmt_materials_free(base->ctx, &found);
    }
    if (status)
        fmt_materials_free(base->ctx, out);
    return status;
}

static int read_materials(struct fmt_mesh_reader *base, struct fmt_materials *out)
{
    return list_materials(base, false, out);
}

static int preview_materials(struct fmt_mesh_reader *base, struct fmt_materials *out)
{
    return list_materials(base, true, out);
}

static const char *dependency(const struct fmt_mesh_reader *base, uint32_t index)
{
    const struct mixed_reader *mixed = (const struct mixed_reader *)base;
    for (uint32_t i = 0; i < mixed->part_count; i++) {
        const struct fmt_mesh_reader *reader = mixed->parts[i].reader;
        const char *path = NULL;
        uint32_t own = 0;
        while (reader->format->dependency && (path = reader->format->dependency(reader, own))) {
            if (index-- == 0)
                return path;
            own++;
        }
    }
    return NULL;
}

const struct fmt_mesh_format fmt_mixed_format = {
    .name = "several formats",
    .close = close_reader,
    .read = read_all,
    .estimate = estimate,
    .locate_face = locate_face,
    .read_materials = read_materials,
    .preview_materials = preview_materials,
    .dependency = dependency,
};
