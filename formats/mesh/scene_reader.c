/* scene_reader.c - reads FBX, COLLADA and other files, which Assimp reads whole.
 *
 * Meant for low-poly meshes. The memory that Assimp takes is not known before; it is counted as a
 * multiple of the file. */
#include <assert.h>
#include <inttypes.h>
#include <math.h>
#include <string.h>

#include "base/file.h"
#include "base/loss.h"
#include "formats/mesh/mesh_arrays.h"
#include "formats/mesh/mesh_format.h"
#include "formats/mesh/mesh_text.h"
#include "formats/mesh/obj_path.h"
#include "formats/mesh/scene_module.h"

/* Assimp's memory for a byte of a file. Text of positions takes less, compressed FBX files more. */
enum { MEMORY_PER_BYTE = 40 };

/* Elements of a block. */
enum { BLOCK_ELEMENTS = 16384 };

struct scene_reader {
    struct fmt_mesh_reader base; /* must be first */
    const char *path, *beside;   /* of the input; other files are looked for beside the latter */
    struct fmt_scene scene;
    uint64_t bytes; /* of the file */
    bool read_before;
    bool uses_colors;          /* the caller previewed materials */
    struct mesh_arrays arrays; /* of one block: a copy that callers may change */
};

/* ---- opening ---- */

static bool recognise(const char *head, size_t size)
{
    static const char magic[] = "Kaydara FBX Binary";
    return size >= sizeof magic && memcmp(head, magic, sizeof magic - 1) == 0;
}

/* Returns a name whose suffix tells the format: the file's, without the suffix of a packed file. */
static int name_for_format(struct bsq_ctx *ctx, const char *path, const char *head, size_t size,
                           char **out)
{
    int status =
        fmt_string_copy(ctx, recognise(head, size) ? "mesh.fbx" : bsq_file_name(path), out);
    if (!status)
        (*out)[fmt_mesh_unpacked_length(*out)] = '\0';
    return status;
}

static int read_whole(struct scene_reader *r, const struct bsq_file *file)
{
    struct bsq_ctx *ctx = r->base.ctx;
    const struct fmt_module *module;
    char head[64], *name = NULL;
    uint64_t got = 0, memory;
    r->bytes = file->size;
    if (__builtin_mul_overflow(file->size, (uint64_t)MEMORY_PER_BYTE, &memory))
        return bsq_fail(ctx, BSQ_ENOMEM, "%s: too large", r->path);
    int status = fmt_module_open(ctx, "scene", "FBX, COLLADA and such files", &module);
    if (!status)
        status = bsq_file_read_some(ctx, file, head, sizeof head, 0, &got);
    if (!status)
        status = name_for_format(ctx, r->path, head, got, &name);
    if (!status)
        status = bsq_reserve(ctx, "reading a file whole by Assimp", memory);
    if (!status) {
        status = ((const struct fmt_scene_module *)module)
                     ->read(&fmt_host_functions, ctx, file, name, &r->scene);
        bsq_release(ctx, memory);
    }
    bsq_free(ctx, name);
    return status;
}

static void close_reader(struct fmt_mesh_reader *base)
{
    struct scene_reader *r = (struct scene_reader *)base;
    bsq_free(base->ctx, r->scene.positions);
    bsq_free(base->ctx, r->scene.texcoords);
    bsq_free(base->ctx, r->scene.normals);
    bsq_free(base->ctx, r->scene.colors);
    bsq_free(base->ctx, r->scene.face_sizes);
    bsq_free(base->ctx, r->scene.corners);
    for (uint64_t i = 0; i < r->scene.part_count; i++)
        bsq_free(base->ctx, r->scene.parts[i].object);
    bsq_free(base->ctx, r->scene.parts);
    for (uint64_t i = 0; i < r->scene.material_count; i++) {
        bsq_free(base->ctx, r->scene.materials[i].name);
        bsq_free(base->ctx, r->scene.materials[i].texture);
    }
    bsq_free(base->ctx, r->scene.materials);
    fmt_arrays_free(base->ctx, &r->arrays);
    bsq_free(base->ctx, r);
}

static int open_input(struct scene_reader *r, struct fmt_input *input)
{
    struct bsq_file file = BSQ_FILE_CLOSED;
    int status = fmt_input_open(input);
    if (status)
        return status;
    r->path = fmt_input_path(input);
    r->beside = fmt_input_beside(input);
    status = fmt_input_whole(input, &file);
    if (!status)
        status = read_whole(r, &file);
    bsq_file_close(r->base.ctx, &file);
    const int closed = fmt_input_close(input);
    return status ? status : closed;
}

