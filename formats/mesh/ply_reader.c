/* ply_reader.c - reads PLY files as an ordered stream of parsed blocks.
 *
 * Understood: text and binary of both byte orders, numbers of any type, elements in any order.
 * Vertices have positions, normals, colours and texture coordinates. Faces have any number of
 * corners, colours, texture coordinates of corners and a texture's number. Other elements and
 * properties are skipped. */
#include <inttypes.h>
#include <stdio.h>
#include <string.h>

#include "base/context.h"
#include "formats/mesh/mesh_text.h"
#include "formats/mesh/ply_internal.h"

/* ---- opening ---- */

static bool recognise(const char *head, size_t size)
{
    const size_t mark = fmt_mesh_mark(head, size);
    return size >= mark + 4 && memcmp(head + mark, "ply", 3) == 0 &&
           (head[mark + 3] == '\n' || head[mark + 3] == '\r');
}

/* Decides what the properties of a file's header are used for. */
static void choose_use(struct ply_source *source)
{
    const struct ply_element *vertices = fmt_ply_find_element(&source->header, PLY_VERTICES);
    const struct ply_element *faces = fmt_ply_find_element(&source->header, PLY_FACES);
    source->vertex_normals = vertices->role[PLY_NX] != NULL;
    source->corner_texcoords = faces->role[PLY_CORNER_TEXCOORDS];
    source->vertex_texcoords = vertices->role[PLY_S] != NULL;
    if (source->header.texture_count > 0 && (source->corner_texcoords || source->vertex_texcoords))
        source->tags = PLY_TAGS_TEXTURE;
    else if (faces->role[PLY_RED] && !vertices->role[PLY_RED])
        source->tags = PLY_TAGS_COLOR;
}

static int begin(struct stream_source *source)
{
    struct ply_source *file = source->data;
    int status = fmt_input_open(source->input);
    if (!status)
        status = fmt_ply_header_read(source->ctx, source->input, &file->header);
    const int closed = fmt_input_close(source->input);
    BSQ_PASS(status ? status : closed);
    choose_use(file);
    source->material_count = source->object_count = file->header.texture_count;
    return 0;
}

static void end(struct stream_source *source)
{
    struct ply_source *file = source->data;
    fmt_ply_header_free(source->ctx, &file->header);
    bsq_texts_free(&file->colors);
}

/* ---- cutting ----
 *
 * Binary elements without lists have equal sizes, so their blocks need not be loaded here. The
 * sizes of others are found by walking over their lists. Text is cut by counting lines. */

/* The state of one cut. */
struct cutter {
    struct bsq_ctx *ctx;
    const struct stream_source *source;
    const struct ply_header *header;
    const struct ply_element *element;
    struct stream_slot *slot;
    struct stream_block *block; /* of the slot */
    uint64_t limit;             /* elements that are left */
    uint64_t have;              /* bytes loaded */
    bool at_file_end;           /* the file ends with them, for certain */
    bool swap;
};

static uint64_t smaller(uint64_t a, uint64_t b)
{
    return a < b ? a : b;
}

/* Loads `size` bytes from the block's start on, or fewer at the end of the file. */
static int load(struct cutter *c, uint64_t size)
{
    return fmt_stream_extend(c->slot, c->have, size, &c->have, &c->at_file_end);
}

/* Returns the bytes of the file, as far as they are known: there may be more. */
static uint64_t known_size(const struct cutter *c)
{
    const uint64_t size = fmt_input_size(c->source->input);
    return size < UINT64_MAX ? size : c->block->offset + c->have;
}

/* Makes a block of the first `items` elements, which take `size` loaded bytes. */
static int take(struct cutter *c, uint64_t items, uint64_t size)
{
    c->block->items = items;
    c->block->size = size;
    c->block->end = c->block->offset + size;
    c->slot->loaded = true;
    return 1;
}

static int fail_truncated(struct cutter *c)
{
    c->block->end = known_size(c);
    fmt_stream_fail(c->slot,
                    c->block->first_line ? c->block->first_line + c->block->lines : c->block->end,
                    "truncated: the file ends after %" PRIu64 " of %" PRIu64 " elements \"%.40s\"",
                    c->block->first_item, c->element->count, c->element->name);
    return 1;
}

