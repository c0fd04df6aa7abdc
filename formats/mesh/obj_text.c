/* obj_text.c - cuts a file into blocks of whole lines without reading it in sequence.
 *
 * Block i holds the lines that begin in the i-th range of OBJ_BLOCK_BYTES. The few bytes before a
 * position tell whether a line begins there, so any thread can load any block on its own: from a
 * little before its range to the first line start after it. A line longer than a range belongs to
 * the block where it begins; the blocks within it are empty. */
#include <string.h>

#include "formats/mesh/obj_internal.h"

/* Bytes before a position that decide whether a line begins there: backslash, "\r", "\n". */
enum { look_back = 3 };
/* Bytes first read after the range; more are read if its last line is longer. */
enum { look_ahead = 4096 };

/* A part of the file in memory: text[0] is byte `offset` of the file. */
struct window {
    const char *text;
    uint64_t offset, end, file_size;
};

static bool is_at(const struct window *window, uint64_t position, char c)
{
    return position >= window->offset && position < window->end &&
           window->text[position - window->offset] == c;
}

/* Returns true if a line starts at `position`; the byte before it is '\n' or '\r'. A line end after
 * a backslash continues the line. Inside a comment it does not, but the file need not be cut there.
 */
static bool starts_line(const struct window *window, uint64_t position)
{
    uint64_t last = position - 1;
    if (is_at(window, last, '\n'))
        return !(last >= 1 && is_at(window, last - 1, '\\')) &&
               !(last >= 2 && is_at(window, last - 1, '\r') && is_at(window, last - 2, '\\'));
    return !is_at(window, position, '\n') && !(last >= 1 && is_at(window, last - 1, '\\'));
}

/* Returns the first line start at or after `from` (> 0); the end of the file counts as one. Returns
 * UINT64_MAX if the window ends before the file does. */
static uint64_t find_line_start(const struct window *window, uint64_t from)
{
    for (uint64_t at = from - 1; at < window->end; at++) {
        char c = window->text[at - window->offset];
        if (c == '\0') /* not a text file: the parser says so, and need not see more of it */
            return at + 1;
        if (c != '\n' && c != '\r')
            continue;
        if (c == '\r' && at + 1 == window->end && window->end < window->file_size)
            break; /* whether "\n" follows is not known yet */
        if (starts_line(window, at + 1))
            return at + 1;
    }
    return window->end == window->file_size ? window->file_size : UINT64_MAX;
}

static uint64_t smaller(uint64_t a, uint64_t b)
{
    return a < b ? a : b;
}

/* Extends the window to `end`, or to the end of the file. */
static int load_until(struct bsq_ctx *ctx, struct fmt_input *input, struct obj_block *block,
                      struct window *window, uint64_t end)
{
    uint64_t have = window->end - window->offset;
    /* Memory first: who cannot hold so much need not have it unpacked. */
    end = smaller(end, fmt_input_size(input));
    int status = fmt_obj_block_reserve_text(ctx, block, end - window->offset);
    if (!status)
        status = fmt_input_reach(input, end, &window->file_size);
    if (status)
        return status;
    end = smaller(end, window->file_size);
    status = fmt_input_read(input, block->buffer + have, end - window->end, window->end);
    window->text = block->buffer;
    window->end = end;
    return status;
}

int fmt_obj_text_load(struct bsq_ctx *ctx, struct fmt_input *input, uint64_t index,
                      struct obj_block *block, uint64_t *offset)
{
    uint64_t first = index * OBJ_BLOCK_BYTES, range_end = first + OBJ_BLOCK_BYTES;
    struct window window = {.offset = first ? first - look_back : 0};
    window.end = window.offset;
    int status = load_until(ctx, input, block, &window, range_end + look_ahead);
    if (status)
        return status;
    range_end = smaller(range_end, window.file_size);
    uint64_t start = first ? find_line_start(&window, first) : 0;
    uint64_t end;
    if (start < range_end) {
        while ((end = find_line_start(&window, range_end)) == UINT64_MAX) {
            uint64_t have = window.end - window.offset;
            if ((status = bsq_check(ctx)) ||
                (status = load_until(ctx, input, block, &window, window.end + have)))
                return status;
        }
    } else {
        start = end = range_end;
    }
    *offset = start;
    fmt_obj_block_set_text(block, start - window.offset, end - window.offset);
    return 0;
}
