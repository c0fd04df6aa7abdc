/* farm_merge.c - merges the parts of a bake in tasks: each UDIM tile alone, or all that are not
 * merged yet, and then the preview.
 *
 * The ranges of maps follow from all texels. The parts have exact sums of them in their headers, so
 * a tile needs the texels of no other tile. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <xxhash.h>

#include "base/output.h"
#include "libbake/farm/farm.h"

/* ---- notes ----
 *
 * A note is for the program that wrote it. It has the plan's id, a checksum of the sizes, times and
 * names of the files, what the whole bake found, and thumbnails. Files that were touched since are
 * merged again, which gives the same bytes. */

enum { THUMBNAILS = 3 };

/* The note that a tile is merged, so that doing it again costs nothing. The note of the preview has
 * the number after the last tile. */
struct note {
    uint32_t number;
    char **paths; /* the files that the merge wrote */
    uint32_t path_count;
    struct bake_farm_counts counts; /* of the whole bake */
    /* The note keeps the tile's thumbnails for the preview, which another process renders: normals,
     * colours and misses. Some may have no texels; when a note is read, all have none at first. */
    bool with_thumbnails;
    struct bake_thumbnail *thumbnails[THUMBNAILS];
    uint32_t most_side; /* in texels; larger thumbnails are not read */
};

struct head {
    char magic[8];
    char plan_id[32];
    uint64_t files; /* checksum */
    struct bake_farm_counts counts;
    uint32_t sizes[THUMBNAILS][5]; /* the first members of the thumbnails; zeros: there is none */
    uint32_t reserved;
    uint64_t texels;   /* checksum of the thumbnails, which follow */
    uint64_t checksum; /* of all above */
};
static const char magic[8] = "BSQMERG\n";
_Static_assert(offsetof(struct bake_thumbnail, texels) >= 5 * sizeof(uint32_t), "sizes are first");

static uint64_t bytes_of(const struct bake_thumbnail *thumbnail)
{
    return (uint64_t)thumbnail->width * thumbnail->height * sizeof *thumbnail->texels;
}

static uint64_t checksum_of(const struct head *head)
{
    return XXH3_64bits(head, offsetof(struct head, checksum));
}

/* Adds the texels of a thumbnail to a checksum. */
static uint64_t add_texels(uint64_t checksum, const struct bake_thumbnail *thumbnail)
{
    return XXH3_64bits_withSeed(thumbnail->texels, bytes_of(thumbnail), checksum);
}

/* Fills in what tells the note of these files, as they are now, from others. Returns false if one
 * is missing. */
static bool begin_head(const struct bake_farm_plan *plan, const struct note *note,
                       struct head *head)
{
    bool all = true;
    memset(head, 0, sizeof *head);
    memcpy(head->magic, magic, sizeof magic);
    memcpy(head->plan_id, plan->id, sizeof head->plan_id);
    for (uint32_t i = 0; i < note->path_count; i++) {
        const struct bsq_identity found = bsq_find_identity(note->paths[i]);
        const char *name = bsq_file_name(note->paths[i]);
        const uint64_t file[] = {head->files, found.size, (uint64_t)found.modified.tv_sec,
                                 (uint64_t)found.modified.tv_nsec, XXH3_64bits(name, strlen(name))};
        head->files = XXH3_64bits(file, sizeof file);
        all &= found.inode != 0;
    }
    return all;
}

static int put_note(struct bsq_output *output, struct head *head, const struct note *note)
{
    int status;
    for (int i = 0; i < THUMBNAILS && note->with_thumbnails; i++)
        if (note->thumbnails[i]->texels) {
            memcpy(head->sizes[i], note->thumbnails[i], sizeof head->sizes[i]);
            head->texels = add_texels(head->texels, note->thumbnails[i]);
        }
    head->counts = note->counts;
    head->checksum = checksum_of(head);
    BSQ_TRY(bsq_output_write(output, head, sizeof *head));
    for (int i = 0; i < THUMBNAILS && note->with_thumbnails; i++)
        if (note->thumbnails[i]->texels)
            BSQ_TRY(bsq_output_write(output, note->thumbnails[i]->texels,
                                     bytes_of(note->thumbnails[i])));
done:
    return status;
}

