// tiff_rows.cc - the program bisque-tiff, which reads TIFF files by libtiff.
//
// Grey and RGB images of 8 and 16 bits and floats are read as they are stored. libtiff converts
// all other kinds of up to 8 bits, such as palettes and CMYK, to RGB, a strip or a row of tiles at
// a time.
#include <half.h>
#include <tiffio.h>

#include <algorithm>
#include <cerrno>
#include <cstdarg>
#include <cstdio>
#include <cstring>
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

class TiffReader : public ImageReader
{
  public:
    void open(const std::string &plugin, struct fmt_rows_info &info) override;
    void read_row(char *row) override;

  private:
    void read_kind();
    uint32_t find_alpha() const;
    void read_tiles();
    const uint8_t *stored_row();
    void read_stored(char *row);
    void read_converted(char *row);

    TIFF *tiff = nullptr;
    std::vector<uint8_t> row_bytes, tile, band; // as stored; `band`: the rows of a row of tiles
    std::vector<uint32_t> raster;               // rows that libtiff has converted
    uint32_t width = 0, height = 0, next = 0 /* row */;
    uint32_t tile_width = 0, band_rows = 0; // 0: strips
    uint16_t bits = 1, format = SAMPLEFORMAT_UINT, samples = 1, photometric = 0, colors = 1;
    uint32_t alpha = 0; // sample; 0: none
    uint32_t channels = 1;
    bool converted = false;
};

[[noreturn]] void fail(const char *what)
{
    fmt_image_fail(errno, what, message);
}

[[noreturn]] void refuse(const char *reason)
{
    fmt_image_fail(0, FMT_ROWS_UNREADABLE, reason);
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
        fail(FMT_ROWS_UNREADABLE);
    return tiff;
}

// Finds out how texels are stored, and whether libtiff has to convert them.
void TiffReader::read_kind()
{
    uint32_t depth = 1;
    uint16_t config = PLANARCONFIG_CONTIG;
    TIFFGetField(tiff, TIFFTAG_IMAGEWIDTH, &width);
    TIFFGetField(tiff, TIFFTAG_IMAGELENGTH, &height);
    TIFFGetFieldDefaulted(tiff, TIFFTAG_IMAGEDEPTH, &depth);
    TIFFGetFieldDefaulted(tiff, TIFFTAG_BITSPERSAMPLE, &bits);
    TIFFGetFieldDefaulted(tiff, TIFFTAG_SAMPLEFORMAT, &format);
    TIFFGetFieldDefaulted(tiff, TIFFTAG_SAMPLESPERPIXEL, &samples);
    TIFFGetFieldDefaulted(tiff, TIFFTAG_PLANARCONFIG, &config);
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
    if (format == SAMPLEFORMAT_INT) // whether -1 or 0 is black differs between programs
        refuse("its samples are signed: store them as unsigned integers or as floats");
    const bool integers = format == SAMPLEFORMAT_UINT || format == SAMPLEFORMAT_VOID;
    const bool plain = photometric == PHOTOMETRIC_RGB || photometric == PHOTOMETRIC_MINISBLACK;
    colors = photometric == PHOTOMETRIC_RGB ? 3 : 1;
    if (samples < colors)
        refuse("it has too few samples");
    converted = !plain || config == PLANARCONFIG_SEPARATE || (integers && bits < 8);
    const bool loses_alpha = photometric == PHOTOMETRIC_RGB && samples > 3;
    if (converted ? !integers || bits > 8 || loses_alpha
                  : !(integers && (bits == 8 || bits == 16)) &&
                        !(format == SAMPLEFORMAT_IEEEFP && (bits == 16 || bits == 32)))
        refuse(
            "its samples are of an unusual kind: store RGB or grey in 8 or 16 bits or in floats, "
            "not as planes");
}

// Returns the sample with the alpha, or 0. Without a list, the last of 2 or 4 samples is one.
uint32_t TiffReader::find_alpha() const
{
    uint16_t count = 0, *kinds = nullptr;
    if (!TIFFGetField(tiff, TIFFTAG_EXTRASAMPLES, &count, &kinds) || count == 0)
        return samples == colors + 1 ? colors : 0;
    for (uint32_t i = 0; i < count && colors + i < samples; i++)
        if (kinds[i] == EXTRASAMPLE_ASSOCALPHA || kinds[i] == EXTRASAMPLE_UNASSALPHA)
            return colors + i;
    return 0;
}

