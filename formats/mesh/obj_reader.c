/* obj_reader.c - reads Wavefront OBJ files as an ordered stream of parsed blocks.
 *
 * Understood: v with 2 to 7 numbers, vt, vn, f with all four forms of indices and any number
 * of corners, negative indices, usemtl, mtllib; CRLF, tabs, line continuation, comments, exponents.
 * If the caller wants objects, also o and g. Other statements (s, l, p, ...) are skipped.
 *
 * Producing a block costs nothing, since a worker needs only its number (obj_text.c). Workers load
 * and parse blocks in any order. What depends on earlier blocks (bases, relative indices, material
 * names, line numbers, the first error of the file) is resolved as blocks come out in order.
 * Buffers belong to pipeline slots and are reused, so memory depends on the number of slots alone.
 */
#include <inttypes.h>
#include <string.h>

#include "base/loss.h"
#include "base/parallel.h"
#include "formats/mesh/mesh_text.h"
#include "formats/mesh/obj_internal.h"

/* After this many unknown lines, and no known statement, a file is not taken for OBJ. */
enum { patience_lines = 1000 };

struct slot {
    uint32_t source;
    uint64_t index, offset;
    bool last; /* block of the file */
    struct obj_block block;
    struct fmt_mesh_material_change *changes;
    uint64_t change_count, change_capacity;
    struct fmt_mesh_block view; /* the block as callers see it, if it has text */
};

/* One call of read_all(). */
struct job {
    struct obj_reader *reader;
    const struct fmt_mesh_steps *steps;
    void *arg;
    struct fmt_mesh_totals *totals;
    struct slot *slots;
    /* state of produce */
    uint32_t next_source;
    uint64_t next_index;
    /* state of emit */
    uint32_t source;   /* file of the last block */
    uint32_t material; /* as blocks number it, of the last face */
    uint32_t named;    /* the last material that a statement named */
    char *object;      /* the last object that a statement named; NULL: none */
    uint64_t sequence, known_statements, skipped_in_file;
    uint64_t totals_by_kind[FMT_MESH_KIND_COUNT];
};

/* ---- opening ---- */

static void close_reader(struct fmt_mesh_reader *base)
{
    struct obj_reader *reader = (struct obj_reader *)base;
    struct bsq_ctx *ctx = base->ctx;
    bsq_free(ctx, reader->sources);
    bsq_free(ctx, reader->places);
    fmt_obj_names_free(ctx, &reader->materials);
    fmt_obj_names_free(ctx, &reader->libraries);
    fmt_obj_names_free(ctx, &reader->parts);
    bsq_free(ctx, reader);
}

static int open_reader(struct bsq_ctx *ctx, struct fmt_input *const *inputs, uint32_t input_count,
                       struct fmt_mesh_reader **out)
{
    struct obj_reader *reader;
    int status = bsq_calloc(ctx, "OBJ reader", 1, sizeof *reader, &reader);
    if (status)
        return status;
    reader->base.ctx = ctx;
    status = bsq_calloc(ctx, "OBJ files", input_count, sizeof *reader->sources, &reader->sources);
    for (uint32_t i = 0; i < input_count && !status; i++) {
        reader->sources[i].input = inputs[i];
        reader->sources[i].path = fmt_input_path(inputs[i]);
    }
    reader->source_count = status ? 0 : input_count;
    if (status)
        close_reader(&reader->base);
    else
        *out = &reader->base;
    return status;
}

/* ---- produce, work ---- */

static int open_source(struct obj_source *source)
{
    int status = fmt_input_open(source->input);
    source->open = !status;
    return status;
}

/* Closes a file after its last block. Errors: BSQ_EIO if it was changed meanwhile. */
static int close_source(struct obj_source *source)
{
    const bool was_open = source->open;
    source->open = false;
    return was_open ? fmt_input_close(source->input) : 0;
}

