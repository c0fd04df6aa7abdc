/* job_record.c - which inputs and options a chunk file was made from, so that a job can go on from
 * it.
 *
 * The record is a text file beside the chunk file, there only while the job is unfinished: what it
 * says (times, places) is of one machine, and the chunk file's bytes shall depend on the scan
 * alone. A file is taken for the same when its size, its time of modification and the hash of
 * samples are. Reading all of it would cost about what resuming saves where disks are slow. The
 * time finds an edit between the samples, the samples a file that was replaced and has an older
 * one's time.
 *
 * Going on from it must give the bytes that doing all again would. So the program must be the same
 * too, and that is not left to a number that somebody has to raise when sorting changes: the record
 * has a sum over the sources. */
#include "base/file.h"
#include "base/output.h"
#include "formats/mesh/mesh_reader.h"
#include "libvoxel/job_record.h"

#include <errno.h>
#include <inttypes.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>
#include <xxhash.h>

#define FIRST_LINE "bisque job 1"

static const char build[] =
#include "chunk_sources.inc"
    ;

/* More than any piece of a line that is written at once. */
enum { LINE_BYTES = 256 };
/* Samples of a file: so many pieces of so many bytes, spread evenly from its first byte to its
 * last. */
enum { SAMPLES = 64, SAMPLE_BYTES = 64 << 10 };
/* Where the chunk file's header has its own checksum, which covers those of all other parts'
 * tables. */
enum { TRIS_CHECKSUM_AT = 144 };

struct source {
    char *path; /* absolute */
    bool library, absent;
    uint64_t bytes, hash;
    int64_t seconds, nanoseconds; /* time of modification */
};

struct vox_job {
    struct bsq_ctx *ctx;
    char *tris_path, *record_path, *texture; /* texture: absolute, or "-" */
    struct source *sources;
    uint64_t count;
};

/* ---- one file ---- */

static int no_memory(struct bsq_ctx *ctx, const char *path)
{
    return bsq_fail_errno(ctx, BSQ_ENOMEM, ENOMEM, "%s", path);
}

/* Absolute name of an existing file; of one that is absent, the name itself. Names are a few bytes,
 * and a job works with a budget of just vox_memory_min(), so they are not counted. */
static int absolute(struct bsq_ctx *ctx, const char *path, char **out)
{
    *out = realpath(path, NULL);
    if (!*out && errno != ENOMEM)
        *out = strdup(path);
    return *out ? 0 : no_memory(ctx, path);
}

static int hash_samples(struct bsq_ctx *ctx, const struct bsq_file *file, uint64_t *hash)
{
    uint8_t *samples;
    uint64_t whole = (uint64_t)SAMPLES * SAMPLE_BYTES,
             size = file->size < whole ? file->size : whole;
    int status = bsq_alloc(ctx, "samples", whole, 1, &samples);
    if (status < 0)
        return status;
    if (file->size <= whole)
        status = bsq_file_read(ctx, file, samples, size, 0);
    for (uint64_t i = 0; file->size > whole && i < SAMPLES && status == 0; i++) {
        uint64_t room = file->size - SAMPLE_BYTES;
        uint64_t at = room / (SAMPLES - 1) * i + room % (SAMPLES - 1) * i / (SAMPLES - 1);
        status = bsq_file_read(ctx, file, samples + i * SAMPLE_BYTES, SAMPLE_BYTES, at);
    }
    *hash = XXH3_64bits(samples, size);
    bsq_free(ctx, samples);
    return status;
}

/* Fills in all but the path. A library may be absent, a scan must not. */
static int identify(struct bsq_ctx *ctx, const char *path, struct source *out)
{
    struct bsq_file file;
    struct stat info;
    out->absent = out->library && access(path, F_OK) != 0;
    if (out->absent)
        return 0;
    int status = bsq_file_open(ctx, path, &file);
    if (status < 0)
        return status;
    if (fstat(file.fd, &info) != 0)
        status = bsq_fail_errno(ctx, BSQ_ENOINPUT, errno, "%s", path);
    else
        status = hash_samples(ctx, &file, &out->hash);
    out->bytes = file.size;
    out->seconds = info.st_mtim.tv_sec;
    out->nanoseconds = info.st_mtim.tv_nsec;
    bsq_file_close(ctx, &file);
    return status;
}

