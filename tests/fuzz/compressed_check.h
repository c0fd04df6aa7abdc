/* compressed_check.h - the decoders of the program bisque-gltf, for their fuzz target. */
#ifndef TESTS_FUZZ_COMPRESSED_CHECK_H
#define TESTS_FUZZ_COMPRESSED_CHECK_H

#include "formats/mesh/gltf_task.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Both return NULL, or what is wrong. */
const char *decode_view(const struct gltf_packed *view, const uint8_t *from, uint8_t *to);
const char *decode_compressed_mesh(const struct gltf_packed *mesh, const uint8_t *from,
                                   uint8_t *to);

#ifdef __cplusplus
}
#endif
#endif
