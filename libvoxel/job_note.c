/* job_note.c - notes which inputs and options a chunk file was made from, so that a job can
 * resume from it (docs/decisions/0006).
 *
 * The note is a file of lines beside the chunk file, each of which ends with a null byte, as
 * paths may contain anything else. It exists only while the job is unfinished, and beside a chunk
 * file that was sorted alone. The first line has the version of the program, and a checksum of the
 * other lines and of the chunk file's header. Each other line is a kind, a hash and a text:
 *
 *     "obj", "mtl": an input. The hash is of its size, time of modification and samples. "mtl" is a
 *            file that the meshes name: of materials, or an image that the chunk file holds
 *     "tex": an image, of which only the path matters; or "NAME=PATH", or the name of a channel
 *     "how": an option
 *
 * To resume, the lines are made again from the files as they are now, and must be the same. A hash
 * of samples is used because reading whole inputs would take about as long as resuming saves on
 * slow disks. The time of modification reveals edits between samples. */
#include "base/job_files.h"
#include "base/output.h"
#include "base/path_map.h"
#include "formats/input/input.h"
#include "formats/mesh/mesh_reader.h"
#include "libvoxel/job_note.h"

#include <assert.h>
#include <errno.h>
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>
#include <xxhash.h>

/* Samples are spread evenly over a file, and overlap in small files. */
enum { SAMPLES = 64, SAMPLE_BYTES = 64 << 10 };
/* Offset of the checksum in a chunk file's header, which covers those of all other parts. */
enum { TRIS_CHECKSUM_AT = 168 };
/* Offset of the text in a line: after a kind of 3 and a hash of 16 characters. */
enum { TEXT_AT = 21 };

static int no_memory(const struct job_note *r)
{
    return bsq_fail_errno(r->ctx, BSQ_ENOMEM, ENOMEM, "%s", r->tris_path);
}

/* ---- lines ---- */

/* Returns the next line; after the last line, the empty one. */
static const char *next_line(const char *line)
{
    return *line ? line + strlen(line) + 1 : line;
}

static const char *text_of(const char *line)
{
    return strlen(line) > TEXT_AT ? line + TEXT_AT : "";
}

/* Adds a line and frees its text. NULL: there was no memory for it. Lines are a few bytes and a job
 * may have a budget of only vox_memory_min(), so they are not counted. */
static int add_line(struct job_note *r, const char *kind, uint64_t hash, char *text)
{
    const size_t bytes = text ? TEXT_AT + strlen(text) + 1 : 0;
    char *grown = text ? realloc(r->lines, r->size + bytes + 1) : NULL;
    if (grown) {
        snprintf(grown + r->size, bytes, "%s %016" PRIx64 " %s", kind, hash, text);
        r->lines = grown;
        r->size += bytes;
        grown[r->size] = '\0';
    }
    free(text);
    return grown ? 0 : no_memory(r);
}

static int hash_file(struct bsq_ctx *ctx, const char *path, uint64_t *hash)
{
    struct bsq_file file = BSQ_FILE_CLOSED;
    uint8_t *sample = NULL;
    int status;
    BSQ_TRY(bsq_file_open_as(ctx, path, BSQ_OPEN_OTHER, &file));
    BSQ_TRY(bsq_alloc(ctx, "sample", SAMPLE_BYTES, 1, &sample));
    const struct timespec *modified = &file.identity.modified;
    const int64_t known[] = {(int64_t)file.size, modified->tv_sec, modified->tv_nsec};
    const uint64_t bytes = file.size < SAMPLE_BYTES ? file.size : SAMPLE_BYTES;
    const uint64_t last = file.size - bytes, gaps = SAMPLES - 1;
    *hash = XXH3_64bits(known, sizeof known);
    for (uint64_t i = 0; i < SAMPLES; i++) {
        BSQ_TRY(bsq_file_read(ctx, &file, sample, bytes, last / gaps * i + last % gaps * i / gaps));
        *hash = XXH3_64bits_withSeed(sample, bytes, *hash);
    }
done:
    bsq_free(ctx, sample);
    bsq_file_close(ctx, &file);
    return status;
}

/* Returns the absolute path of a file, which may be missing; NULL: there is no memory. */
static char *full_path(const char *path)
{
    char *full = realpath(path, NULL);
    return full || errno == ENOMEM ? full : strdup(path);
}

/* Adds an input: "obj"; or "mtl", which may be absent or no file. */
static int add_input(struct job_note *r, const char *kind, const char *path)
{
    struct stat info;
    uint64_t hash = 0;
    const bool there = stat(path, &info) == 0 && S_ISREG(info.st_mode) && access(path, R_OK) == 0;
    int status = 0;
    if (*kind == 'o' || there)
        BSQ_TRY(hash_file(r->ctx, path, &hash));
    status = add_line(r, kind, hash, full_path(path));
done:
    return status;
}

