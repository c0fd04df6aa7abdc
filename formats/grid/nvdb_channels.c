/* nvdb_channels.c - the head of the section of further channels: which channels there are. */
#include <string.h>

#include "base/channels.h"
#include "formats/grid/nvdb_layout_internal.h"

bool fmt_nvdb_check_channels(const uint8_t *file, uint64_t size, uint64_t offset,
                             struct nvdb_counts *counts)
{
    struct nvdb_channels_head head;
    if (offset > size || size - offset < sizeof head)
        return false;
    memcpy(&head, file + offset, sizeof head);
    const uint8_t *list = file + offset + sizeof head;
    const uint64_t bytes = nvdb_channels_head_bytes(head.list_bytes);
    if (size - offset < bytes || head.words == 0 ||
        bsq_channel_list_values((const char *)list, head.list_bytes) != head.words)
        return false;
    for (uint64_t i = head.list_bytes; i < bytes - sizeof head; i++)
        if (list[i] != 0)
            return false;
    counts->channel_words = head.words;
    counts->channel_list_bytes = head.list_bytes;
    return true;
}
