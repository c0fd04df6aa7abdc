/* lowpoly.h - the low-poly mesh that maps are baked for. Takes mesh files with texture coordinates;
 * gives corners with normals, texture coordinates and tangent frames, and the objects and materials
 * that have maps of their own. */
#ifndef BAKE_LOWPOLY_LOWPOLY_H
#define BAKE_LOWPOLY_LOWPOLY_H

#include "base/text.h"
#include "formats/mesh/mesh_reader.h"
#include "libbake/bake.h"

/* Triangles that share maps. */
struct bake_low_set {
    const char *object, *material; /* NULL: those of all objects or materials */
    uint64_t first, count;         /* its triangles in the mesh as loaded */
};

struct bake_lowmesh {
    uint64_t triangle_count;
    uint64_t polygon_count; /* faces with more than three corners, which became triangles */
    /* Of each triangle's three corners. */
    double (*positions)[3][3]; /* world space */
    float (*normals)[3][3];    /* unit; from the file, else as the options say */
    float (*texcoords)[3][2];  /* OBJ convention: v upwards; clamped to finite floats */
    float (*tangents)[3][4];   /* MikkTSpace; w is the sign of the bitangent */
    float (*directions)[3][3]; /* of rays, outwards: unit; with a cage, the way to its corner */
    float (*reaches)[3];       /* of corners: where rays start outside of the mesh, world units */
    double cage_distance;      /* of the farthest corner of the cage; 0: there is no cage */
    double bounds_min[3], bounds_max[3];
    struct bake_low_set *sets; /* none: all triangles share maps */
    uint32_t set_count;
    struct bsq_texts objects, materials; /* names; only if they are wanted */
    struct bsq_tally names;              /* memory of these */
    uint32_t *object_of, *material_of;   /* of each triangle: numbers in these; likewise */
};

/* Where a mesh lies: p becomes shift + scale * turn p. */
struct bake_transform {
    double scale, turn[3][3], shift[3];
};
/* Sets *out to what the options ask for. */
void bake_transform_of(const struct bake_options *options, struct bake_transform *out);
/* Places a point; `out` may be `p`. */
void bake_transform_point(const struct bake_transform *transform, const double p[3], double out[3]);
/* Sets *out to `first`, followed by `then`. */
void bake_transform_join(const struct bake_transform *first, const struct bake_transform *then,
                         struct bake_transform *out);
/* Sets *out to the matrix of a word of BAKE_TURNS; writes a word for a matrix. */
void bake_turn_matrix(unsigned turn, double out[3][3]);
void bake_turn_word(const double turn[3][3], char out[8]);

/* Loads the mesh files of the options, and moves them as these ask for. Names are kept of what has
 * maps of its own or sees scans of its name. Computes normals for files that have none, and warns
 * unless the options choose them. Computes tangents and ray directions, for each file alone. Free
 * *out with bake_lowmesh_free(). Errors: those of fmt_mesh_load(); BSQ_EDATA with the line of the
 * first face that has no texture coordinates, or whose corners differ from the cage's, or for too
 * many triangles; BSQ_ENOMEM, BSQ_EINTR. */
int bake_lowmesh_load(struct bsq_ctx *ctx, const struct bake_options *options,
                      struct bake_lowmesh *out);
/* Puts triangle order[i] in place i, for `count` places; a triangle may have several. The sets stay
 * as they are. */
int bake_lowmesh_reorder(struct bsq_ctx *ctx, const uint32_t *order, uint64_t count,
                         struct bake_lowmesh *mesh);
/* Sets *out to the position that floats within these bounds should be relative to: 0, or if the
 * bounds lie so far from 0 that floats there are coarse, their middle. */
void bake_choose_origin(const double low[3], const double high[3], double out[3]);
/* Returns the area of a triangle. */
double bake_lowmesh_area(const struct bake_lowmesh *mesh, uint64_t triangle);
/* A zeroed mesh is allowed. */
void bake_lowmesh_free(struct bsq_ctx *ctx, struct bake_lowmesh *mesh);

#endif