static int open_reader(struct bsq_ctx *ctx, struct fmt_input *const *inputs, uint32_t input_count,
                       struct fmt_mesh_reader **out)
{
    struct scene_reader *r;
    assert(input_count == 1);
    (void)input_count;
    int status = bsq_calloc(ctx, "scene reader", 1, sizeof *r, &r);
    if (status)
        return status;
    r->base.ctx = ctx;
    status = open_input(r, inputs[0]);
    if (status)
        close_reader(&r->base);
    else
        *out = &r->base;
    return status;
}

/* ---- reading ---- */

/* Passes a block to all steps and adds it to the totals. */
static int deliver(const struct scene_reader *r, const struct fmt_mesh_steps *steps, void *arg,
                   struct fmt_mesh_block *block, struct fmt_mesh_totals *totals)
{
    int status = bsq_check(r->base.ctx);
    if (!status && steps->on_block)
        status = steps->on_block(arg, block);
    if (!status && steps->follow)
        status = steps->follow(arg, block, 0);
    if (!status && steps->follow)
        status = steps->finish(arg, block, 0);
    totals->vertices += block->vertex_count;
    totals->texcoords += block->texcoord_count;
    totals->normals += block->normal_count;
    totals->faces += block->face_count;
    totals->corners += block->corner_count;
    totals->bytes += block->byte_size;
    return status;
}

static uint64_t smaller(uint64_t a, uint64_t b)
{
    return a < b ? a : b;
}

/* Counts vectors of `size` numbers that are NaN. */
static uint64_t count_missing(const double *values, uint64_t count, unsigned size)
{
    uint64_t missing = 0;
    for (uint64_t i = 0; i < count; i++)
        missing += isnan(values[i * size]) != 0;
    return missing;
}

/* Copies vertices to the arrays of a block. */
static int copy_vertices(struct scene_reader *r, uint64_t first, uint64_t count)
{
    const struct fmt_scene *s = &r->scene;
    struct mesh_arrays *a = &r->arrays;
    fmt_arrays_clear(a);
    int status = fmt_arrays_reserve_positions(r->base.ctx, a, count);
    if (!status)
        status = fmt_arrays_reserve_texcoords(r->base.ctx, a, count);
    if (!status)
        status = fmt_arrays_reserve_normals(r->base.ctx, a, count);
    if (!status && s->colors)
        status = fmt_arrays_reserve_colors(r->base.ctx, a, count);
    if (status || count == 0)
        return status;
    memcpy(a->positions, s->positions + first, count * sizeof *a->positions);
    memcpy(a->texcoords, s->texcoords + first, count * sizeof *a->texcoords);
    memcpy(a->normals, s->normals + first, count * sizeof *a->normals);
    if (s->colors)
        memcpy(a->colors, s->colors + first, count * sizeof *a->colors);
    a->has_colors = s->colors != NULL;
    for (int kind = 0; kind < FMT_MESH_KIND_COUNT; kind++)
        a->count[kind] = count;
    return 0;
}

/* The first block has all bytes of the file, also if there are no vertices. */
static int read_vertices(struct scene_reader *r, const struct fmt_mesh_steps *steps, void *arg,
                         uint64_t *sequence, struct fmt_mesh_totals *totals)
{
    const struct fmt_scene *s = &r->scene;
    int status = 0;
    for (uint64_t v = 0; (v == 0 || v < s->vertex_count) && !status; v += BLOCK_ELEMENTS) {
        const uint64_t count = smaller(s->vertex_count - v, BLOCK_ELEMENTS);
        struct fmt_mesh_block block = {
            .sequence = (*sequence)++,
            .byte_size = v == 0 ? r->bytes : 0,
            .byte_offset = v == 0 ? 0 : r->bytes,
            .vertex_base = v,
            .texcoord_base = v,
            .normal_base = v,
            .color_white = 1,
            .missing_positions = count_missing(&s->positions[v][0], count, 3),
            .missing_texcoords = count_missing(&s->texcoords[v][0], count, 2),
            .material_at_start = FMT_MESH_NO_MATERIAL,
        };
        status = copy_vertices(r, v, count);
        fmt_arrays_show(&r->arrays, &block);
        if (!status)
            status = deliver(r, steps, arg, &block, totals);
    }
    return status;
}

