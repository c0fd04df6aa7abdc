/* analytic_grid.c - collects samples in a hash table of voxels. Aborts without memory. */
#include "tests/unit/libbake/analytic_grid.h"
#include "tests/unit/fixture.h"
#include "tests/unit/formats/grid/nvdb_scene.h"

#include "base/geometry/vec.h"

#define PI 3.14159265358979323846

struct sheet {
    double area, normal[3], moment[3], color[3];
};

struct cell {
    int32_t at[3];
    bool used;
    struct sheet sheets[2];
};

struct analytic_grid {
    struct cell *cells; /* open addressing */
    uint64_t capacity, count;
    uint32_t facet_noise;
    double min[3], max[3]; /* of the samples */
};

static void *must(void *memory)
{
    if (!memory)
        abort();
    return memory;
}

struct analytic_grid *analytic_grid_create(void)
{
    struct analytic_grid *grid = must(calloc(1, sizeof *grid));
    grid->capacity = 1024;
    grid->cells = must(calloc(grid->capacity, sizeof *grid->cells));
    for (int k = 0; k < 3; k++) {
        grid->min[k] = INFINITY;
        grid->max[k] = -INFINITY;
    }
    return grid;
}

void analytic_grid_free(struct analytic_grid *grid)
{
    free(grid->cells);
    free(grid);
}

void analytic_grid_set_facet_noise(struct analytic_grid *grid, uint32_t facet_noise)
{
    grid->facet_noise = facet_noise;
}

/* Returns the entry of a voxel, which may still be unused. */
static struct cell *find(struct cell *cells, uint64_t capacity, const int32_t at[3])
{
    uint64_t h = (uint32_t)at[0] * UINT64_C(0x9e3779b97f4a7c15);
    h = (h ^ (uint32_t)at[1]) * UINT64_C(0xc2b2ae3d27d4eb4f);
    h = (h ^ (uint32_t)at[2]) * UINT64_C(0x165667b19e3779f9);
    for (uint64_t i = h >> 20;; i++) {
        struct cell *cell = &cells[i & (capacity - 1)];
        if (!cell->used || memcmp(cell->at, at, sizeof cell->at) == 0)
            return cell;
    }
}

static void grow(struct analytic_grid *grid)
{
    uint64_t capacity = grid->capacity * 2;
    struct cell *cells = must(calloc(capacity, sizeof *cells));
    for (uint64_t i = 0; i < grid->capacity; i++)
        if (grid->cells[i].used)
            *find(cells, capacity, grid->cells[i].at) = grid->cells[i];
    free(grid->cells);
    grid->cells = cells;
    grid->capacity = capacity;
}

void analytic_grid_add(struct analytic_grid *grid, const double position[3], const double normal[3],
                       double area, const float color[3])
{
    int32_t at[3];
    for (int k = 0; k < 3; k++) {
        at[k] = (int32_t)floor(position[k] + 0.5);
        grid->min[k] = fmin(grid->min[k], position[k]);
        grid->max[k] = fmax(grid->max[k], position[k]);
    }
    struct cell *cell = find(grid->cells, grid->capacity, at);
    if (!cell->used) {
        if (2 * ++grid->count > grid->capacity) {
            grow(grid);
            cell = find(grid->cells, grid->capacity, at);
        }
        cell->used = true;
        memcpy(cell->at, at, sizeof at);
    }
    const double *first = cell->sheets[0].normal;
    double agreement = first[0] * normal[0] + first[1] * normal[1] + first[2] * normal[2];
    struct sheet *sheet = &cell->sheets[cell->sheets[0].area > 0 && agreement < 0];
    sheet->area += area;
    for (int k = 0; k < 3; k++) {
        sheet->normal[k] += area * normal[k];
        sheet->moment[k] += area * (position[k] - at[k]);
        sheet->color[k] += area * (color ? color[k] : 1.0);
    }
}

static uint32_t srgb_byte(double linear)
{
    double c = linear <= 0.0031308 ? 12.92 * linear : 1.055 * pow(linear, 1 / 2.4) - 0.055;
    return (uint32_t)lrint(255 * fmin(fmax(c, 0), 1));
}

