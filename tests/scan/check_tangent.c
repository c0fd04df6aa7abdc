/* check_tangent.c - checks a tangent-space map against the object-space map of the same rays.
 *
 * It decodes the tangent-space values as a MikkTSpace shader does. At the centre of a texel, normal
 * and tangent are interpolated over the low-poly triangle and not normalised. With b = sign *
 * cross(n, t) the result is normalize(m.x t + m.y b + m.z n). The frames at the corners come from
 * libbake; unit tests compare them with Blender's. Everything else is independent of libbake. For
 * bakes with one sample a texel and charts that do not overlap. */
#include "libbake/lowpoly/lowpoly.h"
#include "tests/scan/verdict.h"

#include <getopt.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

/* Least weight at which the centre of a texel is inside a triangle despite rounding. */
#define INSIDE 1e-3

struct check {
    struct bake_lowmesh low;
    struct fmt_exr_image tangent, object, mask;
    struct verdict verdict;
    uint64_t mirrored; /* texels with a negative sign */
};

/* A low-poly triangle on the map, in texels from the top left. */
struct chart {
    double x[3], y[3];
};

static struct chart chart_of(const struct check *c, uint64_t triangle)
{
    struct chart chart;
    for (int i = 0; i < 3; i++) {
        chart.x[i] = (double)c->low.texcoords[triangle][i][0] * c->object.width;
        chart.y[i] = (1 - (double)c->low.texcoords[triangle][i][1]) * c->object.height;
    }
    return chart;
}

/* Computes the barycentric weights of a point. Returns whether it is inside for certain. */
static int weights(const struct chart *chart, double x, double y, double w[3])
{
    const double *px = chart->x, *py = chart->y;
    const double area = (px[1] - px[0]) * (py[2] - py[0]) - (px[2] - px[0]) * (py[1] - py[0]);
    w[1] = ((x - px[0]) * (py[2] - py[0]) - (px[2] - px[0]) * (y - py[0])) / area;
    w[2] = ((px[1] - px[0]) * (y - py[0]) - (x - px[0]) * (py[1] - py[0])) / area;
    w[0] = 1 - w[1] - w[2];
    return w[0] > INSIDE && w[1] > INSIDE && w[2] > INSIDE;
}

/* Decodes a map value into an object-space normal, not unit, as the shader does. */
static void decode(const struct check *c, uint64_t triangle, const double w[3],
                   const double encoded[3], double out[3])
{
    double n[3] = {0}, t[3] = {0};
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++) {
            n[k] += w[i] * (double)c->low.normals[triangle][i][k];
            t[k] += w[i] * (double)c->low.tangents[triangle][i][k];
        }
    for (int k = 0; k < 3; k++) {
        const int p = (k + 1) % 3, q = (k + 2) % 3;
        const double b = (double)c->low.tangents[triangle][0][3] * (n[p] * t[q] - n[q] * t[p]);
        out[k] =
            (2 * encoded[0] - 1) * t[k] + (2 * encoded[1] - 1) * b + (2 * encoded[2] - 1) * n[k];
    }
}

static void compare_texel(struct check *c, uint64_t triangle, const double w[3], uint64_t index)
{
    double encoded[3], normal[3], object[3];
    if (c->mask.samples[index * c->mask.channel_count] < 1) {
        c->verdict.missed++;
        return;
    }
    verdict_pixel(&c->tangent, index, encoded);
    verdict_pixel(&c->object, index, object);
    decode(c, triangle, w, encoded, normal);
    verdict_normal(&c->verdict, object, normal);
    c->mirrored += c->low.tangents[triangle][0][3] < 0;
}

static void compare_triangle(struct check *c, uint64_t triangle)
{
    const struct chart chart = chart_of(c, triangle);
    const double left = fmin(fmin(chart.x[0], chart.x[1]), chart.x[2]);
    const double right = fmax(fmax(chart.x[0], chart.x[1]), chart.x[2]);
    const double top = fmin(fmin(chart.y[0], chart.y[1]), chart.y[2]);
    const double bottom = fmax(fmax(chart.y[0], chart.y[1]), chart.y[2]);
    for (double y = floor(fmax(top, 0)) + 0.5; y < fmin(bottom, c->object.height); y++)
        for (double x = floor(fmax(left, 0)) + 0.5; x < fmin(right, c->object.width); x++) {
            double w[3];
            if (weights(&chart, x, y, w))
                compare_texel(c, triangle, w, (uint64_t)y * c->object.width + (uint64_t)x);
        }
}

static int largest_holds(const struct check *c, double limit)
{
    float largest = 0;
    for (uint64_t i = 0; i < c->verdict.compared; i++)
        largest = fmaxf(largest, c->verdict.angles[i]);
    printf("%s largest angle: %.4g (at most %g), %llu mirrored texels\n",
           (double)largest <= limit ? "within " : "OUTSIDE", (double)largest, limit,
           (unsigned long long)c->mirrored);
    return (double)largest <= limit;
}

int main(int argc, char **argv)
{
    struct check c = {0};
    struct verdict_limits limits = VERDICT_NO_LIMITS;
    double largest = INFINITY;
    for (int o; (o = getopt(argc, argv, "x:m:p:h:")) != -1;) {
        if (o == 'x')
            largest = atof(optarg);
        else if (!verdict_option(&limits, o, optarg))
            return 64;
    }
    if (argc - optind != 4) {
        fputs("usage: check-tangent [-x MAX_DEG] [-m MAX_MEAN_DEG] [-p MAX_P95_DEG] [-h MIN_HITS]\n"
              "                     low.obj tangent_normal.exr object_normal.exr mask.exr\n",
              stderr);
        return 64;
    }
    struct bsq_ctx *ctx;
    if (bsq_ctx_create(&(struct bsq_ctx_options){.memory_bytes = UINT64_C(8) << 30}, &ctx))
        return 71;
    struct bake_options options;
    bake_defaults(&options);
    options.mesh_path = argv[optind];
    if (bake_lowmesh_load(ctx, &options, &c.low)) {
        fprintf(stderr, "check-tangent: %s\n", bsq_error(ctx));
        return 65;
    }
    verdict_load(ctx, argv[optind + 1], &c.tangent);
    verdict_load(ctx, argv[optind + 2], &c.object);
    verdict_load(ctx, argv[optind + 3], &c.mask);
    verdict_start(&c.verdict, (uint64_t)c.object.width * c.object.height);
    for (uint64_t t = 0; t < c.low.triangle_count; t++)
        compare_triangle(&c, t);
    const int holds = largest_holds(&c, largest);
    bake_lowmesh_free(ctx, &c.low);
    fmt_exr_image_free(ctx, &c.tangent), fmt_exr_image_free(ctx, &c.object);
    fmt_exr_image_free(ctx, &c.mask);
    bsq_ctx_destroy(ctx);
    return verdict_finish(&c.verdict, &limits) || !holds;
}
