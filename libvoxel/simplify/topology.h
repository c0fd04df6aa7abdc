/* topology.h - small pieces and narrow handles of a mesh whose edges collapse.
 *
 * The link condition keeps both, so at last they would need all triangles of a noisy scan. Their
 * removal has a cost as collapses have (El-Sana and Varshney, "Controlled Simplification of Genus
 * for Polygonal Models", 1997; Popovic and Hoppe, "Progressive Simplicial Complexes", 1997). */
#ifndef VOX_TOPOLOGY_H
#define VOX_TOPOLOGY_H

#include "libvoxel/simplify/rings.h"

enum { VOX_PIECE_VERTICES = 4 /* most of a piece that is small: a tetrahedron */ };

struct vox_place;

/* Vertices as they were at some time, to look for the nearest one. */
struct vox_places {
    struct vox_place *places; /* NULL: not built yet */
    uint32_t count, alive;    /* alive: triangles at that time */
};

/* A whole piece. */
struct vox_small_piece {
    uint32_t vertices[VOX_PIECE_VERTICES];
    unsigned count;   /* of vertices */
    uint32_t nearest; /* the vertex of all others that is nearest to its farthest point */
    double square;    /* of that distance */
};

/* Sets *piece to the piece of v. piece->count is 0 if it has more than VOX_PIECE_VERTICES, or if
 * nothing else is left. The caller frees places->places with bsq_free(). Errors: BSQ_ENOMEM,
 * BSQ_EINTR. */
int vox_find_small_piece(struct vox_rings *r, uint32_t v, struct vox_places *places,
                         struct vox_small_piece *piece);

/* Takes a piece away. */
void vox_drop_piece(struct vox_rings *r, const struct vox_small_piece *piece);

/* Sets cycle[] to u, v and the least vertex that is next to both but not opposite to their edge, so
 * that the three edges go around a handle, a tunnel or a neck. Returns false if there is none. */
bool vox_find_cycle(struct vox_rings *r, uint32_t u, uint32_t v, uint32_t cycle[3]);

/* Cuts the surface along three edges, and closes either side with a triangle. Those to the right of
 * the cycle get copies[] as corners, which move away from it by a hundredth of the way to their
 * neighbours, so that the sides share no edge. Vertices and triangles that collapses have set free
 * are used again. Returns false, and changes nothing, if these do not suffice, a vertex is flagged,
 * or the edges are those of a triangle. */
bool vox_cut_cycle(struct vox_rings *r, const uint32_t cycle[3], uint32_t copies[3]);

#endif
