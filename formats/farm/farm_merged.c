/* farm_merged.c - the note that the parts of a plan are merged, so that doing it again costs
 * nothing.
 *
 * The note has the plan's id, the size and time of each file, and a line with what the merge found.
 * A file that was touched since is merged again, which gives the same bytes. */
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "base/file.h"
#include "formats/farm/farm.h"

char *fmt_farm_note_path(const struct fmt_farm_plan *plan)
{
    char *path;
    return asprintf(&path, "%s.merged", plan->path) < 0 ? NULL : path;
}

/* Returns the text of the note for the files as they are now; NULL if one is missing or there is no
 * memory. The caller frees it. */
static char *note_text(const struct fmt_farm_plan *plan, char *const *paths, uint64_t count)
{
    char *text = NULL;
    size_t size;
    bool all = true;
    FILE *stream = open_memstream(&text, &size);
    if (!stream)
        return NULL;
    fprintf(stream, "Bisque merged %016" PRIx64 "%016" PRIx64 "\n", plan->id[0], plan->id[1]);
    for (uint64_t i = 0; i < count && all; i++) {
        struct stat info = {0};
        all = stat(paths[i], &info) == 0 && S_ISREG(info.st_mode);
        fprintf(stream, "%lld %lld.%09ld %s\n", (long long)info.st_size,
                (long long)info.st_mtim.tv_sec, info.st_mtim.tv_nsec, bsq_file_name(paths[i]));
    }
    if (fclose(stream) == 0 && all)
        return text;
    free(text);
    return NULL;
}

int fmt_farm_note_merged(const struct fmt_farm_plan *plan, char *const *paths, uint64_t count,
                         const char *found)
{
    char *path = fmt_farm_note_path(plan), *files = note_text(plan, paths, count), *text = NULL;
    if (files && asprintf(&text, "%s%s\n", files, found) < 0)
        text = NULL;
    const int status = path && text
                           ? fmt_farm_write_text(plan->ctx, path, text)
                           : bsq_fail(plan->ctx, BSQ_EIO, "%s: an output is gone", plan->path);
    free(text);
    free(files);
    free(path);
    return status;
}

bool fmt_farm_is_merged(const struct fmt_farm_plan *plan, char *const *paths, uint64_t count,
                        char found[FMT_FARM_FOUND_BYTES])
{
    char *path = fmt_farm_note_path(plan), *files = note_text(plan, paths, count);
    const size_t length = files ? strlen(files) : 0;
    char *text = malloc(length + FMT_FARM_FOUND_BYTES);
    FILE *file = path && files && text ? fopen(path, "re") : NULL;
    const size_t read = file ? fread(text, 1, length + FMT_FARM_FOUND_BYTES, file) : 0;
    const bool same = read > length && read < length + FMT_FARM_FOUND_BYTES &&
                      memcmp(text, files, length) == 0 && text[read - 1] == '\n';
    if (same)
        *(char *)mempcpy(found, text + length, read - 1 - length) = '\0';
    if (file)
        fclose(file);
    free(text);
    free(files);
    free(path);
    return same;
}
