/* file_extent.h - an extent of a file that stands for a file, such as an image in a GLB file.
 *
 * Its name is the file's path with one of these at the end, all numbers in bytes:
 *
 *     #bytes=OFFSET+SIZE          the bytes as they are
 *     #base64=OFFSET,FIRST+SIZE   base64 text from OFFSET on; of its bytes, SIZE from FIRST on
 *
 * So an extent can be named wherever a path can. A file with the whole name takes precedence. */
#ifndef FMT_MATERIAL_FILE_EXTENT_H
#define FMT_MATERIAL_FILE_EXTENT_H

#include "base/file.h"

#ifdef __cplusplus
extern "C" {
#endif

struct fmt_extent {
    uint64_t offset; /* of the bytes, or of the base64 text, in the file */
    uint64_t first;  /* bytes, after decoding, that come before the extent */
    uint64_t size;   /* bytes of the extent, after decoding */
    bool base64;
};

/* Returns the length of the path in the name of an extent, and sets *out. Returns 0 if it is no
 * such name, or if a file has it. */
size_t fmt_extent_parse(const char *name, struct fmt_extent *out);

/* Sets *out to the name of an extent of the file `path`; free it with bsq_free(). */
int fmt_extent_name(struct bsq_ctx *ctx, const char *path, const struct fmt_extent *extent,
                    char **out);

/* Reads `size` bytes of an extent, from its byte number `at` on. Thread-safe. Errors: BSQ_EDATA if
 * the file is too short or is no base64 there; BSQ_EIO. */
int fmt_extent_read(struct bsq_ctx *ctx, const struct bsq_file *file,
                    const struct fmt_extent *extent, void *to, uint64_t size, uint64_t at);

/* Opens the file that `name` names, or the file that it names an extent of. Sets *extent, to the
 * whole file if `name` is no extent. Errors: those of bsq_file_open(). */
int fmt_extent_open(struct bsq_ctx *ctx, const char *name, struct fmt_extent *extent,
                    struct bsq_file *out);

/* Copies an extent of a file to an unnamed temporary file. Errors: those of bsq_file_temp() and
 * fmt_extent_read(). */
int fmt_extent_extract(struct bsq_ctx *ctx, const struct bsq_file *file,
                       const struct fmt_extent *extent, struct bsq_file *out);

#ifdef __cplusplus
}
#endif
#endif
