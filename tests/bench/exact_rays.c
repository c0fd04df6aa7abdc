/* exact_rays.c - secondary rays against a scan's triangles: as bakes from chunk files trace them,
 * and with Embree, with the same rays, one thread and in the same rounds. */
#include <float.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "base/context.h"
#include "base/geometry/vec.h"
#include "formats/chunks/tris.h"
#include "libbake/exact/exact.h"
#include "tests/bench/rays.h"

enum { MAX_ROUNDS = 15, RAY_BATCH = 1 << 16 };
/* What is measured: a bake's tracing, what making its rays takes of that, and ways of Embree. */
enum { OURS, MAKING, SINGLE, BY_8, STREAMS, JOBS };
static const enum rays_way ways[JOBS] = {
    [SINGLE] = RAYS_SINGLE, [BY_8] = RAYS_BY_8, [STREAMS] = RAYS_STREAM};

struct bench {
    struct bsq_ctx *ctx;
    struct rays_scene scene; /* only what places Embree's triangles */
    struct rays_occluder *embree;
    struct bake_exact *exact;
    struct bake_exact_look *look;
    struct bk_params params;
    struct bake_ray_states states;
    bk_viewpoint *points;
    uint64_t point_count;
    float (*rays)[6]; /* RAY_BATCH */
    float unused;     /* keeps the making of rays */
    uint64_t hidden[JOBS];
    double seconds[JOBS];
};

/* ---- points of the scan ---- */

static bk_vec3 vector(struct bsq_vec3 v)
{
    return bk_v3(v.x, v.y, v.z);
}

/* Makes a point of a triangle's middle; rays start above its facet, as bakes let them start. */
static void add_point(struct bench *bench, const struct fmt_tris_chunk *chunk, uint32_t triangle)
{
    struct bsq_vec3 p[3];
    for (int k = 0; k < 3; k++) {
        const float *at = chunk->positions[chunk->triangles[triangle][k]];
        p[k] = bsq_v3(at[0], at[1], at[2]);
    }
    const struct bsq_vec3 cross = bsq_cross3(bsq_sub3(p[1], p[0]), bsq_sub3(p[2], p[0]));
    const float length = sqrtf(bsq_dot3(cross, cross));
    if (!(length > 0))
        return;
    const struct bsq_vec3 facet = bsq_scale3(cross, 1 / length);
    const struct bsq_vec3 middle = bsq_scale3(bsq_add3(bsq_add3(p[0], p[1]), p[2]), 1.0f / 3);
    const struct bsq_vec3 lift = bsq_scale3(facet, 2 * bake_exact_lift(bench->exact));
    bench->points[bench->point_count] =
        (bk_viewpoint){.open_from = vector(bsq_add3(middle, lift)),
                       .solid_from = vector(middle),
                       .normal = vector(facet),
                       .facet = vector(facet),
                       .side = 1,
                       .share = {.seed = bk_hash((uint32_t)bench->point_count)}};
    bench->point_count++;
}

/* Takes up to `most` triangles at equal steps through the chunks, so neighbours follow each other.
 */
static int take_points(struct bench *bench, const char *path, uint64_t most)
{
    struct fmt_tris_file *file;
    void *scratch = NULL;
    int status;
    BSQ_PASS(fmt_tris_open(bench->ctx, path, &file));
    const struct fmt_tris_header *header = fmt_tris_get_header(file);
    const uint64_t step = header->triangle_count / most + 1;
    uint64_t first = 0; /* of a chunk */
    BSQ_TRY(BSQ_ALLOC(bench->ctx, "points", header->triangle_count / step + 1, &bench->points));
    BSQ_TRY(bsq_alloc(bench->ctx, "chunk", fmt_tris_load_size_max(file), 1, &scratch));
    for (uint64_t c = 0; c < header->chunk_count; c++) {
        struct fmt_tris_chunk chunk;
        BSQ_TRY(fmt_tris_load(file, c, scratch, &chunk));
        for (uint64_t t = (step - first % step) % step; t < chunk.triangle_count; t += step)
            add_point(bench, &chunk, (uint32_t)t);
        first += chunk.triangle_count;
    }
    memcpy(bench->scene.surface.translation, header->origin,
           sizeof bench->scene.surface.translation);
done:
    bsq_free(bench->ctx, scratch);
    fmt_tris_close(file);
    return status;
}

