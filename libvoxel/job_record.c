/* job_record.c - records which inputs and options a chunk file was made from, so that a job can
 * resume from it (docs/decisions/0006).
 *
 * The record is a file of lines beside the chunk file, each of which ends with a null byte, as
 * paths may contain anything else. It exists only while the job is unfinished, and beside a chunk
 * file that was sorted alone. Its lines:
 *
 *     the format, checksum and size of the chunk file, and the checksum of the other lines
 *     the version of the program
 *     "how": a text that says where the next input lies, in the form of the lines below
 *     "obj", "tex" or "mtl", for each input: size, time of modification, hash of samples, path
 *     "ids", if there are any: the same without a file; what the ids tell apart
 *     "cha", for each channel: the same; its name, and "=" and its image if one is given
 *     "how" again: a hash of the rules for paths, if there are any
 *
 * A pipe has the path "-", no time, and a hash of all its bytes as they came. To resume, the lines
 * are made again from the files as they are now, and must be the same. A hash of samples is used
 * because reading whole inputs would take about as long as resuming saves on slow disks. The time
 * of modification reveals edits between samples. */
#include "base/job_files.h"
#include "base/output.h"
#include "base/path_map.h"
#include "formats/input/input.h"
#include "formats/mesh/mesh_reader.h"
#include "libvoxel/job_record.h"

#include <assert.h>
#include <errno.h>
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>
#include <xxhash.h>

/* The second line. */
static const char program[] = "version " BSQ_VERSION;

/* Samples are spread evenly over a file, and overlap in small files. */
enum { SAMPLES = 64, SAMPLE_BYTES = 64 << 10 };
/* Offset of the checksum in a chunk file's header, which covers those of all tables. */
enum { TRIS_CHECKSUM_AT = 144 };
/* Strings are a few bytes and a job may have a budget of only vox_memory_min(), so they are not
 * counted. */
struct vox_job {
    struct bsq_ctx *ctx;
    char *tris_path, *record_path;
    char *lines;  /* all but the first; an empty one follows */
    size_t size;  /* bytes of the lines */
    char **pipes; /* paths of inputs that are pipes, in order */
    uint32_t pipe_count;
};

static int no_memory(struct bsq_ctx *ctx, const char *path)
{
    return bsq_fail_errno(ctx, BSQ_ENOMEM, ENOMEM, "%s", path);
}

/* ---- lines ---- */

/* Returns the next line; after the last line, the empty one. */
static const char *next_line(const char *line)
{
    assert(line);
    return *line ? line + strlen(line) + 1 : line;
}

/* Returns the path in the line of an input, after four fields. */
static const char *path_of(const char *line)
{
    for (int field = 0; field < 4 && line; field++)
        line = strchr(line, ' ') ? strchr(line, ' ') + 1 : NULL;
    return line ? line : "";
}

/* Appends a line to the job and frees it. NULL: there was no memory for it. */
static int add_line(struct vox_job *job, char *line)
{
    size_t bytes = line ? strlen(line) + 1 : 0;
    char *grown = line ? realloc(job->lines, job->size + bytes + 1) : NULL;
    if (grown) {
        memcpy(grown + job->size, line, bytes);
        job->lines = grown;
        job->size += bytes;
        grown[job->size] = '\0';
    }
    free(line);
    return grown ? 0 : no_memory(job->ctx, job->tris_path);
}

static int hash_samples(struct bsq_ctx *ctx, const struct bsq_file *file, uint64_t *hash)
{
    const uint64_t bytes = file->size < SAMPLE_BYTES ? file->size : SAMPLE_BYTES;
    const uint64_t last = file->size - bytes, gaps = SAMPLES - 1;
    uint8_t *sample;
    int status = bsq_alloc(ctx, "sample", SAMPLE_BYTES, 1, &sample);
    for (uint64_t i = 0; status == 0 && i < SAMPLES; i++) {
        status = bsq_file_read(ctx, file, sample, bytes, last / gaps * i + last % gaps * i / gaps);
        if (status == 0)
            *hash = XXH3_64bits_withSeed(sample, bytes, *hash);
    }
    bsq_free(ctx, sample);
    return status;
}

static bool is_readable_file(const char *path)
{
    struct stat info;
    return stat(path, &info) == 0 && S_ISREG(info.st_mode) && access(path, R_OK) == 0;
}

/* Makes the line of an input as it is now, for the caller to free. kind: "obj"; "mtl", which may be
 * absent or no file; "tex", only whose path matters. Only three characters of it are read. */
