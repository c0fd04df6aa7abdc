/* rays_embree.c - traces secondary rays against the triangles of the scan with Embree. Rays are the
 * same as for the grid; triangles are transformed to its index space. */
#include <embree3/rtcore.h>
#include <stddef.h>
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
    int status = BSQ_ALLOC(ctx, "positions", vertices + 1, &out->positions);
    if (status == 0)
        status = BSQ_ALLOC(ctx, "triangles", header->triangle_count, &out->indices);
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

static RTCScene build(RTCDevice device, const struct triangles *triangles)
{
    RTCScene scene = rtcNewScene(device);
    RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
    rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                               triangles->positions, 0, sizeof *triangles->positions,
                               triangles->vertices);
    rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                               triangles->indices, 0, sizeof *triangles->indices, triangles->count);
    rtcCommitGeometry(geometry);
    rtcAttachGeometry(scene, geometry);
    rtcReleaseGeometry(geometry);
    rtcCommitScene(scene);
    return scene;
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
    int status = BSQ_CALLOC(scene->ctx, "Embree", 1, out);
    if (status < 0)
        return status;
    struct rays_occluder *occluder = *out;
    occluder->ctx = scene->ctx;
    occluder->device = rtcNewDevice(NULL);
    if (!occluder->device)
        return bsq_fail(scene->ctx, BSQ_EBUG, "Embree does not start");
    status = read_triangles(scene, path, &occluder->triangles);
    if (status == 0)
        occluder->scene = build(occluder->device, &occluder->triangles);
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
    BSQ_FREE(occluder->ctx, occluder->triangles.positions, occluder->triangles.indices, occluder);
}

bool rays_can_occlude(const struct rays_occluder *occluder, enum rays_way way)
{
    static const enum RTCDeviceProperty needs[RAYS_WAYS] = {
        [RAYS_BY_4] = RTC_DEVICE_PROPERTY_NATIVE_RAY4_SUPPORTED,
        [RAYS_BY_8] = RTC_DEVICE_PROPERTY_NATIVE_RAY8_SUPPORTED,
        [RAYS_BY_16] = RTC_DEVICE_PROPERTY_NATIVE_RAY16_SUPPORTED,
        [RAYS_STREAM] = RTC_DEVICE_PROPERTY_RAY_STREAM_SUPPORTED};
    return way == RAYS_SINGLE || rtcGetDeviceProperty(occluder->device, needs[way]) != 0;
}

static struct RTCRay make_ray(const float r[6], float limit)
{
    return (struct RTCRay){.org_x = r[0],
                           .org_y = r[1],
                           .org_z = r[2],
                           .dir_x = r[3],
                           .dir_y = r[4],
                           .dir_z = r[5],
                           .tfar = limit,
                           .mask = ~0u};
}

static uint64_t occlude_single(RTCScene scene, const float (*rays)[6], uint64_t count, float limit)
{
    struct RTCIntersectContext context;
    uint64_t hidden = 0;
    rtcInitIntersectContext(&context);
    for (uint64_t i = 0; i < count; i++) {
        struct RTCRay ray = make_ray(rays[i], limit);
        rtcOccluded1(scene, &context, &ray);
        hidden += ray.tfar < 0;
    }
    return hidden;
}

enum { STREAM_RAYS = 1024 };

static uint64_t occlude_stream(RTCScene scene, const float (*rays)[6], uint64_t count, float limit)
{
    struct RTCIntersectContext context;
    struct RTCRay stream[STREAM_RAYS];
    uint64_t hidden = 0;
    rtcInitIntersectContext(&context);
    for (uint64_t first = 0; first < count; first += STREAM_RAYS) {
        const uint64_t left = count - first;
        const unsigned n = left < STREAM_RAYS ? (unsigned)left : STREAM_RAYS;
        for (unsigned i = 0; i < n; i++)
            stream[i] = make_ray(rays[first + i], limit);
        rtcOccluded1M(scene, &context, stream, n, sizeof *stream);
        for (unsigned i = 0; i < n; i++)
            hidden += stream[i].tfar < 0;
    }
    return hidden;
}

/* Rows of a packet, of n values each: members of struct RTCRay4, RTCRay8 and RTCRay16. */
enum { ORIGIN, DIRECTION = 4, END = 8, MASK, PACKET_ROWS = 12, PACKET_MOST = 16 };
_Static_assert(offsetof(struct RTCRay8, dir_x) == 32 * DIRECTION &&
                   offsetof(struct RTCRay8, tfar) == 32 * END &&
                   offsetof(struct RTCRay8, mask) == 32 * MASK &&
                   sizeof(struct RTCRay8) == 32 * PACKET_ROWS,
               "rows of eight values");

/* n: 4, 8 or 16. */
static inline uint64_t occlude_packets(RTCScene scene, const float (*rays)[6], uint64_t count,
                                       float limit, unsigned n)
{
    struct RTCIntersectContext context;
    _Alignas(64) float packet[PACKET_ROWS * PACKET_MOST];
    _Alignas(64) int valid[PACKET_MOST];
    uint64_t hidden = 0;
    rtcInitIntersectContext(&context);
    for (uint64_t first = 0; first < count; first += n) {
        memset(packet, 0, sizeof packet);
        for (unsigned k = 0; k < n; k++) {
            const float *r = rays[first + k < count ? first + k : first];
            valid[k] = first + k < count ? -1 : 0;
            for (unsigned axis = 0; axis < 3; axis++) {
                packet[(ORIGIN + axis) * n + k] = r[axis];
                packet[(DIRECTION + axis) * n + k] = r[3 + axis];
            }
            packet[END * n + k] = limit;
        }
        memset(&packet[(size_t)MASK * n], 0xff, n * sizeof *packet);
        if (n == 4)
            rtcOccluded4(valid, scene, &context, (struct RTCRay4 *)packet);
        else if (n == 8)
            rtcOccluded8(valid, scene, &context, (struct RTCRay8 *)packet);
        else
            rtcOccluded16(valid, scene, &context, (struct RTCRay16 *)packet);
        for (unsigned k = 0; k < n; k++)
            hidden += valid[k] && packet[END * n + k] < 0;
    }
    return hidden;
}

uint64_t rays_occlude(const struct rays_occluder *occluder, enum rays_way way,
                      const float (*rays)[6], uint64_t count, float limit)
{
    switch (way) {
    case RAYS_BY_4:
        return occlude_packets(occluder->scene, rays, count, limit, 4);
    case RAYS_BY_8:
        return occlude_packets(occluder->scene, rays, count, limit, 8);
    case RAYS_BY_16:
        return occlude_packets(occluder->scene, rays, count, limit, 16);
    case RAYS_STREAM:
        return occlude_stream(occluder->scene, rays, count, limit);
    default:
        return occlude_single(occluder->scene, rays, count, limit);
    }
}