static int add_placement(struct job_note *r, const struct vox_placement *p)
{
    const char *up = p->up == VOX_UP_Y ? "y" : p->up == VOX_UP_Z ? "z" : "unchanged";
    char *text = NULL;
    if (asprintf(&text, "scale %.17g, up %s, translate %.17g,%.17g,%.17g", p->scale, up,
                 p->translate[0], p->translate[1], p->translate[2]) < 0)
        text = NULL;
    return add_line(r, "how", 0, text);
}

static int add_channel(struct job_note *r, const struct vox_channel *channel)
{
    char *path = channel->texture_path ? full_path(channel->texture_path) : NULL, *text = NULL;
    if (asprintf(&text, "%s%s%s", channel->name, path ? "=" : "", path ? path : "") < 0 ||
        (channel->texture_path && !path)) {
        free(text);
        text = NULL;
    }
    free(path);
    return add_line(r, "tex", 0, text);
}

/* Adds the rules for paths, which change the names of textures in the chunk file. */
static int add_path_rules(struct job_note *r)
{
    char *rules;
    int status = bsq_path_rules_text(r->ctx, &rules);
    if (status < 0 || !rules)
        return status;
    const uint64_t hash = XXH3_64bits(rules, strlen(rules));
    free(rules);
    return add_line(r, "how", hash, strdup("the set of rules for paths"));
}

/* ---- a job ---- */

void vox_note_free(struct job_note *r)
{
    free(r->path);
    free(r->lines);
    *r = (struct job_note){0};
}

static char *path_beside(const char *tris_path)
{
    char *path = NULL;
    return asprintf(&path, "%s.job", tris_path) < 0 ? NULL : path;
}

void vox_sort_finish(const char *tris_path)
{
    char *path = path_beside(tris_path);
    if (path)
        unlink(path);
    free(path);
}

/* Returns the path of an input that is a pipe or comes from a callback, or NULL. */
static const char *find_pipe(const struct vox_sort_options *options)
{
    for (uint32_t i = 0; i < options->scan_count; i++)
        if ((options->sources && options->sources[i]) || fmt_input_is_pipe(options->scan_paths[i]))
            return options->scan_paths[i];
    return NULL;
}

static int describe(struct job_note *r, const struct vox_sort_options *options)
{
    static const char *const ids[] = {[VOX_IDS_MATERIAL] = "ids by material",
                                      [VOX_IDS_OBJECT] = "ids by object",
                                      [VOX_IDS_COLOR] = "ids by colour"};
    int status = 0;
    for (uint32_t i = 0; i < options->scan_count; i++) {
        assert(options->scan_paths[i]);
        if (options->placements)
            BSQ_TRY(add_placement(r, &options->placements[i]));
        BSQ_TRY(add_input(r, "obj", options->scan_paths[i]));
    }
    if (options->texture_path)
        BSQ_TRY(add_line(r, "tex", 0, full_path(options->texture_path)));
    if (options->ids != VOX_IDS_NONE)
        BSQ_TRY(add_line(r, "how", 0, strdup(ids[options->ids])));
    for (uint32_t i = 0; i < options->channel_count; i++)
        BSQ_TRY(add_channel(r, &options->channels[i]));
    if (options->embed_textures)
        BSQ_TRY(add_line(r, "how", 0, strdup("textures as images inside")));
    status = add_path_rules(r);
done:
    return status;
}

int vox_note_open(struct bsq_ctx *ctx, const struct vox_sort_options *options, struct job_note *r)
{
    const char *pipe = find_pipe(options);
    int status;
    *r = (struct job_note){.ctx = ctx, .tris_path = options->tris_path};
    if (pipe && options->note == VOX_NOTE_RESUME)
        return bsq_fail(
            ctx, BSQ_EUSAGE,
            "%s is a pipe or no file, which cannot be read again: if %s is complete, make the "
            "grid from it instead of resuming",
            pipe, options->tris_path);
    if (pipe || options->note == VOX_NOTE_NONE)
        return 0;
    r->path = path_beside(options->tris_path);
    BSQ_TRY(r->path ? bsq_note_output(ctx, r->path) : no_memory(r));
    status = describe(r, options);
done:
    return status;
}

int vox_note_add_libraries(struct job_note *r, struct fmt_mesh_reader *reader)
{
    const char *path;
    int status = 0;
    for (uint32_t i = 0; r->path && (path = fmt_mesh_dependency(reader, i)) != NULL; i++)
        BSQ_TRY(add_input(r, "mtl", path));
done:
    return status;
}

int vox_note_add_image(struct job_note *r, const char *path)
{
    return r->path ? add_input(r, "mtl", path) : 0;
}

/* ---- the file ---- */

/* Reads a file, or its first `most` bytes, and adds a null byte. *text: for the caller to free with
 * bsq_free(), or NULL if there is no such file. */
