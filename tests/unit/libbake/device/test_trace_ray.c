/* test_trace_ray.c - single rays against voxel grids of analytic surfaces: hits are compared with
 * the surfaces themselves. */
#include "libbake/device/device.h"
#include "tests/unit/sanitized.h"
#include "tests/unit/test.h"
#include "tests/unit/libbake/analytic_grid.h"

#define PI 3.14159265358979323846

SHARED_CONTEXT(context, 0)

static double mean(const double *values, size_t count)
{
    double sum = 0;
    for (size_t i = 0; i < count; i++)
        sum += values[i];
    return sum / (double)count;
}

/* Returns a percentile; sorts the values. */
static double percentile(double *values, size_t count, size_t percent)
{
    qsort(values, count, sizeof *values, analytic_by_value);
    return values[count * percent / 100];
}

TEST(test_sphere)
{
    enum { RAYS = TEST_SANITIZED ? 100000 : 1000000 };
    const double centre[3] = {100.3, -57.2, 33.7}, radius = 60, away = 1.3 * radius;
    struct analytic_grid *source = analytic_grid_create();
    double *angles = malloc(RAYS * sizeof *angles), squares = 0;
    size_t count = 0, grazing = 0, false_hits = 0;
    uint64_t seed = test_seed();
    struct bk_params params = {0};
    struct fmt_nvdb_grid grid;

    analytic_sphere(source, centre, radius, 12);
    analytic_grid_open(context, source, false, &grid);
    analytic_grid_free(source);
    bake_params_from_grid(&grid, &params);
    for (int i = 0; i < RAYS; i++) {
        double direction[3], at[3], dot = 0, square = 0, normal[3];
        float o[3], d[3];
        struct traced_hit hit;
        /* The ray goes through a point of a disc slightly larger than the sphere. */
        analytic_random_unit(&seed, direction);
        analytic_random_unit(&seed, at);
        for (int k = 0; k < 3; k++)
            dot += at[k] * direction[k];
        for (int k = 0; k < 3; k++) {
            at[k] -= dot * direction[k];
            square += at[k] * at[k];
        }
        double offset = 1.02 * radius * sqrt(analytic_random(&seed));
        for (int k = 0; k < 3; k++) {
            at[k] *= offset / sqrt(square);
            o[k] = (float)(centre[k] + at[k] - away * direction[k]);
            d[k] = (float)direction[k];
        }
        hit = analytic_trace(&grid, &params, o, d, 0, 1000, -1);
        if (offset >= radius) {
            /* The silhouette may grow by 0.1 voxels at most. */
            assert_true(!hit.found || offset < radius + 0.1);
            false_hits += hit.found;
            continue;
        }
        if (!hit.found) {
            assert_true(offset > radius - 0.1);
            grazing++;
            continue;
        }
        double half = sqrt(radius * radius - offset * offset);
        for (int k = 0; k < 3; k++)
            normal[k] = (at[k] - half * direction[k]) / radius;
        angles[count++] = analytic_degrees(normal, hit.normal);
        squares += (hit.t - (away - half)) * (hit.t - (away - half));
    }
    double rms = sqrt(squares / (double)count), average = mean(angles, count);
    double p95 = percentile(angles, count, 95);
    print_message("sphere: rms distance %.4f voxels, normals %.3f / %.3f degrees; grazing rays: %d "
                  "missed, %d hit falsely\n",
                  rms, average, p95, (int)grazing, (int)false_hits);
    assert_true(grazing < 1e-4 * RAYS && false_hits < 1e-3 * RAYS);
    assert_true(rms < 0.1);
    /* A voxel spans 0.95 degrees of this sphere. */
    assert_true(average < 0.06 && p95 < 0.15);
    fmt_nvdb_close(context, &grid);
    free(angles);
}

struct sine_errors {
    double average, p95; /* angles in degrees */
    double gain;         /* regression of the slopes onto those of the formula */
};

/* Adds up, for the regression, the products of a normal's slopes and the formula's, and the squares
 * of the formula's. Slopes are against the base plane. */
static void add_slopes(const struct analytic_sine *sine, const double truth[3],
                       const float normal[3], double *products, double *squares)
{
    double t[3] = {0}, n[3] = {0};
    for (int axis = 0; axis < 3; axis++)
        for (int k = 0; k < 3; k++) {
            t[axis] += sine->axes[axis][k] * truth[k];
            n[axis] += sine->axes[axis][k] * normal[k];
        }
    for (int axis = 0; axis < 2; axis++) {
        *products += t[axis] / t[2] * n[axis] / n[2];
        *squares += t[axis] / t[2] * t[axis] / t[2];
    }
}

