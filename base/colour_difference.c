/* colour_difference.c - CIELAB and CIEDE2000. */
#include "base/colour_difference.h"

#include <math.h>

static const double pi = 3.14159265358979323846;

static double lab_curve(double t)
{
    const double d = 6.0 / 29.0;
    return t > d * d * d ? cbrt(t) : t / (3 * d * d) + 4.0 / 29.0;
}

void bsq_lab(const float linear[3], double lab[3])
{
    /* Each row sums to a component of the white point, so that (1, 1, 1) is exactly neutral. */
    static const double to_xyz[3][3] = {{0.4124564, 0.3575761, 0.1804375},
                                        {0.2126729, 0.7151522, 0.0721750},
                                        {0.0193339, 0.1191920, 0.9503041}};
    double f[3];
    for (int i = 0; i < 3; i++) {
        double sum = 0, white = 0;
        for (int k = 0; k < 3; k++) {
            sum += to_xyz[i][k] * (double)linear[k];
            white += to_xyz[i][k];
        }
        f[i] = lab_curve(sum / white);
    }
    lab[0] = 116 * f[1] - 16;
    lab[1] = 500 * (f[0] - f[1]);
    lab[2] = 200 * (f[1] - f[2]);
}

static double hue(double a, double b)
{
    if (a == 0 && b == 0)
        return 0;
    double h = atan2(b, a) * 180 / pi;
    return h < 0 ? h + 360 : h;
}

static double cos_degrees(double angle)
{
    return cos(angle * pi / 180);
}

/* Returns sqrt(C^7 / (C^7 + 25^7)), the weight of the chroma correction. */
static double chroma_weight(double chroma)
{
    const double c2 = chroma * chroma, c7 = c2 * c2 * c2 * chroma;
    return sqrt(c7 / (c7 + 6103515625.0));
}

/* sqrt() is the same on each system; hypot() differs between versions of the C library. */
static double chroma_of(double a, double b)
{
    return sqrt(a * a + b * b);
}

struct polar {
    double c1, c2, h1, h2;
};

static struct polar to_polar(const double a[3], const double b[3])
{
    double chroma = (chroma_of(a[1], a[2]) + chroma_of(b[1], b[2])) / 2;
    double stretch = 1 + 0.5 * (1 - chroma_weight(chroma));
    return (struct polar){chroma_of(stretch * a[1], a[2]), chroma_of(stretch * b[1], b[2]),
                          hue(stretch * a[1], a[2]), hue(stretch * b[1], b[2])};
}

double bsq_ciede2000(const double a[3], const double b[3])
{
    struct polar p = to_polar(a, b);
    int grey = p.c1 * p.c2 == 0;
    double turn = p.h2 - p.h1;
    if (turn > 180)
        turn -= 360;
    else if (turn < -180)
        turn += 360;
    double dl = b[0] - a[0], dc = p.c2 - p.c1;
    double dh = grey ? 0 : 2 * sqrt(p.c1 * p.c2) * sin(turn * pi / 360);
    double l = (a[0] + b[0]) / 2, c = (p.c1 + p.c2) / 2, h = p.h1 + p.h2;
    if (!grey) {
        if (fabs(p.h1 - p.h2) > 180)
            h += h < 360 ? 360 : -360;
        h /= 2;
    }
    double t = 1 - 0.17 * cos_degrees(h - 30) + 0.24 * cos_degrees(2 * h) +
               0.32 * cos_degrees(3 * h + 6) - 0.20 * cos_degrees(4 * h - 63);
    double bend = (h - 275) / 25;
    double rotation = -2 * chroma_weight(c) * sin(60 * exp(-bend * bend) * pi / 180);
    double sl = 1 + 0.015 * (l - 50) * (l - 50) / sqrt(20 + (l - 50) * (l - 50));
    double sc = 1 + 0.045 * c, sh = 1 + 0.015 * c * t;
    double x = dl / sl, y = dc / sc, z = dh / sh;
    return sqrt(fmax(0, x * x + y * y + z * z + rotation * y * z));
}
