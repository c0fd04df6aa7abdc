/* ids.c - hashes a name (FNV-1a by Fowler, Noll & Vo, 64 bits; mixed as at the end of
 * Appleby's MurmurHash3), and turns the hash into a colour by whole numbers alone. */
#include "base/ids.h"

static uint64_t hash_of(const char *name)
{
    uint64_t h = UINT64_C(0xcbf29ce484222325);
    for (; *name; name++)
        h = (h ^ (unsigned char)*name) * UINT64_C(0x100000001b3);
    h = (h ^ h >> 33) * UINT64_C(0xff51afd7ed558ccd);
    h = (h ^ h >> 33) * UINT64_C(0xc4ceb9fe1a85ec53);
    return h ^ h >> 33;
}

uint32_t bsq_name_id(const char *name)
{
    /* The channels that get the highest, the lowest and the middle value: all six hues. */
    static const uint8_t orders[6][3] = {{0, 1, 2}, {0, 2, 1}, {1, 0, 2},
                                         {1, 2, 0}, {2, 0, 1}, {2, 1, 0}};
    const uint64_t h = hash_of(name);
    const uint32_t high = 160 + (uint32_t)(h & 255) * 96 / 256;
    const uint32_t low = high * (uint32_t)(h >> 8 & 255) * 5 / 2048;
    const uint32_t middle = low + (high - low) * (uint32_t)(h >> 16 & 255) / 256;
    const uint8_t *order = orders[(h >> 24 & 255) * 6 / 256];
    return 0xff000000u | high << 8 * order[0] | low << 8 * order[1] | middle << 8 * order[2];
}

const char *bsq_ids_text(enum bsq_ids ids)
{
    return ids == BSQ_IDS_MATERIAL ? "material" : ids == BSQ_IDS_OBJECT ? "object" : "color";
}
