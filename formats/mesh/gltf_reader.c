/* gltf_reader.c - reads glTF 2.0 files, .gltf and GLB, as an ordered stream of parsed blocks.
 *
 * A file's JSON says where its elements are, so blocks are cut without reading anything: first all
 * vertices, then all faces, each in the order of nodes and primitives. Buffers are read in blocks,
 * and memory does not grow with them. */
#include <inttypes.h>
#include <math.h>
#include <string.h>

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

/* Reads all elements of a top-level array. *list: becomes an array of elements of `bytes` bytes,
 * with space for one more. */
static int read_list(struct gltf_document *document, struct gltf_source *file, const char *array,
                     uint64_t bytes, void *list, uint32_t *count,
                     int (*read)(const struct gltf_item *, struct gltf_source *, void *))
{
    const uint64_t all = fmt_gltf_count(document, array);
    uint8_t *elements;
    BSQ_PASS((bsq_calloc)(document->ctx, array, all + 1, bytes, list));
    memcpy(&elements, list, sizeof elements);
    for (uint64_t i = 0; i < all; i++) {
        const struct gltf_item item = fmt_gltf_element(document, array, i);
        if (i % 1024 == 0)
            BSQ_PASS(bsq_check(document->ctx));
        ++*count;
        BSQ_PASS(read(&item, file, elements + i * bytes));
    }
    return 0;
}

/* Allocates the primitives of all meshes. */
static int allocate_primitives(struct gltf_document *document, struct gltf_source *source)
{
    const uint64_t count = fmt_gltf_count(document, "meshes");
    uint64_t primitives = 1;
    for (uint64_t i = 0; i < count; i++)
        primitives += json_array_size(
            json_object_get(fmt_gltf_element(document, "meshes", i).object, "primitives"));
    return BSQ_CALLOC(document->ctx, "glTF primitives", primitives, &source->primitives);
}

#define READ_LIST(name, list, count, read)                                                         \
    read_list(document, file, name, sizeof *file->list, &file->list, &file->count, read)

static int read_document(struct gltf_document *document, struct gltf_source *file)
{
    file->bytes = document->file.size;
    BSQ_PASS(READ_LIST("buffers", buffers, buffer_count, fmt_gltf_read_buffer));
    file->view_capacity = fmt_gltf_count(document, "bufferViews") + 1;
    BSQ_PASS(READ_LIST("bufferViews", views, view_count, fmt_gltf_read_view));
    BSQ_PASS(READ_LIST("accessors", accessors, accessor_count, fmt_gltf_read_accessor));
    BSQ_PASS(READ_LIST("materials", materials, material_count, fmt_gltf_read_material));
    BSQ_PASS(allocate_primitives(document, file));
    BSQ_PASS(READ_LIST("meshes", meshes, mesh_count, fmt_gltf_read_mesh));
    return fmt_gltf_read_scene(document, file);
}

static int begin(struct stream_source *source)
{
    struct gltf_source *file = source->data;
    struct gltf_document document;
    file->own = file->decoded.file = (struct bsq_file)BSQ_FILE_CLOSED;
    BSQ_PASS(fmt_input_open(source->input));
    int status = fmt_gltf_open_document(source->ctx, source->input, &document);
    file->size = document.file.size;
    if (!status)
        status = read_document(&document, file);
    fmt_gltf_close_document(&document);
    const int closed = fmt_input_close(source->input);
    source->material_count = file->material_count;
    source->object_count = file->object_count;
    source->reader->gltf_colors |= file->has_colors;
    return status ? status : closed;
}

static void end(struct stream_source *source)
{
    struct bsq_ctx *ctx = source->ctx;
    struct gltf_source *file = source->data;
    bsq_file_close(ctx, &file->own);
    fmt_gltf_free_buffers(ctx, file);
    for (uint32_t i = 0; i < file->material_count; i++)
        fmt_material_free(ctx, &file->materials[i].described);
    BSQ_FREE(ctx, file->materials, file->accessors, file->primitives, file->meshes);
    for (uint32_t i = 0; i < file->placement_count; i++)
        bsq_free(ctx, file->placements[i].name);
    bsq_free(ctx, file->placements);
}

