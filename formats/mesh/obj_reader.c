/* obj_reader.c - reads Wavefront OBJ files as an ordered stream of parsed blocks.
 *
 * Understood: v with 2 to 7 numbers, vt, vn, f with all four forms of indices and any number
 * of corners, negative indices, usemtl, mtllib; CRLF, tabs, line continuation, comments, exponents.
 * If the caller wants objects, also o and g. Other statements (s, l, p, ...) are skipped.
 *
 * A file is cut after the last line that is whole, without looking at the lines before it. */
#include <inttypes.h>
#include <stdio.h>
#include <string.h>

#include "formats/mesh/mesh_text.h"
#include "formats/mesh/obj_internal.h"

/* After this many unknown lines, and no known statement, a file is not taken for OBJ. */
enum { PATIENCE_LINES = 1000 };

static void end(struct stream_source *source)
{
    struct obj_file *file = source->data;
    BSQ_FREE(source->ctx, file->library_lines, file->object);
    bsq_texts_free(&file->materials);
    bsq_texts_free(&file->objects);
    bsq_texts_free(&file->libraries);
}

/* ---- cutting and parsing ---- */

/* Returns whether a line ends with byte `at` of `have` loaded ones. After a backslash it does not:
 * inside a comment it does, but the file need not be cut there. After a last "\r" may come "\n". */
static bool ends_line(const uint8_t *text, uint64_t at, uint64_t have)
{
    if (text[at] != '\n' && (text[at] != '\r' || at + 1 == have))
        return false;
    at -= text[at] == '\n' && at > 0 && text[at - 1] == '\r';
    return at == 0 || text[at - 1] != '\\';
}

/* Returns the bytes of whole lines in loaded text. One with a zero byte is whole: the parser says
 * that it is no text, and need not see more of it. */
static uint64_t find_lines(struct stream_slot *slot, uint64_t have, bool at_file_end)
{
    uint64_t size = have;
    while (size > 0 && !ends_line(slot->bytes, size - 1, have))
        size--;
    return at_file_end || (size == 0 && memchr(slot->bytes, '\0', have)) ? have : size;
}

/* Cuts a block of full size from a plain file, if the file does not end in it. Reads only the end
 * of the block, to find a line end there: workers read the rest, several blocks at a time. Leaves
 * the size 0 if the block cannot be cut this way. */
static int cut_by_end(struct stream_slot *slot)
{
    enum { TAIL = 4096 };
    struct stream_block *block = &slot->block;
    const struct fmt_input *input = slot->source->input;
    const uint64_t most = block->offset + OBJ_BLOCK_BYTES;
    uint64_t size = TAIL;
    if (!fmt_input_is_plain(input) || fmt_input_size(input) <= most)
        return 0;
    BSQ_PASS(fmt_stream_reserve(slot, TAIL));
    BSQ_PASS(fmt_input_read(slot->source->input, slot->bytes, TAIL, most - TAIL));
    /* What is before the tail may be a backslash. */
    while (size > 2 && !ends_line(slot->bytes, size - 1, TAIL))
        size--;
    block->size = size > 2 ? OBJ_BLOCK_BYTES - TAIL + size : 0;
    block->end = block->offset + block->size;
    return 0;
}

static int cut(const struct stream_block *before, struct stream_slot *slot)
{
    slot->block.first_item = before->end > 0 ? before->first_item + 1 : 0;
    slot->block.offset = before->end;
    BSQ_PASS(cut_by_end(slot));
    return slot->block.size > 0 ? 1 : fmt_stream_cut_text(slot, OBJ_BLOCK_BYTES, find_lines);
}

static int parse(struct stream_slot *slot)
{
    BSQ_PASS(fmt_stream_load(slot));
    return fmt_obj_parse_text(slot, 0, slot->block.size, slot->source->reader->objects);
}

/* ---- passing in order ---- */

/* Reports a relative vertex index that points before the start of the file: at corner number
 * `corner` of the block. Returns BSQ_EDATA. */
