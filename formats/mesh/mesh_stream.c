/* mesh_stream.c - reads the files of a scan block by block, on all threads; see mesh_format.h. */
#include <inttypes.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "base/context.h"
#include "base/parallel.h"
#include "formats/mesh/mesh_format.h"
#include "formats/mesh/mesh_text.h"

/* One call of fmt_mesh_read_steps(). */
struct reading {
    struct fmt_mesh_reader *reader;
    const struct fmt_mesh_steps *steps;
    void *arg;
    struct stream_slot *slots;
    struct stream_block cut; /* the last block that was cut */
    uint32_t source;         /* file of the last block that passed */
    uint64_t passed;         /* bytes of this file that earlier batches have */
};

/* ---- files ---- */

/* Opens a file before its first block. */
static int enter_file(struct stream_source *source)
{
    int status = fmt_input_open(source->input);
    source->open = status == 0;
    if (!status && source->held)
        fmt_input_close(source->input);
    source->held &= status != 0;
    return !status && source->format->enter ? source->format->enter(source) : status;
}

/* Closes a file after its last block. Errors: BSQ_EIO if it was changed meanwhile. */
static int leave_file(struct stream_source *source)
{
    const bool was_open = source->open;
    source->open = false;
    const int status = was_open ? fmt_input_close(source->input) : 0;
    const int left = source->format->leave ? source->format->leave(source) : 0;
    return status ? status : left;
}

int fmt_stream_reserve(struct stream_slot *slot, uint64_t size)
{
    if (size > UINT64_MAX - STREAM_PADDING)
        return bsq_fail(slot->ctx, BSQ_ENOMEM, "a part of a mesh file is too long");
    return FMT_RESERVE(slot->ctx, size + STREAM_PADDING, slot->bytes, slot->capacity);
}

int fmt_stream_extend(struct stream_slot *slot, uint64_t have, uint64_t size, uint64_t *loaded,
                      bool *at_end)
{
    struct fmt_input *input = slot->source->input;
    const uint64_t offset = slot->block.offset;
    uint64_t file_size, end;
    *loaded = have;
    *at_end = false;
    if (__builtin_add_overflow(offset, size, &end) || end > fmt_input_size(input))
        end = fmt_input_size(input);
    end = end > offset ? end : offset;
    /* Memory first: bytes that do not fit need not be unpacked. */
    BSQ_PASS(fmt_stream_reserve(slot, end - offset));
    BSQ_PASS(fmt_input_reach(input, end, &file_size));
    end = end < file_size ? end : file_size;
    size = end > offset ? end - offset : 0;
    if (size > have)
        BSQ_PASS(fmt_input_read(input, slot->bytes + have, size - have, offset + have));
    *loaded = size > have ? size : have;
    *at_end = offset + *loaded >= file_size;
    return 0;
}

int fmt_stream_load(struct stream_slot *slot)
{
    const struct stream_block *block = &slot->block;
    if (slot->loaded)
        return 0;
    BSQ_PASS(fmt_stream_reserve(slot, block->size));
    BSQ_PASS(fmt_input_read(slot->source->input, slot->bytes, block->size, block->offset));
    slot->loaded = true;
    return 0;
}

int fmt_stream_cut_text(struct stream_slot *slot, uint64_t usual,
                        uint64_t (*find)(struct stream_slot *, uint64_t, bool))
{
    struct stream_block *block = &slot->block;
    uint64_t have = 0, wanted = usual;
    bool at_end = false;
    for (;;) {
        BSQ_PASS(fmt_stream_extend(slot, have, wanted, &have, &at_end));
        block->size = have > 0 ? find(slot, have, at_end) : 0;
        if (block->size > 0 || at_end)
            break;
        BSQ_PASS(bsq_check(slot->ctx));
        if (fmt_mesh_count_space(slot->bytes, have) < have) {
            wanted *= 2;
        } else { /* any number of blanks needs no memory */
            block->offset += have;
            block->first_line += block->lines;
            have = block->lines = 0;
        }
    }
    block->end = block->offset + block->size;
    slot->loaded = true;
    return block->size > 0;
}

