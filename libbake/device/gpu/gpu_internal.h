/* gpu_internal.h - what patches and areas share; private to this folder. */
#ifndef BAKE_DEVICE_GPU_GPU_INTERNAL_H
#define BAKE_DEVICE_GPU_GPU_INTERNAL_H

#include "libbake/device/gpu/gpu.h"

/* Adds an argument, which must live until the launch. */
void bake_launch_add(struct bake_launch *launch, const void *value, uint64_t bytes);
#define BAKE_LAUNCH_ADD(launch, value) bake_launch_add(launch, &(value), sizeof(value))

/* Reserves bytes of the host's budget until the device is closed. */
int bake_gpu_reserve(struct bake_gpu *gpu, const char *what, uint64_t bytes);

/* Releases memory of the device, if there is any. */
void bake_gpu_release(struct bake_gpu *gpu, bake_memory *memory);

/* Attaches the calling thread, and opens a stream before its first work. */
struct bake_failure bake_gpu_take_stream(struct bake_gpu *gpu, struct bake_stream *stream);
/* Waits for what a worker fetches, in the host memory of the stream. */
struct bake_failure bake_gpu_receive(struct bake_gpu *gpu, struct bake_stream *stream);
/* Describes the failure of a worker's work in `why`, and releases a stream that could not be
 * opened. Returns BSQ_ENODEVICE; 0 if nothing failed. */
int bake_gpu_end_worker(struct bake_gpu *gpu, struct bake_stream *stream,
                        struct bake_failure failure, char *why);

/* Returns the bytes of a worker's memory for bake_gpu_look() and bake_gpu_first(). */
uint64_t bake_gpu_chunk_rays_bytes(const struct bk_params *params);

#endif
