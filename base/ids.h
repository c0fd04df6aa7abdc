/* ids.h - ids of the regions of a scan: what they tell apart, and the colour of a name. */
#ifndef BSQ_IDS_H
#define BSQ_IDS_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* What ids tell apart. Files store these numbers. */
enum bsq_ids {
    BSQ_IDS_NONE,     /* there are no ids */
    BSQ_IDS_MATERIAL, /* materials, by name */
    BSQ_IDS_OBJECT,   /* objects and groups, by name */
    BSQ_IDS_COLOR     /* vertex colours */
};

/* Returns "material", "object" or "color". */
const char *bsq_ids_text(enum bsq_ids ids);

/* Returns the id of a name, a colour that depends on its bytes alone: red in bits 0-7, green in
 * 8-15, blue in 16-23, 255 in 24-31. It is never black. formats/FORMATS.md has the formula. */
uint32_t bsq_name_id(const char *name);

#ifdef __cplusplus
}
#endif
#endif