/* Writes the note, with the sizes and times of the files. */
static int write_note(const struct bake_farm_plan *plan, const struct note *note)
{
    struct bsq_output *output = NULL;
    struct head head = {0};
    char *path;
    int status;
    BSQ_TRY(bake_farm_path(plan, "merged", note->number, &path));
    if (!begin_head(plan, note, &head))
        BSQ_TRY(bsq_fail(plan->ctx, BSQ_EIO, "%s: an output is gone", plan->path));
    BSQ_TRY(bsq_output_open(plan->ctx, path, &output));
    BSQ_TRY(put_note(output, &head, note));
    status = bsq_output_commit(output);
    output = NULL;
done:
    bsq_output_discard(output);
    free(path);
    return status;
}

/* Reads the thumbnails. Returns BSQ_EDATA if there are none, or if they are too large or damaged.
 */
static int read_thumbnails(const struct bake_farm_plan *plan, const struct bsq_file *file,
                           const struct head *head, struct note *note)
{
    uint64_t at = sizeof *head, checksum = 0;
    int status = head->sizes[THUMBNAILS - 1][0] > 0 ? 0 : BSQ_EDATA;
    for (int i = 0; i < THUMBNAILS && status == 0; i++) {
        struct bake_thumbnail *out = note->thumbnails[i];
        memcpy(out, head->sizes[i], sizeof head->sizes[i]);
        if (out->width == 0)
            continue;
        if (out->width > note->most_side || out->height > note->most_side ||
            bytes_of(out) > file->size - at)
            return BSQ_EDATA;
        BSQ_TRY(bsq_alloc(plan->ctx, "texture of the preview", 1, bytes_of(out), &out->texels));
        BSQ_TRY(bsq_file_read(plan->ctx, file, out->texels, bytes_of(out), at));
        at += bytes_of(out);
        checksum = add_texels(checksum, out);
    }
    return status == 0 && checksum != head->texels ? BSQ_EDATA : status;
done:
    return status;
}

/* Sets *kept if there is a note that these files were merged from the plan, and they were not
 * touched since. Then sets the counts, and the thumbnails if they are asked for. Errors:
 * BSQ_ENOMEM, BSQ_EINTR. */
static int read_note(const struct bake_farm_plan *plan, struct note *note, bool *kept)
{
    struct bsq_file file = BSQ_FILE_CLOSED;
    struct head head, now = {0};
    const bool all = begin_head(plan, note, &now);
    char *path;
    int status;
    BSQ_TRY(bake_farm_path(plan, "merged", note->number, &path));
    BSQ_TRY(bsq_file_open_as(plan->ctx, path, BSQ_OPEN_OTHER, &file));
    BSQ_TRY(bsq_file_read(plan->ctx, &file, &head, sizeof head, 0));
    if (!all || memcmp(&head, &now, offsetof(struct head, counts)) != 0 ||
        checksum_of(&head) != head.checksum)
        BSQ_TRY(BSQ_EDATA);
    note->counts = head.counts;
    if (note->with_thumbnails)
        status = read_thumbnails(plan, &file, &head, note);
done:
    bsq_file_close(plan->ctx, &file);
    free(path);
    *kept = status == 0;
    if (status == BSQ_ENOMEM || status == BSQ_EINTR)
        return status;
    bsq_clear_error(plan->ctx);
    return 0;
}

/* ---- a merge ---- */

struct merge {
    struct bake_work *job;
    const struct bake_farm_plan *plan;
    uint32_t tile; /* BAKE_ALL_TILES: all, and the preview */
    bool force;
    struct bake_farm_counts counts;
};

static bool is_whole(const struct merge *merge)
{
    return merge->tile == BAKE_ALL_TILES;
}

/* ---- what was merged before ---- */

static void free_paths(struct note *note)
{
    for (uint32_t i = 0; i < note->path_count; i++)
        free(note->paths[i]);
    free(note->paths);
}

