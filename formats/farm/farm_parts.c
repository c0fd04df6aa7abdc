/* farm_parts.c - part files: their names, their heads, and which are missing. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <xxhash.h>

#include "base/file.h"
#include "formats/farm/farm.h"

/* Structures are copied to and from the file as they are. */
_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "the host must be little-endian");
_Static_assert(sizeof(struct fmt_farm_part_head) == 40, "the head has no padding");

enum { ATTEMPTS = 3, LIST_BYTES = 160 };

/* Returns the length of a plan's path without ".json", or 0 if its name has no such end. */
static size_t length_without_json(const char *path)
{
    const char *name = bsq_file_name(path);
    const size_t length = strlen(name);
    if (length <= 5 || strcmp(name + length - 5, ".json") != 0)
        return 0;
    return (size_t)(name - path) + length - 5;
}

/* Plans a.json and a may lie side by side, so their parts end differently. */
char *fmt_farm_part_path(const struct fmt_farm_plan *plan, uint32_t task)
{
    const size_t stem = length_without_json(plan->path);
    char *path;
    const int written = stem > 0 ? asprintf(&path, "%.*s.%04u.part", (int)stem, plan->path, task)
                                 : asprintf(&path, "%s.part.%04u", plan->path, task);
    return written < 0 ? NULL : path;
}

struct fmt_farm_part_head fmt_farm_part_head(const struct fmt_farm_plan *plan, uint32_t task,
                                             uint32_t own)
{
    struct fmt_farm_part_head head = {.version = plan->kind->part_version,
                                      .own = own,
                                      .plan_id = {plan->id[0], plan->id[1]},
                                      .task = task,
                                      .task_count = plan->task_count};
    memcpy(head.magic, plan->kind->magic, sizeof head.magic);
    return head;
}

/* ---- writing ---- */

static int write_and_commit(const struct fmt_farm_plan *plan, const char *path,
                            const struct fmt_farm_part_steps *steps)
{
    struct bsq_output *output;
    int status = bsq_output_open(plan->ctx, path, &output);
    if (status < 0)
        return status;
    status = steps->write(steps->arg, output);
    if (status == 0)
        return bsq_output_commit(output);
    bsq_output_discard(output);
    return status;
}

/* On file systems whose locks hold on one machine only, the same task on another machine may remove
 * this one's temporary file. Then its part may be there by now; else writing starts again. */
int fmt_farm_part_write(const struct fmt_farm_plan *plan, uint32_t task,
                        const struct fmt_farm_part_steps *steps)
{
    char *path = fmt_farm_part_path(plan, task);
    int status = path ? 0 : fmt_farm_fail_memory(plan);
    for (int attempt = 1; status == 0; attempt++) {
        bool there = false;
        status = write_and_commit(plan, path, steps);
        if (status != BSQ_ECANTCREAT || attempt == ATTEMPTS)
            break;
        if (fmt_farm_part_is_there(plan, task, steps, &there) < 0 || bsq_check(plan->ctx) < 0)
            break;
        bsq_clear_error(plan->ctx);
        status = 0;
        if (there)
            break;
    }
    free(path);
    return status;
}

/* ---- reading ---- */

int fmt_farm_fail_part(const struct fmt_farm_plan *plan, const struct bsq_file *file,
                       const char *what)
{
    return bsq_fail(plan->ctx, BSQ_EDATA, "%s: %s: run this task again", file->path, what);
}

static int check_head(const struct fmt_farm_plan *plan, uint32_t task, const void *header,
                      size_t size, const struct bsq_file *file)
{
    struct fmt_farm_part_head head;
    uint64_t checksum;
    char text[128];
    memcpy(&head, header, sizeof head);
    memcpy(&checksum, (const char *)header + size - sizeof checksum, sizeof checksum);
    if (memcmp(head.magic, plan->kind->magic, sizeof head.magic) != 0) {
        snprintf(text, sizeof text, "not a part of %s", plan->kind->work);
        return fmt_farm_fail_part(plan, file, text);
    }
    if (head.version != plan->kind->part_version) {
        snprintf(text, sizeof text, "version %u of parts is unknown", head.version);
        return fmt_farm_fail_part(plan, file, text);
    }
    if (XXH3_64bits(header, size - sizeof checksum) != checksum)
        return fmt_farm_fail_part(plan, file, "damaged header");
    if (head.plan_id[0] != plan->id[0] || head.plan_id[1] != plan->id[1])
        return fmt_farm_fail_part(plan, file, "a part of another plan");
    if (head.task != task || head.task_count != plan->task_count)
        return fmt_farm_fail_part(plan, file, "the part of another task");
    return 0;
}

