/* parts.h - objects and materials of low-poly meshes; private to this folder. */
#ifndef BAKE_LOWPOLY_PARTS_H
#define BAKE_LOWPOLY_PARTS_H

#include "libbake/lowpoly/lowpoly.h"

/* The names in all files of a job, and those of each triangle. All zero at first. */
struct bake_parts {
    struct bsq_texts objects, materials;
    struct bsq_tally tally; /* of these */
    uint32_t (*of)[2];      /* of each triangle: numbers of its object and material */
    uint64_t count, capacity;
};

/* Adds the triangles of a file, which fmt_mesh_load() loaded. A triangle without an object
 * belongs to one with the file's name, without folder and suffix. */
int bake_parts_add(struct bsq_ctx *ctx, struct bake_parts *parts, const char *path,
                   const struct fmt_mesh *mesh);

/* Sorts the mesh by set, and gives it the sets and the objects of its triangles, as the options
 * ask. Takes the names over. */
int bake_parts_apply(struct bsq_ctx *ctx, const struct bake_lowmesh_options *options,
                     struct bake_parts *parts, struct bake_lowmesh *mesh);
void bake_parts_free(struct bsq_ctx *ctx, struct bake_parts *parts);

#endif
