/* analytic_grid.h - voxel grids for tests, made from samples of an analytic surface, written to a
 * file and opened. */
#ifndef TEST_ANALYTIC_GRID_H
#define TEST_ANALYTIC_GRID_H

#include "formats/grid/nvdb.h"
#include "libbake/device/device.h"

struct analytic_grid;

struct analytic_grid *analytic_grid_create(void);
void analytic_grid_free(struct analytic_grid *grid);
/* Sets the facet-noise weight of all first records, 0 to FMT_NVDB_FACET_NOISE_MAX. Default: 0. */
void analytic_grid_set_facet_noise(struct analytic_grid *grid, uint32_t facet_noise);

/* Adds a small piece of surface: position in index space, unit normal, area in square voxels,
 * linear colour (NULL: white). Pieces whose normal opposes the sum of the voxel's first record go
 * to its second record. */
void analytic_grid_add(struct analytic_grid *grid, const double position[3], const double normal[3],
                       double area, const float color[3]);

/* Writes the samples to a file, as a grid with voxel size 1 and no translation. */
void analytic_grid_write(const struct analytic_grid *grid, bool has_color, const char *path);
/* Writes them to a temporary file, and opens it. */
void analytic_grid_open(struct bsq_ctx *ctx, const struct analytic_grid *grid, bool has_color,
                        struct fmt_nvdb_grid *out);

/* Adds a sphere, with about `density` samples along the side of a voxel. */
void analytic_sphere(struct analytic_grid *grid, const double centre[3], double radius,
                     double density);

/* The height field z = A sin(k x) sin(k y) in a rotated frame through `centre`, of half width
 * `half`. */
struct analytic_sine {
    double centre[3];
    double axes[3][3]; /* rows: unit u, v and w (up) */
    double wavelength, amplitude, half;
};
/* Returns a height field with slopes up to 20 degrees, rotated so that it is aligned with no axis
 * of the grid. */
struct analytic_sine analytic_sine_make(double wavelength, double half, const double centre[3]);
void analytic_sine_add(struct analytic_grid *grid, const struct analytic_sine *sine,
                       double density);
/* Return the height and the unit normal (index space) at (u, v), and the point (u, v, w). */
double analytic_sine_height(const struct analytic_sine *sine, double u, double v);
void analytic_sine_normal(const struct analytic_sine *sine, double u, double v, double normal[3]);
void analytic_sine_point(const struct analytic_sine *sine, double u, double v, double w,
                         double point[3]);

struct traced_hit {
    bool found, reversed;
    float t; /* voxels */
    float normal[3], color[3];
    uint32_t id;
};

/* Traces one ray, as bake_trace_rays() traces many. facing: 1: surfaces must face along the ray;
 * -1: against it. */
struct traced_hit analytic_trace(const struct fmt_nvdb_grid *grid, const struct bk_params *params,
                                 const float origin[3], const float direction[3], float t_min,
                                 float t_max, float facing);

/* Returns a deterministic random number in [0, 1). */
double analytic_random(uint64_t *state);
/* Computes a random unit vector. */
void analytic_random_unit(uint64_t *state, double unit[3]);

/* Compares two doubles for qsort(). */
int analytic_by_value(const void *a, const void *b);
/* Returns the angle of two vectors in degrees. */
double analytic_degrees(const double a[3], const float b[3]);

#endif
