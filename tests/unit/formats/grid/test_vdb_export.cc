// test_vdb_export.cc - OpenVDB reads an exported grid: all voxels, normals, colours, and the
// transform.
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <iterator>
#include <string>
#include <unistd.h>

#include <openvdb/io/File.h>
#include <openvdb/openvdb.h>

extern "C" {
#include "base/geometry/vec.h"
}
#include "formats/grid/nvdb.h"
#include "tests/unit/formats/grid/nvdb_scene.h"

// Last, because its macros (skip, fail) are names in other headers too.
#include "tests/unit/test.h"

namespace
{

const std::string grid_path = "a.nvdb";
std::string vdb_path = "a.vdb";

bsq_ctx *new_context(uint64_t memory)
{
    bsq_ctx_options options = {};
    options.memory_bytes = memory;
    options.threads = 2;
    bsq_ctx *ctx;
    assert_int_equal(bsq_ctx_create(&options, &ctx), 0);
    return ctx;
}

// Writes a random grid and exports it.
int write_and_export(bsq_ctx *ctx, scene &scene, uint64_t seed, bool color)
{
    scene_random(&scene, seed, 3000);
    scene.info.has_color = color;
    for (uint64_t i = 0; i < scene.count; i++) {
        const int32_t *p = scene.voxels[i].ijk;
        bsq_vec3 n = bsq_unit3(bsq_vec3{float(p[0] % 7) + 0.5f, float(p[1] % 5), float(p[2] % 3)});
        scene.voxels[i].first.normal = bsq_oct_pack(n);
    }
    fmt_nvdb_totals totals;
    if (scene_write(ctx, grid_path.c_str(), &scene, &totals))
        fail_msg("%s", bsq_error(ctx));
    fmt_nvdb_grid grid;
    if (fmt_nvdb_open(ctx, grid_path.c_str(), &grid))
        fail_msg("%s", bsq_error(ctx));
    bsq_output *output;
    int status = fmt_vdb_export(ctx, &grid, vdb_path.c_str(), &output);
    fmt_nvdb_close(ctx, &grid);
    return status ? status : bsq_output_commit(output);
}

void compare_transform(const openvdb::GridBase &grid, const scene &scene)
{
    openvdb::Vec3d world = grid.indexToWorld(openvdb::Vec3d(3, -4, 5));
    const double index[3] = {3, -4, 5};
    for (int axis = 0; axis < 3; axis++) {
        double expected = index[axis] * scene.info.voxel_size + scene.info.translation[axis];
        assert_true(std::abs(world[axis] - expected) < 1e-9);
    }
}

double linear(uint32_t byte)
{
    double s = byte / 255.0;
    return s <= 0.04045 ? s / 12.92 : std::pow((s + 0.055) / 1.055, 2.4);
}

TEST(test_export)
{
    for (bool color : {true, false}) {
        bsq_ctx *ctx = new_context(0);
        scene scene;
        if (write_and_export(ctx, scene, 31, color))
            fail_msg("%s", bsq_error(ctx));
        assert_int_equal(bsq_memory_used(ctx), 0);
        assert_true(bsq_memory_high(ctx) > 1 << 20);
        bsq_ctx_destroy(ctx);

        openvdb::initialize();
        openvdb::io::File file(vdb_path);
        file.open();
        auto grids = file.getGrids();
        assert_int_equal(grids->size(), color ? 3 : 2);
        auto surface = openvdb::gridPtrCast<openvdb::MaskGrid>(file.readGrid("surface"));
        auto normals = openvdb::gridPtrCast<openvdb::Vec3fGrid>(file.readGrid("N"));
        openvdb::Vec3fGrid::Ptr colors;
        if (color)
            colors = openvdb::gridPtrCast<openvdb::Vec3fGrid>(file.readGrid("Cd"));
        assert_int_equal(surface->activeVoxelCount(), scene.count);
        assert_int_equal(normals->activeVoxelCount(), scene.count);
        compare_transform(*surface, scene);
        compare_transform(*normals, scene);
        auto on = surface->getConstAccessor();
        auto n = normals->getConstAccessor();
        for (uint64_t i = 0; i < scene.count; i++) {
            const scene_voxel &v = scene.voxels[i];
            openvdb::Coord ijk(v.ijk);
            assert_true(on.isValueOn(ijk));
            assert_true(n.isValueOn(ijk));
            bsq_vec3 unit = bsq_oct_unpack(v.first.normal);
            assert_true(n.getValue(ijk) == openvdb::Vec3f(unit.x, unit.y, unit.z));
            if (color) {
                openvdb::Vec3f found = colors->getConstAccessor().getValue(ijk);
                for (int c = 0; c < 3; c++)
                    assert_true(std::abs(found[c] - linear(v.first.color >> 8 * c & 255)) < 1e-6);
            }
        }
        scene_free(&scene);
    }
}

std::string read_file(const std::string &path)
{
    std::ifstream file(path, std::ios::binary);
    return std::string((std::istreambuf_iterator<char>(file)), std::istreambuf_iterator<char>());
}

TEST(test_same_bytes)
{
    std::string bytes[2];
    for (std::string &b : bytes) {
        bsq_ctx *ctx = new_context(0);
        scene scene;
        assert_int_equal(write_and_export(ctx, scene, 32, true), 0);
        scene_free(&scene);
        bsq_ctx_destroy(ctx);
        b = read_file(vdb_path);
    }
    assert_true(!bytes[0].empty() && bytes[0] == bytes[1]);
    openvdb::io::File file(vdb_path);
    file.open();
    assert_int_equal(file.getUniqueTag().size(), 36);
    assert_int_equal(bytes[0].compare(21, 36, file.getUniqueTag()), 0);
}

// No partial file is left, and the message says what is missing.
} // namespace

RUN_TESTS(nullptr, nullptr)