static struct fmt_nvdb_record record_of(const struct sheet *sheet, bool has_second, bool has_color)
{
    const double *n = sheet->normal;
    double length = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]), offset = 0;
    struct fmt_nvdb_record record = {0};
    for (int k = 0; k < 3; k++)
        offset += n[k] / length * sheet->moment[k] / sheet->area;
    record.normal = bsq_oct_pack(
        bsq_v3((float)(n[0] / length), (float)(n[1] / length), (float)(n[2] / length)));
    record.plane = (uint32_t)(uint16_t)(int16_t)lrint(offset * 32767) |
                   (uint32_t)lrint(255 * length / sheet->area) << 16 |
                   (has_second ? FMT_NVDB_PLANE_SECOND : 0);
    if (has_color)
        for (int k = 0; k < 3; k++)
            record.color |= srgb_byte(sheet->color[k] / sheet->area) << 8 * k;
    return record;
}

void analytic_grid_write(const struct analytic_grid *grid, bool has_color, const char *path)
{
    struct scene scene = {.info = {.voxel_size = 1, .has_color = has_color},
                          .voxels = must(calloc(grid->count, sizeof *scene.voxels))};
    struct fmt_nvdb_totals totals;
    for (uint64_t i = 0; i < grid->capacity; i++) {
        const struct cell *cell = &grid->cells[i];
        if (!cell->used)
            continue;
        struct scene_voxel *voxel = &scene.voxels[scene.count++];
        const bool has_second = cell->sheets[1].area > 0;
        memcpy(voxel->ijk, cell->at, sizeof voxel->ijk);
        voxel->first = record_of(&cell->sheets[0], has_second, has_color);
        voxel->first.plane |= grid->facet_noise << FMT_NVDB_FACET_NOISE_SHIFT;
        if (has_second)
            voxel->second = record_of(&cell->sheets[1], false, has_color);
    }
    scene_sort(&scene);
    memcpy(scene.info.scan_min, grid->min, sizeof grid->min);
    memcpy(scene.info.scan_max, grid->max, sizeof grid->max);
    struct bsq_ctx *ctx = test_context(1, 0);
    assert_int_equal(scene_write(ctx, path, &scene, &totals), 0);
    scene_free(&scene);
    test_context_end(ctx);
}

void analytic_grid_open(struct bsq_ctx *ctx, const struct analytic_grid *grid, bool has_color,
                        struct fmt_nvdb_grid *out)
{
    analytic_grid_write(grid, has_color, "analytic.nvdb");
    bsq_forget_files(ctx);
    assert_int_equal(fmt_nvdb_open(ctx, "analytic.nvdb", out), 0);
    unlink("analytic.nvdb");
}

void analytic_sphere(struct analytic_grid *grid, const double centre[3], double radius,
                     double density)
{
    uint64_t bands = (uint64_t)(PI * radius * density) + 1;
    for (uint64_t r = 0; r < bands; r++) {
        double latitude = PI * (r + 0.5) / bands, z = cos(latitude), s = sin(latitude);
        uint64_t steps = (uint64_t)(2 * PI * radius * s * density) + 1;
        double share = cos(PI * r / bands) - cos(PI * (r + 1) / bands);
        double area = 2 * PI * radius * radius * share / steps;
        for (uint64_t i = 0; i < steps; i++) {
            double angle = 2 * PI * (i + 0.5) / steps;
            double n[3] = {s * cos(angle), s * sin(angle), z}, p[3];
            for (int k = 0; k < 3; k++)
                p[k] = centre[k] + radius * n[k];
            analytic_grid_add(grid, p, n, area, NULL);
        }
    }
}

struct analytic_sine analytic_sine_make(double wavelength, double half, const double centre[3])
{
    /* Quaternion (1, 2, 3, 4) / sqrt(30), row by row. */
    struct analytic_sine sine = {.axes = {{-20 / 30., 20 / 30., 10 / 30.},
                                          {4 / 30., -10 / 30., 28 / 30.},
                                          {22 / 30., 20 / 30., 4 / 30.}},
                                 .wavelength = wavelength,
                                 .amplitude = tan(20 * PI / 180) * wavelength / (2 * PI),
                                 .half = half};
    memcpy(sine.centre, centre, sizeof sine.centre);
    return sine;
}

