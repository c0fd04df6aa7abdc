/* channels.h - further channels of a scan, such as roughness: their names, and what values mean.
 *
 * A channel is a quantity of the scan's surface that a texture gives, besides its colour. */
#ifndef BSQ_CHANNELS_H
#define BSQ_CHANNELS_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* What is known of a channel by its name. */
struct bsq_channel {
    const char *name; /* "" for names that the table does not have */
    uint32_t values;  /* 1 or 3 */
    bool color;       /* linear light, which files of integers hold sRGB-encoded; else data */
    /* Statements of MTL files: its texture and its value; NULL: none. */
    const char *mtl_map, *mtl_value;
};

/* Returns the row of a name, or that of all other names: three values, data. */
const struct bsq_channel *bsq_channel_find(const char *name);
/* Returns row `number` of the table; NULL after the last. */
const struct bsq_channel *bsq_channel_at(unsigned number);

/* Returns whether a channel can have this name: lower-case letters, digits and underscores, with a
 * letter first. */
bool bsq_is_channel_name(const char *name);

#ifdef __cplusplus
}
#endif
#endif
