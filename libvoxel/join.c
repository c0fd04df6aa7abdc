/* join.c - writes chunk files as one, and gives it vertex normals.
 *
 * Files are ordered by their content, so the order in which they are given does not matter. Only
 * one is open at a time, so there may be any number. Their chunks are made equal: materials are
 * numbered over all files, and attributes that only other files have get the values that sorting
 * gives to meshes without them. */
#include "base/context.h"
#include "base/job_files.h"
#include "base/parallel.h"
#include "base/sort_array.h"
#include "libvoxel/normals/normals.h"
#include "libvoxel/temp_tris.h"

#include <string.h>

/* One of the chunk files. */
struct join_part {
    const char *name;            /* its path, or what messages call the temporary file */
    const struct bsq_file *temp; /* NULL, or the temporary file */
    struct fmt_tris_file *file;  /* released: it has header and table */
    uint32_t first_material;     /* number of its first material in the new file */
};

/* A chunk under way: that of the slot's sequence number. */
struct join_slot {
    uint64_t size;
    void *scratch, *encoded;
    struct fmt_tris_chunk_info info;
};

struct joining {
    struct bsq_ctx *ctx;
    const struct vox_join_options *options;
    struct join_part *parts;
    uint32_t part_count;
    struct fmt_tris_header header;   /* of the new file */
    struct fmt_tris_source *sources; /* of its materials */
    enum bsq_scan_normals weights;   /* of the normals that it gets; FLAT: none */
    struct fmt_tris_writer *writer;
    uint64_t output_bytes, load_bytes, encoded_bytes; /* of all chunks; of the largest ones */
    struct join_slot *slots;
    uint64_t slot_count;
    float (*zeros)[2]; /* what a chunk without texture coordinates or fine colours gets */
    uint32_t *ones;    /* what one without colours or materials gets */
    /* The part that is being copied: */
    const struct join_part *part;
    const struct fmt_tris_file *open;
};

/* ---- opening ---- */

static const struct fmt_tris_header *join_header_of(const struct joining *j, uint32_t part)
{
    return fmt_tris_get_header(j->parts[part].file);
}

static int join_open(const struct joining *j, const struct join_part *part,
                     struct fmt_tris_file **out)
{
    return part->temp ? fmt_tris_open_temp(j->ctx, part->temp, out)
                      : fmt_tris_open(j->ctx, part->name, out);
}

/* Orders parts by their content, the largest first. */
static int compare_parts(const void *a, const void *b)
{
    const struct join_part *one = a, *two = b;
    const uint64_t x = fmt_tris_get_header(one->file)->triangle_count,
                   y = fmt_tris_get_header(two->file)->triangle_count;
    const uint64_t p = fmt_tris_checksum(one->file), q = fmt_tris_checksum(two->file);
    return x != y ? (x > y ? -1 : 1) : p != q ? (p < q ? -1 : 1) : strcmp(one->name, two->name);
}

/* Opens all parts once, and puts them in order. */
static int join_open_parts(struct joining *j)
{
    const struct vox_join_options *options = j->options;
    const bool mesh = options->temp_tris && options->temp_tris->file.fd >= 0;
    const uint64_t count = (uint64_t)options->tris_count + mesh;
    BSQ_PASS(BSQ_CALLOC(j->ctx, "chunk files", count, &j->parts));
    for (uint32_t i = 0; i < count; i++) {
        struct join_part *part = &j->parts[j->part_count++];
        part->name = i < options->tris_count ? options->tris_paths[i] : "the mesh";
        part->temp = i < options->tris_count ? NULL : &options->temp_tris->file;
        BSQ_PASS(join_open(j, part, &part->file));
        fmt_tris_release(part->file);
    }
    bsq_sort(j->parts, j->part_count, sizeof *j->parts, compare_parts);
    return 0;
}

/* ---- the header ---- */

/* Checks what all parts must have like the first one: one origin; normals, or none, because smooth
 * normals need the whole scan. */