static int describe(struct bsq_ctx *ctx, const char *kind, const char *path, char **out)
{
    struct bsq_file file;
    struct stat info = {.st_size = -1};
    uint64_t hash = 0;
    *out = NULL;
    if (*kind == 'o' || (*kind == 'm' && is_readable_file(path))) {
        int status = bsq_file_open_as(ctx, path, BSQ_OPEN_OTHER, &file);
        if (status < 0)
            return status;
        status = fstat(file.fd, &info) == 0 ? hash_samples(ctx, &file, &hash)
                                            : bsq_fail_errno(ctx, BSQ_ENOINPUT, errno, "%s", path);
        bsq_file_close(ctx, &file);
        if (status < 0)
            return status;
    }
    char *full = realpath(path, NULL);
    if (!full && errno != ENOMEM)
        full = strdup(path);
    if (full && asprintf(out, "%.3s %" PRId64 " %" PRId64 ".%09ld %016" PRIx64 " %s", kind,
                         (int64_t)info.st_size, (int64_t)info.st_mtim.tv_sec, info.st_mtim.tv_nsec,
                         hash, full) < 0)
        *out = NULL;
    free(full);
    return *out ? 0 : no_memory(ctx, path);
}

/* ---- pipes ---- */

/* Returns whether a line is about a pipe. Only meshes come through pipes; the path of a mesh file
 * is absolute. Other inputs may be missing files, which have the path that was given. */
static bool is_pipe_line(const char *line)
{
    return strncmp(line, "obj ", 4) == 0 && strcmp(path_of(line), "-") == 0;
}

/* Makes the line of a pipe. bytes: -1 as long as they are not known. */
static char *pipe_line(int64_t bytes, uint64_t hash)
{
    char *line = NULL;
    return asprintf(&line, "obj %" PRId64 " 0.000000000 %016" PRIx64 " -", bytes, hash) < 0 ? NULL
                                                                                            : line;
}

static int add_pipe(struct vox_job *job, const char *path)
{
    char **pipes = reallocarray(job->pipes, job->pipe_count + 1, sizeof *pipes);
    char *copy = pipes ? strdup(path) : NULL;
    if (pipes)
        job->pipes = pipes;
    if (!copy)
        return no_memory(job->ctx, path);
    pipes[job->pipe_count++] = copy;
    return add_line(job, pipe_line(-1, 0));
}

/* Makes all lines again, with what came through the pipes. `find` gives it; it returns 1, 0 for
 * "not known" or a negative status. */
static int describe_pipes(struct vox_job *job,
                          int (*find)(void *arg, const char *path, uint64_t *bytes, uint64_t *hash),
                          void *arg)
{
    char *lines = job->lines;
    uint32_t pipe = 0;
    int status = 0;
    if (job->pipe_count == 0)
        return 0;
    job->lines = NULL;
    job->size = 0;
    for (const char *line = lines; *line && status >= 0; line = next_line(line)) {
        uint64_t bytes = 0, hash = 0;
        const bool is_pipe = is_pipe_line(line);
        assert(!is_pipe || pipe < job->pipe_count);
        if (is_pipe)
            status = find(arg, job->pipes[pipe++], &bytes, &hash);
        if (status >= 0)
            status = add_line(job, is_pipe && status > 0 ? pipe_line((int64_t)bytes, hash)
                                                         : strdup(line));
    }
    free(lines);
    return status;
}

static int find_given(void *arg, const char *path, uint64_t *bytes, uint64_t *hash)
{
    return fmt_mesh_given(arg, path, bytes, hash);
}

/* Reads a pipe to its end. */
static int find_by_reading(void *arg, const char *path, uint64_t *bytes, uint64_t *hash)
{
    int status = fmt_input_drain(arg, path, bytes, hash);
    return status < 0 ? status : 1;
}

/* ---- inputs ---- */

static int add_input(struct vox_job *job, const char *kind, const char *path)
{
    char *line;
    int status = describe(job->ctx, kind, path, &line);
    return status < 0 ? status : add_line(job, line);
}

/* Reads a file, or its first `most` bytes, and adds a null byte. *text: for the caller to free with
 * bsq_free(), or NULL if there is no such file. */
static int load(struct bsq_ctx *ctx, const char *path, uint64_t most, char **text, uint64_t *size)
{
    struct bsq_file file;
    *text = NULL;
    *size = 0;
    if (access(path, F_OK) != 0)
        return 0;
    int status = bsq_file_open_as(ctx, path, BSQ_OPEN_OTHER, &file);
    if (status < 0)
        return status;
    uint64_t bytes = file.size < most ? file.size : most;
    status = bsq_calloc(ctx, "job record", bytes + 1, 1, text);
    if (status == 0)
        status = bsq_file_read(ctx, &file, *text, bytes, 0);
    *size = file.size;
    bsq_file_close(ctx, &file);
    return status;
}

