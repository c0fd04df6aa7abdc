/* ray_bounds.c - rays as the kernel makes them, from the same code, joined to boxes as long as they
 * lie close together. */
#define BK_WIDTH 4
#include "libbake/device/subgrid/ray_bounds.h"

#include <math.h>

#include "libbake/kernel/bk_sample.h"

enum {
    SQUARE = 4, /* texels whose rays may share a box */
    SLACK = 8,  /* voxels that a shared box may be longer than two of its own */
    MARGIN = 2  /* voxels around a ray: the blend takes one, rounding far less than the other */
};

struct box {
    float low[3], high[3]; /* low > high: empty */
};

struct reach {
    struct bsq_ctx *ctx;
    const struct bake_job *job;
    struct bake_leaf_set *set;
    struct box box; /* not added yet */
    bk_samples samples;
};

static const struct box nothing = {{INFINITY, INFINITY, INFINITY},
                                   {-INFINITY, -INFINITY, -INFINITY}};

static int add_box(struct reach *reach)
{
    const struct bk_params *params = &reach->job->params;
    int32_t low[3], high[3];
    bool some = true;
    for (int k = 0; k < 3; k++) {
        const double a = floor((double)reach->box.low[k]) - MARGIN;
        const double b = ceil((double)reach->box.high[k]) + MARGIN;
        const double least = (double)params->index_min[k], most = (double)params->index_max[k];
        some = some && a <= most && b >= least;
        if (!some)
            break;
        low[k] = (int32_t)fmax(a, least);
        high[k] = (int32_t)fmin(b, most);
    }
    reach->box = nothing;
    return some ? bake_leaf_set_add_box(reach->ctx, reach->set, low, high) : 0;
}

/* Whether one box for both is hardly longer than the two. */
static bool close_together(const struct box *a, const struct box *b)
{
    for (int k = 0; k < 3; k++) {
        const float joined = fmaxf(a->high[k], b->high[k]) - fminf(a->low[k], b->low[k]);
        if (!(joined <= fmaxf(a->high[k] - a->low[k], b->high[k] - b->low[k]) + SLACK))
            return false;
    }
    return true;
}

static int join_box(struct reach *reach, const struct box *box)
{
    struct box *own = &reach->box;
    int status = 0;
    if (own->low[0] <= own->high[0] && !close_together(own, box))
        status = add_box(reach);
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

/* Rays whose origin is no number find nothing; fminf and fmaxf pass over them. */
static int add_samples(struct reach *reach)
{
    const struct bk_params *params = &reach->job->params;
    const uint32_t count = reach->samples.count;
    if (count == 0)
        return 0;
    const bk_point points = bk_points_at(reach->job->triangles, &reach->samples);
    const bk_vec3w d = bk_unitw(points.normal), o = points.position;
    const float f = params->front, b = params->back;
    struct box box = nothing;
    extend(o.x + f * d.x, o.x - b * d.x, count, &box.low[0], &box.high[0]);
    extend(o.y + f * d.y, o.y - b * d.y, count, &box.low[1], &box.high[1]);
    extend(o.z + f * d.z, o.z - b * d.z, count, &box.low[2], &box.high[2]);
    reach->samples.count = 0;
    return join_box(reach, &box);
}

static int add_texel(struct reach *reach, const struct bk_tile *tile,
                     const uint32_t *sample_triangles, uint32_t column, uint32_t row)
{
    const uint32_t n = reach->job->params.samples;
    bk_samples *samples = &reach->samples;
    int status = 0;
    for (uint32_t j = 0; j < n; j++)
        for (uint32_t i = 0; i < n && status == 0; i++) {
            const uint32_t triangle = sample_triangles[bk_sample_index(tile, n, column, row, i, j)];
            if (triangle == BK_NO_TRIANGLE)
                continue;
            samples->triangle[samples->count] = triangle;
            samples->x[samples->count] = bk_sample_place(tile->x + column, i, n);
            samples->y[samples->count] = bk_sample_place(tile->y + row, j, n);
            if (++samples->count == BK_WIDTH)
                status = add_samples(reach);
        }
    return status;
}

static int add_square(struct reach *reach, const struct bk_tile *tile,
                      const uint32_t *sample_triangles, const struct bake_rectangle *square)
{
    int status = 0;
    for (uint32_t y = 0; y < square->height && status == 0; y++)
        for (uint32_t x = 0; x < square->width && status == 0; x++)
            status = add_texel(reach, tile, sample_triangles, square->x + x, square->y + y);
    if (status == 0)
        status = add_samples(reach);
    if (status == 0 && reach->box.low[0] <= reach->box.high[0])
        status = add_box(reach);
    return status;
}

int bake_reach(struct bsq_ctx *ctx, const struct bake_job *job, const struct bk_tile *tile,
               const uint32_t *sample_triangles, const struct bake_rectangle *rectangle,
               struct bake_leaf_set *set)
{
    struct reach reach = {.ctx = ctx, .job = job, .set = set, .box = nothing};
    int status = 0;
    for (uint32_t y = 0; y < rectangle->height && status == 0; y += SQUARE)
        for (uint32_t x = 0; x < rectangle->width && status == 0; x += SQUARE) {
            const uint32_t right = rectangle->width - x, below = rectangle->height - y;
            const struct bake_rectangle square = {rectangle->x + x, rectangle->y + y,
                                                  right < SQUARE ? right : SQUARE,
                                                  below < SQUARE ? below : SQUARE};
            status = add_square(&reach, tile, sample_triangles, &square);
        }
    return status;
}
