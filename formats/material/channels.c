/* channels.c - see channels.h. */
#include "formats/material/channels.h"

#include <string.h>

#include "base/text.h"

/* A channel of one value that is no colour, and a colour. */
#define DATA(channel, map, number)                                                                 \
    .name = (channel), .values = 1, .mtl_map = (map), .mtl_value = (number)
#define COLOR(channel, map, number)                                                                \
    .name = (channel), .values = 3, .color = true, .mtl_map = (map), .mtl_value = (number)
#define PBR  "pbrMetallicRoughness"
#define COAT "KHR_materials_clearcoat"

static const struct fmt_channel channels[] = {
    {DATA("roughness", "map_Pr", "Pr"),
     .gltf = {PBR, "metallicRoughnessTexture", "roughnessFactor", 1, 1}},
    {DATA("metallic", "map_Pm", "Pm"),
     .gltf = {PBR, "metallicRoughnessTexture", "metallicFactor", 2, 1}},
    {DATA("sheen", "map_Ps", "Ps")},
    {DATA("clearcoat", "map_Pc", "Pc"),
     .gltf = {COAT, "clearcoatTexture", "clearcoatFactor", 0, 0}},
    {DATA("clearcoat_roughness", "map_Pcr", "Pcr"),
     .gltf = {COAT, "clearcoatRoughnessTexture", "clearcoatRoughnessFactor", 1, 0}},
    {DATA("anisotropy", "map_aniso", "aniso")},
    {DATA("anisotropy_rotation", "map_anisor", "anisor")},
    {DATA("shininess", "map_Ns", NULL)},
    {DATA("opacity", "map_d", "d"), .mtl_inverse = "Tr", .component = FMT_CHANNEL_ALPHA,
     .usual = 1},
    {DATA("occlusion", "map_ao", NULL), .neutral = 1, .gltf = {"", "occlusionTexture", NULL, 0, 1}},
    {DATA("displacement", "disp", NULL)},
    {COLOR("specular", "map_Ks", "Ks")},
    {COLOR("emission", "map_Ke", "Ke"), .gltf = {"", "emissiveTexture", "emissiveFactor", 0, 0}},
    {.name = FMT_CHANNEL_NORMAL_MAP,
     .values = 3,
     .mtl_map = "norm",
     .neutral = 0.5f,
     .gltf = {"", "normalTexture", NULL, 0, 0}},
};
enum { CHANNELS = sizeof channels / sizeof *channels };

const struct fmt_channel *fmt_channel_at(unsigned number)
{
    return number < CHANNELS ? &channels[number] : NULL;
}

/* Finds the row of a name of `length` bytes. */
static const struct fmt_channel *channel_find(const char *name, uint64_t length)
{
    static const struct fmt_channel other = {.name = "", .values = 3};
    for (unsigned i = 0; i < CHANNELS; i++)
        if (strlen(channels[i].name) == length && memcmp(channels[i].name, name, length) == 0)
            return &channels[i];
    return &other;
}

const struct fmt_channel *fmt_channel_find(const char *name)
{
    return channel_find(name, strlen(name));
}

static bool is_name(const char *name, uint64_t length)
{
    bool good = length > 0 && name[0] >= 'a' && name[0] <= 'z';
    for (uint64_t i = 1; i < length && good; i++)
        good = (name[i] >= 'a' && name[i] <= 'z') || (name[i] >= '0' && name[i] <= '9') ||
               name[i] == '_';
    return good;
}

bool fmt_is_channel_name(const char *name)
{
    return is_name(name, strlen(name));
}

bool fmt_is_map_name(const char *name)
{
    static const char *const names[] = {"normal",     "color", "mask",    "height",    "position",
                                        "curvature",  "ao",    "bent",    "thickness", "id",
                                        "confidence", "all",   "transfer"};
    for (size_t i = 0; i < sizeof names / sizeof *names; i++)
        if (strcmp(names[i], name) == 0)
            return true;
    return false;
}

/* Returns the length of the name at the start of the rest of a list. */
static uint64_t channel_name_length(const char *rest, uint64_t bytes)
{
    const char *comma = memchr(rest, ',', bytes);
    return comma ? (uint64_t)(comma - rest) : bytes;
}

uint32_t fmt_channel_list_values(const char *list, uint64_t bytes)
{
    uint32_t values = 0;
    for (uint64_t at = 0; at <= bytes;) {
        const uint64_t length = channel_name_length(list + at, bytes - at);
        values += channel_find(list + at, length)->values;
        if (!is_name(list + at, length) || values > FMT_CHANNEL_VALUES_MAX)
            return 0;
        at += length + 1;
    }
    return values;
}

int fmt_channel_list_split(struct bsq_ctx *ctx, const char *list, uint64_t bytes, char ***names,
                           uint32_t *count)
{
    uint64_t most = 1;
    for (uint64_t i = 0; i < bytes; i++)
        most += list[i] == ',';
    *count = 0;
    BSQ_PASS(bsq_calloc(ctx, "names of channels", most * sizeof **names + bytes + 1, 1, names));
    char *rest = (char *)(*names + most);
    memcpy(rest, list, bytes);
    while (rest)
        (*names)[(*count)++] = strsep(&rest, ",");
    return 0;
}

const struct fmt_channel *fmt_channel_list_find(const char *list, uint64_t bytes, const char *name,
                                                uint32_t *first)
{
    *first = 0;
    for (uint64_t at = 0; at <= bytes;) {
        const uint64_t length = channel_name_length(list + at, bytes - at);
        const struct fmt_channel *channel = channel_find(list + at, length);
        if (length == strlen(name) && memcmp(list + at, name, length) == 0)
            return channel;
        *first += channel->values;
        at += length + 1;
    }
    return NULL;
}

/* ---- ids ----
 *
 * Hashes a name (FNV-1a by Fowler, Noll & Vo, 64 bits; mixed as at the end of Appleby's
 * MurmurHash3), and turns the hash into a colour by whole numbers alone. */

static uint64_t hash_of(const char *name)
{
    uint64_t h = bsq_text_hash(BSQ_HASH_START, name, strlen(name));
    h = (h ^ h >> 33) * UINT64_C(0xff51afd7ed558ccd);
    h = (h ^ h >> 33) * UINT64_C(0xc4ceb9fe1a85ec53);
    return h ^ h >> 33;
}

uint32_t fmt_name_id(const char *name)
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

const char *fmt_ids_text(enum fmt_ids ids)
{
    return ids == FMT_IDS_MATERIAL ? "material" : ids == FMT_IDS_OBJECT ? "object" : "color";
}
