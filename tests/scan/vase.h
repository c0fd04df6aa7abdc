/* vase.h - an analytic scan: a hollow clay vase with carved relief and glaze.
 *
 * A closed profile curve (outer wall, lip, inner wall, foot) turns around the y axis, so the
 * surface is a torus in topology: no poles, thin walls with an inside and an outside. u in [0, 1)
 * runs around the axis, s in [0, 1) along the profile. The relief displaces along the normal of the
 * smooth body; position, normal and colour are known at every point, so that maps can be held
 * against the truth. */
#ifndef SCAN_VASE_H
#define SCAN_VASE_H

struct vase_point {
    double position[3];
    double normal[3]; /* unit, outwards from the clay */
    double color[3];  /* sRGB 0..1 */
};

/* Body without relief (the low mesh lies on it); colour is not set. */
void vase_body(double u, double s, struct vase_point *out);

/* Surface with relief: the scan itself. The normal is that of the displaced surface, from central
 * differences in double (error about 1e-8). */
void vase_surface(double u, double s, struct vase_point *out);

/* Position alone, for generating many vertices. */
void vase_position(double u, double s, double position[3]);
void vase_color(double u, double s, double color[3]);

/* Solves surface(u, s) = p + t n for the crossing next to the starting values in *u, *s (Newton's
 * method on three unknowns). Returns 0 where it does not converge. */
int vase_intersect(const double p[3], const double n[3], double *u, double *s, double *t);

#endif
