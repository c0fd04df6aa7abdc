/* machine.c - the memory and the processors that this process may use.
 *
 * Control groups limit both, in version 1 and 2 of their files, and each group on the way to the
 * root of the hierarchy has limits of its own. A container sees its own group as the root, or the
 * path of its group on the host with nothing but that group mounted. So the path of the group is
 * taken relative to what is mounted, and all groups from there up to the mount point count. */
#include <errno.h>
#include <sched.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "base/context_internal.h"

/* Calls `fn` for each line of a file, without its newline. A file that cannot be read has none. */
static void for_each_line(const char *path, void (*fn)(void *arg, char *line), void *arg)
{
    char *line = NULL;
    size_t size = 0;
    FILE *file = fopen(path, "re");
    while (file && getline(&line, &size, file) > 0) {
        line[strcspn(line, "\n")] = '\0';
        fn(arg, line);
    }
    free(line);
    if (file)
        fclose(file);
}

/* ---- the files of one group ---- */

/* Reads up to two numbers of root/directory/name. Returns how many there are; "max" is none. */
static int machine_read_numbers(const char *directory, const char *name, long long numbers[2])
{
    char *path = NULL;
    int count = 0;
    if (asprintf(&path, "%s/%s", directory, name) < 0)
        return 0;
    FILE *file = fopen(path, "re");
    if (file) {
        count = fscanf(file, "%lld %lld", &numbers[0], &numbers[1]);
        fclose(file);
    }
    free(path);
    return count < 0 ? 0 : count;
}

static void limit_memory(struct bsq_machine *machine, const char *directory, const char *name)
{
    long long numbers[2];
    if (machine_read_numbers(directory, name, numbers) > 0 && numbers[0] >= 0 &&
        (uint64_t)numbers[0] < machine->memory_bytes)
        machine->memory_bytes = (uint64_t)numbers[0];
}

/* A quota is microseconds of processor time in each period; a part of a processor counts as one. */
static void limit_processors(struct bsq_machine *machine, long long quota, long long period)
{
    if (quota <= 0 || period <= 0)
        return;
    const long long processors = (quota - 1) / period + 1;
    if (processors < machine->processors)
        machine->processors = (unsigned)processors;
}

static void apply_group(struct bsq_machine *machine, const char *directory)
{
    long long quota[2], period[2];
    limit_memory(machine, directory, "memory.max");
    limit_memory(machine, directory, "memory.high");
    limit_memory(machine, directory, "memory.limit_in_bytes");
    if (machine_read_numbers(directory, "cpu.max", quota) == 2)
        limit_processors(machine, quota[0], quota[1]);
    if (machine_read_numbers(directory, "cpu.cfs_quota_us", quota) > 0 &&
        machine_read_numbers(directory, "cpu.cfs_period_us", period) > 0)
        limit_processors(machine, quota[0], period[0]);
}

/* ---- hierarchies ---- */

struct hierarchy {
    const char *root;    /* prefix of all paths */
    const char *top;     /* the group that is mounted */
    const char *mount;   /* where */
    const char *type;    /* "cgroup" or "cgroup2" */
    const char *options; /* of the mount: names of controllers for version 1 */
    struct bsq_machine *machine;
};

/* Returns whether a list with commas has this word. */
static bool has_word(const char *list, const char *word, size_t length)
{
    for (const char *p = list; p; p = strchr(p, ',') ? strchr(p, ',') + 1 : NULL)
        if (strncmp(p, word, length) == 0 && (p[length] == ',' || p[length] == '\0'))
            return true;
    return false;
}

/* Returns whether a line of /proc/self/cgroup with these controllers is about the hierarchy. */
static bool is_of_hierarchy(const struct hierarchy *h, const char *controllers)
{
    if (*controllers == '\0')
        return strcmp(h->type, "cgroup2") == 0;
    return strcmp(h->type, "cgroup") == 0 &&
           has_word(h->options, controllers, strcspn(controllers, ","));
}