int fmt_stream_fail(struct stream_slot *slot, uint64_t at, const char *format, ...)
{
    va_list arguments;
    if (slot->error[0])
        return 0;
    slot->at = at;
    va_start(arguments, format);
    vsnprintf(slot->error, sizeof slot->error, format, arguments);
    va_end(arguments);
    return 0;
}

/* Returns whether all numbers are finite. */
static bool all_finite(const double *numbers, uint64_t count)
{
    const uint64_t exponent = 0x7ff0000000000000, one = 0x0010000000000000;
    uint64_t carries = 0, bits;
    for (uint64_t i = 0; i < count; i++) {
        memcpy(&bits, &numbers[i], sizeof bits);
        carries |= (bits & exponent) + one; /* the largest exponent carries into the sign */
    }
    return carries >> 63 == 0;
}

/* Makes all numbers of a vector NaN if one is not finite, for `count` vectors of `size` numbers.
 * Returns how many there are. */
static uint64_t clear_bad(void *vectors, uint64_t count, unsigned size)
{
    uint64_t bad = 0;
    double *v = vectors;
    if (all_finite(v, count * size))
        return 0;
    for (uint64_t i = 0; i < count; i++, v += size) {
        if (all_finite(v, size))
            continue;
        for (unsigned k = 0; k < size; k++)
            v[k] = NAN;
        bad++;
    }
    return bad;
}

/* Sets vectors that are not finite to `missing`. Returns how many there are. */
static uint64_t replace_bad(float (*vectors)[3], uint64_t count, float missing)
{
    uint64_t bad = 0;
    for (uint64_t i = 0; i < count; i++) {
        float *v = vectors[i];
        if (v[0] * 0.0f + v[1] * 0.0f + v[2] * 0.0f == 0.0f)
            continue;
        v[0] = v[1] = v[2] = missing;
        bad++;
    }
    return bad;
}

/* Finds out whether colours of a block that may need more than 8 bits do: from half of a step that
 * chunk files keep on. Numbers round to whole steps in the sums, in a loop without branches. */
static void look_for_fine_colors(struct stream_slot *slot)
{
    const struct mesh_arrays *a = &slot->arrays;
    const float *numbers = a->has_colors && slot->fine_colors ? a->colors[0] : NULL;
    const uint64_t count = numbers ? 3 * a->count[FMT_MESH_VERTEX] : 0;
    const float white = slot->color_white, round = 3 << 22;
    const float factor = 255.0f / (white > 0.0f ? white : 1.0f),
                bright = white > 0.0f ? factor : 1.0f;
    int fine = 0;
    for (uint64_t i = 0; i < count; i++) {
        const float value = numbers[i] * (numbers[i] > 1.0f ? bright : factor);
        fine |= fabsf(value - ((value + round) - round)) > 1.0f / 2048.0f;
    }
    slot->fine_colors = fine;
}

/* Marks elements of a block that are not finite, and counts them. */
static void mark_bad(struct stream_slot *slot)
{
    struct mesh_arrays *a = &slot->arrays;
    struct stream_oddity *odd = slot->odd;
    odd[STREAM_NO_POSITION].count = clear_bad(a->positions, a->count[FMT_MESH_VERTEX], 3);
    odd[STREAM_NO_TEXCOORD].count = clear_bad(a->texcoords, a->count[FMT_MESH_TEXCOORD], 2);
    odd[STREAM_NO_NORMAL].count = replace_bad(a->normals, a->count[FMT_MESH_NORMAL], 0.0f);
    if (a->has_colors && slot->color_white != 255.0f) /* the files' integers are finite */
        odd[STREAM_NO_COLOR].count += replace_bad(a->colors, a->count[FMT_MESH_VERTEX], -1.0f);
}

/* ---- cutting and parsing ---- */

