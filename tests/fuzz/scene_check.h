/* scene_check.h - the part of the fuzz target for Assimp's scenes that is C++. */
#ifndef FUZZ_SCENE_CHECK_H
#define FUZZ_SCENE_CHECK_H

#include "base/context.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Makes a scene from the input, writes it, and checks what was written. Errors: BSQ_EDATA. */
int fuzz_scene(struct bsq_ctx *ctx, const uint8_t *data, size_t size);

#ifdef __cplusplus
}
#endif
#endif