/* ---- cutting ---- */

/* What a block holds: stream_block.kind is its placement, .carry its primitive, .carry_out this. */
enum { GLTF_VERTICES, GLTF_FACES };

static uint64_t count_items(const struct gltf_source *source, const struct stream_block *block)
{
    const struct gltf_primitive *p = &source->primitives[block->carry];
    return block->carry_out == GLTF_FACES ? p->triangles
                                          : gltf_accessor_of(source, p, GLTF_POSITION)->count;
}

/* Goes on to the next primitive, placement or kind of elements. Returns false at the end. */
static bool advance(const struct gltf_source *source, struct stream_block *block)
{
    const struct gltf_mesh *mesh = &source->meshes[source->placements[block->kind].mesh];
    block->first_item = 0;
    if (++block->carry < mesh->first + mesh->count)
        return true;
    if (++block->kind == source->placement_count) {
        block->kind = 0;
        block->carry_out++;
    }
    block->carry = source->meshes[source->placements[block->kind].mesh].first;
    return block->carry_out <= GLTF_FACES;
}

/* Returns how many elements a block has: its bytes, and the arrays that they become, fit a core's
 * cache. */
static uint64_t usual_items(const struct gltf_source *source, const struct stream_block *block)
{
    const struct gltf_primitive *p = &source->primitives[block->carry];
    uint64_t bytes = 32;
    if (block->carry_out == GLTF_FACES)
        return STREAM_BLOCK_BYTES / 24 + 1;
    for (int use = 0; use < GLTF_INDEX; use++) {
        const struct gltf_accessor *a = gltf_accessor_of(source, p, (enum gltf_use)use);
        const uint64_t stride = a ? fmt_gltf_stride(source, a) : 0;
        bytes = stride > bytes ? stride : bytes;
    }
    return STREAM_BLOCK_BYTES / bytes + 1;
}

/* The bytes of the file are shared out by elements, as a measure of progress. block->left counts
 * the elements of this and of earlier blocks. */
static int cut(const struct stream_block *before, struct stream_slot *slot)
{
    const struct gltf_source *source = slot->source->data;
    const uint64_t size = source->size;
    const uint64_t all = source->total[FMT_MESH_VERTEX] + source->triangles;
    struct stream_block *block = &slot->block;
    if (before->left == all && (all > 0 || before->end > 0))
        return 0;
    slot->loaded = true; /* parsing reads what it needs */
    *block = *before;
    block->end = size;
    if (all == 0)
        return 1;
    block->first_item += before->items;
    if (before->left == 0)
        block->carry = source->meshes[source->placements[0].mesh].first;
    else if (block->first_item == count_items(source, block))
        advance(source, block);
    const uint64_t rest = count_items(source, block) - block->first_item;
    const uint64_t usual = usual_items(source, block);
    block->items = rest < usual ? rest : usual;
    block->left = before->left + block->items;
    block->end = (uint64_t)((unsigned __int128)size * block->left / all);
    return 1;
}

/* ---- parsing ----
 *
 * A vertex or triangle is read again for each node that places its mesh. */

/* What a block belongs to. */
struct parser {
    struct stream_slot *slot;
    const struct gltf_source *source;
    const struct gltf_placement *placement;
    const struct gltf_primitive *primitive;
    uint64_t first, count; /* vertices or triangles of the primitive */
    struct mesh_arrays *arrays;
};

/* Decodes an attribute of the block's vertices. */
static int decode(const struct parser *p, enum gltf_use use, const double **out)
{
    return fmt_gltf_decode(p->slot, p->primitive->accessors[use], p->first, p->count, out);
}

/* ---- vertices ---- */

