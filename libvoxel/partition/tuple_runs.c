/* tuple_runs.c - see tuple_runs.h. */
#include "libvoxel/partition/tuple_runs.h"
#include "libvoxel/partition/corner_delta_code.h"

/* ---- tuples ---- */

static void add_indices(struct tuple_layout *layout, const struct scan *scan)
{
    for (int kind = 0; kind < FMT_MESH_KIND_COUNT; kind++) {
        /* The largest number of this width is reserved: it means "none". */
        const uint64_t count = scan_count(scan, scan_stream_of(kind));
        const uint32_t width = tuple_index_width(count, scan->limits->index_bytes);
        layout->index_bytes[kind] = scan_keeps(scan, scan_stream_of(kind)) ? width : 0;
        layout->index_at[kind] = layout->corner_bytes;
        layout->corner_bytes += layout->index_bytes[kind];
    }
}

static bool streams_spilled(const struct scan *scan)
{
    bool spilled = false;
    for (int i = 0; i < SCAN_STREAM_COUNT; i++)
        spilled |= bsq_spill_in_file(&scan->streams[i].spill) && scan_keeps(scan, i);
    return spilled;
}

void vox_tuple_layout_for(const struct scan *scan, struct tuple_layout *layout)
{
    *layout = (struct tuple_layout){.gathered = streams_spilled(scan)};
    add_indices(layout, scan);
    if (scan->material_count > 0)
        layout->material_bytes = tuple_index_width(scan->material_count, 1);
    layout->bytes = 3 * layout->corner_bytes + layout->material_bytes;
    layout->plain =
        scan->attributes == 0 && layout->index_bytes[FMT_MESH_VERTEX] == 4 && layout->bytes == 12;
}

void vox_tuple_vertex(const struct tuple_layout *layout, const struct scan *scan,
                      const uint8_t *corner, struct vertex *out)
{
    const struct attribute_stream *streams = scan->streams;
    uint64_t v = tuple_vertex_index(layout, corner);
    memset(out, 0, sizeof *out);
    memcpy(out->position, stream_at(&streams[SCAN_POSITIONS], v, 12), 12);
    if (scan->attributes & FMT_TRIS_COLORS) {
        memcpy(&out->color, stream_at(&streams[SCAN_COLORS], v, 4), 4);
        const bool fine = scan->attributes & FMT_TRIS_FINE_COLORS;
        if (fine)
            memcpy(&out->fine_color, stream_at(&streams[SCAN_FINE_COLORS], v, 4), 4);
        vox_scan_scale_colors(scan, v, 1, &out->color, fine ? &out->fine_color : NULL);
    }
    if (scan->attributes & FMT_TRIS_TEXCOORDS) {
        uint64_t t = tuple_load(corner + layout->index_at[FMT_MESH_TEXCOORD],
                                layout->index_bytes[FMT_MESH_TEXCOORD]);
        if (t < scan_count(scan, SCAN_TEXCOORDS))
            memcpy(out->texcoord, stream_at(&streams[SCAN_TEXCOORDS], t, 8), 8);
    }
    if (scan->attributes & FMT_TRIS_NORMALS) {
        uint64_t n = tuple_load(corner + layout->index_at[FMT_MESH_NORMAL],
                                layout->index_bytes[FMT_MESH_NORMAL]);
        out->normal = SCAN_NO_NORMAL;
        if (n < scan_count(scan, SCAN_NORMALS))
            memcpy(&out->normal, stream_at(&streams[SCAN_NORMALS], n, 4), 4);
    }
}

/* ---- the buffer ---- */

/* Size of the largest run: delta codes of all kinds of indices. Plain tuples are never larger. */
#define RUN_MAX      (RUN_TRIANGLES * FMT_MESH_KIND_COUNT * CORNER_CODE_MAX)
#define BUFFER_BYTES (RUN_MAX + RUN_HEADER_MAX)
_Static_assert(RUN_MAX < 1u << RUN_BYTES_BITS, "a run's bytes must fit in its header");

int vox_run_reader_init(struct run_reader *reader, const struct scan *scan,
                        const struct tuple_layout *layout)
{
    *reader = (struct run_reader){.scan = scan, .layout = layout};
    return bsq_calloc(scan->ctx, "sorting", BUFFER_BYTES + CORNER_CODE_SLACK, 1, &reader->buffer);
}

void vox_run_reader_free(struct run_reader *reader)
{
    if (reader->scan)
        bsq_free(reader->scan->ctx, reader->buffer);
    memset(reader, 0, sizeof *reader);
}

