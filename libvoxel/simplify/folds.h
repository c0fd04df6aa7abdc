/* folds.h - triangles that lie back to back, as of a surface that is folded over. */
#ifndef VOX_FOLDS_H
#define VOX_FOLDS_H

#include "libvoxel/simplify/rings.h"

/* Returns whether the collapse of (u, v) to p would fold the surface over: at an edge, or because a
 * triangle turns. Where there are folds already, it may turn triangles if fewer folds are left. v
 * is VOX_NONE: u moves to p, and nothing collapses. */
bool vox_makes_fold(struct vox_rings *r, uint32_t u, uint32_t v, const float p[3]);

/* Returns whether a triangle in a cycle would lie back to back with one beside it. normal: of the
 * cycle. */
bool vox_cap_folds(struct vox_rings *r, const uint32_t cycle[3], const double normal[3]);

#endif
