/* voxel_color.h - converts between 8-bit sRGB and linear light (IEC 61966-2-1). */
#ifndef VOX_VOXELIZE_RECORDS_VOXEL_COLOR_H
#define VOX_VOXELIZE_RECORDS_VOXEL_COLOR_H

#include <stdint.h>

enum { VOX_COLOR_STEPS = 4096 };

struct vox_color_tables {
    double to_linear[256];
    double boundary[255]; /* linear value of the sRGB value halfway between codes i and i + 1 */
    uint8_t start[VOX_COLOR_STEPS + 1]; /* code of the linear value i / VOX_COLOR_STEPS */
};

void vox_color_tables_init(struct vox_color_tables *tables);

/* Returns the nearest 8-bit sRGB code of a linear value. Values outside of [0, 1] are clamped; NaN
 * gives 0. */
static inline uint32_t vox_color_encode(const struct vox_color_tables *t, double linear)
{
    if (!(linear > 0.0))
        return 0;
    if (linear >= 1.0)
        return 255;
    uint32_t code = t->start[(uint32_t)(linear * VOX_COLOR_STEPS)];
    while (code < 255 && linear >= t->boundary[code])
        code++;
    return code;
}

#endif