void TiffReader::open(const std::string &, struct fmt_rows_info &info)
{
    TIFFSetErrorHandler(keep_message);
    TIFFSetWarningHandler(nullptr);
    tiff = open_file();
    read_kind();
    char why[1024];
    if (converted) {
        if (tile_width > 0) // libtiff 4.5 converts these from mapped files only
            tiff = open_file("r");
        TIFFSetField(tiff, TIFFTAG_ORIENTATION, ORIENTATION_TOPLEFT);
        if (!TIFFRGBAImageOK(tiff, why))
            refuse(why);
        channels = 3;
    } else {
        alpha = find_alpha();
        channels = colors + (alpha > 0);
    }
    info.width = width;
    info.height = height;
    info.channels = channels;
    info.sample_bytes = converted ? 1 : format == SAMPLEFORMAT_IEEEFP ? 4 : bits / 8;
    info.alpha = alpha > 0 ? int32_t(channels) - 1 : -1;
}

// Reads the row of tiles that begins with the next row.
void TiffReader::read_tiles()
{
    const size_t tile_row = size_t(TIFFTileRowSize64(tiff));
    const size_t across = (width - 1) / tile_width + 1;
    const size_t column = product(band_rows, tile_row);
    tile.resize(std::max(size_t(TIFFTileSize64(tiff)), column));
    band.resize(product(across, column));
    for (size_t i = 0; i < across; i++) {
        if (TIFFReadTile(tiff, tile.data(), uint32_t(i * tile_width), next, 0, 0) < 0)
            fail(FMT_ROWS_DAMAGED);
        for (size_t y = 0; y < band_rows; y++)
            std::memcpy(&band[(y * across + i) * tile_row], &tile[y * tile_row], tile_row);
    }
}

// Returns the next row as it is stored.
const uint8_t *TiffReader::stored_row()
{
    if (tile_width == 0) {
        row_bytes.resize(
            std::max(size_t(TIFFScanlineSize64(tiff)), product(size_t(width) * samples, bits / 8)));
        if (TIFFReadScanline(tiff, row_bytes.data(), next, 0) < 0)
            fail(FMT_ROWS_DAMAGED);
        return row_bytes.data();
    }
    if (next % band_rows == 0)
        read_tiles();
    return &band[next % band_rows * (band.size() / band_rows)];
}

// Copies the colours and the alpha of a row. Halves become floats.
void TiffReader::read_stored(char *row)
{
    const size_t bytes = bits / 8;
    const uint8_t *from = stored_row();
    for (size_t x = 0; x < width; x++, from += samples * bytes)
        for (uint32_t c = 0; c < channels; c++) {
            const uint8_t *sample = from + (c < colors ? c : alpha) * bytes;
            if (format == SAMPLEFORMAT_IEEEFP && bits == 16) {
                imath_half_bits_t half;
                std::memcpy(&half, sample, sizeof half);
                const float number = imath_half_to_float(half);
                std::memcpy(row, &number, sizeof number);
                row += sizeof number;
            } else {
                std::memcpy(row, sample, bytes);
                row += bytes;
            }
        }
}

// Reads a row that libtiff converts to RGB: `raster` has rows from the bottom.
void TiffReader::read_converted(char *row)
{
    uint32_t rows = band_rows, good = 1;
    if (tile_width == 0)
        TIFFGetFieldDefaulted(tiff, TIFFTAG_ROWSPERSTRIP, &rows);
    rows = std::max(std::min(rows, height), 1u);
    const uint32_t across = tile_width ? (width - 1) / tile_width + 1 : 1;
    const size_t column_width = tile_width ? tile_width : width;
    const size_t column = column_width * (tile_width ? band_rows : rows), line = next % rows;
    if (line == 0)
        raster.resize(product(column, across));
    for (uint32_t i = 0; line == 0 && good && i < across; i++)
        good = uint32_t(
            tile_width ? TIFFReadRGBATileExt(tiff, i * tile_width, next, &raster[i * column], 1)
                       : TIFFReadRGBAStripExt(tiff, next, raster.data(), 1));
    if (!good)
        fail(FMT_ROWS_DAMAGED);
    const uint32_t filled =
        tile_width ? band_rows : std::min(rows, height - (next - uint32_t(line)));
    for (size_t x = 0; x < width; x++) {
        const uint32_t texel = raster[x / column_width * column +
                                      (filled - 1 - line) * column_width + x % column_width];
        *row++ = char(TIFFGetR(texel));
        *row++ = char(TIFFGetG(texel));
        *row++ = char(TIFFGetB(texel));
    }
}

void TiffReader::read_row(char *row)
{
    errno = 0;
    message.clear();
    if (converted)
        read_converted(row);
    else
        read_stored(row);
    next++;
}

} // namespace

int main(int argument_count, char **arguments)
{
    TiffReader reader;
    return fmt_image_program(argument_count, arguments, reader);
}
