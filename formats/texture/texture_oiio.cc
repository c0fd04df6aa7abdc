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
#include "formats/texture/texture_images.h"

#include <algorithm>
#include <cctype>
#include <cerrno>
#include <cmath>
#include <memory>
#include <new>
#include <string>
#include <unordered_map>
#include <utility>

#include "base/srgb.h"

extern "C" {
extern const struct fmt_texture_module bisque_module;
}

using OIIO::ImageCache;
using OIIO::ImageSpec;
using OIIO::TypeDesc;

namespace fmt
{

// ---- errors and memory ----

int fail_tiles(Textures *textures, const Image &image, int error, std::string reason)
{
    std::replace(reason.begin(), reason.end(), '\n', ' ');
    if (error == 0)
        return textures->host->fail(textures->ctx, BSQ_EIO, "%s: %s", image.temporary.path,
                                    reason.c_str());
    return textures->host->fail_errno(textures->ctx, BSQ_EIO, error, "%s: %s", image.temporary.path,
                                      reason.c_str());
}

int fail_read(Textures *textures, const Image &image, int error, const std::string &message)
{
    const std::string reason = one_line(message, image.file->path);
    if (error == EIO)
        return textures->host->fail_errno(textures->ctx, BSQ_EIO, error, "%s: %s",
                                          image.file->path.c_str(), reason.c_str());
    return textures->host->fail(textures->ctx, BSQ_EDATA, "%s: damaged image: %s",
                                image.file->path.c_str(), reason.c_str());
}

int reserve_whole(Textures *textures, const HeldImage &file)
{
    const Whole &whole = file.whole;
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

namespace
{

constexpr uint64_t smallest_cache = 12 << 20; // OpenImageIO takes at least 10 MB
constexpr uint64_t large_chunk = 4 << 20;     // smaller tiles or groups of rows are not counted
constexpr int first_pyramid_level = 2;

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

// Counts large tiles or groups of rows: plug-ins decode one at a time.
int reserve_chunk(Textures *textures, const HeldImage &file)
{
    uint64_t bytes = chunk_bytes(*file.kind, file.shape);
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
    image.file = std::make_unique<HeldImage>();
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
    status = HeldInput(image.file.get()).open_image();
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
            bytes += Pyramid::size_bytes(image.width, image.height, level);
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

// Adds a file to the cache, which reads it through a HeldInput, and sets its handle.
bool add_to_cache(ImageCache *cache, Image &image, size_t number)
{
    OIIO::ustring name("bisque image " + std::to_string(number));
    ImageSpec config;
    HeldImage *file = image.copy ? image.copy.get() : image.file.get();
    config.attribute(HeldInput::attribute, TypeDesc::PTR, &file);
    if (!cache->add_file(name, HeldInput::create, &config))
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

} // namespace fmt

extern "C" {
const struct fmt_texture_module bisque_module = {
    {fmt_module_stamp}, fmt::open_textures, fmt::close_textures, fmt::texture_size,
    fmt::has_alpha,     fmt::take_broken,   fmt::sample_texture};
}
