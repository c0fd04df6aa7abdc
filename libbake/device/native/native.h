/* native.h - the processor as a device: the kernel as C on the calling thread, the reference for
 * all other devices. Takes a job; reads the grid from its mapped file. */
#ifndef BAKE_DEVICE_NATIVE_NATIVE_H
#define BAKE_DEVICE_NATIVE_NATIVE_H

#include "libbake/device/backend/backend.h"

struct bake_places;
struct bake_ray_states;

extern const struct bake_device_kind bake_native_kind;

/* See bake_trace_rays(). */
void bake_native_trace_rays(const struct fmt_nvdb_grid *grid, const struct bk_params *params,
                            const struct bake_ray_batch *rays, struct bk_hit *hits);
/* See bake_trace_places(). */
void bake_native_trace_places(const struct fmt_nvdb_grid *grid, const struct bk_params *params,
                              const struct bake_places *places, uint64_t begin, uint64_t end,
                              struct bake_ray_states *states);

#endif
