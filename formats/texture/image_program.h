// image_program.h - what the programs that decode images share: bisque-tiff and bisque-texture.
//
// program_rows.c runs them: damaged files make the libraries crash, loop, or take any amount of
// memory. So they have limits of memory and time. The file is their standard input; their standard
// output becomes struct fmt_rows_info and the rows.
#ifndef FMT_TEXTURE_IMAGE_PROGRAM_H
#define FMT_TEXTURE_IMAGE_PROGRAM_H

#include <string>

#include "formats/texture/image_rows.h"

// An image that is read from the top.
class ImageReader
{
  public:
    virtual ~ImageReader() = default;
    virtual void open(const std::string &plugin, struct fmt_rows_info &info) = 0;
    virtual void read_row(char *row) = 0;
};

// The file, for libraries that open it by a name.
inline const char fmt_image_file[] = "/proc/self/fd/0";

// Throws what is wrong. error: an errno; some are not faults of the image.
[[noreturn]] void fmt_image_fail(int error, const std::string &what, std::string reason);

// The main function of a program, whose option is OpenImageIO's name of the format.
int fmt_image_program(int argument_count, char **arguments, ImageReader &reader);

#endif
