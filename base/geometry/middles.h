/* middles.h - divides things in space for trees of boxes. */
#ifndef BSQ_MIDDLES_H
#define BSQ_MIDDLES_H

#include <stdint.h>

/* Where a thing is, and its number. */
struct bsq_middle {
    float at[3]; /* the middle of its box, times any factor that all have */
    uint32_t number;
};

/* Moves the `first` ones of `count` with the least coordinates on an axis to the front (Hoare,
 * "Algorithm 65: Find", 1961). The order depends on the arguments alone. */
static inline void bsq_select_middles(struct bsq_middle *middles, uint32_t count, uint32_t first,
                                      int axis)
{
    uint32_t begin = 0, end = count;
    while (end - begin > 1) {
        const float pivot = middles[begin + (end - begin) / 2].at[axis];
        uint32_t i = begin, j = end - 1;
        while (i <= j) {
            while (middles[i].at[axis] < pivot)
                i++;
            while (middles[j].at[axis] > pivot)
                j--;
            if (i > j)
                break;
            const struct bsq_middle swapped = middles[i];
            middles[i++] = middles[j];
            middles[j] = swapped;
            if (j-- == 0)
                break;
        }
        if (j != UINT32_MAX && first <= j)
            end = j + 1;
        else if (first >= i)
            begin = i;
        else
            return;
    }
}

#endif
