// texture_formats.h - the image formats that textures may have, and the memory that reading takes.
//
// OpenImageIO opens many more files, among them videos, streams from the network and plain text. A
// file's first bytes choose a row of the table; no other plug-in ever sees it.
#ifndef FMT_TEXTURE_TEXTURE_FORMATS_H
#define FMT_TEXTURE_TEXTURE_FORMATS_H

#include <OpenImageIO/imageio.h>

#include <string>

#include "formats/module/module.h"

namespace fmt
{

// An image in an open file, and its first bytes; zeros follow after a short image.
struct Probe {
    const struct fmt_host *host;
    struct bsq_ctx *ctx;
    const struct bsq_file *file;
    const struct bsq_part *part; // the part of the file that is the image; NULL: all of it
    uint8_t head[64];

    uint64_t size() const
    {
        return part ? part->size : file->size;
    }

    // Reads up to `size` bytes from byte `offset` of the image on; *got is their number, which is
    // lower at the end of the image only.
    int read(uint64_t offset, void *to, uint64_t size, uint64_t *got) const;
};

// An image that is decoded whole: its size in texels (0: unknown), and the bytes that this takes.
// 0 bytes: the file is read by rows or tiles.
struct Whole {
    uint64_t width, height, bytes;
};

struct ImageKind {
    const char *plugin; // OpenImageIO's name
    const char *name;   // for messages
    bool (*recognise)(const Probe &probe);
    Whole (*whole)(const Probe &probe); // from the file's header; NULL: always by rows or tiles
    const char *(*excess)(
        const Probe &probe); // what is too much in the header, or NULL; may be NULL
    // Finds damage that the plug-in does not tell of, in memory like that of decoding. Returns a
    // failure that was reported, or 0; `reason` is then empty if the image is whole. May be NULL.
    int (*check)(const Probe &probe, std::string &reason);
};

// All formats, for messages.
extern const char image_kinds_text[];

// Returns the format of a file, or NULL if it is none of the table.
const ImageKind *find_image_kind(const Probe &probe);

// Returns the row of TIFF, the format of temporary copies.
const ImageKind *tiff_kind();

// Returns the bytes of a tile, or of the rows that the format stores together, while they are
// decoded.
uint64_t chunk_bytes(const ImageKind &kind, const OIIO::ImageSpec &spec);

} // namespace fmt

#endif
