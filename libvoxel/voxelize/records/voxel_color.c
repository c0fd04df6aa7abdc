/* voxel_color.c - tables that replace pow() by a search. A coarse table gives a code that is not
 * too high; the exact boundaries do the rest. */
#include "libvoxel/voxelize/records/voxel_color.h"
#include "base/srgb.h"

#include <math.h>

void vox_color_tables_init(struct vox_color_tables *tables)
{
    for (int i = 0; i < 256; i++)
        tables->to_linear[i] = bsq_srgb_to_linear(i / 255.0);
    for (int i = 0; i < 255; i++)
        tables->boundary[i] = bsq_srgb_to_linear((i + 0.5) / 255.0);
    uint8_t code = 0;
    for (int i = 0; i <= VOX_COLOR_STEPS; i++) {
        while (code < 255 && (double)i / VOX_COLOR_STEPS >= tables->boundary[code])
            code++;
        tables->start[i] = code;
    }
}