static int produce(void *arg, void *slot_memory, uint64_t sequence)
{
    struct job *job = arg;
    struct slot *slot = slot_memory;
    struct obj_reader *reader = job->reader;
    (void)sequence;
    for (; job->next_source < reader->source_count; job->next_source++, job->next_index = 0) {
        struct obj_source *source = &reader->sources[job->next_source];
        const uint64_t begin = job->next_index * OBJ_BLOCK_BYTES;
        uint64_t size = 0;
        int status = job->next_index == 0 ? open_source(source) : 0;
        if (!status)
            status = fmt_input_reach(source->input, begin + OBJ_BLOCK_BYTES + 1, &size);
        if (!status && size == 0) /* no block of an empty file passes, so nothing else closes it */
            status = close_source(source);
        if (status)
            return status;
        if (size == 0)
            continue;
        slot->source = job->next_source;
        slot->index = job->next_index++;
        slot->last = size - begin <= OBJ_BLOCK_BYTES;
        /* The file may be closed when this block has passed. */
        job->next_source += slot->last;
        job->next_index = slot->last ? 0 : job->next_index;
        return 1;
    }
    return 0;
}

static int work(void *arg, void *slot_memory, uint64_t sequence, unsigned worker)
{
    struct job *job = arg;
    struct slot *slot = slot_memory;
    struct bsq_ctx *ctx = job->reader->base.ctx;
    const struct obj_source *source = &job->reader->sources[slot->source];
    (void)sequence, (void)worker;
    int status = fmt_obj_text_load(ctx, source->input, slot->index, &slot->block, &slot->offset);
    slot->block.objects = job->reader->base.objects;
    if (!status)
        status = fmt_obj_block_parse(ctx, &slot->block, slot->offset == 0, UINT64_MAX);
    return status;
}

/* ---- emit ---- */

/* Turns parsed corners of one kind into numbers over the whole scan. Does nothing in a first file
 * without relative indices, where they are that already. */
static int resolve_corners(struct job *job, struct slot *slot, enum fmt_mesh_kind kind)
{
    const struct obj_source *source = &job->reader->sources[slot->source];
    struct obj_block *block = &slot->block;
    uint64_t *corners = block->corners[kind], count = block->corner_count;
    uint64_t base = source->base[kind], local_base = source->count[kind];
    bool always = kind == FMT_MESH_VERTEX;
    if (!always && !block->has_corners[kind])
        return 0;
    if (!block->relative[kind]) {
        if (base)
            for (uint64_t i = 0; i < count; i++)
                corners[i] = corners[i] == FMT_MESH_NONE ? FMT_MESH_NONE : corners[i] + base;
        return 0;
    }
    for (uint64_t i = 0; i < count; i++) {
        if (corners[i] == FMT_MESH_NONE)
            continue;
        if (corners[i] >= OBJ_RELATIVE_LIMIT) {
            uint64_t index = corners[i] - OBJ_RELATIVE_ZERO + local_base;
            if ((int64_t)index < 0 && always)
                return fmt_obj_fail_relative(job->reader, source, block, slot->index, i);
            corners[i] = (int64_t)index < 0 ? FMT_MESH_BEFORE : index;
        }
        corners[i] += base;
    }
    return 0;
}

static int add_change(struct job *job, struct slot *slot, uint64_t face, uint32_t material)
{
    int status = 0;
    if (slot->change_count == slot->change_capacity)
        status = bsq_grow(job->reader->base.ctx, "OBJ statements", slot->change_count + 16,
                          sizeof *slot->changes, &slot->changes, &slot->change_capacity);
    if (!status)
        slot->changes[slot->change_count++] =
            (struct fmt_mesh_material_change){.face = face, .material = material};
    return status;
}

