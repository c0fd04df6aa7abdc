/* analytic_grid.h - grids for tests from samples of an analytic surface, written and opened through
 * the file format. Shared by the tests of libbake. */
#ifndef TEST_ANALYTIC_GRID_H
#define TEST_ANALYTIC_GRID_H

#include "formats/grid/nvdb.h"

struct analytic_grid;

struct analytic_grid *analytic_grid_create(void);
void analytic_grid_free(struct analytic_grid *grid);
/* Of all first records, 0 to FMT_NVDB_FACET_NOISE_MAX; 0 before. */
void analytic_grid_set_grain(struct analytic_grid *grid, uint32_t grain);

/* Adds a small piece of surface: position in index space, unit normal, area in voxels squared,
 * linear colour (NULL: white). Pieces whose normal opposes the voxel's first ones make its second
 * record. */
void analytic_grid_add(struct analytic_grid *grid, const double position[3], const double normal[3],
                       double area, const float color[3]);

/* Writes the samples to a temporary file and opens it as a grid of voxel size 1 and no translation.
 */
void analytic_grid_open(struct bsq_ctx *ctx, const struct analytic_grid *grid, bool has_color,
                        struct fmt_nvdb_grid *out);

/* A sphere, sampled about `density` times a voxel's side. */
void analytic_sphere(struct analytic_grid *grid, const double centre[3], double radius,
                     double density);

/* The height field z = A sin(k x) sin(k y) in a rotated frame through `centre`, of half width
 * `half`. */
struct analytic_sine {
    double centre[3];
    double axes[3][3]; /* rows: unit u, v and w (up) */
    double wavelength, amplitude, half;
};
/* A slope up to 20 degrees, rotated so that no axis of the grid is special. */
struct analytic_sine analytic_sine_make(double wavelength, double half, const double centre[3]);
void analytic_sine_add(struct analytic_grid *grid, const struct analytic_sine *sine,
                       double density);
/* Height and unit normal (index space) at (u, v). */
double analytic_sine_height(const struct analytic_sine *sine, double u, double v);
void analytic_sine_normal(const struct analytic_sine *sine, double u, double v, double normal[3]);
void analytic_sine_point(const struct analytic_sine *sine, double u, double v, double w,
                         double point[3]);

/* A small deterministic generator: uniform in [0, 1). */
double analytic_random(uint64_t *state);
void analytic_random_unit(uint64_t *state, double unit[3]);

#endif