static bool same_content(const struct source *a, const struct source *b)
{
    return a->absent == b->absent &&
           (a->absent || (a->bytes == b->bytes && a->hash == b->hash && a->seconds == b->seconds &&
                          a->nanoseconds == b->nanoseconds));
}

static int add_source(struct vox_job *job, const char *path, bool library)
{
    struct source source = {.library = library};
    struct source *grown = reallocarray(job->sources, job->count + 1, sizeof *grown);
    if (!grown)
        return no_memory(job->ctx, path);
    job->sources = grown;
    int status = identify(job->ctx, path, &source);
    if (status == 0)
        status = absolute(job->ctx, path, &source.path);
    if (status == 0)
        job->sources[job->count++] = source;
    return status;
}

/* ---- a job ---- */

static int name_none(struct bsq_ctx *ctx, char **out)
{
    *out = strdup("-");
    return *out ? 0 : no_memory(ctx, "texture");
}

void vox_job_close(struct vox_job *job)
{
    if (!job)
        return;
    for (uint64_t i = 0; i < job->count; i++)
        free(job->sources[i].path);
    free(job->sources);
    free(job->tris_path);
    free(job->record_path);
    free(job->texture);
    free(job);
}

int vox_job_open(struct bsq_ctx *ctx, const struct vox_sort_options *options, struct vox_job **out)
{
    struct vox_job *job = calloc(1, sizeof *job);
    int status = 0;
    *out = NULL;
    if (!job)
        return no_memory(ctx, options->tris_path);
    job->ctx = ctx;
    job->tris_path = strdup(options->tris_path);
    if (!job->tris_path || asprintf(&job->record_path, "%s.job", options->tris_path) < 0) {
        job->record_path = NULL;
        status = no_memory(ctx, options->tris_path);
    }
    if (status == 0)
        status = options->texture_path ? absolute(ctx, options->texture_path, &job->texture)
                                       : name_none(ctx, &job->texture);
    for (uint32_t i = 0; i < options->scan_count && status == 0; i++)
        status = add_source(job, options->scan_paths[i], false);
    if (status < 0)
        vox_job_close(job);
    else
        *out = job;
    return status;
}

int vox_job_add_dependencies(struct vox_job *job, const struct fmt_mesh_reader *reader)
{
    int status = 0;
    const char *path;
    for (uint32_t i = 0; status == 0 && (path = fmt_mesh_dependency(reader, i)) != NULL; i++)
        status = add_source(job, path, true);
    return status;
}

/* ---- text ---- */

/* Text under construction; `at` NULL: only its size is counted. */
struct text {
    char *at;
    size_t size;
};

static void put(struct text *text, const char *format, ...) __attribute__((format(printf, 2, 3)));

static void put(struct text *text, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    /* With room for the terminator, which the next piece overwrites. */
    int length = vsnprintf(text->at ? text->at + text->size : NULL, text->at ? LINE_BYTES : 0,
                           format, arguments);
    va_end(arguments);
    text->size += (size_t)length;
}

/* Bytes that would end a line, and the sign that says so, as %XX. */
static void put_path(struct text *text, const char *path)
{
    for (; *path; path++) {
        unsigned char c = (unsigned char)*path;
        if (c < 0x20 || c == '%')
            put(text, "%%%02X", c);
        else
            put(text, "%c", c);
    }
    put(text, "\n");
}

static void read_path(char *text)
{
    char *to = text;
    unsigned code;
    for (; *text; text++) {
        if (*text == '%' && sscanf(text + 1, "%2x", &code) == 1) {
            *to++ = (char)code;
            text += 2;
        } else {
            *to++ = *text;
        }
    }
    *to = '\0';
}

/* What tells a chunk file from any other. */
struct seal {
    uint64_t checksum, bytes; /* bytes 0: there is no such file */
};

static int read_seal(struct bsq_ctx *ctx, const char *tris_path, struct seal *out)
{
    struct bsq_file file;
    *out = (struct seal){0, 0};
    if (access(tris_path, F_OK) != 0)
        return 0;
    int status = bsq_file_open(ctx, tris_path, &file);
    if (status < 0)
        return status;
    if (file.size >= TRIS_CHECKSUM_AT + sizeof out->checksum) {
        status = bsq_file_read(ctx, &file, &out->checksum, sizeof out->checksum, TRIS_CHECKSUM_AT);
        out->bytes = file.size;
    }
    bsq_file_close(ctx, &file);
    return status;
}

