// oiio_rows.cc - the module bisque-texture.so: reads rows of images by OpenImageIO.
//
// OpenImageIO reads the file through a descriptor, never by its name, and one format's plug-in
// alone sees it. Rows and tiles are read one by one: plug-ins would start threads for several, and
// end the process if the system has none left.
#include <OpenImageIO/imageio.h>

#include <algorithm>
#include <cctype>
#include <cerrno>
#include <cstring>
#include <memory>
#include <new>
#include <string>
#include <vector>

#include "formats/texture/image_rows.h"

using OIIO::ImageInput;
using OIIO::ImageSpec;
using OIIO::TypeDesc;

namespace
{

struct OiioRows {
    struct fmt_rows_input *input;
    std::unique_ptr<ImageInput> image;
    TypeDesc type; // of samples in rows
    int next = 0;  // row
    size_t row_bytes = 0, texel_bytes = 0;
    std::vector<char> tile, band; // a tile, and the rows that a row of tiles covers
};

// Makes OpenImageIO's message fit for one of ours: one line that names the image instead of the
// descriptor that it is read from, and is never empty.
std::string one_line(std::string reason, const char *path)
{
    static const char opened[] = "/proc/self/fd/";
    const char *slash = std::strrchr(path, '/'), *name = slash ? slash + 1 : path;
    std::replace(reason.begin(), reason.end(), '\n', ' ');
    for (size_t at = 0; (at = reason.find(opened, at)) != std::string::npos;) {
        const size_t end = reason.find_first_not_of("0123456789", at + sizeof opened - 1);
        reason.replace(at, end == std::string::npos ? end : end - at, name);
        at += std::strlen(name);
    }
    return reason.empty() ? "its decoder gives no reason, the file may be cut off" : reason;
}

int fail(const struct fmt_rows_input *input, int error, const char *what, const std::string &reason)
{
    if (error == EMFILE || error == ENFILE || error == EIO) // not a fault of the image
        return input->host->fail_errno(input->ctx, BSQ_ENOINPUT, error, "%s", input->path);
    return input->host->fail(input->ctx, BSQ_EDATA, "%s: %s: %s", input->path, what,
                             one_line(reason, input->path).c_str());
}

// Calls a function that returns a status and may throw.
template <typename Function> int guarded(const struct fmt_rows_input *input, Function function)
{
    try {
        return function();
    } catch (const std::bad_alloc &) {
        return input->host->fail(input->ctx, BSQ_ENOMEM, "%s: out of memory", input->path);
    } catch (const std::exception &exception) {
        return fail(input, 0, "damaged image", exception.what());
    }
}

// Returns the exponent that turns the file's integers into linear light, or 0 for sRGB, which is
// the default if the file does not name a colour space.
double file_gamma(const ImageSpec &spec)
{
    std::string space = spec.get_string_attribute("oiio:ColorSpace");
    std::transform(space.begin(), space.end(), space.begin(),
                   [](unsigned char c) { return char(std::tolower(c)); });
    if (space.find("linear") != std::string::npos)
        return 1;
    float gamma = spec.get_float_attribute("oiio:Gamma", 0);
    return space.rfind("gamma", 0) == 0 && gamma > 0 ? double(gamma) : 0;
}

// Returns the rows that the file's compressor decodes together.
uint64_t rows_at_once(const ImageSpec &spec, const std::string &plugin)
{
    const std::string compression = spec.get_string_attribute("compression");
    const auto is_any_of = [&](std::initializer_list<const char *> names) {
        return std::find(names.begin(), names.end(), compression) != names.end();
    };
    uint64_t rows = 1;
    if (spec.tile_width > 0)
        return uint64_t(spec.tile_height);
    if (plugin == "openexr")
        rows = compression == "dwab" ? 256 : is_any_of({"piz", "b44", "b44a", "dwaa"}) ? 32 : 16;
    else if (plugin == "tiff" && !is_any_of({"none", "lzw", "zip", "packbits"}))
        rows = uint64_t(std::max(spec.get_int_attribute("tiff:RowsPerStrip"), 1));
    return std::min(rows, uint64_t(spec.height));
}

void describe(OiioRows &rows, struct fmt_rows_info &info)
{
    const ImageSpec &spec = rows.image->spec();
    const bool integers = spec.format == TypeDesc::UINT8 || spec.format == TypeDesc::UINT16;
    rows.type = integers ? spec.format : TypeDesc(TypeDesc::FLOAT);
    info.width = uint32_t(spec.width);
    info.height = uint32_t(spec.height);
    info.channels = uint32_t(spec.nchannels);
    info.sample_bytes = uint32_t(rows.type.size());
    info.alpha = spec.alpha_channel;
    info.gamma = file_gamma(spec);
    rows.texel_bytes = info.channels * rows.type.size();
    rows.row_bytes = info.width * rows.texel_bytes;
    info.bytes = 2 * rows_at_once(spec, rows.input->plugin) * rows.row_bytes;
}

int open_image(OiioRows &rows, struct fmt_rows_info &info)
{
    struct fmt_rows_input *input = rows.input;
    ImageSpec found, config;
    config["oiio:UnassociatedAlpha"] = 1;
    OIIO::attribute("exr_threads", -1); // decodes on the calling thread
    errno = 0;
    rows.image = ImageInput::create(input->plugin);
    if (!rows.image)
        return fail(input, errno, "not a readable image", OIIO::geterror());
    rows.image->threads(1);
    if (!rows.image->open("/proc/self/fd/" + std::to_string(input->file.fd), found, config))
        return fail(input, errno, "not a readable image", rows.image->geterror());
    const ImageSpec &spec = rows.image->spec();
    if (spec.width < 1 || spec.height < 1 || spec.nchannels < 1 || spec.depth > 1 || spec.deep)
        return fail(input, 0, "not a readable image", "it is not two-dimensional");
    if (spec.format == TypeDesc::DOUBLE) // OpenImageIO 2.4 reads other numbers
        return fail(input, 0, "not a readable image", "it has samples of 64 bits");
    describe(rows, info);
    return 0;
}

// Reads the row of tiles that begins with the next row.
bool read_band(OiioRows &rows)
{
    const ImageSpec &spec = rows.image->spec();
    const size_t tile_row = size_t(spec.tile_width) * rows.texel_bytes;
    rows.tile.resize(size_t(spec.tile_height) * tile_row);
    rows.band.resize(size_t(spec.tile_height) * rows.row_bytes);
    for (int x = 0; x < spec.width; x += spec.tile_width) {
        const size_t first = size_t(x) * rows.texel_bytes;
        if (!rows.image->read_tile(spec.x + x, spec.y + rows.next, spec.z, rows.type,
                                   rows.tile.data()))
            return false;
        for (size_t y = 0; y < size_t(spec.tile_height); y++)
            std::memcpy(&rows.band[y * rows.row_bytes + first], &rows.tile[y * tile_row],
                        std::min(tile_row, rows.row_bytes - first));
    }
    return true;
}

int read_row(OiioRows &rows, void *row)
{
    const ImageSpec &spec = rows.image->spec();
    const int line = spec.tile_width > 0 ? rows.next % spec.tile_height : 0;
    bool good = true;
    errno = 0;
    if (spec.tile_width == 0)
        good = rows.image->read_scanline(spec.y + rows.next, spec.z, rows.type, row);
    else if (line == 0)
        good = read_band(rows);
    if (!good)
        return fail(rows.input, errno, "damaged image", rows.image->geterror());
    if (spec.tile_width > 0)
        std::memcpy(row, &rows.band[size_t(line) * rows.row_bytes], rows.row_bytes);
    rows.next++;
    return 0;
}

int open_rows(struct fmt_rows_input *input, struct fmt_rows_info *info, void **state)
{
    auto *rows = new (std::nothrow) OiioRows;
    *state = rows;
    if (!rows)
        return input->host->fail(input->ctx, BSQ_ENOMEM, "%s: out of memory", input->path);
    rows->input = input;
    return guarded(input, [&] { return open_image(*rows, *info); });
}

int read_rows(void *state, void *row)
{
    auto *rows = static_cast<OiioRows *>(state);
    return guarded(rows->input, [&] { return read_row(*rows, row); });
}

void close_rows(void *state)
{
    delete static_cast<OiioRows *>(state);
}

} // namespace

extern "C" {
extern const struct fmt_rows_module bisque_module;
const struct fmt_rows_module bisque_module = {{fmt_module_stamp},
                                              {open_rows, read_rows, close_rows}};
}