static int check_part(const struct joining *j, uint32_t i)
{
    const struct fmt_tris_header *first = join_header_of(j, 0), *header = join_header_of(j, i);
    const char *name = j->parts[i].name, *first_name = j->parts[0].name;
    const bool has = header->attributes & FMT_TRIS_NORMALS;
    for (int axis = 0; axis < 3; axis++)
        if (header->origin[axis] < first->origin[axis] ||
            header->origin[axis] > first->origin[axis])
            return bsq_fail(j->ctx, BSQ_EDATA,
                            "%s and %s have different origins: sort one of them again with "
                            "--origin %.17g,%.17g,%.17g",
                            first_name, name, first->origin[0], first->origin[1], first->origin[2]);
    if (has != !!(first->attributes & FMT_TRIS_NORMALS))
        return bsq_fail(j->ctx, BSQ_EDATA,
                        "%s has normals, %s has none: such parts cannot be one scan",
                        has ? name : first_name, has ? first_name : name);
    return 0;
}

/* Returns whether some triangles have a material's colour that is no texture's, and not white. */
static bool has_material_color(const struct fmt_tris_header *part)
{
    bool any = false;
    for (uint32_t i = 0; part->attributes & FMT_TRIS_MATERIALS && i < part->material_count; i++) {
        const struct fmt_tris_material *m = &part->materials[i];
        const bool white = m->diffuse[0] == 1.0f && m->diffuse[1] == 1.0f && m->diffuse[2] == 1.0f;
        any |= !m->texture_path && !m->colorless && !white;
    }
    return any;
}

/* Warns of parts without vertex colours beside others with such colours: of those that have
 * colours of materials instead, which are lost, and of the others. */
static int join_compare_colors(const struct joining *j)
{
    const char *names[2] = {NULL, NULL};
    unsigned long long counts[2] = {0, 0};
    for (uint32_t i = 0; i < j->part_count; i++) {
        const struct fmt_tris_header *part = join_header_of(j, i);
        const bool lossy = has_material_color(part);
        if (part->attributes & FMT_TRIS_COLORS)
            continue;
        names[lossy] = counts[lossy]++ == 0 ? j->parts[i].name : names[lossy];
    }
    if (!(j->header.attributes & FMT_TRIS_COLORS))
        return 0;
    if (names[false])
        bsq_warn(j->ctx,
                 "%s: no vertex colours, so what has no texture is white; other parts of the scan "
                 "have vertex colours; parts like this: %llu",
                 names[false], counts[false]);
    if (names[true])
        return bsq_warn_loss(j->ctx,
                             "%s: colours of materials are not used, because other parts of the "
                             "scan have vertex colours; parts like this: %llu",
                             names[true], counts[true]);
    return 0;
}

/* Fails if a part has no ids of the kind of the first one. */
static int require_ids(const struct joining *j, uint32_t i)
{
    const enum fmt_ids first = join_header_of(j, 0)->ids, ids = join_header_of(j, i)->ids;
    if (first == FMT_IDS_NONE || ids == FMT_IDS_NONE)
        return bsq_fail(j->ctx, BSQ_EDATA,
                        "%s has no ids: make it with bisque-voxelize --channels id",
                        j->parts[ids == FMT_IDS_NONE ? i : 0].name);
    return ids == first
               ? 0
               : bsq_fail(j->ctx, BSQ_EDATA, "%s has ids by %s, %s by %s: make both with one --id",
                          j->parts[0].name, fmt_ids_text(first), j->parts[i].name,
                          fmt_ids_text(ids));
}

/* Returns a part without a channel, or NULL. */
static const struct join_part *find_lacking(const struct joining *j, const char *channel)
{
    for (uint32_t i = 0; i < j->part_count; i++)
        if (fmt_tris_find_channel(join_header_of(j, i), channel) == UINT32_MAX)
            return &j->parts[i];
    return NULL;
}

/* Keeps ids of one kind that all parts have, the channels that all parts have, and a normal map of
 * any part: the others then have none. Warns of others if the output is to be kept. */
