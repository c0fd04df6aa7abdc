/* cover.h - which triangles of a mesh lie under a scan, and how far below, in one pass.
 *
 * Seen along a triangle's normal, triangles of the scan that are near its plane form a chain. If no
 * edge that the triangle can see belongs to it unequally often in both directions, the chain has no
 * border there, and covers each point of the triangle equally often. If that is not zero times,
 * each of these points has a point of the scan straight above or below it, no farther than the
 * highest corner of the chain. */
#ifndef VOX_SIMPLIFY_COVER_H
#define VOX_SIMPLIFY_COVER_H

#include "formats/chunks/tris.h"
#include "libvoxel/simplify/closest.h"

struct vox_cover_sum;

struct vox_cover {
    const struct vox_closest *tree; /* of the mesh, the caller's */
    double height;                  /* triangles of the scan count up to this height */
    double margin;                  /* at the edges of triangles, for rounded coordinates */
    double reach;                   /* triangles are looked at in blocks of about this size */
    struct vox_cover_sum *sums;     /* one a triangle of the mesh */
};

/* Begins without any triangle of the scan; the caller has set all but the sums, and frees these
 * with vox_cover_free(). Errors: BSQ_ENOMEM. */
int vox_cover_begin(struct bsq_ctx *ctx, uint32_t triangle_count, struct vox_cover *cover);
void vox_cover_free(struct bsq_ctx *ctx, struct vox_cover *cover);

/* Adds a chunk of the scan. blocks: a number for each vertex. Thread-safe. The order of chunks does
 * not matter. Errors: BSQ_EINTR. */
int vox_cover_add(struct bsq_ctx *ctx, const struct vox_cover *cover,
                  const struct fmt_tris_chunk *chunk, uint64_t *blocks);

/* Returns a bound for the distance of each point of a triangle from the scan; INFINITY: there is
 * none. Edges are compared by sums of 64-bit hashes, so one in 2^59 borders would not be seen. */
double vox_cover_bound(const struct vox_cover *cover, uint32_t triangle);
#endif
