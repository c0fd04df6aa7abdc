/* vase.c - the surface, relief and colours of the vase. */
#include "tests/scan/vase.h"

#include <math.h>

/* Control points (radius, height) of the profile, a closed uniform cubic B-spline. They run
 * counterclockwise in the (r, z) plane, so that dp/du x dp/ds points out of the clay. */
static const double profile[][2] = {
    {0.24, 0.00}, {0.33, 0.00}, {0.40, 0.06}, {0.47, 0.20}, {0.53, 0.38}, {0.52, 0.58},
    {0.42, 0.78}, {0.29, 0.94}, {0.25, 1.06}, {0.28, 1.18}, {0.36, 1.25}, {0.37, 1.28},
    {0.33, 1.28}, {0.25, 1.21}, {0.20, 1.08}, {0.23, 0.93}, {0.36, 0.75}, {0.46, 0.57},
    {0.47, 0.38}, {0.41, 0.22}, {0.31, 0.10}, {0.22, 0.06},
};
enum { PROFILE_POINTS = sizeof profile / sizeof *profile };

static const double two_pi = 6.283185307179586476925;

/* Computes the profile curve and its derivative with respect to s. */
static void profile_at(double s, double value[2], double slope[2])
{
    double x = (s - floor(s)) * PROFILE_POINTS;
    int segment = (int)x % PROFILE_POINTS;
    double t = x - floor(x), w = 1 - t;
    double b[4] = {w * w * w / 6, (3 * t * t * t - 6 * t * t + 4) / 6,
                   (3 * w * w * w - 6 * w * w + 4) / 6, t * t * t / 6};
    double d[4] = {-w * w / 2, (3 * t * t - 4 * t) / 2, -(3 * w * w - 4 * w) / 2, t * t / 2};
    for (int axis = 0; axis < 2; axis++) {
        value[axis] = slope[axis] = 0;
        for (int i = 0; i < 4; i++) {
            double c = profile[(segment + i + PROFILE_POINTS - 1) % PROFILE_POINTS][axis];
            value[axis] += b[i] * c;
            slope[axis] += d[i] * c * PROFILE_POINTS;
        }
    }
}

/* Returns 0 below a, 1 above b, and a smooth (C2) transition between. */
static double smooth_step(double a, double b, double x)
{
    double t = fmin(fmax((x - a) / (b - a), 0), 1);
    return t * t * t * (t * (6 * t - 15) + 10);
}

/* Returns 1 inside a band of the outer wall and 0 outside, with smooth borders. */
static double band(double s, double from, double to)
{
    return smooth_step(from, from + 0.02, s) * (1 - smooth_step(to - 0.02, to, s));
}

/* Returns the height of the relief: flutes on the shoulder, diamonds on the belly, tool marks all
 * over. */
static double relief(double u, double s)
{
    double a = two_pi * u;
    s -= floor(s);
    double flutes = band(s, 0.26, 0.37) * 0.008 * cos(28 * a);
    double diamonds = band(s, 0.10, 0.255) * 0.009 * sin(18 * a + 150 * s) * sin(18 * a - 150 * s);
    double marks = 0.0012 * sin(7 * a + two_pi * 60 * s) + 0.0007 * sin(90 * a + two_pi * 23 * s);
    return flutes + diamonds + marks;
}

void vase_body(double u, double s, struct vase_point *out)
{
    double value[2], slope[2], c = cos(two_pi * u), k = sin(two_pi * u);
    profile_at(s, value, slope);
    double length = hypot(slope[0], slope[1]);
    double nr = slope[1] / length, nz = -slope[0] / length;
    out->position[0] = value[0] * c, out->position[1] = value[1], out->position[2] = -value[0] * k;
    out->normal[0] = nr * c, out->normal[1] = nz, out->normal[2] = -nr * k;
}

void vase_position(double u, double s, double position[3])
{
    struct vase_point body;
    vase_body(u, s, &body);
    double h = relief(u, s);
    for (int i = 0; i < 3; i++)
        position[i] = body.position[i] + h * body.normal[i];
}

/* Terracotta with a glazed neck and slip painted into the diamonds. */
void vase_color(double u, double s, double color[3])
{
    static const double clay[3] = {0.72, 0.38, 0.24}, glaze[3] = {0.13, 0.35, 0.42},
                        slip[3] = {0.93, 0.86, 0.70};
    double a = two_pi * u;
    s -= floor(s);
    double edge = 0.004;
    double neck =
        smooth_step(-edge, edge, s - 0.39 + 0.012 * sin(9 * a)) * (1 - smooth_step(0.58, 0.60, s));
    double diamond = band(s, 0.10, 0.255) *
                     smooth_step(0.15, 0.45, sin(18 * a + 150 * s) * sin(18 * a - 150 * s));
    for (int i = 0; i < 3; i++) {
        double c = clay[i] + (slip[i] - clay[i]) * diamond;
        color[i] = c + (glaze[i] - c) * neck;
    }
}

static void cross(const double a[3], const double b[3], double out[3])
{
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

static double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* Computes derivatives of the position by central differences. */
static void derivatives(double u, double s, double du[3], double ds[3])
{
    const double h = 1e-5;
    double a[3], b[3];
    vase_position(u + h, s, a);
    vase_position(u - h, s, b);
    for (int i = 0; i < 3; i++)
        du[i] = (a[i] - b[i]) / (2 * h);
    vase_position(u, s + h, a);
    vase_position(u, s - h, b);
    for (int i = 0; i < 3; i++)
        ds[i] = (a[i] - b[i]) / (2 * h);
}

void vase_surface(double u, double s, struct vase_point *out)
{
    double du[3], ds[3];
    vase_position(u, s, out->position);
    vase_color(u, s, out->color);
    derivatives(u, s, du, ds);
    cross(du, ds, out->normal);
    double length = sqrt(dot(out->normal, out->normal));
    for (int i = 0; i < 3; i++)
        out->normal[i] /= length;
}

int vase_intersect(const double p[3], const double n[3], double *u, double *s, double *t)
{
    *t = 0;
    for (int step = 0; step < 30; step++) {
        double q[3], du[3], ds[3], r[3], c[3];
        vase_position(*u, *s, q);
        for (int i = 0; i < 3; i++)
            r[i] = p[i] + *t * n[i] - q[i];
        if (dot(r, r) < 1e-22)
            return 1;
        /* du a + ds b - n c = r by Cramer's rule. */
        derivatives(*u, *s, du, ds);
        cross(du, ds, c);
        double det = -dot(n, c);
        if (fabs(det) < 1e-9)
            return 0;
        double along = dot(r, c) / det, rn[3], nr[3];
        cross(ds, n, rn);
        cross(n, du, nr);
        *u += -dot(r, rn) / det;
        *s += -dot(r, nr) / det;
        *t += along;
    }
    return 0;
}