static int fail_relative(const struct stream_slot *slot, uint64_t corner)
{
    const enum fmt_mesh_kind kind = FMT_MESH_VERTEX;
    const struct mesh_arrays *a = &slot->arrays;
    const int64_t distance = (int64_t)(a->corners[kind][corner] - OBJ_RELATIVE_ZERO);
    struct stream_slot again;
    uint64_t face = 0;
    for (uint64_t end = a->face_sizes[0]; end <= corner; end += a->face_sizes[face])
        face++;
    int status = fmt_stream_parse_again(slot->source, &slot->block, face, &again);
    const uint64_t count = again.arrays.count[kind];
    fmt_stream_free_slot(&again);
    BSQ_PASS(status);
    return bsq_fail(slot->ctx, BSQ_EDATA,
                    "%s:%" PRIu64 ": face refers to %s %" PRId64 ", file has %" PRIu64 " so far",
                    slot->source->path, again.at, fmt_mesh_kind_names[kind],
                    distance - (int64_t)count, slot->source->count[kind] + count);
}

/* Makes relative indices of one kind count from the start of the file. */
static int resolve_corners(const struct stream_slot *slot, enum fmt_mesh_kind kind)
{
    uint64_t *corners = slot->arrays.corners[kind];
    const uint64_t before = slot->source->count[kind];
    for (uint64_t i = 0; i < slot->arrays.corner_count; i++) {
        if (corners[i] == FMT_MESH_NONE || corners[i] < OBJ_RELATIVE_LIMIT)
            continue;
        const uint64_t index = corners[i] - OBJ_RELATIVE_ZERO + before;
        if ((int64_t)index < 0 && kind == FMT_MESH_VERTEX)
            return fail_relative(slot, i);
        corners[i] = (int64_t)index < 0 ? FMT_MESH_BEFORE : index;
    }
    return 0;
}

/* Sets *number to the number of the current object with its material. */
static int enter_object(struct stream_source *source, uint64_t *number)
{
    struct obj_file *file = source->data;
    const char *object = file->object ? file->object : "";
    char *text;
    BSQ_PASS(bsq_text_print(source->ctx, &text, "%0*" PRIx32 "%s", OBJ_MATERIAL_DIGITS,
                            file->material, object));
    int status = bsq_texts_add(source->ctx, &source->reader->names, &file->objects, text, number);
    bsq_free(source->ctx, text);
    return status;
}

/* Adds the change that a usemtl, o or g statement makes; takes the object's name over. */
static int add_change(struct stream_slot *slot, const struct stream_statement *statement,
                      char **text)
{
    struct stream_source *source = slot->source;
    struct obj_file *file = source->data;
    struct mesh_arrays *a = &slot->arrays;
    const bool objects = source->reader->objects;
    uint64_t number;
    if (statement->kind == OBJ_OBJECT) {
        bsq_free(source->ctx, file->object);
        file->object = *text;
        *text = NULL;
        fmt_mesh_tidy_name(file->object);
    } else {
        file->material = FMT_MESH_NO_MATERIAL;
        if (**text) {
            BSQ_PASS(bsq_texts_add(source->ctx, &source->reader->names, &file->materials, *text,
                                   &number));
            file->material = (uint32_t)number;
        }
    }
    number = file->material;
    if (objects)
        BSQ_PASS(enter_object(source, &number));
    while (source->number_count < (objects ? file->objects.count : file->materials.count))
        BSQ_PASS(fmt_stream_add_material(source, &file->number));
    file->number = number == FMT_MESH_NO_MATERIAL ? FMT_MESH_NO_MATERIAL : source->numbers[number];
    BSQ_PASS(FMT_RESERVE(source->ctx, a->change_count + 1, a->changes, a->change_capacity));
    a->changes[a->change_count++] =
        (struct fmt_mesh_material_change){.face = statement->face, .material = file->number};
    return 0;
}

