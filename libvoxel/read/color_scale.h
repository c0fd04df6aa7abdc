/* color_scale.h - finds the scale of vertex colours: from 0 to 1, or from 0 to 255.
 *
 * OBJ files, and PLY files with real numbers, do not say it. All colours of a file vote, so the
 * result depends neither on their order nor on how a file is packed. */
#ifndef VOX_READ_COLOR_SCALE_H
#define VOX_READ_COLOR_SCALE_H

#include <stdint.h>

/* Numbers of colours that have some such component. All zero at first. */
struct color_votes {
    uint64_t nonzero;    /* above 0 */
    uint64_t fractional; /* above 0 and at most COLOR_BRIGHT, but not whole */
    uint64_t large;      /* above COLOR_UNIT */
    uint64_t bright;     /* above COLOR_BRIGHT */
};

/* Some programs write values from 0 to 1 with bright spots above that. */
#define COLOR_UNIT   2.0f
#define COLOR_BRIGHT 16.0f

/* Adds colours to the votes. Those of vertices without a colour have no component above 0. */
void vox_color_votes_add(struct color_votes *votes, const float (*colors)[3], uint64_t count);

/* Returns the factor from the colours to 0..255: 255 or 1. Returns 0 if they do not tell: all are
 * whole numbers up to COLOR_UNIT so far. */
float vox_color_votes_scale(const struct color_votes *votes);

#endif
