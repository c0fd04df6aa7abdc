/* surface_parts.h - surfaces of several scans; private to this folder. */
#ifndef BAKE_SURFACE_SURFACE_PARTS_H
#define BAKE_SURFACE_SURFACE_PARTS_H

#include "libbake/surface/surface.h"

/* These do for several scans what the functions of surface.h do for one. */
int bake_surface_open_parts(struct bake_surface *surface, const struct bake_options *options);
void bake_surface_close_parts(struct bake_surface *surface);
int bake_surface_trace_parts(const struct bake_surface *surface, const struct bk_params *params,
                             const struct bake_surface_rays *rays);
uint64_t bake_surface_parts_capacity(const struct bake_surface *surface);

#endif
