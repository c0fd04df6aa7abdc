/* mesh_arrays.h - private to formats/mesh: growing arrays for the elements and faces of one block.
 *
 * The arrays are reused from block to block, so only the first blocks allocate. */
#ifndef FMT_MESH_ARRAYS_H
#define FMT_MESH_ARRAYS_H

#include "formats/mesh/mesh_reader.h"

/* What one block holds. All zero at first. Fields are those of struct fmt_mesh_block. */
struct mesh_arrays {
    double (*positions)[3];
    float (*colors)[3];
    double (*texcoords)[2];
    float (*normals)[3];
    uint32_t *face_sizes;
    uint64_t *corners[FMT_MESH_KIND_COUNT];
    uint32_t *face_tags; /* what decides the material of each face; the format says what it is */
    struct fmt_mesh_material_change *changes;

    uint64_t count[FMT_MESH_KIND_COUNT];
    uint64_t face_count, corner_count, change_count;
    bool has_colors;
    bool has_corners[FMT_MESH_KIND_COUNT];

    uint64_t position_capacity, color_capacity, texcoord_capacity, normal_capacity;
    uint64_t size_capacity, corner_capacity[FMT_MESH_KIND_COUNT], tag_capacity, change_capacity;
};

/* Sets all counts to 0 and keeps the memory. */
void fmt_arrays_clear(struct mesh_arrays *arrays);

/* Ensure capacity for this number of elements, faces or corners in all. Errors: BSQ_ENOMEM. */
int fmt_arrays_reserve_positions(struct bsq_ctx *ctx, struct mesh_arrays *arrays, uint64_t count);
int fmt_arrays_reserve_colors(struct bsq_ctx *ctx, struct mesh_arrays *arrays, uint64_t count);
int fmt_arrays_reserve_texcoords(struct bsq_ctx *ctx, struct mesh_arrays *arrays, uint64_t count);
int fmt_arrays_reserve_normals(struct bsq_ctx *ctx, struct mesh_arrays *arrays, uint64_t count);
int fmt_arrays_reserve_faces(struct bsq_ctx *ctx, struct mesh_arrays *arrays, uint64_t count);
int fmt_arrays_reserve_tags(struct bsq_ctx *ctx, struct mesh_arrays *arrays, uint64_t count);
int fmt_arrays_reserve_changes(struct bsq_ctx *ctx, struct mesh_arrays *arrays, uint64_t count);
int fmt_arrays_reserve_corners(struct bsq_ctx *ctx, struct mesh_arrays *arrays,
                               enum fmt_mesh_kind kind, uint64_t count);

/* Sets the arrays and counts of `block`; other fields stay. */
void fmt_arrays_show(const struct mesh_arrays *arrays, struct fmt_mesh_block *block);

void fmt_arrays_free(struct bsq_ctx *ctx, struct mesh_arrays *arrays);

#endif
