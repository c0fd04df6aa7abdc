/* device.h - what traces patches: native threads or a GPU, behind one interface. The kernel in
 * libbake/kernel/ is the same for all.
 *
 * The public header of device/ for the rest of libbake. Takes a job (job/job.h); gives texels.
 * Single rays are traced on the processor (native/native.h). */
#ifndef BAKE_DEVICE_DEVICE_H
#define BAKE_DEVICE_DEVICE_H

#include "libbake/device/gpu/gpu.h"
#include "libbake/device/scene/scene.h"
#include "libbake/device/native/native.h"

struct bake_device;

/* Opens a device by its name on the command line (BAKE_DEVICE_NAMES) and loads the grid. "auto"
 * takes the first GPU that works and has memory for the grid, else the processor. If the GPU fails
 * later, the processor goes on. If the grid does not fit a device that was named, the processor
 * takes its place, after a warning. Without a grid, likewise for chunks of triangles. Errors:
 * BSQ_ENODEVICE, with the devices that exist; BSQ_EUSAGE for any other name. */
int bake_device_open(struct bsq_ctx *ctx, const char *name, const struct bake_scene *scene,
                     struct bake_device **out);
void bake_device_close(struct bake_device *device); /* NULL is allowed */
/* Returns the device's name; after it failed also that of the processor, which went on. Must not be
 * called while patches are traced. */
const char *bake_device_name(const struct bake_device *device);

/* Traces one patch and waits for it: sample_triangles in, width * height texels of
 * bk_texel_floats(params.maps) floats out, row 0 at the top. Several
 * workers may call this at a time with distinct `worker` (< bsq_threads). Native code traces on the
 * calling thread; a GPU has a stream and buffers for each worker. */
int bake_device_trace(struct bake_device *device, const struct bk_patch *patch,
                      const uint32_t *sample_triangles, float *texels, unsigned worker);
/* Start a patch, and wait for it. A worker may start several patches, one in each window; window 0
 * is that of bake_device_trace(). Errors: BSQ_RETRY if the device is the processor or was lost:
 * then bake_device_trace() is to follow; those of bake_device_trace(). */
unsigned bake_device_windows(const struct bake_device *device); /* at least 1 */
int bake_device_begin(struct bake_device *device, const struct bk_patch *patch,
                      const uint32_t *sample_triangles, unsigned worker, unsigned window);
int bake_device_end(struct bake_device *device, const struct bk_patch *patch, float *texels,
                    unsigned worker, unsigned window);

/* Traces single rays through the job's grid for a job with curvature, as bake_trace_rays() does,
 * and sets the hits' t, triangle and normal; the batch asks for nothing else, and has at most
 * bake_device_most_rays(). unit: of a voxel in world units. Workers call it as bake_device_trace().
 */
int bake_device_trace_rays(struct bake_device *device, const struct bake_ray_batch *batch,
                           double unit, unsigned worker);
uint32_t bake_device_most_rays(const struct bake_device *device);

/* ---- chunks of triangles ---- */

/* Returns whether a GPU traces rays through chunks, until it fails. Then the caller does. */
bool bake_device_has_areas(const struct bake_device *device);

/* Do what the functions of gpu.h do, for the GPU of bake_device_has_areas(). Errors: BSQ_RETRY if
 * it failed and the processor goes on, after a warning; BSQ_ENODEVICE if it failed and was named;
 * BSQ_ENOMEM. */
int bake_device_make_areas(struct bake_device *device, uint64_t whole, uint64_t least,
                           uint32_t *count, uint64_t *bytes);
void bake_device_release_areas(struct bake_device *device);
int bake_device_make_wave(struct bake_device *device, uint64_t least, uint64_t *bytes);
int bake_device_send(struct bake_device *device, uint32_t area, uint64_t at, const void *from,
                     uint64_t bytes, unsigned worker);
int bake_device_look(struct bake_device *device, uint32_t area, const struct bk_params *params,
                     const struct bake_viewpoints *viewpoints, uint64_t begin, uint64_t end,
                     unsigned worker, const struct bake_ray_states *states);
int bake_device_first(struct bake_device *device, uint64_t at, const bk_limits *limits,
                      const struct bake_first_rays *rays, const bk_first_hit **hits,
                      unsigned worker);

/* Returns what the device did so far; zeros for the processor. Must not be called while patches are
 * traced. */
void bake_device_times(struct bake_device *device, struct bake_device_times *out);

#endif