double analytic_sine_height(const struct analytic_sine *sine, double u, double v)
{
    double k = 2 * PI / sine->wavelength;
    return sine->amplitude * sin(k * u) * sin(k * v);
}

static void slopes(const struct analytic_sine *sine, double u, double v, double *du, double *dv)
{
    double k = 2 * PI / sine->wavelength;
    *du = sine->amplitude * k * cos(k * u) * sin(k * v);
    *dv = sine->amplitude * k * sin(k * u) * cos(k * v);
}

void analytic_sine_normal(const struct analytic_sine *sine, double u, double v, double normal[3])
{
    double du, dv;
    slopes(sine, u, v, &du, &dv);
    double scale = 1 / sqrt(1 + du * du + dv * dv);
    for (int k = 0; k < 3; k++)
        normal[k] = scale * (sine->axes[2][k] - du * sine->axes[0][k] - dv * sine->axes[1][k]);
}

void analytic_sine_point(const struct analytic_sine *sine, double u, double v, double w,
                         double point[3])
{
    for (int k = 0; k < 3; k++)
        point[k] =
            sine->centre[k] + u * sine->axes[0][k] + v * sine->axes[1][k] + w * sine->axes[2][k];
}

void analytic_sine_add(struct analytic_grid *grid, const struct analytic_sine *sine, double density)
{
    int64_t n = (int64_t)(2 * sine->half * density);
    double step = 2 * sine->half / n;
    for (int64_t i = 0; i < n; i++)
        for (int64_t j = 0; j < n; j++) {
            double u = -sine->half + (i + 0.5) * step, v = -sine->half + (j + 0.5) * step;
            double du, dv, p[3], normal[3];
            slopes(sine, u, v, &du, &dv);
            analytic_sine_point(sine, u, v, analytic_sine_height(sine, u, v), p);
            analytic_sine_normal(sine, u, v, normal);
            analytic_grid_add(grid, p, normal, step * step * sqrt(1 + du * du + dv * dv), NULL);
        }
}

double analytic_random(uint64_t *state)
{
    /* splitmix64 (Steele, Lea, Flood 2014) */
    uint64_t z = *state += UINT64_C(0x9e3779b97f4a7c15);
    z = (z ^ z >> 30) * UINT64_C(0xbf58476d1ce4e5b9);
    z = (z ^ z >> 27) * UINT64_C(0x94d049bb133111eb);
    return (double)((z ^ z >> 31) >> 11) * 0x1p-53;
}

void analytic_random_unit(uint64_t *state, double unit[3])
{
    double z = 2 * analytic_random(state) - 1, angle = 2 * PI * analytic_random(state);
    double s = sqrt(1 - z * z);
    unit[0] = s * cos(angle);
    unit[1] = s * sin(angle);
    unit[2] = z;
}

struct traced_hit analytic_trace(const struct fmt_nvdb_grid *grid, const struct bk_params *params,
                                 const float origin[3], const float direction[3], float t_min,
                                 float t_max, float facing)
{
    const struct bake_ray ray = {{origin[0], origin[1], origin[2]},
                                 {direction[0], direction[1], direction[2]}};
    struct bake_hit hit = {.triangle = BAKE_NO_HIT};
    const struct bake_ray_batch batch = {.rays = &ray,
                                         .hits = &hit,
                                         .count = 1,
                                         .t_min = (double)t_min,
                                         .t_max = (double)t_max,
                                         .facing_origin = facing < 0};
    bake_trace_rays(grid, params, 1, &batch, 0, 1);
    struct traced_hit out = {.found = hit.triangle != BAKE_NO_HIT,
                             .t = (float)hit.t,
                             .id = hit.id,
                             .reversed = hit.reversed};
    memcpy(out.normal, hit.normal, sizeof out.normal);
    memcpy(out.color, hit.color, sizeof out.color);
    return out;
}

int analytic_by_value(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

double analytic_degrees(const double a[3], const float b[3])
{
    double dot = 0, cross = 0;
    for (int k = 0; k < 3; k++) {
        int p = (k + 1) % 3, q = (k + 2) % 3;
        double c = a[p] * b[q] - a[q] * b[p];
        dot += a[k] * b[k];
        cross += c * c;
    }
    return atan2(sqrt(cross), dot) * 180 / PI;
}
