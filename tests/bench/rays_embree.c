/* rays_embree.c - traces the rays of a map against the triangles of the scan with Embree. Rays are
 * the same as for the grid; triangles are transformed to its index space. */
#include <embree3/rtcore.h>
#include <string.h>

#include "base/context.h"
#include "formats/chunks/tris.h"
#include "libbake/kernel/bk_sample.h"
#include "tests/bench/rays.h"

struct triangles {
    float (*positions)[3];
    uint32_t (*indices)[3];
    uint64_t vertices, count;
};

struct tally {
    uint64_t hits;
};

struct embree {
    const struct rays_scene *scene;
    RTCScene rtc;
    struct tally *tallies; /* one per worker */
};

/* ---- building ---- */

static void add_chunk(const struct rays_scene *scene, const double origin[3],
                      const struct fmt_tris_chunk *chunk, struct triangles *out)
{
    for (uint32_t v = 0; v < chunk->vertex_count; v++)
        for (int k = 0; k < 3; k++)
            out->positions[out->vertices + v][k] =
                (float)((origin[k] + (double)chunk->positions[v][k] -
                         scene->surface.translation[k]) /
                        scene->surface.unit);
    for (uint32_t t = 0; t < chunk->triangle_count; t++)
        for (int k = 0; k < 3; k++)
            out->indices[out->count + t][k] = (uint32_t)out->vertices + chunk->triangles[t][k];
    out->vertices += chunk->vertex_count;
    out->count += chunk->triangle_count;
}

static int load(const struct rays_scene *scene, struct fmt_tris_file *file, struct triangles *out)
{
    struct bsq_ctx *ctx = scene->ctx;
    const struct fmt_tris_header *header = fmt_tris_get_header(file);
    const struct fmt_tris_chunk_info *chunks = fmt_tris_chunks(file);
    uint64_t vertices = 0;
    void *scratch = NULL;
    for (uint64_t i = 0; i < header->chunk_count; i++)
        vertices += chunks[i].vertex_count;
    /* One position is spare: Embree reads 16 bytes at each. */
    int status = bsq_alloc(ctx, "positions", vertices + 1, sizeof *out->positions, &out->positions);
    if (status == 0)
        status = bsq_alloc(ctx, "triangles", header->triangle_count, sizeof *out->indices,
                           &out->indices);
    if (status == 0)
        status = bsq_alloc(ctx, "chunk", fmt_tris_load_size_max(file), 1, &scratch);
    for (uint64_t i = 0; i < header->chunk_count && status == 0; i++) {
        struct fmt_tris_chunk chunk;
        status = fmt_tris_load(file, i, scratch, &chunk);
        if (status == 0)
            add_chunk(scene, header->origin, &chunk, out);
    }
    bsq_free(ctx, scratch);
    return status;
}

/* Rejects hits of surfaces that face against the low-poly mesh's normal, as the kernel does. Rays
 * against the normal have id 1. */
static void only_facing(const struct RTCFilterFunctionNArguments *a)
{
    const struct RTCRay *ray = (const struct RTCRay *)a->ray;
    const struct RTCHit *hit = (const struct RTCHit *)a->hit;
    const float along = hit->Ng_x * ray->dir_x + hit->Ng_y * ray->dir_y + hit->Ng_z * ray->dir_z;
    if (!((ray->id ? -along : along) > 0.0f))
        a->valid[0] = 0;
}

static RTCScene build(RTCDevice device, const struct triangles *triangles, bool filtered)
{
    RTCScene scene = rtcNewScene(device);
    RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
    rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                               triangles->positions, 0, sizeof *triangles->positions,
                               triangles->vertices);
    rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                               triangles->indices, 0, sizeof *triangles->indices, triangles->count);
    if (filtered)
        rtcSetGeometryIntersectFilterFunction(geometry, only_facing);
    rtcCommitGeometry(geometry);
    rtcAttachGeometry(scene, geometry);
    rtcReleaseGeometry(geometry);
    rtcCommitScene(scene);
    return scene;
}

/* ---- tracing ---- */

static bool intersect(RTCScene scene, bk_vec3w o, bk_vec3w d, float far, bool against, float *t)
{
    struct RTCIntersectContext context;
    struct RTCRayHit ray = {.ray = {.org_x = o.x,
                                    .org_y = o.y,
                                    .org_z = o.z,
                                    .dir_x = d.x,
                                    .dir_y = d.y,
                                    .dir_z = d.z,
                                    .tfar = far,
                                    .mask = ~0u,
                                    .id = against},
                            .hit = {.geomID = RTC_INVALID_GEOMETRY_ID}};
    rtcInitIntersectContext(&context);
    context.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
    rtcIntersect1(scene, &context, &ray);
    *t = ray.ray.tfar;
    return ray.hit.geomID != RTC_INVALID_GEOMETRY_ID;
}

/* Traces a ray outwards, and one inwards that is no longer than the distance of the first hit. */
static bool trace_pair(const struct embree *embree, uint32_t triangle, float x, float y)
{
    const struct bk_params *params = &embree->scene->job.params;
    const bk_point point = bk_point_at(&embree->scene->triangles[triangle], x, y);
    const bk_vec3w d = bk_unitw(point.direction), back = {-d.x, -d.y, -d.z};
    float t = params->back, unused;
    bool found = intersect(embree->rtc, point.position, d, params->front, false, &unused);
    if (found && unused < t)
        t = unused;
    return intersect(embree->rtc, point.position, back, t, true, &unused) || found;
}

