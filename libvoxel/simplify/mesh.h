/* mesh.h - an indexed mesh in memory. */
#ifndef VOX_SIMPLIFY_MESH_H
#define VOX_SIMPLIFY_MESH_H

#include <math.h>

#include "base/context.h"
#include "base/geometry/vec.h"

/* v A v + 2 b v + c, with A as xx, xy, xz, yy, yz, zz; v is relative to the vertex that has it, so
 * that single precision is enough. */
struct vox_quadric {
    float a[6], b[3], c;
};

/* A mesh whose vertices are welded: no two have the same position. The owner frees it with
 * vox_mesh_free(). */
struct vox_mesh {
    uint32_t vertex_count, triangle_count;
    float (*positions)[3];
    uint32_t (*triangles)[3];
    struct vox_quadric *quadrics; /* of vertices; NULL: not carried */
};

/* Allocates arrays for a mesh in *mesh. Errors: BSQ_ENOMEM; then *mesh is empty. */
int vox_mesh_allocate(struct bsq_ctx *ctx, uint32_t vertices, uint32_t triangles, bool quadrics,
                      struct vox_mesh *mesh);
/* Copies a mesh without its quadrics, with space for more triangles, which are counted already.
 * Errors: BSQ_ENOMEM. */
int vox_mesh_copy(struct bsq_ctx *ctx, const struct vox_mesh *from, uint32_t more,
                  struct vox_mesh *to);
/* Copies a triangle and its material to number `to`, which may be the same. */
void vox_mesh_move_triangle(struct vox_mesh *mesh, uint32_t to, uint32_t from);
void vox_mesh_free(struct bsq_ctx *ctx, struct vox_mesh *mesh);

/* Returns a quadric relative to a place that is `s` away from its own one, in double. */
void vox_quadric_shift(const struct vox_quadric *q, const double s[3], double a[6], double b[3],
                       double *c);

/* Solves A x = b for a positive definite A, by Cholesky's method. Returns false if it is not. */
bool vox_solve(const double a[6], const double b[3], double x[3]);

/* Welds vertices of equal positions and adds up their quadrics; leaves out triangles with two equal
 * corners, and all but one of triangles with the same three corners. Errors: BSQ_ENOMEM. */
int vox_mesh_weld(struct bsq_ctx *ctx, struct vox_mesh *mesh);

/* Closes slits of a welded mesh: adds triangles without area where three open edges enclose one.
 * Sorting leaves such triangles out. Quadrics are not kept then. Errors: BSQ_ENOMEM. */
int vox_mesh_close_slits(struct bsq_ctx *ctx, struct vox_mesh *mesh);

/* Sets the quadric of each vertex to the sum over its triangles, of the squared distance from each
 * one's plane times its area. */
void vox_mesh_set_quadrics(struct vox_mesh *mesh);

/* Mixes all bits, and leaves 0 as it is (Steele, Lea and Flood, "Fast Splittable Pseudorandom
 * Number Generators", 2014). */
static inline uint64_t vox_mix_bits(uint64_t x)
{
    x = (x ^ x >> 30) * UINT64_C(0xbf58476d1ce4e5b9);
    x = (x ^ x >> 27) * UINT64_C(0x94d049bb133111eb);
    return x ^ x >> 31;
}

/* Returns the number of the set that v is in; a set has the number of one of its members. */
static inline uint32_t vox_find_root(uint32_t *parents, uint32_t v)
{
    while (parents[v] != v)
        v = parents[v] = parents[parents[v]];
    return v;
}

/* Sets *normal to twice the area of a triangle times its normal. */
static inline void vox_triangle_normal(const float (*positions)[3], const uint32_t triangle[3],
                                       double normal[3])
{
    const float *a = positions[triangle[0]], *b = positions[triangle[1]],
                *c = positions[triangle[2]];
    const double e[3] = {(double)b[0] - (double)a[0], (double)b[1] - (double)a[1],
                         (double)b[2] - (double)a[2]},
                 f[3] = {(double)c[0] - (double)a[0], (double)c[1] - (double)a[1],
                         (double)c[2] - (double)a[2]};
    normal[0] = e[1] * f[2] - e[2] * f[1];
    normal[1] = e[2] * f[0] - e[0] * f[2];
    normal[2] = e[0] * f[1] - e[1] * f[0];
}

static inline double vox_triangle_area(const float (*positions)[3], const uint32_t triangle[3])
{
    double normal[3];
    vox_triangle_normal(positions, triangle, normal);
    return 0.5 * sqrt(bsq_dotd(normal, normal));
}

#endif
