/* input.h - the public header of this folder: the bytes of an input file that may be packed, or a
 * pipe.
 *
 * Takes the path of a regular file, of a FIFO, or "-" for standard input; gives ranges of bytes. A
 * file that gzip or Zstandard packed gives its unpacked bytes; its first bytes tell, not its name.
 *
 * A packed file, or a pipe, is unpacked into a temporary file without a name, by the threads that
 * want its bytes and only as far as they want them. So a small file that unpacks to a huge one
 * takes no more disk than its reader wants. Of a packed file the last 128 MiB are kept; who goes
 * back farther has it unpacked again. */
#ifndef FMT_INPUT_INPUT_H
#define FMT_INPUT_INPUT_H

#include "base/file.h"

struct fmt_input;

/* Looks at a file. `path` is copied. `beside`: an output path, whose directory takes temporary
 * files (NULL: "."). pipes: a FIFO or "-" is allowed; else they are refused as every other file
 * that is not regular. A pipe is read from the first fmt_input_peek() or fmt_input_open() on, and
 * only once. Errors: BSQ_ENOINPUT, BSQ_EIO, BSQ_ENOMEM. */
int fmt_input_create(struct bsq_ctx *ctx, const char *path, const char *beside, bool pipes,
                     struct fmt_input **out);
/* Makes an input of a callback, which must live as long. `name` is copied, for messages. */
int fmt_input_create_source(struct bsq_ctx *ctx, const char *name, const struct bsq_source *source,
                            struct fmt_input **out);
/* Frees the input; NULL is allowed. */
void fmt_input_free(struct fmt_input *input);

/* Returns the path as given, for messages. */
const char *fmt_input_path(const struct fmt_input *input);
/* Returns the path that names of other files in the input are relative to: its own; for a pipe "",
 * which means the current directory. */
const char *fmt_input_beside(const struct fmt_input *input);
/* Returns the bytes of the file, unpacked; UINT64_MAX as long as this is not known. */
uint64_t fmt_input_size(const struct fmt_input *input);

/* Reads the first `size` bytes without opening the input; *got < size only if there are no more. Do
 * not call it while the input is open. Errors: as fmt_input_read(). */
int fmt_input_peek(struct fmt_input *input, void *buffer, uint64_t size, uint64_t *got);

/* Opens the input for reading. Calls nest; each needs a fmt_input_close(). Thread-safe, as all
 * functions below. Errors: BSQ_ENOINPUT; BSQ_EIO if the file was changed since it was first opened.
 */
int fmt_input_open(struct fmt_input *input);
/* Closes the input. After the last close, unpacked bytes of a file are dropped, and made again when
 * it is opened again; those of a pipe are kept. Returns BSQ_EIO if the file was changed meanwhile.
 */
int fmt_input_close(struct fmt_input *input);

/* Unpacks until `end` bytes are there, or all if there are fewer. *size: as fmt_input_size() after
 * that; if it is UINT64_MAX, there are at least `end` bytes. Errors: as fmt_input_read(). */
int fmt_input_reach(struct fmt_input *input, uint64_t end, uint64_t *size);

/* Reads exactly `size` bytes at `offset`. Errors: BSQ_EDATA if there are fewer, and for damaged or
 * truncated packed files, with the byte of the packed file; BSQ_EIO, also if the disk has too
 * little space for unpacked bytes; BSQ_ENOMEM; BSQ_EINTR. */
int fmt_input_read(struct fmt_input *input, void *buffer, uint64_t size, uint64_t offset);
/* Reads up to `size` bytes at `offset`; *got < size only at the end. Errors: as fmt_input_read().
 */
int fmt_input_read_some(struct fmt_input *input, void *buffer, uint64_t size, uint64_t offset,
                        uint64_t *got);

/* Gives an open file with all bytes, for readers that jump about. The caller closes *out, and keeps
 * the input open until then. Errors: as fmt_input_read(); BSQ_EDATA for what a callback gives. */
int fmt_input_whole(struct fmt_input *input, struct bsq_file *out);
/* Returns true for a plain file: bytes of it can be named by their place in the file. */
bool fmt_input_is_plain(const struct fmt_input *input);

/* What is looked at of a packed file, or a pipe. */
#define FMT_INPUT_SAMPLE_BYTES ((uint64_t)1 << 20)

/* Reads a small file of text whole, with `padding` zeros after its end. The caller frees *text with
 * bsq_free(). Errors: as fmt_input_read(), and BSQ_ENOINPUT. */
int fmt_input_text(struct bsq_ctx *ctx, const char *path, uint64_t padding, char **text,
                   uint64_t *size);

/* Returns true if fmt_input_create() would take `path` for a pipe. */
bool fmt_input_is_pipe(const char *path);

#endif