/* Adds the change that a usemtl, o or g statement makes; takes the object's name over. */
static int resolve_change(struct job *job, struct slot *slot, const struct obj_statement *statement,
                          char **text)
{
    struct obj_reader *reader = job->reader;
    struct bsq_ctx *ctx = reader->base.ctx;
    uint32_t material = FMT_MESH_NO_MATERIAL;
    int status = 0;
    if (statement->kind == OBJ_OBJECT) {
        bsq_free(ctx, job->object);
        job->object = *text;
        *text = NULL;
        fmt_mesh_tidy_name(job->object);
    } else {
        if (**text)
            status = fmt_obj_names_enter(ctx, &reader->materials, slot->source, *text, &material);
        job->named = material;
    }
    material = job->named;
    if (!status && reader->base.objects)
        status = fmt_obj_names_enter(ctx, &reader->parts, job->named,
                                     job->object ? job->object : "", &material);
    return status ? status : add_change(job, slot, statement->face, material);
}

/* Counts the faces of a block from *begin to `end`, if they have no material, and moves *begin. */
static void count_plain_faces(struct job *job, const struct slot *slot, uint64_t end,
                              uint64_t *begin)
{
    if (job->named == FMT_MESH_NO_MATERIAL)
        job->reader->sources[slot->source].plain_faces += end - *begin;
    *begin = end;
}

/* Enters the names in the statements of the block. */
static int resolve_statements(struct job *job, struct slot *slot)
{
    struct obj_reader *reader = job->reader;
    const struct obj_block *block = &slot->block;
    const uint64_t lines = reader->sources[slot->source].lines;
    uint64_t counted = 0; /* faces */
    int status = 0;
    slot->change_count = 0;
    for (uint64_t i = 0; i < block->statement_count && !status; i++) {
        const struct obj_statement *statement = &block->statements[i];
        char *text;
        if ((status = bsq_check(reader->base.ctx)) ||
            (status = fmt_obj_statement_text(reader->base.ctx, block, statement, &text)))
            break;
        count_plain_faces(job, slot, statement->face, &counted);
        if (statement->kind == OBJ_MTLLIB)
            status =
                fmt_obj_enter_libraries(reader, slot->source, lines + statement->line + 1, text);
        else
            status = resolve_change(job, slot, statement, &text);
        bsq_free(reader->base.ctx, text);
    }
    count_plain_faces(job, slot, block->face_count, &counted);
    return status;
}

/* Records where the block's faces are, for fmt_obj_locate_face(). */
static int add_place(struct job *job, const struct slot *slot)
{
    struct obj_reader *reader = job->reader;
    int status = 0;
    if (slot->block.face_count == 0)
        return 0;
    if (reader->place_count == reader->place_capacity)
        status = bsq_grow(reader->base.ctx, "OBJ block table", reader->place_count + 16,
                          sizeof *reader->places, &reader->places, &reader->place_capacity);
    if (!status)
        reader->places[reader->place_count++] = (struct obj_place){
            .source = slot->source,
            .block = slot->index,
            .face_base = job->totals->faces,
            .first_line = reader->sources[slot->source].lines + 1,
        };
    return status;
}

/* Moves on to the file of the next block. */
static void enter_source(struct job *job, uint32_t number)
{
    struct obj_source *source = &job->reader->sources[number];
    job->source = number;
    job->material = job->named = FMT_MESH_NO_MATERIAL;
    bsq_free(job->reader->base.ctx, job->object);
    job->object = NULL;
    job->known_statements = job->skipped_in_file = 0;
    memcpy(source->base, job->totals_by_kind, sizeof source->base);
    memset(source->count, 0, sizeof source->count);
    source->lines = source->paint = source->plain_faces = 0;
    source->bad_paint = false;
}

