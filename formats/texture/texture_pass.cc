// texture_pass.cc - the pass over all rows of each image, see texture_oiio.cc.
#include "formats/texture/texture_images.h"

#include <OpenImageIO/filesystem.h>

#include <algorithm>
#include <cerrno>
#include <new>
#include <system_error>

using OIIO::ImageSpec;
using OIIO::TypeDesc;

namespace fmt
{

namespace
{

float texel_value(const Image &image, const void *texels, size_t i)
{
    if (image.type == TypeDesc::UINT8)
        return image.table[static_cast<const uint8_t *>(texels)[i]];
    if (image.type == TypeDesc::UINT16)
        return image.table[static_cast<const uint16_t *>(texels)[i]];
    return static_cast<const float *>(texels)[i];
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
    image.copy = std::make_unique<HeldImage>();
    image.copy->host = textures->host;
    image.copy->ctx = textures->ctx;
    image.copy->path = image.temporary.path;
    image.copy->kind = tiff_kind();
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

int read_rows(Textures *textures, const Image &image, HeldInput &input, uint32_t first,
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

// Reports damage that decoding would not tell of.
int check_damage(Textures *textures, const Image &image)
{
    std::string reason;
    const int status = image.file->check(reason);
    return status || reason.empty() ? status : fail_read(textures, image, 0, reason);
}

// Reads the image once: builds its pyramid and, if textures->rewrite is set, its tiled copy.
int pass_over(Textures *textures, Image &image)
{
    const struct fmt_host *host = textures->host;
    struct bsq_ctx *ctx = textures->ctx;
    TiledFile tiled;
    auto &output = tiled.output;
    Rows rows{textures, nullptr};
    HeldInput input(image.file.get());
    int status = check_damage(textures, image);
    if (!status)
        status = input.open_image();
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
    image.pyramid = Pyramid(image.width, image.height, textures->pyramid_level);
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

} // namespace

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

} // namespace fmt