/* Copies faces of a part to the arrays of a block. */
static int copy_faces(struct scene_reader *r, const struct fmt_scene_part *part, uint64_t face,
                      uint64_t face_count, uint64_t corner, uint64_t corner_count)
{
    const bool has[FMT_MESH_KIND_COUNT] = {[FMT_MESH_VERTEX] = true,
                                           [FMT_MESH_TEXCOORD] = part->has_texcoords,
                                           [FMT_MESH_NORMAL] = part->has_normals};
    struct mesh_arrays *a = &r->arrays;
    fmt_arrays_clear(a);
    int status = fmt_arrays_reserve_faces(r->base.ctx, a, face_count);
    for (int kind = 0; kind < FMT_MESH_KIND_COUNT && !status; kind++) {
        a->has_corners[kind] = has[kind];
        if (has[kind])
            status =
                fmt_arrays_reserve_corners(r->base.ctx, a, (enum fmt_mesh_kind)kind, corner_count);
        if (has[kind] && !status)
            memcpy(a->corners[kind], r->scene.corners + corner, corner_count * sizeof(uint64_t));
    }
    if (status)
        return status;
    memcpy(a->face_sizes, r->scene.face_sizes + face, face_count * sizeof *a->face_sizes);
    a->face_count = face_count;
    a->corner_count = corner_count;
    return 0;
}

static int read_faces(struct scene_reader *r, const struct fmt_scene_part *part,
                      const struct fmt_mesh_steps *steps, void *arg, uint64_t *sequence,
                      struct fmt_mesh_totals *totals)
{
    const struct fmt_scene *s = &r->scene;
    uint64_t corner = part->first_corner;
    int status = 0;
    for (uint64_t f = part->first_face; f < part[1].first_face && !status;) {
        struct fmt_mesh_block block = {
            .sequence = (*sequence)++,
            .byte_offset = r->bytes,
            .vertex_base = s->vertex_count,
            .texcoord_base = s->vertex_count,
            .normal_base = s->vertex_count,
            .face_base = f,
            .material_at_start = r->base.objects ? (uint32_t)(part - s->parts) : part->material,
        };
        uint64_t corners = 0;
        for (; f < part[1].first_face && corners < 3 * BLOCK_ELEMENTS; f++)
            corners += s->face_sizes[f];
        status = copy_faces(r, part, block.face_base, f - block.face_base, corner, corners);
        fmt_arrays_show(&r->arrays, &block);
        corner += corners;
        if (!status)
            status = deliver(r, steps, arg, &block, totals);
    }
    return status;
}

/* Returns how many meshes have a diffuse colour out of range, which describe_material() clamps.
 * Beside vertex colours, it is one of these. */
static uint64_t count_clamped(const struct fmt_scene *s)
{
    uint64_t count = 0;
    for (uint64_t i = 0; i < s->part_count && !s->colors; i++) {
        const uint32_t number = s->parts[i].material;
        const struct fmt_scene_material *m =
            number < s->material_count ? &s->materials[number] : NULL;
        bool clamped = false;
        for (int k = 0; k < 3 && m && m->has_diffuse && !m->texture; k++)
            clamped |= m->diffuse[k] < 0 || m->diffuse[k] > 1;
        count += clamped;
    }
    return count;
}

/* Warns of what is not read, or not finite. Colours matter only if the caller uses them. */
static int warn_unread(const struct scene_reader *r)
{
    const struct fmt_scene *s = &r->scene;
    const struct {
        uint64_t count;
        const char *what;
    } kinds[] = {
        {s->missing_positions + s->missing_texcoords + s->missing_normals,
         "values are not finite and were left out"},
        {r->uses_colors ? s->missing_colors : 0, "colours are not finite and were left out"},
        {r->uses_colors ? s->inner_textures : 0,
         "textures are inside of the file and are not read: save them and use --texture"},
        {r->uses_colors ? s->turned_textures : 0,
         "textures are turned, or use further texture coordinates, which is not applied"},
        {r->uses_colors ? s->hidden_colors : 0,
         "meshes have a texture, so their vertex colours are not used"},
        {r->uses_colors ? count_clamped(s) : 0,
         "meshes have a diffuse colour out of range, which was clamped"},
    };
    int status = 0;
    for (size_t i = 0; i < sizeof kinds / sizeof *kinds && !status; i++)
        if (kinds[i].count > 0)
            status = bsq_warn_loss(r->base.ctx, "%s: %" PRIu64 " %s", r->path, kinds[i].count,
                                   kinds[i].what);
    return status;
}

