/* texture_module.h - the table of the module bisque-texture.so, which reads images by OpenImageIO.
 */
#ifndef FMT_TEXTURE_TEXTURE_MODULE_H
#define FMT_TEXTURE_TEXTURE_MODULE_H

#include "formats/module/module.h"
#include "formats/texture/texture.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Images of files as the host sees them; the module derives its own struct from this one. */
struct fmt_texture_images {
    const struct fmt_texture_module *module;
};

/* Functions do the work of their namesakes in texture.h, for textures of one file. */
struct fmt_texture_module {
    struct fmt_module module;
    int (*open)(const struct fmt_host *host, struct bsq_ctx *ctx,
                const struct fmt_texture_source *sources, uint32_t count, uint64_t cache_bytes,
                struct fmt_texture_images **out);
    void (*close)(struct fmt_texture_images *textures);
    void (*size)(const struct fmt_texture_images *textures, uint32_t image, uint32_t *width,
                 uint32_t *height);
    bool (*has_alpha)(const struct fmt_texture_images *textures, uint32_t image);
    /* Returns the number of texels of an image that are not finite, and sets the path of its file.
     * Later calls for the same file return 0. */
    uint64_t (*take_broken)(struct fmt_texture_images *textures, uint32_t image, const char **path);
    int (*sample)(struct fmt_texture_images *textures, uint32_t image, float u, float v, float du,
                  float dv, float out[3]);
};

#ifdef __cplusplus
}
#endif
#endif
