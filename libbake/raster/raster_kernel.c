/* raster_kernel.c - converts the triangles of the low-poly mesh into the kernel's form.
 *
 * The kernel works in float. To keep precision, barycentric weights are affine functions of the
 * offset from a texel near the triangle, and positions are in the index space of the grid. Both are
 * computed in double. */
#include "libbake/raster/raster_internal.h"

#include <math.h>
#include <string.h>

/* Across a sliver, weights change so fast that float rounding and the snapping of corners would
 * place samples far outside of it. Triangles whose height is below SLIVER_STEPS steps of the sample
 * grid, or below SLIVER_ASPECT times their longest edge, are sampled along that edge instead. */
#define SLIVER_STEPS  16.0
#define SLIVER_ASPECT (1.0 / 16384)

struct corners {
    double x[3], y[3]; /* texels */
};

/* A barycentric weight as an affine function: its gradient per texel, and a point where it is 0. */
struct weight {
    double dx, dy, zero_x, zero_y;
};

static struct corners map_corners(const struct bake_raster *raster, uint64_t triangle)
{
    const float(*uv)[2] = (const float(*)[2])raster->mesh->texcoords[triangle];
    struct corners c;
    for (int i = 0; i < 3; i++) {
        c.x[i] = uv[i][0] * (double)raster->options.width;
        c.y[i] = (1.0 - uv[i][1]) * (double)raster->options.height;
    }
    return c;
}

static double corner_area(const struct corners *c)
{
    return (c->x[1] - c->x[0]) * (c->y[2] - c->y[0]) - (c->x[2] - c->x[0]) * (c->y[1] - c->y[0]);
}

static double edge_length(const struct corners *c, int i)
{
    int j = (i + 1) % 3;
    const double x = c->x[j] - c->x[i], y = c->y[j] - c->y[i];
    return sqrt(x * x + y * y);
}

/* Returns the weight of corner i, which is 0 on the opposite edge. */
static struct weight weight_in_triangle(const struct corners *c, double area, int i)
{
    int j = (i + 1) % 3, k = (i + 2) % 3;
    return (struct weight){(c->y[j] - c->y[k]) / area, (c->x[k] - c->x[j]) / area, c->x[j],
                           c->y[j]};
}

/* Returns the weight of corner i along the edge from corner `edge` to the next one: 0 at the other
 * end of the edge, and 0 for the corner opposite to it. */
static struct weight weight_along_edge(const struct corners *c, int edge, int i)
{
    int other = i == edge ? (edge + 1) % 3 : edge;
    double x = c->x[i] - c->x[other], y = c->y[i] - c->y[other];
    double square = x * x + y * y;
    if (i == (edge + 2) % 3)
        return (struct weight){0, 0, 0, 0};
    return (struct weight){x / square, y / square, c->x[other], c->y[other]};
}

static void set_weight(const struct weight *w, double x0, double y0, float out[3])
{
    out[0] = (float)w->dx;
    out[1] = (float)w->dy;
    out[2] = (float)(w->dx * (x0 - w->zero_x) + w->dy * (y0 - w->zero_y));
}

static void set_weights(const struct bake_raster *raster, uint64_t triangle,
                        const struct raster_window *samples, struct bk_triangle *out)
{
    const uint32_t n = raster->options.samples;
    const uint32_t texel_x = (samples->begin_x / 2 + samples->end_x / 2) / n;
    const uint32_t texel_y = (samples->begin_y / 2 + samples->end_y / 2) / n;
    const double x0 = texel_x, y0 = texel_y;
    const double step = 1.0 / ((double)n * ((uint32_t)1 << raster->grid.shift));
    const struct corners c = map_corners(raster, triangle);
    const double area = corner_area(&c);
    struct weight w1 = weight_in_triangle(&c, area, 1), w2 = weight_in_triangle(&c, area, 2);
    int longest = 0;
    for (int i = 1; i < 3; i++)
        longest = edge_length(&c, i) > edge_length(&c, longest) ? i : longest;
    const double length = edge_length(&c, longest);
    if (!(fabs(area) >= length * fmax(SLIVER_STEPS * step, SLIVER_ASPECT * length))) {
        w1 = weight_along_edge(&c, longest, 1);
        w2 = weight_along_edge(&c, longest, 2);
    }
    out->x0 = (float)x0;
    out->y0 = (float)y0;
    set_weight(&w1, x0, y0, out->b1);
    set_weight(&w2, x0, y0, out->b2);
}

/* Copies where rays start and go; the way to a cage is a length in voxels. */
static void set_directions(const struct bake_lowmesh *mesh, uint64_t triangle, double voxel_size,
                           struct bk_triangle *out)
{
    memcpy(out->direction, mesh->directions[triangle], sizeof(out->direction));
    for (int c = 0; c < 3; c++)
        out->reach[c] = (float)((double)mesh->reaches[triangle][c] / voxel_size);
    for (int c = 0; c < 3 && mesh->cage_distance > 0; c++)
        for (int k = 0; k < 3; k++)
            out->direction[c][k] = (float)((double)out->direction[c][k] / voxel_size);
}

void bake_raster_kernel_triangles(const struct bake_raster *raster, const double translation[3],
                                  double voxel_size, struct bk_triangle *out)
{
    const struct bake_lowmesh *mesh = raster->mesh;
    struct raster_triangle snapped;
    for (uint64_t i = 0; i < raster->options.count; i++) {
        const uint64_t t = raster->options.first + i;
        memset(&out[t], 0, sizeof(out[t]));
        if (!bake_raster_snap(raster, t, &snapped))
            continue;
        const struct raster_window samples = bake_raster_bounds(&raster->grid, &snapped);
        set_weights(raster, t, &samples, &out[t]);
        for (int c = 0; c < 3; c++) {
            for (int k = 0; k < 3; k++)
                out[t].position[c][k] =
                    (float)((mesh->positions[t][c][k] - translation[k]) / voxel_size);
        }
        set_directions(mesh, t, voxel_size, &out[t]);
        memcpy(out[t].normal, mesh->normals[t], sizeof(out[t].normal));
        memcpy(out[t].tangent, mesh->tangents[t], sizeof(out[t].tangent));
    }
}
