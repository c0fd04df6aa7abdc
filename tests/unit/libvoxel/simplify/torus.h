/* torus.h - a closed surface that is smooth everywhere, for tests of simplification. */
#ifndef TEST_TORUS_H
#define TEST_TORUS_H

#include <math.h>

#define PI 3.14159265358979323846

/* Sets p to the place of (x, y), both from 0 to 1, on a torus: a tube of radius 1 around a circle
 * of radius 3. */
static inline void on_torus(double x, double y, float *p)
{
    const double r = 3 + cos(2 * PI * y);
    p[0] = (float)(r * cos(2 * PI * x));
    p[1] = (float)(r * sin(2 * PI * x));
    p[2] = (float)sin(2 * PI * y);
}

#endif
