/* json_bound.c - see json_bound.h.
 *
 * The factors follow from Jansson's structures json_object_t, hashtable_pair, json_array_t and
 * json_string_t. Tables double when they are full, and so does the buffer for the string that is
 * being read. */
#include "base/json_bound.h"

#include <stdbool.h>

uint64_t bsq_json_bound(const char *text, uint64_t size)
{
    uint64_t objects = 0, arrays = 0, members = 0, commas = 0, length = 0, longest = 0;
    bool in_string = false, escaped = false;
    for (uint64_t i = 0; i < size; i++) {
        const char c = text[i];
        if (in_string) {
            in_string = escaped || c != '"';
            escaped = !escaped && c == '\\';
            length++;
            longest = length > longest ? length : longest;
            continue;
        }
        objects += c == '{';
        arrays += c == '[';
        members += c == ':';
        commas += c == ',';
        in_string = c == '"';
        length = 0;
    }
    return 65536 + 256 * objects + 224 * arrays + 224 * members + 112 * commas + size + 4 * longest;
}
