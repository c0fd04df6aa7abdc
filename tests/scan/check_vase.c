/* check_vase.c - checks baked maps of the vase against its analytic normals and colours.
 *
 * The low-poly mesh is a regular grid in texture space. For each texel the program computes the
 * rays from that mesh, and solves for their crossings with the analytic surface. It compares the
 * mean over the texel's samples with the object-space normal map and the linear colour map. It uses
 * nothing of libbake. */
#include "tests/scan/vase.h"
#include "tests/scan/verdict.h"

#include <getopt.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

struct check {
    unsigned nu, ns;  /* quads of the low-poly mesh */
    unsigned samples; /* N, for N x N samples a texel */
    struct fmt_exr_image normal, mask, color;
    struct verdict verdict;
};

/* Computes the ray at (u, s) of texture space. The mesh's quads are split along the diagonal u = s.
 */
static void low_ray(const struct check *c, double u, double s, double p[3], double n[3])
{
    double x = u * c->nu, y = s * c->ns, i = floor(x), j = floor(y), fx = x - i, fy = y - j;
    double corner[3][2] = {{i, j}, {i + 1, j + 1}, {fx >= fy ? i + 1 : i, fx >= fy ? j : j + 1}};
    double w[3] = {1 - fmax(fx, fy), fmin(fx, fy), fabs(fx - fy)};
    for (int k = 0; k < 3; k++)
        p[k] = n[k] = 0;
    for (int v = 0; v < 3; v++) {
        struct vase_point body;
        vase_body(corner[v][0] / c->nu, corner[v][1] / c->ns, &body);
        for (int k = 0; k < 3; k++) {
            p[k] += w[v] * body.position[k];
            n[k] += w[v] * body.normal[k];
        }
    }
    double length = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
    for (int k = 0; k < 3; k++)
        n[k] /= length;
}

/* Computes the sum of the analytic normals and the mean linear colour over a texel's samples.
 * Returns 0 if the crossing of a ray cannot be found. */
static int expected(const struct check *c, double x, double y, double normal[3], double color[3])
{
    for (int k = 0; k < 3; k++)
        normal[k] = color[k] = 0;
    for (unsigned sample = 0; sample < c->samples * c->samples; sample++) {
        double u = (x + (sample % c->samples + 0.5) / c->samples) / c->normal.width;
        double s = 1 - (y + (sample / c->samples + 0.5) / c->samples) / c->normal.height;
        double p[3], n[3], t;
        struct vase_point hit;
        low_ray(c, u, s, p, n);
        if (!vase_intersect(p, n, &u, &s, &t))
            return 0;
        vase_surface(u, s, &hit);
        for (int k = 0; k < 3; k++) {
            normal[k] += hit.normal[k];
            color[k] += verdict_linear(hit.color[k]) / (c->samples * c->samples);
        }
    }
    return 1;
}

static void compare_texel(struct check *c, uint64_t index)
{
    double normal[3], color[3], found[3];
    if (c->mask.samples[index * c->mask.channel_count] < 1) {
        c->verdict.missed++;
        return;
    }
    if (!expected(c, (double)(index % c->normal.width), (double)(index / c->normal.width), normal,
                  color)) {
        c->verdict.unsolved++;
        return;
    }
    verdict_pixel(&c->normal, index, found);
    verdict_normal(&c->verdict, found, normal);
    if (!c->color.samples)
        return;
    verdict_pixel(&c->color, index, found);
    verdict_color(&c->verdict, found, color);
}

int main(int argc, char **argv)
{
    struct check c = {.nu = 40, .ns = 64, .samples = 1};
    struct verdict_limits limits = VERDICT_NO_LIMITS;
    unsigned step = 1;
    for (int o; (o = getopt(argc, argv, "s:e:m:p:c:h:")) != -1;) {
        if (o == 's')
            c.samples = (unsigned)atoi(optarg);
        else if (o == 'e')
            step = (unsigned)atoi(optarg);
        else if (!verdict_option(&limits, o, optarg))
            return 64;
    }
    if (argc - optind < 2 || argc - optind > 3 || c.samples < 1 || step < 1) {
        fputs(
            "usage: check-vase [-s SAMPLES] [-e EVERY] [-m MAX_MEAN_DEG] [-p MAX_P95_DEG]\n"
            "                  [-h MIN_HITS] [-c MAX_COLOR] object_normal.exr mask.exr [color.exr]\n",
            stderr);
        return 64;
    }
    struct bsq_ctx *ctx;
    if (bsq_ctx_create(&(struct bsq_ctx_options){.memory_bytes = UINT64_C(8) << 30}, &ctx))
        return 71;
    verdict_load(ctx, argv[optind], &c.normal);
    verdict_load(ctx, argv[optind + 1], &c.mask);
    if (optind + 2 < argc)
        verdict_load(ctx, argv[optind + 2], &c.color);
    uint64_t texels = (uint64_t)c.normal.width * c.normal.height;
    verdict_start(&c.verdict, texels);
    for (uint64_t i = 0; i < texels; i += step)
        compare_texel(&c, i);
    fmt_exr_image_free(ctx, &c.normal), fmt_exr_image_free(ctx, &c.mask);
    fmt_exr_image_free(ctx, &c.color);
    bsq_ctx_destroy(ctx);
    return verdict_finish(&c.verdict, &limits);
}
