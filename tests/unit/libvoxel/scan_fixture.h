/* scan_fixture.h - small scans as chunk files, for tests of the voxelizer. */
#ifndef TEST_SCAN_FIXTURE_H
#define TEST_SCAN_FIXTURE_H

#include "formats/chunks/tris.h"

struct scan_mesh {
    uint32_t vertex_count, triangle_count;
    float (*positions)[3];
    uint32_t (*triangles)[3];
    /* Optional, NULL if not used; per vertex, and materials per triangle. */
    uint32_t *normals, *colors, *materials;
    float (*texcoords)[2];
};

/* Allocates a mesh without attributes. Ends the test if there is no memory. */
struct scan_mesh scan_mesh_new(uint32_t vertices, uint32_t triangles);
void scan_mesh_free(struct scan_mesh *mesh);

/* Set one vertex or triangle of a mesh from scan_mesh_new(). */
void scan_set_vertex(struct scan_mesh *mesh, uint32_t v, double x, double y, double z);
void scan_set_triangle(struct scan_mesh *mesh, uint32_t t, uint32_t a, uint32_t b, uint32_t c);
/* Adds a parallelogram from `at` along u and v, facing along u x v, as vertices 4 q to 4 q + 3. */
void scan_set_quad(struct scan_mesh *mesh, uint32_t q, const double at[3], const double u[3],
                   const double v[3]);

/* Makes a subdivided octahedron with its vertices on the sphere and no edge above max_edge. Its six
 * corners lie on the axes, so its bounds are those of the sphere. */
struct scan_mesh scan_sphere(double radius, double max_edge);

/* Sorts triangles along a Morton curve, as in a real chunk file. */
void scan_sort(struct scan_mesh *mesh);

/* Writes the mesh as a chunk file with at most chunk_triangles in a chunk, and with vertex normals
 * by area if it has none. */
void scan_write(struct bsq_ctx *ctx, const char *path, const struct scan_mesh *mesh,
                const double origin[3], const struct fmt_tris_material *materials,
                uint32_t material_count, uint32_t chunk_triangles);

/* Returns the next number of a repeatable sequence, in [0, 1). */
double scan_random(uint64_t *seed);

#endif