/* Cuts elements of equal size. Elements that are not read become one block. */
static int cut_equal(struct cutter *c)
{
    const uint64_t each = c->element->least_bytes, usual = STREAM_BLOCK_BYTES / each;
    uint64_t items = smaller(c->limit, usual > 0 ? usual : 1), end, file_size;
    if (c->element->kind == PLY_OTHER)
        items = c->limit;
    if (__builtin_mul_overflow(items, each, &end) ||
        __builtin_add_overflow(end, c->block->offset, &end))
        end = UINT64_MAX;
    BSQ_PASS(fmt_input_reach(c->source->input, end, &file_size));
    if (end > file_size || end == UINT64_MAX)
        return fail_truncated(c);
    take(c, items, items * each);
    c->slot->loaded = false;
    return 1;
}

/* Returns the bytes of the element at `from`, where `have` bytes are loaded. Returns 0 if they are
 * too few, or if a list has a negative length; then the slot has an error. */
static uint64_t element_bytes(struct cutter *c, const uint8_t *from, uint64_t have)
{
    const struct ply_property *p = c->header->properties + c->element->first_property;
    uint64_t at = 0;
    for (uint32_t i = 0; i < c->element->property_count; i++, p++) {
        uint64_t each = fmt_ply_type_bytes[p->type];
        if (p->count_type == PLY_NO_TYPE) {
            at += each;
        } else {
            uint64_t prefix = fmt_ply_type_bytes[p->count_type];
            if (have < at || have - at < prefix)
                return 0;
            int64_t length = ply_integer(from + at, p->count_type, c->swap);
            if (length < 0) {
                fmt_stream_fail(c->slot, c->block->offset + (uint64_t)(from - c->slot->bytes) + at,
                                "a list of %" PRId64 " numbers", length);
                return 0;
            }
            at += prefix;
            if ((uint64_t)length > (have - at) / each)
                return 0;
            at += (uint64_t)length * each;
        }
        if (at > have)
            return 0;
    }
    return at;
}

/* Returns how many elements from byte `at` on are triangles, of at most `limit`. It knows only
 * elements with one list, whose length is one byte; most scans have no others. *each: bytes of such
 * a triangle. */
static uint64_t count_triangles(const struct cutter *c, uint64_t at, uint64_t limit, uint64_t *each)
{
    const struct ply_property *p = c->element->role[PLY_INDICES];
    uint64_t items = 0;
    *each = 0;
    if (c->element->list_count != 1 || !p || fmt_ply_type_bytes[p->count_type] != 1)
        return 0;
    *each = c->element->least_bytes + 3 * (uint64_t)fmt_ply_type_bytes[p->type];
    const uint8_t *length = c->slot->bytes + at + p->offset;
    limit = smaller(limit, (c->have - at) / *each);
    for (; items < limit && *length == 3; items++)
        length += *each;
    return items;
}

/* Returns how many of the loaded elements are whole. *size: their bytes. */
static uint64_t count_whole(struct cutter *c, uint64_t *size)
{
    uint64_t items = 0, at = 0, each;
    while (items < c->limit) {
        const uint64_t triangles = count_triangles(c, at, c->limit - items, &each);
        at += triangles * each;
        items += triangles;
        if (items == c->limit)
            break;
        uint64_t bytes = element_bytes(c, c->slot->bytes + at, c->have - at);
        if (bytes == 0)
            break;
        at += bytes;
        items++;
    }
    *size = at;
    return items;
}

/* Cuts elements with lists. Loads more if not even the first one is whole. */
static int cut_lists(struct cutter *c)
{
    uint64_t size, items, wanted = STREAM_BLOCK_BYTES;
    for (;; wanted *= 2) {
        BSQ_PASS(load(c, wanted));
        items = count_whole(c, &size);
        if (items > 0 || c->slot->error[0] || c->at_file_end)
            break;
        BSQ_PASS(bsq_check(c->ctx));
    }
    if (items > 0) {
        /* What is wrong with the next element is reported with the next block. */
        c->slot->error[0] = '\0';
        return take(c, items, size);
    }
    if (c->slot->error[0]) {
        c->block->end = known_size(c);
        return 1;
    }
    return fail_truncated(c);
}