static int join_channels(struct joining *j)
{
    struct fmt_tris_header *all = &j->header;
    const struct fmt_tris_header *first = join_header_of(j, 0);
    all->ids = first->ids;
    BSQ_PASS(BSQ_ALLOC(j->ctx, "channels", (uint64_t)first->channel_count + 1, &all->channels));
    for (uint32_t i = 0; i < j->part_count; i++) {
        const struct fmt_tris_header *part = join_header_of(j, i);
        const char *name = j->parts[i].name;
        BSQ_PASS(j->options->ids ? require_ids(j, i) : 0);
        if (part->ids != first->ids && !j->options->temporary)
            BSQ_PASS(bsq_warn_loss(j->ctx,
                                   "ids are not kept, because %s and %s do not have the same kind",
                                   j->parts[0].name, name));
        all->ids = part->ids != first->ids ? FMT_IDS_NONE : all->ids;
        for (uint32_t c = 0; c < part->channel_count; c++) {
            char *channel = part->channels[c];
            const struct join_part *lacking =
                strcmp(channel, FMT_CHANNEL_NORMAL_MAP) == 0 ? NULL : find_lacking(j, channel);
            if (lacking && !j->options->temporary)
                BSQ_PASS(bsq_warn_loss(j->ctx,
                                       "%s: the channel %s is not kept, because %s has none", name,
                                       channel, lacking->name));
            if (!lacking && fmt_tris_find_channel(all, channel) == UINT32_MAX)
                all->channels[all->channel_count++] = channel;
        }
    }
    return 0;
}

/* Numbers the materials of all parts, with their sources of the channels that are kept. */
static int join_materials(struct joining *j, uint64_t count)
{
    struct fmt_tris_header *all = &j->header;
    const uint32_t channels = all->channel_count;
    if (count >= UINT32_MAX)
        return bsq_fail(j->ctx, BSQ_EDATA, "%s: too many materials in all parts", j->parts[0].name);
    BSQ_PASS(BSQ_ALLOC(j->ctx, "materials", count + 1, &all->materials));
    BSQ_PASS(BSQ_CALLOC(j->ctx, "channels", count * channels + 1, &j->sources));
    for (uint32_t i = 0; i < j->part_count; i++) {
        const struct fmt_tris_header *part = join_header_of(j, i);
        j->parts[i].first_material = all->material_count;
        for (uint32_t m = 0; m < part->material_count; m++) {
            struct fmt_tris_material *to = &all->materials[all->material_count];
            *to = part->materials[m];
            to->sources = j->sources + (uint64_t)all->material_count++ * channels;
            for (uint32_t c = 0; c < channels; c++) {
                const uint32_t own = fmt_tris_find_channel(part, all->channels[c]);
                if (own != UINT32_MAX)
                    to->sources[c] = part->materials[m].sources[own];
            }
        }
    }
    return 0;
}

/* Returns the weights of the normals that the new file gets, FLAT for none. */
static enum bsq_scan_normals join_weights(const struct joining *j)
{
    enum bsq_scan_normals all = j->options->scan_normals;
    bool any = false;
    for (uint32_t i = 0; i < j->part_count && j->options->scan_normals == BSQ_SCAN_NORMALS_AUTO;
         i++) {
        const enum bsq_scan_normals one = join_header_of(j, i)->made_normals;
        if (j->parts[i].temp)
            continue;
        all = !any || all == one ? one : BSQ_SCAN_NORMALS_SMOOTH;
        any = true;
    }
    return j->header.attributes & FMT_TRIS_NORMALS || all == BSQ_SCAN_NORMALS_AUTO
               ? BSQ_SCAN_NORMALS_FLAT
               : all;
}

/* Makes the header of all parts. */
static int join_headers(struct joining *j)
{
    struct fmt_tris_header *all = &j->header;
    uint64_t materials = 0;
    memcpy(all->origin, join_header_of(j, 0)->origin, sizeof all->origin);
    for (uint32_t i = 0; i < j->part_count; i++) {
        const struct fmt_tris_header *part = join_header_of(j, i);
        BSQ_PASS(check_part(j, i));
        all->attributes |= part->attributes;
        all->embeds_images |= fmt_tris_has_images(j->parts[i].file);
        all->triangle_count += part->triangle_count;
        all->chunk_count += part->chunk_count;
        all->source_faces += part->source_faces;
        all->skipped_triangles += part->skipped_triangles;
        materials += part->material_count;
    }
    BSQ_PASS(join_channels(j));
    BSQ_PASS(join_materials(j, materials));
    j->weights = join_weights(j);
    return join_compare_colors(j);
}

/* ---- chunks ---- */