static int parse_positions(struct parser *p)
{
    const double(*m)[4] = p->placement->matrix;
    const double *from;
    BSQ_PASS(decode(p, GLTF_POSITION, &from));
    for (uint64_t i = 0; i < p->count; i++, from += 3)
        for (int k = 0; k < 3; k++)
            p->arrays->positions[i][k] =
                m[k][0] * from[0] + m[k][1] * from[1] + m[k][2] * from[2] + m[k][3];
    return 0;
}

static int parse_normals(struct parser *p)
{
    const double(*m)[3] = p->placement->normal_matrix;
    const double *from;
    BSQ_PASS(decode(p, GLTF_NORMAL, &from));
    for (uint64_t i = 0; i < p->count; i++, from += 3)
        for (int k = 0; k < 3; k++) {
            const double value = m[k][0] * from[0] + m[k][1] * from[1] + m[k][2] * from[2];
            p->arrays->normals[i][k] = fabs(value) <= 3e38 ? (float)value : NAN;
        }
    return 0;
}

/* v of glTF points downwards, v of a batch upwards. */
static int parse_texcoords(struct parser *p)
{
    static const double plain[2][3] = {{1, 0, 0}, {0, 1, 0}};
    const uint32_t material = p->primitive->material;
    const double(*m)[3] = material == GLTF_NONE
                              ? plain
                              : (const double(*)[3])p->source->materials[material].uv_matrix;
    const double *from;
    BSQ_PASS(decode(p, GLTF_TEXCOORD, &from));
    for (uint64_t i = 0; i < p->count; i++, from += 2) {
        double *to = p->arrays->texcoords[i];
        to[0] = m[0][0] * from[0] + m[0][1] * from[1] + m[0][2];
        to[1] = 1 - (m[1][0] * from[0] + m[1][1] * from[1] + m[1][2]);
    }
    return 0;
}

/* Returns the sRGB value of linear light. One out of range stays so, for callers that count them;
 * it is above -1, which stands for no colour. */
static float display_color(double linear)
{
    const bool inside = linear >= 0.0 && linear <= 1.0;
    return (float)(inside ? bsq_linear_to_srgb(linear) : fmax(linear, -0.5));
}

/* Colours are linear, and factors of the material's. If any vertex of the scan has a colour, the
 * others get that of their material, because colours of vertices hide those of materials, or
 * multiply their textures. */
static int parse_colors(struct parser *p)
{
    static const double white[3] = {1, 1, 1};
    const struct gltf_accessor *own = gltf_accessor_of(p->source, p->primitive, GLTF_COLOR);
    const uint32_t material = p->primitive->material, step = own ? own->components : 0;
    const double *factor = material == GLTF_NONE ? white : p->source->materials[material].color;
    const double *from = white;
    const int status = own ? decode(p, GLTF_COLOR, &from) : 0;
    for (uint64_t i = 0; !status && i < p->count; i++, from += step)
        for (int k = 0; k < 3; k++)
            p->arrays->colors[i][k] = isfinite(from[k]) ? display_color(from[k] * factor[k]) : NAN;
    p->slot->color_white = 1;
    p->slot->fine_colors =
        !own || own->component != GLTF_UINT8 || factor[0] != 1 || factor[1] != 1 || factor[2] != 1;
    return status;
}

static int reserve_vertices(const struct parser *p)
{
    struct bsq_ctx *ctx = p->slot->ctx;
    struct mesh_arrays *a = p->arrays;
    const uint32_t *accessors = p->primitive->accessors;
    a->count[FMT_MESH_VERTEX] = p->count;
    a->count[FMT_MESH_NORMAL] = accessors[GLTF_NORMAL] != GLTF_NONE ? p->count : 0;
    a->count[FMT_MESH_TEXCOORD] = accessors[GLTF_TEXCOORD] != GLTF_NONE ? p->count : 0;
    a->has_colors = p->slot->source->reader->gltf_colors;
    BSQ_PASS(FMT_RESERVE(ctx, p->count, a->positions, a->position_capacity));
    BSQ_PASS(FMT_RESERVE(ctx, a->count[FMT_MESH_NORMAL], a->normals, a->normal_capacity));
    BSQ_PASS(FMT_RESERVE(ctx, a->count[FMT_MESH_TEXCOORD], a->texcoords, a->texcoord_capacity));
    if (a->has_colors)
        BSQ_PASS(FMT_RESERVE(ctx, p->count, a->colors, a->color_capacity));
    return 0;
}

