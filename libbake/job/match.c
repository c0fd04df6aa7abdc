/* match.c - finds out which scans each object of the low-poly mesh sees, by their names. */
#include <stdio.h>
#include <string.h>

#include "base/file.h"
#include "libbake/job/job.h"

enum { LIST_BYTES = 300 /* of names in a message */ };

/* A scan's name: its file's, without folder and suffix. */
struct name {
    const char *at;
    size_t length;
};

static struct name scan_name(const struct bake_work *job, uint32_t scan)
{
    const char *path = job->surface.scans[scan].path;
    const char *at = bsq_file_name(path), *dot = strrchr(at, '.');
    return (struct name){at, dot && dot > at ? (size_t)(dot - at) : strlen(at)};
}

/* Reads `text` at the start of a name, and advances the name past it. Returns whether it is there.
 */
static bool take(struct name *name, const char *text, size_t length)
{
    const bool there = name->length >= length && memcmp(name->at, text, length) == 0;
    name->at += there ? length : 0;
    name->length -= there ? length : 0;
    return there;
}

/* Returns the length of an object's name without its suffix. */
static size_t stem_length(const struct bake_options *options, const char *object)
{
    const size_t low = strlen(options->low_suffix), length = strlen(object);
    const bool ends =
        low > 0 && length > low && strcmp(object + length - low, options->low_suffix) == 0;
    return ends ? length - low : length;
}

/* Returns whether an object and a scan have the same name but for their suffixes. What follows the
 * scan's suffix after a '_' is the number of a scan, or any other text. */
static bool match(const struct bake_options *options, const char *object, struct name scan)
{
    if (!take(&scan, object, stem_length(options, object)))
        return false;
    return scan.length == 0 || (take(&scan, options->high_suffix, strlen(options->high_suffix)) &&
                                (scan.length == 0 || *scan.at == '_'));
}

/* Lets a scan be seen only by the objects that share most of its name with it: "body_arm_high" is a
 * scan of "body_arm_low", not another one of "body_low", if the suffixes allow both. */
static void keep_longest(struct bake_work *job, uint32_t scan)
{
    const uint32_t scans = job->surface.scan_count, objects = job->mesh.objects.count;
    size_t longest = 0;
    for (uint32_t o = 0; o < objects; o++) {
        const size_t stem = stem_length(job->options, job->mesh.objects.list[o]);
        if (job->sees[(uint64_t)o * scans + scan] && stem > longest)
            longest = stem;
    }
    for (uint32_t o = 0; o < objects; o++)
        job->sees[(uint64_t)o * scans + scan] &=
            stem_length(job->options, job->mesh.objects.list[o]) == longest;
}

/* ---- messages ---- */

/* A list of names in a message; those that do not fit are counted. */
struct list {
    char text[LIST_BYTES];
    size_t used;
    uint64_t left;
};

static void add_name(struct list *list, const char *name, size_t length)
{
    if (list->left > 0 || list->used + length + 32 > sizeof list->text) {
        list->left++;
        return;
    }
    list->used += (size_t)snprintf(list->text + list->used, sizeof list->text - list->used,
                                   "%s%.*s", list->used > 0 ? ", " : "", (int)length, name);
}

static const char *end_list(struct list *list)
{
    if (list->left > 0)
        snprintf(list->text + list->used, sizeof list->text - list->used, " and %llu more",
                 (unsigned long long)list->left);
    return list->used + list->left > 0 ? list->text : "none";
}

/* Reports the objects and scans that have no partner. */
static int fail_alone(const struct bake_work *job, const bool *sees)
{
    const uint32_t scans = job->surface.scan_count;
    struct list objects = {{0}, 0, 0}, others = {{0}, 0, 0};
    for (uint32_t o = 0; o < job->mesh.objects.count; o++)
        if (!memchr(sees + (uint64_t)o * scans, 1, scans))
            add_name(&objects, job->mesh.objects.list[o], strlen(job->mesh.objects.list[o]));
    for (uint32_t s = 0; s < scans; s++) {
        bool seen = false;
        for (uint32_t o = 0; o < job->mesh.objects.count && !seen; o++)
            seen = sees[(uint64_t)o * scans + s];
        const struct name name = scan_name(job, s);
        if (!seen)
            add_name(&others, name.at, name.length);
    }
    if (objects.used + objects.left + others.used + others.left == 0)
        return 0;
    return bsq_fail(job->ctx, BSQ_EUSAGE,
                    "names do not match: low-poly objects without a scan: %s; scans without an "
                    "object: %s",
                    end_list(&objects), end_list(&others));
}

/* ---- all objects ---- */

int bake_match_names(struct bake_work *job)
{
    const uint32_t scans = job->surface.scan_count, objects = job->mesh.objects.count;
    int status = 0;
    BSQ_TRY(
        bsq_calloc(job->ctx, "matches", (uint64_t)objects * scans, sizeof *job->sees, &job->sees));
    for (uint32_t o = 0; o < objects; o++) {
        if (o % 1024 == 0)
            BSQ_TRY(bsq_check(job->ctx));
        for (uint32_t s = 0; s < scans; s++)
            job->sees[(uint64_t)o * scans + s] =
                match(job->options, job->mesh.objects.list[o], scan_name(job, s));
    }
    for (uint32_t s = 0; s < scans; s++) {
        BSQ_TRY(bsq_check(job->ctx));
        keep_longest(job, s);
    }
    BSQ_TRY(fail_alone(job, job->sees));
    job->surface.sees = job->sees;
done:
    return status;
}
