// damage_images.cc - damages images at random, gives each to the code of the program that reads it,
// in a process of its own, and counts how these end. OpenImageIO or libtiff may crash: then the
// reader says so. What is wrong here is an end without rows or words, or outside of the limits.
//
// usage: damage-images SEED COUNT IMAGE...
#include <cstdint>
#include <map>
#include <random>

#include <fcntl.h>
#include <poll.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/wait.h>

#define main texture_main
#include "formats/texture/oiio_rows.cc"
#undef main
#define main tiff_main
#include "formats/texture/tiff_rows.cc"
#undef main

namespace
{

using Bytes = std::vector<uint8_t>;

// Returns OpenImageIO's name of the format of a file.
std::string plugin_of(const std::string &path)
{
    static const std::map<std::string, std::string> names = {
        {"tif", "tiff"}, {"exr", "openexr"}, {"jp2", "jpeg2000"}, {"webp", "webp"}, {"bmp", "bmp"},
        {"hdr", "hdr"},  {"ppm", "pnm"},     {"pfm", "pnm"},      {"tga", "targa"}};
    return names.at(path.substr(path.rfind('.') + 1));
}

Bytes read_file(const char *path)
{
    Bytes bytes(1 << 20);
    FILE *file = fopen(path, "rb");
    bytes.resize(file ? fread(bytes.data(), 1, bytes.size(), file) : 0);
    if (file)
        fclose(file);
    return bytes;
}

// Changes bytes at random: few, or numbers that sizes might have, or cuts the file off.
void damage(Bytes &bytes, std::mt19937_64 &random)
{
    static const uint8_t odd[] = {0, 1, 0x7f, 0x80, 0xff};
    const size_t first = random() % 2 ? bytes.size() : std::min<size_t>(bytes.size(), 160);
    for (uint64_t i = random() % 8 + 1; i > 0; i--) {
        uint8_t &byte = bytes[random() % first];
        byte = random() % 2 ? odd[random() % sizeof odd] : uint8_t(random());
    }
    if (random() % 8 == 0)
        bytes.resize(random() % bytes.size() + 1);
}

// Returns what is wrong with the output of a process that ended with a code, or nothing.
std::string complaint(int code, const Bytes &out)
{
    struct fmt_rows_info info;
    if (code == -BSQ_EDATA || code == -BSQ_ENOINPUT)
        return out.empty() ? "no words" : "";
    if (code == -BSQ_ENOMEM)
        return "";
    if (code != 0 || out.size() < sizeof info)
        return "exit code " + std::to_string(code);
    std::memcpy(&info, out.data(), sizeof info);
    const uint64_t row = uint64_t(info.width) * info.channels * info.sample_bytes;
    return out.size() == sizeof info + info.height * row ? "" : "rows are missing";
}

// Runs the program's code on a file. Returns how it ended; *wrong says what must not be.
std::string run_one(const Bytes &bytes, const std::string &plugin, std::string *wrong)
{
    enum { MOST = 1 << 24 };
    char own[] = "bisque-texture", memory[] = "268435456", seconds[] = "10";
    const int file = memfd_create("image", 0), kept = memfd_create("rows", 0);
    if (write(file, bytes.data(), bytes.size()) != ssize_t(bytes.size()))
        std::abort();
    const pid_t process = fork();
    if (process == 0) {
        const struct rlimit most = {MOST, MOST};
        char *arguments[] = {own,
                             const_cast<char *>(fmt_program_stamp),
                             const_cast<char *>(plugin.c_str()),
                             memory,
                             seconds,
                             nullptr};
        dup2(file, STDIN_FILENO);
        dup2(kept, STDOUT_FILENO);
        dup2(open("/dev/null", O_RDWR), STDERR_FILENO);
        signal(SIGXFSZ, SIG_IGN); // an image that is large, not wrong
        setrlimit(RLIMIT_FSIZE, &most);
        _exit((plugin == "tiff" ? tiff_main : texture_main)(5, arguments));
    }
    int state;
    waitpid(process, &state, 0);
    Bytes out(size_t(lseek(kept, 0, SEEK_END)));
    if (pread(kept, out.data(), out.size(), 0) != ssize_t(out.size()))
        std::abort();
    close(file);
    close(kept);
    if (WIFSIGNALED(state))
        return strsignal(WTERMSIG(state));
    if (out.size() < MOST)
        *wrong = complaint(WEXITSTATUS(state), out);
    return "exit code " + std::to_string(WEXITSTATUS(state));
}

} // namespace

int main(int argument_count, char **arguments)
{
    const uint64_t count = argument_count > 3 ? strtoull(arguments[2], nullptr, 10) : 0;
    std::mt19937_64 random(argument_count > 3 ? strtoull(arguments[1], nullptr, 10) : 0);
    std::map<std::string, uint64_t> ends;
    uint64_t bad = 0;
    for (uint64_t i = 0; i < count; i++) {
        const char *path = arguments[3 + i % uint64_t(argument_count - 3)];
        Bytes bytes = read_file(path);
        if (bytes.empty()) {
            std::printf("not ok - %s cannot be read\n", path);
            return 1;
        }
        std::string wrong;
        if (i >= uint64_t(argument_count - 3)) // each is read without damage first
            damage(bytes, random);
        const std::string end = run_one(bytes, plugin_of(path), &wrong);
        ends[plugin_of(path) + ": " + end]++;
        bad += !wrong.empty();
        const char *keep = std::getenv("KEEP");
        if (!wrong.empty() || (keep && end.rfind("exit", 0) != 0)) {
            std::printf("%s %s, number %llu: %s %s\n", wrong.empty() ? "#" : "not ok -", path,
                        (unsigned long long)i, end.c_str(), wrong.c_str());
            FILE *file =
                keep ? fopen((std::string(keep) + "/" + std::to_string(i) + "." + plugin_of(path))
                                 .c_str(),
                             "wb")
                     : nullptr;
            if (file) {
                fwrite(bytes.data(), 1, bytes.size(), file);
                fclose(file);
            }
        }
    }
    for (const auto &end : ends)
        std::printf("%8llu %s\n", (unsigned long long)end.second, end.first.c_str());
    return bad > 0 || count == 0;
}
