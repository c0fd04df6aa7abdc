/* exr_header.c - the limits that the header of an EXR file must keep.
 *
 * OpenEXR sorts channels and attributes, which for a small file with very many takes minutes, and
 * allocates what the header holds outside of the budget. So this walks over the header first, whose
 * layout is described at https://openexr.com/en/latest/OpenEXRFileLayout.html. */
#include <string.h>

#include "base/bytes.h"
#include "formats/image/exr_internal.h"

/* Renderers write up to some hundred channels and attributes, and previews of 100 KiB. */
enum { MOST_ATTRIBUTES = 4096, MOST_CHANNELS = 16384, MOST_BYTES = 1 << 20 };
enum { NAME_BYTES = 256, CHANNEL_BYTES = 16, MULTI_PART = 1 << 12 };

struct walk {
    struct bsq_ctx *ctx;
    const struct bsq_file *file;
    int status; /* of a failed read, or 0 */
    uint64_t at;
    uint32_t attributes, channels;
    const char *excess; /* what is too much; NULL: nothing */
};

/* Reads up to `size` bytes. Returns their number. */
static uint64_t exr_head_read(struct walk *walk, uint64_t offset, void *to, uint64_t size)
{
    uint64_t got = 0;
    const int status = bsq_file_read_some(walk->ctx, walk->file, to, size, offset, &got);
    walk->status = walk->status < 0 ? walk->status : status;
    return status < 0 ? 0 : got;
}

/* Reads a name and moves behind the null byte at its end. Returns false if there is none. */
static bool exr_head_name(struct walk *walk, char name[NAME_BYTES])
{
    const uint64_t got = exr_head_read(walk, walk->at, name, NAME_BYTES);
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
    while (exr_head_name(walk, name) && name[0]) {
        walk->at += CHANNEL_BYTES;
        if (++walk->channels > MOST_CHANNELS) {
            walk->excess = "the header has more than 16384 channels";
            return false;
        }
    }
    if (walk->at != end)
        walk->excess = "the header's list of channels has a wrong length";
    return walk->at == end;
}

/* Walks over an attribute after its name. Returns false if the walk ends. */
static bool pass_attribute(struct walk *walk)
{
    char type[NAME_BYTES];
    unsigned char size[4];
    if (!exr_head_name(walk, type) || exr_head_read(walk, walk->at, size, 4) < 4)
        return false;
    const uint64_t end = walk->at + 4 + bsq_little(size, 4);
    walk->at += 4;
    if (++walk->attributes > MOST_ATTRIBUTES)
        walk->excess = "the header has more than 4096 attributes";
    else if (end > MOST_BYTES)
        walk->excess = "the header has more than 1 MiB";
    else if (strcmp(type, "chlist") == 0)
        return pass_channels(walk, end);
    walk->at = end;
    return !walk->excess;
}

int fmt_exr_check_header(struct bsq_ctx *ctx, const char *path, const struct bsq_file *file)
{
    struct walk walk = {.ctx = ctx, .file = file, .at = 8};
    unsigned char version[4] = {0};
    char name[NAME_BYTES];
    bool empty = true;
    const bool found = exr_head_read(&walk, 4, version, 4) == 4;
    const bool parts = bsq_little(version, 4) & MULTI_PART;
    while (found && exr_head_name(&walk, name)) {
        if (!name[0] && (!parts || empty))
            break;
        if (name[0] && !pass_attribute(&walk))
            break;
        empty = !name[0];
    }
    if (walk.status < 0 || !walk.excess)
        return walk.status;
    return bsq_fail(ctx, BSQ_EDATA, "%s: %s", path, walk.excess);
}
