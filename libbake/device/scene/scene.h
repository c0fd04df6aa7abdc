/* scene.h - what a device traces: the grid, the low-poly mesh's triangles and the parameters.
 *
 * Takes an open grid file (formats/grid); gives the kernel's parameters and array pointers for it,
 * the arrays that a device with memory of its own takes. Every other folder of
 * device/ uses this one. */
#ifndef BAKE_DEVICE_SCENE_SCENE_H
#define BAKE_DEVICE_SCENE_SCENE_H

#include "formats/grid/nvdb.h"
#include "libbake/bake.h"
#include "libbake/grid_tree/leaf_tree.h"
#include "libbake/kernel/bk_maps.h"

struct bk_grid;

/* Everything that stays the same over a job; pointers stay valid until the device is closed. */
struct bake_scene {
    const struct fmt_nvdb_grid *grid; /* NULL: rays meet chunks of triangles */
    /* Then device memory: that the largest chunk and its table need for rays from hits, that it
     * needs for first rays, and that these can use. */
    uint64_t chunk_bytes, place_bytes, wave_bytes;
    const struct bk_triangle *triangles;
    uint32_t triangle_count;
    uint32_t patch_texels;  /* largest width * height of a patch */
    uint64_t device_memory; /* limit for a device's own memory, in bytes; 0: all that is free */
    const struct bake_tree *tree; /* for secondary rays, else NULL; bake_device_open() makes it */
    struct bk_params params;
};

/* Voxels that can be traced have indices in -BAKE_INDEX_LIMIT .. BAKE_INDEX_LIMIT - 1, so that
 * neither neighbours nor distances from a ray's origin overflow 32 bits. Bisque writes no others,
 * but its format allows them. */
#define BAKE_INDEX_LIMIT (1 << 30)

/* Checks the index bounds of a grid. Errors: BSQ_EDATA. */
int bake_check_grid(struct bsq_ctx *ctx, const struct fmt_nvdb_grid *grid);

/* Fills the grid part of params (bounds, counts, second_base, BK_HAS_COLOR, ids). */
void bake_params_from_grid(const struct fmt_nvdb_grid *grid, struct bk_params *params);

/* Points the kernel's grid at the arrays of a mapped file; valid while the file is open. */
void bake_kernel_grid(const struct fmt_nvdb_grid *grid, const struct bk_params *params,
                      struct bk_grid *out);

/* Arrays of a grid, in the order of the kernel's arguments. */
enum {
    BAKE_ROOT_TILES,
    BAKE_UPPERS,
    BAKE_LOWERS,
    BAKE_LEAVES,
    BAKE_NORMALS,
    BAKE_PLANES,
    BAKE_COLORS, /* also ids and channels, and the kernel's tables for them */
    BAKE_SECONDS,
    BAKE_NODES,
    BAKE_BLOCKS,
    BAKE_GRID_ARRAYS
};

enum { BAKE_ARRAY_RANGES = 5 };

/* An array in the memory of a device: parts of the grid's file, one after another. */
struct bake_grid_array {
    const char *name; /* for messages */
    struct {
        const void *data;
        uint64_t bytes;
    } ranges[BAKE_ARRAY_RANGES];
    uint64_t bytes; /* of all parts; 0: the kernel does not read the array */
};

/* A grid in the memory of a device. */
struct bake_grid_arrays {
    struct bake_grid_array arrays[BAKE_GRID_ARRAYS];
    uint64_t bytes, largest; /* of all arrays, and of the largest one */
    struct bk_params params; /* the job's, for these arrays */
};

/* Lists the arrays of a job's grid and of its tree, if there is one, which stay valid while both
 * exist. Allocates nothing. */
void bake_list_arrays(const struct bake_scene *scene, struct bake_grid_arrays *out);

#endif