static int parse_vertices(struct parser *p)
{
    BSQ_PASS(reserve_vertices(p));
    BSQ_PASS(parse_positions(p));
    if (p->arrays->count[FMT_MESH_NORMAL] > 0)
        BSQ_PASS(parse_normals(p));
    if (p->arrays->count[FMT_MESH_TEXCOORD] > 0)
        BSQ_PASS(parse_texcoords(p));
    if (p->arrays->has_colors)
        BSQ_PASS(parse_colors(p));
    return 0;
}

/* ---- faces ---- */

/* Entries of a primitive's list of indices; without a list, entry i is i. */
struct window {
    const double *values; /* NULL: there is no list */
    uint64_t first, count;
    uint64_t start; /* entry 0, which each triangle of a fan has */
};

static int load_window(const struct parser *p, struct window *w)
{
    const uint32_t mode = p->primitive->mode, list = p->primitive->accessors[GLTF_INDEX];
    *w = (struct window){.first = p->first, .count = p->count + 2};
    if (mode == 4)
        *w = (struct window){.first = 3 * p->first, .count = 3 * p->count};
    if (list == GLTF_NONE)
        return 0;
    if (mode == 6) {
        BSQ_PASS(fmt_gltf_decode(p->slot, list, 0, 1, &w->values));
        w->start = (uint64_t)w->values[0];
    }
    return fmt_gltf_decode(p->slot, list, w->first, w->count, &w->values);
}

static uint64_t entry(const struct window *w, uint64_t i)
{
    if (!w->values)
        return i;
    return i < w->first ? w->start : (uint64_t)w->values[i - w->first];
}

/* Sets the vertices of a triangle, numbered in the primitive. Every second one of a strip is in
 * reverse order in the file. */
static void find_corners(const struct parser *p, const struct window *w, uint64_t triangle,
                         uint64_t out[3])
{
    const uint64_t t = triangle, odd = t & 1;
    const uint64_t entries[3][3] = {
        {3 * t, 3 * t + 1, 3 * t + 2}, {t, t + 1 + odd, t + 2 - odd}, {t + 1, t + 2, 0}};
    const uint64_t *own = entries[p->primitive->mode - 4];
    for (int i = 0; i < 3; i++)
        out[i] = entry(w, own[i]);
    if (p->placement->mirrored) {
        const uint64_t last = out[2];
        out[2] = out[1];
        out[1] = last;
    }
}

static void add_triangle(const struct parser *p, const uint64_t corners[3],
                         const uint64_t base[FMT_MESH_KIND_COUNT])
{
    struct mesh_arrays *a = p->arrays;
    for (int kind = 0; kind < FMT_MESH_KIND_COUNT; kind++)
        for (int i = 0; i < 3 && (kind == FMT_MESH_VERTEX || a->has_corners[kind]); i++)
            a->corners[kind][a->corner_count + (uint64_t)i] = base[kind] + corners[i];
    a->corner_count += 3;
    a->face_sizes[a->face_count++] = 3;
}

/* Adds the triangles of the block. In strips and fans, triangles that name a vertex twice only
 * connect others; they are left out. */
static int add_triangles(const struct parser *p, const struct window *w)
{
    const uint64_t vertices = gltf_accessor_of(p->source, p->primitive, GLTF_POSITION)->count;
    uint64_t base[FMT_MESH_KIND_COUNT], v[3];
    for (int kind = 0; kind < FMT_MESH_KIND_COUNT; kind++)
        base[kind] = p->placement->base[kind] + p->primitive->base[kind];
    p->arrays->vertex_bound = base[FMT_MESH_VERTEX] + vertices;
    for (uint64_t t = p->first; t < p->first + p->count; t++) {
        find_corners(p, w, t, v);
        for (int i = 0; i < 3; i++)
            if (v[i] >= vertices)
                return fmt_stream_fail(p->slot, 0,
                                       "meshes[%" PRIu32 "], primitive %" PRIu32
                                       ": triangle %" PRIu64 " refers to vertex %" PRIu64
                                       ", there are %" PRIu64,
                                       p->primitive->mesh, p->primitive->number, t, v[i], vertices);
        if (p->primitive->mode == 4 || (v[0] != v[1] && v[1] != v[2] && v[2] != v[0]))
            add_triangle(p, v, base);
    }
    return 0;
}

