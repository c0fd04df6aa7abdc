/* check_mesh.c - checks baked maps against rays that are traced by brute force.
 *
 * For some of the texels it finds the low-poly triangle in texture space and casts the ray along
 * the interpolated normal. It intersects the ray with all triangles of the scan in double and takes
 * the nearest front-facing hit. It compares the face normal there, and the texture if there is one,
 * with the maps. It is slow and simple on purpose and uses nothing of libbake or libvoxel. For
 * scans of some ten thousand triangles. */
#include "formats/mesh/mesh_reader.h"
#include "tests/scan/verdict.h"

#include <getopt.h>
#include <math.h>
#include <png.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

struct check {
    struct fmt_mesh scan, low;
    struct fmt_exr_image normal, mask, color;
    png_image texture;
    unsigned char *texels; /* RGBA, 8 bit */
    double length;         /* of a ray at most, world units */
    struct verdict verdict;
};

struct hit {
    uint64_t triangle;
    double t, w[3];
};

static void subtract(const double a[3], const double b[3], double out[3])
{
    for (int k = 0; k < 3; k++)
        out[k] = a[k] - b[k];
}

static void cross(const double a[3], const double b[3], double out[3])
{
    for (int i = 0; i < 3; i++)
        out[i] = a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3];
}

static double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static void face_normal(const struct fmt_mesh *m, uint64_t triangle, double n[3])
{
    const uint32_t *v = m->vertices[triangle];
    double a[3], b[3];
    subtract(m->positions[v[1]], m->positions[v[0]], a);
    subtract(m->positions[v[2]], m->positions[v[0]], b);
    cross(a, b, n);
}

/* Intersects a line with a triangle (Moeller & Trumbore, "Fast, Minimum Storage Ray/Triangle
 * Intersection", 1997). Returns whether they meet. */
static int intersect(const struct fmt_mesh *m, uint64_t triangle, const double p[3],
                     const double d[3], struct hit *hit)
{
    const uint32_t *v = m->vertices[triangle];
    double e1[3], e2[3], s[3], q[3], r[3];
    subtract(m->positions[v[1]], m->positions[v[0]], e1);
    subtract(m->positions[v[2]], m->positions[v[0]], e2);
    cross(d, e2, q);
    double det = dot(e1, q);
    if (det == 0)
        return 0;
    subtract(p, m->positions[v[0]], s);
    cross(s, e1, r);
    hit->w[1] = dot(s, q) / det;
    hit->w[2] = dot(d, r) / det;
    hit->w[0] = 1 - hit->w[1] - hit->w[2];
    hit->t = dot(e2, r) / det;
    hit->triangle = triangle;
    return hit->w[0] >= 0 && hit->w[1] >= 0 && hit->w[2] >= 0;
}

/* Finds the nearest front-facing hit. Returns whether there is one. */
static int trace(const struct check *c, const double p[3], const double d[3], struct hit *best)
{
    best->t = c->length;
    int found = 0;
    for (uint64_t i = 0; i < c->scan.triangle_count; i++) {
        struct hit hit;
        double n[3];
        if (!intersect(&c->scan, i, p, d, &hit) || fabs(hit.t) >= fabs(best->t))
            continue;
        face_normal(&c->scan, i, n);
        if (dot(n, d) < 0)
            continue;
        *best = hit;
        found = 1;
    }
    return found;
}

/* Computes the ray at (u, v) of texture space. Returns 0 outside of all charts. */
static int low_ray(const struct check *c, double u, double v, double p[3], double d[3])
{
    for (uint64_t i = 0; i < c->low.triangle_count; i++) {
        const double *a = c->low.texcoords[c->low.corner_texcoords[i][0]],
                     *b = c->low.texcoords[c->low.corner_texcoords[i][1]],
                     *e = c->low.texcoords[c->low.corner_texcoords[i][2]];
        double area = (b[0] - a[0]) * (e[1] - a[1]) - (b[1] - a[1]) * (e[0] - a[0]), w[3];
        w[1] = ((u - a[0]) * (e[1] - a[1]) - (v - a[1]) * (e[0] - a[0])) / area;
        w[2] = ((b[0] - a[0]) * (v - a[1]) - (b[1] - a[1]) * (u - a[0])) / area;
        w[0] = 1 - w[1] - w[2];
        if (!(w[0] >= 0 && w[1] >= 0 && w[2] >= 0))
            continue;
        memset(p, 0, 3 * sizeof *p), memset(d, 0, 3 * sizeof *d);
        for (int corner = 0; corner < 3; corner++)
            for (int k = 0; k < 3; k++) {
                p[k] += w[corner] * c->low.positions[c->low.vertices[i][corner]][k];
                d[k] += w[corner] * (double)c->low.normals[c->low.corner_normals[i][corner]][k];
            }
        double length = sqrt(dot(d, d));
        for (int k = 0; k < 3; k++)
            d[k] /= length;
        return 1;
    }
    return 0;
}

