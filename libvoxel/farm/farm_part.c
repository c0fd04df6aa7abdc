/* farm_part.c - writes part files: the voxels of the regions that one task made. See FORMATS.md.
 *
 * A leaf's records lie beside its mask, so the bytes of a region do not depend on the pieces in
 * which it was made. */
#include <string.h>
#include <xxhash.h>

#include "libvoxel/farm/farm_part.h"

struct vox_part_writer {
    const struct vox_farm_plan *plan;
    struct bsq_output *output;
    struct vox_part_header header;
    struct vox_part_entry *entries;
    uint64_t capacity;
    uint32_t words;          /* of a record */
    uint32_t channel_values; /* of these */
    uint64_t buffer_bytes;
    uint8_t *buffer;
    uint64_t fill;
    XXH3_state_t *hash; /* of the last region */
};

uint32_t vox_part_flags(const struct vox_farm_plan *plan, bool has_color, bool has_ids)
{
    return (has_color ? VOX_PART_COLORS : 0u) | (has_ids ? VOX_PART_IDS : 0u) |
           (vox_channel_values(&plan->options) > 0 ? VOX_PART_CHANNELS : 0u);
}

uint32_t vox_part_words(const struct vox_farm_plan *plan, uint32_t flags)
{
    return 2u + ((flags & VOX_PART_COLORS) != 0) + ((flags & VOX_PART_IDS) != 0) +
           vox_channel_values(&plan->options);
}

int vox_part_begin(const struct vox_farm_plan *plan, uint32_t task, bool has_color, bool has_ids,
                   struct bsq_output *output, struct vox_part_writer **out)
{
    struct bsq_ctx *ctx = plan->base.ctx;
    struct vox_part_writer *writer;
    *out = NULL;
    int status = bsq_calloc(ctx, "part", 1, sizeof *writer, &writer);
    if (status < 0)
        return status;
    writer->plan = plan;
    writer->output = output;
    writer->header.head =
        fmt_farm_part_head(&plan->base, task, vox_part_flags(plan, has_color, has_ids));
    writer->words = vox_part_words(plan, writer->header.head.own);
    writer->channel_values = vox_channel_values(&plan->options);
    writer->buffer_bytes = vox_part_buffer_bytes(writer->words);
    writer->hash = XXH3_createState();
    status = writer->hash ? bsq_alloc(ctx, "part", writer->buffer_bytes, 1, &writer->buffer)
                          : fmt_farm_fail_memory(&plan->base);
    if (status == 0) /* its values follow at the end */
        status = bsq_output_write(output, &writer->header, sizeof writer->header);
    if (status < 0)
        vox_part_free(writer);
    else
        *out = writer;
    return status;
}

void vox_part_free(struct vox_part_writer *writer)
{
    if (!writer)
        return;
    struct bsq_ctx *ctx = writer->plan->base.ctx;
    XXH3_freeState(writer->hash);
    bsq_free(ctx, writer->entries);
    bsq_free(ctx, writer->buffer);
    bsq_free(ctx, writer);
}

/* ---- bytes ---- */

/* Writes the buffer, and adds it to the checksum of the last region. */
static int flush(struct vox_part_writer *writer)
{
    const uint64_t size = writer->fill;
    XXH3_64bits_update(writer->hash, writer->buffer, size);
    writer->fill = 0;
    return bsq_output_write(writer->output, writer->buffer, size);
}

static void put(struct vox_part_writer *writer, const void *bytes, size_t size)
{
    memcpy(writer->buffer + writer->fill, bytes, size);
    writer->fill += size;
}

/* Puts the numbers of records that the part has. channels: of these records, if it has any. */
static void put_records(struct vox_part_writer *writer, const struct fmt_nvdb_record *records,
                        const float *channels, uint64_t count)
{
    const uint32_t flags = writer->header.head.own;
    const uint32_t words = writer->words, values = writer->channel_values;
    uint32_t *to = (uint32_t *)(writer->buffer + writer->fill);
    writer->fill += count * words * sizeof *to;
    for (uint64_t i = 0; i < count; i++, to += words) {
        unsigned at = 2;
        to[0] = records[i].normal;
        to[1] = records[i].plane;
        if (flags & VOX_PART_COLORS)
            to[at++] = records[i].color;
        if (flags & VOX_PART_IDS)
            to[at++] = records[i].id;
        if (values > 0)
            memcpy(to + at, channels + i * values, values * sizeof *channels);
    }
}