static int load(struct bsq_ctx *ctx, const char *path, uint64_t most, char **text, uint64_t *size)
{
    struct bsq_file file = BSQ_FILE_CLOSED;
    int status = 0;
    *text = NULL;
    *size = 0;
    if (access(path, F_OK) != 0)
        return 0;
    BSQ_TRY(bsq_file_open_as(ctx, path, BSQ_OPEN_OTHER, &file));
    const uint64_t bytes = file.size < most ? file.size : most;
    BSQ_TRY(bsq_calloc(ctx, "job note", bytes + 1, 1, text));
    status = bsq_file_read(ctx, &file, *text, bytes, 0);
    *size = file.size;
done:
    bsq_file_close(ctx, &file);
    return status;
}

/* Makes the first line of a note with these other lines, for the caller to free. NULL if there is
 * no chunk file. */
static int make_first_line(const struct job_note *r, const char *lines, size_t bytes, char **out)
{
    char *header;
    uint64_t size, checksum;
    int status = load(r->ctx, r->tris_path, TRIS_CHECKSUM_AT + sizeof checksum, &header, &size);
    *out = NULL;
    if (status == 0 && size >= TRIS_CHECKSUM_AT + sizeof checksum) {
        memcpy(&checksum, header + TRIS_CHECKSUM_AT, sizeof checksum);
        checksum = XXH3_64bits_withSeed(lines, bytes, checksum + size);
        if (asprintf(out, "bisque job 3, version " BSQ_VERSION ", sum %016" PRIx64, checksum) < 0) {
            *out = NULL;
            status = no_memory(r);
        }
    }
    bsq_free(r->ctx, header);
    return status;
}

int vox_note_write(struct job_note *r)
{
    struct bsq_output *output = NULL;
    char *first = NULL;
    int status = 0;
    if (!r->path)
        return 0;
    BSQ_TRY(make_first_line(r, r->lines, r->size, &first));
    if (!first)
        return 0;
    BSQ_TRY(bsq_output_open(r->ctx, r->path, &output));
    BSQ_TRY(bsq_output_write(output, first, strlen(first) + 1));
    BSQ_TRY(bsq_output_write(output, r->lines, r->size));
    status = bsq_output_commit(output);
    output = NULL;
done:
    bsq_output_discard(output);
    free(first);
    return status;
}

/* ---- resuming ---- */

/* Compares a line of the note with the line as it is now. Either may be empty: there is none. */
static int compare(const struct job_note *r, const char *then, const char *now)
{
    const char *was = text_of(then), *is = text_of(now);
    if (strcmp(then, now) == 0)
        return 0;
    if (strcmp(was, is) == 0)
        return bsq_fail(r->ctx, BSQ_EDATA,
                        "%s has changed since %s was made from it: this job cannot be resumed", is,
                        r->tris_path);
    return bsq_fail(r->ctx, BSQ_EUSAGE,
                    "%s was made from %s, not from %s: this job cannot be resumed", r->tris_path,
                    *was ? was : "fewer files", *is ? is : "fewer files");
}

/* Compares all lines. The job does not know its material libraries, as the scan is not read. They
 * are last in the note, and are described again as they are now. */
static int compare_all(struct job_note *r, const char *then)
{
    int status = 0;
    for (size_t at = 0; *then || at < r->size; then = next_line(then)) {
        const bool is_library = strncmp(then, "mtl ", 4) == 0, is_own = at < r->size;
        if (is_library && !is_own)
            BSQ_TRY(add_input(r, "mtl", text_of(then)));
        const char *now = r->lines + at;
        BSQ_TRY(compare(r, is_library && is_own ? "" : then, now));
        at += strlen(now) + 1;
    }
done:
    return status;
}

int vox_note_check(struct job_note *r, enum vox_note how, bool *same)
{
    const size_t own = r->size;
    char *text = NULL, *first = NULL;
    uint64_t size;
    int status = 0;
    *same = false;
    if (!r->path || how == VOX_NOTE_WRITE)
        return 0;
    BSQ_TRY(load(r->ctx, r->path, UINT64_MAX, &text, &size));
    const size_t begin = text ? strlen(text) + 1 : 0;
    if (begin < size)
        BSQ_TRY(make_first_line(r, text + begin, size - begin, &first));
    if (text && first && strcmp(text, first) == 0) {
        BSQ_TRY(compare_all(r, text + begin));
        *same = true;
    }
done:
    bsq_free(r->ctx, text);
    free(first);
    r->size = own; /* without the libraries */
    if (r->lines)
        r->lines[own] = '\0';
    if (how == VOX_NOTE_REUSE && status != BSQ_ENOMEM && status != BSQ_EINTR) {
        bsq_clear_error(r->ctx);
        status = 0;
    }
    return status;
}
