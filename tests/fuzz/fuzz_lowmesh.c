/* fuzz_lowmesh.c - fuzz target for low-poly meshes: each mesh that loads has tangent frames of unit
 * vectors, and can be rasterised in small patches with several samples a texel. */
#include "tests/fuzz/fuzz_file.h"

#include <math.h>

#include "libbake/raster/raster.h"
#include "libbake/udim/udim.h"

enum { SIDE = 12, SAMPLES = 2, PATCH = 5 };

static float length(const float v[3])
{
    return sqrtf(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
}

static void check_mesh(const struct bake_lowmesh *mesh)
{
    require(mesh->triangle_count > 0, "a mesh has no triangles");
    for (uint64_t t = 0; t < mesh->triangle_count; t++)
        for (int i = 0; i < 3; i++) {
            float tangent = length(mesh->tangents[t][i]), sign = mesh->tangents[t][i][3];
            require(fabsf(length(mesh->normals[t][i]) - 1.0f) < 1e-3f,
                    "a normal is not a unit vector");
            require(tangent == 0.0f || fabsf(tangent - 1.0f) < 1e-3f,
                    "a tangent is not a unit vector");
            require(sign == 1.0f || sign == -1.0f, "a bitangent sign is not 1 or -1");
            require(isfinite(mesh->texcoords[t][i][0]) && isfinite(mesh->texcoords[t][i][1]),
                    "a texture coordinate is not finite");
        }
}

static void check_patch(const struct bake_raster *raster, const struct bake_lowmesh *mesh,
                        uint32_t index)
{
    uint32_t samples[PATCH * PATCH * SAMPLES * SAMPLES];
    struct bk_patch patch = bake_raster_patch(raster, index);
    uint64_t overlaps = 0;
    require(patch.width > 0 && patch.width <= PATCH && patch.x + patch.width <= SIDE,
            "a patch is out of range");
    require(patch.height > 0 && patch.height <= PATCH && patch.y + patch.height <= SIDE - 1,
            "a patch is out of range");
    require(bake_raster_fill(raster, index, samples, &overlaps) == 0, "rasterising failed");
    for (uint32_t i = 0; i < patch.width * patch.height * SAMPLES * SAMPLES; i++)
        require(samples[i] == BK_NO_TRIANGLE || samples[i] < mesh->triangle_count,
                "a sample's triangle is out of range");
}

static int rasterise(struct bsq_ctx *ctx, const struct bake_lowmesh *mesh)
{
    const struct bake_raster_options options = {.width = SIDE,
                                                .height = SIDE - 1,
                                                .samples = SAMPLES,
                                                .patch_side = PATCH,
                                                .count = mesh->triangle_count};
    const double translation[3] = {0.5, -2, 1e3};
    struct bake_raster_report report;
    struct bake_raster *raster;
    struct bk_triangle *triangles = NULL;
    int status = bake_raster_create(ctx, mesh, &options, &report, &raster);
    if (status)
        return status;
    require(report.degenerate_triangles <= mesh->triangle_count,
            "more triangles are reported than exist");
    for (uint32_t i = 0; i < bake_raster_patch_count(raster); i++)
        check_patch(raster, mesh, i);
    status = BSQ_ALLOC(ctx, "triangles", mesh->triangle_count, &triangles);
    if (status == 0)
        bake_raster_kernel_triangles(raster, translation, 0.125, triangles);
    bsq_free(ctx, triangles);
    bake_raster_free(raster);
    return status;
}

/* Sorts the mesh by tile, as a bake of all tiles does. */
static int sort_by_tile(struct bsq_ctx *ctx, const char *path, struct bake_lowmesh *mesh)
{
    const struct bake_tile_range all = {BAKE_FIRST_TILE, BAKE_LAST_TILE};
    struct bake_options options;
    struct bake_udim udim;
    bake_defaults(&options);
    options.mesh_path = path;
    options.output_path = "<UDIM>.exr";
    options.tile_ranges = &all;
    options.tile_range_count = 1;
    int status = bake_udim_find(ctx, &options, mesh, &udim);
    if (status == 0)
        status = bake_udim_arrange(ctx, &options, &udim, mesh);
    bake_udim_free(ctx, &udim);
    return status == BSQ_EUSAGE ? 0 : status; /* no triangle is in any tile */
}

static int use(struct bsq_ctx *ctx, const char *const *paths, uint32_t count)
{
    const char *path = paths[0];
    (void)count;
    struct bake_lowmesh mesh;
    struct bake_options options;
    bake_defaults(&options);
    options.mesh_path = path;
    int status = bake_lowmesh_load(ctx, &options, &mesh);
    if (status)
        return status;
    check_mesh(&mesh);
    status = rasterise(ctx, &mesh);
    if (status == 0)
        status = sort_by_tile(ctx, path, &mesh);
    bake_lowmesh_free(ctx, &mesh);
    return status;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    return fuzz_files(&(struct fuzz_input){data, size, "fuzz.obj"}, 1, use);
}
