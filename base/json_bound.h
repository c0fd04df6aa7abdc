/* json_bound.h - what the parser of JSON may allocate, which it takes from the system. */
#ifndef BSQ_JSON_BOUND_H
#define BSQ_JSON_BOUND_H

#include <stdint.h>

/* Returns a bound of the bytes that Jansson 2 needs for a text of `size` bytes, with the system's
 * overhead of each block. Reserve them before parsing. */
uint64_t bsq_json_bound(const char *text, uint64_t size);

#endif