int fmt_farm_part_open(const struct fmt_farm_plan *plan, uint32_t task, void *header, size_t size,
                       struct bsq_file *file)
{
    *file = (struct bsq_file)BSQ_FILE_CLOSED;
    char *path = fmt_farm_part_path(plan, task), text[64];
    if (!path)
        return fmt_farm_fail_memory(plan);
    int status = bsq_file_open_as(plan->ctx, path, BSQ_OPEN_OTHER, file);
    snprintf(text, sizeof text, "not a part of %s", plan->kind->work);
    if (status == 0 && file->size < size)
        status = fmt_farm_fail_part(plan, file, text);
    if (status == 0)
        status = bsq_file_read(plan->ctx, file, header, size, 0);
    if (status == 0)
        status = check_head(plan, task, header, size, file);
    free(path);
    return status;
}

int fmt_farm_part_is_there(const struct fmt_farm_plan *plan, uint32_t task,
                           const struct fmt_farm_part_steps *steps, bool *out)
{
    const int status = steps->check(steps->arg, task);
    *out = status == 0;
    if (status == BSQ_ENOMEM || status == BSQ_EINTR)
        return status;
    bsq_clear_error(plan->ctx);
    return 0;
}

/* Fails with the numbers of the missing parts, as many as fit a line. */
static int fail_missing(const struct fmt_farm_plan *plan, const uint32_t *missing, uint32_t count)
{
    char list[LIST_BYTES] = "";
    size_t length = 0;
    uint32_t named = 0;
    while (named < count && length + 32 < sizeof list) {
        length += (size_t)snprintf(list + length, sizeof list - length, "%s%u", named ? ", " : "",
                                   missing[named]);
        named++;
    }
    char *path = fmt_farm_part_path(plan, missing[0]);
    const int status = bsq_fail(plan->ctx, BSQ_ENOINPUT,
                                "%s: missing; %u of %u parts are missing: those of task%s %s%s",
                                path ? path : plan->path, count, plan->task_count,
                                count == 1 ? "" : "s", list, named < count ? " ..." : "");
    free(path);
    return status;
}

int fmt_farm_parts_check(const struct fmt_farm_plan *plan, const struct fmt_farm_part_steps *steps)
{
    uint32_t *missing, count = 0;
    int status = bsq_alloc(plan->ctx, "tasks", plan->task_count, sizeof *missing, &missing);
    for (uint32_t task = 0; task < plan->task_count && status == 0; task++) {
        status = steps->check(steps->arg, task);
        if (status == BSQ_ENOINPUT) {
            bsq_clear_error(plan->ctx);
            missing[count++] = task;
            status = 0;
        }
        if (status == 0)
            status = bsq_check(plan->ctx);
    }
    if (status == 0 && count > 0)
        status = fail_missing(plan, missing, count);
    bsq_free(plan->ctx, missing);
    return status;
}

/* ---- before the work ---- */

int fmt_farm_check_task(const struct fmt_farm_plan *plan, uint32_t task)
{
    return task < plan->task_count
               ? 0
               : bsq_fail(plan->ctx, BSQ_EUSAGE, "%s: there is no task %u: tasks are 0 to %u",
                          plan->path, task, plan->task_count - 1);
}

/* Checks a path, which it frees; NULL: there was no memory for it. */
static int check_output(const struct fmt_farm_plan *plan, char *path)
{
    const int status = path ? bsq_output_check(plan->ctx, path) : fmt_farm_fail_memory(plan);
    free(path);
    return status;
}

int fmt_farm_check_part_output(const struct fmt_farm_plan *plan, uint32_t task)
{
    return check_output(plan, fmt_farm_part_path(plan, task));
}

int fmt_farm_check_note_output(const struct fmt_farm_plan *plan)
{
    return check_output(plan, fmt_farm_note_path(plan));
}
