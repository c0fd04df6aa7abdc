/* vdb_export_openvdb.cc - the module bisque-openvdb.so: writes a grid as an OpenVDB file.
 *
 * OpenVDB's leaves are dense: 6 KiB for 512 vectors, of which a surface sets about fifty. OpenVDB's
 * file class ignores write errors, so the archive is written to a stream that reports them. */
#include <algorithm>
#include <cmath>
#include <cstring>
#include <exception>
#include <new>
#include <ostream>
#include <streambuf>
#include <vector>

#include <openvdb/io/Archive.h>
#include <openvdb/openvdb.h>
#include <tbb/task_arena.h>

extern "C" {
#include "base/vec.h"
#include "base/channels.h"
}
#include "formats/grid/nvdb_layout_internal.h"
#include "formats/grid/vdb_module.h"

namespace
{

/* An exception for a failure that was reported to the context already. */
struct described {
    int status;
};

/* The grid that values come from. */
struct source {
    const fmt_host *host;
    bsq_ctx *ctx;
    const fmt_nvdb_grid *grid;
    float linear[256]; /* linear light of each sRGB byte */
};

/* The three grids: each functor returns the value of the voxel with a value index. */
struct surface_value {
    using grid_type = openvdb::MaskGrid;
    bool operator()(const source &, uint64_t) const
    {
        return true;
    }
};

struct normal_value {
    using grid_type = openvdb::Vec3fGrid;
    openvdb::Vec3f operator()(const source &from, uint64_t index) const
    {
        bsq_vec3 n = bsq_oct_unpack(from.grid->normals[index]);
        return openvdb::Vec3f(n.x, n.y, n.z);
    }
};

struct color_value {
    using grid_type = openvdb::Vec3fGrid;
    openvdb::Vec3f operator()(const source &from, uint64_t index) const
    {
        uint32_t c = from.grid->colors[index];
        return openvdb::Vec3f(from.linear[c & 255], from.linear[c >> 8 & 255],
                              from.linear[c >> 16 & 255]);
    }
};

/* Copies all voxels into a tree. OpenVDB numbers the voxels of a leaf as NanoVDB does. Value
 * indices are bounded because the file may shrink while it is mapped, and then reads as zeros. */
template <typename ValueT, typename TreeT> void fill_tree(const source &from, TreeT &tree)
{
    using leaf_type = typename TreeT::LeafNodeType;
    openvdb::tree::ValueAccessor<TreeT> accessor(tree);
    const auto *leaves = reinterpret_cast<const nvdb_leaf *>(from.grid->leaves);
    ValueT value;
    for (uint32_t i = 0; i < from.grid->leaf_count; i++) {
        if (i % 4096 == 0) {
            int status = from.host->check(from.ctx);
            if (status)
                throw described{status};
        }
        const nvdb_leaf &leaf = leaves[i];
        openvdb::Coord origin(leaf.bbox_min[0] & ~7, leaf.bbox_min[1] & ~7, leaf.bbox_min[2] & ~7);
        auto *out = new leaf_type(origin, typename TreeT::ValueType(0), false);
        uint64_t index = leaf.offset;
        for (openvdb::Index word = 0; word < 8; word++)
            for (uint64_t bits = leaf.mask[word]; bits; bits &= bits - 1, index++)
                out->setValueOn(64 * word + openvdb::Index(__builtin_ctzll(bits)),
                                value(from, index < from.grid->record_count ? index : 0));
        accessor.addLeaf(out); /* the tree takes ownership */
    }
}

/* Returns the bytes of a tree's nodes, with malloc's overhead. */
template <typename TreeT> uint64_t tree_bytes(const fmt_nvdb_grid &grid)
{
    using leaf_type = typename TreeT::LeafNodeType;
    using upper_type = typename TreeT::RootNodeType::ChildNodeType;
    using lower_type = typename upper_type::ChildNodeType;
    uint64_t values =
        std::is_same<TreeT, openvdb::MaskTree>::value ? 0 : 512 * sizeof(typename TreeT::ValueType);
    return grid.leaf_count * (sizeof(leaf_type) + values + 32) +
           grid.lower_count * (sizeof(lower_type) + uint64_t(32)) +
           grid.upper_count * (sizeof(upper_type) + uint64_t(128));
}

uint64_t export_bytes(const fmt_nvdb_grid *grid)
{
    uint64_t vectors = tree_bytes<openvdb::Vec3STree>(*grid);
    return tree_bytes<openvdb::MaskTree>(*grid) + (grid->colors ? 2 * vectors : vectors);
}

template <typename ValueT>
typename ValueT::grid_type::Ptr make_grid(const source &from, const char *name)
{
    const fmt_nvdb_info &info = from.grid->info;
    auto grid = ValueT::grid_type::create();
    auto transform = openvdb::math::Transform::createLinearTransform(info.voxel_size);
    transform->postTranslate(openvdb::Vec3d(info.translation));
    grid->setTransform(transform);
    grid->setName(name);
    fill_tree<ValueT>(from, grid->tree());
    return grid;
}

/* Buffers what OpenVDB writes to the output. Throws failures, which the stream passes on. */
class output_buffer : public std::streambuf
{
  public:
    output_buffer(const source &from, bsq_output *output)
        : from_(from), output_(output), bytes_(size_t(1) << 20)
    {
        setp(bytes_.data(), bytes_.data() + bytes_.size());
    }

