/* ray_bounds.c - finds the lower nodes around rays. The rays come from the kernel's own code. */
#define BK_WIDTH 4
#include "libbake/device/subgrid/subgrid.h"

#include <math.h>
#include <string.h>

#include "libbake/kernel/bk_sample.h"

/* Voxels around a ray: one for the blend, one for rounding, which needs less. */
enum { MARGIN = 2 };

struct ray_bounds {
    struct bsq_ctx *ctx;
    const struct bake_job *job;
    struct bake_lower_set *set;
    double margin;
    int32_t last[6]; /* lowest and highest lower nodes around the last ray: voxels >> 7 */
    bk_samples samples;
};

float bake_secondary_reach(const struct bk_params *params)
{
    float reach = 0;
    if (params->maps & BK_OPEN_MAPS)
        reach = params->open_limit + BK_LIFT;
    if (params->maps & 1u << BK_MAP_thickness)
        reach = fmaxf(reach, params->thickness_limit);
    return reach;
}

static int add_node(void *arg, uint32_t lower, const int32_t origin[3])
{
    struct ray_bounds *bounds = arg;
    (void)origin;
    return bake_lower_set_add(bounds->ctx, bounds->set, lower);
}

/* Adds the nodes around a ray from a to b. Most rays have those of the last one. A ray whose origin
 * is NaN hits nothing, and has no nodes. */
static int add_ray(struct ray_bounds *bounds, const float a[3], const float b[3])
{
    const struct bk_params *params = &bounds->job->params;
    int32_t low[3], high[3], nodes[6];
    for (int k = 0; k < 3; k++) {
        const double begin = floor((double)fminf(a[k], b[k])) - bounds->margin;
        const double end = ceil((double)fmaxf(a[k], b[k])) + bounds->margin;
        const double least = (double)params->index_min[k], most = (double)params->index_max[k];
        if (!(begin <= most && end >= least))
            return 0;
        low[k] = (int32_t)fmax(begin, least);
        high[k] = (int32_t)fmin(end, most);
        nodes[k] = low[k] >> BK_LOWER_LOG2;
        nodes[3 + k] = high[k] >> BK_LOWER_LOG2;
    }
    if (memcmp(nodes, bounds->last, sizeof nodes) == 0)
        return 0;
    memcpy(bounds->last, nodes, sizeof nodes);
    return bake_visit_nodes(bounds->job->grid, low, high, add_node, bounds);
}

/* Adds the collected samples' rays. */
static int add_samples(struct ray_bounds *bounds)
{
    const struct bk_params *params = &bounds->job->params;
    const uint32_t count = bounds->samples.count;
    if (count == 0)
        return 0;
    const bk_point points = bk_points_at(params, bounds->job->triangles, &bounds->samples);
    const bk_start start = bk_start_at(params, &points);
    const bk_vec3w from = bk_add_scaledw(start.origin, start.t_max, start.direction);
    const bk_vec3w to = bk_add_scaledw(start.origin, bk_splat(-params->back), start.direction);
    int status = 0;
    for (uint32_t lane = 0; lane < count && status == 0; lane++) {
        float a[3], b[3];
        bk_copy_lane(&from, lane, a);
        bk_copy_lane(&to, lane, b);
        status = add_ray(bounds, a, b);
    }
    bounds->samples.count = 0;
    return status;
}

static int add_texel(struct ray_bounds *bounds, const struct bk_patch *patch,
                     const uint32_t *sample_triangles, uint32_t column, uint32_t row)
{
    const uint32_t n = bounds->job->params.samples;
    bk_samples *samples = &bounds->samples;
    int status = 0;
    for (uint32_t j = 0; j < n; j++)
        for (uint32_t i = 0; i < n && status == 0; i++) {
            const bk_ulong index = bk_sample_index(patch, n, column, row, i, j);
            const uint32_t triangle = sample_triangles[index];
            if (triangle == BK_NO_TRIANGLE)
                continue;
            samples->triangle[samples->count] = triangle;
            samples->x[samples->count] = bk_sample_position(patch->x + column, i, n);
            samples->y[samples->count] = bk_sample_position(patch->y + row, j, n);
            samples->skew[samples->count] =
                bk_sample_skew(&bounds->job->params, patch, sample_triangles, index);
            if (++samples->count == BK_WIDTH)
                status = add_samples(bounds);
        }
    return status;
}

int bake_lower_set_add_rays(struct bsq_ctx *ctx, struct bake_lower_set *set,
                            const struct bake_job *job, const struct bk_patch *patch,
                            const uint32_t *sample_triangles,
                            const struct bake_rectangle *rectangle)
{
    struct ray_bounds bounds = {.ctx = ctx,
                                .job = job,
                                .set = set,
                                .margin = MARGIN + ceil((double)bake_secondary_reach(&job->params)),
                                .last = {INT32_MAX}};
    int status = 0;
    for (uint32_t y = 0; y < rectangle->height; y++)
        for (uint32_t x = 0; x < rectangle->width; x++)
            BSQ_TRY(
                add_texel(&bounds, patch, sample_triangles, rectangle->x + x, rectangle->y + y));
    status = add_samples(&bounds);
done:
    return status;
}
