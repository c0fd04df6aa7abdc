/* nvdb_scene.c - random sparse voxels in a plain sorted list.
 *
 * Order and grouping follow from the coordinates by division, not by the bit fields that the
 * library uses, so that tests compare two independent computations. */
#include <stdlib.h>
#include <string.h>

#include "formats/material/channels.h"
#include "tests/unit/formats/grid/nvdb_scene.h"
#include "tests/grid_lookup.h"

uint64_t scene_next(uint64_t *state)
{
    *state ^= *state << 13;
    *state ^= *state >> 7;
    *state ^= *state << 17;
    return *state * UINT64_C(0x2545f4914f6cdd1d);
}

static int64_t floor_div(int64_t a, int64_t b)
{
    return (a - ((a % b + b) % b)) / b;
}

/* Returns a node's coordinate among nodes of edge `dim`; root tiles are ordered as unsigned
 * numbers. */
static int64_t node_rank(int32_t x, int32_t dim)
{
    int64_t node = floor_div(x, dim);
    return dim == 4096 && node < 0 ? node + (INT64_C(1) << 21) : node;
}

static int compare(const int32_t a[3], const int32_t b[3])
{
    static const int32_t dims[] = {4096, 128, 8, 1};
    for (int level = 0; level < 4; level++) {
        for (int axis = 0; axis < 3; axis++) {
            int64_t na = node_rank(a[axis], dims[level]), nb = node_rank(b[axis], dims[level]);
            if (na != nb)
                return na < nb ? -1 : 1;
        }
    }
    return 0;
}

static int compare_voxels(const void *a, const void *b)
{
    return compare(((const struct scene_voxel *)a)->ijk, ((const struct scene_voxel *)b)->ijk);
}

/* Returns a random valid record: no half of a normal is -32768, the plane is in the voxel, and
 * colours are opaque. */
static struct fmt_nvdb_record random_record(uint64_t *state)
{
    struct fmt_nvdb_record r = {(uint32_t)scene_next(state), (uint32_t)scene_next(state) & 0xffffff,
                                (uint32_t)scene_next(state) | 0xff000000u, 0};
    r.normal ^= (r.normal & 0xffff) == 0x8000;
    r.normal ^= r.normal >> 16 == 0x8000 ? 0x10000 : 0;
    int distance = (int16_t)(r.plane & 0xffff);
    if (abs(distance) > FMT_NVDB_PLANE_MAX)
        r.plane = (r.plane & 0xff0000) | ((uint32_t)(distance / 2) & 0xffff);
    return r;
}

static void fill_records(struct scene *scene, uint64_t *state)
{
    for (uint64_t i = 0; i < scene->count; i++) {
        struct scene_voxel *v = &scene->voxels[i];
        v->first = random_record(state);
        if (scene_next(state) % 5 == 0) {
            v->first.plane |= FMT_NVDB_PLANE_SECOND;
            v->second = random_record(state);
        }
    }
}

void scene_sort(struct scene *scene)
{
    qsort(scene->voxels, scene->count, sizeof(*scene->voxels), compare_voxels);
    uint64_t kept = 0;
    for (uint64_t i = 0; i < scene->count; i++)
        if (kept == 0 || compare(scene->voxels[kept - 1].ijk, scene->voxels[i].ijk) != 0)
            scene->voxels[kept++] = scene->voxels[i];
    scene->count = kept;
}

void scene_random(struct scene *scene, uint64_t seed, unsigned per_cluster)
{
    static const int32_t centres[][3] = {
        {0, 0, 0},       {-20, 300, -4096},  {4095, 4096, -1}, {127, 128, 255}, {-8192, 12000, 77},
        {4100, 5, 4200}, {-130, -4090, 130}, {3, 4, 5},        {60, 61, 62},
    };
    uint64_t state = seed * 2 + 1;
    uint64_t clusters = sizeof(centres) / sizeof(*centres);
    memset(scene, 0, sizeof(*scene));
    scene->voxels = calloc(clusters * per_cluster, sizeof(*scene->voxels));
    for (uint64_t c = 0; c < clusters; c++) {
        for (unsigned i = 0; i < per_cluster; i++) {
            int32_t *ijk = scene->voxels[scene->count++].ijk;
            for (int axis = 0; axis < 3; axis++)
                ijk[axis] = centres[c][axis] + (int32_t)(scene_next(&state) % 41) - 20;
        }
    }
    scene_sort(scene);
    fill_records(scene, &state);
    scene->info = (struct fmt_nvdb_info){
        .voxel_size = 0.037,
        .translation = {500000.123, -2.5, 1e-3},
        .has_color = true,
        .source_triangles = UINT64_C(1234567890123),
        .scan_min = {-1.5, -2.5, -3.5},
        .scan_max = {4.25, 5.25, 6.25},
    };
}