    void write_out()
    {
        uint64_t size = uint64_t(pptr() - pbase());
        int status = from_.host->check(from_.ctx);
        if (!status)
            status = from_.host->output_write_at(output_, pbase(), size, start_);
        if (status)
            throw described{status};
        start_ += size;
        setp(bytes_.data(), bytes_.data() + bytes_.size());
    }

  protected:
    int_type overflow(int_type c) override
    {
        write_out();
        if (!traits_type::eq_int_type(c, traits_type::eof()))
            sputc(traits_type::to_char_type(c));
        return traits_type::not_eof(c);
    }

    std::streamsize xsputn(const char *data, std::streamsize size) override
    {
        for (std::streamsize done = 0; done < size;) {
            if (pptr() == epptr())
                write_out();
            std::streamsize part = std::min<std::streamsize>(size - done, epptr() - pptr());
            std::memcpy(pptr(), data + done, size_t(part));
            pbump(int(part));
            done += part;
        }
        return size;
    }

    /* OpenVDB asks for the position, and goes back to fill in offsets that it did not know before.
     */
    pos_type seekoff(off_type offset, std::ios_base::seekdir way, std::ios_base::openmode) override
    {
        uint64_t here = start_ + uint64_t(pptr() - pbase());
        end_ = std::max(end_, here);
        off_type base = way == std::ios_base::beg   ? 0
                        : way == std::ios_base::cur ? off_type(here)
                                                    : off_type(end_);
        if (base + offset < 0)
            return pos_type(off_type(-1));
        if (uint64_t(base + offset) != here) {
            write_out();
            start_ = uint64_t(base + offset);
        }
        return base + offset;
    }

    pos_type seekpos(pos_type position, std::ios_base::openmode mode) override
    {
        return seekoff(off_type(position), std::ios_base::beg, mode);
    }

  private:
    const source &from_;
    bsq_output *output_;
    uint64_t start_ = 0; /* offset of the buffer in the file */
    uint64_t end_ = 0;   /* largest offset seen in seekoff() */
    std::vector<char> bytes_;
};

struct archive : openvdb::io::Archive {
    using Archive::write;
};

void write_archive(const source &from, bsq_output *output)
{
    openvdb::initialize();
    openvdb::GridCPtrVec grids;
    grids.push_back(make_grid<surface_value>(from, "surface"));
    auto normals = make_grid<normal_value>(from, "N");
    normals->setVectorType(openvdb::VEC_COVARIANT_NORMALIZE);
    grids.push_back(normals);
    if (from.grid->colors) {
        auto colors = make_grid<color_value>(from, "Cd");
        colors->setVectorType(openvdb::VEC_INVARIANT);
        grids.push_back(colors);
    }
    openvdb::MetaMap meta;
    meta.insertMeta("creator", openvdb::StringMetadata("Bisque " BSQ_VERSION));
    output_buffer buffer(from, output);
    std::ostream stream(&buffer);
    stream.exceptions(std::ios_base::badbit | std::ios_base::failbit);
    archive().write(stream, grids, true, meta);
    buffer.write_out();
}

/* Turns exceptions into status codes; none may reach the program. */
int export_to(source &from, bsq_output *output, const char *path) noexcept
{
    try {
        tbb::task_arena arena(int(from.host->threads(from.ctx)));
        arena.execute([&] { write_archive(from, output); });
        return 0;
    } catch (const described &failure) {
        return failure.status;
    } catch (const std::bad_alloc &) {
        return from.host->fail(from.ctx, BSQ_ENOMEM, "%s: no memory for the OpenVDB export", path);
    } catch (const std::exception &failure) {
        return from.host->fail(from.ctx, BSQ_EIO, "%s: OpenVDB cannot write it: %s", path,
                               failure.what());
    } catch (...) {
        return from.host->fail(from.ctx, BSQ_EIO, "%s: OpenVDB cannot write it", path);
    }
}

int write_file(const fmt_host *host, bsq_ctx *ctx, const fmt_nvdb_grid *grid, bsq_output *output,
               const char *path)
{
    source from = {host, ctx, grid, {}};
    for (int i = 0; i < 256; i++)
        from.linear[i] = float(bsq_srgb_to_linear(i / 255.0));
    return export_to(from, output, path);
}

} // namespace

extern "C" {
extern const fmt_vdb_module bisque_module;
const fmt_vdb_module bisque_module = {{fmt_module_stamp}, export_bytes, write_file};
}
