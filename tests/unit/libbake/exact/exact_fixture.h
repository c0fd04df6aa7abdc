/* exact_fixture.h - for the tests of exact rays: random numbers, meshes as chunk files, and rays
 * that are traced through them. */
#ifndef TEST_EXACT_FIXTURE_H
#define TEST_EXACT_FIXTURE_H

#include "libbake/exact/exact.h"
#include "tests/unit/libbake/triangle_scan.h"

/* Files in a directory of the program's own, which these make and remove; for cmocka. */
extern char exact_scan_path[96], exact_picture_path[96];
int exact_make_directory(void **state);
int exact_remove_directory(void **state);

/* Random numbers go on from here; main prints it. */
extern uint64_t exact_seed;
/* In [0, 1). */
double exact_uniform(void);
float exact_between(double low, double high);
/* The direction from one point to another. */
void exact_toward(const float from[3], const double to[3], float out[3]);

/* Triangles of all directions and sizes without common vertices. */
struct triangle_scan exact_soup(uint32_t triangles);
/* A bumpy torus of nu x nv quads: closed, each vertex in six triangles. */
struct triangle_scan exact_torus(uint32_t nu, uint32_t nv);
/* Two triangles over the square 0 .. 2 x 0 .. 2 at z = 0 that face upwards, corners (0 0) (2 0)
 * (2 2) (0 2). */
struct triangle_scan exact_square(void);

/* Makes the mesh the scan, moved away from the origin. */
void exact_write_scan(const struct triangle_scan *mesh, uint32_t chunk_triangles);

struct exact_setup {
    unsigned threads;
    uint64_t memory;
    bool two_sided, flat, color, facing_origin;
    double t_min, t_max;
    const struct bake_exact_footprint *footprint; /* of all rays */
};

/* Traces through the scan, in as many batches as it takes, in a context of its own. */
void exact_trace(const struct exact_setup *setup, const struct bake_exact_ray *rays, uint64_t count,
                 struct bake_exact_hit *hits);
/* One ray along z. */
struct bake_exact_hit exact_trace_one(const struct exact_setup *setup, float x, float y, float z,
                                      float dz);
/* Origins between low and high on each axis; every 16th along an axis. */
void exact_random_rays(struct bake_exact_ray *rays, uint64_t count, double low, double high);

#endif