static int read_all(struct fmt_mesh_reader *base, const struct fmt_mesh_steps *steps, void *arg,
                    struct fmt_mesh_totals *totals)
{
    struct scene_reader *r = (struct scene_reader *)base;
    const struct fmt_scene *s = &r->scene;
    uint64_t sequence = 0;
    int status = read_vertices(r, steps, arg, &sequence, totals);
    for (uint64_t i = 0; i < s->part_count && !status; i++)
        status = read_faces(r, &s->parts[i], steps, arg, &sequence, totals);
    totals->materials = (uint32_t)(base->objects ? s->part_count : s->material_count);
    totals->short_faces = s->short_faces;
    totals->has_tangents = s->has_tangents;
    totals->split_vertices = true;
    if (!status && !r->read_before)
        status = warn_unread(r);
    r->read_before |= status == 0;
    return status;
}

static int estimate(const struct fmt_mesh_reader *base, struct fmt_mesh_estimate *out)
{
    const struct fmt_scene *s = &((const struct scene_reader *)base)->scene;
    *out = (struct fmt_mesh_estimate){.vertices = s->vertex_count,
                                      .texcoords = s->vertex_count,
                                      .normals = s->vertex_count,
                                      .faces = s->face_count,
                                      .corners = s->corner_count,
                                      .has_colors = s->colors != NULL,
                                      .faces_come_last = true};
    return 0;
}

static int locate_face(struct fmt_mesh_reader *base, uint64_t face, struct fmt_mesh_place *out)
{
    const struct scene_reader *r = (const struct scene_reader *)base;
    (void)face; /* its number tells where it is */
    *out = (struct fmt_mesh_place){.path = r->path, .from_zero = true};
    for (int kind = 0; kind < FMT_MESH_KIND_COUNT; kind++)
        out->count[kind] = r->scene.vertex_count;
    return 0;
}

/* Lists the parts with the names of their materials and objects. */
static int list_parts(struct fmt_mesh_reader *base, struct fmt_materials *out)
{
    const struct fmt_scene *s = &((const struct scene_reader *)base)->scene;
    int status =
        bsq_calloc(base->ctx, "materials", s->part_count + 1, sizeof *out->list, &out->list);
    for (uint64_t i = 0; i < s->part_count && !status; i++, out->count++) {
        const uint32_t material = s->parts[i].material;
        status = fmt_string_copy(base->ctx,
                                 material < s->material_count ? s->materials[material].name : "",
                                 &out->list[i].name);
        if (!status)
            status = fmt_string_copy(base->ctx, s->parts[i].object, &out->list[i].object);
    }
    if (status)
        fmt_materials_free(base->ctx, out);
    return status;
}

/* Describes a material. Its texture is looked for beside the file, as those of MTL files are. */
static int describe_material(const struct scene_reader *r, const struct fmt_scene_material *from,
                             struct fmt_material *out)
{
    struct bsq_ctx *ctx = r->base.ctx;
    for (int k = 0; k < 3; k++)
        out->diffuse[k] = fminf(fmaxf(from->diffuse[k], 0), 1);
    out->has_diffuse = from->has_diffuse;
    out->uv = from->uv;
    int status = fmt_string_copy(ctx, from->name, &out->name);
    if (!status && from->texture)
        status = fmt_path_find(ctx, r->beside, from->texture, &out->texture_path, NULL);
    if (!status && from->texture)
        status = fmt_string_copy(ctx, r->path, &out->texture_place);
    return status;
}

static int list_materials(const struct scene_reader *r, struct fmt_materials *out)
{
    const struct fmt_scene *s = &r->scene;
    struct bsq_ctx *ctx = r->base.ctx;
    int status = bsq_calloc(ctx, "materials", s->material_count + 1, sizeof *out->list, &out->list);
    for (uint64_t i = 0; i < s->material_count && !status; i++)
        status = describe_material(r, &s->materials[i], &out->list[out->count++]);
    if (status)
        fmt_materials_free(ctx, out);
    return status;
}

static int read_materials(struct fmt_mesh_reader *base, struct fmt_materials *out)
{
    return base->objects ? list_parts(base, out)
                         : list_materials((const struct scene_reader *)base, out);
}

static int preview_materials(struct fmt_mesh_reader *base, struct fmt_materials *out)
{
    ((struct scene_reader *)base)->uses_colors = true;
    return list_materials((const struct scene_reader *)base, out);
}

const struct fmt_mesh_format fmt_scene_format = {
    .name = "FBX, COLLADA or the like",
    .suffix = ".fbx .dae .3ds .x",
    .single = true,
    .recognise = recognise,
    .open = open_reader,
    .close = close_reader,
    .read = read_all,
    .estimate = estimate,
    .locate_face = locate_face,
    .read_materials = read_materials,
    .preview_materials = preview_materials,
};