/* Counts the elements in whole lines of the loaded text. Returns the bytes of these lines. */
static uint64_t find_lines(struct stream_slot *slot, uint64_t have, bool at_file_end)
{
    const struct ply_header *header = &((struct ply_source *)slot->source->data)->header;
    struct stream_block *block = &slot->block;
    const uint64_t most = header->elements[block->kind].count - block->first_item;
    const uint8_t *from = slot->bytes, *limit = from + have;
    block->items = block->lines = 0;
    while (block->items < most && from < limit) {
        const uint8_t *end = memchr(from, header->line_end, (size_t)(limit - from));
        if (!end && !at_file_end)
            break;
        end = end ? end : limit;
        block->items += from + fmt_mesh_count_space(from, (uint64_t)(end - from)) < end;
        block->lines++;
        from = end < limit ? end + 1 : end;
    }
    return block->items > 0 ? (uint64_t)(from - slot->bytes) : 0;
}

static int cut_text(struct cutter *c)
{
    int status = fmt_stream_cut_text(c->slot, STREAM_BLOCK_BYTES, find_lines);
    if (status != 0)
        return status;
    return fail_truncated(c);
}

/* Finds the element after `items` ones of element number `number`. Sets c->element and c->limit.
 * Returns false if there is none. */
static bool find_element(struct cutter *c, uint32_t number, uint64_t items)
{
    for (; number < c->header->element_count; number++, items = 0) {
        c->element = &c->header->elements[number];
        c->limit = c->element->count - items;
        c->block->kind = number;
        c->block->first_item = items;
        if (c->limit > 0 && c->element->property_count > 0)
            return true;
    }
    return false;
}

/* What follows the last element becomes a block without elements. */
static int cut_rest(struct cutter *c)
{
    uint64_t file_size;
    int status = fmt_input_reach(c->source->input, UINT64_MAX, &file_size);
    if (status || c->block->offset >= file_size)
        return status;
    c->block->kind = PLY_BLOCK_REST;
    c->block->end = file_size;
    return 1;
}

static int cut(const struct stream_block *before, struct stream_slot *slot)
{
    const struct ply_header *header = &((struct ply_source *)slot->source->data)->header;
    struct cutter c = {.ctx = slot->ctx,
                       .source = slot->source,
                       .header = header,
                       .slot = slot,
                       .block = &slot->block,
                       .swap = header->encoding == PLY_BIG_ENDIAN};
    const bool at_start = before->end == 0, text = header->encoding == PLY_ASCII;
    if (before->kind == PLY_BLOCK_REST)
        return 0;
    c.block->offset = at_start ? header->bytes : before->end;
    if (text)
        c.block->first_line = at_start ? header->lines + 1 : before->first_line + before->lines;
    if (!find_element(&c, before->kind, before->first_item + before->items))
        return cut_rest(&c);
    if (text)
        return cut_text(&c);
    return c.element->list_count > 0 ? cut_lists(&c) : cut_equal(&c);
}

/* ---- reading ---- */

/* Gives each corner the normal and texture coordinate of its vertex. */
static int copy_vertex_indices(struct stream_slot *slot)
{
    const struct ply_source *file = slot->source->data;
    const bool wanted[FMT_MESH_KIND_COUNT] = {
        [FMT_MESH_NORMAL] = file->vertex_normals, [FMT_MESH_TEXCOORD] = file->vertex_texcoords};
    struct mesh_arrays *a = &slot->arrays;
    for (int kind = FMT_MESH_TEXCOORD; kind <= FMT_MESH_NORMAL && a->face_count > 0; kind++) {
        if (!wanted[kind])
            continue;
        BSQ_PASS(
            FMT_RESERVE(slot->ctx, a->corner_count, a->corners[kind], a->corner_capacity[kind]));
        a->has_corners[kind] = true;
        memcpy(a->corners[kind], a->corners[FMT_MESH_VERTEX], a->corner_count * sizeof(uint64_t));
    }
    return 0;
}