static int join_produce(void *arg, void *slot, uint64_t sequence)
{
    (void)slot;
    return sequence < fmt_tris_get_header(((const struct joining *)arg)->open)->chunk_count;
}

static int join_work(void *arg, void *slot, uint64_t sequence, unsigned worker)
{
    const struct joining *j = arg;
    struct join_slot *s = slot;
    struct fmt_tris_chunk chunk;
    (void)worker;
    BSQ_PASS(fmt_tris_load(j->open, sequence, s->scratch, &chunk));
    uint32_t *materials = (uint32_t *)chunk.materials; /* in the scratch memory */
    for (uint32_t t = 0; materials && t < chunk.triangle_count; t++)
        materials[t] += materials[t] == UINT32_MAX ? 0 : j->part->first_material;
    chunk.texcoords = chunk.texcoords ? chunk.texcoords : (const float(*)[2])j->zeros;
    chunk.colors = chunk.colors ? chunk.colors : j->ones;
    chunk.fine_colors = chunk.fine_colors ? chunk.fine_colors : (const void *)j->zeros;
    chunk.materials = chunk.materials ? chunk.materials : j->ones;
    return fmt_tris_encode(j->ctx, j->header.attributes, &chunk, s->encoded, &s->size, &s->info);
}

static int join_emit(void *arg, void *slot, uint64_t sequence)
{
    const struct joining *j = arg;
    const struct join_slot *s = slot;
    (void)sequence;
    bsq_progress_add(j->ctx, s->info.triangle_count);
    return fmt_tris_append(j->writer, s->encoded, s->size, &s->info);
}

/* Measures the chunks, and allocates what copying them needs. */
static int join_allocate(struct joining *j)
{
    const uint64_t normal_bytes = j->weights == BSQ_SCAN_NORMALS_FLAT ? 0 : sizeof(uint64_t);
    uint64_t things = 0; /* vertices or triangles of a chunk */
    for (uint32_t i = 0; i < j->part_count; i++) {
        const struct fmt_tris_chunk_info *infos = fmt_tris_chunks(j->parts[i].file);
        const uint64_t load = fmt_tris_load_size_max(j->parts[i].file);
        j->load_bytes = load > j->load_bytes ? load : j->load_bytes;
        for (uint64_t k = 0; k < join_header_of(j, i)->chunk_count; k++) {
            const uint32_t nt = infos[k].triangle_count, nv = infos[k].vertex_count;
            const uint64_t bytes = fmt_tris_encoded_bound(j->header.attributes, nt, nv);
            things = nt > things ? nt : things;
            things = nv > things ? nv : things;
            j->encoded_bytes = bytes > j->encoded_bytes ? bytes : j->encoded_bytes;
            j->output_bytes += bytes + nv * normal_bytes;
        }
    }
    BSQ_PASS(BSQ_CALLOC(j->ctx, "chunks", things + 1, &j->zeros));
    BSQ_PASS(BSQ_ALLOC(j->ctx, "chunks", things + 1, &j->ones));
    memset(j->ones, 0xff, (things + 1) * sizeof *j->ones);
    const uint64_t usual = UINT64_C(2) * bsq_threads(j->ctx),
                   fits = bsq_memory_left(j->ctx) / 2 / (j->load_bytes + j->encoded_bytes + 1);
    j->slot_count = fits < 1 ? 1 : fits < usual ? fits : usual;
    BSQ_PASS(BSQ_CALLOC(j->ctx, "chunks", j->slot_count, &j->slots));
    for (struct join_slot *s = j->slots; s < j->slots + j->slot_count; s++) {
        BSQ_PASS(bsq_alloc(j->ctx, "chunks", j->load_bytes, 1, &s->scratch));
        BSQ_PASS(bsq_alloc(j->ctx, "chunks", j->encoded_bytes, 1, &s->encoded));
    }
    return 0;
}

/* Copies the chunks of a part. */
static int copy_part(struct joining *j, const struct join_part *part)
{
    const struct bsq_pipeline pipeline = {.produce = join_produce,
                                          .work = join_work,
                                          .emit = join_emit,
                                          .arg = j,
                                          .slots = j->slots,
                                          .slot_size = sizeof *j->slots,
                                          .slot_count = (unsigned)j->slot_count};
    struct fmt_tris_file *file = NULL;
    int status;
    BSQ_TRY(join_open(j, part, &file));
    if (fmt_tris_checksum(file) != fmt_tris_checksum(part->file))
        BSQ_TRY(bsq_fail(j->ctx, BSQ_EIO, "%s was changed while it was read", part->name));
    j->part = part;
    j->open = file;
    status = bsq_pipeline_run(j->ctx, &pipeline);
done:
    fmt_tris_close(file);
    return status;
}