void vox_run_reader_seek(struct run_reader *reader, const struct bsq_spill *buckets,
                         uint32_t bucket, uint64_t offset)
{
    reader->begin = reader->end = 0;
    reader->buckets = buckets;
    reader->bucket = bucket;
    reader->offset = offset;
    reader->cursor = (struct bsq_spill_cursor){0};
}

/* Makes at least `size` bytes available at `begin`. */
static int fill_buffer(struct run_reader *reader, uint32_t size)
{
    uint32_t have = reader->end - reader->begin;
    uint64_t left = reader->buckets->list[reader->bucket].bytes - reader->offset;
    uint32_t capacity = BUFFER_BYTES - have;
    if (have >= size)
        return 0;
    memmove(reader->buffer, reader->buffer + reader->begin, have);
    uint32_t more = left < capacity ? (uint32_t)left : capacity;
    BSQ_PASS(bsq_spill_read(reader->buckets, reader->bucket, reader->offset, more,
                            reader->buffer + have, &reader->cursor));
    reader->offset += more;
    reader->begin = 0;
    reader->end = have + more;
    return reader->end < size
               ? bsq_fail(reader->scan->ctx, BSQ_EBUG, "a bucket ends inside of a run")
               : 0;
}

/* ---- decoding ---- */

/* Decodes plain tuples (tuple_runs.h), as most scans have them. */
static void decode_plain(const uint8_t *from, uint32_t count, uint8_t *to)
{
    struct corner_code code = {0};
    for (uint32_t t = 0; t < count; t++, to += 12) {
        uint64_t index[3];
        from = corner_code_get(&code, from, index);
        /* One by one: a copy of all waits until they have left the processor's store buffer. */
        for (uint32_t k = 0; k < 3; k++)
            memcpy(to + 4 * k, &(uint32_t){(uint32_t)index[k]}, 4);
    }
}

static void decode_indices(const struct tuple_layout *layout, unsigned form, const uint8_t *from,
                           uint32_t count, uint8_t *to)
{
    struct corner_code codes[FMT_MESH_KIND_COUNT] = {0};
    for (uint32_t t = 0; t < count; t++, to += layout->bytes)
        for (int kind = 0; kind < FMT_MESH_KIND_COUNT; kind++) {
            uint64_t index[3] = {FMT_MESH_NONE, FMT_MESH_NONE, FMT_MESH_NONE};
            if (form >> kind & 1)
                from = corner_code_get(&codes[kind], from, index);
            if (layout->index_bytes[kind] == 0)
                continue;
            for (uint32_t k = 0; k < 3; k++)
                tuple_store(to + k * layout->corner_bytes + layout->index_at[kind], index[k],
                            layout->index_bytes[kind]);
        }
}

static void set_materials(const struct scan *scan, const struct tuple_layout *layout,
                          const struct run_header *header, uint8_t *tuples)
{
    uint32_t usemtl = header->material >> 1;
    uint32_t entry = 2 * (usemtl == 0 ? scan->usemtl_count : usemtl - 1) + (header->material & 1);
    for (uint32_t t = 0; t < header->triangles; t++)
        tuple_store(tuples + (uint64_t)t * layout->bytes + 3 * layout->corner_bytes,
                    scan->material_map[entry] + 1, layout->material_bytes);
}

static void tuples_decode(const struct run_reader *reader, const struct run_header *header,
                          const uint8_t *from, uint8_t *to)
{
    const struct tuple_layout *layout = reader->layout;
    const uint32_t count = header->triangles;
    if (header->form == RUN_TUPLES) {
        memcpy(to, from, header->bytes);
        return;
    }
    if (header->form == 1u << FMT_MESH_VERTEX && layout->plain)
        decode_plain(from, count, to);
    else
        decode_indices(layout, header->form, from, count, to);
    if (layout->material_bytes > 0)
        set_materials(reader->scan, layout, header, to);
}

int vox_run_reader_next(struct run_reader *reader, uint8_t *to, uint32_t *count)
{
    struct run_header header;
    uint32_t before;
    BSQ_PASS(fill_buffer(reader, 4));
    header = run_header_get(reader->buffer + reader->begin);
    before = run_header_bytes(&header);
    if (reader->end - reader->begin < before + header.bytes) {
        BSQ_PASS(fill_buffer(reader, before));
        header = run_header_get(reader->buffer + reader->begin);
        BSQ_PASS(fill_buffer(reader, before + header.bytes));
    }
    if (to)
        tuples_decode(reader, &header, reader->buffer + reader->begin + before, to);
    reader->begin += before + header.bytes;
    *count = header.triangles;
    return 0;
}
