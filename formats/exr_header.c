/* exr_header.c - walks over the header of an OpenEXR file, whose layout is described at
 * https://openexr.com/en/latest/OpenEXRFileLayout.html. */
#include "formats/exr_header.h"

#include <stdbool.h>
#include <string.h>

/* Renderers write up to some hundred channels and attributes, and previews of 100 KiB. */
enum { MOST_ATTRIBUTES = 4096, MOST_CHANNELS = 16384, MOST_BYTES = 1 << 20 };
enum { NAME_BYTES = 256, CHANNEL_BYTES = 16, MULTI_PART = 1 << 12 };

struct walk {
    struct bsq_ctx *ctx;
    const struct bsq_file *file;
    int status; /* of a failed read, or 0 */
    uint64_t at;
    uint32_t attributes, channels;
    bool compressed; /* the compression is known */
    struct fmt_exr_header *out;
};

static uint32_t little32(const unsigned char *p)
{
    return p[0] | (uint32_t)p[1] << 8 | (uint32_t)p[2] << 16 | (uint32_t)p[3] << 24;
}

/* Reads up to `size` bytes. Returns their number. */
static uint64_t read_at(struct walk *walk, uint64_t offset, void *to, uint64_t size)
{
    uint64_t got = 0;
    const int status = bsq_file_read_some(walk->ctx, walk->file, to, size, offset, &got);
    walk->status = walk->status < 0 ? walk->status : status;
    return status < 0 ? 0 : got;
}

/* Reads a name and moves behind the null byte at its end. Returns false if there is none. */
static bool read_name(struct walk *walk, char name[NAME_BYTES])
{
    const uint64_t got = read_at(walk, walk->at, name, NAME_BYTES);
    const char *end = memchr(name, '\0', got);
    if (end)
        walk->at += (uint64_t)(end - name) + 1;
    return end != NULL;
}

/* Walks over a list of channels. Its length must be right, because some readers go by the names
 * alone. */
static bool pass_channels(struct walk *walk, uint64_t end)
{
    char name[NAME_BYTES];
    while (read_name(walk, name) && name[0]) {
        walk->at += CHANNEL_BYTES;
        if (++walk->channels > MOST_CHANNELS) {
            walk->out->excess = "the header has more than 16384 channels";
            return false;
        }
    }
    if (walk->at != end)
        walk->out->excess = "the header's list of channels has a wrong length";
    return walk->at == end;
}

/* Walks over an attribute after its name. Returns false if the walk ends. */
static bool pass_attribute(struct walk *walk)
{
    char type[NAME_BYTES];
    unsigned char size[4];
    if (!read_name(walk, type) || read_at(walk, walk->at, size, 4) < 4)
        return false;
    const uint64_t end = walk->at + 4 + little32(size);
    walk->at += 4;
    if (++walk->attributes > MOST_ATTRIBUTES)
        walk->out->excess = "the header has more than 4096 attributes";
    else if (end > MOST_BYTES)
        walk->out->excess = "the header has more than 1 MiB";
    else if (strcmp(type, "chlist") == 0)
        return pass_channels(walk, end);
    else if (strcmp(type, "compression") == 0 && !walk->compressed)
        walk->compressed = read_at(walk, walk->at, &walk->out->compression, 1) == 1;
    walk->at = end;
    return !walk->out->excess;
}

/* A file has one header, or one for each part and an empty one at the end. */
int fmt_exr_header_read(struct bsq_ctx *ctx, const struct bsq_file *file,
                        struct fmt_exr_header *out)
{
    struct walk walk = {.ctx = ctx, .file = file, .at = 8, .out = out};
    unsigned char version[4] = {0};
    char name[NAME_BYTES];
    bool empty = true;
    *out = (struct fmt_exr_header){0};
    const bool found = read_at(&walk, 4, version, 4) == 4;
    const bool parts = little32(version) & MULTI_PART;
    while (found && read_name(&walk, name)) {
        if (!name[0] && (!parts || empty))
            break;
        if (name[0] && !pass_attribute(&walk))
            break;
        empty = !name[0];
    }
    return walk.status;
}
