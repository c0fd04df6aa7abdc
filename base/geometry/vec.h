/* vec.h - small vector arithmetic in float and double, unit vectors in 32 bits, and normals with a
 * tangent-space normal map. */
#ifndef BSQ_VEC_H
#define BSQ_VEC_H

#include <math.h>
#include <stdbool.h>
#include <stdint.h>

struct bsq_vec3 {
    float x, y, z;
};

static inline struct bsq_vec3 bsq_v3(float x, float y, float z)
{
    return (struct bsq_vec3){x, y, z};
}
static inline struct bsq_vec3 bsq_load3(const float v[3])
{
    return bsq_v3(v[0], v[1], v[2]);
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

/* ---- unit vectors as two 16-bit numbers (mean error 0.0013 degrees) ----
 *
 * Source: Meyer, Suessmuth, Sussner, Stamminger, Greiner, "On Floating-Point Normal Vectors",
 * EGSR 2010; survey in Cigolle et al., "A Survey of Efficient Representations for Independent Unit
 * Vectors", JCGT 3(2), 2014. */

/* Packs a unit vector: x coordinate of the unfolded octahedron in the low 16 bits, y in the high,
 * each a signed normalised integer in [-32767, 32767] stored in two's complement. */
uint32_t bsq_oct_pack(struct bsq_vec3 unit);
/* Unpacks to a vector of length 1 within float rounding. Any 32-bit value is valid. */
struct bsq_vec3 bsq_oct_unpack(uint32_t packed);

/* ---- normal maps ---- */

/* Replaces a unit normal of a triangle by the one that a texel of a normal map gives. edge: the
 * vectors from the first corner to the others; uv_edge: the same in texture coordinates. The
 * tangent is at right angles to the normal. Red of the map points where u grows on the triangle,
 * green where v does, blue along the normal; samples from 0 to 1 are components from -1 to 1.
 * Returns false, with the normal unchanged, if the texel is black or the triangle has no area in
 * the texture. */
bool bsq_normal_map_apply(const double edge[2][3], const double uv_edge[2][2], const float texel[3],
                          double normal[3]);

#endif
