/* costs.c - estimates what a bake or a task of a plan needs: memory, temporary files, time.
 *
 * A plan's id covers these numbers. So they follow from the inputs and options alone, not from
 * the budget and the threads of the program that writes the plan. decisions/0033 has the
 * measurements. */
#include <math.h>

#include "libbake/exact/exact.h"
#include "libbake/job/job.h"
#include "libbake/kernel/bk_sample.h"

/* Seconds of one core. */
static const double start_seconds = 0.03;
/* Of a sample's pair of rays; of a hit that sends rays; of a ray from a hit; of the curvature of a
 * texel. */
struct speed {
    double sample, look, open, thickness, curvature;
};
static const struct speed grid_speed = {0.35e-6, 0.6e-6, 0.2e-6, 0.35e-6, 3.0e-6};
/* Secondary rays on several scans do not go through a tree of leaves. */
static const struct speed walk_speed = {0.35e-6, 0.6e-6, 0.5e-6, 0.9e-6, 3.0e-6};
static const struct speed exact_speed = {0.95e-6, 0.0, 2.3e-6, 4.0e-6, 9.0e-6};
/* Of a triangle in a chunk that is loaded; of one in the tree that rays reach; of one in the chunks
 * that secondary rays need, which are all of the scan. */
static const double load_seconds = 0.16e-6, reach_seconds = 0.65e-6, look_seconds = 0.16e-6;

/* The threads whose buffers are counted. */
enum { THREADS = 8 };
enum {
    PROGRAM_BYTES = 24 << 20,
    TRIANGLE_BYTES = 432,       /* of a low-poly triangle: corners, and what the device gets */
    TILE_BYTES = 128 << 10,     /* of a thread that traces a grid */
    STREAM_BYTES = 512 << 10,   /* of a thread that traces secondary rays on a grid */
    TREE_LEAF_BYTES = 224,      /* of a grid's leaf in the tree for these rays, while it is built */
    TEXTURE_BYTES = 96 << 20,   /* of the libraries that read textures; not of the textures */
    LOOK_RAY_BYTES = 32,        /* of a hit that sends rays */
    CURVATURE_BYTES = 16 << 20, /* of rays for curvature on a grid */
    CURVATURE_RAYS = 8,         /* of a texel, on triangles */
    CURVATURE_RAY_BYTES = 32,   /* of such a ray, beside what all rays need */
};
/* Rays and chunks on triangles take more than this if the budget allows, but gain little by it. */
#define MOST_EXACT_BYTES (UINT64_C(4) << 30)

/* A task, as far as scans are concerned. */
struct share {
    const struct bake_work *job;
    double part; /* of all texels */
    uint64_t texels, samples;
};

static bool looks_around(const struct bake_work *job)
{
    return (job->maps & (BAKE_MAP_AO | BAKE_MAP_BENT | BAKE_MAP_THICKNESS)) != 0;
}

/* Returns whether secondary rays on a grid go through a tree of its leaves. */
static bool has_tree(const struct share *task)
{
    return looks_around(task->job) && task->job->surface.scan_count == 1;
}

/* Returns the seconds of rays against one scan, without those of loading it. */
static double ray_seconds(const struct share *task, const struct speed *speed)
{
    const struct bake_work *job = task->job;
    const struct bake_options *options = job->options;
    double sample = speed->sample, texel = 0;
    if (looks_around(job))
        sample += speed->look;
    if (job->maps & BAKE_MAP_CONFIDENCE)
        sample += speed->sample;
    if (job->maps & (BAKE_MAP_AO | BAKE_MAP_BENT))
        sample += bake_sample_rays(options, options->ao_rays) * speed->open;
    if (job->maps & BAKE_MAP_THICKNESS)
        sample += bake_sample_rays(options, options->thickness_rays) * speed->thickness;
    if (job->maps & BAKE_MAP_CURVATURE)
        texel += speed->curvature;
    return (double)task->samples * sample + (double)task->texels * texel;
}

/* Returns the seconds of loading chunks. A task's surface is taken to be a square: if it covers n
 * chunks, it touches (sqrt(n) + 1)^2. */
static double load_chunks_seconds(const struct share *task, const struct bake_exact *exact)
{
    const double triangles = (double)bake_exact_header(exact)->triangle_count;
    const double chunks = bake_exact_expect(exact, THREADS).chunk_count;
    const double own = triangles * task->part, side = sqrt(chunks * task->part) + 1;
    const double loaded = triangles * fmin(side * side / chunks, 1);
    const uint32_t passes = task->job->maps & BAKE_MAP_CURVATURE ? 2 : 1;
    double seconds = passes * loaded * load_seconds;
    seconds += fmin(own, (double)task->samples) * reach_seconds;
    return seconds + (looks_around(task->job) ? triangles * look_seconds : 0);
}