static int produce(void *arg, void *slot_memory, uint64_t sequence)
{
    struct reading *reading = arg;
    struct stream_slot *slot = slot_memory;
    (void)sequence;
    while (reading->cut.source < reading->reader->source_count) {
        struct stream_source *source = &reading->reader->sources[reading->cut.source];
        int status = !source->open && reading->cut.end == 0 ? enter_file(source) : 0;
        slot->source = source;
        slot->loaded = false;
        slot->error[0] = '\0';
        slot->block = (struct stream_block){.source = reading->cut.source};
        if (status == 0 && !reading->cut.failed)
            status = source->format->cut(&reading->cut, slot);
        slot->block.failed = slot->error[0] != '\0';
        if (status != 0) {
            reading->cut = slot->block;
            return status;
        }
        /* No block of an empty file passes, so nothing else closes it. */
        BSQ_PASS(reading->cut.end == 0 ? leave_file(source) : 0);
        reading->cut = (struct stream_block){.source = reading->cut.source + 1};
    }
    return 0;
}

/* Forgets what an earlier block had, and keeps the memory. */
static void clear_slot(struct stream_slot *slot)
{
    struct mesh_arrays *a = &slot->arrays;
    memset(a->count, 0, sizeof a->count);
    memset(a->has_corners, 0, sizeof a->has_corners);
    memset(slot->odd, 0, sizeof slot->odd);
    a->late_color_count = a->face_count = a->corner_count = a->change_count = 0;
    a->has_colors = false;
    a->vertex_bound = UINT64_MAX;
    slot->statement_count = slot->short_faces = 0;
    slot->finite = false;
    slot->local = 0;
    slot->balance = 0;
    slot->color_white = 0;
    slot->fine_colors = false;
    slot->material_at_start = FMT_MESH_NO_MATERIAL;
}

static int work(void *arg, void *slot_memory, uint64_t sequence, unsigned worker)
{
    struct stream_slot *slot = slot_memory;
    (void)arg, (void)sequence, (void)worker;
    clear_slot(slot);
    slot->last_face = UINT64_MAX;
    BSQ_PASS(slot->block.failed ? 0 : slot->source->format->parse(slot));
    if (!slot->finite)
        mark_bad(slot);
    look_for_fine_colors(slot);
    return 0;
}

/* ---- materials ---- */

int fmt_stream_add_material(struct stream_source *source, uint32_t *number)
{
    if (source->reader->material_count >= FMT_MESH_NO_MATERIAL - 1)
        return bsq_fail(source->ctx, BSQ_EDATA, "%s: too many materials", source->path);
    BSQ_PASS(FMT_RESERVE(source->ctx, source->number_count + 1, source->numbers,
                         source->number_capacity));
    *number = (uint32_t)source->reader->material_count++;
    source->numbers[source->number_count++] = *number;
    return 0;
}

void fmt_stream_number_materials(struct stream_slot *slot)
{
    for (uint64_t i = 0; i < slot->arrays.change_count; i++) {
        uint32_t *material = &slot->arrays.changes[i].material;
        if (*material != FMT_MESH_NO_MATERIAL)
            *material = slot->source->numbers[*material];
    }
}

/* Numbers the materials or objects that are known of a file from its start. */
static int number_first_materials(struct stream_source *source)
{
    const bool objects = source->reader->objects;
    const uint64_t count = objects ? source->object_count : source->material_count;
    uint32_t number;
    if (count >= FMT_MESH_NO_MATERIAL - source->reader->material_count)
        return bsq_fail(source->ctx, BSQ_EDATA, "%s: too many %s", source->path,
                        objects ? "objects" : "materials");
    while (source->number_count < count)
        BSQ_PASS(fmt_stream_add_material(source, &number));
    return 0;
}

/* ---- passing in order ---- */

/* Moves on to the file of the next block. The blocks of earlier files have all been parsed. */
static int enter_source(struct reading *reading, struct stream_source *source)
{
    const struct fmt_mesh_totals *totals = reading->reader->totals;
    for (uint32_t i = reading->source; i < source->number; i++)
        BSQ_PASS(leave_file(&reading->reader->sources[i]));
    reading->source = source->number;
    reading->passed = 0;
    source->base[FMT_MESH_VERTEX] = totals->vertices;
    source->base[FMT_MESH_TEXCOORD] = totals->texcoords;
    source->base[FMT_MESH_NORMAL] = totals->normals;
    source->face_base = totals->faces;
    memset(source->count, 0, sizeof source->count);
    source->late_color_count = source->lines = 0;
    return number_first_materials(source);
}

