/* vec.h - small vector arithmetic in float and double. */
#ifndef BSQ_VEC_H
#define BSQ_VEC_H

#include <math.h>

struct bsq_vec3 {
    float x, y, z;
};

static inline struct bsq_vec3 bsq_v3(float x, float y, float z)
{
    return (struct bsq_vec3){x, y, z};
}
static inline struct bsq_vec3 bsq_add3(struct bsq_vec3 a, struct bsq_vec3 b)
{
    return bsq_v3(a.x + b.x, a.y + b.y, a.z + b.z);
}
static inline struct bsq_vec3 bsq_sub3(struct bsq_vec3 a, struct bsq_vec3 b)
{
    return bsq_v3(a.x - b.x, a.y - b.y, a.z - b.z);
}
static inline struct bsq_vec3 bsq_scale3(struct bsq_vec3 a, float s)
{
    return bsq_v3(a.x * s, a.y * s, a.z * s);
}
static inline float bsq_dot3(struct bsq_vec3 a, struct bsq_vec3 b)
{
    return a.x * b.x + a.y * b.y + a.z * b.z;
}
static inline struct bsq_vec3 bsq_cross3(struct bsq_vec3 a, struct bsq_vec3 b)
{
    return bsq_v3(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
}
static inline float bsq_length3(struct bsq_vec3 a)
{
    return sqrtf(bsq_dot3(a, a));
}
/* Returns the unit vector, or zero if the length is zero or not finite. */
static inline struct bsq_vec3 bsq_unit3(struct bsq_vec3 a)
{
    float length = bsq_length3(a);
    if (!(length > 0.0f) || !isfinite(length))
        return bsq_v3(0, 0, 0);
    return bsq_scale3(a, 1.0f / length);
}

/* ---- doubles ---- */

static inline double bsq_dotd(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}
static inline void bsq_crossd(const double a[3], const double b[3], double out[3])
{
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

#endif
