/* ray_bounds.c - boxes around the rays of neighbouring texels. The rays come from the kernel's own
 * code. */
#define BK_WIDTH 4
#include "libbake/device/subgrid/leaf_set.h"

#include <math.h>

#include "libbake/kernel/bk_sample.h"

enum {
    SQUARE = 4, /* side in texels of the square whose rays may share a box */
    SLACK = 8,  /* voxels that a shared box may be longer than either of its two */
    MARGIN = 2  /* voxels around a ray: one for the blend, one for rounding, which needs less */
};

struct box {
    float low[3], high[3]; /* low > high: empty */
};

struct ray_bounds {
    struct bsq_ctx *ctx;
    const struct bake_job *job;
    struct bake_leaf_set *set;
    struct box box; /* of rays whose nodes are not in the set yet */
    bk_samples samples;
};

static const struct box nothing = {{INFINITY, INFINITY, INFINITY},
                                   {-INFINITY, -INFINITY, -INFINITY}};

float bake_secondary_reach(const struct bk_params *params)
{
    float reach = 0;
    if (params->maps & BK_OPEN_MAPS)
        reach = params->open_limit + BK_LIFT;
    if (params->maps & 1u << BK_MAP_thickness)
        reach = fmaxf(reach, params->thickness_limit);
    return reach;
}

static int add_box(struct ray_bounds *bounds)
{
    const struct bk_params *params = &bounds->job->params;
    const double margin = MARGIN + ceil((double)bake_secondary_reach(params));
    int32_t low[3], high[3];
    bool some = true;
    for (int k = 0; k < 3; k++) {
        const double a = floor((double)bounds->box.low[k]) - margin;
        const double b = ceil((double)bounds->box.high[k]) + margin;
        const double least = (double)params->index_min[k], most = (double)params->index_max[k];
        some = some && a <= most && b >= least;
        if (!some)
            break;
        low[k] = (int32_t)fmax(a, least);
        high[k] = (int32_t)fmin(b, most);
    }
    bounds->box = nothing;
    return some ? bake_leaf_set_add_box(bounds->ctx, bounds->set, low, high) : 0;
}

/* Returns whether a box around both is hardly longer than the longer one. */
static bool close_together(const struct box *a, const struct box *b)
{
    for (int k = 0; k < 3; k++) {
        const float joined = fmaxf(a->high[k], b->high[k]) - fminf(a->low[k], b->low[k]);
        if (!(joined <= fmaxf(a->high[k] - a->low[k], b->high[k] - b->low[k]) + SLACK))
            return false;
    }
    return true;
}

static int join_box(struct ray_bounds *bounds, const struct box *box)
{
    struct box *own = &bounds->box;
    int status = 0;
    if (own->low[0] <= own->high[0] && !close_together(own, box))
        status = add_box(bounds);
    for (int k = 0; k < 3; k++) {
        own->low[k] = fminf(own->low[k], box->low[k]);
        own->high[k] = fmaxf(own->high[k], box->high[k]);
    }
    return status;
}

static void extend(bk_fw a, bk_fw b, uint32_t count, float *low, float *high)
{
    for (uint32_t lane = 0; lane < count; lane++) {
        *low = fminf(*low, fminf(bk_lane(a, lane), bk_lane(b, lane)));
        *high = fmaxf(*high, fmaxf(bk_lane(a, lane), bk_lane(b, lane)));
    }
}

/* Adds the collected samples' rays. fminf and fmaxf ignore origins that are NaN; such rays hit
 * nothing. */
static int add_samples(struct ray_bounds *bounds)
{
    const struct bk_params *params = &bounds->job->params;
    const uint32_t count = bounds->samples.count;
    if (count == 0)
        return 0;
    const bk_point points = bk_points_at(params, bounds->job->triangles, &bounds->samples);
    const bk_start start = bk_start_at(params, &points);
    const bk_vec3w d = start.direction, o = start.origin;
    const bool cage = params->flags & BK_CAGE;
    const float f = cage ? params->front + params->back : params->front;
    const float b = cage ? 0.0f : params->back;
    struct box box = nothing;
    extend(o.x + f * d.x, o.x - b * d.x, count, &box.low[0], &box.high[0]);
    extend(o.y + f * d.y, o.y - b * d.y, count, &box.low[1], &box.high[1]);
    extend(o.z + f * d.z, o.z - b * d.z, count, &box.low[2], &box.high[2]);
    bounds->samples.count = 0;
    return join_box(bounds, &box);
}

static int add_texel(struct ray_bounds *bounds, const struct bk_tile *tile,
                     const uint32_t *sample_triangles, uint32_t column, uint32_t row)
{
    const uint32_t n = bounds->job->params.samples;
    bk_samples *samples = &bounds->samples;
    int status = 0;
    for (uint32_t j = 0; j < n; j++)
        for (uint32_t i = 0; i < n && status == 0; i++) {
            const bk_ulong index = bk_sample_index(tile, n, column, row, i, j);
            const uint32_t triangle = sample_triangles[index];
            if (triangle == BK_NO_TRIANGLE)
                continue;
            samples->triangle[samples->count] = triangle;
            samples->x[samples->count] = bk_sample_place(tile->x + column, i, n);
            samples->y[samples->count] = bk_sample_place(tile->y + row, j, n);
            samples->skew[samples->count] =
                bk_sample_skew(&bounds->job->params, tile, sample_triangles, index);
            if (++samples->count == BK_WIDTH)
                status = add_samples(bounds);
        }
    return status;
}

static int add_square(struct ray_bounds *bounds, const struct bk_tile *tile,
                      const uint32_t *sample_triangles, const struct bake_rectangle *square)
{
    int status = 0;
    for (uint32_t y = 0; y < square->height && status == 0; y++)
        for (uint32_t x = 0; x < square->width && status == 0; x++)
            status = add_texel(bounds, tile, sample_triangles, square->x + x, square->y + y);
    if (status == 0)
        status = add_samples(bounds);
    if (status == 0 && bounds->box.low[0] <= bounds->box.high[0])
        status = add_box(bounds);
    return status;
}

int bake_leaf_set_add_rays(struct bsq_ctx *ctx, struct bake_leaf_set *set,
                           const struct bake_job *job, const struct bk_tile *tile,
                           const uint32_t *sample_triangles, const struct bake_rectangle *rectangle)
{
    struct ray_bounds bounds = {.ctx = ctx, .job = job, .set = set, .box = nothing};
    int status = 0;
    for (uint32_t y = 0; y < rectangle->height && status == 0; y += SQUARE)
        for (uint32_t x = 0; x < rectangle->width && status == 0; x += SQUARE) {
            const uint32_t right = rectangle->width - x, below = rectangle->height - y;
            const struct bake_rectangle square = {rectangle->x + x, rectangle->y + y,
                                                  right < SQUARE ? right : SQUARE,
                                                  below < SQUARE ? below : SQUARE};
            status = add_square(&bounds, tile, sample_triangles, &square);
        }
    return status;
}