/* Prepares the note of a tile or, after the last tile, of the preview. Free it with free_paths().
 */
static int begin_note(const struct merge *merge, uint32_t number, struct note *note)
{
    struct bake_work *job = merge->job;
    struct bake_tile *tile = number < job->udim.count ? &job->tiles[number] : NULL;
    const unsigned end = tile ? bake_files_end(job->options, job->maps) : 1;
    bool good;
    *note = (struct note){.number = number, .paths = calloc(end, sizeof *note->paths)};
    good = note->paths != NULL;
    for (unsigned i = 0; good && i < end; i++)
        if (!tile || bake_has_file(&tile->options, job->maps, i))
            good = (note->paths[note->path_count++] =
                        tile ? bake_path_of(&tile->options, i)
                             : strdup(merge->plan->options.preview_path)) != NULL;
    if (tile) {
        note->thumbnails[0] = &tile->normal;
        note->thumbnails[1] = &tile->color;
        note->thumbnails[2] = &tile->missed;
    }
    return good ? 0 : bsq_fail(job->ctx, BSQ_ENOMEM, "%s: out of memory", merge->plan->path);
}

/* Sets *kept: whether a tile or the preview was merged before. side: of thumbnails that the preview
 * needs, or 0. */
static int find_kept(struct merge *merge, uint32_t number, uint32_t side, bool *kept)
{
    struct note note;
    int status = begin_note(merge, number, &note);
    note.most_side = side;
    note.with_thumbnails = side > 0;
    *kept = false;
    if (status == 0 && !merge->force)
        status = read_note(merge->plan, &note, kept);
    if (*kept)
        merge->counts = note.counts;
    for (int i = 0; i < 3 && !*kept && note.thumbnails[i]; i++)
        bake_thumbnail_free(merge->job->ctx, note.thumbnails[i]);
    free_paths(&note);
    return status;
}

/* Finds out what is to be done. *all: nothing is. */
static int find_all_kept(struct merge *merge, bool *all)
{
    struct bake_work *job = merge->job;
    uint32_t side = 0;
    int status = 0;
    job->keeps_preview = !job->options->preview_path || !is_whole(merge);
    if (!job->keeps_preview)
        BSQ_TRY(find_kept(merge, job->udim.count, 0, &job->keeps_preview));
    *all = job->keeps_preview;
    if (!job->keeps_preview)
        side = bake_preview_texture_side(job);
    for (uint32_t i = 0; i < job->udim.count; i++) {
        job->tiles[i].kept = !is_whole(merge) && i != merge->tile;
        if (!job->tiles[i].kept)
            BSQ_TRY(find_kept(merge, i, side, &job->tiles[i].kept));
        *all &= job->tiles[i].kept;
    }
done:
    return status;
}

/* Notes what was written. keeps_preview: the preview was kept. */
static int note_merged(const struct merge *merge)
{
    const struct bake_work *job = merge->job;
    int status = 0;
    for (uint32_t i = 0; i <= job->udim.count && status == 0; i++) {
        struct note note;
        if (i < job->udim.count ? job->tiles[i].kept : job->keeps_preview)
            continue;
        status = begin_note(merge, i, &note);
        note.counts = merge->counts;
        note.with_thumbnails = !is_whole(merge) && job->options->preview_path;
        if (status == 0)
            status = write_note(merge->plan, &note);
        free_paths(&note);
    }
    return status;
}

/* ---- merging ---- */

/* Checks the parts, and notes what all tasks found. */
static int use_parts(struct merge *merge)
{
    struct bake_work *job = merge->job;
    struct bake_report *report = job->report;
    struct bake_farm_found found;
    int status = bake_farm_parts_check(merge->plan, &found);
    merge->counts = found.counts;
    memcpy(job->measures.statistics, found.statistics, sizeof found.statistics);
    report->degenerate_uv_triangles = merge->plan->degenerate_triangles;
    report->covered_texels = found.counts.covered_texels;
    report->overlapping_samples = found.counts.overlapping_samples;
    snprintf(report->device, sizeof report->device, "%u tasks", merge->plan->tasks);
    return status;
}

