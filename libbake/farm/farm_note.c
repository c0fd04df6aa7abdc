/* farm_note.c - notes that tiles are merged.
 *
 * A note is for the program that wrote it. It has the plan's id, a checksum of the sizes, times and
 * names of the files, what the whole bake found, and thumbnails. Files that were touched since are
 * merged again, which gives the same bytes. */
#include <stdlib.h>
#include <string.h>
#include <xxhash.h>

#include "base/output.h"
#include "libbake/farm/farm.h"

enum { THUMBNAILS = 3 };

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
static bool begin(const struct bake_farm_plan *plan, const struct bake_farm_note *note,
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

static int write_note(struct bsq_output *output, struct head *head,
                      const struct bake_farm_note *note)
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

int bake_farm_note_write(const struct bake_farm_plan *plan, const struct bake_farm_note *note)
{
    struct bsq_output *output = NULL;
    struct head head = {0};
    char *path;
    int status;
    BSQ_TRY(bake_farm_path(plan, "merged", note->number, &path));
    if (!begin(plan, note, &head))
        BSQ_TRY(bsq_fail(plan->ctx, BSQ_EIO, "%s: an output is gone", plan->path));
    BSQ_TRY(bsq_output_open(plan->ctx, path, &output));
    BSQ_TRY(write_note(output, &head, note));
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
                           const struct head *head, struct bake_farm_note *note)
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

int bake_farm_note_read(const struct bake_farm_plan *plan, struct bake_farm_note *note, bool *kept)
{
    struct bsq_file file = BSQ_FILE_CLOSED;
    struct head head, now = {0};
    const bool all = begin(plan, note, &now);
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
