/* device.h - what traces a tile: native threads or a compute device, behind one interface.
 * The kernel in libbake/kernel/ is the same for all. */
#ifndef BAKE_DEVICE_DEVICE_H
#define BAKE_DEVICE_DEVICE_H

#include "formats/grid/nvdb.h"
#include "libbake/bake.h"
#include "libbake/kernel/bk_types.h"

enum { BAKE_MOST_SAMPLES = 256 }; /* N; 65536 a texel */

/* How kernels are run on a CUDA device; measurements try others than the default. */
struct bake_cuda_tuning {
    unsigned registers;                 /* of a thread at most; 0: as many as the compiler likes */
    unsigned block_width, block_height; /* threads; a multiple of 32 together, at most 1024 */
    uint64_t piece_bytes; /* longest piece of the device's memory; 0: the limit of all devices */
};

/* Everything that stays the same over a job; pointers stay valid until the device is closed. */
struct bake_job {
    const struct fmt_nvdb_grid *grid;
    const struct bk_triangle *triangles;
    uint32_t triangle_count;
    uint32_t tile_texels;   /* largest width * height of a tile */
    uint64_t device_memory; /* most bytes of a device's own memory to use; 0: what it has */
    struct bk_params params;
    const struct bake_cuda_tuning *cuda_tuning; /* NULL: the default */
};

/* Voxels that can be traced have indices in -BAKE_INDEX_LIMIT .. BAKE_INDEX_LIMIT - 1, so that
 * neither neighbours nor distances from a ray's origin overflow 32 bits. Bisque writes no others,
 * but its format allows them: BSQ_EDATA. */
#define BAKE_INDEX_LIMIT (1 << 30)
int bake_check_grid(struct bsq_ctx *ctx, const struct fmt_nvdb_grid *grid);

/* Fills the grid part of params (bounds, counts, second_base, BK_HAS_COLOR). */
void bake_params_from_grid(const struct fmt_nvdb_grid *grid, struct bk_params *params);

struct bake_device;
struct bake_part;

/* Parts of a grid that a device can hold at a time. */
enum { BAKE_SLOTS = 2 };

/* Opens the device named as on the command line (BAKE_DEVICE_NAMES) for a job and makes the grid
 * available to it, where it has room for all of it: see bake_device_holds_grid(). "auto" takes a
 * GPU that works, else cpu. Errors: BSQ_ENODEVICE with what is there, BSQ_EUSAGE for any other
 * name. */
int bake_device_open(struct bsq_ctx *ctx, const char *name, const struct bake_job *job,
                     struct bake_device **out);
const char *bake_device_name(const struct bake_device *device);

/* Whether any tile can be traced. Otherwise parts have to be loaded first: in each slot one whose
 * arrays take no more than *part_bytes together and *buffer_bytes each. *other_bytes: what the job
 * takes besides. */
bool bake_device_holds_grid(const struct bake_device *device, uint64_t *part_bytes,
                            uint64_t *buffer_bytes, uint64_t *other_bytes);
/* Puts a part of the grid into a slot, while other threads may trace tiles from the other one. */
int bake_device_load(struct bake_device *device, unsigned slot, const struct bake_part *part);
/* From now on tiles are traced from this slot (at first 0). Not while tiles are traced. */
void bake_device_use(struct bake_device *device, unsigned slot);
/* A device that was chosen automatically is given up with a warning for native threads: true. */
bool bake_device_give_up(struct bake_device *device, const char *why);

/* Traces one tile: sample_triangles in, width * height texels out, row 0 at the top. Called from
 * several workers at a time with distinct `worker` (< bsq_threads): native code traces on the
 * calling thread, others keep a queue and buffers per worker. */
int bake_device_trace(struct bake_device *device, const struct bk_tile *tile,
                      const uint32_t *sample_triangles, struct bk_texel *texels, unsigned worker);
/* What the device did so far; zeros for the processor. Not while tiles are traced. */
struct bake_device_times {
    double upload;  /* of the grid, wall time */
    double copies;  /* of tiles' samples to the device and of texels back, on the device's clock */
    double kernels; /* likewise; what several queues do at once counts once */
    uint64_t launches; /* kernel calls */
};
void bake_device_times(struct bake_device *device, struct bake_device_times *out);
void bake_device_close(struct bake_device *device); /* NULL is allowed */

/* Traces single rays on the calling thread with the same kernel code (for previews and tests).
 * origin and unit direction in index space; hits with t in [t_min, t_max], the one with the
 * smallest |t| wins. facing: unit vector; surfaces whose normal has a negative dot product with it
 * are ignored unless flags has BK_TWO_SIDED. */
void bake_trace_ray(const struct fmt_nvdb_grid *grid, const struct bk_params *params,
                    const float origin[3], const float direction[3], float t_min, float t_max,
                    const float facing[3], struct bk_hit *hit);

#endif