/* Traces rays along the base plane's normal from below and above the surface. Every ray has to hit.
 */
static struct sine_errors trace_sine(double wavelength, uint32_t flags, uint32_t facet_noise)
{
    enum { RAYS = TEST_SANITIZED ? 15000 : 150000 };
    const double centre[3] = {100.3, -57.2, 33.7};
    struct analytic_sine sine = analytic_sine_make(wavelength, 40, centre);
    struct analytic_grid *source = analytic_grid_create();
    double *angles = malloc(RAYS * sizeof *angles), worst = 0, products = 0, squares = 0;
    uint64_t seed = test_seed();
    struct sine_errors errors;
    struct bk_params params = {.flags = flags};
    struct fmt_nvdb_grid grid;

    analytic_sine_add(source, &sine, 12);
    analytic_grid_set_facet_noise(source, facet_noise);
    analytic_grid_open(context, source, false, &grid);
    analytic_grid_free(source);
    bake_params_from_grid(&grid, &params);
    for (int i = 0; i < RAYS; i++) {
        double u = 74 * (analytic_random(&seed) - 0.5), v = 74 * (analytic_random(&seed) - 0.5);
        double w = 20 * (analytic_random(&seed) - 0.5), at[3], normal[3];
        float o[3], d[3];
        struct traced_hit hit;
        analytic_sine_point(&sine, u, v, w, at);
        for (int k = 0; k < 3; k++) {
            o[k] = (float)at[k];
            d[k] = (float)sine.axes[2][k];
        }
        hit = analytic_trace(&grid, &params, o, d, -20, 20, 1);
        assert_true(hit.found);
        worst = fmax(worst, fabs(hit.t - (analytic_sine_height(&sine, u, v) - w)));
        analytic_sine_normal(&sine, u, v, normal);
        angles[i] = analytic_degrees(normal, hit.normal);
        add_slopes(&sine, normal, hit.normal, &products, &squares);
    }
    errors.average = mean(angles, RAYS);
    errors.p95 = percentile(angles, RAYS, 95);
    errors.gain = products / squares;
    print_message(
        "wavelength %g voxels, facet noise %u: normals %.3f / %.3f degrees, slopes %.4f of the "
        "formula's, distance within "
        "%.3f voxels\n",
        wavelength, facet_noise, errors.average, errors.p95, errors.gain, worst);
    /* A single plane errs more if it only cuts a corner of its voxel. */
    assert_true(worst < (flags & BK_NEAREST ? 0.25 : 0.1));
    fmt_nvdb_close(context, &grid);
    free(angles);
    return errors;
}

/* Trilinear blending of the normals alone errs by 6.4, 1.95, 0.54 and 0.155 degrees on average, and
 * by 9.6, 3.0, 0.83 and 0.27 at the 95th percentile; the planes' offsets must improve on that.
 * Means over voxels lower slopes by (2 pi / wavelength)^2 / 12: by 0.051, 0.013 and 0.003 from 8
 * voxels on. Only higher terms of this loss may remain. */
TEST(test_sine_accuracy)
{
    static const struct {
        double wavelength, average, p95, slack;
    } limits[] = {
        {4, 2.3, 4.4, 0.15}, {8, 0.7, 1.5, 0.01}, {16, 0.3, 0.7, 0.002}, {32, 0.14, 0.33, 0.001}};
    for (size_t i = 0; i < sizeof limits / sizeof *limits; i++) {
        struct sine_errors errors = trace_sine(limits[i].wavelength, 0, 0);
        assert_true(errors.average < limits[i].average && errors.p95 < limits[i].p95);
        assert_true(fabs(errors.gain - 1) < limits[i].slack);
    }
}

/* The facet-noise weight determines how much of that loss remains. */
TEST(test_facet_noise)
{
    for (uint32_t facet_noise = 3; facet_noise <= FMT_NVDB_FACET_NOISE_MAX; facet_noise += 2) {
        struct sine_errors errors = trace_sine(16, 0, facet_noise);
        double left = (2 * PI / 16) * (2 * PI / 16) / 12 * facet_noise / FMT_NVDB_FACET_NOISE_MAX;
        assert_true(fabs(errors.gain - (1 - left)) < 0.002);
    }
}

/* The normal of the nearest voxel errs by about the change of the slope over half a voxel. */
TEST(test_sine_nearest)
{
    struct sine_errors errors = trace_sine(16, BK_NEAREST, 0);
    assert_true(errors.average > 1 && errors.average < 2.1 && errors.p95 < 4.4);
}

