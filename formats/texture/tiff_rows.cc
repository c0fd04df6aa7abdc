// tiff_rows.cc - the program bisque-tiff, which reads TIFF files by libtiff.
//
// Grey, RGB and CMYK images are read as they are stored. libtiff converts all other kinds, such as
// palettes, to 8-bit RGB, a strip or a row of tiles at a time. Planes that lie apart in the file
// are read by a handle each: so no strip is decoded twice.
#include <half.h>
#include <tiffio.h>

#include <algorithm>
#include <cerrno>
#include <cstdarg>
#include <cstdio>
#include <cstring>
#include <limits>
#include <vector>

#include "formats/texture/image_program.h"

namespace
{

std::string message; // the first one of libtiff since it was cleared

void keep_message(const char *, const char *format, va_list arguments)
{
    char text[512];
    vsnprintf(text, sizeof text, format, arguments);
    if (message.empty())
        message = text;
    if (errno == ENOMEM) // otherwise no memory would look like damage
        fmt_image_fail(ENOMEM, "", "");
}

// Where the samples of a texel are: samples of one handle, or the first of one handle each.
struct Plane {
    TIFF *tiff = nullptr;
    std::vector<uint8_t> row, tile, band; // as stored; `band`: the rows of a row of tiles
    std::vector<char> wide;               // the row, in samples of 1, 2 or 4 bytes
};

class TiffReader : public ImageReader
{
  public:
    void open(const std::string &plugin, struct fmt_rows_info &info) override;
    void read_row(char *row) override;

  private:
    void read_kind();
    uint32_t find_alpha() const;
    uint64_t decoder_bytes() const;
    void read_tiles(Plane &plane, uint16_t sample);
    const uint8_t *stored_row(Plane &plane, uint16_t sample);
    const char *widen(Plane &plane, const uint8_t *from, size_t count) const;
    template <class T> void write_row(const char *const *from, T *out) const;
    void read_converted(char *row);

