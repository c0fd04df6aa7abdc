// image_program.cc - the frame of the programs that decode images.
#include "formats/texture/image_program.h"

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <new>
#include <stdexcept>
#include <vector>

#include <sys/resource.h>
#include <unistd.h>

namespace
{

// What is wrong: with the image, or with the system.
struct Failure {
    int code; // a status of Bisque
    std::string text;
};

void put(const void *from, size_t size)
{
    if (fwrite(from, size, 1, stdout) != 1)
        throw Failure{BSQ_EIO, ""};
}

// Lets decoding take a second more for each million of texels.
void add_time(uint64_t texels)
{
    struct rlimit time;
    getrlimit(RLIMIT_CPU, &time);
    time.rlim_cur += texels / 1000000;
    time.rlim_max = std::max(time.rlim_max, time.rlim_cur + 1);
    setrlimit(RLIMIT_CPU, &time);
}

void convert(ImageReader &reader, const char *plugin)
{
    struct fmt_rows_info info = {};
    reader.open(plugin, info);
    add_time(uint64_t(info.width) * info.height);
    put(&info, sizeof info);
    std::vector<char> row(size_t(info.width) * info.channels * info.sample_bytes);
    for (uint32_t y = 0; y < info.height; y++) {
        reader.read_row(row.data());
        put(row.data(), row.size());
    }
}

} // namespace

[[noreturn]] void fmt_image_fail(int error, const std::string &what, std::string reason)
{
    if (error == ENOMEM)
        _exit(-BSQ_ENOMEM);
    if (error == EMFILE || error == ENFILE || error == EIO) // not a fault of the image
        throw Failure{BSQ_ENOINPUT, std::strerror(error)};
    for (size_t at; (at = reason.find(fmt_image_file)) != std::string::npos;)
        reason.replace(at, sizeof fmt_image_file - 1, "the file");
    if (reason.empty())
        reason = "its decoder gives no reason, the file may be cut off";
    throw Failure{BSQ_EDATA, what + ": " + reason};
}

// Ends without destructors, which may crash for damaged images.
int fmt_image_program(int argument_count, char **arguments, ImageReader &reader)
{
    enum { FILES = 8 };                      // libraries open the standard input again
    const uint64_t own = uint64_t(64) << 20; // of memory that decoders take for themselves
    fmt_program_input input;
    const char *plugin = fmt_program_begin(argument_count, arguments, own, FILES, &input);
    std::set_new_handler([] { _exit(-BSQ_ENOMEM); });
    try {
        convert(reader, plugin);
    } catch (const Failure &failure) {
        fmt_program_refuse(failure.code, failure.text.c_str());
    } catch (const std::exception &exception) {
        fmt_program_refuse(BSQ_EDATA, (std::string("damaged image: ") + exception.what()).c_str());
    }
    _exit(fflush(stdout) == 0 && !ferror(stdout) ? 0 : -BSQ_EIO);
}
