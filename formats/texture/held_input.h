// held_input.h - reads one image file that must stay what it was when it was first opened.
#ifndef FMT_TEXTURE_HELD_INPUT_H
#define FMT_TEXTURE_HELD_INPUT_H

#include <OpenImageIO/imageio.h>

#include <atomic>
#include <memory>
#include <string>
#include <vector>

#include "formats/texture/texture_formats.h"

namespace fmt
{

// What all openings of an image share. It must not move, as openings refer to it.
struct HeldImage {
    const struct fmt_host *host = nullptr;
    struct bsq_ctx *ctx = nullptr;
    std::string path;                       // of a file, or the name of a part (base/file_part.h)
    struct bsq_file part = BSQ_FILE_CLOSED; // copy of the part
    bool alpha = false;    // give the alpha channel alone, or the first if there is none
    int first_channel = 0; // that is read, of those that a HeldInput gives
    int temporary = -1;    // descriptor of a tiled copy, which has no name: `path` is for messages
    const ImageKind *kind = nullptr; // set by probe()
    Whole whole = {0, 0, 0};         // set by probe()
    bool described = false;
    OIIO::ImageSpec shape;      // what the first opening found
    std::atomic<int> status{0}; // first failure that was reported to the context
    std::atomic<int> error{0};  // errno of the first failed read; OpenImageIO's callers lose it

    ~HeldImage()
    {
        if (part.fd >= 0)
            host->file_close(ctx, &part);
    }

    // Finds out the format and what decoding takes, without decoding. Errors: those of
    // bsq_file_open(); BSQ_EDATA.
    int probe();

    // Looks for damage that decoding would not tell of. Returns as ImageKind's check().
    int check(std::string &reason);

  private:
    int probe_range(const std::string &name, const struct bsq_part *range);
    int recognise(Probe found);
};

// Makes OpenImageIO's message fit for one of ours: one line that names the image instead of the
// descriptor that it is read from, and is never empty.
std::string one_line(std::string reason, const std::string &path);

// An opened image, of whose channels it gives the first three, or one, or alpha. OpenImageIO reads
// the file through a descriptor, never by its name, and one format's plug-in alone sees it. open()
// fails if the file or its layout is not that of the first opening, so that buffers of that layout
// hold every row and tile. Reading backwards opens the file again: plug-ins would do so by
// themselves, without any check. Tiles are read one by one, because plug-ins would start threads
// for several.
class HeldInput final : public OIIO::ImageInput
{
  public:
    explicit HeldInput(HeldImage *image = nullptr);
    ~HeldInput() override;

    // Opens the image. Returns 0 or a status that was reported to the context.
    int open_image();

    // For an ImageCache: `config` has the address of a HeldImage under this name.
    static constexpr const char *attribute = "bisque:image";
    static OIIO::ImageInput *create()
    {
        return new HeldInput;
    }

    const char *format_name() const override
    {
        return "bisque";
    }
    bool open(const std::string &name, OIIO::ImageSpec &spec) override;
    bool open(const std::string &name, OIIO::ImageSpec &spec,
              const OIIO::ImageSpec &config) override;
    bool close() override;
    bool read_native_scanline(int subimage, int miplevel, int y, int z, void *data) override;
    bool read_native_scanlines(int subimage, int miplevel, int ybegin, int yend, int z,
                               void *data) override;
    bool read_native_tile(int subimage, int miplevel, int x, int y, int z, void *data) override;

  private:
    int open_inner();
    void drop_channels();
    void keep(const void *from, void *to, size_t texels) const;
    int check_shape();
    int fail_open(int error, const std::string &message);
    bool go_to(int ybegin, int yend);
    bool pass_on(bool good);

    HeldImage *image;
    struct bsq_file file = BSQ_FILE_CLOSED;
    std::unique_ptr<OIIO::ImageInput> inner;
    int next_row = 0;
    size_t inner_texel = 0, texel = 0; // bytes; equal if all channels are given
    size_t first_byte = 0;             // of the first channel that is given, in a texel
    std::vector<char> scratch;
};

} // namespace fmt

#endif
