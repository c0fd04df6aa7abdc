/* texture.c - passes the calls of texture.h on to the module bisque-texture.so. */
#include "formats/texture/texture_module.h"

int fmt_textures_open(struct bsq_ctx *ctx, const struct fmt_texture_source *sources, uint32_t count,
                      uint64_t cache_bytes, struct fmt_textures **out)
{
    const struct fmt_module *module;
    int status = fmt_module_open(ctx, "texture", "textures", &module);

    *out = NULL;
    if (status != 0)
        return status;
    return ((const struct fmt_texture_module *)module)
        ->open(&fmt_host_functions, ctx, sources, count, cache_bytes, out);
}

void fmt_textures_close(struct fmt_textures *textures)
{
    if (textures)
        textures->module->close(textures);
}

void fmt_texture_size(const struct fmt_textures *textures, uint32_t image, uint32_t *width,
                      uint32_t *height)
{
    textures->module->size(textures, image, width, height);
}

int fmt_texture_sample(struct fmt_textures *textures, uint32_t image, float u, float v, float du,
                       float dv, float out[3])
{
    return textures->module->sample(textures, image, u, v, du, dv, out);
}
