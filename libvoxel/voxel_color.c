/* voxel_color.c - encoding by search instead of pow(): a coarse table gives a code that is not too
 * high, the exact boundaries do the rest. */
#include "libvoxel/voxel_color.h"

#include <math.h>

double vox_srgb_to_linear(double srgb)
{
    if (!(srgb > 0.0))
        return 0.0;
    if (srgb >= 1.0)
        return 1.0;
    return srgb <= 0.04045 ? srgb / 12.92 : pow((srgb + 0.055) / 1.055, 2.4);
}

void vox_color_tables_init(struct vox_color_tables *tables)
{
    for (int i = 0; i < 256; i++)
        tables->to_linear[i] = vox_srgb_to_linear(i / 255.0);
    for (int i = 0; i < 255; i++)
        tables->boundary[i] = vox_srgb_to_linear((i + 0.5) / 255.0);
    uint8_t code = 0;
    for (int i = 0; i <= VOX_COLOR_STEPS; i++) {
        while (code < 255 && (double)i / VOX_COLOR_STEPS >= tables->boundary[code])
            code++;
        tables->start[i] = code;
    }
}
