/* groups.h - the surface of a scan in parts, which need not fit in memory together. */
#ifndef VOX_SIMPLIFY_GROUPS_H
#define VOX_SIMPLIFY_GROUPS_H

#include "base/spill.h"
#include "formats/chunks/tris.h"
#include "libvoxel/simplify/mesh.h"

/* A mesh: a chunk, or bytes of a spill: positions, quadrics and triangles. Its vertices
 * are welded; those at its border are also in other parts. */
struct vox_part {
    uint64_t offset;
    uint32_t vertices, triangles;
    float low[3], high[3]; /* around it */
    float weight;          /* how many triangles it needs, beside those of other parts */
};

/* All parts, in the order of the scan's chunks. */
struct vox_level {
    struct bsq_ctx *ctx;
    const char *beside;                 /* an output, for temporary files */
    const struct fmt_tris_file *chunks; /* of the first level, the caller's; else NULL */
    struct bsq_spill spill;             /* of one stream */
    struct vox_part *parts;
    uint64_t part_count, triangles;
    bool quadrics; /* are in the spill */
};

/* Begins the level after another one; most: parts that it may get. The caller frees it, also after
 * failure. Errors: BSQ_ENOMEM. */
int vox_level_begin(const struct vox_level *from, uint64_t most, bool quadrics,
                    struct vox_level *to);
/* Frees a level of which `to` is the next one, or NULL. A level of all zeros is allowed. */
void vox_level_free(struct vox_level *level, struct vox_level *to);

/* Adds a part with the mesh's quadrics, if the level has them. Errors: BSQ_ENOMEM, BSQ_EIO,
 * BSQ_ECANTCREAT. */
int vox_level_add(struct vox_level *level, const struct vox_mesh *mesh, float weight);

/* Reads a part into the space after the vertices and triangles that the mesh has; these stay as
 * many. Reads quadrics if mesh and level have them. Thread-safe. Errors: BSQ_ENOMEM, BSQ_EIO,
 * BSQ_EDATA. */
int vox_level_read(const struct vox_level *level, uint64_t index, struct vox_mesh *mesh);

/* Makes one welded mesh, without quadrics. The caller frees it. Errors: as of reading a part. */
int vox_level_join(const struct vox_level *level, struct vox_mesh *mesh);

/* ---- regions.c: dividing space ---- */

/* A box: its low sides belong to it, its high ones to others. */
struct vox_region {
    float low[3], high[3];
    uint64_t triangles; /* of the parts whose middles are in it */
};

/* Divides space by planes until regions have about `limit` triangles, or one part. share_below: of
 * the triangles, those below a plane. The caller frees *regions, also after failure. Errors:
 * BSQ_ENOMEM. */
int vox_divide_level(const struct vox_level *level, uint64_t limit, double share_below,
                     struct vox_region **regions, uint64_t *count);

static inline float vox_part_middle(const struct vox_part *part, int axis)
{
    return 0.5F * (part->low[axis] + part->high[axis]);
}

static inline bool vox_region_has(const struct vox_region *region, const float position[3])
{
    bool in = true;
    for (int k = 0; k < 3; k++)
        in = in && position[k] >= region->low[k] && position[k] < region->high[k];
    return in;
}

#endif
