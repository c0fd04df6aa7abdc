// texture_lookup.cc - averages of an image over boxes of texels, see texture_oiio.cc.
#include "formats/texture/texture_images.h"

#include <algorithm>
#include <cmath>

#include <half.h>

using OIIO::ImageCache;
using OIIO::TypeDesc;

namespace fmt
{

namespace
{

constexpr double cells_across = 4; // least cells along a box in the pyramid level it is read from

// Adds to `sum` the integral of the image over the part of rectangle `r` that lies in one tile.
// `roi` is the tile's region in the file's coordinates, `texels` its first texel.
template <typename T, typename Decode>
void add_texels(const Image &image, const Rectangle &r, const OIIO::ROI &roi, const T *texels,
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
            double weight = overlap(x, 1, r.x0, r.x1);
            for (size_t c = 0; c < pixel; c++)
                line[c] += weight * double(decode(t[c]));
        }
        double weight = overlap(y, 1, r.y0, r.y1);
        for (size_t c = 0; c < 3; c++)
            sum[c] += weight * line[pixel == 3 ? c : 0];
    }
}

// Adds to `sum` the integral of the image over a rectangle inside it, tile by tile.
int add_from_tiles(Textures *textures, const Image &image, const Rectangle &r, double sum[3])
{
    ImageCache *cache = textures->cache;
    int x_end = int(std::ceil(r.x1)), y_end = int(std::ceil(r.y1));
    for (int y = int(std::floor(r.y0)), next_y = y; y < y_end; y = next_y)
        for (int x = int(std::floor(r.x0)); x < x_end;) {
            const HeldImage &held = image.copy ? *image.copy : *image.file;
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

} // namespace

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
            Rectangle r = {across.first[i], across.last[i], down.first[j], down.last[j]};
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

} // namespace fmt
