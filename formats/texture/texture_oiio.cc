// texture_oiio.cc - the module bisque-texture.so: reads images of any size by OpenImageIO.
//
// A lookup returns the exact average of the image, each texel a constant square, over a box of at
// least one texel. A box of exactly one texel is bilinear interpolation. Texels come from a private
// ImageCache in the file's own type. A table converts them to linear light before they are
// averaged: the MIP levels of an OpenImageIO texture system would average sRGB values.
//
// Wide boxes are averaged from a pyramid of linear averages that stays in memory. Its lowest level
// is the lowest one that takes at most a quarter of the cache. Opening an image builds the pyramid
// in one pass over the rows, which also finds damaged files. If scanline files do not fit the
// cache, that pass copies them to a temporary tiled file: a PNG or JPEG that is not read downwards
// is decoded from its first row each time. Files that can only be decoded whole are always copied,
// one after the other, if the budget has the memory.
#include "formats/texture/texture_module.h"

#include <OpenImageIO/filesystem.h>
#include <OpenImageIO/imagecache.h>

#include <algorithm>
#include <cctype>
#include <cerrno>
#include <cmath>
#include <memory>
#include <new>
#include <string>
#include <system_error>
#include <unordered_map>
#include <utility>
#include <vector>

#include <half.h>

#include "base/srgb.h"
#include "formats/texture/held_input.h"
#include "formats/texture/texture_pyramid.h"

extern "C" {
extern const struct fmt_texture_module bisque_module;
}

