/* nvdb_checksum.c - checksums of a .nvdb file's head and of its record.
 *
 * NanoVDB's own checksum covers the grid's head only (its default mode): what its full mode covers
 * changed between 32.4 and 32.6, so a full one would be refused by one or the other. The record
 * has an XXH3-64 of every section instead, see nvdb_verify.c. */
#include <xxhash.h>
#include <zlib.h>

#include "formats/grid/nvdb_layout_internal.h"

uint32_t fmt_nvdb_head_crc(const uint8_t *head, const struct nvdb_layout *layout)
{
    uint64_t begin = FMT_NVDB_GRID_OFFSET + offsetof(struct nvdb_grid_data, version);
    uLong crc = crc32(0, NULL, 0);
    return (uint32_t)crc32_z(crc, head + begin, layout->section[NVDB_HEAD].size - begin);
}

uint64_t fmt_nvdb_record_checksum(const struct nvdb_record *record)
{
    return XXH3_64bits(record, offsetof(struct nvdb_record, record_checksum));
}