static int resolve_statement(struct stream_slot *slot, const struct stream_statement *statement)
{
    struct obj_file *file = slot->source->data;
    const uint64_t line = slot->block.first_line + statement->line;
    char *text = NULL;
    int status;
    BSQ_TRY(bsq_check(slot->ctx));
    BSQ_TRY(fmt_obj_statement_text(slot, statement, &text));
    if (statement->kind == OBJ_MTLLIB) {
        status = fmt_obj_enter_libraries(slot->source, line, text);
    } else if (statement->kind == OBJ_BAD_PAINT) {
        file->bad_paint = true;
    } else if (statement->kind != OBJ_FIRST_UNKNOWN) {
        status = add_change(slot, statement, &text);
    } else if (file->unknown == 0) {
        file->first_unknown = line;
        fmt_mesh_quote(text, text + strlen(text), file->unknown_text, sizeof file->unknown_text);
    }
done:
    bsq_free(slot->ctx, text);
    return status;
}

/* Enters the names in the statements of the block. Counts its faces without a material. */
static int resolve_statements(struct stream_slot *slot)
{
    struct obj_file *file = slot->source->data;
    uint64_t counted = 0;
    int status = 0;
    slot->material_at_start = file->number;
    for (uint64_t i = 0; i < slot->statement_count && !status; i++) {
        const struct stream_statement *statement = &slot->statements[i];
        if (file->material == FMT_MESH_NO_MATERIAL)
            file->plain_faces += statement->face - counted;
        counted = statement->face;
        status = resolve_statement(slot, statement);
    }
    if (file->material == FMT_MESH_NO_MATERIAL)
        file->plain_faces += slot->arrays.face_count - counted;
    return status;
}

/* Refuses a text without any known statement: it is something else, for instance an ASCII STL. */
static int check_is_obj(const struct stream_source *source, uint64_t most_unknown)
{
    const struct obj_file *file = source->data;
    if (file->known > 0 || file->unknown <= most_unknown)
        return 0;
    return bsq_fail(source->ctx, BSQ_EDATA,
                    "%s:%" PRIu64 ": not an OBJ file: \"%s\" is no statement of that format",
                    source->path, file->first_unknown, file->unknown_text);
}

/* Starts a reading of a file. */
static void begin_reading(struct stream_source *source)
{
    struct obj_file *file = source->data;
    bsq_free(source->ctx, file->object);
    file->object = NULL;
    file->material = file->number = FMT_MESH_NO_MATERIAL;
    file->plain_faces = file->known = file->unknown = 0;
    file->bad_paint = false;
}

/* Errors are reported in the order of the file: first the relative indices of the faces that were
 * parsed, then the place where the parser stopped. */
static int pass(struct stream_slot *slot)
{
    struct stream_source *source = slot->source;
    struct obj_file *file = source->data;
    const uint64_t unknown = slot->odd[OBJ_UNKNOWN].count;
    if (slot->block.first_item == 0)
        begin_reading(source);
    slot->block.first_line = source->lines + 1;
    slot->at += source->lines;
    for (int i = 0; i < STREAM_ODDITY_COUNT; i++)
        slot->odd[i].at += source->lines;
    for (int kind = 0; kind < FMT_MESH_KIND_COUNT; kind++)
        if (slot->block.carry_out >> kind & 1)
            BSQ_PASS(resolve_corners(slot, (enum fmt_mesh_kind)kind));
    if (slot->error[0])
        return 0;
    BSQ_PASS(resolve_statements(slot));
    file->known += (uint64_t)slot->balance + slot->short_faces + slot->arrays.face_count;
    for (int kind = 0; kind < FMT_MESH_KIND_COUNT; kind++)
        file->known += slot->arrays.count[kind];
    file->unknown += unknown;
    source->reader->totals->skipped_lines += unknown;
    return check_is_obj(source, PATIENCE_LINES - 1);
}