static int parse(struct stream_slot *slot)
{
    const struct ply_header *header = &((struct ply_source *)slot->source->data)->header;
    if (slot->block.kind == PLY_BLOCK_REST || header->elements[slot->block.kind].kind == PLY_OTHER)
        return 0;
    const struct ply_element *element = &header->elements[slot->block.kind];
    BSQ_PASS(fmt_stream_load(slot));
    BSQ_PASS(fmt_ply_parse(element, slot));
    slot->local = slot->arrays.count[FMT_MESH_TEXCOORD] > 0 && element->kind != PLY_VERTICES
                      ? 1u << FMT_MESH_TEXCOORD
                      : 0;
    return copy_vertex_indices(slot);
}

/* Warns of bytes after the last element, unless they are blank. */
static int warn_rest(const struct stream_slot *slot)
{
    const struct stream_source *source = slot->source;
    const uint64_t bytes = slot->block.end - slot->block.offset;
    char sample[256];
    uint64_t got;
    BSQ_PASS(fmt_input_read_some(source->input, sample, sizeof sample, slot->block.offset, &got));
    if (fmt_mesh_count_space(sample, got) < bytes && !source->reader->read_before)
        BSQ_PASS(bsq_warn_loss(source->ctx, "%s: %" PRIu64 " bytes after the last element not read",
                               source->path, bytes));
    return 0;
}

/* ---- materials of faces ---- */

/* Returns the first PLY file of the scan, which has the colours of faces of all of them. */
static struct stream_source *colors_owner(const struct stream_source *source)
{
    struct stream_source *first = source->reader->sources;
    while (first->format != &fmt_ply_format)
        first++;
    return first;
}

/* Sets *number to the number of a colour of faces. */
static int enter_color(struct stream_source *owner, uint32_t color, uint64_t *number)
{
    static const char digits[] = "0123456789abcdef";
    struct ply_source *file = owner->data;
    const uint32_t slot = color * 0x9e3779b1u >> 20;
    char name[8] = "#";
    int status = 0;
    if (file->cached[slot].entry == 0 || file->cached[slot].color != color) {
        for (int i = 0; i < 6; i++)
            name[1 + i] = digits[color >> (8 * (i / 2) + (i % 2 ? 0 : 4)) & 15];
        status = bsq_texts_add(owner->ctx, &owner->reader->names, &file->colors, name, number);
        file->cached[slot].color = color;
        file->cached[slot].entry = status ? 0 : (uint32_t)*number + 1;
    }
    *number = file->cached[slot].entry - UINT64_C(1);
    return status;
}

/* Sets *material to the number over the scan of a face's material. */
static int find_material(const struct stream_source *source, uint32_t tag, uint32_t *material)
{
    struct stream_source *owner = colors_owner(source);
    const struct ply_source *file = source->data;
    uint64_t number;
    *material = FMT_MESH_NO_MATERIAL;
    if (tag != PLY_NO_TAG && file->tags == PLY_TAGS_TEXTURE) {
        *material = source->numbers[tag];
    } else if (tag != PLY_NO_TAG) {
        BSQ_PASS(enter_color(owner, tag, &number));
        const uint64_t place = owner->material_count + number; /* textures come first */
        if (place == owner->number_count)
            BSQ_PASS(fmt_stream_add_material(owner, material));
        *material = owner->numbers[place];
    }
    return 0;
}

/* Turns face_tags into changes of material. */
static int find_materials(struct stream_slot *slot)
{
    struct mesh_arrays *a = &slot->arrays;
    for (uint64_t face = 0; face < a->face_count; face++) {
        const uint32_t tag = a->face_tags[face];
        if (face > 0 && tag == a->face_tags[face - 1])
            continue;
        BSQ_PASS(FMT_RESERVE(slot->ctx, a->change_count + 1, a->changes, a->change_capacity));
        struct fmt_mesh_material_change *change = &a->changes[a->change_count++];
        change->face = face;
        BSQ_PASS(find_material(slot->source, tag, &change->material));
    }
    return 0;
}

static int pass(struct stream_slot *slot)
{
    const struct ply_source *file = slot->source->data;
    if (slot->block.kind == PLY_BLOCK_REST)
        return warn_rest(slot);
    return file->tags != PLY_TAGS_NONE ? find_materials(slot) : 0;
}

