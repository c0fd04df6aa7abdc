/* generate_sine.c - a patch of z = a sin(k x) sin(k y) over a plane that is parallel to no axis, so
 * that voxels meet it at every angle. The steepest slope is 20 degrees for any wavelength: two
 * patches differ only in the length of a wave in voxels. */
#include "tests/scan/generate_options.h"
#include "tests/scan/permutation.h"
#include "tests/scan/text_writer.h"

#include <math.h>

#define SLOPE  (20 / 57.29577951308232)
#define SIDE   100.0 /* of the low-poly mesh, world units; OBJ numbers have six decimals */
#define MARGIN 4.0   /* by which the scan extends beyond the low-poly mesh */

struct patch {
    struct text_writer text;
    double axis[3][3]; /* x, y along the plane, z up */
    double k, height;
    double offset[3];
    uint64_t cells; /* along a side */
};

static void set_axes(double axis[3][3])
{
    const double a = 0.6, b = 0.9, c = 0.4;
    const double along[3] = {cos(a), sin(a), 0};
    const double across[3] = {-sin(a) * cos(b), cos(a) * cos(b), sin(b)};
    const double up[3] = {sin(a) * sin(b), -cos(a) * sin(b), cos(b)};
    for (int i = 0; i < 3; i++) {
        axis[0][i] = cos(c) * along[i] + sin(c) * across[i];
        axis[1][i] = cos(c) * across[i] - sin(c) * along[i];
        axis[2][i] = up[i];
    }
}

static void put_vector(struct patch *patch, const char *keyword, double x, double y, double z,
                       const double offset[3])
{
    text_string(&patch->text, keyword);
    for (int i = 0; i < 3; i++)
        text_real(&patch->text, x * patch->axis[0][i] + y * patch->axis[1][i] +
                                    z * patch->axis[2][i] + offset[i]);
    text_string(&patch->text, "\n");
}

static void put_grid(struct patch *patch, int normals)
{
    static const double nowhere[3] = {0, 0, 0};
    for (uint64_t j = 0; j <= patch->cells; j++)
        for (uint64_t i = 0; i <= patch->cells; i++) {
            const double step = (SIDE + 2 * MARGIN) / (double)patch->cells;
            const double x = (double)i * step - MARGIN, y = (double)j * step - MARGIN;
            const double sx = sin(patch->k * x), cx = cos(patch->k * x);
            const double sy = sin(patch->k * y), cy = cos(patch->k * y);
            const double slope = patch->height * patch->k, dx = slope * cx * sy,
                         dy = slope * sx * cy;
            const double length = sqrt(dx * dx + dy * dy + 1);
            if (normals)
                put_vector(patch, "vn", -dx / length, -dy / length, 1 / length, nowhere);
            else
                put_vector(patch, "v", x, y, patch->height * sx * sy, patch->offset);
        }
}

static void put_triangle(struct patch *patch, uint64_t index, int normals)
{
    const uint64_t row = patch->cells + 1;
    const uint64_t at = index / 2 / patch->cells * row + index / 2 % patch->cells + 1;
    const uint64_t lower[3] = {at, at + 1, at + row + 1}, upper[3] = {at, at + row + 1, at + row};
    text_string(&patch->text, "f");
    for (int corner = 0; corner < 3; corner++) {
        const uint64_t vertex = index & 1 ? upper[corner] : lower[corner];
        text_string(&patch->text, " ");
        text_integer(&patch->text, vertex);
        if (normals) {
            text_string(&patch->text, "//");
            text_integer(&patch->text, vertex);
        }
    }
    text_string(&patch->text, "\n");
}

static void open_patch(struct patch *patch, const struct generate_options *options)
{
    set_axes(patch->axis);
    patch->k = 6.283185307179586 / (options->wavelength > 0 ? options->wavelength : 10);
    patch->height = tan(SLOPE) / patch->k;
    for (int i = 0; i < 3; i++)
        patch->offset[i] = options->offset[i];
    text_open(&patch->text, options->output);
}

void generate_sine(const struct generate_options *options)
{
    struct patch patch = {.cells = (uint64_t)fmax(1, round(sqrt((double)options->triangles / 2)))};
    open_patch(&patch, options);
    put_grid(&patch, 0);
    if (options->normals)
        put_grid(&patch, 1);
    const uint64_t count = 2 * patch.cells * patch.cells;
    for (uint64_t n = 0; n < count; n++)
        put_triangle(&patch, options->shuffle ? scan_permute(n, count, options->seed) : n,
                     options->normals);
    text_close(&patch.text);
}

void generate_sine_low(const struct generate_options *options)
{
    static const double corner[4][2] = {{0, 0}, {1, 0}, {1, 1}, {0, 1}}, nowhere[3] = {0, 0, 0};
    struct patch patch = {.cells = 1};
    open_patch(&patch, options);
    for (int i = 0; i < 4; i++)
        put_vector(&patch, "v", SIDE * corner[i][0], SIDE * corner[i][1], 0, patch.offset);
    for (int i = 0; i < 4; i++) {
        text_string(&patch.text, "vt");
        text_real(&patch.text, corner[i][0]);
        text_real(&patch.text, corner[i][1]);
        text_string(&patch.text, "\n");
    }
    put_vector(&patch, "vn", 0, 0, 1, nowhere);
    text_string(&patch.text, "f 1/1/1 2/2/1 3/3/1\nf 1/1/1 3/3/1 4/4/1\n");
    text_close(&patch.text);
}