void scene_free(struct scene *scene)
{
    free(scene->voxels);
    memset(scene, 0, sizeof(*scene));
}

static bool same_node(const int32_t a[3], const int32_t b[3], int32_t dim)
{
    for (int axis = 0; axis < 3; axis++)
        if (floor_div(a[axis], dim) != floor_div(b[axis], dim))
            return false;
    return true;
}

static float channel_value(const int32_t ijk[3], uint32_t k, bool second)
{
    return (float)(ijk[0] % 64 - 2 * (ijk[1] % 32)) + 0.25f * (float)k + (second ? 1000.0f : 0.0f);
}

/* Appends the voxels [begin, end), which are in one region. */
static int append_region(struct fmt_nvdb_writer *writer, const struct scene *scene, uint64_t begin,
                         uint64_t end)
{
    uint64_t n = end - begin;
    uint16_t *ids = calloc(n, sizeof(*ids));
    uint64_t(*masks)[8] = calloc(n, sizeof(*masks));
    struct fmt_nvdb_record *records = calloc(n, sizeof(*records));
    struct fmt_nvdb_record *second = calloc(n, sizeof(*second));
    const char *list = scene->info.channels;
    const uint32_t words = list ? fmt_channel_list_values(list, strlen(list)) : 0;
    float *channels = calloc(n * words + 1, sizeof *channels);
    float *second_channels = calloc(n * words + 1, sizeof *second_channels);
    struct fmt_nvdb_region region = {
        .record_count = n, .channels = channels, .second_channels = second_channels};
    for (uint64_t i = begin; i < end; i++) {
        const struct scene_voxel *v = &scene->voxels[i];
        uint32_t in[3];
        for (int axis = 0; axis < 3; axis++) {
            region.origin[axis] = (int32_t)(floor_div(v->ijk[axis], 128) * 128);
            in[axis] = (uint32_t)(v->ijk[axis] - region.origin[axis]);
        }
        uint16_t id = (uint16_t)(in[0] / 8 * 256 + in[1] / 8 * 16 + in[2] / 8);
        if (region.leaf_count == 0 || ids[region.leaf_count - 1] != id)
            ids[region.leaf_count++] = id;
        masks[region.leaf_count - 1][in[0] % 8] |= UINT64_C(1) << (in[1] % 8 * 8 + in[2] % 8);
        records[i - begin] = v->first;
        for (uint32_t k = 0; k < words; k++) {
            channels[(i - begin) * words + k] = channel_value(v->ijk, k, false);
            second_channels[region.second_count * words + k] = channel_value(v->ijk, k, true);
        }
        if (v->first.plane & FMT_NVDB_PLANE_SECOND)
            second[region.second_count++] = v->second;
    }
    region.leaf_ids = ids;
    region.masks = (const uint64_t(*)[8])masks;
    region.records = records;
    region.second = second;
    int status = fmt_nvdb_append(writer, &region);
    free(ids);
    free(masks);
    free(records);
    free(second);
    free(channels);
    free(second_channels);
    return status;
}

int scene_write(struct bsq_ctx *ctx, const char *path, const struct scene *scene,
                struct fmt_nvdb_totals *totals)
{
    struct fmt_nvdb_writer *writer;
    int status = fmt_nvdb_create(ctx, path, &scene->info, &writer);
    if (status)
        return status;
    for (uint64_t i = 0, begin = 0; i < scene->count && status == 0; i++) {
        if (i + 1 < scene->count && same_node(scene->voxels[i].ijk, scene->voxels[i + 1].ijk, 128))
            continue;
        status = append_region(writer, scene, begin, i + 1);
        begin = i + 1;
    }
    if (status) {
        fmt_nvdb_discard(writer);
        return status;
    }
    return grid_commit(writer, totals);
}
