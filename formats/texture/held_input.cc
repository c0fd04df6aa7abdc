// held_input.cc - reads one image file that must stay what it was when it was first opened.
#include "formats/texture/held_input.h"

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstring>

#include "formats/texture/png_rows.h"

namespace fmt
{

namespace
{

// PNG files through libpng. The colour space is set as OpenImageIO does it.
class PngInput final : public OIIO::ImageInput
{
  public:
    explicit PngInput(int fd) : fd(fd)
    {
    }
    ~PngInput() override
    {
        fmt_png_rows_close(rows);
    }
    const char *format_name() const override
    {
        return "png";
    }
    bool open(const std::string &, OIIO::ImageSpec &spec) override
    {
        struct fmt_png_info info;
        char message[FMT_PNG_MESSAGE];
        if (fmt_png_rows_open(fd, &info, message, &rows) < 0) {
            errorfmt("{}", message);
            return false;
        }
        m_spec = OIIO::ImageSpec(int(info.width), int(info.height), info.channels,
                                 info.bits == 16 ? OIIO::TypeDesc::UINT16 : OIIO::TypeDesc::UINT8);
        float gamma = info.gamma > 0 ? std::round(100 * float(1 / info.gamma)) / 100 : 0;
        m_spec.attribute("oiio:ColorSpace", gamma == 0   ? "sRGB"
                                            : gamma == 1 ? "linear"
                                                         : "GammaCorrected");
        m_spec.attribute("oiio:Gamma", gamma);
        spec = m_spec;
        return true;
    }
    bool close() override
    {
        fmt_png_rows_close(rows);
        rows = nullptr;
        return true;
    }
    // Skips the rows above; never goes back.
    bool read_native_scanline(int, int, int y, int, void *data) override
    {
        char message[FMT_PNG_MESSAGE];
        for (; next_row <= y; next_row++)
            if (fmt_png_rows_read(rows, data, message) < 0) {
                errorfmt("{}", message);
                return false;
            }
        return true;
    }