/* A ridge whose sides slope by 40 degrees, not aligned with the grid. A voxel on the ridge has the
 * normal of neither side. With the same weight as other voxels, it would make normals within two
 * voxels of the ridge err by 4.7 degrees on average, and 22 % of them by more than 5. */
TEST(test_crease)
{
    enum { RAYS = TEST_SANITIZED ? 20000 : 200000, CELLS = 480 };
    const double centre[3] = {100.3, -57.2, 33.7}, slope = tan(40 * PI / 180);
    const struct analytic_sine frame = analytic_sine_make(100, 20, centre);
    struct analytic_grid *source = analytic_grid_create();
    double *angles = malloc(RAYS * sizeof *angles), normals[2][3], at[3];
    uint64_t seed = test_seed();
    struct bk_params params = {0};
    struct fmt_nvdb_grid grid;
    size_t above = 0;

    for (int side = 0; side < 2; side++)
        for (int k = 0; k < 3; k++)
            normals[side][k] = (frame.axes[2][k] + (side ? slope : -slope) * frame.axes[0][k]) /
                               sqrt(1 + slope * slope);
    for (int i = 0; i < CELLS; i++)
        for (int j = 0; j < CELLS; j++) {
            double u = (i + 0.5) / 12 - 20, v = (j + 0.5) / 12 - 20;
            analytic_sine_point(&frame, u, v, -slope * fabs(u), at);
            analytic_grid_add(source, at, normals[u > 0], sqrt(1 + slope * slope) / 144, NULL);
        }
    analytic_grid_open(context, source, false, &grid);
    analytic_grid_free(source);
    bake_params_from_grid(&grid, &params);
    for (int i = 0; i < RAYS; i++) {
        double u = 4 * (analytic_random(&seed) - 0.5), v = 30 * (analytic_random(&seed) - 0.5);
        float o[3], d[3];
        struct traced_hit hit;
        analytic_sine_point(&frame, u, v, 10, at);
        for (int k = 0; k < 3; k++) {
            o[k] = (float)at[k];
            d[k] = -(float)frame.axes[2][k];
        }
        hit = analytic_trace(&grid, &params, o, d, 0, 20, -1);
        assert_true(hit.found);
        angles[i] = analytic_degrees(normals[u > 0], hit.normal);
        above += angles[i] > 5;
    }
    double average = mean(angles, RAYS), share = (double)above / RAYS;
    print_message("ridge: normals within two voxels err by %.2f degrees, %.3f by more than 5\n",
                  average, share);
    assert_true(average < 4.1 && share < 0.19);
    fmt_nvdb_close(context, &grid);
    free(angles);
}

static void add_plane(struct analytic_grid *grid, double z, double up, const float color[3])
{
    for (int i = 0; i < 40 * 8; i++)
        for (int j = 0; j < 40 * 8; j++) {
            double at[3] = {(i + 0.5) / 8 - 20, (j + 0.5) / 8 - 20, z};
            double normal[3] = {0, 0, up};
            analytic_grid_add(grid, at, normal, 1 / 64., color);
        }
}

/* A plate 0.4 voxels thick, red above and blue below. A hit has the colour and normal of the side
 * that the ray faces, even if the ray starts on the other side or inside. If the plate lies at a
 * border of its voxels, rounding can put a side just outside of them. */
