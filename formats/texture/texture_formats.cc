// texture_formats.cc - recognises images by their content and tells the memory that decoding takes.
//
// Headers are read here, as some plug-ins decode the whole image when they open a file. The factors
// were measured with OpenImageIO 2.4.7 (docs/decisions/0031).
#include "formats/texture/texture_formats.h"

#include "formats/exr_header.h"
#include "formats/texture/jpeg_check.h"

#include <algorithm>
#include <cstring>

namespace fmt
{

namespace
{

uint32_t big16(const uint8_t *p)
{
    return uint32_t(p[0]) << 8 | p[1];
}

uint32_t big32(const uint8_t *p)
{
    return big16(p) << 16 | big16(p + 2);
}

uint32_t little16(const uint8_t *p)
{
    return uint32_t(p[1]) << 8 | p[0];
}

uint32_t little24(const uint8_t *p)
{
    return uint32_t(p[2]) << 16 | little16(p);
}

uint32_t little32(const uint8_t *p)
{
    return little16(p + 2) << 16 | little16(p);
}

// Reads `size` bytes; zeros follow after the end of the file and after a failure, which the
// decoder will meet again.
void read_at(const Probe &probe, uint64_t offset, uint8_t *to, uint64_t size)
{
    uint64_t got = 0;
    std::memset(to, 0, size);
    probe.read(offset, to, size, &got);
}

template <size_t size> bool begins(const Probe &probe, const char (&magic)[size])
{
    return std::memcmp(probe.head, magic, size - 1) == 0;
}

uint64_t product(uint64_t a, uint64_t b, uint64_t c)
{
    uint64_t ab, abc;
    if (__builtin_mul_overflow(a, b, &ab) || __builtin_mul_overflow(ab, c, &abc))
        return UINT64_MAX;
    return abc;
}

Whole by_texels(uint64_t width, uint64_t height, uint64_t texel_bytes)
{
    return {width, height, product(width, height, texel_bytes)};
}

// ---- PNG ----

bool is_png(const Probe &probe)
{
    return begins(probe, "\x89PNG\r\n\x1a\n");
}

// Returns whether a PNG file begins with a header (ISO/IEC 15948, 11.2.2) of sizes that libpng
// takes. Otherwise libpng refuses the file, so its numbers mean nothing.
bool has_png_header(const uint8_t *h)
{
    static const char chunk[] = "\0\0\0\x0dIHDR";
    return std::memcmp(h + 8, chunk, 8) == 0 && big32(h + 16) <= INT32_MAX &&
           big32(h + 20) <= INT32_MAX && h[26] == 0 && h[27] == 0 && h[28] <= 1;
}

// Interlaced images are held whole, with an alpha channel if a palette or a colour gives one.
Whole png_whole(const Probe &probe)
{
    const uint8_t *h = probe.head;
    if (!has_png_header(h))
        return {0, 0, 0};
    bool is_grey = h[25] == 0 || h[25] == 4;
    uint64_t texel = (is_grey ? 2U : 4U) * (h[24] == 16 ? 2U : 1U);
    return by_texels(big32(h + 16), big32(h + 20), h[28] ? texel : 0);
}

// ---- JPEG ----

bool is_jpeg(const Probe &probe)
{
    return begins(probe, "\xff\xd8\xff");
}

// The frame of a JPEG file (ITU-T T.81, B.2.2).
struct JpegFrame {
    bool found, progressive;
    unsigned components;
    Whole coefficients; // of two bytes each
};

JpegFrame read_frame(const Probe &probe, uint64_t offset, int marker)
{
    uint8_t frame[8 + 3 * 4];
    read_at(probe, offset, frame, sizeof frame);
    JpegFrame out = {true,
                     marker == 0xc2 || marker == 0xc6 || marker == 0xca || marker == 0xce,
                     std::min<unsigned>(frame[7], 4),
                     {big16(frame + 5), big16(frame + 3), 0}};
    unsigned most_h = 1, most_v = 1;
    for (unsigned i = 0; i < out.components; i++) {
        most_h = std::max<unsigned>(most_h, frame[8 + 3 * i + 1] >> 4);
        most_v = std::max<unsigned>(most_v, frame[8 + 3 * i + 1] & 15);
    }
    uint64_t across = (out.coefficients.width + 8 * most_h - 1) / (8 * most_h);
    uint64_t down = (out.coefficients.height + 8 * most_v - 1) / (8 * most_v);
    for (unsigned i = 0; i < out.components; i++)
        out.coefficients.bytes +=
            128 * across * (frame[8 + 3 * i + 1] >> 4) * down * (frame[8 + 3 * i + 1] & 15);
    return out;
}

// libjpeg holds the coefficients of the whole image if a file is progressive or has a scan for each
// component.
Whole jpeg_whole(const Probe &probe)
{
    JpegFrame frame = {false, false, 0, {0, 0, 0}};
    uint64_t offset = 2;
    while (offset + 4 <= probe.size()) {
        uint8_t segment[5];
        read_at(probe, offset, segment, sizeof segment);
        int marker = segment[1];
        if (segment[0] != 0xff)
            break;
        if (marker == 0xff) { // a fill byte
            offset++;
            continue;
        }
        bool is_frame =
            marker >= 0xc0 && marker <= 0xcf && marker != 0xc4 && marker != 0xc8 && marker != 0xcc;
        if (is_frame && !frame.found)
            frame = read_frame(probe, offset + 2, marker);
        if (marker == 0xda) // the first scan
            return frame.progressive || segment[4] < frame.components ? frame.coefficients
                                                                      : Whole{0, 0, 0};
        offset += 2 + uint64_t(big16(segment + 2));
    }
    return {0, 0, 0};
}

int read_jpeg(void *arg, uint64_t offset, void *to, uint64_t size, uint64_t *got)
{
    return static_cast<const Probe *>(arg)->read(offset, to, size, got);
}

int check_interruption(void *arg)
{
    const auto *probe = static_cast<const Probe *>(arg);
    return probe->host->check(probe->ctx);
}

int jpeg_check(const Probe &probe, std::string &reason)
{
    const struct fmt_jpeg_source source = {read_jpeg, check_interruption,
                                           const_cast<Probe *>(&probe)};
    char message[FMT_JPEG_MESSAGE];
    const int failure = fmt_jpeg_check(&source, message);
    reason = message;
    return failure;
}

// ---- JPEG 2000 ----

bool is_jpeg2000(const Probe &probe)
{
    static const char box[] = "\0\0\0\x0cjP  \r\n\x87\n";
    return std::memcmp(probe.head, box, sizeof box - 1) == 0 || begins(probe, "\xff\x4f\xff\x51");
}

// Returns where the code stream begins (ISO/IEC 15444-1, Annex I), or the end of the file.
uint64_t find_codestream(const Probe &probe)
{
    uint64_t offset = probe.head[0] == 0xff ? 0 : 12;
    while (offset > 0 && offset < probe.size()) {
        uint8_t box[16];
        read_at(probe, offset, box, sizeof box);
        uint64_t size = big32(box), header = size == 1 ? 16 : 8;
        if (std::memcmp(box + 4, "jp2c", 4) == 0)
            return offset + header;
        if (size == 1)
            size = uint64_t(big32(box + 8)) << 32 | big32(box + 12);
        if (size < header || size > probe.size() - offset)
            return probe.size();
        offset += size;
    }
    return offset;
}

// OpenJPEG decodes all samples to 4 bytes.
Whole jpeg2000_whole(const Probe &probe)
{
    uint8_t size[42];
    read_at(probe, find_codestream(probe), size, sizeof size);
    if (std::memcmp(size, "\xff\x4f\xff\x51", 4) != 0) // OpenJPEG refuses the file
        return {0, 0, 0};
    uint64_t width = big32(size + 8), height = big32(size + 12);
    width -= std::min<uint64_t>(width, big32(size + 16));
    height -= std::min<uint64_t>(height, big32(size + 20));
    return by_texels(width, height, 5 * uint64_t(big16(size + 40)));
}

// ---- other formats ----

bool is_tiff(const Probe &probe)
{
    return begins(probe, "II*\0") || begins(probe, "MM\0*") || begins(probe, "II+\0") ||
           begins(probe, "MM\0+");
}

bool is_exr(const Probe &probe)
{
    return begins(probe, "\x76\x2f\x31\x01");
}

uint64_t read_exr_header(void *arg, uint64_t offset, void *to, uint64_t size)
{
    const Probe &probe = *static_cast<const Probe *>(arg);
    uint64_t got = 0;
    probe.read(offset, to, size, &got);
    return got;
}

const char *exr_excess(const Probe &probe)
{
    return fmt_exr_header_excess(read_exr_header, const_cast<Probe *>(&probe));
}

bool is_bmp(const Probe &probe)
{
    return begins(probe, "BM");
}

Whole bmp_whole(const Probe &probe)
{
    const uint8_t *h = probe.head;
    bool packed = little32(h + 14) >= 40 && (little32(h + 30) == 1 || little32(h + 30) == 2);
    uint64_t height = little32(h + 22);
    if (height > INT32_MAX) // the rows are stored from the top
        height = (uint64_t(1) << 32) - height;
    return by_texels(little32(h + 18), height, packed ? 4 : 0);
}

bool is_hdr(const Probe &probe)
{
    return begins(probe, "#?RADIANCE") || begins(probe, "#?RGBE");
}

bool is_pnm(const Probe &probe)
{
    const uint8_t *h = probe.head;
    bool kind = (h[1] >= '1' && h[1] <= '6') || h[1] == 'F' || h[1] == 'f';
    return h[0] == 'P' && kind && (h[2] == ' ' || (h[2] >= '\t' && h[2] <= '\r') || h[2] == '#');
}

Whole pnm_whole(const Probe &probe)
{
    return {0, 0, probe.size()};
}

bool is_webp(const Probe &probe)
{
    return begins(probe, "RIFF") && std::memcmp(probe.head + 8, "WEBP", 4) == 0;
}

Whole webp_whole(const Probe &probe)
{
    const uint8_t *h = probe.head;
    uint64_t width = little16(h + 26) & 0x3fff, height = little16(h + 28) & 0x3fff;
    if (std::memcmp(h + 12, "VP8X", 4) == 0) {
        width = uint64_t(little24(h + 24)) + 1;
        height = uint64_t(little24(h + 27)) + 1;
    } else if (std::memcmp(h + 12, "VP8L", 4) == 0) {
        width = (little32(h + 21) & 0x3fff) + 1;
        height = (little32(h + 21) >> 14 & 0x3fff) + 1;
    }
    return {width, height, product(width, height, 4) + probe.size()};
}

// Only version 2 has a mark, at the file's end. The header of version 1 has few values that are
// possible.
bool is_targa(const Probe &probe)
{
    static const char mark[] = "TRUEVISION-XFILE.";
    const uint8_t *h = probe.head;
    uint8_t end[sizeof mark] = {0};
    if (probe.size() >= 44)
        read_at(probe, probe.size() - sizeof mark, end, sizeof end);
    bool type = (h[2] >= 1 && h[2] <= 3) || (h[2] >= 9 && h[2] <= 11);
    bool bits = h[16] == 8 || h[16] == 15 || h[16] == 16 || h[16] == 24 || h[16] == 32;
    bool possible = h[1] <= 1 && type && bits && little16(h + 12) > 0 && little16(h + 14) > 0;
    return possible && (std::memcmp(end, mark, sizeof mark) == 0 || !(h[17] & 0xc0));
}

Whole targa_whole(const Probe &probe)
{
    return by_texels(little16(probe.head + 12), little16(probe.head + 14), 4);
}

// The last row matches loosely.
const ImageKind kinds[] = {
    {"png", "PNG", is_png, png_whole, nullptr, nullptr},
    {"jpeg", "JPEG", is_jpeg, jpeg_whole, nullptr, jpeg_check},
    {"tiff", "TIFF", is_tiff, nullptr, nullptr, nullptr},
    {"openexr", "OpenEXR", is_exr, nullptr, exr_excess, nullptr},
    {"jpeg2000", "JPEG 2000", is_jpeg2000, jpeg2000_whole, nullptr, nullptr},
    {"webp", "WebP", is_webp, webp_whole, nullptr, nullptr},
    {"bmp", "BMP", is_bmp, bmp_whole, nullptr, nullptr},
    {"hdr", "Radiance HDR", is_hdr, nullptr, nullptr, nullptr},
    {"pnm", "PNM", is_pnm, pnm_whole, nullptr, nullptr},
    {"targa", "TGA", is_targa, targa_whole, nullptr, nullptr},
};

} // namespace

const char image_kinds_text[] =
    "PNG, JPEG, TIFF, OpenEXR, JPEG 2000, WebP, BMP, Radiance HDR, PNM or TGA";

int Probe::read(uint64_t offset, void *to, uint64_t size, uint64_t *got) const
{
    uint64_t count = 1;
    *got = 0;
    if (part) {
        size = std::min(size, part->size - std::min(part->size, offset));
        const int failure = size > 0 ? host->part_read(ctx, file, part, to, size, offset) : 0;
        *got = failure ? 0 : size;
        return failure;
    }
    while (*got < size && count > 0) {
        const int failure = host->file_read_some(ctx, file, static_cast<uint8_t *>(to) + *got,
                                                 size - *got, offset + *got, &count);
        if (failure)
            return failure;
        *got += count;
    }
    return 0;
}

const ImageKind *find_image_kind(const Probe &probe)
{
    for (const ImageKind &kind : kinds)
        if (kind.recognise(probe))
            return &kind;
    return nullptr;
}

const ImageKind *tiff_kind()
{
    return std::find_if(std::begin(kinds), std::end(kinds),
                        [](const ImageKind &kind) { return kind.recognise == is_tiff; });
}

// Returns the rows that a compressor of OpenEXR takes together.
static uint64_t exr_rows(const std::string &compression)
{
    if (compression == "dwab")
        return 256;
    if (compression == "piz" || compression == "b44" || compression == "b44a" ||
        compression == "dwaa")
        return 32;
    return 16;
}

// Some compressors of TIFF decode whole strips.
static uint64_t tiff_rows(const OIIO::ImageSpec &spec, const std::string &compression)
{
    bool streams = compression == "none" || compression == "lzw" || compression == "zip" ||
                   compression == "packbits";
    return streams ? 1 : uint64_t(std::max(spec.get_int_attribute("tiff:RowsPerStrip"), 1));
}

uint64_t chunk_bytes(const ImageKind &kind, const OIIO::ImageSpec &spec)
{
    std::string compression = spec.get_string_attribute("compression");
    uint64_t texel = std::max<uint64_t>(spec.pixel_bytes(true), spec.pixel_bytes());
    uint64_t width = uint64_t(spec.width), rows = 1;
    if (spec.tile_width > 0) {
        width = uint64_t(spec.tile_width);
        rows = uint64_t(spec.tile_height);
    } else if (kind.recognise == is_exr) {
        rows = std::min(exr_rows(compression), uint64_t(spec.height));
    } else if (kind.recognise == is_tiff) {
        rows = std::min(tiff_rows(spec, compression), uint64_t(spec.height));
    }
    return product(width, rows, 2 * texel);
}

} // namespace fmt