  private:
    int fd, next_row = 0;
    struct fmt_png_rows *rows = nullptr;
};

// Returns whether reading several rows at once starts a pool of threads, which ends the process if
// the system has none left.
bool starts_threads(const ImageKind &kind)
{
    return std::strcmp(kind.plugin, "tiff") == 0;
}

bool same_shape(const OIIO::ImageSpec &a, const OIIO::ImageSpec &b)
{
    return a.x == b.x && a.y == b.y && a.z == b.z && a.width == b.width && a.height == b.height &&
           a.depth == b.depth && a.nchannels == b.nchannels && a.tile_width == b.tile_width &&
           a.tile_height == b.tile_height && a.tile_depth == b.tile_depth && a.format == b.format &&
           a.channelformats == b.channelformats && a.deep == b.deep;
}

} // namespace

int HeldImage::probe()
{
    struct bsq_part range;
    const size_t length = host->part_parse(path.c_str(), &range);
    if (length == 0)
        return probe_range(path, nullptr);
    // A part that is no image is not copied.
    const int failure = probe_range(path.substr(0, length), &range);
    return failure ? failure : host->part_extract(ctx, path.c_str(), &part);
}

// Recognises the image in the file of this name, or in a range of it.
int HeldImage::probe_range(const std::string &name, const struct bsq_part *range)
{
    struct bsq_file file;
    const int failure = host->file_open(ctx, name.c_str(), &file);
    const Probe found = {host, ctx, &file, range, {0}};
    const int status = failure ? failure : recognise(found);
    host->file_close(ctx, &file);
    return status;
}

int HeldImage::recognise(Probe found)
{
    uint64_t got = 0;
    int failure = found.read(0, found.head, sizeof found.head, &got);
    if (!failure && !(kind = find_image_kind(found)))
        failure = host->fail(ctx, BSQ_EDATA, "%s: not a readable image: it is no %s", path.c_str(),
                             image_kinds_text);
    const char *excess = !failure && kind->excess ? kind->excess(found) : nullptr;
    if (excess)
        failure = host->fail(ctx, BSQ_EDATA, "%s: not a readable image: %s", path.c_str(), excess);
    if (!failure && kind->whole)
        whole = kind->whole(found);
    return failure;
}

int HeldImage::check(std::string &reason)
{
    if (!kind->check)
        return 0;
    struct bsq_file file = BSQ_FILE_CLOSED;
    const bool is_part = part.fd >= 0;
    int failure = is_part ? 0 : host->file_open(ctx, path.c_str(), &file);
    if (!failure)
        failure = kind->check({host, ctx, is_part ? &part : &file, nullptr, {0}}, reason);
    host->file_close(ctx, &file);
    return failure;
}

HeldInput::HeldInput(HeldImage *image) : image(image)
{
    threads(1);
}

HeldInput::~HeldInput()
{
    close();
}

bool HeldInput::close()
{
    lock_guard guard(*this);
    inner.reset();
    if (image)
        image->host->file_close(image->ctx, &file);
    return true;
}

std::string one_line(std::string reason, const std::string &path)
{
    static const char opened[] = "/proc/self/fd/";
    const std::string name = path.substr(path.rfind('/') + 1); // npos + 1 is 0
    std::replace(reason.begin(), reason.end(), '\n', ' ');
    for (size_t at = 0; (at = reason.find(opened, at)) != std::string::npos; at += name.size()) {
        const size_t end = reason.find_first_not_of("0123456789", at + sizeof opened - 1);
        reason.replace(at, end == std::string::npos ? end : end - at, name);
    }
    return reason.empty() ? "its decoder gives no reason, the file may be cut off" : reason;
}

int HeldInput::fail_open(int error, const std::string &message)
{
    const char *path = image->path.c_str();
    const std::string reason = one_line(message, image->path);
    if (image->temporary >= 0)
        return image->host->fail(image->ctx, BSQ_EIO, "%s: %s", path, reason.c_str());
    if (error == EMFILE || error == ENFILE || error == EIO) // not a fault of the image
        return image->host->fail_errno(image->ctx, BSQ_ENOINPUT, error, "%s", path);
    return image->host->fail(image->ctx, BSQ_EDATA, "%s: not a readable image: %s", path,
                             reason.c_str());
}

int HeldInput::check_shape()
{
    if (!image->described) {
        image->shape = inner->spec();
        image->described = true;
    }
    if (same_shape(image->shape, inner->spec()))
        return 0;
    return image->host->fail(image->ctx, BSQ_EIO, "%s: was changed while it was read",
                             image->path.c_str());
}

int HeldInput::open_inner()
{
    OIIO::ImageSpec found, config;
    config["oiio:UnassociatedAlpha"] = 1;
    int fd = image->temporary >= 0 ? image->temporary : image->part.fd;
    if (fd < 0) {
        int status = image->host->file_open(image->ctx, image->path.c_str(), &file);
        if (status)
            return status;
        fd = file.fd;
    }
    errno = 0;
    if (std::strcmp(image->kind->plugin, "png") == 0)
        inner.reset(new PngInput(fd));
    else
        inner = OIIO::ImageInput::create(image->kind->plugin);
    if (!inner)
        return fail_open(errno, OIIO::geterror());
    inner->threads(1);
    if (!inner->open("/proc/self/fd/" + std::to_string(fd), found, config))
        return fail_open(errno, inner->geterror());
    next_row = inner->spec().y;
    return check_shape();
}

int HeldInput::open_image()
{
    lock_guard guard(*this);
    close();
    int status = open_inner();
    int none = 0;
    if (status) {
        close();
        image->status.compare_exchange_strong(none, status);
    } else {
        m_spec = inner->spec();
        drop_channels();
    }
    return status;
}

// OpenImageIO itself would start threads to leave channels out. Images whose channels differ in
// type are left to it.
void HeldInput::drop_channels()
{
    int kept = m_spec.nchannels >= 3 && !image->alpha ? 3 : 1;
    inner_texel = texel = m_spec.pixel_bytes(true);
    first_byte = 0;
    if (kept == m_spec.nchannels || !m_spec.channelformats.empty())
        return;
    if (image->alpha && m_spec.alpha_channel > 0)
        first_byte = m_spec.format.size() * size_t(m_spec.alpha_channel);
    m_spec.nchannels = kept;
    m_spec.alpha_channel = m_spec.z_channel = -1;
    m_spec.channelnames.resize(size_t(kept));
    texel = m_spec.pixel_bytes(true);
}

// Copies the channels that are given.
void HeldInput::keep(const void *from, void *to, size_t texels) const
{
    const char *in = static_cast<const char *>(from) + first_byte;
    char *out = static_cast<char *>(to);
    for (size_t i = 0; i < texels; i++, in += inner_texel, out += texel)
        std::memcpy(out, in, texel);
}

bool HeldInput::open(const std::string &, OIIO::ImageSpec &)
{
    return false; // without the attribute there is no image
}

bool HeldInput::open(const std::string &, OIIO::ImageSpec &spec, const OIIO::ImageSpec &config)
{
    const auto *value = config.find_attribute(attribute, OIIO::TypeDesc::PTR);
    if (!value)
        return false;
    image = *static_cast<HeldImage *const *>(value->data());
    if (open_image() != 0) {
        errorfmt("cannot be opened again");
        return false;
    }
    spec = m_spec;
    return true;
}

bool HeldInput::pass_on(bool good)
{
    int none = 0; // the first reason counts: OpenImageIO may try again, and fail in another way
    if (!good && image)
        image->error.compare_exchange_strong(none, errno);
    if (!good)
        errorfmt("{}", inner ? inner->geterror() : "cannot be opened again");
    return good;
}

// Prepares for reading rows in sequence.
bool HeldInput::go_to(int ybegin, int yend)
{
    bool good = inner && (ybegin >= next_row || open_image() == 0);
    next_row = yend;
    return good;
}

bool HeldInput::read_native_scanline(int subimage, int miplevel, int y, int z, void *data)
{
    lock_guard guard(*this); // the cache's threads share one input
    errno = 0;
    bool whole = texel == inner_texel;
    size_t width = size_t(m_spec.width);
    scratch.resize(whole ? 0 : width * inner_texel);
    if (!go_to(y, y + 1) ||
        !inner->read_native_scanline(subimage, miplevel, y, z, whole ? data : scratch.data()))
        return pass_on(false);
    if (!whole)
        keep(scratch.data(), data, width);
    return true;
}

bool HeldInput::read_native_scanlines(int subimage, int miplevel, int ybegin, int yend, int z,
                                      void *data)
{
    if (starts_threads(*image->kind) || texel != inner_texel)
        return ImageInput::read_native_scanlines(subimage, miplevel, ybegin, yend, z, data);
    lock_guard guard(*this);
    errno = 0;
    return pass_on(go_to(ybegin, yend) &&
                   inner->read_native_scanlines(subimage, miplevel, ybegin, yend, z, data));
}

bool HeldInput::read_native_tile(int subimage, int miplevel, int x, int y, int z, void *data)
{
    lock_guard guard(*this);
    errno = 0;
    bool whole = texel == inner_texel;
    size_t texels = size_t(m_spec.tile_width) * size_t(m_spec.tile_height);
    scratch.resize(whole ? 0 : texels * inner_texel);
    if (!inner ||
        !inner->read_native_tile(subimage, miplevel, x, y, z, whole ? data : scratch.data()))
        return pass_on(false);
    if (!whole)
        keep(scratch.data(), data, texels);
    return true;
}

} // namespace fmt
