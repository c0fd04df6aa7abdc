/* native.h - the processor as a device: the kernel as C on the calling thread, the reference for
 * all other devices. Takes a job; reads the grid from its mapped file. */
#ifndef BAKE_DEVICE_NATIVE_NATIVE_H
#define BAKE_DEVICE_NATIVE_NATIVE_H

#include "libbake/device/scene/scene.h"
#include "libbake/ray/ray.h"

struct bake_native;

/* Prepares to trace a job's patches. Errors: BSQ_ENOMEM. */
int bake_native_open(struct bsq_ctx *ctx, const struct bake_scene *scene, struct bake_native **out);
void bake_native_close(struct bake_native *native); /* NULL is allowed */

/* Does what bake_device_trace() does, on the calling thread. Errors: BSQ_EINTR. */
int bake_native_trace(struct bake_native *native, const struct bk_patch *patch,
                      const uint32_t *sample_triangles, float *texels, unsigned worker);

/* Describes the processor as a device. */
struct bake_device_info bake_native_describe(const struct bsq_ctx *ctx);

/* Traces rays begin to end - 1 of a batch on the calling thread, with the widest lanes of the
 * processor. The rays are in index space, whose unit is given in world units, as t is. Surfaces
 * that face the other way count if params->flags has BK_TWO_SIDED, which turns their normals round.
 * Of a batch with a gap, hits within BK_NEXT_SHEET voxels of t = 0 do not count. params: flags and
 * maps. */
void bake_trace_rays(const struct fmt_nvdb_grid *grid, const struct bk_params *params, double unit,
                     const struct bake_ray_batch *batch, uint64_t begin, uint64_t end);

/* Memory of the workers that trace secondary rays. */
struct bake_tree_stream;
struct bake_native_workers {
    struct bake_tree_stream *streams;
    float *results; /* results_each for each worker */
    uint64_t results_each;
};

/* Allocates memory for bsq_threads() workers that trace the rays that params ask for. The caller
 * frees it, also after a failure. Errors: BSQ_ENOMEM. */
int bake_native_workers_create(struct bsq_ctx *ctx, const struct bk_params *params,
                               struct bake_native_workers *out);
void bake_native_workers_free(struct bsq_ctx *ctx, struct bake_native_workers *workers);

/* Traces the rays of viewpoints begin to end - 1 on the calling thread, and notes in their states
 * what the grid adds to other parts of the surface. tree: of the grid. params: maps, counts and
 * lengths of rays. worker: number of the calling thread. */
void bake_trace_viewpoints(const struct fmt_nvdb_grid *grid, const struct bake_tree *tree,
                           const struct bk_params *params, const struct bake_viewpoints *viewpoints,
                           uint64_t begin, uint64_t end, const struct bake_native_workers *workers,
                           unsigned worker, const struct bake_ray_states *states);

#endif