    std::vector<Plane> planes;
    std::vector<uint32_t> raster; // rows that libtiff has converted
    uint32_t width = 0, height = 0, next = 0 /* row */;
    uint32_t tile_width = 0, band_rows = 0; // 0: strips
    uint16_t bits = 1, format = SAMPLEFORMAT_UINT, samples = 1, photometric = 0, colors = 1;
    uint32_t alpha = 0;                    // sample; 0: none
    uint32_t channels = 1, wide_bytes = 1; // of rows that are given
    bool apart = false, converted = false;
};

[[noreturn]] void fail(const char *what)
{
    fmt_image_fail(errno, what, message);
}

[[noreturn]] void refuse(const char *reason)
{
    fmt_image_fail(0, "not a readable image", reason);
}

// Returns the product of sizes that a file names.
size_t product(size_t a, size_t b)
{
    size_t bytes;
    if (__builtin_mul_overflow(a, b, &bytes))
        fmt_image_fail(ENOMEM, "", "");
    return bytes;
}

TIFF *open_file(const char *mode = "rm") // m: it is not mapped
{
    errno = 0;
    TIFF *tiff = TIFFOpen(fmt_image_file, mode);
    if (!tiff)
        fail("not a readable image");
    return tiff;
}

// Finds out how texels are stored.
void TiffReader::read_kind()
{
    TIFF *tiff = planes[0].tiff;
    uint32_t depth = 1;
    uint16_t config = PLANARCONFIG_CONTIG, compression = COMPRESSION_NONE;
    TIFFGetField(tiff, TIFFTAG_IMAGEWIDTH, &width);
    TIFFGetField(tiff, TIFFTAG_IMAGELENGTH, &height);
    TIFFGetFieldDefaulted(tiff, TIFFTAG_IMAGEDEPTH, &depth);
    TIFFGetFieldDefaulted(tiff, TIFFTAG_BITSPERSAMPLE, &bits);
    TIFFGetFieldDefaulted(tiff, TIFFTAG_SAMPLEFORMAT, &format);
    TIFFGetFieldDefaulted(tiff, TIFFTAG_SAMPLESPERPIXEL, &samples);
    TIFFGetFieldDefaulted(tiff, TIFFTAG_PLANARCONFIG, &config);
    TIFFGetFieldDefaulted(tiff, TIFFTAG_COMPRESSION, &compression);
    if (!TIFFGetField(tiff, TIFFTAG_PHOTOMETRIC, &photometric))
        photometric = samples < 3 ? PHOTOMETRIC_MINISBLACK : PHOTOMETRIC_RGB;
    if (width < 1 || height < 1 || depth > 1)
        refuse("it is not two-dimensional");
    if (TIFFIsTiled(tiff)) {
        TIFFGetField(tiff, TIFFTAG_TILEWIDTH, &tile_width);
        TIFFGetField(tiff, TIFFTAG_TILELENGTH, &band_rows);
        if (tile_width < 1 || band_rows < 1)
            refuse("its tiles are empty");
    }
    if (photometric == PHOTOMETRIC_YCBCR && compression == COMPRESSION_JPEG && samples == 3 &&
        config == PLANARCONFIG_CONTIG) {
        TIFFSetField(tiff, TIFFTAG_JPEGCOLORMODE, JPEGCOLORMODE_RGB);
        photometric = PHOTOMETRIC_RGB;
    }
    apart = config == PLANARCONFIG_SEPARATE;
    colors = photometric == PHOTOMETRIC_RGB ? 3 : photometric == PHOTOMETRIC_SEPARATED ? 4 : 1;
    converted = photometric > PHOTOMETRIC_RGB && photometric != PHOTOMETRIC_SEPARATED;
}

// Returns the sample with the alpha, or 0. Without a list, the last of 2 or 4 samples is one.
uint32_t TiffReader::find_alpha() const
{
    uint16_t count = 0, *kinds = nullptr;
    if (!TIFFGetField(planes[0].tiff, TIFFTAG_EXTRASAMPLES, &count, &kinds) || count == 0)
        return samples == colors + 1 ? colors : 0;
    for (uint32_t i = 0; i < count && colors + i < samples; i++)
        if (kinds[i] == EXTRASAMPLE_ASSOCALPHA || kinds[i] == EXTRASAMPLE_UNASSALPHA)
            return colors + i;
    return 0;
}

// Returns the memory of libtiff: the longest compressed strip or tile, and what it decodes at once.
uint64_t TiffReader::decoder_bytes() const
{
    TIFF *tiff = planes[0].tiff;
    uint16_t compression = COMPRESSION_NONE;
    uint32_t strip_rows = 1,
             count = tile_width ? TIFFNumberOfTiles(tiff) : TIFFNumberOfStrips(tiff);
    uint64_t stored = 0;
    TIFFGetFieldDefaulted(tiff, TIFFTAG_COMPRESSION, &compression);
    TIFFGetFieldDefaulted(tiff, TIFFTAG_ROWSPERSTRIP, &strip_rows);
    for (uint32_t i = 0; i < count; i++)
        stored = std::max(stored, TIFFGetStrileByteCount(tiff, i));
    const uint16_t by_rows[] = {COMPRESSION_NONE,          COMPRESSION_LZW,
                                COMPRESSION_ADOBE_DEFLATE, COMPRESSION_DEFLATE,
                                COMPRESSION_PACKBITS,      COMPRESSION_JPEG};
    const bool single =
        !converted && std::count(std::begin(by_rows), std::end(by_rows), compression);
    const uint64_t rows = tile_width ? band_rows : single ? 1 : std::min(strip_rows, height);
    const uint64_t row = tile_width ? TIFFTileRowSize64(tiff) * ((width - 1) / tile_width + 1)
                                    : TIFFScanlineSize64(tiff);
    return planes.size() * (stored + 2 * rows * row) + (converted ? 4 * rows * width : 0);
}

void TiffReader::open(const std::string &, struct fmt_rows_info &info)
{
    TIFFSetErrorHandler(keep_message);
    TIFFSetWarningHandler(nullptr);
    planes.resize(1);
    planes[0].tiff = open_file();
    read_kind();
    char why[1024];
    if (converted) {
        if (tile_width >
            0) // libtiff 4.5 converts tiles that are not compressed from mapped files only
            planes[0].tiff = open_file("r");
        TIFFSetField(planes[0].tiff, TIFFTAG_ORIENTATION, ORIENTATION_TOPLEFT);
        if (!TIFFRGBAImageOK(planes[0].tiff, why))
            refuse(why);
        channels = 3;
    } else {
        const bool integers = format == SAMPLEFORMAT_UINT || format == SAMPLEFORMAT_VOID;
        if (bits == 64)
            refuse("it has samples of 64 bits");
        if (format == SAMPLEFORMAT_INT) // whether -1 or 0 is black differs between programs
            refuse("its samples are signed: store them as unsigned integers or as floats");
        if (!(integers && (bits <= 16 || bits == 32)) &&
            !(format == SAMPLEFORMAT_IEEEFP && (bits == 16 || bits == 32)))
            refuse("its samples are neither integers nor floats of a usual size");
        if (samples < colors)
            refuse("it has too few samples");
        wide_bytes = bits > 16 || !integers ? 4 : bits > 8 ? 2 : 1;
        alpha = find_alpha();
        channels = (colors == 1 ? 1 : 3) + (alpha > 0);
        if (apart)
            planes.resize(size_t(colors) + (alpha > 0));
        for (size_t i = 1; i < planes.size(); i++)
            planes[i].tiff = open_file();
    }
    info.width = width;
    info.height = height;
    info.channels = channels;
    info.sample_bytes = wide_bytes;
    info.alpha = alpha > 0 ? int32_t(channels) - 1 : -1;
    info.bytes = decoder_bytes();
}

// Reads the row of tiles that begins with the next row.
void TiffReader::read_tiles(Plane &plane, uint16_t sample)
{
    const size_t tile_row = size_t(TIFFTileRowSize64(plane.tiff));
    const size_t across = (width - 1) / tile_width + 1;
    const size_t part = product(band_rows, tile_row);
    plane.tile.resize(std::max(size_t(TIFFTileSize64(plane.tiff)), part));
    plane.band.resize(product(across, part));
    for (size_t i = 0; i < across; i++) {
        if (TIFFReadTile(plane.tiff, plane.tile.data(), uint32_t(i * tile_width), next, 0, sample) <
            0)
            fail("damaged image");
        for (size_t y = 0; y < band_rows; y++)
            std::memcpy(&plane.band[(y * across + i) * tile_row], &plane.tile[y * tile_row],
                        tile_row);
    }
}

// Returns the next row as it is stored.
const uint8_t *TiffReader::stored_row(Plane &plane, uint16_t sample)
{
    if (tile_width == 0) {
        plane.row.resize(std::max(plane.row.size(), size_t(TIFFScanlineSize64(plane.tiff))));
        if (TIFFReadScanline(plane.tiff, plane.row.data(), next, sample) < 0)
            fail("damaged image");
        return plane.row.data();
    }
    if (next % band_rows == 0)
        read_tiles(plane, sample);
    return &plane.band[next % band_rows * (plane.band.size() / band_rows)];
}

// Makes samples of 1, 2 or 4 bytes of `count` samples of any bits. Returns them.
const char *TiffReader::widen(Plane &plane, const uint8_t *from, size_t count) const
{
    if (bits == 8 * wide_bytes && (bits < 32 || format == SAMPLEFORMAT_IEEEFP))
        return reinterpret_cast<const char *>(from);
    plane.wide.resize(count * wide_bytes);
    char *out = plane.wide.data();
    for (size_t i = 0; i < count; i++, out += wide_bytes) {
        uint64_t value = 0;
        if (bits >= 16)
            std::memcpy(&value, from + i * (bits / 8), bits / 8);
        else
            for (size_t bit = i * bits; bit < (i + 1) * bits; bit++)
                value = value << 1 | (from[bit / 8] >> (7 - bit % 8) & 1);
        const double share = double(value) / double((UINT64_C(1) << bits) - 1);
        const float number = format == SAMPLEFORMAT_IEEEFP
                                 ? imath_half_to_float(imath_half_bits_t(value))
                                 : float(share);
        const uint8_t byte = uint8_t(share * UINT8_MAX + 0.5);
        const uint16_t word = uint16_t(share * UINT16_MAX + 0.5);
        if (wide_bytes == 4)
            std::memcpy(out, &number, 4);
        else if (wide_bytes == 2)
            std::memcpy(out, &word, 2);
        else
            std::memcpy(out, &byte, 1);
    }
    return plane.wide.data();
}

// Returns the light that two inks let through.
template <class T> T mix(T ink, T black)
{
    const double most =
        std::numeric_limits<T>::is_integer ? double(std::numeric_limits<T>::max()) : 1;
    const double light = (most - double(ink)) * (most - double(black)) / most;
    return T(std::numeric_limits<T>::is_integer ? light + 0.5 : light);
}

// from: the wide row of each handle.
template <class T> void TiffReader::write_row(const char *const *from, T *out) const
{
    const uint32_t step = apart ? 1 : samples, shown = colors == 4 ? 3 : colors;
    const auto samples_of = [&](uint32_t color) {
        return reinterpret_cast<const T *>(from[apart ? color : 0]) + (apart ? 0 : color);
    };
    for (uint32_t c = 0; c < channels; c++) {
        const bool is_alpha = c == shown;
        const T *in = is_alpha && apart ? samples_of(colors) : samples_of(is_alpha ? alpha : c);
        const T *black = samples_of(colors - 1); // of CMYK
        for (size_t x = 0; x < width; x++) {
            T value = in[x * step];
            if (colors == 4 && !is_alpha)
                value = mix(value, black[x * step]);
            else if (photometric == PHOTOMETRIC_MINISWHITE && !is_alpha)
                value = mix(value, T(0));
            out[x * channels + c] = value;
        }
    }
}

// Reads a row that libtiff converts to RGB: `raster` has rows from the bottom.
void TiffReader::read_converted(char *row)
{
    TIFF *tiff = planes[0].tiff;
    uint32_t rows = band_rows, good = 1;
    if (tile_width == 0)
        TIFFGetFieldDefaulted(tiff, TIFFTAG_ROWSPERSTRIP, &rows);
    rows = std::max(std::min(rows, height), 1u);
    const uint32_t across = tile_width ? (width - 1) / tile_width + 1 : 1;
    const size_t part_width = tile_width ? tile_width : width;
    const size_t part = part_width * (tile_width ? band_rows : rows), line = next % rows;
    if (line == 0)
        raster.resize(product(part, across));
    for (uint32_t i = 0; line == 0 && good && i < across; i++)
        good = uint32_t(tile_width
                            ? TIFFReadRGBATileExt(tiff, i * tile_width, next, &raster[i * part], 1)
                            : TIFFReadRGBAStripExt(tiff, next, raster.data(), 1));
    if (!good)
        fail("damaged image");
    const uint32_t filled =
        tile_width ? band_rows : std::min(rows, height - (next - uint32_t(line)));
    for (size_t x = 0; x < width; x++) {
        const uint32_t texel =
            raster[x / part_width * part + (filled - 1 - line) * part_width + x % part_width];
        *row++ = char(TIFFGetR(texel));
        *row++ = char(TIFFGetG(texel));
        *row++ = char(TIFFGetB(texel));
    }
}

void TiffReader::read_row(char *row)
{
    errno = 0;
    message.clear();
    if (converted) {
        read_converted(row);
    } else {
        const size_t count = size_t(width) * (apart ? 1 : samples);
        const char *from[5] = {};
        void *out = row;
        for (size_t i = 0; i < planes.size(); i++) {
            const uint32_t sample = !apart ? 0 : i < colors ? uint32_t(i) : alpha;
            planes[i].row.resize((count * bits + 7) / 8);
            from[i] = widen(planes[i], stored_row(planes[i], uint16_t(sample)), count);
        }
        if (wide_bytes == 1)
            write_row(from, static_cast<uint8_t *>(out));
        else if (wide_bytes == 2)
            write_row(from, static_cast<uint16_t *>(out));
        else
            write_row(from, static_cast<float *>(out));
    }
    next++;
}

} // namespace

int main(int argument_count, char **arguments)
{
    TiffReader reader;
    return fmt_image_program(argument_count, arguments, reader);
}
