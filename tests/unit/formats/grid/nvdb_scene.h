/* nvdb_scene.h - random sparse voxels for tests of grid files. */
#ifndef TEST_NVDB_SCENE_H
#define TEST_NVDB_SCENE_H

#include "formats/grid/nvdb.h"

#ifdef __cplusplus
extern "C" {
#endif

struct scene_voxel {
    int32_t ijk[3];
    struct fmt_nvdb_record first, second; /* `second` is valid if first.plane has the flag */
};

struct scene {
    struct fmt_nvdb_info info;
    uint64_t count;
    struct scene_voxel *voxels; /* in the order of the file */
};

/* Makes about `per_cluster` voxels around each of several points: in several root tiles, with both
 * signs, at borders of nodes. */
void scene_random(struct scene *scene, uint64_t seed, unsigned per_cluster);
/* Sorts voxels into the order of the file, and keeps the first of several at one position. */
void scene_sort(struct scene *scene);
void scene_free(struct scene *scene);

/* Writes the scene as a grid of this type. */
int scene_write(struct bsq_ctx *ctx, const char *path, const struct scene *scene,
                struct fmt_nvdb_totals *totals);

/* Returns a pseudo-random number; *state must not be zero. */
uint64_t scene_next(uint64_t *state);

#ifdef __cplusplus
}
#endif
#endif
