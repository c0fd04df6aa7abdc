/* sort_grid.h - a bumpy grid with random attributes as an OBJ file, and the triangles that sorting
 * it must give. */
#ifndef TEST_SORT_GRID_H
#define TEST_SORT_GRID_H

#include "sort_fixture.h"

/* The next number of a repeatable sequence. */
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
/* Face normals are compared for angle elsewhere, here only their presence: they are masked out. */
void sort_grid_expect(const struct sort_grid *g, unsigned flags, struct sorted_triangles *out);
/* Third corners of sort_grid_expect() lack a normal and have their triangle's. */
void sort_grid_check_face_normals(struct sorted_triangles *t);

#endif
