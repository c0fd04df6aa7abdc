/* vdb_program.cc - the program bisque-vdb: writes the grid that is its standard input as an OpenVDB
 * file, its standard output.
 *
 * OpenVDB's leaves are dense: 6 KiB for 512 vectors, of which a surface sets about fifty. OpenVDB's
 * file class ignores write errors, so the archive is written to a stream that reports them. */
#include <array>
#include <cerrno>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <new>
#include <ostream>

#include <ext/stdio_filebuf.h>
#include <sys/stat.h>
#include <unistd.h>

#include <openvdb/io/Archive.h>
#include <openvdb/openvdb.h>
#include <tbb/task_arena.h>

extern "C" {
#include "base/srgb.h"
#include "base/context.h"
#include "base/geometry/vec.h"
}
#include "formats/grid/nvdb_layout_internal.h"
#include "formats/program/program.h"

namespace
{

/* The three grids: each functor returns the value of the voxel with a value index. */
struct surface_value {
    using grid_type = openvdb::MaskGrid;
    bool operator()(const fmt_nvdb_grid &, uint64_t) const
    {
        return true;
    }
};

struct normal_value {
    using grid_type = openvdb::Vec3fGrid;
    openvdb::Vec3f operator()(const fmt_nvdb_grid &from, uint64_t index) const
    {
        bsq_vec3 n = bsq_oct_unpack(from.normals[index]);
        return openvdb::Vec3f(n.x, n.y, n.z);
    }
};

struct color_value {
    using grid_type = openvdb::Vec3fGrid;
    /* Linear light of each sRGB byte. */
    std::array<float, 256> table;
    color_value()
    {
        for (int i = 0; i < 256; i++)
            table[size_t(i)] = float(bsq_srgb_to_linear(i / 255.0));
    }
    float linear(uint32_t byte) const
    {
        return table[byte & 255];
    }
    openvdb::Vec3f operator()(const fmt_nvdb_grid &from, uint64_t index) const
    {
        uint32_t c = from.colors[index];
        return openvdb::Vec3f(linear(c), linear(c >> 8), linear(c >> 16));
    }
};

/* Copies all voxels into a tree. OpenVDB numbers the voxels of a leaf as NanoVDB does. Value
 * indices are bounded because the file may shrink while it is mapped, and then reads as zeros. */
template <typename ValueT, typename TreeT> void fill_tree(const fmt_nvdb_grid &from, TreeT &tree)
{
    using leaf_type = typename TreeT::LeafNodeType;
    openvdb::tree::ValueAccessor<TreeT> accessor(tree);
    const auto *leaves = reinterpret_cast<const nvdb_leaf *>(from.leaves);
    ValueT value;
    for (uint32_t i = 0; i < from.leaf_count; i++) {
        const nvdb_leaf &leaf = leaves[i];
        openvdb::Coord origin(leaf.bbox_min[0] & ~7, leaf.bbox_min[1] & ~7, leaf.bbox_min[2] & ~7);
        auto *out = new leaf_type(origin, typename TreeT::ValueType(0), false);
        uint64_t index = leaf.offset;
        for (openvdb::Index word = 0; word < 8; word++)
            for (uint64_t bits = leaf.mask[word]; bits; bits &= bits - 1, index++)
                out->setValueOn(64 * word + openvdb::Index(__builtin_ctzll(bits)),
                                value(from, index < from.record_count ? index : 0));
        accessor.addLeaf(out); /* the tree takes ownership */
    }
}

/* Checks the bytes of a tree's nodes, to which malloc adds 32 at most, or 128 for the largest. */
template <typename TreeT, int VALUES, int LEAF, int LOWER, int UPPER> struct takes_no_more {
    using upper_type = typename TreeT::RootNodeType::ChildNodeType;
    using lower_type = typename upper_type::ChildNodeType;
    static constexpr bool value = sizeof(typename TreeT::LeafNodeType) + VALUES + 32 <= LEAF &&
                                  sizeof(lower_type) + 32 <= LOWER &&
                                  sizeof(upper_type) + 128 <= UPPER;
};
static_assert(takes_no_more<openvdb::Vec3STree, 512 * sizeof(openvdb::Vec3f), VDB_VECTOR_LEAF,
                            VDB_VECTOR_LOWER, VDB_VECTOR_UPPER>::value,
              "the caller reserves what trees of vectors take");
static_assert(
    takes_no_more<openvdb::MaskTree, 0, VDB_BIT_LEAF, VDB_BIT_LOWER, VDB_BIT_UPPER>::value,
    "the caller reserves what trees of bits take");

template <typename ValueT>
typename ValueT::grid_type::Ptr make_grid(const fmt_nvdb_grid &from, const char *name)
{
    const fmt_nvdb_info &info = from.info;
    auto grid = ValueT::grid_type::create();
    auto transform = openvdb::math::Transform::createLinearTransform(info.voxel_size);
    transform->postTranslate(openvdb::Vec3d(info.translation));
    grid->setTransform(transform);
    grid->setName(name);
    fill_tree<ValueT>(from, grid->tree());
    return grid;
}

struct archive : openvdb::io::Archive {
    using Archive::write;
};

void write_archive(const fmt_nvdb_grid &from)
{
    openvdb::initialize();
    openvdb::GridCPtrVec grids;
    grids.push_back(make_grid<surface_value>(from, "surface"));
    auto normals = make_grid<normal_value>(from, "N");
    normals->setVectorType(openvdb::VEC_COVARIANT_NORMALIZE);
    grids.push_back(normals);
    if (from.colors) {
        auto colors = make_grid<color_value>(from, "Cd");
        colors->setVectorType(openvdb::VEC_INVARIANT);
        grids.push_back(colors);
    }
    openvdb::MetaMap meta;
    meta.insertMeta("creator", openvdb::StringMetadata("Bisque " BSQ_VERSION));
    __gnu_cxx::stdio_filebuf<char> buffer(STDOUT_FILENO, std::ios::out | std::ios::binary,
                                          size_t(1) << 20);
    std::ostream stream(&buffer);
    stream.exceptions(std::ios_base::badbit | std::ios_base::failbit);
    archive().write(stream, grids, true, meta);
    stream.flush();
}

/* Writes the grid that is the standard input. */
void convert(bsq_ctx *ctx)
{
    fmt_nvdb_grid grid;
    struct stat info;
    bsq_file file = {};
    file.fd = STDIN_FILENO;
    file.path = strdup("the grid");
    file.size = fstat(STDIN_FILENO, &info) == 0 ? uint64_t(info.st_size) : 0;
    int status = fmt_nvdb_open_file(ctx, &file, &grid);
    if (status == 0) {
        tbb::task_arena arena(int(bsq_threads(ctx)));
        arena.execute([&] { write_archive(grid); });
        status = bsq_map_check(ctx, &grid.map);
    }
    if (status)
        fmt_program_refuse(status, bsq_error(ctx));
}

} // namespace

/* The option is the number of threads. Ends without destructors. */
int main(int argument_count, char **arguments)
{
    fmt_program_input input;
    const char *threads = fmt_program_begin(argument_count, arguments, UINT64_MAX, 0, &input);
    bsq_ctx_options options = {};
    bsq_ctx *ctx;
    options.threads = unsigned(atoi(threads));
    try {
        if (bsq_ctx_create(&options, &ctx))
            throw std::bad_alloc();
        convert(ctx);
    } catch (const std::bad_alloc &) {
        fmt_program_refuse(BSQ_ENOMEM, "OpenVDB has not enough memory for it");
    } catch (const std::ios_base::failure &) {
        fmt_program_refuse(BSQ_EIO, std::strerror(errno));
    } catch (const std::exception &failure) {
        fmt_program_refuse(BSQ_EIO, failure.what());
    }
    _exit(0);
}
