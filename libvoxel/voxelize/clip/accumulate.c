/* accumulate.c - what the fragments of triangles have in common; accumulate_lanes.c adds them.
 *
 * What is linear over a triangle is interpolated at a fragment's centroid, which gives the
 * fragment's mean exactly (shade_lanes.h). A texture is averaged over the fragment's extent
 * instead. */
#include "libvoxel/voxelize/clip/fragment_block.h"

#include <string.h>

uint64_t vox_fragment_block_bytes(void)
{
    return sizeof(struct vox_fragment_block);
}

/* ---- materials ---- */

/* Sets the channels of a material. */
static void set_channels(struct vox_shading *shading, uint32_t material)
{
    double *to = shading->channels + (uint64_t)material * shading->channel_words;
    for (uint32_t a = FMT_SHADING_CHANNELS; a < shading->scan.attribute_count; a++) {
        const struct fmt_attribute *attribute = &shading->scan.attributes[a];
        for (uint32_t k = 0; k < attribute->row->values; k++)
            *to++ = (double)attribute->sources[material].value[k];
    }
}

int vox_shading_prepare(struct vox_shading *shading)
{
    const struct fmt_shading *scan = &shading->scan;
    const uint32_t materials = scan->header->material_count;
    vox_color_tables_init(&shading->tables);
    for (uint32_t a = FMT_SHADING_CHANNELS; a < scan->attribute_count; a++)
        shading->channel_words += scan->attributes[a].row->values;
    if (shading->channel_words > 0)
        BSQ_PASS(bsq_alloc(scan->ctx, "channels", materials + UINT64_C(1),
                           shading->channel_words * sizeof *shading->channels, &shading->channels));
    if (scan->textures)
        BSQ_PASS(BSQ_CALLOC(scan->ctx, "textured materials", materials + UINT64_C(1),
                            &shading->textured));
    for (uint64_t m = 0; m <= materials; m++) {
        if (shading->channels)
            set_channels(shading, (uint32_t)m);
        for (uint32_t a = 0; shading->textured && a < scan->attribute_count; a++)
            shading->textured[m] |= fmt_shading_is_textured(scan, a, (uint32_t)m);
    }
    return 0;
}

void vox_shading_free(struct vox_shading *shading)
{
    if (shading->scan.ctx) {
        BSQ_FREE(shading->scan.ctx, shading->channels, shading->textured);
    }
    shading->channels = NULL;
    shading->textured = NULL;
    fmt_shading_close(&shading->scan);
}

/* ---- triangles ---- */

bool vox_shade_corners(const struct vox_shading *shading, const struct fmt_tris_chunk *chunk,
                       uint32_t triangle, double rgb[3][3])
{
    const uint32_t *v = chunk->triangles[triangle];
    const double *diffuse =
        fmt_shading_diffuse(&shading->scan, fmt_shading_material(&shading->scan, chunk, triangle));
    if (!chunk->colors && !diffuse) {
        memset(rgb, 0, sizeof(double[3][3]));
        return false;
    }
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++)
            rgb[i][k] = chunk->colors
                            ? shading->tables.to_linear[chunk->colors[v[i]] >> (8 * k) & 0xff]
                            : diffuse[k];
    return true;
}

/* Sets the further channels of a fragment. */
static int shade_channels(const struct fmt_shading *scan,
                          const struct fmt_shading_footprint *footprint, double *out)
{
    for (uint32_t a = FMT_SHADING_CHANNELS; a < scan->attribute_count; a++) {
        float values[3] = {0};
        BSQ_PASS(fmt_shade_attribute(scan, a, footprint, values));
        for (uint32_t k = 0; k < scan->attributes[a].row->values; k++)
            *out++ = (double)values[k];
    }
    return 0;
}

int vox_shade_textures(const struct fmt_shading *scan,
                       const struct fmt_shading_footprint *footprint, double *rgb, double *channels,
                       float *texel)
{
    float color[3];
    if (rgb) {
        BSQ_PASS(fmt_shade_attribute(scan, FMT_SHADING_COLOR, footprint, color));
        for (int k = 0; k < 3; k++)
            rgb[k] = (double)color[k];
    }
    if (channels)
        BSQ_PASS(shade_channels(scan, footprint, channels));
    if (texel)
        return fmt_shade_attribute(scan, FMT_SHADING_NORMAL_MAP, footprint, texel);
    return 0;
}
