/* exr_header.h - the limits that the header of an OpenEXR file must keep.
 *
 * OpenEXR and OpenImageIO sort channels and attributes one by one, so a small file with very many
 * takes minutes, and they allocate what the header holds outside of the budget. This is checked
 * before they open a file. It calls nothing else, because a module links it too. */
#ifndef FMT_EXR_HEADER_H
#define FMT_EXR_HEADER_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Reads up to `size` bytes at `offset`. Returns how many; fewer at the end or after a failure. */
typedef uint64_t (*fmt_exr_read_at)(void *arg, uint64_t offset, void *to, uint64_t size);

/* Returns what is too much in a header, for a message after the file's name. Returns NULL if
 * nothing is, or if this is no header at all: OpenEXR says what is wrong with it. */
const char *fmt_exr_header_excess(fmt_exr_read_at read, void *arg);

#ifdef __cplusplus
}
#endif
#endif
