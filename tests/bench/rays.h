/* rays.h - the rays of a map, for benchmarks of tracing. */
#ifndef BENCH_RAYS_H
#define BENCH_RAYS_H

#include "libbake/device/device.h"
#include "libbake/raster/raster.h"
#include "libbake/surface/surface.h"

/* A low-poly mesh and a grid, prepared as by bisque-bake with default options. */
struct rays_scene {
    struct bsq_ctx *ctx;
    struct bake_surface surface;
    struct bake_lowmesh mesh;
    struct bake_raster *raster;
    struct bk_triangle *triangles;
    struct bake_scene job;
    uint32_t patch_side, patch_count, samples;
};

/* Opens the files. size: side of the map in texels. Errors: those of bake_run(). Close *out also
 * after a failure. */
int rays_open(struct bsq_ctx *ctx, const char *scan, const char *mesh, uint32_t size,
              uint32_t samples, struct rays_scene *out);
void rays_close(struct rays_scene *scene);

struct rays_patch {
    unsigned worker;
    struct bk_patch patch;
    const uint32_t *sample_triangles;
    float *texels; /* scratch for the patch */
};
/* Calls fn for each patch, on all threads. Stops at the first failure, and returns it. */
int rays_for_patches(struct rays_scene *scene, int (*fn)(void *arg, const struct rays_patch *patch),
                     void *arg);

/* Returns the processor time that all threads took until now. */
double rays_seconds(void);

/* Returns the median of values, and sorts them. */
double rays_median(double *values, unsigned count);

/* Traces all rays on an open device. *seconds: of the processor. */
int rays_trace(struct rays_scene *scene, struct bake_device *device, double *seconds);

/* ---- rays that any hit ends, with Embree ---- */

struct rays_occluder;
/* Builds the tree of the scan's triangles, in index space. Close *out also after a failure. */
int rays_occluder_open(const struct rays_scene *scene, const char *tris,
                       struct rays_occluder **out);
void rays_occluder_close(struct rays_occluder *occluder); /* NULL is allowed */
/* Ways to trace: one by one, in packets, and in streams of many. */
enum rays_way { RAYS_SINGLE, RAYS_BY_4, RAYS_BY_8, RAYS_BY_16, RAYS_STREAM, RAYS_WAYS };

/* Returns whether Embree has this way on this processor. */
bool rays_can_occlude(const struct rays_occluder *occluder, enum rays_way way);

/* Returns how many rays meet a triangle within `limit`. A ray is its origin and its unit
 * direction. */
uint64_t rays_occlude(const struct rays_occluder *occluder, enum rays_way way,
                      const float (*rays)[6], uint64_t count, float limit);

#endif