/* Makes the first line of a record, for the caller to free. NULL if there is no chunk file. */
static int first_line(struct vox_job *job, const char *others, size_t bytes, char **out)
{
    char *header;
    uint64_t size, checksum;
    int status = load(job->ctx, job->tris_path, TRIS_CHECKSUM_AT + sizeof checksum, &header, &size);
    *out = NULL;
    if (status == 0 && size >= TRIS_CHECKSUM_AT + sizeof checksum) {
        memcpy(&checksum, header + TRIS_CHECKSUM_AT, sizeof checksum);
        if (asprintf(out, "bisque job 2, chunks %016" PRIx64 " %" PRIu64 ", sum %016" PRIx64,
                     checksum, size, (uint64_t)XXH3_64bits(others, bytes)) < 0) {
            *out = NULL;
            status = no_memory(job->ctx, job->tris_path);
        }
    }
    bsq_free(job->ctx, header);
    return status;
}

/* ---- a job ---- */

void vox_job_close(struct vox_job *job)
{
    if (!job)
        return;
    for (uint32_t i = 0; i < job->pipe_count; i++)
        free(job->pipes[i]);
    free(job->pipes);
    free(job->lines);
    free(job->tris_path);
    free(job->record_path);
    free(job);
}

/* Adds a line that says how input number `i` is placed, if it is. */
static int add_placement(struct vox_job *job, const struct vox_sort_options *options, uint32_t i)
{
    char *line = NULL;
    if (!options->placements)
        return 0;
    const struct vox_placement *p = &options->placements[i];
    const char *up = p->up == VOX_UP_Y ? "y" : p->up == VOX_UP_Z ? "z" : "unchanged";
    if (asprintf(
            &line,
            "how -1 0.000000000 0000000000000000 scale %.17g, up %s, translate %.17g,%.17g,%.17g",
            p->scale, up, p->translate[0], p->translate[1], p->translate[2]) < 0)
        line = NULL;
    return add_line(job, line);
}

/* Records a channel, with the absolute path of its image. */
static int add_channel(struct vox_job *job, const struct vox_channel *channel)
{
    const char *path = channel->texture_path;
    char *full = path ? realpath(path, NULL) : NULL, *text = NULL;
    if (asprintf(&text, "%s%s%s", channel->name, path ? "=" : "",
                 full   ? full
                 : path ? path
                        : "") < 0)
        text = NULL;
    free(full);
    int status = text ? add_input(job, "cha", text) : no_memory(job->ctx, job->tris_path);
    free(text);
    return status;
}

/* Records the rules for paths, which change the names of textures in the chunk file. */
static int add_path_rules(struct vox_job *job)
{
    char *rules, *line = NULL;
    int status = bsq_path_rules_text(job->ctx, &rules);
    if (status < 0 || !rules)
        return status;
    if (asprintf(&line, "how -1 0.000000000 %016" PRIx64 " the set of rules for paths",
                 (uint64_t)XXH3_64bits(rules, strlen(rules))) < 0)
        line = NULL;
    free(rules);
    return add_line(job, line);
}

int vox_job_open(struct bsq_ctx *ctx, const struct vox_sort_options *options, struct vox_job **out)
{
    static const char *const ids[] = {[VOX_IDS_MATERIAL] = "ids by material",
                                      [VOX_IDS_OBJECT] = "ids by object",
                                      [VOX_IDS_COLOR] = "ids by colour"};
    struct vox_job *job = calloc(1, sizeof *job);
    *out = NULL;
    if (!job)
        return no_memory(ctx, options->tris_path);
    job->ctx = ctx;
    job->tris_path = strdup(options->tris_path);
    if (asprintf(&job->record_path, "%s.job", options->tris_path) < 0)
        job->record_path = NULL;
    int status = job->tris_path && job->record_path ? add_line(job, strdup(program))
                                                    : no_memory(ctx, options->tris_path);
    if (status == 0)
        status = bsq_note_output(ctx, job->record_path);
    for (uint32_t i = 0; i < options->scan_count && status == 0; i++) {
        status = add_placement(job, options, i);
        if (status < 0)
            break;
        status = fmt_input_is_pipe(options->scan_paths[i])
                     ? add_pipe(job, options->scan_paths[i])
                     : add_input(job, "obj", options->scan_paths[i]);
    }
    if (status == 0 && options->texture_path)
        status = add_input(job, "tex", options->texture_path);
    if (status == 0 && options->ids != VOX_IDS_NONE)
        status = add_input(job, "ids", ids[options->ids]);
    for (uint32_t i = 0; i < options->channel_count && status == 0; i++)
        status = add_channel(job, &options->channels[i]);
    if (status == 0)
        status = add_path_rules(job);
    if (status < 0)
        vox_job_close(job);
    else
        *out = job;
    return status;
}

