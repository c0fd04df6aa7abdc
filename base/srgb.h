/* srgb.h - the transfer curve of sRGB (IEC 61966-2-1), for tables and reports; clamps to 0..1. */
#ifndef BSQ_SRGB_H
#define BSQ_SRGB_H

#include <math.h>

static inline double bsq_srgb_to_linear(double srgb)
{
    if (!(srgb > 0.0))
        return 0.0;
    if (srgb >= 1.0)
        return 1.0;
    return srgb <= 0.04045 ? srgb / 12.92 : pow((srgb + 0.055) / 1.055, 2.4);
}

static inline double bsq_linear_to_srgb(double linear)
{
    linear = fmin(fmax(linear, 0.0), 1.0);
    return linear <= 0.0031308 ? 12.92 * linear : 1.055 * pow(linear, 1 / 2.4) - 0.055;
}

#endif
