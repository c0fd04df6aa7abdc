/* traced_sheet.c - makes and traces the sheet. */
#include "tests/unit/fixture.h"
#include "tests/unit/libbake/device/traced_sheet.h"

#include "tests/unit/libbake/analytic_grid.h"

/* Computes the linear colour of the sheet at (u, v) of its frame. */
static void color_at(double u, double v, float color[3])
{
    color[0] = (float)(0.5 + 0.5 * sin(u / 5));
    color[1] = (float)(0.5 + 0.5 * cos(v / 7));
    color[2] = 0.25f;
}

/* Adds the wavy coloured sheet to a grid. */
static void add_sheet(struct analytic_grid *grid, const struct analytic_sine *sine)
{
    const int n = (int)(2 * sine->half * 8);
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) {
            double u = -sine->half + (i + 0.5) / 8, v = -sine->half + (j + 0.5) / 8;
            double point[3], normal[3];
            float color[3];
            analytic_sine_point(sine, u, v, analytic_sine_height(sine, u, v), point);
            analytic_sine_normal(sine, u, v, normal);
            color_at(u, v, color);
            analytic_grid_add(grid, point, normal, 1 / 64., color);
        }
}

static void set_corner(struct bk_triangle *triangle, int corner, const struct analytic_sine *sine,
                       double u, double v)
{
    double point[3];
    analytic_sine_point(sine, u, v, -0.7, point);
    for (int k = 0; k < 3; k++) {
        triangle->position[corner][k] = (float)point[k];
        triangle->direction[corner][k] = triangle->normal[corner][k] = (float)sine->axes[2][k];
        triangle->tangent[corner][k] = (float)sine->axes[0][k];
    }
    triangle->reach[corner] = (float)corner;
    triangle->tangent[corner][3] = -1; /* the map's y runs opposite to v */
}

static void make_square(struct fixture *f, const struct analytic_sine *sine, double half)
{
    struct bk_triangle *a = &f->triangles[0], *b = &f->triangles[1];
    *a = (struct bk_triangle){.b1 = {1.f / WIDTH, 0, 0}, .b2 = {0, 1.f / HEIGHT, 0}};
    *b = (struct bk_triangle){
        .x0 = WIDTH, .y0 = HEIGHT, .b1 = {-1.f / WIDTH, 0, 0}, .b2 = {0, -1.f / HEIGHT, 0}};
    set_corner(a, 0, sine, -half, -half);
    set_corner(a, 1, sine, half, -half);
    set_corner(a, 2, sine, -half, half);
    set_corner(b, 0, sine, half, half);
    set_corner(b, 1, sine, -half, half);
    set_corner(b, 2, sine, half, -half);
}

int traced_sheet_setup(void **state)
{
    struct fixture *f = calloc(1, sizeof *f);
    const double centre[3] = {60, -40, 20};
    struct analytic_sine sine = analytic_sine_make(16, 30, centre);
    struct analytic_grid *grid = analytic_grid_create();
    const uint32_t row = WIDTH * SAMPLES;

    f->ctx = test_context(2, 0);
    add_sheet(grid, &sine);
    analytic_grid_open(f->ctx, grid, true, &f->grid);
    analytic_grid_free(grid);
    /* The square is larger than the sheet, so that some rays miss. */
    make_square(f, &sine, 32);
    f->samples = malloc(sizeof *f->samples * row * HEIGHT * SAMPLES);
    for (uint32_t j = 0; j < HEIGHT * SAMPLES; j++)
        for (uint32_t i = 0; i < row; i++) {
            bool upper = i * HEIGHT * SAMPLES + j * row < row * HEIGHT * SAMPLES;
            f->samples[j * row + i] = i < 3 ? BK_NO_TRIANGLE : upper ? 0 : 1;
        }
    f->job = (struct bake_scene){.grid = &f->grid,
                                 .triangles = f->triangles,
                                 .triangle_count = 2,
                                 .patch_texels = TEXELS,
                                 .params = {.maps = BAKE_MAP_NORMAL | BAKE_MAP_COLOR,
                                            .samples = SAMPLES,
                                            .unit = 1,
                                            .front = 5,
                                            .back = 5}};
    bake_params_from_grid(&f->grid, &f->job.params);
    *state = f;
    return 0;
}

int traced_sheet_teardown(void **state)
{
    struct fixture *f = *state;
    fmt_nvdb_close(f->ctx, &f->grid);
    test_context_end(f->ctx);
    free(f->samples);
    free(f);
    return 0;
}

struct sheet_texel *traced_sheet_trace(struct fixture *f, const char *name, unsigned worker)
{
    const struct bk_patch patch = {.width = WIDTH, .height = HEIGHT};
    struct sheet_texel *texels = calloc(TEXELS, sizeof *texels);
    struct bake_device *device;

    if (bake_device_open(f->ctx, name, &f->job, &device) < 0) {
        print_message("%s\n", bsq_error(f->ctx));
        free(texels);
        return NULL;
    }
    assert_int_equal(bake_device_trace(device, &patch, f->samples, (float *)texels, worker), 0);
    bake_device_close(device);
    return texels;
}

struct sheet_texel *traced_sheet_trace_dense(struct fixture *f, const char *name, uint32_t n,
                                             uint64_t *launches)
{
    const struct bk_patch patch = {
        .x = WIDTH / 2, .y = HEIGHT / 2, .width = DENSE_WIDTH, .height = DENSE_HEIGHT};
    struct sheet_texel *texels = calloc(DENSE_TEXELS, sizeof *texels);
    uint32_t *samples = calloc(DENSE_TEXELS, n * n * sizeof *samples);
    struct bake_scene job = f->job;
    struct bake_device_times times;
    struct bake_device *device;

    job.params.samples = n;
    job.patch_texels = DENSE_TEXELS;
    for (uint32_t i = 0; i < DENSE_TEXELS * n * n; i += 7)
        samples[i] = i % 2 ? 1 : BK_NO_TRIANGLE;
    if (bake_device_open(f->ctx, name, &job, &device) < 0) {
        print_message("%s\n", bsq_error(f->ctx));
        free(texels);
        free(samples);
        return NULL;
    }
    assert_int_equal(bake_device_trace(device, &patch, samples, (float *)texels, 0), 0);
    bake_device_times(device, &times);
    *launches = times.launches;
    bake_device_close(device);
    free(samples);
    return texels;
}