static int trace_tile(void *arg, const struct rays_tile *tile)
{
    const struct embree *embree = arg;
    const uint32_t n = embree->scene->samples;
    struct tally *tally = &embree->tallies[tile->worker];
    for (uint32_t row = 0; row < tile->tile.height * n; row++)
        for (uint32_t column = 0; column < tile->tile.width * n; column++) {
            const uint32_t triangle =
                tile->sample_triangles[(uint64_t)row * tile->tile.width * n + column];
            if (triangle == BK_NO_TRIANGLE)
                continue;
            tally->hits += trace_pair(embree, triangle,
                                      bk_sample_place(tile->tile.x + column / n, column % n, n),
                                      bk_sample_place(tile->tile.y + row / n, row % n, n));
        }
    return 0;
}

static int trace(struct rays_scene *scene, RTCScene rtc, struct rays_cost *cost)
{
    struct embree embree = {.scene = scene, .rtc = rtc};
    int status = bsq_calloc(scene->ctx, "tallies", bsq_threads(scene->ctx), sizeof *embree.tallies,
                            &embree.tallies);
    if (status < 0)
        return status;
    rays_cost_begin(cost);
    status = rays_for_tiles(scene, trace_tile, &embree);
    rays_cost_end(cost);
    for (unsigned w = 0; w < bsq_threads(scene->ctx); w++)
        cost->hits += embree.tallies[w].hits;
    bsq_free(scene->ctx, embree.tallies);
    return status;
}

static int read_triangles(const struct rays_scene *scene, const char *path, struct triangles *out)
{
    struct fmt_tris_file *file = NULL;
    int status = fmt_tris_open(scene->ctx, path, &file);
    if (status == 0)
        status = load(scene, file, out);
    if (file)
        fmt_tris_close(file);
    return status;
}

/* ---- rays that any hit ends ---- */

struct rays_occluder {
    struct bsq_ctx *ctx;
    struct triangles triangles;
    RTCDevice device;
    RTCScene scene;
};

int rays_occluder_open(const struct rays_scene *scene, const char *path, struct rays_occluder **out)
{
    int status = bsq_calloc(scene->ctx, "Embree", 1, sizeof **out, out);
    if (status < 0)
        return status;
    struct rays_occluder *occluder = *out;
    occluder->ctx = scene->ctx;
    occluder->device = rtcNewDevice(NULL);
    if (!occluder->device)
        return bsq_fail(scene->ctx, BSQ_EBUG, "Embree does not start");
    status = read_triangles(scene, path, &occluder->triangles);
    if (status == 0)
        occluder->scene = build(occluder->device, &occluder->triangles, false);
    return status;
}

void rays_occluder_close(struct rays_occluder *occluder)
{
    if (!occluder)
        return;
    if (occluder->scene)
        rtcReleaseScene(occluder->scene);
    if (occluder->device)
        rtcReleaseDevice(occluder->device);
    bsq_free(occluder->ctx, occluder->triangles.positions);
    bsq_free(occluder->ctx, occluder->triangles.indices);
    bsq_free(occluder->ctx, occluder);
}

uint64_t rays_occluded1(const struct rays_occluder *occluder, const float (*rays)[6],
                        uint64_t count, float limit)
{
    struct RTCIntersectContext context;
    uint64_t hidden = 0;
    rtcInitIntersectContext(&context);
    for (uint64_t i = 0; i < count; i++) {
        const float *r = rays[i];
        struct RTCRay ray = {.org_x = r[0],
                             .org_y = r[1],
                             .org_z = r[2],
                             .dir_x = r[3],
                             .dir_y = r[4],
                             .dir_z = r[5],
                             .tfar = limit,
                             .mask = ~0u};
        rtcOccluded1(occluder->scene, &context, &ray);
        hidden += ray.tfar < 0;
    }
    return hidden;
}

uint64_t rays_occluded8(const struct rays_occluder *occluder, const float (*rays)[6],
                        uint64_t count, float limit)
{
    struct RTCIntersectContext context;
    uint64_t hidden = 0;
    rtcInitIntersectContext(&context);
    for (uint64_t i = 0; i < count; i += 8) {
        _Alignas(32) int valid[8];
        struct RTCRay8 packet = {0};
        for (int k = 0; k < 8; k++) {
            const float *r = rays[i + (uint64_t)k < count ? i + (uint64_t)k : i];
            valid[k] = i + (uint64_t)k < count ? -1 : 0;
            packet.org_x[k] = r[0];
            packet.org_y[k] = r[1];
            packet.org_z[k] = r[2];
            packet.dir_x[k] = r[3];
            packet.dir_y[k] = r[4];
            packet.dir_z[k] = r[5];
            packet.tfar[k] = limit;
            packet.mask[k] = ~0u;
        }
        rtcOccluded8(valid, occluder->scene, &context, &packet);
        for (int k = 0; k < 8; k++)
            hidden += valid[k] && packet.tfar[k] < 0;
    }
    return hidden;
}

/* ---- nearest hits ---- */

int rays_embree(struct rays_scene *scene, const char *path, struct rays_cost *building,
                struct rays_cost *cost)
{
    struct triangles triangles = {0};
    RTCDevice device = rtcNewDevice(NULL);
    if (!device)
        return bsq_fail(scene->ctx, BSQ_EBUG, "Embree does not start");
    int status = read_triangles(scene, path, &triangles);
    if (status == 0) {
        rays_cost_begin(building);
        RTCScene rtc = build(device, &triangles, true);
        rays_cost_end(building);
        status = trace(scene, rtc, cost);
        rtcReleaseScene(rtc);
    }
    rtcReleaseDevice(device);
    bsq_free(scene->ctx, triangles.positions);
    bsq_free(scene->ctx, triangles.indices);
    return status;
}