/* Returns the number in the file of a primitive at a node. The stream checks that it fits. */
static uint32_t object_of(const struct parser *p)
{
    const uint64_t primitive = (uint64_t)(p->primitive - p->source->primitives) -
                               p->source->meshes[p->placement->mesh].first;
    return (uint32_t)(p->placement->object_base + primitive);
}

static int reserve_faces(const struct parser *p)
{
    const bool wanted[FMT_MESH_KIND_COUNT] = {
        [FMT_MESH_VERTEX] = true,
        [FMT_MESH_TEXCOORD] = p->primitive->accessors[GLTF_TEXCOORD] != GLTF_NONE,
        [FMT_MESH_NORMAL] = p->primitive->accessors[GLTF_NORMAL] != GLTF_NONE};
    struct mesh_arrays *a = p->arrays;
    BSQ_PASS(FMT_RESERVE(p->slot->ctx, p->count, a->face_sizes, a->size_capacity));
    for (int kind = 0; kind < FMT_MESH_KIND_COUNT; kind++) {
        if (!wanted[kind])
            continue;
        BSQ_PASS(
            FMT_RESERVE(p->slot->ctx, 3 * p->count, a->corners[kind], a->corner_capacity[kind]));
        a->has_corners[kind] = true;
    }
    return FMT_RESERVE(p->slot->ctx, 1, a->changes, a->change_capacity);
}

static int parse_faces(struct parser *p)
{
    struct window window;
    BSQ_PASS(reserve_faces(p));
    BSQ_PASS(load_window(p, &window));
    BSQ_PASS(add_triangles(p, &window));
    p->arrays->change_count = p->arrays->face_count > 0;
    p->arrays->changes[0] = (struct fmt_mesh_material_change){
        .face = 0,
        .material = p->slot->source->reader->objects      ? object_of(p)
                    : p->primitive->material == GLTF_NONE ? FMT_MESH_NO_MATERIAL
                                                          : p->primitive->material};
    return 0;
}

/* ---- blocks ---- */

static int parse(struct stream_slot *slot)
{
    const struct gltf_source *source = slot->source->data;
    struct parser p = {
        .slot = slot,
        .source = source,
        .first = slot->block.first_item,
        .count = slot->block.items,
        .arrays = &slot->arrays,
    };
    if (p.count == 0)
        return 0;
    p.placement = &source->placements[slot->block.kind];
    p.primitive = &source->primitives[slot->block.carry];
    return slot->block.carry_out == GLTF_VERTICES ? parse_vertices(&p) : parse_faces(&p);
}

/* ---- reading ---- */

/* Opens the buffers, and prepares what can only be read whole. */
static int enter(struct stream_source *source)
{
    struct gltf_source *file = source->data;
    if (file->own.fd < 0)
        BSQ_PASS(fmt_input_whole(source->input, &file->own));
    BSQ_PASS(fmt_gltf_open_buffers(source->ctx, file));
    return fmt_gltf_unpack(source->ctx, file);
}

static int leave(struct stream_source *source)
{
    struct gltf_source *file = source->data;
    bsq_file_close(source->ctx, &file->own);
    return fmt_gltf_close_buffers(source->ctx, file);
}

static int pass(struct stream_slot *slot)
{
    struct fmt_mesh_totals *totals = slot->source->reader->totals;
    fmt_stream_number_materials(slot);
    totals->split_vertices = true;
    totals->flat_normals = true;
    const struct gltf_source *source = slot->source->data;
    totals->has_tangents |= source->has_tangents;
    totals->uneven_scale |= source->uneven_scale;
    return 0;
}

