#include "tests/fuzz/tris_mend.h"

#include <string.h>
#include <xxhash.h>

#include "formats/chunks/tris_internal.h"

/* Returns the checksum of the bytes from `begin` to `end` if they are inside the file, else `old`.
 */
static uint64_t sum_of(const uint8_t *data, size_t size, uint64_t begin, uint64_t end, uint64_t old)
{
    return begin <= end && end <= size ? XXH3_64bits(data + begin, end - begin) : old;
}

static void mend_entry(const uint8_t *data, uint64_t size, uint32_t attributes,
                       struct fmt_tris_chunk_info *entry)
{
    const struct tris_layout l =
        tris_chunk_layout(attributes, entry->triangle_count, entry->vertex_count);
    if (entry->offset > size || entry->size_bytes > size - entry->offset)
        return;
    const uint8_t *chunk = data + entry->offset;
    entry->checksum = XXH3_64bits(chunk, entry->size_bytes);
    if (attributes & FMT_TRIS_SAMPLES)
        entry->sample_checksum =
            sum_of(chunk, entry->size_bytes, l.values[TRIS_ATTRIBUTE_COUNT - 1], l.triangles,
                   entry->sample_checksum);
}

void tris_mend(uint8_t *data, size_t size)
{
    struct tris_file_header h;
    struct fmt_tris_chunk_info entry;
    if (size < sizeof h)
        return;
    memcpy(&h, data, sizeof h);
    h.file_bytes = size;
    for (uint64_t at = h.table_offset; at <= size && size - at >= sizeof entry;
         at += sizeof entry) {
        memcpy(&entry, data + at, sizeof entry);
        mend_entry(data, size, h.attributes, &entry);
        memcpy(data + at, &entry, sizeof entry);
    }
    h.images_checksum = sum_of(data, size, sizeof h, h.chunks_offset, h.images_checksum);
    h.materials_checksum =
        sum_of(data, size, h.materials_offset, h.table_offset, h.materials_checksum);
    h.table_checksum = sum_of(data, size, h.table_offset, size, h.table_checksum);
    h.header_checksum = XXH3_64bits(&h, offsetof(struct tris_file_header, header_checksum));
    memcpy(data, &h, sizeof h);
}
