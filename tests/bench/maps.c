/* maps.c - measures what maps cost beside the normal map alone, and how many secondary rays a grid
 * traces, beside Embree with the same rays on the triangles of the scan. Prints tables in Markdown.
 * All on one thread; seconds are processor time.
 *
 *   bench-maps SCAN.nvdb SCAN.tris LOW.obj SIZE SAMPLES RAYS ROUNDS */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "libbake/kernel/bk_sample.h"
#include "tests/bench/rays.h"

/* Maps of the first hit have at least FIRST_HIT_ROUNDS, as a round is short and its ratio near 1.
 */
enum { MAX_ROUNDS = 99, FIRST_HIT_ROUNDS = 9 };

struct bench {
    struct bsq_ctx *ctx;
    struct rays_scene scene;
    struct rays_occluder *embree;
    unsigned rounds;
    struct bk_grid grid;
    float (*rays)[6]; /* of a patch */
    /* Sums over all patches: number of rays; for each way, seconds and rays that hit. */
    uint64_t count, total, hidden[RAYS_WAYS];
    double seconds[RAYS_WAYS];
};

/* Traces all samples for these maps. */
static int trace(struct bench *bench, uint32_t maps, double *seconds)
{
    struct bake_device *device;
    struct bk_params *params = &bench->scene.job.params;
    params->maps = maps;
    bake_params_from_grid(&bench->scene.surface.scans->grid, params);
    if (!(maps & BAKE_MAP_ID)) /* then bakes read no ids */
        params->flags &= ~(bk_uint)BK_HAS_IDS;
    int status = bake_device_open(bench->ctx, "cpu", &bench->scene.job, &device);
    if (status < 0)
        return status;
    status = rays_trace(&bench->scene, device, seconds);
    bake_device_close(device);
    return status;
}

/* ---- maps of the first hit ---- */

static int measure_maps(struct bench *bench)
{
    static const struct {
        const char *name;
        uint32_t map;
    } maps[] = {{"height", BAKE_MAP_HEIGHT}, {"position", BAKE_MAP_POSITION}, {"id", BAKE_MAP_ID}};
    const unsigned rounds = bench->rounds > FIRST_HIT_ROUNDS ? bench->rounds : FIRST_HIT_ROUNDS;
    double ratios[MAX_ROUNDS];
    puts("| map beside normal | processor time, ratio |\n|:--|--:|");
    for (size_t m = 0; m < sizeof maps / sizeof *maps; m++) {
        for (unsigned round = 0; round < rounds; round++) {
            double alone = 0, both = 0;
            int status = trace(bench, BAKE_MAP_NORMAL, &alone);
            if (status == 0)
                status = trace(bench, BAKE_MAP_NORMAL | maps[m].map, &both);
            if (status < 0)
                return status;
            ratios[round] = both / alone;
        }
        printf("| %s | %.3f |\n", maps[m].name, rays_median(ratios, rounds));
    }
    return 0;
}

/* ---- secondary rays ---- */

/* Appends the open rays of a sample, as the kernel makes them. */
static void add_rays(struct bench *bench, const bk_grid *grid, bk_cache *cache, uint32_t triangle,
                     float x, float y)
{
    const struct bk_params *params = &bench->scene.job.params;
    const bk_point point = bk_point_at(&bench->scene.triangles[triangle], x, y);
    const bk_start start = bk_start_at(params, &point);
    const bk_lines lines = {.count = 1,
                            .origin = start.origin,
                            .direction = start.direction,
                            .facing = start.direction,
                            .reach = start.reach,
                            .t_min = -params->back,
                            .t_max = start.t_max};
    bk_hits hits;
    bk_trace(grid, params, cache, &lines, &hits);
    if (!hits.found)
        return;
    const bk_vec3 normal = bk_lane3(&hits.normal, 0);
    const bk_vec3w hit = bk_add_scaledw(start.origin, hits.t, start.direction);
    const bk_vec3 at = bk_add_scaled(bk_lane3(&hit, 0), BK_LIFT, normal);
    const bk_rays kind = bk_rays_of(params, 1);
    const bk_viewpoint from = {.normal = normal, .share = bk_sample_share(x, y, params->samples)};
    for (bk_uint i = 0; i < params->open_rays; i++) {
        const bk_vec3w d = bk_ray_directions(&kind, &from, i);
        float *ray = bench->rays[bench->count++];
        ray[0] = at.x;
        ray[1] = at.y;
        ray[2] = at.z;
        ray[3] = d.x;
        ray[4] = d.y;
        ray[5] = d.z;
    }
}

static int trace_patch(void *arg, const struct rays_patch *patch)
{
    struct bench *bench = arg;
    const uint32_t n = bench->scene.samples;
    const float limit = bench->scene.job.params.open_limit;
    bk_cache cache = bk_cache_empty();
    bench->count = 0;
    for (uint32_t row = 0; row < patch->patch.height * n; row++)
        for (uint32_t column = 0; column < patch->patch.width * n; column++) {
            const uint32_t triangle =
                patch->sample_triangles[(uint64_t)row * patch->patch.width * n + column];
            if (triangle != BK_NO_TRIANGLE)
                add_rays(bench, &bench->grid, &cache, triangle,
                         bk_sample_position(patch->patch.x + column / n, column % n, n),
                         bk_sample_position(patch->patch.y + row / n, row % n, n));
        }
    for (int way = 0; way < RAYS_WAYS; way++) {
        if (!rays_can_occlude(bench->embree, way))
            continue;
        bench->seconds[way] -= rays_seconds();
        bench->hidden[way] +=
            rays_occlude(bench->embree, way, (const float(*)[6])bench->rays, bench->count, limit);
        bench->seconds[way] += rays_seconds();
    }
    bench->total += bench->count;
    return bsq_check(bench->ctx);
}