static bool get_point(const void *arg, uint64_t index, bk_viewpoint *out)
{
    *out = ((const struct bench *)arg)->points[index];
    return true;
}

/* ---- rays ---- */

/* Makes the rays of points [begin, end), in the order of a bake. Returns their number. */
static uint64_t make_rays(struct bench *bench, uint64_t begin, uint64_t end)
{
    const bk_rays kind = bk_rays_of(&bench->params, 1);
    uint64_t count = 0;
    for (uint64_t i = begin; i < end; i++)
        for (bk_uint r = 0; r < kind.count; r++, count++) {
            const bk_vec3 from = bk_ray_start(&kind, &bench->points[i]);
            const bk_vec3w d = bk_ray_directions(&kind, &bench->points[i], r);
            const float ray[6] = {from.x, from.y, from.z, d.x, d.y, d.z};
            memcpy(bench->rays[count], ray, sizeof ray);
        }
    return count;
}

/* Makes all rays, and traces them with Embree. */
static void trace_with_embree(struct bench *bench)
{
    const uint64_t step = RAY_BATCH / bench->params.open_rays;
    for (uint64_t begin = 0; begin < bench->point_count; begin += step) {
        const uint64_t left = bench->point_count - begin;
        bench->seconds[MAKING] -= rays_seconds();
        const uint64_t count = make_rays(bench, begin, begin + (left < step ? left : step));
        bench->seconds[MAKING] += rays_seconds();
        bench->unused += bench->rays[count - 1][3];
        for (int job = SINGLE; job < JOBS; job++) {
            if (!rays_can_occlude(bench->embree, ways[job]))
                continue;
            bench->seconds[job] -= rays_seconds();
            bench->hidden[job] +=
                rays_occlude(bench->embree, ways[job], (const float(*)[6])bench->rays, count,
                             bench->params.open_limit);
            bench->seconds[job] += rays_seconds();
        }
    }
}

static int trace_as_bakes_do(struct bench *bench)
{
    const struct bake_viewpoints points = {
        .get = get_point, .arg = bench, .count = bench->point_count, .unit = 1};
    const uint64_t words = bench->states.words * bench->point_count;
    memset(bench->states.hidden, 0, words * sizeof *bench->states.hidden);
    bench->seconds[OURS] -= rays_seconds();
    const int status = bake_exact_look_from(bench->look, &points, &bench->states);
    bench->seconds[OURS] += rays_seconds();
    for (uint64_t i = 0; i < words; i++)
        bench->hidden[OURS] += (uint64_t)__builtin_popcountll(bench->states.hidden[i]);
    return status;
}

/* ---- measuring ---- */

static int measure(struct bench *bench, float limit, const char *name, unsigned rounds)
{
    const double all = (double)(bench->point_count * bench->params.open_rays);
    double rates[JOBS][MAX_ROUNDS], ratios[MAX_ROUNDS];
    bench->params.open_limit = limit;
    for (unsigned round = 0; round < rounds; round++) {
        memset(bench->seconds, 0, sizeof bench->seconds);
        memset(bench->hidden, 0, sizeof bench->hidden);
        BSQ_PASS(trace_as_bakes_do(bench));
        trace_with_embree(bench);
        for (int job = 0; job < JOBS; job++)
            rates[job][round] = bench->seconds[job] > 0 ? 1e-6 * all / bench->seconds[job] : 0;
        ratios[round] = rates[OURS][round] / rates[SINGLE][round];
    }
    const double difference = (double)bench->hidden[OURS] - (double)bench->hidden[SINGLE];
    if (fabs(difference) > 1e-3 * all)
        return bsq_fail(bench->ctx, BSQ_EBUG, "%.0f rays differ from Embree's", fabs(difference));
    printf("| %s | %.1f | %.3f |", name, 1e-6 * all, 1 - (double)bench->hidden[SINGLE] / all);
    for (int job = 0; job < JOBS; job++)
        printf(" %.2f |", rays_median(rates[job], rounds));
    printf(" %.2f |\n", rays_median(ratios, rounds));
    fflush(stdout);
    return 0;
}