/* Applies the limits of a group and of all groups above it, as far as they are mounted. */
static void apply_groups(const struct hierarchy *h, const char *group)
{
    const size_t top = strcmp(h->top, "/") == 0 ? 0 : strlen(h->top);
    const bool below = strncmp(group, h->top, top) == 0 && (group[top] == '/' || !group[top]);
    char *path = NULL;
    const int length = asprintf(&path, "%s%s", h->root, h->mount);
    if (length < 0)
        return;
    apply_group(h->machine, path);
    free(path);
    if (!below || asprintf(&path, "%s%s%s", h->root, h->mount, group + top) < 0)
        return;
    for (char *slash; strlen(path) > (size_t)length; *slash = '\0') {
        apply_group(h->machine, path);
        slash = strrchr(path, '/');
    }
    free(path);
}

/* Takes a line of /proc/self/cgroup: "number:controllers:group". */
static void take_group(void *arg, char *line)
{
    const struct hierarchy *h = arg;
    char *rest = line;
    strsep(&rest, ":");
    const char *controllers = strsep(&rest, ":");
    if (rest && is_of_hierarchy(h, controllers))
        apply_groups(h, rest);
}

/* Replaces \\ooo, which stands for blanks and the like in paths of mounts. */
static void unescape(char *text)
{
    char *to = text;
    for (; *text; text++) {
        unsigned byte;
        if (*text == '\\' && sscanf(text + 1, "%3o", &byte) == 1) {
            *to++ = (char)byte;
            text += 3;
        } else {
            *to++ = *text;
        }
    }
    *to = '\0';
}

/* Takes a line of /proc/self/mountinfo: "id parent device top mount ... - type source options". */
static void take_mount(void *arg, char *line)
{
    struct bsq_machine *machine = ((struct hierarchy *)arg)->machine;
    const char *root = ((struct hierarchy *)arg)->root;
    char *fields[5] = {0}, *tail = strstr(line, " - "), *path = NULL;
    if (!tail)
        return;
    *tail = '\0';
    tail += 3;
    for (int i = 0; i < 5; i++)
        fields[i] = strsep(&line, " ");
    const char *type = strsep(&tail, " ");
    strsep(&tail, " ");
    if (!fields[4] || !tail || strncmp(type, "cgroup", 6) != 0)
        return;
    unescape(fields[3]);
    unescape(fields[4]);
    struct hierarchy hierarchy = {root, fields[3], fields[4], type, tail, machine};
    if (asprintf(&path, "%s/proc/self/cgroup", root) < 0)
        return;
    for_each_line(path, take_group, &hierarchy);
    free(path);
}

void bsq_apply_control_groups(const char *root, struct bsq_machine *machine)
{
    struct hierarchy hierarchy = {.root = root, .machine = machine};
    char *path = NULL;
    if (asprintf(&path, "%s/proc/self/mountinfo", root) < 0)
        return;
    for_each_line(path, take_mount, &hierarchy);
    free(path);
}

/* ---- all ---- */

/* Returns the number of processors that threads of this process may run on. */
static unsigned allowed_processors(void)
{
    /* A fixed cpu_set_t ends at 1024 processors, so the set grows until the kernel's fits. */
    for (int limit = 1024; limit <= 1 << 20; limit *= 2) {
        cpu_set_t *set = CPU_ALLOC(limit);
        if (!set)
            break;
        size_t size = CPU_ALLOC_SIZE(limit);
        int failed = sched_getaffinity(0, size, set);
        int count = failed ? 0 : CPU_COUNT_S(size, set);
        CPU_FREE(set);
        if (!failed && count > 0)
            return (unsigned)count;
        if (failed && errno != EINVAL)
            break;
    }
    return 1;
}

void bsq_machine(struct bsq_machine *out)
{
    long pages = sysconf(_SC_PHYS_PAGES), page_size = sysconf(_SC_PAGE_SIZE);
    out->memory_bytes = UINT64_C(4) << 30;
    if (pages > 0 && page_size > 0)
        out->memory_bytes = (uint64_t)pages * (uint64_t)page_size;
    out->processors = allowed_processors();
    bsq_apply_control_groups("", out);
}