static void put_record(const struct vox_job *job, const struct seal *seal, struct text *text)
{
    put(text, FIRST_LINE "\nversion %s %s\nchunks %016" PRIx64 " %" PRIu64 "\ntexture ",
        BSQ_VERSION, build, seal->checksum, seal->bytes);
    put_path(text, job->texture);
    for (uint64_t i = 0; i < job->count; i++) {
        const struct source *s = &job->sources[i];
        put(text, "%s %d %" PRIu64 " %" PRId64 ".%09" PRId64 " %016" PRIx64 " ",
            s->library ? "mtl" : "obj", !s->absent, s->bytes, s->seconds, s->nanoseconds, s->hash);
        put_path(text, s->path);
    }
}

static int write_text(struct vox_job *job, const char *text, size_t size)
{
    char end[32];
    struct bsq_output *output;
    int status = bsq_output_open(job->ctx, job->record_path, &output);
    if (status < 0)
        return status;
    int length =
        snprintf(end, sizeof end, "end %016" PRIx64 "\n", (uint64_t)XXH3_64bits(text, size));
    if ((status = bsq_output_write(output, text, size)) == 0)
        status = bsq_output_write(output, end, (uint64_t)length);
    if (status == 0)
        return bsq_output_commit(output);
    bsq_output_discard(output);
    return status;
}

int vox_job_record(struct vox_job *job)
{
    struct seal seal;
    struct text text = {NULL, 0};
    int status = 0;
    /* A file that changed while it was read is in the chunks as it was at no time: better no
     * record. */
    for (uint64_t i = 0; i < job->count && status == 0; i++) {
        struct source now = {.library = job->sources[i].library};
        status = identify(job->ctx, job->sources[i].path, &now);
        if (status == 0 && !same_content(&job->sources[i], &now)) {
            bsq_warn(job->ctx, "%s was changed while it was read", job->sources[i].path);
            return 0;
        }
    }
    if (status < 0 || (status = read_seal(job->ctx, job->tris_path, &seal)) < 0)
        return status;
    put_record(job, &seal, &text);
    text.at = malloc(text.size + LINE_BYTES);
    if (!text.at)
        return no_memory(job->ctx, job->record_path);
    text.size = 0;
    put_record(job, &seal, &text);
    status = write_text(job, text.at, text.size);
    free(text.at);
    return status;
}

void vox_job_finish(struct vox_job *job)
{
    if (job)
        unlink(job->record_path);
}

/* ---- going on ---- */

static int changed(const struct vox_job *job, const struct source *then, const struct source *now)
{
    const char *tris = job->tris_path;
    if (then->absent != now->absent)
        return bsq_fail(job->ctx, BSQ_EDATA,
                        "%s has %s since %s was made: this job cannot be resumed", then->path,
                        now->absent ? "disappeared" : "appeared", tris);
    if (then->bytes != now->bytes)
        return bsq_fail(job->ctx, BSQ_EDATA,
                        "%s has changed since %s was made from it, from %" PRIu64
                        " bytes to %" PRIu64 ": this job cannot be resumed",
                        then->path, tris, then->bytes, now->bytes);
    return bsq_fail(job->ctx, BSQ_EDATA,
                    "%s has changed since %s was made from it, %s: this job cannot be resumed",
                    then->path, tris,
                    then->hash != now->hash ? "its content is another"
                                            : "it was written again at another time");
}

/* Holds the next source of the record against that of the job. */
static int check_source(struct vox_job *job, uint64_t number, const struct source *then)
{
    struct source now = {.library = then->library};
    if (!then->library &&
        (number >= job->count || strcmp(job->sources[number].path, then->path) != 0))
        return bsq_fail(job->ctx, BSQ_EUSAGE, "%s was made from %s%s%s: this job cannot be resumed",
                        job->tris_path, then->path, number < job->count ? ", not from " : " too",
                        number < job->count ? job->sources[number].path : "");
    int status = identify(job->ctx, then->path, &now);
    return status < 0 || same_content(then, &now) ? status : changed(job, then, &now);
}

