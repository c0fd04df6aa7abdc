/* native.h - the processor as a device: the kernel as C on the calling thread, the reference for
 * all other devices. Takes a job; reads the grid from its mapped file. */
#ifndef BAKE_DEVICE_NATIVE_NATIVE_H
#define BAKE_DEVICE_NATIVE_NATIVE_H

#include "libbake/device/backend/backend.h"

struct bake_viewpoints;
struct bake_ray_states;

extern const struct bake_device_kind bake_native_kind;

/* Traces rays on the calling thread, with the widest lanes of the processor. A ray without
 * direction has no hit. params: flags and maps. */
void bake_trace_rays(const struct fmt_nvdb_grid *grid, const struct bk_params *params,
                     const struct bake_ray_batch *rays, struct bk_hit *hits);

/* Traces the rays of viewpoints begin to end - 1 on the calling thread, and notes in their states
 * what the grid adds to other parts of the surface. params: maps, counts and lengths of rays. */
void bake_trace_viewpoints(const struct fmt_nvdb_grid *grid, const struct bk_params *params,
                           const struct bake_viewpoints *viewpoints, uint64_t begin, uint64_t end,
                           struct bake_ray_states *states);

#endif