/* Refuses a text without any known statement: it is something else, for instance an ASCII STL. */
static int check_is_obj(struct job *job, const struct slot *slot)
{
    const struct obj_block *block = &slot->block;
    const struct obj_odd_lines *unknown = &block->odd[OBJ_UNKNOWN];
    const struct obj_source *source = &job->reader->sources[slot->source];
    job->known_statements += block->known_lines + block->short_faces + block->face_count;
    for (int kind = 0; kind < FMT_MESH_KIND_COUNT; kind++)
        job->known_statements += block->count[kind];
    job->skipped_in_file += unknown->count;
    if (job->known_statements == 0 && unknown->count > 0 &&
        (slot->last || job->skipped_in_file >= patience_lines))
        return bsq_fail(job->reader->base.ctx, BSQ_EDATA,
                        "%s:%" PRIu64 ": not an OBJ file: \"%s\" is no statement of that format",
                        source->path, source->lines + unknown->first + 1, block->first_unknown);
    return 0;
}

static int call_on_block(struct job *job, struct slot *slot)
{
    const struct obj_block *block = &slot->block;
    slot->view = (struct fmt_mesh_block){
        .sequence = job->sequence,
        .file = slot->source,
        .byte_offset = slot->offset,
        .byte_size = block->size,
        .vertex_count = block->count[FMT_MESH_VERTEX],
        .vertex_base = job->totals->vertices,
        .positions = (const double(*)[3])block->positions,
        .missing_positions = block->odd[OBJ_NO_POSITION].count,
        .missing_texcoords = block->odd[OBJ_NO_TEXCOORD].count,
        .colors = block->has_colors ? (const float(*)[3])block->colors : NULL,
        .late_colors = block->paint,
        .late_color_count = block->paint_count,
        .late_color_base = job->reader->sources[slot->source].base[FMT_MESH_VERTEX] +
                           job->reader->sources[slot->source].paint,
        .texcoord_count = block->count[FMT_MESH_TEXCOORD],
        .texcoord_base = job->totals->texcoords,
        .texcoords = (const double(*)[2])block->texcoords,
        .normal_count = block->count[FMT_MESH_NORMAL],
        .normal_base = job->totals->normals,
        .normals = (const float(*)[3])block->normals,
        .face_count = block->face_count,
        .face_base = job->totals->faces,
        .face_sizes = block->face_sizes,
        .corner_count = block->corner_count,
        .corner_vertices = block->corners[FMT_MESH_VERTEX],
        .corner_texcoords =
            block->has_corners[FMT_MESH_TEXCOORD] ? block->corners[FMT_MESH_TEXCOORD] : NULL,
        .corner_normals =
            block->has_corners[FMT_MESH_NORMAL] ? block->corners[FMT_MESH_NORMAL] : NULL,
        .material_change_count = slot->change_count,
        .material_changes = slot->changes,
        .material_at_start = job->material,
    };
    job->reader->has_colors |= block->has_colors || block->paint_count > 0;
    if (slot->change_count)
        job->material = slot->changes[slot->change_count - 1].material;
    return job->steps->on_block ? job->steps->on_block(job->arg, &slot->view) : 0;
}

/* Adds the odd lines of the block, of which the first in the order of the file is kept. */
static void count_odd_lines(struct obj_reader *reader, const struct slot *slot)
{
    for (int i = 0; i < OBJ_ODDITY_COUNT; i++) {
        const struct obj_odd_lines *from = &slot->block.odd[i];
        struct obj_odd_place *to = &reader->odd[i];
        if (from->count > 0 && to->count == 0) {
            to->source = slot->source;
            to->line = reader->sources[slot->source].lines + from->first + 1;
        }
        to->count += from->count;
    }
}