static int fail_block(const struct stream_slot *slot)
{
    const char *path = slot->source->path;
    if (slot->at == 0)
        return bsq_fail(slot->ctx, BSQ_EDATA, "%s: %s", path, slot->error);
    return bsq_fail(slot->ctx, BSQ_EDATA, "%s:%s%" PRIu64 ": %s", path,
                    slot->block.first_line ? "" : " byte ", slot->at, slot->error);
}

/* Makes indices that count from the start of the file, or of the block, count over the scan. */
static void add_bases(struct stream_slot *slot)
{
    const struct stream_source *source = slot->source;
    struct mesh_arrays *arrays = &slot->arrays;
    for (int kind = 0; kind < FMT_MESH_KIND_COUNT; kind++) {
        uint64_t *corners = arrays->corners[kind], base = source->base[kind];
        base += slot->local >> kind & 1 ? source->count[kind] : 0;
        if (base == 0 || (kind != FMT_MESH_VERTEX && !arrays->has_corners[kind]))
            continue;
        for (uint64_t i = 0; kind == FMT_MESH_VERTEX && i < arrays->corner_count; i++)
            corners[i] += base; /* each corner has a vertex */
        if (kind == FMT_MESH_VERTEX && arrays->vertex_bound < UINT64_MAX)
            arrays->vertex_bound += base;
        for (uint64_t i = 0; kind != FMT_MESH_VERTEX && i < arrays->corner_count; i++)
            corners[i] = corners[i] == FMT_MESH_NONE ? FMT_MESH_NONE : corners[i] + base;
    }
}

/* Scales, turns and shifts the elements of a block, in double precision, before anybody chooses an
 * origin for 32-bit positions. */
static void move_elements(const struct bsq_placement *p, struct mesh_arrays *a)
{
    for (uint64_t v = 0; v < a->count[FMT_MESH_VERTEX]; v++) {
        double *position = a->positions[v];
        const double x = position[0] * p->scale, y = position[1] * p->scale,
                     z = position[2] * p->scale;
        const double turned[3][2] = {{y, z}, {z, -y}, {-z, y}}; /* by p->up */
        position[0] = x + p->translate[0];
        position[1] = turned[p->up][0] + p->translate[1];
        position[2] = turned[p->up][1] + p->translate[2];
    }
    for (uint64_t i = 0; p->up != BSQ_UP_KEEP && i < a->count[FMT_MESH_NORMAL]; i++) {
        const float y = a->normals[i][1], z = a->normals[i][2];
        a->normals[i][1] = p->up == BSQ_UP_Y ? z : -z;
        a->normals[i][2] = p->up == BSQ_UP_Y ? -y : y;
    }
}

static int add_face_block(const struct reading *reading, const struct stream_slot *slot)
{
    struct fmt_mesh_reader *reader = reading->reader;
    if (slot->arrays.face_count == 0)
        return 0;
    BSQ_PASS(FMT_RESERVE(reader->ctx, reader->face_block_count + 1, reader->face_blocks,
                         reader->face_block_capacity));
    reader->face_blocks[reader->face_block_count++] = (struct stream_face_block){
        .block = slot->block, .face_base = reading->reader->totals->faces};
    return 0;
}

/* Adds the oddities of a block to the notes of all files. */
static int note_oddities(struct fmt_mesh_reader *reader, const struct stream_slot *slot)
{
    for (int i = 0; i < STREAM_ODDITY_COUNT; i++) {
        const char *text = slot->source->format->oddities[i];
        uint64_t k = 0;
        if (slot->odd[i].count == 0 || !text || reader->read_before)
            continue;
        while (k < reader->note_count && reader->notes[k].text != text)
            k++;
        BSQ_PASS(FMT_RESERVE(reader->ctx, k + 1, reader->notes, reader->note_capacity));
        if (k == reader->note_count)
            reader->notes[reader->note_count++] =
                (struct stream_note){.text = text,
                                     .source = slot->block.source,
                                     .bytes = slot->block.first_line == 0,
                                     .odd = {.at = slot->odd[i].at}};
        reader->notes[k].odd.count += slot->odd[i].count;
    }
    return 0;
}