static int prepare(struct bench *bench, const char *path, uint64_t points, uint32_t rays)
{
    struct bake_options options;
    bake_defaults(&options);
    bench->scene.ctx = bench->ctx;
    bench->scene.surface.unit = 1;
    bench->params = (struct bk_params){.maps = BK_OPEN_MAPS,
                                       .unit = 1,
                                       .samples = 1,
                                       .open_rays = rays,
                                       .open_limit = FLT_MAX,
                                       .open_sine2 = 1};
    BSQ_PASS(bake_exact_open(bench->ctx, path, &options, &bench->exact));
    BSQ_PASS(take_points(bench, path, points));
    bench->states = (struct bake_ray_states){
        .opens = rays, .words = (rays + 63) / 64, .capacity = bench->point_count};
    BSQ_PASS(BSQ_ALLOC(bench->ctx, "states", bench->states.words * bench->point_count,
                       &bench->states.hidden));
    BSQ_PASS(BSQ_ALLOC(bench->ctx, "rays", RAY_BATCH, &bench->rays));
    BSQ_PASS(rays_occluder_open(&bench->scene, path, &bench->embree));
    return bake_exact_look_create(bench->exact, &bench->params, &bench->look);
}

static int run(struct bench *bench, unsigned rounds)
{
    const struct fmt_tris_header *header = bake_exact_header(bench->exact);
    const float height = header->bounds_max[2] - header->bounds_min[2];
    BSQ_PASS(trace_as_bakes_do(bench)); /* loads the chunks and builds their trees */
    const uint64_t loads = bake_exact_loads(bench->exact);
    puts("| length of rays | M rays | open | exact, M/s | making rays | Embree, single | by 8 | "
         "streams | ratio to single |\n|:--|--:|--:|--:|--:|--:|--:|--:|--:|");
    BSQ_PASS(measure(bench, FLT_MAX, "no end", rounds));
    BSQ_PASS(measure(bench, height / 20, "a twentieth of the height", rounds));
    if (bake_exact_loads(bench->exact) != loads)
        fputs("bench-exact-rays: chunks did not fit, and were loaded again\n", stderr);
    return 0;
}

int main(int argc, char **argv)
{
    static struct bench bench;
    const int rounds = argc == 5 ? atoi(argv[4]) : 0, rays = argc == 5 ? atoi(argv[3]) : 0;
    if (rounds < 1 || rounds > MAX_ROUNDS || rays < 1 || rays > RAY_BATCH || atoi(argv[2]) < 1) {
        fputs("usage: bench-exact-rays SCAN.tris POINTS RAYS ROUNDS\n", stderr);
        return 64;
    }
    if (bsq_ctx_create(&(struct bsq_ctx_options){.threads = 1}, &bench.ctx) < 0)
        return 71;
    int status = prepare(&bench, argv[1], (uint64_t)atoi(argv[2]), (uint32_t)rays);
    if (status == 0)
        status = run(&bench, (unsigned)rounds);
    if (status < 0)
        fprintf(stderr, "bench-exact-rays: %s\n", bsq_error(bench.ctx));
    rays_occluder_close(bench.embree);
    bake_exact_look_free(bench.look);
    bake_exact_close(bench.exact);
    BSQ_FREE(bench.ctx, bench.rays, bench.states.hidden, bench.points);
    bsq_ctx_destroy(bench.ctx);
    return -status;
}
