/* vase.h - an analytic scan: a hollow clay vase with carved relief and glaze.
 *
 * A closed profile curve (outer wall, lip, inner wall, foot) revolves around the y axis. So the
 * surface is topologically a torus: it has no poles, and thin walls with an inside and an outside.
 * u in [0, 1) runs around the axis, s in [0, 1) along the profile. The relief displaces the smooth
 * body along its normal. Position, normal and colour are known at every point, so that maps can be
 * checked against them. */
#ifndef SCAN_VASE_H
#define SCAN_VASE_H

struct vase_point {
    double position[3];
    double normal[3]; /* unit, outwards from the clay */
    double color[3];  /* sRGB 0..1 */
};

/* Computes a point of the body without relief, on which the low-poly mesh lies. Sets no colour. */
void vase_body(double u, double s, struct vase_point *out);

/* Computes a point of the surface with relief, the scan. The normal of the displaced surface comes
 * from central differences in double (error about 1e-8). */
void vase_surface(double u, double s, struct vase_point *out);

/* Compute the position or the colour of a point of the scan alone. */
void vase_position(double u, double s, double position[3]);
void vase_color(double u, double s, double color[3]);

/* Solves surface(u, s) = p + t n for the crossing near the starting values in *u and *s, with
 * Newton's method. Returns 0 if it does not converge. */
int vase_intersect(const double p[3], const double n[3], double *u, double *s, double *t);

#endif