/* Adds the block to all counts. */
static void pass_block(struct job *job, const struct slot *slot)
{
    const struct obj_block *block = &slot->block;
    struct obj_source *source = &job->reader->sources[slot->source];
    struct fmt_mesh_totals *totals = job->totals;
    count_odd_lines(job->reader, slot);
    for (int kind = 0; kind < FMT_MESH_KIND_COUNT; kind++) {
        source->count[kind] += block->count[kind];
        job->totals_by_kind[kind] += block->count[kind];
    }
    source->lines += block->lines;
    source->paint += block->paint_count;
    source->bad_paint |= block->bad_paint;
    totals->bytes += block->size;
    totals->vertices = job->totals_by_kind[FMT_MESH_VERTEX];
    totals->texcoords = job->totals_by_kind[FMT_MESH_TEXCOORD];
    totals->normals = job->totals_by_kind[FMT_MESH_NORMAL];
    totals->faces += block->face_count;
    totals->corners += block->corner_count;
    totals->skipped_lines += block->odd[OBJ_UNKNOWN].count;
    totals->short_faces += block->short_faces;
    totals->materials = (uint32_t)fmt_obj_numbers(job->reader)->count;
    job->sequence += block->size > 0;
}

/* Passes on one block. Errors are reported in the order of the file: first the relative indices of
 * the faces that were parsed, then the place where the parser stopped. */
static int emit_text(struct job *job, struct slot *slot)
{
    const struct obj_source *source = &job->reader->sources[slot->source];
    const struct obj_block *block = &slot->block;
    int status = 0;
    for (enum fmt_mesh_kind kind = FMT_MESH_VERTEX; kind < FMT_MESH_KIND_COUNT && !status; kind++)
        status = resolve_corners(job, slot, kind);
    if (!status && block->failed)
        status = bsq_fail(job->reader->base.ctx, BSQ_EDATA, "%s:%" PRIu64 ": %s", source->path,
                          source->lines + block->lines + 1, block->error);
    if (!status)
        status = check_is_obj(job, slot);
    if (!status)
        status = resolve_statements(job, slot);
    if (!status)
        status = add_place(job, slot);
    if (!status && block->size > 0)
        status = call_on_block(job, slot);
    return status;
}

static int emit(void *arg, void *slot_memory, uint64_t sequence)
{
    struct job *job = arg;
    struct slot *slot = slot_memory;
    struct obj_source *source = &job->reader->sources[slot->source];
    if (sequence == 0 || slot->source != job->source)
        enter_source(job, slot->source);
    int status = emit_text(job, slot);
    if (!status)
        pass_block(job, slot);
    if (slot->last) {
        int closed = close_source(source);
        status = status ? status : closed;
    }
    return status;
}

/* ---- follow, finish ---- */

static int follow(void *arg, void *slot_memory, uint64_t sequence, unsigned worker)
{
    const struct job *job = arg;
    const struct slot *slot = slot_memory;
    (void)sequence, (void)worker;
    if (slot->block.size == 0)
        return 0;
    return job->steps->follow(job->arg, &slot->view, (unsigned)(slot - job->slots));
}

static int finish(void *arg, void *slot_memory, uint64_t sequence)
{
    const struct job *job = arg;
    const struct slot *slot = slot_memory;
    (void)sequence;
    if (slot->block.size == 0)
        return 0;
    return job->steps->finish(job->arg, &slot->view, (unsigned)(slot - job->slots));
}

/* ---- reading ---- */

static unsigned count_slots(const struct obj_reader *reader)
{
    uint64_t blocks = 0;
    const unsigned most = fmt_mesh_max_slots(&reader->base);
    for (uint32_t i = 0; i < reader->source_count && blocks < most; i++)
        blocks += fmt_input_size(reader->sources[i].input) / OBJ_BLOCK_BYTES + 1;
    return blocks < most ? (unsigned)blocks : most;
}

