/* record_runs.c - see record_runs.h. */
#include "libvoxel/partition/record_runs.h"
#include "libvoxel/partition/corner_delta_code.h"

uint8_t *vox_run_put_records(const struct record_layout *layout, const uint8_t *records,
                             uint32_t count, uint8_t *to)
{
    struct run_header header = {
        .bytes = count * layout->bytes, .triangles = (uint16_t)count, .form = RUN_RECORDS};
    memcpy(to, &header, sizeof header);
    memcpy(to + sizeof header, records, header.bytes);
    return to + sizeof header + header.bytes;
}

/* ---- the buffer ---- */

/* Size of the largest run: delta codes of all kinds of indices. Plain records are never larger. */
#define BUFFER_BYTES                                                                               \
    (RUN_TRIANGLES * FMT_MESH_KIND_COUNT * CORNER_CODE_MAX + RUN_TRIANGLES / 8 +                   \
     (uint32_t)sizeof(struct run_header))

int vox_run_reader_init(struct run_reader *reader, const struct scan *scan,
                        const struct record_layout *layout)
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

void vox_run_reader_seek(struct run_reader *reader, const struct buckets *buckets, uint32_t bucket,
                         uint64_t offset)
{
    reader->begin = reader->end = 0;
    reader->buckets = buckets;
    reader->bucket = bucket;
    reader->offset = offset;
    reader->cursor = (struct bucket_cursor){0};
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
    int status = vox_buckets_read(reader->buckets, reader->bucket, reader->offset, more,
                                  reader->buffer + have, &reader->cursor);
    reader->offset += more;
    reader->begin = 0;
    reader->end = have + more;
    if (status == 0 && reader->end < size)
        status = bsq_fail(reader->scan->ctx, BSQ_EBUG, "a bucket ends inside of a run");
    return status;
}

/* ---- decoding ---- */

/* Decodes plain records (triangle_record.h), as most scans have them. */
static void decode_plain(const uint8_t *from, uint32_t count, uint8_t *to)
{
    struct corner_code code = {0};
    for (uint32_t t = 0; t < count; t++, to += 12) {
        uint64_t index[3];
        from = corner_code_get(&code, from, index);
        uint32_t record[3] = {(uint32_t)index[0], (uint32_t)index[1], (uint32_t)index[2]};
        memcpy(to, record, sizeof record);
    }
}

static void decode_indices(const struct record_layout *layout, unsigned form, const uint8_t *from,
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
                record_store(to + k * layout->corner_bytes + layout->index_at[kind], index[k],
                             layout->index_bytes[kind]);
        }
}

static void set_materials(const struct scan *scan, const struct record_layout *layout,
                          const struct run_header *header, uint8_t *records)
{
    uint32_t usemtl = header->material >> 1;
    uint32_t entry = 2 * (usemtl == 0 ? scan->usemtl_count : usemtl - 1) + (header->material & 1);
    for (uint32_t t = 0; t < header->triangles; t++)
        record_store(records + (uint64_t)t * layout->bytes + 3 * layout->corner_bytes,
                     scan->material_map[entry] + 1, layout->material_bytes);
}

static void set_fans(const struct record_layout *layout, const uint8_t *bits, uint32_t count,
                     uint8_t *records)
{
    for (uint32_t t = 0; t < count; t++, records += layout->bytes)
        if (bits[t / 8] >> t % 8 & 1)
            record_continue_fan(layout, records);
}

static void decode(const struct run_reader *reader, const struct run_header *header,
                   const uint8_t *from, uint8_t *to)
{
    const struct record_layout *layout = reader->layout;
    const uint32_t count = header->triangles;
    if (header->form == RUN_RECORDS) {
        memcpy(to, from, header->bytes);
        return;
    }
    const unsigned kinds = header->form & ~(unsigned)RUN_FANS;
    if (kinds == 1u << FMT_MESH_VERTEX && layout->plain)
        decode_plain(from, count, to);
    else
        decode_indices(layout, kinds, from, count, to);
    if (header->form & RUN_FANS)
        set_fans(layout, from + header->bytes - (count + 7) / 8, count, to);
    if (layout->material_bytes > 0)
        set_materials(reader->scan, layout, header, to);
}

int vox_run_reader_next(struct run_reader *reader, uint8_t *to, uint32_t *count)
{
    struct run_header header;
    int status = fill_buffer(reader, sizeof header);
    if (status < 0)
        return status;
    memcpy(&header, reader->buffer + reader->begin, sizeof header);
    status = fill_buffer(reader, (uint32_t)sizeof header + header.bytes);
    if (status < 0)
        return status;
    if (to)
        decode(reader, &header, reader->buffer + reader->begin + sizeof header, to);
    reader->begin += (uint32_t)sizeof header + header.bytes;
    *count = header.triangles;
    return 0;
}