static void show_arrays(const struct mesh_arrays *a, struct fmt_mesh_batch *batch)
{
    batch->vertex_count = a->count[FMT_MESH_VERTEX];
    batch->positions = (const double(*)[3])a->positions;
    batch->colors = a->has_colors ? (const float(*)[3])a->colors : NULL;
    batch->late_colors = a->late_colors;
    batch->late_color_count = a->late_color_count;
    batch->texcoord_count = a->count[FMT_MESH_TEXCOORD];
    batch->texcoords = (const double(*)[2])a->texcoords;
    batch->normal_count = a->count[FMT_MESH_NORMAL];
    batch->normals = (const float(*)[3])a->normals;
    batch->face_count = a->face_count;
    batch->face_sizes = a->face_sizes;
    batch->corner_count = a->corner_count;
    batch->corner_vertices = a->corners[FMT_MESH_VERTEX];
    batch->corner_texcoords =
        a->has_corners[FMT_MESH_TEXCOORD] ? a->corners[FMT_MESH_TEXCOORD] : NULL;
    batch->corner_normals = a->has_corners[FMT_MESH_NORMAL] ? a->corners[FMT_MESH_NORMAL] : NULL;
    batch->vertex_bound = a->vertex_bound;
    batch->material_change_count = a->change_count;
    batch->material_changes = a->changes;
}

static int call_on_batch(const struct reading *reading, struct stream_slot *slot, uint64_t sequence)
{
    const struct fmt_mesh_totals *totals = reading->reader->totals;
    const struct stream_source *source = slot->source;
    slot->view = (struct fmt_mesh_batch){
        .sequence = sequence,
        .file = slot->block.source,
        .byte_size = slot->block.end - reading->passed,
        .color_white = slot->color_white,
        .fine_colors = slot->fine_colors,
        .missing_positions = slot->odd[STREAM_NO_POSITION].count,
        .missing_texcoords = slot->odd[STREAM_NO_TEXCOORD].count,
        .late_color_base = source->base[FMT_MESH_VERTEX] + source->late_color_count,
        .vertex_base = totals->vertices,
        .texcoord_base = totals->texcoords,
        .normal_base = totals->normals,
        .face_base = totals->faces,
        .material_at_start = slot->material_at_start,
    };
    show_arrays(&slot->arrays, &slot->view);
    return reading->steps->on_batch ? reading->steps->on_batch(reading->arg, &slot->view) : 0;
}

/* Adds the block to all counts. */
static void count_stream_block(struct reading *reading, const struct stream_slot *slot)
{
    const struct mesh_arrays *arrays = &slot->arrays;
    struct stream_source *source = slot->source;
    struct fmt_mesh_totals *totals = reading->reader->totals;
    for (int kind = 0; kind < FMT_MESH_KIND_COUNT; kind++)
        source->count[kind] += arrays->count[kind];
    source->late_color_count += arrays->late_color_count;
    source->lines += slot->block.lines;
    reading->reader->has_colors |= arrays->has_colors || arrays->late_color_count > 0;
    totals->bytes += slot->block.end - reading->passed;
    totals->vertices += arrays->count[FMT_MESH_VERTEX];
    totals->texcoords += arrays->count[FMT_MESH_TEXCOORD];
    totals->normals += arrays->count[FMT_MESH_NORMAL];
    totals->faces += arrays->face_count;
    totals->corners += arrays->corner_count;
    totals->short_faces += slot->short_faces;
    totals->materials = (uint32_t)reading->reader->material_count;
    reading->passed = slot->block.end;
}

