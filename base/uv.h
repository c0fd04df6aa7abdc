/* uv.h - how a material moves texture coordinates: scale, then offset; and what lies beyond its
 * image.
 */
#ifndef BSQ_UV_H
#define BSQ_UV_H

#include <stdbool.h>
#include <stdint.h>

/* Beyond an image it repeats, its border texels do, or it is mirrored at each border. */
enum bsq_wrap { BSQ_WRAP_REPEAT, BSQ_WRAP_CLAMP, BSQ_WRAP_MIRROR, BSQ_WRAPS };

/* All zero: coordinates stay as they are, and the image repeats. */
struct bsq_uv {
    bool moves;
    float scale[2], offset[2]; /* u, v; finite; used if `moves` is set */
    uint8_t wrap[2];           /* enum bsq_wrap, of u and v */
};

static inline float bsq_uv_apply(const struct bsq_uv *uv, int axis, float value)
{
    return uv->moves ? uv->scale[axis] * value + uv->offset[axis] : value;
}

/* Returns the width of something that was `width` wide. */
static inline float bsq_uv_width(const struct bsq_uv *uv, int axis, float width)
{
    const float scale = uv->moves ? uv->scale[axis] : 1.0f;
    return scale < 0 ? -scale * width : scale * width;
}

#endif