static int trace_with_embree(struct bench *bench)
{
    const uint64_t most = (uint64_t)bench->scene.job.patch_texels * bench->scene.samples *
                          bench->scene.samples * bench->scene.job.params.open_rays;
    bench->total = 0;
    memset(bench->hidden, 0, sizeof bench->hidden);
    memset(bench->seconds, 0, sizeof bench->seconds);
    bake_kernel_grid(bench->scene.job.grid, &bench->scene.job.params, &bench->grid);
    int status = BSQ_ALLOC(bench->ctx, "rays", most, &bench->rays);
    if (status == 0)
        status = rays_for_patches(&bench->scene, trace_patch, bench);
    bsq_free(bench->ctx, bench->rays);
    return status;
}

/* Measures rays without end, and rays of a twentieth of the scan. */
static int measure_rays(struct bench *bench, float limit, const char *name)
{
    double ours[MAX_ROUNDS], embree[RAYS_WAYS][MAX_ROUNDS], ratios[MAX_ROUNDS];
    bench->scene.job.params.open_limit = limit;
    for (unsigned round = 0; round < bench->rounds; round++) {
        double alone = 0, both = 0;
        double fastest = 0;
        int status = trace(bench, BAKE_MAP_NORMAL, &alone);
        if (status == 0)
            status = trace(bench, BAKE_MAP_NORMAL | BAKE_MAP_AO, &both);
        if (status == 0)
            status = trace_with_embree(bench);
        if (status < 0)
            return status;
        const double rays = 1e-6 * (double)bench->total;
        ours[round] = rays / (both - alone);
        for (int way = 0; way < RAYS_WAYS; way++) {
            const double seconds = bench->seconds[way];
            if (seconds > 0 && fabs((double)bench->hidden[way] - (double)bench->hidden[0]) >
                                   1e-4 * (double)bench->total)
                return bsq_fail(bench->ctx, BSQ_EBUG, "Embree's ways to trace disagree");
            embree[way][round] = seconds > 0 ? rays / seconds : 0;
            if (embree[way][round] > fastest)
                fastest = embree[way][round];
        }
        ratios[round] = ours[round] / fastest;
    }
    printf("| %s | %.1f | %.3f | %.2f |", name, 1e-6 * (double)bench->total,
           1 - (double)bench->hidden[RAYS_SINGLE] / (double)bench->total,
           rays_median(ours, bench->rounds));
    for (int way = 0; way < RAYS_WAYS; way++)
        printf(" %.2f |", rays_median(embree[way], bench->rounds));
    printf(" %.2f |\n", rays_median(ratios, bench->rounds));
    return 0;
}

static int run(struct bench *bench)
{
    const double *low = bench->scene.surface.scan_min, *high = bench->scene.surface.scan_max;
    const double side = (high[2] - low[2]) / bench->scene.surface.unit;
    int status = measure_maps(bench);
    puts("\n| length of rays | M rays | open | grid, M/s | Embree, single | by 4 | by 8 | by 16 | "
         "streams | ratio to the fastest |\n|:--|--:|--:|--:|--:|--:|--:|--:|--:|--:|");
    if (status == 0)
        status = measure_rays(bench, BK_FAR, "no end");
    if (status == 0)
        status = measure_rays(bench, (float)(side / 20), "a twentieth of the height");
    return status;
}

int main(int argc, char **argv)
{
    static struct bench bench;
    if (argc != 8 || atoi(argv[7]) < 1 || atoi(argv[7]) > MAX_ROUNDS) {
        fputs("usage: bench-maps SCAN.nvdb SCAN.tris LOW.obj SIZE SAMPLES RAYS ROUNDS\n", stderr);
        return 64;
    }
    bench.rounds = (unsigned)atoi(argv[7]);
    if (bsq_ctx_create(&(struct bsq_ctx_options){.threads = 1}, &bench.ctx) < 0)
        return 71;
    int status = rays_open(bench.ctx, argv[1], argv[3], (uint32_t)atoi(argv[4]),
                           (uint32_t)atoi(argv[5]), &bench.scene);
    bench.scene.job.params.open_rays = (bk_uint)atoi(argv[6]);
    bench.scene.job.params.open_sine2 = 1.0f;
    bench.scene.job.params.coarse = BAKE_AO_COARSE;
    if (status == 0)
        status = rays_occluder_open(&bench.scene, argv[2], &bench.embree);
    if (status == 0)
        status = run(&bench);
    if (status < 0)
        fprintf(stderr, "bench-maps: %s\n", bsq_error(bench.ctx));
    rays_occluder_close(bench.embree);
    rays_close(&bench.scene);
    bsq_ctx_destroy(bench.ctx);
    return -status;
}
