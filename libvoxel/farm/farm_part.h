/* farm_part.h - the layout of part files; private to this folder. See FORMATS.md. */
#ifndef VOX_FARM_FARM_PART_H
#define VOX_FARM_FARM_PART_H

#include "libvoxel/farm/farm.h"

/* Structures are copied to and from the file as they are. */
_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "the host must be little-endian");

/* Member `own` of the head: what records have beside normal and plane. */
enum { VOX_PART_COLORS = 1, VOX_PART_IDS = 2, VOX_PART_CHANNELS = 4 };

struct vox_part_header {
    struct fmt_farm_part_head head;
    uint64_t region_count;
    uint64_t leaves, voxels, seconds; /* of all regions */
    int32_t index_min[3], index_max[3];
    uint64_t table_checksum;
    uint64_t header_checksum; /* of all bytes before this field */
};
_Static_assert(sizeof(struct vox_part_header) == 112, "the header has no padding");

/* A region. Their bytes follow each other in the order of the table. */
struct vox_part_entry {
    int32_t origin[3]; /* index of its first voxel */
    uint32_t leaf_count;
    uint64_t bytes;
    uint64_t voxels, seconds;
    uint64_t checksum; /* of its bytes */
};
_Static_assert(sizeof(struct vox_part_entry) == 48, "the entry has no padding");

/* A leaf. The records of its voxels follow, then its second records. */
struct vox_part_leaf {
    uint32_t number; /* as leaf_ids of struct fmt_nvdb_region */
    uint32_t second_count;
    uint64_t mask[8];
};
_Static_assert(sizeof(struct vox_part_leaf) == 72, "the leaf has no padding");

/* Returns the member `own` of the parts of a plan. */
uint32_t vox_part_flags(const struct vox_farm_plan *plan, bool has_color, bool has_ids);
/* Returns the 32-bit numbers of a record, those values included. */
uint32_t vox_part_words(const struct vox_farm_plan *plan, uint32_t flags);

/* Returns the size in bytes of a buffer that holds any leaf, if a record is `words` numbers. */
static inline uint64_t vox_part_buffer_bytes(uint32_t words)
{
    const uint64_t least = UINT64_C(256) << 10,
                   leaf = sizeof(struct vox_part_leaf) + UINT64_C(2) * 512 * words * sizeof words;
    return leaf < least ? least : leaf;
}

static inline uint32_t vox_part_voxels(const struct vox_part_leaf *leaf)
{
    uint32_t voxels = 0;
    for (int i = 0; i < 8; i++)
        voxels += (uint32_t)__builtin_popcountll(leaf->mask[i]);
    return voxels;
}

#endif
