/* glyphs.h - a 5 x 7 dot font for the legends of charts: digits, signs and letters. */
#ifndef BAKE_COMPARE_GLYPHS_H
#define BAKE_COMPARE_GLYPHS_H

#include <stdint.h>

enum { BAKE_GLYPH_WIDTH = 5, BAKE_GLYPH_HEIGHT = 7 };

/* Seven rows from the top, five bits each, the leftmost dot in bit 4. Characters without a glyph
 * are blank. */
const uint8_t *bake_glyph(char character);

#endif
