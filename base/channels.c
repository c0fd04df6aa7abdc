/* channels.c - see channels.h. */
#include "base/channels.h"

#include <string.h>

static const struct bsq_channel channels[] = {
    {"roughness", 1, false},
    {"metallic", 1, false},
    {"sheen", 1, false},
    {"clearcoat", 1, false},
    {"clearcoat_roughness", 1, false},
    {"anisotropy", 1, false},
    {"anisotropy_rotation", 1, false},
    {"shininess", 1, false},
    {"opacity", 1, false},
    {"occlusion", 1, false},
    {"displacement", 1, false},
    {"specular", 3, true},
    {"emission", 3, true},
};
enum { CHANNELS = sizeof channels / sizeof *channels };

const struct bsq_channel *bsq_channel_at(unsigned number)
{
    return number < CHANNELS ? &channels[number] : NULL;
}

const struct bsq_channel *bsq_channel_find(const char *name)
{
    static const struct bsq_channel other = {"", 3, false};
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
