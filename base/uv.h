/* uv.h - how a material moves texture coordinates: scale, then offset. */
#ifndef BSQ_UV_H
#define BSQ_UV_H

#include <stdbool.h>

/* All zero: coordinates stay as they are. */
struct bsq_uv {
    bool moves;
    float scale[2], offset[2]; /* u, v; finite; used if `moves` is set */
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
