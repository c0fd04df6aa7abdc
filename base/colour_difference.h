/* colour_difference.h - how different two colours look. */
#ifndef BSQ_COLOUR_DIFFERENCE_H
#define BSQ_COLOUR_DIFFERENCE_H

/* Converts a linear Rec. 709 colour to CIELAB under D65 (IEC 61966-2-1, CIE 15). */
void bsq_lab(const float linear[3], double lab[3]);

/* Returns the CIEDE2000 difference of two CIELAB colours (CIE 142; Sharma, Wu & Dalal, "The
 * CIEDE2000 Color-Difference Formula: Implementation Notes", 2005). About 1 is just noticeable. */
double bsq_ciede2000(const double a[3], const double b[3]);

#endif
