/* exact_fixture.h - shared by the tests of the exact tracer: random numbers, meshes as chunk files,
 * and tracing rays through them. */
#ifndef TEST_EXACT_FIXTURE_H
#define TEST_EXACT_FIXTURE_H

#include "libbake/exact/exact.h"
#include "tests/unit/libbake/triangle_scan.h"

#define exact_scan_path "scan.tris"

/* State of the random numbers; main prints it as the seed. */
extern uint64_t exact_seed;
/* Return a random number in [0, 1), and one between two limits. */
double exact_uniform(void);
float exact_between(double low, double high);
/* Computes the unit direction from one point to another. */
void exact_toward(const float from[3], const double to[3], float out[3]);

/* Returns triangles of all directions and sizes that share no vertices. Free the meshes with
 * triangle_scan_free(). */
struct triangle_scan exact_soup(uint32_t triangles);
/* Returns a bumpy torus of nu x nv quads: closed, with six triangles around each vertex. */
struct triangle_scan exact_torus(uint32_t nu, uint32_t nv);
/* Returns two triangles that face upwards at z = 0: the square with corners (0 0) (2 0) (2 2) (0
 * 2).
 */
struct triangle_scan exact_square(void);

/* Writes the mesh to exact_scan_path, moved away from the origin. */
void exact_write_scan(const struct triangle_scan *mesh, uint32_t chunk_triangles);

struct exact_setup {
    unsigned threads;
    uint64_t memory;
    bool two_sided, color, facing_origin, from_reach;
    enum bsq_scan_normals normals;
    double t_min, t_max;
    const float *reaches;                   /* of all rays; NULL: 0 */
    const struct bake_footprint *footprint; /* the same for all rays; NULL: none */
};

/* Traces rays through the scan, in as many batches as needed, in a context of its own. */
void exact_trace(const struct exact_setup *setup, const struct bake_ray *rays, uint64_t count,
                 struct bake_hit *hits);
/* Traces one ray along z. */
struct bake_hit exact_trace_one(const struct exact_setup *setup, float x, float y, float z,
                                float dz);
/* Makes rays with origins between low and high on each axis. Every 16th ray is parallel to an axis.
 */
void exact_random_rays(struct bake_ray *rays, uint64_t count, double low, double high);

#endif
