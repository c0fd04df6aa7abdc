// oiio_rows.cc - the program bisque-texture, which reads images of many formats by OpenImageIO.
//
// One format's plug-in alone sees the file, through its descriptor and never by its name. Rows and
// tiles are read one by one: plug-ins would start threads for several.
#include <OpenImageIO/imageio.h>

#include <algorithm>
#include <cctype>
#include <cerrno>
#include <cstring>
#include <memory>
#include <vector>

#include "formats/texture/image_program.h"

using OIIO::ImageInput;
using OIIO::ImageSpec;
using OIIO::TypeDesc;

namespace
{

class OiioReader : public ImageReader
{
  public:
    void open(const std::string &plugin, struct fmt_rows_info &info) override;
    void read_row(char *row) override;

  private:
    void describe(struct fmt_rows_info &info);
    bool read_band();
    std::unique_ptr<ImageInput> image;
    TypeDesc type; // of samples in rows
    int next = 0;  // row
    size_t row_bytes = 0, texel_bytes = 0;
    std::vector<char> tile, band; // a tile, and the rows that a row of tiles covers
};

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

void OiioReader::describe(struct fmt_rows_info &info)
{
    const ImageSpec &spec = image->spec();
    const bool integers = spec.format == TypeDesc::UINT8 || spec.format == TypeDesc::UINT16;
    type = integers ? spec.format : TypeDesc(TypeDesc::FLOAT);
    info.width = uint32_t(spec.width);
    info.height = uint32_t(spec.height);
    info.channels = uint32_t(spec.nchannels);
    info.sample_bytes = uint32_t(type.size());
    info.alpha = spec.alpha_channel;
    info.gamma = file_gamma(spec);
    texel_bytes = info.channels * type.size();
    row_bytes = info.width * texel_bytes;
}

void OiioReader::open(const std::string &plugin, struct fmt_rows_info &info)
{
    ImageSpec found, config;
    config["oiio:UnassociatedAlpha"] = 1;
    OIIO::attribute("exr_threads", -1); // decodes on the calling thread
    errno = 0;
    image = ImageInput::create(plugin);
    if (!image)
        fmt_image_fail(errno, FMT_ROWS_UNREADABLE, OIIO::geterror());
    image->threads(1);
    if (!image->open(fmt_image_file, found, config))
        fmt_image_fail(errno, FMT_ROWS_UNREADABLE, image->geterror());
    const ImageSpec &spec = image->spec();
    if (spec.width < 1 || spec.height < 1 || spec.nchannels < 1 || spec.depth > 1 || spec.deep)
        fmt_image_fail(0, FMT_ROWS_UNREADABLE, "it is not two-dimensional");
    if (spec.format == TypeDesc::DOUBLE) // OpenImageIO 2.4 reads other numbers
        fmt_image_fail(0, FMT_ROWS_UNREADABLE, "it has samples of 64 bits");
    describe(info);
}

// Reads the row of tiles that begins with the next row.
bool OiioReader::read_band()
{
    const ImageSpec &spec = image->spec();
    const size_t tile_row = size_t(spec.tile_width) * texel_bytes;
    tile.resize(size_t(spec.tile_height) * tile_row);
    band.resize(size_t(spec.tile_height) * row_bytes);
    for (int x = 0; x < spec.width; x += spec.tile_width) {
        const size_t first = size_t(x) * texel_bytes;
        if (!image->read_tile(spec.x + x, spec.y + next, spec.z, type, tile.data()))
            return false;
        for (size_t y = 0; y < size_t(spec.tile_height); y++)
            std::memcpy(&band[y * row_bytes + first], &tile[y * tile_row],
                        std::min(tile_row, row_bytes - first));
    }
    return true;
}

void OiioReader::read_row(char *row)
{
    const ImageSpec &spec = image->spec();
    const int line = spec.tile_width > 0 ? next % spec.tile_height : 0;
    bool good = true;
    errno = 0;
    if (spec.tile_width == 0)
        good = image->read_scanline(spec.y + next, spec.z, type, row);
    else if (line == 0)
        good = read_band();
    if (!good)
        fmt_image_fail(errno, FMT_ROWS_DAMAGED, image->geterror());
    if (spec.tile_width > 0)
        std::memcpy(row, &band[size_t(line) * row_bytes], row_bytes);
    next++;
}

} // namespace

int main(int argument_count, char **arguments)
{
    OiioReader reader;
    return fmt_image_program(argument_count, arguments, reader);
}