TEST(test_thin_plate)
{
    static const float red[3] = {1, 0, 0}, blue[3] = {0, 0, 1};
    uint64_t seed = test_seed();
    struct bk_params params = {0};
    struct fmt_nvdb_grid grid;

    /* The plate lies inside a layer of voxels, between two layers, and at the lower border of one.
     */
    static const double places[] = {3.0, 3.5, 2.7, 2.7};
    for (int place = 0; place < 4; place++) {
        const double z = places[place];
        const int first = place == 3 ? 1 : 0; /* side that is added first */
        struct analytic_grid *source = analytic_grid_create();
        for (int side = first; side < first + 2; side++)
            add_plane(source, side & 1 ? z - 0.2 : z + 0.2, side & 1 ? -1 : 1,
                      side & 1 ? blue : red);
        analytic_grid_open(context, source, true, &grid);
        analytic_grid_free(source);
        assert_true(place == 1 || grid.record_count == 1 + 2 * grid.voxel_count);
        bake_params_from_grid(&grid, &params);
        for (int i = 0; i < 20000; i++) {
            float up = i & 1 ? 1 : -1;
            float direction[3] = {0.6f * (float)(i % 3 - 1), 0, 0}, origin[3];
            struct traced_hit hit;
            direction[2] = up * sqrtf(1 - direction[0] * direction[0]);
            for (int k = 0; k < 3; k++)
                origin[k] = (float)(20 * (analytic_random(&seed) - 0.5));
            origin[2] = (float)(z + 2 * (analytic_random(&seed) - 0.5));
            hit = analytic_trace(&grid, &params, origin, direction, -5, 5, 1);
            assert_true(hit.found);
            assert_true(hit.normal[2] * up > 0.999f);
            assert_true(fabsf(hit.color[up > 0 ? 0 : 2] - 1) < 1e-5f);
            assert_true(hit.color[up > 0 ? 2 : 0] == 0);
            double expected = (z + 0.2 * up - origin[2]) / direction[2];
            assert_true(fabs(hit.t - expected) < 1e-3);
        }
        /* A two-sided ray hits the nearer side. */
        struct bk_params both = params;
        both.flags |= BK_TWO_SIDED;
        for (int i = 0; i < 20000; i++) {
            float direction[3] = {0, 0, i & 1 ? 1 : -1}, origin[3] = {1.3f, 2.2f, 0};
            struct traced_hit hit;
            double from = z + 2 * (analytic_random(&seed) - 0.5);
            origin[2] = (float)from;
            if (fabs(from - z) < 1e-3)
                continue;
            hit = analytic_trace(&grid, &both, origin, direction, -5, 5, 1);
            assert_true(hit.found && hit.color[from > z ? 0 : 2] > 0.999f);
        }
        fmt_nvdb_close(context, &grid);
    }
}

/* Hits outside [t_min, t_max] are ignored; of two sheets the nearer one is hit. */
TEST(test_range)
{
    struct analytic_grid *source = analytic_grid_create();
    struct bk_params params = {0};
    struct fmt_nvdb_grid grid;
    static const struct {
        float z, t_min, t_max;
        bool found;
        float t;
    } cases[] = {
        {0, -20, 20, true, 3},    {-4, -20, 20, true, 7},  {8, -20, 20, true, -5},
        {9, -20, 20, true, 5},    {8, 0, 20, true, 6},     {8, -20, 0, true, -5},
        {0, -20, 2.5f, false, 0}, {0, 3.5f, 13, false, 0}, {0, 3.5f, 15, true, 14},
        {20, -5, 20, false, 0},   {20, -7, 20, true, -6},  {20, -20, -7, true, -17},
        {0, 20, -20, false, 0},   {3, -20, 20, true, 0},   {3.0625f, -20, 20, true, -0.0625f},
    };

    add_plane(source, 3, 1, NULL);
    add_plane(source, 14, 1, NULL);
    analytic_grid_open(context, source, false, &grid);
    analytic_grid_free(source);
    bake_params_from_grid(&grid, &params);
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        float origin[3] = {0.3f, -0.7f, cases[i].z}, direction[3] = {0, 0, 1};
        struct traced_hit hit;
        hit = analytic_trace(&grid, &params, origin, direction, cases[i].t_min, cases[i].t_max, 1);
        assert_int_equal(hit.found, cases[i].found);
        if (hit.found)
            assert_true(fabsf(hit.t - cases[i].t) < 1e-3f);
    }
    fmt_nvdb_close(context, &grid);
}

/* The difference of such an index and a ray's origin would overflow the kernel's integers. */
TEST(test_voxels_at_the_ends_of_the_index_range_are_refused)
{
    static const struct {
        double low, high;
        int status;
    } cases[] = {{-2147483648.0, 2147483647.0, BSQ_EDATA},
                 {0, 2147483647.0, BSQ_EDATA},
                 {-1073741825.0, 0, BSQ_EDATA},
                 {0, 1073741824.0, BSQ_EDATA},
                 {-1073741824.0, 1073741823.0, 0}};

    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct analytic_grid *source = analytic_grid_create();
        const double low[3] = {3, cases[i].low, 5}, high[3] = {3, cases[i].high, 5};
        const double up[3] = {0, 1, 0};
        struct fmt_nvdb_grid grid;
        analytic_grid_add(source, low, up, 1, NULL);
        analytic_grid_add(source, high, up, 1, NULL);
        analytic_grid_open(context, source, false, &grid);
        analytic_grid_free(source);
        assert_int_equal(bake_check_grid(context, &grid), cases[i].status);
        fmt_nvdb_close(context, &grid);
        bsq_clear_error(context);
    }
}

RUN_TESTS(open_context, close_context)
