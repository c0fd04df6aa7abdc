/* colour_difference.h - how different two colours look. */
#ifndef BAKE_COMPARE_COLOUR_DIFFERENCE_H
#define BAKE_COMPARE_COLOUR_DIFFERENCE_H

/* CIELAB under D65 of a linear Rec. 709 colour (IEC 61966-2-1, CIE 15). */
void bake_lab(const float linear[3], double lab[3]);

/* CIEDE2000 difference of two CIELAB colours (CIE 142; Sharma, Wu & Dalal, "The CIEDE2000
 * Color-Difference Formula: Implementation Notes", 2005). About 1 is just noticeable. */
double bake_ciede2000(const double a[3], const double b[3]);

#endif
