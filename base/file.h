/* file.h - input files, temporary files and read-only maps.
 *
 * Every function handles EINTR and short transfers, and describes failures with the path. */
#ifndef BSQ_FILE_H
#define BSQ_FILE_H

#include <time.h>

#include "base/context.h"

#ifdef __cplusplus
extern "C" {
#endif

/* What tells that a file is still the same and was not written to. */
struct bsq_identity {
    uint64_t device, inode, size;
    struct timespec modified, changed; /* the last write; the last change of content or inode */
};

/* Writes inode, size and times as a text that machines of one file server agree on. A later file
 * with this text has the same content: the system changes the last of the times with every write,
 * and no program can set it. Only two writes within a few seconds may leave it the same. */
enum { BSQ_IDENTITY_BYTES = 112 };
void bsq_identity_text(const struct bsq_identity *identity, char text[BSQ_IDENTITY_BYTES]);

struct bsq_file {
    int fd;                       /* -1 when closed */
    uint64_t size;                /* input: size when opened; temporary: bytes appended so far */
    char *path;                   /* for messages; owned */
    struct bsq_identity identity; /* input: when opened */
};
/* clang-format off */
#define BSQ_FILE_CLOSED {-1, 0, NULL, {0, 0, 0, {0, 0}, {0, 0}}}
/* clang-format on */

/* Returns a descriptor of 3 or more for the open file `fd`, and closes `fd` if it is less. In a
 * program whose standard streams are closed, a new file gets a number from 0 to 2, and what any
 * code prints would go into it. Returns -1 and sets errno if `fd` is -1 or there is no other
 * descriptor. */
int bsq_fd_above_standard(int fd);

/* Returns the path that `path` leads to if it is a symbolic link, also if there is no such file.
 * Free it with free(). Returns NULL and sets errno if links form a loop or there is no memory. */
char *bsq_follow_links(const char *path);

/* Returns the part of a path after its last slash. */
const char *bsq_file_name(const char *path);

/* How bsq_file_open_as() opens a file. */
enum bsq_open {
    BSQ_OPEN_INPUT, /* an input of the job, see base/job_files.h */
    BSQ_OPEN_OTHER  /* a file that the job may also write, such as its note */
};

/* Opens a regular file for reading. Never waits: pipes, sockets and devices are refused. An input
 * that the job has opened before must be the same file, unchanged. Errors: BSQ_ENOINPUT; BSQ_EIO if
 * the file was changed since; BSQ_EUSAGE if the job writes this file. */
int bsq_file_open_as(struct bsq_ctx *ctx, const char *path, enum bsq_open how,
                     struct bsq_file *out);

/* Opens an input: bsq_file_open_as() with BSQ_OPEN_INPUT. */
int bsq_file_open(struct bsq_ctx *ctx, const char *path, struct bsq_file *out);

/* Returns BSQ_EIO if an input was written to since it was opened. Call it after the last read.
 * Temporary files pass. */
int bsq_file_check(struct bsq_ctx *ctx, const struct bsq_file *file);

/* Creates an unnamed temporary file, which is gone when it is closed or the process ends. It lies
 * in the context's tmpdir or, if there is none, in the directory of `beside` (an output path; NULL:
 * the first output that was noted, or "."). `what` is for messages. */
int bsq_file_temp(struct bsq_ctx *ctx, const char *beside, const char *what, struct bsq_file *out);

/* Opens a second descriptor of the same file. Errors: BSQ_ENOINPUT. */
int bsq_file_duplicate(struct bsq_ctx *ctx, const struct bsq_file *file, struct bsq_file *out);

/* Closes and frees; a closed file is allowed. */
void bsq_file_close(struct bsq_ctx *ctx, struct bsq_file *file);

/* Waits until a pipe has bytes or has ended, and reads up to `size` of them; *got is 0 at the end.
 * A FIFO that nobody has opened for writing yet has neither. `path` is for messages. Errors:
 * BSQ_EIO, BSQ_EINTR. */
int bsq_pipe_read(struct bsq_ctx *ctx, int fd, const char *path, void *buffer, uint64_t size,
                  uint64_t *got);

/* Tells the system that part of an open file is read soon. Nothing happens if it cannot be read
 * ahead. */
void bsq_file_read_ahead(const struct bsq_file *file, uint64_t size, uint64_t offset);

/* Reads exactly `size` bytes at `offset`. If the file ends before, this is BSQ_EDATA ("truncated"),
 * or what bsq_file_check() returns for an input that shrank. */
int bsq_file_read(struct bsq_ctx *ctx, const struct bsq_file *file, void *buffer, uint64_t size,
                  uint64_t offset);

/* Reads up to `size` bytes at `offset`; *got < size only at the end of the file. */
int bsq_file_read_some(struct bsq_ctx *ctx, const struct bsq_file *file, void *buffer,
                       uint64_t size, uint64_t offset, uint64_t *got);

/* Writes all of `size` bytes at `offset`. Errors: BSQ_EIO. Does not change file->size. */
int bsq_file_write(struct bsq_ctx *ctx, const struct bsq_file *file, const void *buffer,
                   uint64_t size, uint64_t offset);

/* Writes at file->size and advances it. Not thread-safe for one file. */
int bsq_file_append(struct bsq_ctx *ctx, struct bsq_file *file, const void *buffer, uint64_t size);

/* Returns the bytes written to temporary files of this context so far, for reports. */
uint64_t bsq_temp_bytes(const struct bsq_ctx *ctx);

/* Checks that the file system for temporary files has `bytes` free. Errors: BSQ_EIO, which names
 * the bytes needed and available. */
int bsq_require_disk(struct bsq_ctx *ctx, const char *beside, uint64_t bytes);

/* Checks that the disk has space for an output of about `output_bytes` at path `output` and for
 * temporary files of about `temp_bytes`. If both lie on one file system, it needs their sum.
 * Errors: BSQ_EIO, which names the bytes needed and free. */
int bsq_require_space(struct bsq_ctx *ctx, const char *output, uint64_t output_bytes,
                      uint64_t temp_bytes);

/* Checks that the process may open `count` more outputs together with the files that are open now
 * (RLIMIT_NOFILE). `output` is the path for the message. Errors: BSQ_ECANTCREAT, which names these
 * numbers. */
int bsq_require_descriptors(struct bsq_ctx *ctx, const char *output, uint64_t count);

/* A whole file mapped read-only, 4096-byte aligned.
 *
 * If the file shrinks while it is mapped, or the disk fails, the lost memory reads as zeros instead
 * of ending the process, and bsq_map_check() reports it. For that, the process has a handler of
 * SIGBUS while any map is open; it passes signals that are not about a map to the previous handler.
 * A program that installs another handler meanwhile must do the same. Threads that read a map must
 * not block SIGBUS. */
struct bsq_map {
    const void *data;
    uint64_t size;
    char *path; /* owned */
    int fd;
    struct timespec modified; /* when it was opened */
    struct bsq_map_range *range;
};
#define BSQ_MAP_CLOSED                                                                             \
    {                                                                                              \
        .fd = -1                                                                                   \
    }
/* Maps a file. An empty file has data NULL and size 0. Errors: BSQ_ENOINPUT. */
int bsq_map_open(struct bsq_ctx *ctx, const char *path, struct bsq_map *out);
/* Maps an open file and takes it over: closes it on failure. */
int bsq_map_file(struct bsq_ctx *ctx, struct bsq_file *file, struct bsq_map *out);
/* Returns BSQ_EIO if the data cannot be relied on: the file shrank, was written to, or could not be
 * read. Call it now and then, and before results are used. Thread-safe. */
int bsq_map_check(struct bsq_ctx *ctx, const struct bsq_map *map);
/* Returns the cause of a status: the error of bsq_map_check() if that fails, since changed data can
 * make a job fail in other ways; else `status`. Forgets the failure that it replaces, so no other
 * thread may use the context. Interruptions stay what they are. */
int bsq_map_explain(struct bsq_ctx *ctx, const struct bsq_map *map, int status);
/* Unmaps and closes; a closed map, or one of all zeros, is allowed. */
void bsq_map_close(struct bsq_ctx *ctx, struct bsq_map *map);

#ifdef __cplusplus
}
#endif
#endif