static int emit(void *arg, void *slot_memory, uint64_t sequence)
{
    struct reading *reading = arg;
    struct stream_slot *slot = slot_memory;
    struct stream_source *source = slot->source;
    BSQ_PASS(bsq_check(slot->ctx));
    if (sequence == 0 || source->number != reading->source)
        BSQ_PASS(enter_source(reading, source));
    if (source->format->pass)
        BSQ_PASS(source->format->pass(slot));
    if (slot->error[0])
        return fail_block(slot);
    add_bases(slot);
    if (source->moves)
        move_elements(&source->placement, &slot->arrays);
    BSQ_PASS(note_oddities(reading->reader, slot));
    BSQ_PASS(add_face_block(reading, slot));
    BSQ_PASS(call_on_batch(reading, slot, sequence));
    count_stream_block(reading, slot);
    return 0;
}

static int follow(void *arg, void *slot_memory, uint64_t sequence, unsigned worker)
{
    const struct reading *reading = arg;
    const struct stream_slot *slot = slot_memory;
    (void)sequence, (void)worker;
    return reading->steps->follow(reading->arg, &slot->view, (unsigned)(slot - reading->slots));
}

static int finish(void *arg, void *slot_memory, uint64_t sequence)
{
    const struct reading *reading = arg;
    const struct stream_slot *slot = slot_memory;
    (void)sequence;
    return reading->steps->finish(reading->arg, &slot->view, (unsigned)(slot - reading->slots));
}

/* ---- reading ---- */

void fmt_stream_free_slot(struct stream_slot *slot)
{
    struct mesh_arrays *a = &slot->arrays;
    BSQ_FREE(slot->ctx, a->positions, a->colors, a->texcoords, a->normals, a->face_sizes,
             a->corners[0], a->corners[1], a->corners[2], a->face_tags, a->late_colors, a->changes,
             slot->bytes, slot->work, slot->statements);
}

static unsigned count_slots(const struct fmt_mesh_reader *reader)
{
    uint64_t blocks = 1;
    const unsigned most = fmt_mesh_max_slots(reader);
    for (uint32_t i = 0; i < reader->source_count && blocks < most; i++)
        blocks += fmt_input_size(reader->sources[i].input) / STREAM_BLOCK_BYTES + 2;
    return blocks < most ? (unsigned)blocks : most;
}

static int run_reading(struct reading *reading)
{
    struct bsq_ctx *ctx = reading->reader->ctx;
    const unsigned slot_count = count_slots(reading->reader);
    BSQ_PASS(BSQ_CALLOC(ctx, "batches of a mesh", slot_count, &reading->slots));
    for (unsigned i = 0; i < slot_count; i++)
        reading->slots[i].ctx = ctx;
    struct bsq_pipeline pipeline = {
        .produce = produce,
        .work = work,
        .emit = emit,
        .follow = reading->steps->follow ? follow : NULL,
        .finish = reading->steps->follow ? finish : NULL,
        .arg = reading,
        .slots = reading->slots,
        .slot_size = sizeof *reading->slots,
        .slot_count = slot_count,
    };
    int status = bsq_pipeline_run(ctx, &pipeline);
    for (unsigned i = 0; i < slot_count; i++)
        fmt_stream_free_slot(&reading->slots[i]);
    bsq_free(ctx, reading->slots);
    return status;
}

int fmt_stream_warn_unread(const struct stream_source *source, const struct stream_unread *kinds,
                           size_t count)
{
    for (size_t i = 0; i < count && !source->reader->read_before; i++) {
        if (kinds[i].count > 0 && kinds[i].loss)
            BSQ_PASS(bsq_warn_loss(source->ctx, "%s: %" PRIu64 " %s", source->path, kinds[i].count,
                                   kinds[i].what));
        else if (kinds[i].count > 0)
            bsq_warn(source->ctx, "%s: %" PRIu64 " %s", source->path, kinds[i].count,
                     kinds[i].what);
    }
    return 0;
}