/* ---- regions ---- */

/* Completes the last region's entry. */
static int end_region(struct vox_part_writer *writer)
{
    if (writer->header.region_count == 0)
        return 0;
    struct vox_part_entry *entry = &writer->entries[writer->header.region_count - 1];
    int status = flush(writer);
    entry->checksum = XXH3_64bits_digest(writer->hash);
    return status;
}

/* Begins the entry of a region, unless its last piece was one of the same region. */
static int begin_region(struct vox_part_writer *writer, const int32_t origin[3])
{
    struct vox_part_header *header = &writer->header;
    if (header->region_count > 0 && memcmp(writer->entries[header->region_count - 1].origin, origin,
                                           sizeof writer->entries->origin) == 0)
        return 0;
    int status = end_region(writer);
    if (status == 0)
        status = bsq_grow(writer->plan->base.ctx, "regions of a part", header->region_count + 1,
                          sizeof *writer->entries, &writer->entries, &writer->capacity);
    if (status < 0)
        return status;
    struct vox_part_entry *entry = &writer->entries[header->region_count++];
    *entry = (struct vox_part_entry){.leaf_count = 0};
    memcpy(entry->origin, origin, sizeof entry->origin);
    XXH3_64bits_reset(writer->hash);
    return 0;
}

static uint32_t count_seconds(const struct fmt_nvdb_record *records, uint32_t count)
{
    uint32_t seconds = 0;
    for (uint32_t i = 0; i < count; i++)
        seconds += (records[i].plane & FMT_NVDB_PLANE_SECOND) != 0;
    return seconds;
}

int vox_part_append(void *arg, const struct fmt_nvdb_region *region)
{
    struct vox_part_writer *writer = arg;
    const uint32_t words = writer->words, values = writer->channel_values;
    const struct fmt_nvdb_record *records = region->records, *second = region->second;
    const float *channels = region->channels, *second_channels = region->second_channels;
    int status = bsq_check(writer->plan->base.ctx);
    if (status == 0)
        status = begin_region(writer, region->origin);
    for (uint32_t i = 0; i < region->leaf_count && status == 0; i++) {
        struct vox_part_leaf leaf = {.number = region->leaf_ids[i]};
        memcpy(leaf.mask, region->masks[i], sizeof leaf.mask);
        const uint32_t voxels = vox_part_voxels(&leaf);
        leaf.second_count = count_seconds(records, voxels);
        const uint64_t bytes =
            sizeof leaf + ((uint64_t)voxels + leaf.second_count) * words * sizeof(uint32_t);
        if (writer->fill + bytes > writer->buffer_bytes)
            status = flush(writer);
        put(writer, &leaf, sizeof leaf);
        put_records(writer, records, channels, voxels);
        put_records(writer, second, second_channels, leaf.second_count);
        records += voxels;
        second += leaf.second_count;
        if (values > 0) {
            channels += (uint64_t)voxels * values;
            second_channels += (uint64_t)leaf.second_count * values;
        }
        struct vox_part_entry *entry = &writer->entries[writer->header.region_count - 1];
        entry->bytes += bytes;
        entry->voxels += voxels;
        entry->seconds += leaf.second_count;
        entry->leaf_count++;
    }
    return status;
}

int vox_part_end(struct vox_part_writer *writer, struct vox_part_totals *totals)
{
    struct vox_part_header *header = &writer->header;
    int status = end_region(writer);
    for (uint64_t i = 0; i < header->region_count; i++) {
        header->leaves += writer->entries[i].leaf_count;
        header->voxels += writer->entries[i].voxels;
        header->seconds += writer->entries[i].seconds;
    }
    memcpy(header->index_min, totals->index_min, sizeof header->index_min);
    memcpy(header->index_max, totals->index_max, sizeof header->index_max);
    const uint64_t bytes = header->region_count * sizeof *writer->entries;
    header->table_checksum = XXH3_64bits(writer->entries, bytes);
    header->header_checksum =
        XXH3_64bits(header, offsetof(struct vox_part_header, header_checksum));
    if (status == 0)
        status = bsq_output_write(writer->output, writer->entries, bytes);
    if (status == 0)
        status = bsq_output_write_at(writer->output, header, sizeof *header, 0);
    totals->regions = header->region_count;
    totals->leaves = header->leaves;
    totals->voxels = header->voxels;
    totals->second_records = header->seconds;
    return status;
}