/* Checks that ZBrush's comments have a colour for each vertex of each file, or none at all. */
static int finish(struct stream_source *source)
{
    struct fmt_mesh_reader *reader = source->reader;
    const struct obj_file *file = source->data;
    reader->painted |= source->late_color_count > 0 || file->bad_paint;
    reader->unpainted |=
        file->bad_paint || source->late_color_count != source->count[FMT_MESH_VERTEX];
    if (reader->painted && reader->unpainted)
        reader->totals->unread_colors =
            "ZBrush's polypaint is not used, as it is not one colour for each "
            "vertex: export a texture of it for --texture";
    return check_is_obj(source, 0);
}

/* ---- samples ---- */

/* Samples of a plain file. Of others, the start is sampled. */
enum { SAMPLES = 32, SAMPLE_BYTES = 8192 };

/* Parses the whole lines of a sample, from block.offset of the file. Clears faces_come_last if
 * elements follow faces of earlier samples. */
static int parse_sample(struct stream_slot *slot, uint64_t size, struct fmt_mesh_hints *out)
{
    const struct mesh_arrays *a = &slot->arrays;
    const uint64_t faces = a->face_count, elements = a->count[0] + a->count[1] + a->count[2];
    const uint8_t *end = memrchr(slot->bytes, '\n', size), *begin = slot->bytes;
    if (slot->block.offset > 0)
        begin = memchr(slot->bytes, '\n', size);
    if (!begin)
        return 0;
    begin += slot->block.offset > 0;
    if (!end || end < begin)
        return 0;
    BSQ_PASS(fmt_obj_parse_text(slot, (uint64_t)(begin - slot->bytes), (uint64_t)(end - begin) + 1,
                                false));
    out->faces_come_last &= faces == 0 || a->count[0] + a->count[1] + a->count[2] == elements;
    return 0;
}

static int look(struct stream_source *source, struct fmt_mesh_hints *out)
{
    struct stream_slot slot = {.ctx = source->ctx, .source = source, .last_face = UINT64_MAX};
    const bool plain = fmt_input_is_plain(source->input);
    const uint64_t bytes = plain ? fmt_input_size(source->input) : 0;
    const uint64_t size = plain ? SAMPLE_BYTES : FMT_INPUT_SAMPLE_BYTES;
    const uint64_t step = bytes / SAMPLES > size ? bytes / SAMPLES : size;
    uint64_t got;
    int status;
    BSQ_PASS(fmt_input_open(source->input));
    do {
        BSQ_TRY(fmt_stream_reserve(&slot, size));
        BSQ_TRY(fmt_input_read_some(source->input, slot.bytes, size, slot.block.offset, &got));
        BSQ_TRY(parse_sample(&slot, got, out));
        slot.block.offset += step;
    } while (slot.block.offset < bytes);
    out->has_texcoords |= slot.arrays.count[FMT_MESH_TEXCOORD] > 0;
done:
    fmt_stream_free_slot(&slot);
    const int closed = fmt_input_close(source->input);
    return status ? status : closed;
}

const struct fmt_mesh_format fmt_obj_format = {
    .name = "OBJ",
    .suffix = ".obj",
    .from_one = true,
    .data_bytes = sizeof(struct obj_file),
    .oddities = {[STREAM_NO_POSITION] = "vertices without a finite position",
                 [STREAM_NO_TEXCOORD] = "texture coordinates without finite numbers",
                 [STREAM_NO_NORMAL] = "normals without three finite numbers",
                 [STREAM_NO_COLOR] = "vertices with a colour that is not finite",
                 [OBJ_VERTEX_SIZE] = "vertices of 2 or 5 numbers, read as x y 0 or x y z",
                 [OBJ_SURFACE] = "free-form surfaces, which are not read",
                 [OBJ_USEMAP] = "usemap statements, whose textures are not read (see --texture)",
                 [OBJ_UNKNOWN] = "lines with statements that are not of the format"},
    .end = end,
    .cut = cut,
    .parse = parse,
    .pass = pass,
    .finish = finish,
    .look = look,
    .read_materials = fmt_obj_read_materials,
    .preview_materials = fmt_obj_preview_materials,
    .find_object = fmt_obj_find_object,
};