/* Sets what a merge reports also if it is kept, and warns as a bake does. */
static int report_counts(const struct merge *merge)
{
    struct bake_work *job = merge->job;
    const struct bake_farm_counts *counts = &merge->counts;
    const struct bake_curvature_counts curvature = {counts->curvature_texels,
                                                    counts->curvature_alone};
    job->report->samples = counts->samples;
    job->report->hits = counts->hits;
    job->report->misses = counts->samples - counts->hits;
    const int status = bake_check_hits(job);
    if (status < 0 || !(job->maps & BAKE_MAP_CURVATURE))
        return status;
    bake_choose_radius(job); /* which the plan has */
    return bake_warn_of_radius(job->ctx, &curvature, job->measures.curvature_radius);
}

/* Writes the maps of a tile. Its image takes at most half of the memory that is left, as in a bake
 * without tasks. */
static int merge_tile(struct merge *merge, uint32_t number, uint32_t side, uint64_t *limited)
{
    struct bake_work *job = merge->job;
    struct bake_tile *tile = &job->tiles[number];
    int status;
    BSQ_TRY(
        bake_tile_create_image(job->ctx, tile, bsq_memory_share(job->ctx, "image of a tile", 2)));
    BSQ_TRY(bake_farm_parts_read(merge->plan, number, tile->image));
    status = bake_write_tile(job, tile, side, limited);
done:
    return status;
}

static int write_maps(struct merge *merge)
{
    struct bake_work *job = merge->job;
    const uint32_t side = job->options->preview_path ? bake_preview_texture_side(job) : 0;
    uint64_t *limited = NULL;
    int status;
    BSQ_TRY(bsq_calloc(job->ctx, "maps", bake_files_end(job->options, job->maps), sizeof *limited,
                       &limited));
    for (uint32_t i = 0; i < job->udim.count; i++)
        if (!job->tiles[i].kept)
            BSQ_TRY(merge_tile(merge, i, side, limited));
    status = bake_warn_limited(job->ctx, job->options, job->maps, limited);
done:
    bsq_free(job->ctx, limited);
    return status;
}

static int merge_parts(struct merge *merge, bool *kept)
{
    struct bake_work *job = merge->job;
    int status;
    BSQ_TRY(bake_farm_open_job(job, merge->plan));
    BSQ_TRY(find_all_kept(merge, kept));
    if (!*kept) {
        BSQ_TRY(bake_check_outputs(job, NULL));
        BSQ_TRY(use_parts(merge));
    }
    BSQ_TRY(report_counts(merge));
    if (*kept)
        goto done;
    for (uint32_t i = 0; i < job->udim.count; i++)
        if (!job->tiles[i].kept)
            BSQ_TRY(bake_farm_check_output(merge->plan, "merged", i));
    BSQ_TRY(bake_open_outputs(job));
    BSQ_TRY(bake_udim_arrange(job->ctx, job->options, &job->udim, &job->mesh));
    BSQ_TRY(write_maps(merge));
    BSQ_TRY(bake_write_preview(job));
    BSQ_TRY(bake_surface_check(&job->surface));
    BSQ_TRY(bake_commit_outputs(job));
    status = note_merged(merge);
done:
    return status;
}

int bake_merge_plan(struct bsq_ctx *ctx, const struct bake_farm_plan *plan, uint32_t tile,
                    bool force, bool *kept, struct bake_report *report)
{
    struct merge merge = {.plan = plan, .tile = tile, .force = force};
    *kept = false;
    if (bsq_clear_report(ctx, "bake_report", report, sizeof *report) < 0)
        return BSQ_EUSAGE;
    if (tile != BAKE_ALL_TILES && tile >= plan->tile_count)
        return bsq_fail(ctx, BSQ_EUSAGE, "%s: there is no tile %u: tiles are 0 to %u", plan->path,
                        tile, plan->tile_count - 1);
    int status = bake_begin_job(ctx, &plan->options, report, &merge.job);
    return status < 0 ? status : bake_end_job(merge.job, merge_parts(&merge, kept));
}