/* Warns of what is not read. Colours matter only if the caller uses them. */
static int finish(struct stream_source *source)
{
    const struct gltf_unread *unread = &((struct gltf_source *)source->data)->unread;
    const bool colors = source->reader->uses_colors;
    const struct stream_unread kinds[] = {
        {unread->points, false, "primitives of points or lines are not read"},
        {unread->bare, true, "primitives without positions are not read"},
        {unread->rest, true, "indices of incomplete triangles are not read"},
        {unread->outside, true, "nodes with meshes are not in the scene and are not read"},
        {unread->unplaced, true, "meshes are at no node and are not read"},
        {unread->skins, false, "meshes have skins, which are not applied: they are in bind pose"},
        {unread->morphs, true, "meshes have weights of morph targets, which are not applied"},
        {unread->instances, true,
         "nodes have EXT_mesh_gpu_instancing, of which one instance is read"},
        {unread->hidden, true, "nodes are hidden by KHR_node_visibility, but are read"},
        {colors ? unread->images : 0, true,
         "textures have a format or an address that is not read"},
        {colors ? unread->packed_images : 0, true,
         "textures are inside of a packed file or a pipe: unpack it"},
        {colors ? unread->other_colors : 0, true,
         "primitives have COLOR_1 or the like without COLOR_0, which is not read"},
        {colors ? unread->variants : 0, true,
         "primitives have KHR_materials_variants, of which only the first material is read"},
    };
    return fmt_stream_warn_unread(source, kinds, sizeof kinds / sizeof *kinds);
}

static int look(struct stream_source *source, struct fmt_mesh_hints *out)
{
    const struct gltf_source *file = source->data;
    out->has_texcoords |= file->total[FMT_MESH_TEXCOORD] > 0;
    return 0;
}

/* ---- materials and other files ---- */

static int list_materials(struct stream_source *source, struct fmt_materials *out)
{
    const struct gltf_source *file = source->data;
    struct fmt_material *material;
    for (uint32_t i = 0; i < file->material_count; i++) {
        BSQ_PASS(fmt_materials_add(source->ctx, out, &material));
        BSQ_PASS(fmt_material_copy(source->ctx, &file->materials[i].described, material));
        material->tinted = material->color.texture_path && source->reader->gltf_colors;
    }
    return 0;
}

/* Objects are the primitives of each placement, in the order of their numbers. */
static const char *find_object(const struct stream_source *source, uint64_t number,
                               uint32_t *material)
{
    const struct gltf_source *file = source->data;
    uint64_t low = 0, high = file->placement_count;
    while (high - low > 1) {
        const uint64_t middle = low + (high - low) / 2;
        *(file->placements[middle].object_base <= number ? &low : &high) = middle;
    }
    const struct gltf_placement *placement = &file->placements[low];
    const uint32_t first = file->meshes[placement->mesh].first;
    *material = file->primitives[first + (number - placement->object_base)].material;
    return placement->name;
}

#define LEFT_OUT " are not finite and were left out"

const struct fmt_mesh_format fmt_gltf_format = {
    .name = "glTF",
    .suffix = ".gltf",
    .data_bytes = sizeof(struct gltf_source),
    .oddities = {[STREAM_NO_POSITION] = "positions" LEFT_OUT,
                 [STREAM_NO_NORMAL] = "normals" LEFT_OUT,
                 [STREAM_NO_TEXCOORD] = "texture coordinates" LEFT_OUT,
                 [STREAM_NO_COLOR] = "colours" LEFT_OUT},
    .recognise = recognise,
    .begin = begin,
    .end = end,
    .enter = enter,
    .leave = leave,
    .cut = cut,
    .parse = parse,
    .pass = pass,
    .finish = finish,
    .look = look,
    .read_materials = list_materials,
    .preview_materials = list_materials,
    .find_object = find_object,
};
