/* index_delta_code.c - see index_delta_code.h. */
#include "libvoxel/read/index_delta_code.h"

#include <string.h>

uint64_t vox_index_code_bound(uint64_t count)
{
    return (count + 3) / 4 + 8 * count + INDEX_CODE_SLACK;
}

/* Appends `value` at *to and returns the code of its length. */
static inline unsigned put(uint8_t **to, uint64_t value)
{
    unsigned code = (value > 0xff) + (value > 0xffff) + (value > 0xffffffffu);
    memcpy(*to, &value, 8);
    *to += 1u << code;
    return code;
}

static inline uint64_t get(const uint8_t **from, unsigned code)
{
    static const uint64_t masks[4] = {0xff, 0xffff, 0xffffffffu, UINT64_MAX};
    uint64_t value;
    memcpy(&value, *from, 8);
    *from += 1u << code;
    return value & masks[code];
}

static inline uint64_t zigzag(uint64_t difference)
{
    return difference << 1 ^ (0 - (difference >> 63));
}

static inline uint64_t unzigzag(uint64_t value)
{
    return value >> 1 ^ (0 - (value & 1));
}

uint8_t *vox_index_code_encode(const uint64_t *indices, uint64_t count, uint8_t *to, uint64_t *end,
                               bool *none)
{
    uint8_t *codes = to, *data = to + (count + 3) / 4;
    uint64_t before = 0, largest = 0, any_none = 0, i = 0;
    while (i < count) {
        unsigned bits = 0;
        uint64_t group = count - i < 4 ? count - i : 4;
        for (unsigned k = 0; k < group; k++, i++) {
            uint64_t index = indices[i] + 1; /* FMT_MESH_NONE becomes 0 */
            bits |= put(&data, zigzag(index - before)) << 2 * k;
            largest = index > largest ? index : largest;
            any_none |= index == 0;
            before = index;
        }
        *codes++ = (uint8_t)bits;
    }
    *end = largest;
    *none = any_none != 0;
    return data;
}

const uint8_t *vox_index_code_decode(const uint8_t *from, uint64_t count, uint64_t *indices)
{
    const uint8_t *codes = from, *data = from + (count + 3) / 4;
    uint64_t before = 0, i = 0;
    for (; i + 4 <= count; i += 4) {
        unsigned bits = *codes++;
        for (unsigned k = 0; k < 4; k++) {
            before += unzigzag(get(&data, bits >> 2 * k & 3));
            indices[i + k] = before - 1;
        }
    }
    for (unsigned k = 0; i < count; i++, k++) {
        before += unzigzag(get(&data, *codes >> 2 * k & 3u));
        indices[i] = before - 1;
    }
    return data;
}

uint8_t *vox_index_code_encode_sizes(const uint32_t *sizes, uint64_t count, uint8_t *to)
{
    uint8_t *codes = to, *data = to + (count + 3) / 4;
    memset(codes, 0, (count + 3) / 4);
    for (uint64_t i = 0; i < count; i++)
        codes[i / 4] |= (uint8_t)(put(&data, sizes[i]) << 2 * (i % 4));
    return data;
}

const uint8_t *vox_index_code_decode_sizes(const uint8_t *from, uint64_t count, uint32_t *sizes)
{
    const uint8_t *codes = from, *data = from + (count + 3) / 4;
    for (uint64_t i = 0; i < count; i++)
        sizes[i] = (uint32_t)get(&data, codes[i / 4] >> 2 * (i % 4) & 3u);
    return data;
}