int vox_job_add_inputs(struct vox_job *job, struct fmt_mesh_reader *reader)
{
    int status = describe_pipes(job, find_given, reader);
    const char *path;
    for (uint32_t i = 0; status == 0 && (path = fmt_mesh_dependency(reader, i)) != NULL; i++)
        status = add_input(job, "mtl", path);
    return status;
}

void vox_job_finish(struct vox_job *job)
{
    if (job)
        unlink(job->record_path);
}

/* ---- writing ---- */

static int write_lines(struct vox_job *job, const char *first)
{
    struct bsq_output *output;
    int status = bsq_output_open(job->ctx, job->record_path, &output);
    if (status < 0)
        return status;
    if ((status = bsq_output_write(output, first, strlen(first) + 1)) == 0 &&
        (status = bsq_output_write(output, job->lines, job->size)) == 0)
        return bsq_output_commit(output);
    bsq_output_discard(output);
    return status;
}

int vox_job_record(struct vox_job *job)
{
    char *first, *now;
    int status;
    /* If an input changed while it was read, the chunks may be a mix of both versions. */
    for (const char *line = next_line(job->lines); *line; line = next_line(line)) {
        if (is_pipe_line(line) || strncmp(line, "how ", 4) == 0)
            continue;
        status = describe(job->ctx, line, path_of(line), &now);
        bool changed = now && strcmp(line, now) != 0;
        free(now);
        if (changed)
            bsq_warn(job->ctx, "%s was changed while it was read", path_of(line));
        if (status < 0 || changed)
            return status;
    }
    status = first_line(job, job->lines, job->size, &first);
    if (first)
        status = write_lines(job, first);
    free(first);
    return status;
}

/* ---- resuming ---- */

/* Compares a line of the record with the line as it is now. Either may be empty: there is none. */
static int compare(const struct vox_job *job, const char *then, const char *now)
{
    assert(then && now);
    const char *tris = job->tris_path, *was = path_of(then), *is = path_of(now);
    if (strcmp(then, now) == 0)
        return 0;
    if (now == job->lines)
        return bsq_fail(job->ctx, BSQ_EDATA,
                        "%s was made by %s, this is %s: this job cannot be resumed", tris, then,
                        now);
    if (strcmp(was, is) == 0)
        return bsq_fail(job->ctx, BSQ_EDATA,
                        "%s has changed since %s was made from it: this job cannot be resumed", is,
                        tris);
    return bsq_fail(job->ctx, BSQ_EUSAGE,
                    "%s was made from %s, not from %s: this job cannot be resumed", tris,
                    *was ? was : "fewer files", *is ? is : "fewer files");
}

static int check_lines(const struct vox_job *job, const char *then)
{
    const char *now = job->lines;
    int status = 0;
    for (; status == 0 && (*then || *now); then = next_line(then)) {
        if (strncmp(then, "mtl ", 4) != 0) {
            status = compare(job, then, now);
            now = next_line(now);
            continue;
        }
        /* This job does not know its material libraries, as the scan is not read. */
        char *library;
        status = describe(job->ctx, then, path_of(then), &library);
        if (library)
            status = compare(job, then, library);
        free(library);
    }
    return status;
}

int vox_job_resume(struct vox_job *job, bool *sorted)
{
    char *text, *first = NULL;
    uint64_t size;
    *sorted = false;
    int status = load(job->ctx, job->record_path, UINT64_MAX, &text, &size);
    const size_t begin = status == 0 && text ? strlen(text) + 1 : 0;
    /* The last line, too, must have its null byte. */
    if (begin > 0 && begin < size && text[size - 1] == '\0')
        status = first_line(job, text + begin, size - begin, &first);
    if (first && strcmp(text, first) == 0) {
        status = describe_pipes(job, find_by_reading, job->ctx);
        if (status == 0)
            status = check_lines(job, text + begin);
        *sorted = status == 0;
        if (*sorted)
            bsq_note_written(job->ctx, job->tris_path);
    }
    bsq_free(job->ctx, text);
    free(first);
    return status;
}

int vox_job_is_done(struct vox_job *job, bool *done)
{
    *done = false;
    if (job->pipe_count > 0) /* they can be read only once */
        return 0;
    int status = vox_job_resume(job, done);
    if (status == BSQ_ENOMEM || status == BSQ_EINTR)
        return status;
    bsq_clear_error(job->ctx);
    return 0;
}
