/* obj_locate.c - finds the line of a face again, for messages.
 *
 * Line numbers of faces are not kept. A table says which block has a face; parsing that block again
 * up to the face counts the lines before it. */
#include <inttypes.h>
#include <string.h>

#include "formats/mesh/obj_internal.h"

/* Returns the last place whose faces begin at or before `face`. Blocks without faces are not in the
 * table. */
static const struct obj_place *find_place(const struct obj_reader *reader, uint64_t face)
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

/* Parses block `index` of `source` up to its face number `face`. *line: the line of the face, from
 * the start of the block. *count: the elements of the block before the face. */
static int parse_up_to(struct bsq_ctx *ctx, const struct obj_source *source, uint64_t index,
                       uint64_t face, uint64_t *line, uint64_t count[FMT_MESH_KIND_COUNT])
{
    struct obj_block block = {0};
    uint64_t offset;
    int status = fmt_input_open(source->input), closed;
    if (!status)
        status = fmt_obj_text_load(ctx, source->input, index, &block, &offset);
    if (!status)
        status = fmt_obj_block_parse(ctx, &block, offset == 0, face);
    *line = block.lines;
    memcpy(count, block.count, sizeof block.count);
    fmt_obj_block_free(ctx, &block);
    closed = fmt_input_close(source->input);
    return status ? status : closed;
}

int fmt_obj_locate_face(struct fmt_mesh_reader *base, uint64_t face, struct fmt_mesh_place *out)
{
    const struct obj_reader *reader = (const struct obj_reader *)base;
    const struct obj_place *place = find_place(reader, face);
    if (!place)
        return bsq_fail(base->ctx, BSQ_EBUG, "face %" PRIu64 " has not been read", face);
    const struct obj_source *source = &reader->sources[place->source];
    uint64_t line, count[FMT_MESH_KIND_COUNT];
    int status =
        parse_up_to(base->ctx, source, place->block, face - place->face_base, &line, count);
    *out = (struct fmt_mesh_place){.path = source->path, .line = place->first_line + line};
    memcpy(out->base, source->base, sizeof out->base);
    memcpy(out->count, source->count, sizeof out->count);
    return status;
}

int fmt_obj_fail_relative(struct obj_reader *reader, const struct obj_source *source,
                          const struct obj_block *block, uint64_t index, uint64_t corner)
{
    const enum fmt_mesh_kind kind = FMT_MESH_VERTEX;
    uint64_t face = 0, line, count[FMT_MESH_KIND_COUNT];
    for (uint64_t end = block->face_sizes[0]; end <= corner; end += block->face_sizes[face])
        face++;
    int64_t distance = (int64_t)(block->corners[kind][corner] - OBJ_RELATIVE_ZERO);
    int status = parse_up_to(reader->base.ctx, source, index, face, &line, count);
    if (status)
        return status;
    return bsq_fail(reader->base.ctx, BSQ_EDATA,
                    "%s:%" PRIu64 ": face refers to %s %" PRId64 ", file has %" PRIu64 " so far",
                    source->path, source->lines + line + 1, fmt_mesh_kind_names[kind],
                    distance - (int64_t)count[kind], source->count[kind] + count[kind]);
}