/* ---- the whole ---- */

/* Writes the new file, except for its end. */
static int join_write(struct joining *j)
{
    const struct vox_join_options *options = j->options;
    int status = 0;
    BSQ_PASS(bsq_require_space(j->ctx, options->output_path,
                               options->temporary ? 0 : j->output_bytes,
                               options->temporary ? j->output_bytes : 0));
    BSQ_PASS(options->temporary
                 ? fmt_tris_create_temp(j->ctx, options->output_path, &j->header, &j->writer)
                 : fmt_tris_create(j->ctx, options->output_path, &j->header, &j->writer));
    bsq_progress_begin(j->ctx, "writing", "triangles", j->header.triangle_count);
    for (uint32_t i = 0; i < j->part_count && status == 0; i++)
        status = copy_part(j, &j->parts[i]);
    bsq_progress_end(j->ctx);
    BSQ_PASS(status);
    fmt_tris_skip(j->writer, j->header.skipped_triangles);
    if (j->weights != BSQ_SCAN_NORMALS_FLAT)
        return vox_write_normals(j->ctx, j->writer, j->weights, options->output_path);
    return 0;
}

static void report_join(const struct joining *j, struct vox_sort_report *report)
{
    report->triangles = j->header.triangle_count;
    report->chunks = j->header.chunk_count;
    report->has_normals = (j->header.attributes & FMT_TRIS_NORMALS) != 0;
    report->has_texcoords = (j->header.attributes & FMT_TRIS_TEXCOORDS) != 0;
    report->has_colors = (j->header.attributes & FMT_TRIS_COLORS) != 0;
    report->has_fine_colors = (j->header.attributes & FMT_TRIS_FINE_COLORS) != 0;
    memcpy(report->origin, j->header.origin, sizeof report->origin);
}

static void join_free(struct joining *j)
{
    fmt_tris_discard(j->writer);
    for (uint32_t i = 0; i < j->part_count; i++)
        fmt_tris_close(j->parts[i].file);
    for (uint64_t i = 0; j->slots && i < j->slot_count; i++)
        BSQ_FREE(j->ctx, j->slots[i].scratch, j->slots[i].encoded);
    BSQ_FREE(j->ctx, j->parts, j->header.materials, j->header.channels, j->sources, j->slots,
             j->zeros, j->ones);
}

int vox_join(struct bsq_ctx *ctx, const struct vox_join_options *options,
             struct vox_sort_report *report)
{
    const double start = bsq_seconds_now();
    const uint64_t temp_before = bsq_temp_bytes(ctx);
    struct bsq_file made = BSQ_FILE_CLOSED;
    struct joining j = {.ctx = ctx, .options = options};
    int status;
    BSQ_TRY(bsq_clear_report(ctx, "vox_sort_report", report, sizeof *report));
    BSQ_TRY(bsq_check_size(ctx, "vox_join_options", options->size, sizeof *options));
    BSQ_TRY(options->temporary ? 0 : bsq_note_output(ctx, options->output_path));
    BSQ_TRY(join_open_parts(&j));
    BSQ_TRY(join_headers(&j));
    BSQ_TRY(join_allocate(&j));
    BSQ_TRY(join_write(&j));
    report_join(&j, report);
    status = fmt_tris_commit(j.writer, &made);
    j.writer = NULL;
    BSQ_TRY(status);
    report->tris_bytes = made.size;
    if (options->temporary) {
        bsq_file_close(ctx, &options->temp_tris->file);
        options->temp_tris->file = made;
        made = (struct bsq_file)BSQ_FILE_CLOSED;
    }
done:
    bsq_file_close(ctx, &made);
    join_free(&j);
    report->temp_bytes = bsq_temp_bytes(ctx) - temp_before;
    report->seconds_sort = bsq_seconds_now() - start;
    return status;
}
