/* costs.c - estimates the time that a bake or a part of it takes, by which users wait and devices
 * are chosen. decisions/0033 has the measurements. */
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
static const struct speed exact_speed = {0.95e-6, 0.0, 2.3e-6, 4.0e-6, 9.0e-6};
/* A grid on a GPU: seconds of the card (an H100), and of one core, whose work goes on beside it;
 * then seconds to open the card, and how many bytes of the grid reach it in a second. */
static const struct speed gpu_speed = {1.0e-9, 1.0e-9, 0.92e-9, 2.7e-9, 10e-9};
static const struct speed beside_gpu_speed = {0.1e-6, 0.0, 0.0, 0.0, 0.4e-6};
/* Likewise of triangles, whose hits the processor shades. The card's are aims, and what the bus
 * takes of first rays: no card has been measured. */
static const struct speed exact_gpu_speed = {10e-9, 0.0, 2.7e-9, 5.0e-9, 60e-9};
static const struct speed beside_exact_gpu_speed = {0.65e-6, 0.0, 0.0, 0.0, 6.2e-6};
static const double gpu_seconds = 0.5, upload_bytes = 8e9, triangle_bytes = 60;
/* Of a triangle in a chunk that is loaded; of one in the tree that rays reach; of one in the chunks
 * that secondary rays need, which are all of the scan. */
static const double load_seconds = 0.16e-6, reach_seconds = 0.65e-6, look_seconds = 0.16e-6;

/* A bake, as far as scans are concerned. */
struct share {
    const struct bake_job *job;
    uint64_t texels, samples;
};

static bool looks_around(const struct bake_job *job)
{
    return (job->maps & (BAKE_MAP_AO | BAKE_MAP_BENT | BAKE_MAP_THICKNESS)) != 0;
}

/* Returns the seconds of rays against one scan, without those of loading it. */
static double ray_seconds(const struct share *share, const struct speed *speed)
{
    const struct bake_job *job = share->job;
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
    return (double)share->samples * sample + (double)share->texels * texel;
}

/* Returns the seconds of loading chunks. */
static double load_chunks_seconds(const struct share *share, const struct bake_exact *exact)
{
    const double triangles = (double)bake_exact_header(exact)->triangle_count;
    const uint32_t passes = share->job->maps & BAKE_MAP_CURVATURE ? 2 : 1;
    double seconds = passes * triangles * load_seconds;
    seconds += fmin(triangles, (double)share->samples) * reach_seconds;
    return seconds + (looks_around(share->job) ? triangles * look_seconds : 0);
}

static double scan_seconds(const struct share *share, const struct bake_scan *scan)
{
    if (scan->exact)
        return ray_seconds(share, &exact_speed) + load_chunks_seconds(share, scan->exact);
    return ray_seconds(share, &grid_speed);
}

/* Likewise with a GPU. */
static double gpu_scan_seconds(const struct share *share, const struct bake_scan *scan)
{
    const double threads = bsq_threads(share->job->ctx);
    if (!scan->exact)
        return ray_seconds(share, &gpu_speed) + ray_seconds(share, &beside_gpu_speed) / threads +
               (double)scan->grid.map.size / upload_bytes;
    const double triangles = (double)bake_exact_header(scan->exact)->triangle_count,
                 beside = ray_seconds(share, &beside_exact_gpu_speed) +
                          load_chunks_seconds(share, scan->exact);
    return ray_seconds(share, &exact_gpu_speed) + beside / threads +
           triangles * triangle_bytes / upload_bytes;
}

static struct share share_of(const struct bake_job *job, uint64_t texels)
{
    const uint64_t samples = (uint64_t)job->options->samples * job->options->samples;
    return (struct share){job, texels, texels * samples};
}

/* Returns the seconds that the bake is expected to take on one core. texels: how many it covers. */
static double expect_seconds(const struct bake_job *job, uint64_t texels)
{
    const struct share share = share_of(job, texels);
    double seconds = start_seconds;
    for (uint32_t i = 0; i < job->surface.scan_count; i++)
        seconds += scan_seconds(&share, &job->surface.scans[i]);
    return seconds;
}

bool bake_expect_processor_first(const struct bake_job *job, uint64_t texels)
{
    const struct share share = share_of(job, texels);
    double gpu = gpu_seconds;
    for (uint32_t i = 0; i < job->surface.scan_count; i++)
        gpu += gpu_scan_seconds(&share, &job->surface.scans[i]);
    return expect_seconds(job, texels) / bsq_threads(job->ctx) <= gpu;
}

/* Returns the texels that triangles of the low-poly mesh cover, without those that they share. */
static uint64_t covered_texels(const struct bake_job *job)
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

uint64_t bake_expect_work(const struct bake_job *job)
{
    struct bake_report *report = job->report;
    const struct bake_options *options = job->options;
    const uint64_t texels = covered_texels(job);
    uint64_t rays = 2;
    if (job->maps & (BAKE_MAP_AO | BAKE_MAP_BENT))
        rays += bake_sample_rays(options, options->ao_rays);
    if (job->maps & BAKE_MAP_THICKNESS)
        rays += bake_sample_rays(options, options->thickness_rays);
    if (job->maps & BAKE_MAP_CONFIDENCE)
        rays += 2;
    report->expected_rays = texels * options->samples * options->samples * rays;
    report->expected_seconds = expect_seconds(job, texels);
    return texels;
}
