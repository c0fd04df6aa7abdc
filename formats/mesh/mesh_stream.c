/* mesh_stream.c - see mesh_stream.h. */
#include "formats/mesh/mesh_stream.h"

#include <inttypes.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "base/parallel.h"
#include "formats/mesh/mesh_text.h"

/* One call of fmt_stream_read(). */
struct job {
    struct stream_reader *reader;
    const struct fmt_mesh_steps *steps;
    void *arg;
    struct fmt_mesh_totals *totals;
    struct stream_slot *slots;
    struct stream_part cut; /* the last part that was cut */
    uint32_t source;        /* file of the last part that passed */
    uint64_t passed;        /* bytes of this file that earlier blocks have */
};

/* ---- files ---- */

static int set_sources(struct stream_reader *reader, struct fmt_input *const *inputs,
                       uint32_t input_count)
{
    struct bsq_ctx *ctx = reader->base.ctx;
    int status =
        bsq_calloc(ctx, "mesh files", input_count, sizeof *reader->sources, &reader->sources);
    if (status)
        return status;
    reader->source_count = input_count;
    for (uint32_t i = 0; i < input_count; i++) {
        reader->sources[i].input = inputs[i];
        reader->sources[i].path = fmt_input_path(inputs[i]);
    }
    return 0;
}

int fmt_stream_open(struct bsq_ctx *ctx, const struct stream_format *stream,
                    struct fmt_input *const *inputs, uint32_t input_count,
                    struct fmt_mesh_reader **out)
{
    struct stream_reader *reader;
    int status = bsq_calloc(ctx, stream->reader_name, 1, stream->reader_bytes, &reader);
    if (status)
        return status;
    reader->base.ctx = ctx;
    reader->stream = stream;
    status = set_sources(reader, inputs, input_count);
    if (!status)
        status = stream->prepare(reader);
    for (uint32_t i = 0; i < input_count && !status; i++)
        status = stream->begin(reader, i);
    if (status)
        stream->end(&reader->base);
    else
        *out = &reader->base;
    return status;
}

void fmt_stream_free(struct stream_reader *reader)
{
    struct bsq_ctx *ctx = reader->base.ctx;
    bsq_free(ctx, reader->sources);
    bsq_free(ctx, reader->places);
    bsq_free(ctx, reader);
}

/* Opens a file before its first part. */
static int enter_file(struct stream_reader *reader, uint32_t number)
{
    struct stream_source *source = &reader->sources[number];
    int status = fmt_input_open(source->input);
    source->open = status == 0;
    if (!status && reader->stream->open)
        status = reader->stream->open(reader, number);
    return status;
}

/* Closes a file after its last part. Errors: BSQ_EIO if it was changed meanwhile. */
static int close_source(struct stream_reader *reader, struct stream_source *source)
{
    const bool was_open = source->open;
    source->open = false;
    int status = was_open ? fmt_input_close(source->input) : 0;
    const int closed = reader->stream->close
                           ? reader->stream->close(reader, (uint32_t)(source - reader->sources))
                           : 0;
    return status ? status : closed;
}

int fmt_stream_reserve(struct bsq_ctx *ctx, struct stream_slot *slot, uint64_t size)
{
    if (size > UINT64_MAX - STREAM_PADDING)
        return bsq_fail(ctx, BSQ_ENOMEM, "a part of a mesh file is too long");
    if (size + STREAM_PADDING <= slot->capacity)
        return 0;
    return bsq_grow(ctx, "parts of mesh files", size + STREAM_PADDING, 1, &slot->bytes,
                    &slot->capacity);
}

int fmt_stream_extend(struct stream_reader *reader, struct stream_slot *slot, uint64_t have,
                      uint64_t size, uint64_t *loaded, bool *at_end)
{
    struct fmt_input *input = reader->sources[slot->part.source].input;
    const uint64_t offset = slot->part.offset;
    uint64_t file_size, end;
    *loaded = have;
    *at_end = false;
    if (__builtin_add_overflow(offset, size, &end) || end > fmt_input_size(input))
        end = fmt_input_size(input);
    end = end > offset ? end : offset;
    /* Memory first: who cannot hold so much need not have it unpacked. */
    int status = fmt_stream_reserve(reader->base.ctx, slot, end - offset);
    if (!status)
        status = fmt_input_reach(input, end, &file_size);
    if (status)
        return status;
    end = end < file_size ? end : file_size;
    size = end > offset ? end - offset : 0;
    if (size > have)
        status = fmt_input_read(input, slot->bytes + have, size - have, offset + have);
    if (!status)
        *loaded = size > have ? size : have;
    *at_end = offset + *loaded >= file_size;
    return status;
}

