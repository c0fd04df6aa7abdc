/* sort_grid.h - writes a bumpy grid with random attributes as an OBJ file, and computes the
 * triangles that sorting must give. */
#ifndef TEST_SORT_GRID_H
#define TEST_SORT_GRID_H

#include "sort_fixture.h"

/* Returns the next number of a repeatable sequence. */
uint32_t sort_random(uint64_t *seed);

enum { GRID_COLORS = 1, GRID_NORMALS = 2, GRID_SHUFFLED = 4 };

/* A bumpy grid of n x n quads, two triangles each; vertices are numbered row by row. */
struct sort_grid {
    uint32_t n;
    double (*positions)[3];
    uint8_t (*colors)[3];
};

void sort_grid_make(struct sort_grid *g, uint32_t n, uint64_t seed);
void sort_grid_free(struct sort_grid *g);
void sort_grid_write(const struct sort_grid *g, const char *path, unsigned flags, uint64_t seed);
/* Computes the expected triangles. Normals of faces are masked out: only their presence counts. */
void sort_grid_expect(const struct sort_grid *g, unsigned flags, struct sorted_triangles *out);
/* Checks that third corners, which have no normal in the file, have their triangle's normal. */
void sort_grid_check_face_normals(struct sorted_triangles *t);

#endif
