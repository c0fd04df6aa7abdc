/* rings.h - the triangles around each vertex of a mesh whose edges collapse.
 *
 * Corners of triangles are linked in a ring around each vertex, in no particular order. Vertices
 * and links of a triangle are together in memory, because a step along a ring reads both. A
 * collapse of (u, v) joins the rings of both; corners of triangles that are gone leave a ring when
 * somebody walks along it. Meshes stay manifold where they are: vox_rings_keep_topology() and
 * vox_rings_keep_orientation() refuse collapses that would make an edge with three triangles or
 * fold a triangle over. */
#ifndef VOX_RINGS_H
#define VOX_RINGS_H

#include "libvoxel/simplify/mesh.h"

enum {
    VOX_BORDER = 1, /* of a vertex: at an edge with one triangle */
    VOX_LOCKED = 2, /* stays: at an edge with three triangles or more, or as options say */
    VOX_SHARED = 4, /* locked, and in other meshes, too, so that its piece stays */
    VOX_NONE = UINT32_MAX,
    VOX_CHECK_EVERY = 1024 /* collapses between two looks at an interruption */
};

/* Words of a triangle a, b, c: vertices c, a, b, c, a, so that each corner has those before and
 * after beside it; then, of each corner, the next one in its vertex's ring. The number of a corner
 * is that of the word of its vertex, the second to the fourth. */
enum { VOX_RING_WORDS = 8, VOX_LINK = 4 /* words from a corner to its link */ };

struct vox_rings {
    struct bsq_ctx *ctx;
    struct vox_mesh *mesh; /* its triangles are out of date until vox_rings_compact() */
    uint32_t alive;        /* triangles */
    uint32_t *words;       /* of triangles; those that are gone have VOX_NONE as their first one */
    uint32_t spare;        /* words of a triangle that is gone: the next one's follow, and a vertex
                            * that is gone too; or VOX_NONE */
    uint32_t *corner;      /* of each vertex: a corner of its ring, or VOX_NONE */
    uint8_t *flags;        /* of vertices */
    uint32_t *marks;       /* of vertices: the walk that found them last */
    uint32_t walk;
};

/* Links the corners of a welded mesh, which stays the caller's, and flags its vertices.
 * lock_borders: vertices of open borders stay. The caller calls vox_rings_free() even after a
 * failure. Errors: BSQ_ENOMEM, BSQ_EINTR. */
int vox_rings_build(struct bsq_ctx *ctx, struct vox_mesh *mesh, bool lock_borders,
                    struct vox_rings *rings);
void vox_rings_free(struct vox_rings *rings);

/* Returns whether an edge has one triangle. */
bool vox_rings_is_border(struct vox_rings *r, uint32_t u, uint32_t v);

/* Returns whether the link condition holds (Dey, Edelsbrunner, Guha and Nekhayev, 1999): the
 * vertices next to both u and v are those opposite to the edge, and no edge lies opposite to both.
 * All that lies beyond open borders counts as one more vertex, so the last triangle of a piece
 * stays. */
bool vox_rings_keep_topology(struct vox_rings *r, uint32_t u, uint32_t v);

/* Returns whether the triangles of u without v keep their orientation if u moves to p. */
bool vox_rings_keep_orientation(struct vox_rings *r, uint32_t u, uint32_t v, const float p[3]);

/* Collapses (u, v) into u, which moves to p. */
void vox_rings_join(struct vox_rings *r, uint32_t u, uint32_t v, const float p[3]);

/* Renumbers vertices and triangles that are left, in their order. The rings are of no use then. */
void vox_rings_compact(struct vox_rings *r);

/* The words of a corner's triangle. */
static inline uint32_t *vox_words(const struct vox_rings *r, uint32_t corner)
{
    return &r->words[corner & ~(VOX_RING_WORDS - 1U)];
}

static inline bool vox_is_gone(const struct vox_rings *r, uint32_t corner)
{
    return *vox_words(r, corner) == VOX_NONE;
}

/* The corners of a corner's triangle, in the order of the mesh. */
static inline const uint32_t *vox_corners(const struct vox_rings *r, uint32_t corner)
{
    return vox_words(r, corner) + 1;
}

/* Returns the corner after `corner` in its ring, and drops those of triangles that are gone. */
static inline uint32_t vox_next_corner(struct vox_rings *r, uint32_t corner)
{
    uint32_t next = r->words[corner + VOX_LINK];
    while (vox_is_gone(r, next) && next != corner)
        next = r->words[corner + VOX_LINK] = r->words[next + VOX_LINK];
    return next;
}

/* Returns a corner of a vertex's ring whose triangle is there, or VOX_NONE. */
static inline uint32_t vox_first_corner(struct vox_rings *r, uint32_t vertex)
{
    const uint32_t corner = r->corner[vertex];
    if (corner == VOX_NONE || !vox_is_gone(r, corner))
        return corner;
    uint32_t next = vox_next_corner(r, corner);
    if (vox_is_gone(r, next))
        next = VOX_NONE;
    return r->corner[vertex] = next;
}

/* The other corners of a corner's triangle, in their order. */
static inline uint32_t vox_after(const struct vox_rings *r, uint32_t corner)
{
    return r->words[corner + 1];
}
static inline uint32_t vox_before(const struct vox_rings *r, uint32_t corner)
{
    return r->words[corner - 1];
}

/* Walks along the ring of a vertex: for (each corner k of vertex v). */
#define VOX_EACH_CORNER(r, v, k)                                                                   \
    uint32_t k = vox_first_corner(r, v), k##_first = k, k##_more = k != VOX_NONE;                  \
    k##_more;                                                                                      \
    k = vox_next_corner(r, k), k##_more = k != k##_first

#endif
