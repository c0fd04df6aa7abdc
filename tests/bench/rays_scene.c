/* rays_scene.c - prepares rays as bisque-bake does, and traces them patch by patch. */
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>

#include "base/context.h"
#include "base/parallel.h"
#include "libbake/fit/fit.h"
#include "tests/bench/rays.h"

static int choose_distances(struct rays_scene *scene)
{
    struct bake_options options;
    double front, back;
    bake_defaults(&options);
    options.as_is = true;
    int status = bake_fit(&scene->surface, &scene->mesh, &options, &front, &back);
    if (status == 0)
        bake_surface_set_lengths(&scene->surface, front, back);
    scene->job.params = scene->surface.params;
    return status;
}

static int make_raster(struct rays_scene *scene, uint32_t size)
{
    scene->patch_side = bake_patch_side(scene->ctx, size, size, scene->samples, 0);
    const struct bake_raster_options options = {.width = size,
                                                .height = size,
                                                .samples = scene->samples,
                                                .patch_side = scene->patch_side,
                                                .count = scene->mesh.triangle_count};
    struct bake_raster_report report = {0};
    int status = bake_raster_create(scene->ctx, &scene->mesh, &options, &report, &scene->raster);
    if (status == 0)
        status = BSQ_ALLOC(scene->ctx, "triangles", scene->mesh.triangle_count, &scene->triangles);
    if (status < 0)
        return status;
    bake_raster_kernel_triangles(scene->raster, scene->surface.translation, scene->surface.unit,
                                 scene->triangles);
    scene->patch_count = bake_raster_patch_count(scene->raster);
    return 0;
}

int rays_open(struct bsq_ctx *ctx, const char *scan, const char *mesh, uint32_t size,
              uint32_t samples, struct rays_scene *out)
{
    struct bake_options options;
    memset(out, 0, sizeof *out);
    out->ctx = ctx;
    out->samples = samples;
    bake_defaults(&options);
    options.scan_path = scan;
    options.mesh_path = mesh;
    int status = bake_surface_open(ctx, &options, &out->surface);
    if (status == 0 && out->surface.scans->exact)
        status = bsq_fail(ctx, BSQ_EDATA, "%s is not a grid", scan);
    if (status == 0)
        status = bake_lowmesh_load(ctx, &options, &out->mesh);
    if (status < 0)
        return status;
    options.samples = samples;
    bake_surface_set_params(&out->surface, &options, BAKE_MAP_NORMAL | BAKE_MAP_COLOR);
    status = choose_distances(out);
    if (status == 0)
        status = make_raster(out, size);
    out->job.grid = &out->surface.scans->grid;
    out->job.triangles = out->triangles;
    out->job.triangle_count = (uint32_t)out->mesh.triangle_count;
    out->job.patch_texels = out->patch_side * out->patch_side;
    return status;
}

void rays_close(struct rays_scene *scene)
{
    bsq_free(scene->ctx, scene->triangles);
    bake_raster_free(scene->raster);
    bake_lowmesh_free(scene->ctx, &scene->mesh);
    bake_surface_close(&scene->surface);
}

/* ---- patches ---- */

struct patch_loop {
    struct rays_scene *scene;
    uint32_t **sample_triangles; /* one per worker */
    float **texels;
    int (*fn)(void *arg, const struct rays_patch *patch);
    void *arg;
};

static int do_patch(void *arg, uint64_t index, unsigned worker)
{
    struct patch_loop *loop = arg;
    uint64_t overlaps;
    const struct rays_patch patch = {.worker = worker,
                                     .patch =
                                         bake_raster_patch(loop->scene->raster, (uint32_t)index),
                                     .sample_triangles = loop->sample_triangles[worker],
                                     .texels = loop->texels[worker]};
    int status = bake_raster_fill(loop->scene->raster, (uint32_t)index,
                                  loop->sample_triangles[worker], &overlaps);
    if (status < 0)
        return status;
    return loop->fn(loop->arg, &patch);
}

int rays_for_patches(struct rays_scene *scene, int (*fn)(void *arg, const struct rays_patch *patch),
                     void *arg)
{
    struct bsq_ctx *ctx = scene->ctx;
    const unsigned threads = bsq_threads(ctx);
    const uint64_t texels = scene->job.patch_texels;
    struct patch_loop loop = {.scene = scene, .fn = fn, .arg = arg};
    int status = bsq_calloc(ctx, "workers", threads, sizeof(void *), &loop.sample_triangles);
    if (status == 0)
        status = bsq_calloc(ctx, "workers", threads, sizeof(void *), &loop.texels);
    for (unsigned w = 0; status == 0 && w < threads; w++) {
        status = bsq_alloc(ctx, "samples", texels * scene->samples,
                           scene->samples * sizeof(uint32_t), &loop.sample_triangles[w]);
        if (status == 0)
            status =
                bsq_alloc(ctx, "texels", texels,
                          bk_texel_floats(scene->job.params.maps) * sizeof(float), &loop.texels[w]);
    }
    if (status == 0)
        status = bsq_parallel_for(ctx, scene->patch_count, do_patch, &loop);
    for (unsigned w = 0; w < threads; w++) {
        if (loop.sample_triangles)
            bsq_free(ctx, loop.sample_triangles[w]);
        if (loop.texels)
            bsq_free(ctx, loop.texels[w]);
    }
    BSQ_FREE(ctx, loop.sample_triangles, loop.texels);
    return status;
}

/* ---- tracing on a device ---- */

static int trace_patch(void *arg, const struct rays_patch *patch)
{
    return bake_device_trace(arg, &patch->patch, patch->sample_triangles, patch->texels,
                             patch->worker);
}

double rays_seconds(void)
{
    struct rusage usage;
    getrusage(RUSAGE_SELF, &usage);
    return (double)usage.ru_utime.tv_sec + (double)usage.ru_stime.tv_sec +
           1e-6 * (double)(usage.ru_utime.tv_usec + usage.ru_stime.tv_usec);
}

static int by_value(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

double rays_median(double *values, unsigned count)
{
    qsort(values, count, sizeof *values, by_value);
    return count % 2 ? values[count / 2] : (values[count / 2 - 1] + values[count / 2]) / 2;
}

int rays_trace(struct rays_scene *scene, struct bake_device *device, double *seconds)
{
    *seconds = -rays_seconds();
    int status = rays_for_patches(scene, trace_patch, device);
    *seconds += rays_seconds();
    return status;
}