namespace
{

using OIIO::ImageCache;
using OIIO::ImageSpec;
using OIIO::TypeDesc;

constexpr uint64_t smallest_cache = 12 << 20; // OpenImageIO takes at least 10 MB
constexpr uint32_t no_image = UINT32_MAX;
constexpr int tile_size = 64;
constexpr uint64_t large_chunk = 4 << 20; // smaller tiles or groups of rows are not counted
constexpr int first_pyramid_level = 2;
constexpr double cells_across = 4; // least cells along a box in the pyramid level it is read from

// Maps each value of an 8 or 16-bit texel to linear light.
struct Transfer {
    unsigned bits;
    double gamma; // exponent; 0: the sRGB curve (IEC 61966-2-1)
    std::vector<float> table;
};

struct Image {
    std::unique_ptr<fmt::HeldImage> file;
    std::unique_ptr<fmt::HeldImage> copy; // the temporary tiled file; NULL: none
    uint32_t width = 0, height = 0;
    int x = 0, y = 0;             // the first texel in the file's coordinates
    int channels = 0;             // channels that are read: 1 or 3
    bool data = false;            // values are no colours
    TypeDesc type;                // of texels in the cache: UINT8, UINT16 or FLOAT
    const float *table = nullptr; // to linear light; for integers only
    bool tiled = false;
    uint64_t broken = 0; // texels that are not finite, until they are told
    struct bsq_file temporary = BSQ_FILE_CLOSED;
    ImageCache::ImageHandle *handle = nullptr;
    fmt::Pyramid pyramid;
};

// The module's own part of struct fmt_texture_images.
struct Textures : fmt_texture_images {
    const struct fmt_host *host = nullptr;
    struct bsq_ctx *ctx = nullptr;
    uint64_t reserved = 0, tile_bytes = 0;
    uint64_t chunk_bytes = 0; // reserved too
    int pyramid_level = first_pyramid_level;
    bool rewrite = false; // copy scanline images to temporary tiled files
    ImageCache *cache = nullptr;
    std::vector<Image> images;      // each file once
    std::vector<uint32_t> image_of; // caller's image number to index in `images`, or no_image
    std::vector<std::unique_ptr<Transfer>> transfers;
};

// ---- colour ----

const float *find_table(Textures *textures, unsigned bits, double gamma)
{
    for (const auto &transfer : textures->transfers)
        if (transfer->bits == bits && transfer->gamma == gamma)
            return transfer->table.data();
    auto transfer = std::make_unique<Transfer>();
    size_t count = size_t(1) << bits;
    transfer->bits = bits;
    transfer->gamma = gamma;
    transfer->table.resize(count);
    for (size_t i = 0; i < count; i++) {
        double s = double(i) / double(count - 1);
        transfer->table[i] = float(gamma == 0 ? bsq_srgb_to_linear(s) : std::pow(s, gamma));
    }
    textures->transfers.push_back(std::move(transfer));
    return textures->transfers.back()->table.data();
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
    return space.rfind("gamma", 0) == 0 && gamma > 0 ? gamma : 0;
}

// ---- opening ----

uint64_t decoded_bytes(const Image &image)
{
    return uint64_t(image.width) * image.height * unsigned(image.channels) * image.type.size();
}

// Reserves memory for an image that is decoded whole.
int reserve_whole(Textures *textures, const fmt::HeldImage &file)
{
    const fmt::Whole &whole = file.whole;
    unsigned long long left = textures->host->memory_left(textures->ctx);
    if (whole.bytes <= left)
        return textures->host->reserve(textures->ctx, "decoding a texture", whole.bytes);
    std::string size = whole.width == 0 ? "image"
                                        : std::to_string(whole.width) + " x " +
                                              std::to_string(whole.height) + " texels";
    return textures->host->fail(
        textures->ctx, BSQ_ENOMEM,
        "%s: this kind of %s file is decoded whole; its %s need%s %llu MiB of memory, %llu MiB are "
        "left: convert it to tiled TIFF (oiiotool IN --tile 64 64 -o OUT.tif)",
        file.path.c_str(), file.kind->name, size.c_str(), whole.width == 0 ? "s" : "",
        static_cast<unsigned long long>((whole.bytes >> 20) + 1), left >> 20);
}

// Counts large tiles or groups of rows: plug-ins decode one at a time.
int reserve_chunk(Textures *textures, const fmt::HeldImage &file)
{
    uint64_t bytes = fmt::chunk_bytes(*file.kind, file.shape);
    if (bytes < large_chunk)
        return 0;
    int status = textures->host->reserve(textures->ctx, "decoding a texture", bytes);
    if (!status)
        textures->chunk_bytes += bytes;
    return status;
}

int describe_spec(Textures *textures, Image &image)
{
    const ImageSpec &spec = image.file->shape;
    if (spec.width < 1 || spec.height < 1 || spec.nchannels < 1 || spec.depth > 1 || spec.deep)
        return textures->host->fail(textures->ctx, BSQ_EDATA, "%s: not a two-dimensional image",
                                    image.file->path.c_str());
    image.width = uint32_t(spec.width);
    image.height = uint32_t(spec.height);
    image.x = spec.x;
    image.y = spec.y;
    image.channels = spec.nchannels >= 3 && !image.file->alpha ? 3 : 1;
    // The input gives all channels of an image whose channels differ in type.
    if (image.file->alpha && spec.alpha_channel > 0 && !spec.channelformats.empty())
        image.file->first_channel = spec.alpha_channel;
    image.tiled = spec.tile_width > 0;
    image.type = TypeDesc::FLOAT;
    if (spec.format == TypeDesc::UINT8 || spec.format == TypeDesc::UINT16) {
        image.type = spec.format;
        image.table = find_table(textures, unsigned(spec.format.size()) * 8,
                                 image.data ? 1 : file_gamma(spec));
    }
    return reserve_chunk(textures, *image.file);
}

// Reserves memory first, as some plug-ins decode an image when they open it.
int describe(Textures *textures, const struct fmt_texture_source &source, Image &image)
{
    image.file = std::make_unique<fmt::HeldImage>();
    image.file->alpha = source.alpha;
    image.data = source.data || source.alpha;
    image.file->host = textures->host;
    image.file->ctx = textures->ctx;
    image.file->path = source.path;
    int status = image.file->probe();
    if (!status)
        status = reserve_whole(textures, *image.file);
    if (status)
        return status;
    status = fmt::HeldInput(image.file.get()).open_image();
    textures->host->release(textures->ctx, image.file->whole.bytes);
    return status ? status : describe_spec(textures, image);
}

// Reserves at most cache_bytes, chooses the pyramids' first level, and leaves the rest to the
// tiles.
int share_cache(Textures *textures, uint64_t cache_bytes)
{
    uint64_t bytes = 0, decoded = 0;
    for (const Image &image : textures->images)
        decoded += decoded_bytes(image);
    // Small images do not need all of a large cache. Three times their texels leave space for the
    // pyramids (a third of the texels) and for tiles that extend beyond an image's edges.
    uint64_t wanted = std::min(std::max(cache_bytes, smallest_cache), smallest_cache + 3 * decoded);
    int status = textures->host->reserve(textures->ctx, "texture cache", wanted);
    if (status)
        return status;
    textures->reserved = wanted;
    for (int level = first_pyramid_level;; level++) {
        bytes = 0;
        for (const Image &image : textures->images)
            bytes += fmt::Pyramid::size_bytes(image.width, image.height, level);
        textures->pyramid_level = level;
        if (bytes <= textures->reserved / 4 || level == 31)
            break;
    }
    if (bytes > textures->reserved / 2)
        return textures->host->fail(textures->ctx, BSQ_ENOMEM,
                                    "textures need a cache of more than %llu bytes",
                                    static_cast<unsigned long long>(textures->reserved));
    textures->tile_bytes = textures->reserved - bytes;
    textures->rewrite = decoded > textures->tile_bytes / 4 * 3;
    return 0;
}

// ---- the pass over all rows ----

float texel_value(const Image &image, const void *texels, size_t i)
{
    if (image.type == TypeDesc::UINT8)
        return image.table[static_cast<const uint8_t *>(texels)[i]];
    if (image.type == TypeDesc::UINT16)
        return image.table[static_cast<const uint16_t *>(texels)[i]];
    return static_cast<const float *>(texels)[i];
}

// Returns 0 for a value that is not finite: a single one would spread to all averages around it.
float finite_value(float value)
{
    return std::isfinite(value) ? value : 0.0f;
}

// Converts a row of the file to RGB triples of linear light. Counts texels that are not finite.
void make_linear(Image &image, const void *row, float *rgb)
{
    size_t channels = size_t(image.channels);
    for (size_t x = 0; x < image.width; x++) {
        bool broken = false;
        for (size_t c = 0; c < 3; c++) {
            float value = texel_value(image, row, x * channels + (channels == 3 ? c : 0));
            broken = broken || !std::isfinite(value);
            rgb[3 * x + c] = finite_value(value);
        }
        image.broken += broken;
    }
}

// Reports a failure of a temporary tiled file. `error` is errno right after the call: OpenImageIO's
// text does not give the system's reason.
int fail_tiles(Textures *textures, const Image &image, int error, std::string reason)
{
    std::replace(reason.begin(), reason.end(), '\n', ' ');
    if (error == 0)
        return textures->host->fail(textures->ctx, BSQ_EIO, "%s: %s", image.temporary.path,
                                    reason.c_str());
    return textures->host->fail_errno(textures->ctx, BSQ_EIO, error, "%s: %s", image.temporary.path,
                                      reason.c_str());
}

// Reports a tile or row of the image that cannot be read: BSQ_EIO if the disk failed, else damage.
int fail_read(Textures *textures, const Image &image, int error, const std::string &message)
{
    const std::string reason = fmt::one_line(message, image.file->path);
    if (error == EIO)
        return textures->host->fail_errno(textures->ctx, BSQ_EIO, error, "%s: %s",
                                          image.file->path.c_str(), reason.c_str());
    return textures->host->fail(textures->ctx, BSQ_EDATA, "%s: damaged image: %s",
                                image.file->path.c_str(), reason.c_str());
}

// What OpenImageIO writes to a temporary file through. The position in the file is its own: no
// other user of a descriptor can move it.
class TemporaryProxy : public OIIO::Filesystem::IOProxy
{
  public:
    TemporaryProxy(const Textures &textures, const struct bsq_file &file)
        : IOProxy("", Write), textures_(textures), file_(file)
    {
    }

