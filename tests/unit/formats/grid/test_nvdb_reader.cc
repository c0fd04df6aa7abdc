// test_nvdb_reader.cc - NanoVDB's C++ reader reads files of the writer, and fmt_nvdb_open()
// reads files of NanoVDB.
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <string>
#include <vector>
#include <unistd.h>

#include <nanovdb/util/GridBuilder.h>
#include <nanovdb/util/GridStats.h>
#include <nanovdb/util/GridValidator.h>
#include <nanovdb/util/IO.h>
#include <nanovdb/util/OpenToNanoVDB.h>
#include <openvdb/openvdb.h>

// Last, because its macros (skip, fail) are names in NanoVDB too.
#include "tests/unit/test.h"

#include "formats/grid/nvdb_layout_internal.h"
#include "tests/unit/formats/grid/nvdb_scene.h"

// Compares the structures in C with NanoVDB's.
using MaskGrid = nanovdb::NanoGrid<nanovdb::ValueMask>;
using MaskRoot = nanovdb::NanoRoot<nanovdb::ValueMask>::DataType;
using MaskUpper = nanovdb::NanoUpper<nanovdb::ValueMask>::DataType;
using MaskLower = nanovdb::NanoLower<nanovdb::ValueMask>::DataType;
using MaskLeaf = nanovdb::NanoLeaf<nanovdb::ValueMask>::DataType;
static_assert(sizeof(nvdb_grid_data) == sizeof(nanovdb::GridData), "GridData");
static_assert(sizeof(nvdb_tree_data) == sizeof(nanovdb::TreeData<3>), "TreeData");
static_assert(NVDB_ROOT_BYTES == sizeof(MaskRoot), "RootData");
static_assert(sizeof(nvdb_root_tile) == sizeof(MaskRoot::Tile), "Tile");
static_assert(sizeof(nvdb_upper) == sizeof(MaskUpper), "upper node");
static_assert(sizeof(nvdb_lower) == sizeof(MaskLower), "lower node");
static_assert(sizeof(nvdb_leaf) == sizeof(MaskLeaf), "leaf");
static_assert(sizeof(nvdb_blind) == sizeof(nanovdb::GridBlindMetaData), "GridBlindMetaData");
static_assert(sizeof(nvdb_file_header) == sizeof(nanovdb::io::Header), "file header");
static_assert(sizeof(nvdb_file_meta) == sizeof(nanovdb::io::MetaData), "file metadata");
#define SAME_OFFSET(C, MEMBER, CXX, CXX_MEMBER)                                                    \
    static_assert(offsetof(C, MEMBER) == offsetof(CXX, CXX_MEMBER), #C "." #MEMBER)
#pragma GCC diagnostic ignored "-Winvalid-offsetof"
SAME_OFFSET(nvdb_grid_data, map, nanovdb::GridData, mMap);
SAME_OFFSET(nvdb_grid_data, voxel_size, nanovdb::GridData, mVoxelSize);
SAME_OFFSET(nvdb_grid_data, blind_count, nanovdb::GridData, mBlindMetadataCount);
SAME_OFFSET(nvdb_grid_data, value_count, nanovdb::GridData, mData1);
SAME_OFFSET(nvdb_map, matrix, nanovdb::Map, mMatD);
SAME_OFFSET(nvdb_map, translation, nanovdb::Map, mVecD);
SAME_OFFSET(nvdb_tree_data, voxel_count, nanovdb::TreeData<3>, mVoxelCount);
SAME_OFFSET(nvdb_root, root_tile_count, MaskRoot, mTableSize);
SAME_OFFSET(nvdb_upper, child_mask, MaskUpper, mChildMask);
SAME_OFFSET(nvdb_upper, statistics, MaskUpper, mMinimum);
SAME_OFFSET(nvdb_upper, table, MaskUpper, mTable);
SAME_OFFSET(nvdb_lower, child_mask, MaskLower, mChildMask);
SAME_OFFSET(nvdb_lower, table, MaskLower, mTable);
SAME_OFFSET(nvdb_leaf, mask, MaskLeaf, mValueMask);
SAME_OFFSET(nvdb_leaf, offset, MaskLeaf, mPadding);
SAME_OFFSET(nvdb_blind, name, nanovdb::GridBlindMetaData, mName);
SAME_OFFSET(nvdb_file_meta, index_min, nanovdb::io::MetaData, indexBBox);
SAME_OFFSET(nvdb_file_meta, version, nanovdb::io::MetaData, version);

namespace
{

const std::string path = "a.nvdb";

bsq_ctx *new_context()
{
    bsq_ctx *ctx;
    assert_int_equal(bsq_ctx_create(nullptr, &ctx), 0);
    return ctx;
}

void write_scene(const scene &scene)
{
    bsq_ctx *ctx = new_context();
    fmt_nvdb_totals totals;
    int status = scene_write(ctx, path.c_str(), &scene, &totals);
    if (status)
        fail_msg("%s", bsq_error(ctx));
    bsq_ctx_destroy(ctx);
}

const nanovdb::GridBlindMetaData *find_channel(const nanovdb::GridData &grid, const char *name)
{
    for (uint32_t i = 0; i < grid.mBlindMetadataCount; i++)
        if (std::strcmp(grid.blindMetaData(i)->mName, name) == 0)
            return grid.blindMetaData(i);
    fail_msg("no channel %s", name);
    return nullptr;
}

// Computes the value index of a voxel from the leaf that NanoVDB finds.
template <typename AccessorT> uint64_t value_index(AccessorT &accessor, const nanovdb::Coord &ijk)
{
    const auto *leaf = accessor.probeLeaf(ijk);
    assert_non_null(leaf);
    uint64_t words[2];
    std::memcpy(words, reinterpret_cast<const char *>(leaf) + 80, sizeof(words));
    uint32_t n = leaf->CoordToOffset(ijk), before = 0;
    for (uint32_t i = 0; i < n; i++)
        before += leaf->valueMask().isOn(i);
    uint32_t in_word = 0;
    for (uint32_t i = n & ~63u; i < n; i++)
        in_word += leaf->valueMask().isOn(i);
    uint64_t prefix = n >> 6 ? words[1] >> (9 * ((n >> 6) - 1)) & 511 : 0;
    assert_int_equal(prefix + in_word, before);
    return words[0] + prefix + in_word;
}

template <typename BuildT>
void compare_voxels(const nanovdb::NanoGrid<BuildT> &grid, const scene &scene)
{
    auto accessor = grid.getAccessor();
    const auto &data = reinterpret_cast<const nanovdb::GridData &>(grid);
    const uint32_t *normals = find_channel(data, "normal")->template getBlindData<uint32_t>();
    const uint32_t *planes = find_channel(data, "plane")->template getBlindData<uint32_t>();
    const uint32_t *colors = find_channel(data, "color")->template getBlindData<uint32_t>();
    const uint32_t *seconds = find_channel(data, "second")->template getBlindData<uint32_t>();
    uint64_t second = 1 + scene.count;
    for (uint64_t i = 0; i < scene.count; i++) {
        const scene_voxel &v = scene.voxels[i];
        nanovdb::Coord ijk(v.ijk[0], v.ijk[1], v.ijk[2]);
        assert_true(accessor.isActive(ijk));
        uint64_t index = value_index(accessor, ijk);
        assert_int_equal(index, i + 1);
        assert_int_equal(normals[index], v.first.normal);
        assert_int_equal(planes[index], v.first.plane);
        assert_int_equal(colors[index], v.first.color);
        bool has_second = v.first.plane & FMT_NVDB_PLANE_SECOND;
        assert_int_equal(seconds[index / 32 * 2] >> index % 32 & 1, has_second);
        if (has_second) {
            assert_int_equal(normals[second], v.second.normal);
            assert_int_equal(colors[second], v.second.color);
            second++;
        }
    }
    for (const char *name : {"normal", "plane", "color"})
        assert_int_equal(find_channel(data, name)->mElementCount, second);
}

template <typename GridT> uint64_t count_active(const GridT &grid)
{
    uint64_t active = 0;
    const auto *leaf = grid.tree().getFirstLeaf();
    for (uint32_t i = 0; i < grid.tree().nodeCount(0); i++)
        for (auto voxel = leaf[i].beginValueOn(); voxel; ++voxel)
            active++;
    return active;
}

TEST(test_mask_grid)
{
    scene scene;
    scene_random(&scene, 21, 3000);
    write_scene(scene);
    auto meta = nanovdb::io::readGridMetaData(path);
    assert_int_equal(meta.size(), 1);
    assert_string_equal(meta[0].gridName.c_str(), "surface");
    assert_int_equal(meta[0].voxelCount, scene.count);
    assert_true(nanovdb::io::hasGrid(path, "surface"));

    auto handle = nanovdb::io::readGrid(path);
    const MaskGrid *grid = handle.grid<nanovdb::ValueMask>();
    assert_non_null(grid);
    assert_string_equal(grid->gridName(), "surface");
    assert_true(nanovdb::isValid(*grid, true, true));
    assert_true(grid->isMask() && grid->isBreadthFirst() && grid->hasBBox());
    assert_int_equal(grid->activeVoxelCount(), scene.count);
    assert_int_equal(count_active(*grid), scene.count);
    compare_voxels(*grid, scene);

    auto world = grid->indexToWorld(nanovdb::Vec3d(10, -20, 30));
    for (int axis = 0; axis < 3; axis++) {
        const double index[3] = {10, -20, 30};
        double expected = index[axis] * scene.info.voxel_size + scene.info.translation[axis];
        assert_true(std::abs(world[axis] - expected) < 1e-9);
    }
    auto back = grid->worldToIndexF(nanovdb::Vec3f(grid->indexToWorldF(nanovdb::Vec3f(1, 2, 3))));
    assert_true(std::abs(back[2] - 3) < 1e-3f);
    scene_free(&scene);
}

// All voxels of two leaves in two lower nodes are set: full masks, and second records for all.
TEST(test_full_leaves)
{
    scene scene;
    scene_random(&scene, 9, 1);
    std::free(scene.voxels);
    scene.count = 1024;
    scene.voxels = static_cast<scene_voxel *>(std::calloc(scene.count, sizeof *scene.voxels));
    for (uint64_t i = 0; i < scene.count; i++) {
        scene_voxel &v = scene.voxels[i];
        v.ijk[0] = int32_t(i / 64 % 8);
        v.ijk[1] = int32_t(i / 8 % 8);
        v.ijk[2] = int32_t(i % 8) + 120 + int32_t(i / 512) * 8;
        v.first.plane = FMT_NVDB_PLANE_SECOND;
        v.first.normal = uint32_t(i);
        v.second.normal = uint32_t(i + 5000);
    }
    write_scene(scene);
    auto handle = nanovdb::io::readGrid(path);
    compare_voxels(*handle.grid<nanovdb::ValueMask>(), scene);
    scene_free(&scene);
}

// NanoVDB computes the bounding boxes of all nodes again: no byte may change.
TEST(test_bounds)
{
    scene scene;
    scene_random(&scene, 22, 2000);
    write_scene(scene);
    auto handle = nanovdb::io::readGrid(path);
    std::vector<uint8_t> before(handle.data(), handle.data() + handle.size());
    MaskGrid *grid = handle.grid<nanovdb::ValueMask>();
    nanovdb::gridStats(*grid, nanovdb::StatsMode::BBox);
    for (size_t i = 0; i < before.size(); i++)
        if (before[i] != handle.data()[i])
            fail_msg("byte %zu: %u, NanoVDB has %u", i, before[i], handle.data()[i]);
    scene_free(&scene);
}

openvdb::MaskGrid::Ptr to_openvdb(const scene &scene)
{
    openvdb::initialize();
    auto grid = openvdb::MaskGrid::create();
    auto accessor = grid->getAccessor();
    for (uint64_t i = 0; i < scene.count; i++)
        accessor.setValueOn(openvdb::Coord(scene.voxels[i].ijk));
    return grid;
}

// NanoVDB's converter makes the same nodes at the same offsets from the same voxels. It orders root
// tiles by signed coordinates and not by keys, which is the same order if none is negative.
TEST(test_same_nodes_as_converter)
{
    scene scene;
    scene_random(&scene, 24, 2000);
    uint64_t kept = 0;
    for (uint64_t i = 0; i < scene.count; i++) {
        const int32_t *ijk = scene.voxels[i].ijk;
        if (ijk[0] >= 0 && ijk[1] >= 0 && ijk[2] >= 0)
            scene.voxels[kept++] = scene.voxels[i];
    }
    scene.count = kept;
    write_scene(scene);
    auto ours_handle = nanovdb::io::readGrid(path);
    auto theirs_handle = nanovdb::openToNanoVDB(*to_openvdb(scene), nanovdb::StatsMode::BBox);
    const auto &ours = ours_handle.grid<nanovdb::ValueMask>()->tree();
    const auto &theirs = theirs_handle.grid<nanovdb::ValueMask>()->tree();
    assert_true(ours.nodeCount(2) > 3);
    for (int level = 0; level < 3; level++)
        assert_int_equal(ours.nodeCount(level), theirs.nodeCount(level));
    assert_memory_equal(&ours.root(), &theirs.root(),
                        sizeof(MaskRoot) + ours.nodeCount(2) * sizeof(MaskRoot::Tile));
    assert_memory_equal(ours.getFirstUpper(), theirs.getFirstUpper(),
                        ours.nodeCount(2) * sizeof(MaskUpper));
    assert_memory_equal(ours.getFirstLower(), theirs.getFirstLower(),
                        ours.nodeCount(1) * sizeof(MaskLower));
    for (uint32_t i = 0; i < ours.nodeCount(0); i++)
        assert_memory_equal(ours.getFirstLeaf() + i, theirs.getFirstLeaf() + i,
                            offsetof(MaskLeaf, mPadding));
    scene_free(&scene);
}

template <typename HandleT> void assert_refused(const HandleT &handle, const char *expected)
{
    nanovdb::io::writeGrid(path, handle);
    bsq_ctx *ctx = new_context();
    fmt_nvdb_grid grid;
    assert_int_equal(fmt_nvdb_open(ctx, path.c_str(), &grid), BSQ_EDATA);
    if (!std::strstr(bsq_error(ctx), expected))
        fail_msg("\"%s\" does not say \"%s\"", bsq_error(ctx), expected);
    bsq_ctx_destroy(ctx);
}

TEST(test_other_grids)
{
    nanovdb::GridBuilder<float> builder(0.0f);
    builder.getAccessor().setValue(nanovdb::Coord(1, 2, 3), 1.0f);
    assert_refused(builder.getHandle<>(1.0, nanovdb::Vec3d(0), "density"),
                   "a.nvdb: grid \"density\" of type float is not a Bisque surface grid");

    // A mask grid without Bisque's channels; the second name is as long as Bisque's.
    scene scene;
    scene_random(&scene, 25, 50);
    for (const char *name : {"surface", "exactly_31_characters_long_name"}) {
        auto grid = to_openvdb(scene);
        grid->setName(name);
        std::string expected = "grid \"" + std::string(name) + "\" of type Mask is not a Bisque";
        assert_refused(nanovdb::openToNanoVDB(*grid), expected.c_str());
    }
    scene_free(&scene);
}

} // namespace

RUN_TESTS(nullptr, nullptr)
