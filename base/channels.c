/* channels.c - see channels.h. */
#include "base/channels.h"

#include <string.h>

static const struct bsq_channel channels[] = {
    {"roughness", 1, false, "map_Pr", "Pr"},
    {"metallic", 1, false, "map_Pm", "Pm"},
    {"sheen", 1, false, "map_Ps", "Ps"},
    {"clearcoat", 1, false, "map_Pc", "Pc"},
    {"clearcoat_roughness", 1, false, "map_Pcr", "Pcr"},
    {"anisotropy", 1, false, "map_aniso", "aniso"},
    {"anisotropy_rotation", 1, false, "map_anisor", "anisor"},
    {"shininess", 1, false, "map_Ns", NULL},
    {"opacity", 1, false, "map_d", "d"},
    {"occlusion", 1, false, "map_ao", NULL},
    {"displacement", 1, false, "disp", NULL},
    {"specular", 3, true, "map_Ks", "Ks"},
    {"emission", 3, true, "map_Ke", "Ke"},
};
enum { CHANNELS = sizeof channels / sizeof *channels };

const struct bsq_channel *bsq_channel_at(unsigned number)
{
    return number < CHANNELS ? &channels[number] : NULL;
}

const struct bsq_channel *bsq_channel_find(const char *name)
{
    static const struct bsq_channel other = {"", 3, false, NULL, NULL};
    for (unsigned i = 0; i < CHANNELS; i++)
        if (strcmp(channels[i].name, name) == 0)
            return &channels[i];
    return &other;
}

bool bsq_is_channel_name(const char *name)
{
    const char *letters = "abcdefghijklmnopqrstuvwxyz";
    return *name != '\0' && strchr(letters, *name) &&
           name[strspn(name, "abcdefghijklmnopqrstuvwxyz0123456789_")] == '\0';
}