/* Samples the texture at a hit, bilinearly in linear light. */
static void texture_at(const struct check *c, const struct hit *hit, double color[3])
{
    double uv[2] = {0, 0};
    for (int corner = 0; corner < 3; corner++)
        for (int k = 0; k < 2; k++)
            uv[k] += hit->w[corner] *
                     c->scan.texcoords[c->scan.corner_texcoords[hit->triangle][corner]][k];
    int width = (int)c->texture.width, height = (int)c->texture.height;
    double x = uv[0] * width - 0.5, y = (1 - uv[1]) * height - 0.5, fx = x - floor(x),
           fy = y - floor(y);
    for (int k = 0; k < 3; k++)
        color[k] = 0;
    for (int corner = 0; corner < 4; corner++) {
        int i = (int)floor(x) + (corner & 1), j = (int)floor(y) + corner / 2;
        double w = (corner & 1 ? fx : 1 - fx) * (corner / 2 ? fy : 1 - fy);
        i = ((i % width) + width) % width, j = ((j % height) + height) % height;
        for (int k = 0; k < 3; k++)
            color[k] +=
                w * verdict_linear(
                        c->texels[4 * ((size_t)j * (size_t)width + (size_t)i) + (size_t)k] / 255.0);
    }
}

static void compare_texel(struct check *c, uint64_t index)
{
    double u = ((double)(index % c->normal.width) + 0.5) / c->normal.width;
    double v = 1 - ((double)(index / c->normal.width) + 0.5) / c->normal.height;
    double p[3], d[3], found[3], normal[3], color[3];
    struct hit hit;
    if (!low_ray(c, u, v, p, d))
        return;
    if (!trace(c, p, d, &hit)) {
        c->verdict.unsolved++;
        return;
    }
    if (c->mask.samples[index * c->mask.channel_count] < 1) {
        c->verdict.missed++;
        return;
    }
    face_normal(&c->scan, hit.triangle, normal);
    verdict_pixel(&c->normal, index, found);
    verdict_normal(&c->verdict, found, normal);
    if (!c->texels)
        return;
    texture_at(c, &hit, color);
    verdict_pixel(&c->color, index, found);
    verdict_color(&c->verdict, found, color);
}

static void load_texture(struct check *c, const char *path)
{
    c->texture.version = PNG_IMAGE_VERSION;
    if (!png_image_begin_read_from_file(&c->texture, path))
        exit(66);
    c->texture.format = PNG_FORMAT_RGBA; /* with alpha, so that libpng does not blend it in */
    c->texels = malloc(PNG_IMAGE_SIZE(c->texture));
    if (!c->texels || !png_image_finish_read(&c->texture, NULL, c->texels, 0, NULL))
        exit(65);
}

static void load_meshes(struct check *c, struct bsq_ctx *ctx, char **paths)
{
    if (fmt_mesh_load(ctx, paths[0], false, &c->scan) ||
        fmt_mesh_load(ctx, paths[1], false, &c->low)) {
        fprintf(stderr, "check-mesh: %s\n", bsq_error(ctx));
        exit(65);
    }
    double low[3], high[3], d[3];
    memcpy(low, c->scan.positions[0], sizeof low), memcpy(high, low, sizeof high);
    for (uint64_t i = 0; i < c->scan.vertex_count; i++)
        for (int k = 0; k < 3; k++) {
            low[k] = fmin(low[k], c->scan.positions[i][k]);
            high[k] = fmax(high[k], c->scan.positions[i][k]);
        }
    subtract(high, low, d);
    c->length *= sqrt(dot(d, d));
}

int main(int argc, char **argv)
{
    struct check c = {.length = 0.05};
    struct verdict_limits limits = VERDICT_NO_LIMITS;
    unsigned step = 97;
    const char *texture = NULL;
    for (int o; (o = getopt(argc, argv, "t:r:e:m:p:c:h:")) != -1;) {
        if (o == 't')
            texture = optarg;
        else if (o == 'r')
            c.length = atof(optarg);
        else if (o == 'e')
            step = (unsigned)atoi(optarg);
        else if (!verdict_option(&limits, o, optarg))
            return 64;
    }
    if (argc - optind != (texture ? 5 : 4) || step < 1) {
        fputs(
            "usage: check-mesh [-e EVERY] [-r LENGTH] [-m MAX_MEAN_DEG] [-p MAX_P95_DEG] [-h MIN_HITS]\n"
            "                  [-c MAX_COLOR -t texture.png] scan.obj low.obj object_normal.exr mask.exr\n"
            "                  [color.exr]\n",
            stderr);
        return 64;
    }
    struct bsq_ctx *ctx;
    if (bsq_ctx_create(&(struct bsq_ctx_options){.memory_bytes = UINT64_C(8) << 30}, &ctx))
        return 71;
    load_meshes(&c, ctx, argv + optind);
    verdict_load(ctx, argv[optind + 2], &c.normal);
    verdict_load(ctx, argv[optind + 3], &c.mask);
    if (texture) {
        load_texture(&c, texture);
        verdict_load(ctx, argv[optind + 4], &c.color);
    }
    uint64_t texels = (uint64_t)c.normal.width * c.normal.height;
    verdict_start(&c.verdict, texels / step + 1);
    for (uint64_t i = step / 2; i < texels; i += step)
        compare_texel(&c, i);
    fmt_mesh_free(ctx, &c.scan), fmt_mesh_free(ctx, &c.low);
    fmt_exr_image_free(ctx, &c.normal), fmt_exr_image_free(ctx, &c.mask);
    fmt_exr_image_free(ctx, &c.color);
    free(c.texels);
    bsq_ctx_destroy(ctx);
    return verdict_finish(&c.verdict, &limits);
}