/* Warns once of each kind of oddity: with its first line, if that is known. */
static int warn_oddities(const struct fmt_mesh_reader *reader)
{
    for (uint64_t i = 0; i < reader->note_count; i++) {
        const struct stream_note *note = &reader->notes[i];
        const struct stream_unread kind = {note->odd.count, true, note->text};
        if (note->odd.at == 0)
            BSQ_PASS(fmt_stream_warn_unread(&reader->sources[note->source], &kind, 1));
        else
            BSQ_PASS(bsq_warn_loss(reader->ctx,
                                   "%s:%s%" PRIu64 ": %s: %" PRIu64 "; this is the first",
                                   reader->sources[note->source].path, note->bytes ? " byte " : "",
                                   note->odd.at, note->text, note->odd.count));
    }
    return 0;
}

int fmt_mesh_read_steps(struct fmt_mesh_reader *reader, const struct fmt_mesh_steps *steps,
                        void *arg, struct fmt_mesh_totals *totals)
{
    struct reading reading = {.reader = reader, .steps = steps, .arg = arg};
    struct fmt_mesh_totals unused = {0};
    reader->totals = totals ? totals : &unused;
    *reader->totals = (struct fmt_mesh_totals){0};
    reader->face_block_count = reader->note_count = 0;
    reader->painted = reader->unpainted = false;
    int status = run_reading(&reading);
    for (uint32_t i = 0; i < reader->source_count; i++) {
        const int left = leave_file(&reader->sources[i]);
        status = status ? status : left;
    }
    for (uint32_t i = 0; i < reader->source_count && !status; i++)
        if (reader->sources[i].format->finish)
            status = reader->sources[i].format->finish(&reader->sources[i]);
    if (!status && !reader->read_before)
        status = warn_oddities(reader);
    reader->read_before |= status == 0;
    return status;
}

/* ---- finding a face again ---- */

/* Returns the last block whose faces begin at or before `face`. */
static const struct stream_face_block *find_face_block(const struct fmt_mesh_reader *reader,
                                                       uint64_t face)
{
    uint64_t low = 0, high = reader->face_block_count;
    while (high - low > 1) {
        uint64_t middle = low + (high - low) / 2;
        if (reader->face_blocks[middle].face_base <= face)
            low = middle;
        else
            high = middle;
    }
    return reader->face_block_count ? &reader->face_blocks[low] : NULL;
}

int fmt_stream_parse_again(struct stream_source *source, const struct stream_block *block,
                           uint64_t face, struct stream_slot *slot)
{
    *slot = (struct stream_slot){
        .ctx = source->ctx, .source = source, .block = *block, .last_face = face};
    const bool opened = !source->open;
    int status = opened ? enter_file(source) : 0;
    if (!status)
        status = source->format->parse(slot);
    const int left = opened ? leave_file(source) : 0;
    return status ? status : left;
}

int fmt_stream_locate_face(struct fmt_mesh_reader *reader, uint64_t face,
                           struct fmt_mesh_location *out)
{
    const struct stream_face_block *found = find_face_block(reader, face);
    struct stream_slot slot;
    if (!found)
        return bsq_fail(reader->ctx, BSQ_EBUG, "face %" PRIu64 " has not been read", face);
    struct stream_source *source = &reader->sources[found->block.source];
    int status = fmt_stream_parse_again(source, &found->block, face - found->face_base, &slot);
    *out = (struct fmt_mesh_location){.path = source->path,
                                      .first_face = source->face_base,
                                      .from_zero = !source->format->from_one};
    *(found->block.first_line ? &out->line : &out->byte) = slot.at;
    memcpy(out->base, source->base, sizeof out->base);
    memcpy(out->count, source->count, sizeof out->count);
    fmt_stream_free_slot(&slot);
    return status;
}

void fmt_mesh_close(struct fmt_mesh_reader *reader)
{
    if (!reader)
        return;
    for (uint32_t i = 0; i < reader->source_count; i++) {
        struct stream_source *source = &reader->sources[i];
        if (source->data && source->format->end)
            source->format->end(source);
        BSQ_FREE(reader->ctx, source->data, source->numbers);
        fmt_input_free(source->input);
    }
    BSQ_FREE(reader->ctx, reader->sources, reader->face_blocks, reader->notes);
    bsq_tally_release(reader->ctx, &reader->names);
    bsq_free(reader->ctx, reader);
}