int fmt_stream_load(struct stream_reader *reader, struct stream_slot *slot)
{
    struct bsq_ctx *ctx = reader->base.ctx;
    const struct stream_part *part = &slot->part;
    int status = slot->loaded ? 0 : fmt_stream_reserve(ctx, slot, part->size);
    if (!status && !slot->loaded)
        status = fmt_input_read(reader->sources[part->source].input, slot->bytes, part->size,
                                part->offset);
    slot->loaded = !status;
    return status;
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

/* ---- cutting and parsing ---- */

static int produce(void *arg, void *slot_memory, uint64_t sequence)
{
    struct job *job = arg;
    struct stream_slot *slot = slot_memory;
    struct stream_reader *reader = job->reader;
    (void)sequence;
    while (job->cut.source < reader->source_count) {
        struct stream_source *source = &reader->sources[job->cut.source];
        int status = !source->open && job->cut.end == 0 ? enter_file(reader, job->cut.source) : 0;
        slot->loaded = false;
        slot->error[0] = '\0';
        slot->part = (struct stream_part){.source = job->cut.source};
        if (status == 0 && !job->cut.failed)
            status = reader->stream->cut(reader, &job->cut, slot);
        slot->part.failed = slot->error[0] != '\0';
        if (status != 0) {
            job->cut = slot->part;
            return status;
        }
        /* No part of an empty file passes, so nothing else closes it. */
        status = job->cut.end == 0 ? close_source(reader, source) : 0;
        if (status != 0)
            return status;
        job->cut = (struct stream_part){.source = job->cut.source + 1};
    }
    return 0;
}

static int work(void *arg, void *slot_memory, uint64_t sequence, unsigned worker)
{
    const struct job *job = arg;
    struct stream_slot *slot = slot_memory;
    (void)sequence, (void)worker;
    fmt_arrays_clear(&slot->arrays);
    slot->last_face = UINT64_MAX;
    slot->short_faces = slot->bad_normals = slot->bad_colors = slot->bad_texcoords = 0;
    slot->missing_positions = slot->missing_texcoords = slot->clamped_colors = 0;
    slot->lost_textures = 0;
    slot->color_white = 0;
    return slot->part.failed ? 0 : job->reader->stream->parse(job->reader, slot);
}

/* ---- passing in order ---- */

/* Moves on to the file of the next part. The parts of earlier files have all been parsed. */
static int enter_source(struct job *job, uint32_t number)
{
    struct stream_reader *reader = job->reader;
    struct stream_source *source = &reader->sources[number];
    const struct fmt_mesh_totals *totals = job->totals;
    int status = 0;
    for (uint32_t i = job->source; i < number && !status; i++)
        status = close_source(reader, &reader->sources[i]);
    job->source = number;
    job->passed = 0;
    source->base[FMT_MESH_VERTEX] = totals->vertices;
    source->base[FMT_MESH_TEXCOORD] = totals->texcoords;
    source->base[FMT_MESH_NORMAL] = totals->normals;
    memset(source->count, 0, sizeof source->count);
    return status;
}

static int fail_part(const struct stream_reader *reader, const struct stream_slot *slot)
{
    const char *path = reader->sources[slot->part.source].path;
    if (slot->at == 0)
        return bsq_fail(reader->base.ctx, BSQ_EDATA, "%s: %s", path, slot->error);
    if (slot->part.first_line)
        return bsq_fail(reader->base.ctx, BSQ_EDATA, "%s:%" PRIu64 ": %s", path, slot->at,
                        slot->error);
    return bsq_fail(reader->base.ctx, BSQ_EDATA, "%s: byte %" PRIu64 ": %s", path, slot->at,
                    slot->error);
}

/* Makes indices that count from the start of the file count over the scan. */
static void add_bases(const struct stream_source *source, struct mesh_arrays *arrays)
{
    for (int kind = 0; kind < FMT_MESH_KIND_COUNT; kind++) {
        uint64_t *corners = arrays->corners[kind], base = source->base[kind];
        if (base == 0 || (kind != FMT_MESH_VERTEX && !arrays->has_corners[kind]))
            continue;
        for (uint64_t i = 0; i < arrays->corner_count; i++)
            corners[i] = corners[i] == FMT_MESH_NONE ? FMT_MESH_NONE : corners[i] + base;
    }
}

static int add_place(const struct job *job, const struct stream_slot *slot)
{
    struct stream_reader *reader = job->reader;
    int status = 0;
    if (slot->arrays.face_count == 0)
        return 0;
    if (reader->place_count == reader->place_capacity)
        status = bsq_grow(reader->base.ctx, "table of parts", reader->place_count + 16,
                          sizeof *reader->places, &reader->places, &reader->place_capacity);
    if (!status)
        reader->places[reader->place_count++] =
            (struct stream_place){.part = slot->part, .face_base = job->totals->faces};
    return status;
}

static int call_on_block(const struct job *job, struct stream_slot *slot, uint64_t sequence)
{
    const struct fmt_mesh_totals *totals = job->totals;
    slot->view = (struct fmt_mesh_block){
        .sequence = sequence,
        .file = slot->part.source,
        .byte_offset = job->passed,
        .byte_size = slot->part.end - job->passed,
        .color_white = slot->color_white,
        .missing_positions = slot->missing_positions,
        .missing_texcoords = slot->missing_texcoords,
        .vertex_base = totals->vertices,
        .texcoord_base = totals->texcoords,
        .normal_base = totals->normals,
        .face_base = totals->faces,
        .material_at_start = FMT_MESH_NO_MATERIAL,
    };
    fmt_arrays_show(&slot->arrays, &slot->view);
    return job->steps->on_block ? job->steps->on_block(job->arg, &slot->view) : 0;
}

/* Adds the part to all counts. */
static void count_part(struct job *job, const struct stream_slot *slot)
{
    const struct mesh_arrays *arrays = &slot->arrays;
    struct stream_source *source = &job->reader->sources[slot->part.source];
    struct fmt_mesh_totals *totals = job->totals;
    for (int kind = 0; kind < FMT_MESH_KIND_COUNT; kind++)
        source->count[kind] += arrays->count[kind];
    totals->bytes += slot->part.end - job->passed;
    totals->vertices += arrays->count[FMT_MESH_VERTEX];
    totals->texcoords += arrays->count[FMT_MESH_TEXCOORD];
    totals->normals += arrays->count[FMT_MESH_NORMAL];
    totals->faces += arrays->face_count;
    totals->corners += arrays->corner_count;
    totals->short_faces += slot->short_faces;
    job->passed = slot->part.end;
}

static int emit(void *arg, void *slot_memory, uint64_t sequence)
{
    struct job *job = arg;
    struct stream_slot *slot = slot_memory;
    struct stream_reader *reader = job->reader;
    int status = bsq_check(reader->base.ctx);
    if (!status && (sequence == 0 || slot->part.source != job->source))
        status = enter_source(job, slot->part.source);
    if (!status && slot->error[0])
        status = fail_part(reader, slot);
    if (!status && reader->stream->pass)
        status = reader->stream->pass(reader, slot, job->totals);
    if (status)
        return status;
    add_bases(&reader->sources[slot->part.source], &slot->arrays);
    status = add_place(job, slot);
    if (!status)
        status = call_on_block(job, slot, sequence);
    if (!status)
        count_part(job, slot);
    return status;
}

static int follow(void *arg, void *slot_memory, uint64_t sequence, unsigned worker)
{
    const struct job *job = arg;
    const struct stream_slot *slot = slot_memory;
    (void)sequence, (void)worker;
    return job->steps->follow(job->arg, &slot->view, (unsigned)(slot - job->slots));
}

static int finish(void *arg, void *slot_memory, uint64_t sequence)
{
    const struct job *job = arg;
    const struct stream_slot *slot = slot_memory;
    (void)sequence;
    return job->steps->finish(job->arg, &slot->view, (unsigned)(slot - job->slots));
}

/* ---- reading ---- */

static void free_slot(struct bsq_ctx *ctx, struct stream_slot *slot)
{
    fmt_arrays_free(ctx, &slot->arrays);
    bsq_free(ctx, slot->bytes);
    bsq_free(ctx, slot->work);
}

static unsigned count_slots(const struct stream_reader *reader)
{
    uint64_t parts = 1;
    unsigned most = fmt_mesh_max_slots(&reader->base);
    for (uint32_t i = 0; i < reader->source_count && parts < most; i++)
        parts += fmt_input_size(reader->sources[i].input) / STREAM_PART_BYTES + 2;
    return parts < most ? (unsigned)parts : most;
}

static int run_job(struct job *job)
{
    struct bsq_ctx *ctx = job->reader->base.ctx;
    unsigned slot_count = count_slots(job->reader);
    int status =
        bsq_calloc(ctx, "parts of mesh files", slot_count, sizeof *job->slots, &job->slots);
    if (status)
        return status;
    struct bsq_pipeline pipeline = {
        .produce = produce,
        .work = work,
        .emit = emit,
        .follow = job->steps->follow ? follow : NULL,
        .finish = job->steps->follow ? finish : NULL,
        .arg = job,
        .slots = job->slots,
        .slot_size = sizeof *job->slots,
        .slot_count = slot_count,
    };
    status = bsq_pipeline_run(ctx, &pipeline);
    for (unsigned i = 0; i < slot_count; i++)
        free_slot(ctx, &job->slots[i]);
    bsq_free(ctx, job->slots);
    return status;
}

int fmt_stream_read(struct stream_reader *reader, const struct fmt_mesh_steps *steps, void *arg,
                    struct fmt_mesh_totals *totals)
{
    struct job job = {.reader = reader, .steps = steps, .arg = arg, .totals = totals};
    reader->place_count = 0;
    int status = run_job(&job);
    for (uint32_t i = 0; i < reader->source_count; i++) {
        int closed = close_source(reader, &reader->sources[i]);
        status = status ? status : closed;
    }
    return status;
}

/* ---- finding a face again ---- */

/* Returns the last place whose faces begin at or before `face`. */
static const struct stream_place *find_place(const struct stream_reader *reader, uint64_t face)
{
    uint64_t low = 0, high = reader->place_count;
    while (high - low > 1) {
        uint64_t middle = low + (high - low) / 2;
        if (reader->places[middle].face_base <= face)
            low = middle;
        else
            high = middle;
    }
    return reader->place_count ? &reader->places[low] : NULL;
}

/* Loads and parses a part up to its face number `face`. *at: the line or byte of the face. */
static int parse_again(struct stream_reader *reader, const struct stream_part *part, uint64_t face,
                       uint64_t *at)
{
    struct bsq_ctx *ctx = reader->base.ctx;
    struct stream_source *source = &reader->sources[part->source];
    struct stream_slot slot = {.part = *part, .last_face = face};
    const bool opened = !source->open;
    int status = opened ? enter_file(reader, part->source) : 0;
    if (!status)
        status = fmt_stream_load(reader, &slot);
    if (!status)
        status = reader->stream->parse(reader, &slot);
    *at = slot.at;
    free_slot(ctx, &slot);
    const int closed = opened ? close_source(reader, source) : 0;
    return status ? status : closed;
}

int fmt_stream_locate_face(struct stream_reader *reader, uint64_t face, struct fmt_mesh_place *out)
{
    const struct stream_place *place = find_place(reader, face);
    uint64_t at = 0;
    if (!place)
        return bsq_fail(reader->base.ctx, BSQ_EBUG, "face %" PRIu64 " has not been read", face);
    const struct stream_source *source = &reader->sources[place->part.source];
    int status = parse_again(reader, &place->part, face - place->face_base, &at);
    *out = (struct fmt_mesh_place){.path = source->path, .from_zero = true};
    *(place->part.first_line ? &out->line : &out->byte) = at;
    memcpy(out->base, source->base, sizeof out->base);
    memcpy(out->count, source->count, sizeof out->count);
    return status;
}