static double scan_seconds(const struct share *task, const struct bake_scan *scan)
{
    if (scan->exact)
        return ray_seconds(task, &exact_speed) + load_chunks_seconds(task, scan->exact);
    return ray_seconds(task, has_tree(task) ? &grid_speed : &walk_speed);
}

static uint64_t larger(uint64_t a, uint64_t b)
{
    return a > b ? a : b;
}

/* Returns the memory of tracing triangles, or of measuring curvature on them if that is more. */
static uint64_t exact_bytes(const struct share *task, const struct bake_exact *exact)
{
    const struct bake_exact_needs needs = bake_exact_expect(exact, THREADS);
    uint64_t bytes = task->samples * needs.ray_bytes;
    if (looks_around(task->job))
        bytes += needs.scan_bytes + task->samples * LOOK_RAY_BYTES;
    if (task->job->maps & BAKE_MAP_CURVATURE)
        bytes =
            larger(bytes, task->texels * CURVATURE_RAYS * (needs.ray_bytes + CURVATURE_RAY_BYTES));
    return needs.fixed_bytes + (bake_exact_wants_footprints(exact) ? TEXTURE_BYTES : 0) +
           (bytes < MOST_EXACT_BYTES ? bytes : MOST_EXACT_BYTES);
}

/* The same for a grid. */
static uint64_t grid_bytes(const struct share *task, const struct fmt_nvdb_grid *grid)
{
    uint64_t tracing = (uint64_t)THREADS * (looks_around(task->job) ? STREAM_BYTES : TILE_BYTES);
    if (has_tree(task))
        tracing += grid->leaf_count * TREE_LEAF_BYTES;
    return task->job->maps & BAKE_MAP_CURVATURE ? larger(tracing, CURVATURE_BYTES) : tracing;
}

/* Images are in memory if they fit half of the budget. */
void bake_expect_cost(const struct bake_work *job, uint64_t texels, uint64_t all,
                      struct bake_task_cost *cost)
{
    const uint64_t samples = (uint64_t)job->options->samples * job->options->samples;
    const struct share share = {job, all > 0 ? (double)texels / (double)all : 0, texels,
                                texels * samples},
                       *task = &share;
    const struct bake_surface *surface = &task->job->surface;
    uint64_t bytes = 0;
    cost->cpu_seconds = start_seconds;
    for (uint32_t i = 0; i < surface->scan_count; i++) {
        const struct bake_scan *scan = &surface->scans[i];
        cost->cpu_seconds += scan_seconds(task, scan);
        bytes = larger(bytes, scan->exact ? exact_bytes(task, scan->exact)
                                          : grid_bytes(task, &scan->grid));
    }
    cost->scratch_bytes = cost->part_bytes;
    cost->memory_bytes = PROGRAM_BYTES + task->job->mesh.triangle_count * TRIANGLE_BYTES +
                         cost->scratch_bytes + larger(bytes, cost->scratch_bytes);
}

/* Returns the texels that triangles of the low-poly mesh cover, without those that they share. */
static uint64_t covered_texels(const struct bake_work *job)
{
    double sum = 0, most = 0;
    for (uint32_t i = 0; i < job->udim.count; i++)
        most += (double)job->tiles[i].options.width * job->tiles[i].options.height;
    for (uint32_t i = 0; i < job->triangle_count; i++) {
        const struct bk_triangle *t = &job->triangles[i];
        const double det = (double)t->b1[0] * t->b2[1] - (double)t->b1[1] * t->b2[0];
        sum += isfinite(1 / det) ? fabs(0.5 / det) : 0;
    }
    return (uint64_t)fmin(sum, most);
}

void bake_expect_work(const struct bake_work *job)
{
    struct bake_report *report = job->report;
    const struct bake_options *options = job->options;
    const uint64_t texels = covered_texels(job);
    struct bake_task_cost cost = {0};
    uint64_t rays = 2;
    if (job->maps & (BAKE_MAP_AO | BAKE_MAP_BENT))
        rays += bake_sample_rays(options, options->ao_rays);
    if (job->maps & BAKE_MAP_THICKNESS)
        rays += bake_sample_rays(options, options->thickness_rays);
    if (job->maps & BAKE_MAP_CONFIDENCE)
        rays += 2;
    bake_expect_cost(job, texels, texels, &cost);
    report->expected_rays = texels * options->samples * options->samples * rays;
    report->expected_seconds = cost.cpu_seconds;
}
