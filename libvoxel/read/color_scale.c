/* color_scale.c - counts what tells the scale of vertex colours. */
#include "libvoxel/read/color_scale.h"

/* A damaged value in a thousand colours must not turn a scan black. */
enum { FRACTIONAL_PER_BRIGHT = 1000 };

/* Returns whether a component is a fraction above 0 and at most COLOR_BRIGHT. */
static uint32_t is_fractional(float value)
{
    value = value > 0.0f ? value : 0.0f;
    value = value < COLOR_BRIGHT ? value : COLOR_BRIGHT;
    return value != (float)(int32_t)value;
}

void vox_color_votes_add(struct color_votes *votes, const float (*colors)[3], uint64_t count)
{
    enum { RUN = 1 << 16 }; /* whose numbers fit in 32 bits, for vector instructions */
    while (count > 0) {
        const uint32_t run = count < RUN ? (uint32_t)count : RUN;
        uint32_t nonzero = 0, fractional = 0, large = 0, bright = 0;
        for (uint32_t v = 0; v < run; v++) {
            const float r = colors[v][0], g = colors[v][1], b = colors[v][2];
            const float of_two = r > g ? r : g, most = of_two > b ? of_two : b;
            nonzero += most > 0.0f;
            large += most > COLOR_UNIT;
            bright += most > COLOR_BRIGHT;
            fractional += is_fractional(r) | is_fractional(g) | is_fractional(b);
        }
        votes->nonzero += nonzero;
        votes->large += large;
        votes->bright += bright;
        votes->fractional += fractional;
        colors += run;
        count -= run;
    }
}

/* Bytes are whole, so any whole value above 2 is one. Among fractions, values above 2 are bright
 * spots of colours from 0 to 1, unless many are too large for that. */
float vox_color_votes_scale(const struct color_votes *votes)
{
    if (votes->fractional == 0)
        return votes->large > 0 ? 1.0f : 0.0f;
    return votes->bright > votes->fractional / FRACTIONAL_PER_BRIGHT ? 1.0f : 255.0f;
}
