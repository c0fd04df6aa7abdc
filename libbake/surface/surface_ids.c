/* surface_ids.c - the ids of a scan, and the names that they stand for. */
#include <stdlib.h>
#include <string.h>

#include "base/ids.h"
#include "base/sort_array.h"
#include "libbake/surface/surface.h"

int bake_surface_use_ids(struct bake_surface *surface, bool use)
{
    int status = 0;
    for (uint32_t s = 0; s < surface->scan_count && status == 0; s++) {
        struct bake_scan *scan = &surface->scans[s];
        if (use && scan->exact && scan->ids != BSQ_IDS_NONE)
            status = bake_exact_use_ids(scan->exact);
        if (!use && !scan->exact)
            scan->grid.ids = NULL;
    }
    return status;
}

/* The report's list while it grows. */
struct listing {
    struct bsq_ctx *ctx;
    struct bake_report *report;
    uint64_t capacity;
};

/* Makes space for one more entry. */
static bool reserve(struct listing *list)
{
    if (list->report->id_count < list->capacity)
        return true;
    const uint64_t capacity = 2 * list->capacity + 16;
    struct bake_id *grown = realloc(list->report->ids, capacity * sizeof *grown);
    if (!grown)
        return false;
    list->report->ids = grown;
    list->capacity = capacity;
    return true;
}

static int add_name(void *arg, const char *name)
{
    struct listing *list = arg;
    const uint32_t id = bsq_name_id(name);
    char *copy = reserve(list) ? strdup(name) : NULL;
    if (!copy)
        return bsq_fail(list->ctx, BSQ_ENOMEM, "no memory for the names of ids");
    list->report->ids[list->report->id_count++] =
        (struct bake_id){copy, {(uint8_t)id, (uint8_t)(id >> 8), (uint8_t)(id >> 16)}};
    return bsq_check(list->ctx);
}

static int by_name(const void *a, const void *b)
{
    return strcmp(*(const char *const *)a, *(const char *const *)b);
}

/* Lists the names of materials of a chunk file, which may repeat. */
static int list_exact(struct listing *list, const struct bake_exact *exact)
{
    const char **names;
    uint64_t count = 0, end = 0;
    while (bake_exact_id_name(exact, (uint32_t)end))
        end++;
    int status = bsq_alloc(list->ctx, "names of ids", end + 1, sizeof *names, &names);
    if (status < 0)
        return status;
    for (; count < end; count++)
        names[count] = bake_exact_id_name(exact, (uint32_t)count);
    names[count++] = ""; /* triangles without a material */
    bsq_sort(names, count, sizeof *names, by_name);
    for (uint64_t i = 0; i < count && status == 0; i++)
        if (i == 0 || strcmp(names[i], names[i - 1]) != 0)
            status = add_name(list, names[i]);
    bsq_free(list->ctx, (void *)names);
    return status;
}

/* Lists the names of one scan, each once and ascending. */
static int list_scan(struct listing *list, const struct bake_scan *scan)
{
    return scan->exact ? list_exact(list, scan->exact)
                       : fmt_nvdb_read_names(list->ctx, &scan->grid, add_name, list);
}

static int by_id_name(const void *a, const void *b)
{
    return strcmp(((const struct bake_id *)a)->name, ((const struct bake_id *)b)->name);
}

/* Joins the lists of several scans: sorts the names, and keeps each once. */
static void join_names(struct bake_report *report)
{
    uint64_t kept = 0;
    bsq_sort(report->ids, report->id_count, sizeof *report->ids, by_id_name);
    for (uint64_t i = 0; i < report->id_count; i++)
        if (kept > 0 && strcmp(report->ids[kept - 1].name, report->ids[i].name) == 0)
            free(report->ids[i].name);
        else
            report->ids[kept++] = report->ids[i];
    report->id_count = kept;
}

int bake_surface_report_ids(const struct bake_surface *surface, struct bake_report *report)
{
    struct listing list = {.ctx = surface->ctx, .report = report};
    int status = 0;
    report->id_source = bsq_ids_text(surface->ids);
    if (surface->ids == BSQ_IDS_COLOR)
        return 0;
    for (uint32_t s = 0; s < surface->scan_count && status == 0; s++)
        status = list_scan(&list, &surface->scans[s]);
    if (surface->scan_count > 1)
        join_names(report);
    return status;
}