    const char *proxytype() const override
    {
        return "bisque";
    }

    size_t read(void *to, size_t size) override
    {
        uint64_t got = 0;
        if (textures_.host->file_read_some(textures_.ctx, &file_, to, size, uint64_t(m_pos), &got))
            return 0;
        m_pos += int64_t(got);
        return size_t(got);
    }

    size_t write(const void *from, size_t size) override
    {
        if (textures_.host->file_write(textures_.ctx, &file_, from, size, uint64_t(m_pos)))
            return 0;
        m_pos += int64_t(size);
        size_ = std::max(size_, size_t(m_pos));
        return size;
    }

    size_t size() const override
    {
        return size_;
    }

  private:
    const Textures &textures_;
    const struct bsq_file &file_;
    size_t size_ = 0;
};

// A temporary tiled file that is being written. The proxy is destroyed after its user.
struct TiledFile {
    std::unique_ptr<TemporaryProxy> proxy;
    std::unique_ptr<OIIO::ImageOutput> output;
};

// Creates an unnamed tiled file for the image's texels.
int create_tiled(Textures *textures, Image &image, TiledFile &tiled)
{
    int status =
        textures->host->file_temp(textures->ctx, nullptr, "texture tiles", &image.temporary);
    if (status)
        return status;
    image.copy = std::make_unique<fmt::HeldImage>();
    image.copy->host = textures->host;
    image.copy->ctx = textures->ctx;
    image.copy->path = image.temporary.path;
    image.copy->kind = fmt::tiff_kind();
    image.copy->temporary = image.temporary.fd;
    ImageSpec spec(int(image.width), int(image.height), image.channels, image.type);
    spec.tile_width = spec.tile_height = tile_size;
    spec["compression"] = "none";
    auto &output = tiled.output;
    tiled.proxy = std::make_unique<TemporaryProxy>(*textures, image.temporary);
    output = OIIO::ImageOutput::create("tiff");
    errno = 0;
    if (!output || !output->set_ioproxy(tiled.proxy.get()) ||
        !output->open("tiles.tif", spec)) // the proxy stands for that name
        return fail_tiles(textures, image, errno, output ? output->geterror() : OIIO::geterror());
    output->threads(1);
    image.x = image.y = 0;
    return 0;
}

int read_rows(Textures *textures, const Image &image, fmt::HeldInput &input, uint32_t first,
              uint32_t end, void *rows)
{
    const ImageSpec &spec = input.spec();
    const int channel = image.file->first_channel;
    errno = 0;
    int y0 = spec.y + int(first), y1 = spec.y + int(end);
    bool good = spec.tile_width ? input.read_tiles(0, 0, spec.x, spec.x + spec.width, y0, y1,
                                                   spec.z, spec.z + 1, channel,
                                                   channel + image.channels, image.type, rows)
                                : input.read_scanlines(0, 0, y0, y1, spec.z, channel,
                                                       channel + image.channels, image.type, rows);
    if (good)
        return 0;
    return fail_read(textures, image, image.file->error, input.geterror());
}

// Rows of an image, which are freed whatever ends their use.
struct Rows {
    Textures *textures;
    void *data = nullptr;
    ~Rows()
    {
        textures->host->free(textures->ctx, data);
    }
};

// Writes tiles one by one. The plug-in's own function would start threads.
bool write_rows(OIIO::ImageOutput &output, const Image &image, uint32_t first, uint32_t end,
                const void *rows)
{
    return output.ImageOutput::write_tiles(0, int(image.width), int(first), int(end), 0, 1,
                                           image.type, rows);
}

// Reads the image once: builds its pyramid and, if textures->rewrite is set, its tiled copy.
int pass_over(Textures *textures, Image &image)
{
    const struct fmt_host *host = textures->host;
    struct bsq_ctx *ctx = textures->ctx;
    TiledFile tiled;
    auto &output = tiled.output;
    Rows rows{textures, nullptr};
    fmt::HeldInput input(image.file.get());
    int status = input.open_image();
    if (status)
        return status;
    bool rewrite = !image.tiled && (textures->rewrite || image.file->whole.bytes > 0);
    if (rewrite && (status = create_tiled(textures, image, tiled)))
        return status;
    size_t row_bytes = size_t(image.width) * size_t(image.channels) * image.type.size();
    uint32_t strip = image.tiled ? uint32_t(input.spec().tile_height) : uint32_t(tile_size);
    strip = std::min(strip, image.height);
    if ((status = host->alloc(ctx, "texture rows", strip, row_bytes, &rows.data)))
        return status;
    image.pyramid = fmt::Pyramid(image.width, image.height, textures->pyramid_level);
    std::vector<float> linear(3 * size_t(image.width));
    for (uint32_t y = 0; y < image.height && !status; y += strip) {
        uint32_t end = std::min(image.height, y + strip);
        status = read_rows(textures, image, input, y, end, rows.data);
        for (uint32_t i = y; i < end && !status; i++) {
            const char *row = static_cast<const char *>(rows.data) + (i - y) * row_bytes;
            make_linear(image, row, linear.data());
            image.pyramid.add_row(linear.data());
        }
        errno = 0;
        if (!status && output && !write_rows(*output, image, y, end, rows.data))
            status = fail_tiles(textures, image, errno, output->geterror());
        if (!status)
            status = host->check(ctx);
    }
    errno = 0;
    if (!status && output && !output->close())
        status = fail_tiles(textures, image, errno, output->geterror());
    image.pyramid.finish();
    return status;
}

int pass_over_or_throw(Textures *textures, Image &image)
{
    try {
        return pass_over(textures, image);
    } catch (const std::bad_alloc &) {
        return textures->host->fail(textures->ctx, BSQ_ENOMEM, "%s: out of memory",
                                    image.file->path.c_str());
    } catch (const std::system_error &error) { // a thread cannot be started
        return textures->host->fail(textures->ctx, BSQ_ENOMEM, "%s: %s", image.file->path.c_str(),
                                    error.what());
    } catch (const std::exception &exception) {
        return fail_read(textures, image, 0, exception.what());
    }
}

int pass_over_image(void *arg, uint64_t index, unsigned)
{
    auto *textures = static_cast<Textures *>(arg);
    Image &image = textures->images[index];
    return image.file->whole.bytes > 0 ? 0 : pass_over_or_throw(textures, image);
}

// Images that are decoded whole come one after the other, so that the memory is needed once.
int pass_over_all(Textures *textures)
{
    int status = textures->host->parallel_for(textures->ctx, textures->images.size(),
                                              pass_over_image, textures);
    for (Image &image : textures->images) {
        uint64_t bytes = image.file->whole.bytes;
        if (status || bytes == 0)
            continue;
        if ((status = reserve_whole(textures, *image.file)))
            break;
        status = pass_over_or_throw(textures, image);
        textures->host->release(textures->ctx, bytes);
    }
    return status;
}

// Adds a file to the cache, which reads it through a HeldInput, and sets its handle.
bool add_to_cache(ImageCache *cache, Image &image, size_t number)
{
    OIIO::ustring name("bisque image " + std::to_string(number));
    ImageSpec config;
    fmt::HeldImage *file = image.copy ? image.copy.get() : image.file.get();
    config.attribute(fmt::HeldInput::attribute, TypeDesc::PTR, &file);
    if (!cache->add_file(name, fmt::HeldInput::create, &config))
        return false;
    image.handle = cache->get_image_handle(name);
    return image.handle && cache->good(image.handle);
}

int open_cache(Textures *textures)
{
    ImageCache *cache = textures->cache = ImageCache::create(false);
    size_t number = 0;
    cache->attribute("max_memory_MB", float(double(textures->tile_bytes) / (1 << 20)));
    cache->attribute("autotile", tile_size);
    cache->attribute("unassociatedalpha", 1);
    cache->attribute("deduplicate", 0);
    for (Image &image : textures->images) {
        if (add_to_cache(cache, image, number++))
            continue;
        int failed = image.copy ? image.copy->status : image.file->status;
        return failed ? failed
                      : textures->host->fail(textures->ctx, BSQ_EDATA, "%s: %s",
                                             image.file->path.c_str(), cache->geterror().c_str());
    }
    return 0;
}

// Describes each distinct source once; materials often share a file.
int describe_all(Textures *textures, const struct fmt_texture_source *sources, uint32_t count)
{
    std::unordered_map<std::string, uint32_t> known[3]; // colours, data, alpha
    textures->image_of.assign(count, no_image);
    for (uint32_t i = 0; i < count; i++) {
        if (!sources[i].path)
            continue;
        const int use = sources[i].alpha ? 2 : sources[i].data ? 1 : 0;
        auto entry = known[use].emplace(sources[i].path, uint32_t(textures->images.size()));
        textures->image_of[i] = entry.first->second;
        if (!entry.second)
            continue;
        textures->images.emplace_back();
        int status = textures->host->check(textures->ctx);
        if (!status)
            status = describe(textures, sources[i], textures->images.back());
        if (status)
            return status;
    }
    return 0;
}

int open_all(Textures *textures, const struct fmt_texture_source *sources, uint32_t count,
             uint64_t cache_bytes)
{
    int status = describe_all(textures, sources, count);
    if (!status)
        status = share_cache(textures, cache_bytes);
    if (!status)
        status = pass_over_all(textures);
    return status ? status : open_cache(textures);
}

// ---- lookups ----

// Adds to `sum` the integral of the image over the part of rectangle `r` that lies in one tile.
// `roi` is the tile's region in the file's coordinates, `texels` its first texel.
template <typename T, typename Decode>
void add_texels(const Image &image, const fmt::Rectangle &r, const OIIO::ROI &roi, const T *texels,
                Decode decode, double sum[3])
{
    int x0 = std::max(roi.xbegin - image.x, int(std::floor(r.x0)));
    int x1 = std::min(roi.xend - image.x, int(std::ceil(r.x1)));
    int y0 = std::max(roi.ybegin - image.y, int(std::floor(r.y0)));
    int y1 = std::min(roi.yend - image.y, int(std::ceil(r.y1)));
    size_t pixel = size_t(image.channels), row = size_t(roi.width()) * pixel;
    for (int y = y0; y < y1; y++) {
        const T *t = texels + size_t(y - (roi.ybegin - image.y)) * row +
                     size_t(x0 - (roi.xbegin - image.x)) * pixel;
        double line[3] = {0, 0, 0};
        for (int x = x0; x < x1; x++, t += pixel) {
            double weight = fmt::overlap(x, 1, r.x0, r.x1);
            for (size_t c = 0; c < pixel; c++)
                line[c] += weight * double(decode(t[c]));
        }
        double weight = fmt::overlap(y, 1, r.y0, r.y1);
        for (size_t c = 0; c < 3; c++)
            sum[c] += weight * line[pixel == 3 ? c : 0];
    }
}

// Adds to `sum` the integral of the image over a rectangle inside it, tile by tile.
int add_from_tiles(Textures *textures, const Image &image, const fmt::Rectangle &r, double sum[3])
{
    ImageCache *cache = textures->cache;
    int x_end = int(std::ceil(r.x1)), y_end = int(std::ceil(r.y1));
    for (int y = int(std::floor(r.y0)), next_y = y; y < y_end; y = next_y)
        for (int x = int(std::floor(r.x0)); x < x_end;) {
            const fmt::HeldImage &held = image.copy ? *image.copy : *image.file;
            auto *tile = cache->get_tile(image.handle, nullptr, 0, 0, x + image.x, y + image.y, 0,
                                         held.first_channel, held.first_channel + image.channels);
            if (!tile && held.status)
                return held.status; // the file could not be opened again
            if (!tile)
                return image.copy ? fail_tiles(textures, image, held.error, cache->geterror())
                                  : fail_read(textures, image, held.error, cache->geterror());
            TypeDesc type;
            const void *texels = cache->tile_pixels(tile, type);
            OIIO::ROI roi = cache->tile_roi(tile);
            const float *table = image.table;
            if (type == TypeDesc::UINT8)
                add_texels(
                    image, r, roi, static_cast<const uint8_t *>(texels),
                    [table](uint8_t v) { return table[v]; }, sum);
            else if (type == TypeDesc::UINT16)
                add_texels(
                    image, r, roi, static_cast<const uint16_t *>(texels),
                    [table](uint16_t v) { return table[v]; }, sum);
            else if (type == TypeDesc::HALF)
                add_texels(
                    image, r, roi, static_cast<const half *>(texels),
                    [](half v) { return finite_value(float(v)); }, sum);
            else
                add_texels(
                    image, r, roi, static_cast<const float *>(texels),
                    [](float v) { return finite_value(v); }, sum);
            cache->release_tile(tile);
            x = roi.xend - image.x;
            next_y = roi.yend - image.y;
        }
    return 0;
}

// An interval on a circle, as one or two intervals in [0, period].
struct Wrapped {
    double first[2], last[2];
    int count;
};

Wrapped wrap(double centre, double extent, double period)
{
    double start = centre - extent / 2;
    start -= std::floor(start / period) * period;
    if (!(start >= 0 && start < period)) // rounding, or not a number
        start = 0;
    if (start + extent <= period)
        return {{start, 0}, {start + extent, 0}, 1};
    return {{start, 0}, {period, start + extent - period}, 2};
}

int average(Textures *textures, const Image &image, double x, double y, double width, double height,
            float out[3])
{
    double sum[3] = {0, 0, 0};
    width = std::min(std::max(width, 1.0), double(image.width));
    height = std::min(std::max(height, 1.0), double(image.height));
    int level = int(std::floor(std::log2(std::min(width, height) / cells_across)));
    level = std::min(level, image.pyramid.last_level());
    Wrapped across = wrap(x, width, image.width), down = wrap(y, height, image.height);
    for (int j = 0; j < down.count; j++)
        for (int i = 0; i < across.count; i++) {
            fmt::Rectangle r = {across.first[i], across.last[i], down.first[j], down.last[j]};
            int status = 0;
            if (level < image.pyramid.first_level())
                status = add_from_tiles(textures, image, r, sum);
            else
                image.pyramid.integrate(level, r, sum);
            if (status)
                return status;
        }
    for (int c = 0; c < 3; c++)
        out[c] = float(sum[c] / (width * height));
    return 0;
}

// ---- the module ----

void close_textures(struct fmt_texture_images *opened)
{
    auto *textures = static_cast<Textures *>(opened);
    if (textures->cache)
        ImageCache::destroy(textures->cache);
    for (Image &image : textures->images)
        textures->host->file_close(textures->ctx, &image.temporary);
    textures->host->release(textures->ctx, textures->reserved + textures->chunk_bytes);
    delete textures;
}

void texture_size(const struct fmt_texture_images *opened, uint32_t image, uint32_t *width,
                  uint32_t *height)
{
    const auto *textures = static_cast<const Textures *>(opened);
    uint32_t number = textures->image_of[image];
    *width = number == no_image ? 0 : textures->images[number].width;
    *height = number == no_image ? 0 : textures->images[number].height;
}

bool has_alpha(const struct fmt_texture_images *opened, uint32_t image)
{
    const auto *textures = static_cast<const Textures *>(opened);
    uint32_t number = textures->image_of[image];
    return number != no_image && textures->images[number].file->shape.alpha_channel >= 0;
}

uint64_t take_broken(struct fmt_texture_images *opened, uint32_t image, const char **path)
{
    auto *textures = static_cast<Textures *>(opened);
    uint32_t number = textures->image_of[image];
    if (number == no_image)
        return 0;
    *path = textures->images[number].file->path.c_str();
    return std::exchange(textures->images[number].broken, 0);
}

int sample_texture(struct fmt_texture_images *opened, uint32_t image, float u, float v, float du,
                   float dv, float out[3])
{
    auto *textures = static_cast<Textures *>(opened);
    uint32_t number = textures->image_of[image];
    if (number == no_image)
        return textures->host->fail(textures->ctx, BSQ_EBUG, "texture %u has no image", image);
    const Image &i = textures->images[number];
    // Reduce to one period before scaling, so that large coordinates keep their precision in
    // texels.
    double x = (double(u) - std::floor(double(u))) * i.width;
    double y = (std::ceil(double(v)) - double(v)) * i.height;
    try {
        return average(textures, i, x, y, double(du) * i.width, double(dv) * i.height, out);
    } catch (const std::bad_alloc &) {
        return textures->host->fail(textures->ctx, BSQ_ENOMEM, "%s: out of memory",
                                    i.file->path.c_str());
    } catch (const std::exception &exception) {
        return fail_read(textures, i, 0, exception.what());
    }
}

int open_textures(const struct fmt_host *host, struct bsq_ctx *ctx,
                  const struct fmt_texture_source *sources, uint32_t count, uint64_t cache_bytes,
                  struct fmt_texture_images **out)
{
    auto *textures = new (std::nothrow) Textures;
    if (!textures)
        return host->fail(ctx, BSQ_ENOMEM, "out of memory for textures");
    textures->module = &bisque_module;
    textures->host = host;
    textures->ctx = ctx;
    int status = 0;
    try {
        OIIO::attribute("exr_threads", -1); // decodes on the calling thread
        status = open_all(textures, sources, count, cache_bytes);
    } catch (const std::bad_alloc &) {
        status = host->fail(ctx, BSQ_ENOMEM, "out of memory for textures");
    } catch (const std::exception &exception) {
        status = host->fail(ctx, BSQ_EDATA, "a texture cannot be read: %s", exception.what());
    }
    if (status)
        close_textures(textures);
    else
        *out = textures;
    return status;
}

} // namespace

extern "C" {
const struct fmt_texture_module bisque_module = {{fmt_module_stamp}, open_textures, close_textures,
                                                 texture_size,       has_alpha,     take_broken,
                                                 sample_texture};
}
