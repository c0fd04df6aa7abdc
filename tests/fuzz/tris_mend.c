#include "tests/fuzz/tris_mend.h"

#include <string.h>
#include <xxhash.h>

#include "formats/chunks/tris_internal.h"

static void mend_chunk(uint8_t *data, uint64_t end, const struct fmt_tris_chunk_info *entry)
{
    if (entry->offset > end || entry->size_bytes > end - entry->offset ||
        entry->size_bytes < sizeof(struct tris_chunk_header))
        return;
    uint8_t *chunk = data + entry->offset;
    uint64_t sum = XXH3_64bits(chunk + sizeof sum, entry->size_bytes - sizeof sum);
    memcpy(chunk, &sum, sizeof sum);
}

void tris_mend(uint8_t *data, size_t size)
{
    struct tris_file_header header;
    if (size < sizeof header)
        return;
    memcpy(&header, data, sizeof header);
    header.file_bytes = size;
    if (header.materials_offset <= header.table_offset && header.table_offset <= size) {
        struct fmt_tris_chunk_info entry;
        for (uint64_t at = header.table_offset; size - at >= sizeof entry; at += sizeof entry) {
            memcpy(&entry, data + at, sizeof entry);
            mend_chunk(data, header.materials_offset, &entry);
        }
        header.materials_checksum = XXH3_64bits(data + header.materials_offset,
                                                header.table_offset - header.materials_offset);
        header.table_checksum = XXH3_64bits(data + header.table_offset, size - header.table_offset);
    }
    header.header_checksum =
        XXH3_64bits(&header, offsetof(struct tris_file_header, header_checksum));
    memcpy(data, &header, sizeof header);
}
