/* stream_pager.h - private to the sorter: elements of a column in a file, through a cache of pages.
 *
 * Fast while accesses have some locality, as in scans whose faces follow their vertices. The caller
 * watches pager.bytes_read to learn that they have none. */
#ifndef VOX_READ_STREAM_PAGER_H
#define VOX_READ_STREAM_PAGER_H

#include "libvoxel/read/attribute_stream.h"

#define PAGER_SHIFT 12 /* elements of a page, as a power of two */
#define PAGER_NONE  UINT32_MAX

struct pager {
    const struct column *column;
    uint64_t page_count, frame_count, hand;
    uint32_t *frame_of; /* for each page, or PAGER_NONE */
    uint64_t *page_of;  /* for each frame, or UINT64_MAX */
    bool *touched;      /* since the hand passed */
    uint8_t *frames;
    uint64_t bytes_read;
};

/* Takes about `bytes` of memory, at least two pages. */
int vox_pager_open(struct pager *pager, const struct column *column, uint64_t bytes);
void vox_pager_close(struct pager *pager);

/* Loads a page that is not in memory. */
int vox_pager_load(struct pager *pager, uint64_t page);

/* The element, valid until the next call. */
static inline int pager_get(struct pager *pager, uint64_t index, const uint8_t **out)
{
    uint64_t page = index >> PAGER_SHIFT;
    if (pager->frame_of[page] == PAGER_NONE) {
        int status = vox_pager_load(pager, page);
        if (status < 0)
            return status;
    }
    uint64_t frame = pager->frame_of[page];
    pager->touched[frame] = true;
    *out = pager->frames + ((frame << PAGER_SHIFT) + (index & ((1u << PAGER_SHIFT) - 1))) *
                               pager->column->element_bytes;
    return 0;
}

#endif