/* Version and build as in the record; those before 0.2.0 had no build in it. */
static int check_program(const struct vox_job *job, char *version)
{
    char *then = strchr(version, ' ');
    if (then)
        *then++ = '\0';
    if (strcmp(version, BSQ_VERSION) != 0)
        return bsq_fail(job->ctx, BSQ_EDATA,
                        "%s was made by version %s, this is " BSQ_VERSION
                        ": this job cannot be resumed",
                        job->tris_path, version);
    if (!then || strcmp(then, build) != 0)
        return bsq_fail(job->ctx, BSQ_EDATA,
                        "%s was made by version " BSQ_VERSION
                        " too, but from other sources: this job cannot be resumed",
                        job->tris_path);
    return 0;
}

static int check_line(struct vox_job *job, char *line, uint64_t *objects)
{
    struct source then = {0};
    int present = 0, at = 0;
    char kind[4];
    if (strncmp(line, "version ", 8) == 0)
        return check_program(job, line + 8);
    if (strncmp(line, "texture ", 8) == 0) {
        read_path(line + 8);
        return strcmp(line + 8, job->texture) == 0
                   ? 0
                   : bsq_fail(job->ctx, BSQ_EUSAGE,
                              "%s was made with %s%s, not with %s%s: this job cannot be resumed",
                              job->tris_path, strcmp(line + 8, "-") ? "texture " : "no texture",
                              strcmp(line + 8, "-") ? line + 8 : "",
                              strcmp(job->texture, "-") ? "texture " : "none",
                              strcmp(job->texture, "-") ? job->texture : "");
    }
    if (sscanf(line, "%3s %d %" SCNu64 " %" SCNd64 ".%" SCNd64 " %" SCNx64 " %n", kind, &present,
               &then.bytes, &then.seconds, &then.nanoseconds, &then.hash, &at) != 6 ||
        at == 0)
        return 0;
    then.library = strcmp(kind, "mtl") == 0;
    then.absent = !present;
    then.path = line + at;
    read_path(then.path);
    int status = check_source(job, *objects, &then);
    *objects += !then.library;
    return status;
}

/* The record's text without its last line, for the caller to free; NULL where there is none that is
 * whole. */
static int read_record(struct vox_job *job, char **out)
{
    struct bsq_file file;
    char *text;
    uint64_t sum;
    *out = NULL;
    if (access(job->record_path, F_OK) != 0)
        return 0;
    int status = bsq_file_open(job->ctx, job->record_path, &file);
    if (status < 0)
        return status;
    if ((status = bsq_alloc(job->ctx, "job record", file.size + 1, 1, &text)) == 0 &&
        (status = bsq_file_read(job->ctx, &file, text, file.size, 0)) == 0) {
        text[file.size] = '\0';
        char *end = strstr(text, "\nend ");
        if (end && sscanf(end + 1, "end %" SCNx64, &sum) == 1 &&
            XXH3_64bits(text, (size_t)(end + 1 - text)) == sum &&
            strncmp(text, FIRST_LINE "\n", sizeof FIRST_LINE) == 0) {
            end[1] = '\0';
            *out = text;
        }
    }
    if (!*out)
        bsq_free(job->ctx, text);
    bsq_file_close(job->ctx, &file);
    return status;
}

int vox_job_resume(struct vox_job *job, bool *sorted)
{
    struct seal now, then;
    uint64_t objects = 0;
    char *text, *rest, *line;
    *sorted = false;
    int status = read_seal(job->ctx, job->tris_path, &now);
    if (status < 0 || now.bytes == 0 || (status = read_record(job, &text)) < 0 || !text)
        return status;
    line = strstr(text, "\nchunks ");
    bool whole = line &&
                 sscanf(line, "\nchunks %" SCNx64 " %" SCNu64, &then.checksum, &then.bytes) == 2 &&
                 now.checksum == then.checksum && now.bytes == then.bytes;
    for (line = whole ? strtok_r(text, "\n", &rest) : NULL; line && status == 0;
         line = strtok_r(NULL, "\n", &rest))
        status = check_line(job, line, &objects);
    if (status == 0 && whole && objects < job->count)
        status =
            bsq_fail(job->ctx, BSQ_EUSAGE, "%s was not made from %s: this job cannot be resumed",
                     job->tris_path, job->sources[objects].path);
    *sorted = status == 0 && whole;
    bsq_free(job->ctx, text);
    return status;
}
