// texture_images.h - the images of the module for textures, which its sources share.
#ifndef FMT_TEXTURE_TEXTURE_IMAGES_H
#define FMT_TEXTURE_TEXTURE_IMAGES_H

#include <OpenImageIO/imagecache.h>

#include <cmath>
#include <memory>
#include <string>
#include <vector>

#include "formats/texture/held_input.h"
#include "formats/texture/texture_module.h"
#include "formats/texture/texture_pyramid.h"

namespace fmt
{

constexpr int tile_size = 64; // of tiles in the cache, in texels
constexpr uint32_t no_image = UINT32_MAX;

// Maps each value of an 8 or 16-bit texel to linear light.
struct Transfer {
    unsigned bits;
    double gamma; // exponent; 0: the sRGB curve (IEC 61966-2-1)
    std::vector<float> table;
};

struct Image {
    std::unique_ptr<HeldImage> file;
    std::unique_ptr<HeldImage> copy; // the temporary tiled file; NULL: none
    uint32_t width = 0, height = 0;
    int x = 0, y = 0;             // the first texel in the file's coordinates
    int channels = 0;             // channels that are read: 1 or 3
    bool data = false;            // values are no colours
    OIIO::TypeDesc type;          // of texels in the cache: UINT8, UINT16 or FLOAT
    const float *table = nullptr; // to linear light; for integers only
    bool tiled = false;
    uint64_t broken = 0; // texels that are not finite, until they are told
    struct bsq_file temporary = BSQ_FILE_CLOSED;
    OIIO::ImageCache::ImageHandle *handle = nullptr;
    Pyramid pyramid;
};

// The module's own part of struct fmt_texture_images.
struct Textures : fmt_texture_images {
    const struct fmt_host *host = nullptr;
    struct bsq_ctx *ctx = nullptr;
    uint64_t reserved = 0, tile_bytes = 0;
    uint64_t chunk_bytes = 0; // reserved too
    int pyramid_level = 0;
    bool rewrite = false; // copy scanline images to temporary tiled files
    OIIO::ImageCache *cache = nullptr;
    std::vector<Image> images;      // each file once
    std::vector<uint32_t> image_of; // caller's image number to index in `images`, or no_image
    std::vector<std::unique_ptr<Transfer>> transfers;
};

// Reserves memory for an image that is decoded whole; the caller releases file.whole.bytes. Returns
// BSQ_ENOMEM if the budget does not have it.
int reserve_whole(Textures *textures, const HeldImage &file);

// Reads each image once, top row first: builds its pyramid, counts texels that are not finite and,
// if it will not fit in the cache, copies it to a temporary tiled file. Errors: those of reading
// and of temporary files; BSQ_EINTR, BSQ_ENOMEM.
int pass_over_all(Textures *textures);

// Averages an image, in linear light, over a box of width x height texels around (x, y). The box is
// clamped to 1 texel and to the image's size; the image repeats. Errors: BSQ_EDATA, BSQ_EIO,
// BSQ_ENOMEM.
int average(Textures *textures, const Image &image, double x, double y, double width, double height,
            float out[3]);

// Reports a failure of a temporary tiled file. `error` is errno right after the call: OpenImageIO's
// text does not give the system's reason. Returns BSQ_EIO.
int fail_tiles(Textures *textures, const Image &image, int error, std::string reason);

// Reports a tile or row of the image that cannot be read. Returns BSQ_EIO if the disk failed, else
// BSQ_EDATA.
int fail_read(Textures *textures, const Image &image, int error, const std::string &message);

// Returns 0 for a value that is not finite: a single one would spread to all averages around it.
inline float finite_value(float value)
{
    return std::isfinite(value) ? value : 0.0f;
}

} // namespace fmt

#endif