static int run_job(struct job *job)
{
    struct bsq_ctx *ctx = job->reader->base.ctx;
    const unsigned slot_count = count_slots(job->reader);
    struct slot *slots;
    int status = bsq_calloc(ctx, "OBJ blocks", slot_count, sizeof *slots, &slots);
    if (status)
        return status;
    struct bsq_pipeline pipeline = {
        .produce = produce,
        .work = work,
        .emit = emit,
        .follow = job->steps->follow ? follow : NULL,
        .finish = job->steps->follow ? finish : NULL,
        .arg = job,
        .slots = slots,
        .slot_size = sizeof *slots,
        .slot_count = slot_count,
    };
    job->slots = slots;
    status = bsq_pipeline_run(ctx, &pipeline);
    for (unsigned i = 0; i < slot_count; i++) {
        fmt_obj_block_free(ctx, &slots[i].block);
        bsq_free(ctx, slots[i].changes);
    }
    bsq_free(ctx, slots);
    return status;
}

/* Checks that ZBrush's comments have a colour for each vertex of each file, or none at all. */
static void check_paint(const struct obj_reader *reader, struct fmt_mesh_totals *totals)
{
    bool painted = false, fits = true;
    for (uint32_t i = 0; i < reader->source_count; i++) {
        const struct obj_source *source = &reader->sources[i];
        painted |= source->paint > 0 || source->bad_paint;
        fits &= !source->bad_paint && source->paint == source->count[FMT_MESH_VERTEX];
    }
    if (painted && !fits)
        totals->unread_colors = "ZBrush's polypaint is not used, as it is not one colour for each "
                                "vertex: export a texture of it for --texture";
}

/* Warns once of each kind of odd lines, with the first line. */
static int warn_odd_lines(const struct obj_reader *reader)
{
    static const char *const texts[OBJ_ODDITY_COUNT] = {
        [OBJ_NO_POSITION] = "vertices without a finite position",
        [OBJ_NO_TEXCOORD] = "texture coordinates without finite numbers",
        [OBJ_NO_NORMAL] = "normals without three finite numbers",
        [OBJ_NO_COLOR] = "vertices with a colour that is not finite",
        [OBJ_VERTEX_SIZE] = "vertices of 2 or 5 numbers, read as x y 0 or x y z",
        [OBJ_SURFACE] = "free-form surfaces, which are not read",
        [OBJ_USEMAP] = "usemap statements, whose textures are not read (see --texture)",
        [OBJ_UNKNOWN] = "lines with statements that are not of the format",
    };
    int status = 0;
    for (int i = 0; i < OBJ_ODDITY_COUNT && !status; i++) {
        const struct obj_odd_place *odd = &reader->odd[i];
        if (odd->count > 0)
            status = bsq_warn_loss(
                reader->base.ctx, "%s:%" PRIu64 ": %s: %" PRIu64 "; this is the first",
                reader->sources[odd->source].path, odd->line, texts[i], odd->count);
    }
    return status;
}

static int read_all(struct fmt_mesh_reader *base, const struct fmt_mesh_steps *steps, void *arg,
                    struct fmt_mesh_totals *totals)
{
    struct obj_reader *reader = (struct obj_reader *)base;
    struct job job = {
        .reader = reader,
        .steps = steps,
        .arg = arg,
        .totals = totals,
        .material = FMT_MESH_NO_MATERIAL,
        .named = FMT_MESH_NO_MATERIAL,
    };
    reader->place_count = 0;
    memset(reader->odd, 0, sizeof reader->odd);
    int status = run_job(&job);
    bsq_free(base->ctx, job.object);
    for (uint32_t i = 0; i < reader->source_count; i++) {
        int closed = close_source(&reader->sources[i]);
        status = status ? status : closed;
    }
    check_paint(reader, totals);
    if (!status && !reader->read_before)
        status = warn_odd_lines(reader);
    reader->read_before |= status == 0;
    return status;
}

const struct fmt_mesh_format fmt_obj_format = {
    .name = "OBJ",
    .suffix = ".obj",
    .open = open_reader,
    .close = close_reader,
    .read = read_all,
    .estimate = fmt_obj_estimate,
    .locate_face = fmt_obj_locate_face,
    .read_materials = fmt_obj_read_materials,
    .preview_materials = fmt_obj_preview_materials,
    .dependency = fmt_obj_dependency,
};
