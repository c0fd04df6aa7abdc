// oiio_rows.cc - the program bisque-texture, which reads images of many formats by OpenImageIO.
//
// oiio_reader.c runs it: damaged files make OpenImageIO crash, loop, or take any amount of memory.
// So it has limits of memory and time. The file is its standard input; what image_rows.h describes
// is its standard output. One format's plug-in alone sees the file, through its descriptor and
// never by its name. Rows and tiles are read one by one: plug-ins would start threads for several.
#include <OpenImageIO/imageio.h>

#include <algorithm>
#include <cctype>
#include <cerrno>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <new>
#include <stdexcept>
#include <string>
#include <vector>

#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>

#include "formats/texture/image_rows.h"

using OIIO::ImageInput;
using OIIO::ImageSpec;
using OIIO::TypeDesc;

namespace
{

struct OiioRows {
    std::string plugin;
    std::unique_ptr<ImageInput> image;
    TypeDesc type; // of samples in rows
    int next = 0;  // row
    size_t row_bytes = 0, texel_bytes = 0;
    std::vector<char> tile, band; // a tile, and the rows that a row of tiles covers
};

// What is wrong: with the image, or with the system.
struct Failure {
    int code; // a status of Bisque
    std::string text;
};

[[noreturn]] void fail(int error, const std::string &what, std::string reason)
{
    static const std::string opened = "/proc/self/fd/0";
    if (error == EMFILE || error == ENFILE || error == EIO) // not a fault of the image
        throw Failure{BSQ_ENOINPUT, std::strerror(error)};
    for (size_t at; (at = reason.find(opened)) != std::string::npos;)
        reason.replace(at, opened.size(), "the file");
    if (reason.empty())
        reason = "its decoder gives no reason, the file may be cut off";
    throw Failure{BSQ_EDATA, what + ": " + reason};
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
    info.bytes = 2 * rows_at_once(spec, rows.plugin) * rows.row_bytes;
}

void open_image(OiioRows &rows, struct fmt_rows_info &info)
{
    static const char unreadable[] = "not a readable image";
    ImageSpec found, config;
    config["oiio:UnassociatedAlpha"] = 1;
    OIIO::attribute("exr_threads", -1); // decodes on the calling thread
    errno = 0;
    rows.image = ImageInput::create(rows.plugin);
    if (!rows.image)
        fail(errno, unreadable, OIIO::geterror());
    rows.image->threads(1);
    if (!rows.image->open("/proc/self/fd/0", found, config))
        fail(errno, unreadable, rows.image->geterror());
    const ImageSpec &spec = rows.image->spec();
    if (spec.width < 1 || spec.height < 1 || spec.nchannels < 1 || spec.depth > 1 || spec.deep)
        fail(0, unreadable, "it is not two-dimensional");
    if (spec.format == TypeDesc::DOUBLE) // OpenImageIO 2.4 reads other numbers
        fail(0, unreadable, "it has samples of 64 bits");
    describe(rows, info);
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

void read_row(OiioRows &rows, char *row)
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
        fail(errno, "damaged image", rows.image->geterror());
    if (spec.tile_width > 0)
        std::memcpy(row, &rows.band[size_t(line) * rows.row_bytes], rows.row_bytes);
    rows.next++;
}

void put(const void *from, size_t size)
{
    if (putchar(FMT_ROWS_GOOD) == EOF || fwrite(from, size, 1, stdout) != 1)
        throw Failure{BSQ_EIO, ""};
}

// Lets decoding take a second more for each million of texels.
void add_time(uint64_t texels)
{
    struct rlimit time;
    getrlimit(RLIMIT_CPU, &time);
    time.rlim_cur += texels / 1000000;
    time.rlim_max = std::max(time.rlim_max, time.rlim_cur + 1);
    setrlimit(RLIMIT_CPU, &time);
}

void convert(const char *plugin)
{
    OiioRows rows;
    struct fmt_rows_head head = {};
    rows.plugin = plugin;
    std::strncpy(head.stamp, fmt_module_stamp, sizeof head.stamp - 1);
    open_image(rows, head.info);
    add_time(uint64_t(head.info.width) * head.info.height);
    put(&head, sizeof head);
    fflush(stdout);
    std::vector<char> row(rows.row_bytes);
    for (uint32_t y = 0; y < head.info.height; y++) {
        read_row(rows, row.data());
        put(row.data(), row.size());
    }
}

[[noreturn]] void fail_memory()
{
    _exit(-BSQ_ENOMEM);
}

void say(const std::string &text)
{
    putchar(FMT_ROWS_BAD);
    fputs(text.c_str(), stdout);
}

// Reads the image; says what is wrong. Returns the exit status.
int run(const char *plugin)
{
    try {
        convert(plugin);
        return 0;
    } catch (const Failure &failure) {
        say(failure.text);
        return -failure.code;
    } catch (const std::exception &exception) {
        say(std::string("damaged image: ") + exception.what());
        return -BSQ_EDATA;
    }
}

} // namespace

// Arguments: OpenImageIO's name of the format, bytes of memory, seconds of a processor. Ends
// without destructors, which may crash for damaged images.
int main(int argument_count, char **arguments)
{
    enum { FILES = 8 }; // plug-ins open the standard input once more
    struct stat info;
    if (argument_count != 4 || fstat(STDIN_FILENO, &info) != 0 || !S_ISREG(info.st_mode)) {
        fputs("bisque-texture: is run by Bisque for images that OpenImageIO reads\n", stderr);
        return -BSQ_EUSAGE;
    }
    fmt_program_isolate();
    fmt_program_limit(strtoull(arguments[2], nullptr, 10), strtoull(arguments[3], nullptr, 10),
                      FILES);
    std::set_new_handler(fail_memory);
    const int code = run(arguments[1]);
    _exit(fflush(stdout) == 0 && !ferror(stdout) ? code : -BSQ_EIO);
}