static int describe_texture(const struct stream_source *source, const char *name,
                            struct fmt_material *out)
{
    bool exists;
    BSQ_PASS(bsq_text_copy(source->ctx, name, &out->name));
    BSQ_PASS(fmt_path_find(source->ctx, fmt_input_beside(source->input), name,
                           &out->color.texture_path, &exists));
    return bsq_text_copy(source->ctx, source->path, &out->color.texture_place);
}

static int describe_color(struct bsq_ctx *ctx, const char *name, struct fmt_material *out)
{
    unsigned color[3] = {0};
    sscanf(name, "#%2x%2x%2x", &color[0], &color[1], &color[2]);
    for (int c = 0; c < 3; c++)
        out->color.value[c] = (float)color[c] / 255.0f;
    out->color.has_value = true;
    return bsq_text_copy(ctx, name, &out->name);
}

/* Lists the textures that comments name, and then the colours of faces. */
static int read_materials(struct stream_source *source, struct fmt_materials *out)
{
    const struct ply_source *file = source->data;
    struct fmt_material *material;
    for (uint32_t i = 0; i < file->header.texture_count; i++) {
        BSQ_PASS(fmt_materials_add(source->ctx, out, &material));
        BSQ_PASS(describe_texture(source, file->header.textures[i], material));
    }
    for (uint64_t i = 0; i < file->colors.count; i++) {
        BSQ_PASS(fmt_materials_add(source->ctx, out, &material));
        BSQ_PASS(describe_color(source->ctx, file->colors.list[i], material));
    }
    return 0;
}

/* ---- warnings ---- */

/* Warns of elements, properties, colours and textures that are not used. */
static int finish(struct stream_source *source)
{
    const struct ply_source *file = source->data;
    const struct ply_element *faces = fmt_ply_find_element(&file->header, PLY_FACES);
    const bool textured = file->tags == PLY_TAGS_TEXTURE;
    if (source->reader->read_before)
        return 0;
    fmt_ply_warn_unread(source->ctx, source->path, &file->header);
    if (file->header.texture_count > 0 && !textured)
        BSQ_PASS(bsq_warn_loss(source->ctx,
                               "%s: no texture coordinates, so the texture %s is not used",
                               source->path, file->header.textures[0]));
    if (faces->role[PLY_RED] && file->tags != PLY_TAGS_COLOR)
        return bsq_warn_loss(source->ctx, "%s: colours of faces are not used beside %s",
                             source->path, textured ? "a texture" : "those of vertices");
    return 0;
}

static int look(struct stream_source *source, struct fmt_mesh_hints *out)
{
    const struct ply_source *file = source->data;
    const struct ply_header *h = &file->header;
    out->has_texcoords |= file->vertex_texcoords || file->corner_texcoords;
    out->faces_come_last &= !file->corner_texcoords && fmt_ply_find_element(h, PLY_FACES) >
                                                           fmt_ply_find_element(h, PLY_VERTICES);
    return 0;
}

static const char lost_textures[] =
    "faces whose texnumber, from 0, is not below the number of textures that the file names; they "
    "have no texture";
static const char clamped_colors[] =
    "colours of faces are out of range and were clamped; real numbers range to 1";

const struct fmt_mesh_format fmt_ply_format = {
    .name = "PLY",
    .suffix = ".ply",
    .data_bytes = sizeof(struct ply_source),
    .oddities = {[STREAM_NO_POSITION] = "positions are not finite or incomplete and were left out",
                 [STREAM_NO_NORMAL] = "normals are not finite or incomplete and were left out",
                 [STREAM_NO_COLOR] = "colours are not finite or incomplete and were left out",
                 [STREAM_NO_TEXCOORD] =
                     "texture coordinates are not finite or incomplete and were left out",
                 [PLY_BAD_TEXCOORDS] =
                     "texture coordinates of corners are incomplete and were left out",
                 [PLY_CLAMPED_COLORS] = clamped_colors,
                 [PLY_LOST_TEXTURES] = lost_textures},
    .recognise = recognise,
    .begin = begin,
    .end = end,
    .cut = cut,
    .parse = parse,
    .pass = pass,
    .finish = finish,
    .look = look,
    .read_materials = read_materials,
    .preview_materials = read_materials,
};
