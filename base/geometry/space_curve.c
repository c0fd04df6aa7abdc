/* space_curve.c - Hilbert's curve as an automaton, one octant a step. */
#include "base/geometry/space_curve.h"

/* For a state and an octant (x in bit 0): the octant's place on the curve in the low three bits,
 * and above them the state inside that octant. Derived from two levels of Skilling's curve
 * ("Programming the Hilbert curve", 2004). */
static const uint8_t transitions[24][8] = {
    {8, 55, 27, 36, 17, 46, 2, 5},
    {56, 75, 65, 10, 95, 20, 86, 13},
    {32, 99, 119, 12, 1, 18, 110, 21},
    {142, 71, 29, 132, 121, 80, 26, 3},
    {64, 57, 131, 34, 87, 94, 4, 37},
    {156, 31, 51, 144, 45, 6, 42, 105},
    {164, 143, 53, 70, 43, 120, 50, 81},
    {0, 33, 111, 118, 171, 58, 68, 61},
    {16, 47, 9, 54, 139, 60, 66, 69},
    {134, 77, 177, 74, 39, 100, 112, 11},
    {124, 91, 85, 82, 79, 160, 14, 49},
    {188, 93, 83, 90, 135, 38, 176, 113},
    {174, 101, 63, 76, 185, 98, 88, 19},
    {148, 115, 103, 152, 109, 106, 22, 41},
    {180, 117, 175, 62, 107, 114, 184, 89},
    {122, 187, 125, 84, 25, 128, 150, 183},
    {78, 161, 133, 130, 15, 48, 28, 35},
    {30, 7, 145, 104, 141, 172, 138, 67},
    {146, 179, 137, 168, 149, 108, 126, 191},
    {154, 169, 163, 136, 157, 190, 44, 127},
    {162, 129, 165, 182, 155, 24, 52, 151},
    {102, 153, 23, 40, 173, 170, 140, 59},
    {178, 181, 73, 166, 147, 116, 96, 159},
    {186, 189, 123, 92, 97, 158, 72, 167},
};

uint64_t bsq_hilbert_place(const uint32_t cell[3], unsigned bits)
{
    uint64_t place = 0;
    for (unsigned bit = bits, state = 0; bit-- > 0;) {
        const unsigned octant =
            (cell[0] >> bit & 1) | (cell[1] >> bit & 1) << 1 | (cell[2] >> bit & 1) << 2;
        const unsigned entry = transitions[state][octant];
        place = place << 3 | (entry & 7);
        state = entry >> 3;
    }
    return place;
}
