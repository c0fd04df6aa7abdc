/* normal_map.h - normals of a triangle with a tangent-space normal map.
 *
 * Red of the map points where u grows on the triangle, green where v does, blue along the normal.
 * Samples from 0 to 1 are components from -1 to 1. */
#ifndef BSQ_NORMAL_MAP_H
#define BSQ_NORMAL_MAP_H

#include <stdbool.h>

/* Replaces a unit normal of a triangle by the one that a texel of a normal map gives. edge: the
 * vectors from the first corner to the others; uv_edge: the same in texture coordinates. The
 * tangent is at right angles to the normal. Returns false, with the normal unchanged, if the texel
 * is black or the triangle has no area in the texture. */
bool bsq_normal_map_apply(const double edge[2][3], const double uv_edge[2][2], const float texel[3],
                          double normal[3]);

#endif
