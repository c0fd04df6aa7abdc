/* tris_parts.c - several chunk files as one scan.
 *
 * The chunks of all files follow each other in one table. Files are ordered by their content, so
 * the order in which they are given does not matter. A file with a name is open only while a chunk
 * of it is loaded, so there may be any number of files. Chunks are made equal when they are loaded:
 * their materials are numbered over all files, and attributes that only other files have get the
 * values that sorting gives to meshes without them. */
#include "formats/chunks/tris_internal.h"

#include <errno.h>
#include <math.h>

#include "formats/material/channels.h"
#include "base/job_files.h"
#include "base/context.h"
#include "base/sort_array.h"

static const char normal_map[] = FMT_CHANNEL_NORMAL_MAP;

/* ---- opening ---- */

/* Opens a part and closes its descriptor. */
static int parts_open_part(struct bsq_ctx *ctx, const char *path, struct tris_part *part)
{
    int status = fmt_tris_open(ctx, path, &part->file);
    if (status < 0)
        return status;
    char *copy = strdup(path);
    if (!copy)
        return bsq_fail_errno(ctx, BSQ_ENOMEM, ENOMEM, "%s", path);
    bsq_file_close(ctx, &part->file->file);
    part->file->file.path = copy;
    return 0;
}

/* Orders parts by their content: a checksum covers every byte of a file. */
static int compare_parts(const void *a, const void *b)
{
    const struct fmt_tris_file *one = ((const struct tris_part *)a)->file;
    const struct fmt_tris_file *two = ((const struct tris_part *)b)->file;
    if (one->header.triangle_count != two->header.triangle_count)
        return one->header.triangle_count > two->header.triangle_count ? -1 : 1;
    if (one->checksum != two->checksum)
        return one->checksum < two->checksum ? -1 : 1;
    return strcmp(one->file.path, two->file.path);
}

/* ---- joining ---- */

/* Either all parts have normals, or none has: smooth normals need the whole scan. */
static int check_normals(const struct fmt_tris_file *all)
{
    const struct fmt_tris_file *first = all->parts[0].file;
    for (uint32_t i = 1; i < all->part_count; i++) {
        const struct fmt_tris_file *file = all->parts[i].file;
        const bool has = file->header.attributes & FMT_TRIS_NORMALS;
        if (has != !!(first->header.attributes & FMT_TRIS_NORMALS))
            return bsq_fail(
                all->ctx, BSQ_EDATA, "%s has normals, %s has none: such parts cannot be one scan",
                has ? file->file.path : first->file.path, has ? first->file.path : file->file.path);
    }
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

/* Warns of parts without vertex colours beside others with such colours. lossy: of those that have
 * colours of materials instead, which are lost; else of the others. */
static int warn_of_colors(const struct fmt_tris_file *all, bool lossy)
{
    const char *path = NULL;
    unsigned long long count = 0;
    for (uint32_t i = 0; i < all->part_count; i++) {
        const struct fmt_tris_file *part = all->parts[i].file;
        if (part->header.attributes & FMT_TRIS_COLORS || has_material_color(&part->header) != lossy)
            continue;
        path = path ? path : part->file.path;
        count++;
    }
    if (count > 0 && lossy)
        return bsq_warn_loss(all->ctx,
                             "%s: colours of materials are not used, because other parts of the "
                             "scan have vertex colours; parts like this: %llu",
                             path, count);
    if (count > 0)
        bsq_warn(all->ctx,
                 "%s: no vertex colours, so what has no texture is white; other parts of the scan "
                 "have vertex colours; parts like this: %llu",
                 path, count);
    return 0;
}

static int parts_compare_colors(const struct fmt_tris_file *all)
{
    if (!(all->header.attributes & FMT_TRIS_COLORS))
        return 0;
    int status = warn_of_colors(all, false);
    return status < 0 ? status : warn_of_colors(all, true);
}

static int join_materials(struct fmt_tris_file *all)
{
    uint64_t count = 0;
    for (uint32_t i = 0; i < all->part_count; i++)
        count += all->parts[i].file->header.material_count;
    if (count >= UINT32_MAX)
        return bsq_fail(all->ctx, BSQ_EDATA, "%s: too many materials in all parts", all->file.path);
    all->header.materials = NULL;
    all->header.material_count = 0;
    int status = bsq_alloc(all->ctx, "materials", count + 1, sizeof *all->header.materials,
                           &all->header.materials);
    for (uint32_t i = 0; i < all->part_count && status == 0; i++) {
        const struct fmt_tris_header *part = &all->parts[i].file->header;
        all->parts[i].first_material = all->header.material_count;
        memcpy(all->header.materials + all->header.material_count, part->materials,
               part->material_count * sizeof *part->materials);
        all->header.material_count += part->material_count;
    }
    return status;
}

/* Returns the number of parts that have a channel. */
static uint32_t parts_with(const struct fmt_tris_file *all, const char *name)
{
    uint32_t count = 0;
    for (uint32_t i = 0; i < all->part_count; i++)
        count += fmt_tris_find_channel(&all->parts[i].file->header, name) != UINT32_MAX;
    return count;
}

/* Keeps the channels that all parts have, in the order of the first part, and the normal map of any
 * part: the others then have none. */
static int join_channels(struct fmt_tris_file *all)
{
    struct fmt_tris_header *header = &all->header;
    const struct fmt_tris_header *first = &all->parts[0].file->header;
    for (uint32_t m = 0; m < header->material_count; m++)
        header->materials[m].sources = NULL;
    int status = bsq_alloc(all->ctx, "channels", (uint64_t)first->channel_count + 1,
                           sizeof *header->channels, &header->channels);
    for (uint32_t c = 0; c < first->channel_count && status == 0; c++)
        if (parts_with(all, first->channels[c]) == all->part_count)
            header->channels[header->channel_count++] = first->channels[c];
    if (status == 0 && parts_with(all, normal_map) > 0 &&
        fmt_tris_find_channel(header, normal_map) == UINT32_MAX)
        header->channels[header->channel_count++] = (char *)(uintptr_t)normal_map;
    return status;
}

/* Gives all materials the sources of the common channels. */
static int join_sources(struct fmt_tris_file *all)
{
    struct fmt_tris_header *header = &all->header;
    const uint64_t count = header->channel_count;
    uint64_t sources;
    if (count == 0)
        return 0;
    if (__builtin_mul_overflow(count, header->material_count + UINT64_C(1), &sources))
        return bsq_fail(all->ctx, BSQ_EDATA, "%s: too many channels in all parts", all->file.path);
    int status = bsq_calloc(all->ctx, "channels", sources, sizeof *all->sources, &all->sources);
    for (uint32_t i = 0; i < all->part_count && status == 0; i++) {
        const struct fmt_tris_header *part = &all->parts[i].file->header;
        for (uint32_t m = 0; m < part->material_count; m++) {
            const uint32_t number = all->parts[i].first_material + m;
            struct fmt_tris_source *to = all->sources + number * count;
            header->materials[number].sources = to;
            for (uint64_t c = 0; c < count; c++) {
                const uint32_t own = fmt_tris_find_channel(part, header->channels[c]);
                if (own != UINT32_MAX)
                    to[c] = part->materials[m].sources[own];
            }
        }
    }
    return status;
}

/* Fails for lack of a channel, or of ids: "id". */
static int fail_without(struct bsq_ctx *ctx, const char *path, const char *channel)
{
    const bool is_channel = strcmp(channel, "id") != 0;
    return bsq_fail(ctx, BSQ_EDATA, "%s has no %s%s: make it with bisque-voxelize --channels %s",
                    path, is_channel ? "channel " : "ids", is_channel ? channel : "", channel);
}

int fmt_tris_require_channel(const struct fmt_tris_file *file, const char *name)
{
    if (fmt_tris_find_channel(&file->header, name) != UINT32_MAX)
        return 0;
    for (uint32_t i = 0; i < file->part_count; i++)
        if (fmt_tris_find_channel(&file->parts[i].file->header, name) == UINT32_MAX)
            return fail_without(file->ctx, file->parts[i].file->file.path, name);
    return fail_without(file->ctx, file->file.path, name);
}

/* Adds a part's chunks to the table and to the bounds. */
static int join_chunks(struct fmt_tris_file *all, struct tris_part *part)
{
    const struct fmt_tris_header *from = &part->file->header;
    struct fmt_tris_header *to = &all->header;
    part->first_chunk = to->chunk_count;
    bool same = true;
    for (int axis = 0; axis < 3; axis++)
        same &= from->origin[axis] == to->origin[axis];
    if (!same)
        return bsq_fail(all->ctx, BSQ_EDATA,
                        "%s and %s have different origins: sort one of them again with --origin "
                        "%.17g,%.17g,%.17g",
                        all->file.path, part->file->file.path, to->origin[0], to->origin[1],
                        to->origin[2]);
    for (uint64_t i = 0; i < from->chunk_count; i++) {
        struct fmt_tris_chunk_info *info = &all->chunks[to->chunk_count++];
        *info = part->file->chunks[i];
        info->crease_count = 0;
        info->first_triangle += to->triangle_count;
        for (int axis = 0; axis < 3; axis++) {
            to->bounds_min[axis] = fminf(to->bounds_min[axis], info->bounds_min[axis]);
            to->bounds_max[axis] = fmaxf(to->bounds_max[axis], info->bounds_max[axis]);
        }
    }
    to->triangle_count += from->triangle_count;
    to->source_faces += from->source_faces;
    to->skipped_triangles += from->skipped_triangles;
    return 0;
}

/* Begins the header: that of the largest part, which is the first, without its contents. Parts
 * whose ids tell different things apart have none together. */
static void begin_header(struct fmt_tris_file *all)
{
    all->header = all->parts[0].file->header;
    all->header.made_normals = 0; /* they lack the other parts' triangles */
    all->header.channels = NULL;  /* each part owns its own */
    all->header.channel_count = 0;
    all->header.materials = NULL;
    all->header.triangle_count = all->header.chunk_count = 0;
    all->header.source_faces = all->header.skipped_triangles = 0;
    for (int axis = 0; axis < 3; axis++) {
        all->header.bounds_min[axis] = INFINITY;
        all->header.bounds_max[axis] = -INFINITY;
    }
    for (uint32_t i = 1; i < all->part_count; i++) {
        const struct fmt_tris_header *part = &all->parts[i].file->header;
        all->header.attributes |= part->attributes;
        if (part->ids != all->parts[0].file->header.ids)
            all->header.ids = FMT_IDS_NONE;
    }
}

int fmt_tris_require_ids(const struct fmt_tris_file *file)
{
    if (file->header.ids != FMT_IDS_NONE)
        return 0;
    if (file->part_count == 0)
        return fail_without(file->ctx, file->file.path, "id");
    const struct fmt_tris_file *first = file->parts[0].file, *other = first;
    for (uint32_t i = 0; i < file->part_count; i++) {
        const struct fmt_tris_file *part = file->parts[i].file;
        if (part->header.ids == FMT_IDS_NONE)
            return fail_without(file->ctx, part->file.path, "id");
        if (part->header.ids != first->header.ids)
            other = part;
    }
    return bsq_fail(file->ctx, BSQ_EDATA, "%s has ids by %s, %s by %s: make both with one --id",
                    first->file.path, fmt_ids_text(first->header.ids), other->file.path,
                    fmt_ids_text(other->header.ids));
}

static int parts_join(struct fmt_tris_file *all)
{
    uint64_t chunks = 0;
    int status;
    for (uint32_t i = 0; i < all->part_count; i++)
        chunks += all->parts[i].file->header.chunk_count;
    begin_header(all);
    BSQ_TRY(join_materials(all));
    BSQ_TRY(join_channels(all));
    BSQ_TRY(join_sources(all));
    BSQ_TRY(check_normals(all));
    BSQ_TRY(parts_compare_colors(all));
    BSQ_TRY(bsq_alloc(all->ctx, "chunk table", chunks + 1, sizeof *all->chunks, &all->chunks));
    for (uint32_t i = 0; i < all->part_count; i++)
        BSQ_TRY(join_chunks(all, &all->parts[i]));
    for (uint64_t i = 0; i < all->header.chunk_count; i++) {
        const uint64_t bytes = fmt_tris_load_size(all, i);
        all->load_size_max = bytes > all->load_size_max ? bytes : all->load_size_max;
    }
done:
    return status;
}

/* Opens the parts with names, then the temporary one. */
static int open_all(struct fmt_tris_file *all, const char *const *paths, uint32_t path_count,
                    const struct bsq_file *temp)
{
    const uint64_t count = (uint64_t)path_count + (temp != NULL);
    int status = bsq_calloc(all->ctx, "chunk files", count, sizeof *all->parts, &all->parts);
    for (; status == 0 && all->part_count < path_count; all->part_count++)
        status = parts_open_part(all->ctx, paths[all->part_count], &all->parts[all->part_count]);
    if (status == 0 && temp)
        status = fmt_tris_open_temp(all->ctx, temp, &all->parts[all->part_count++].file);
    return status;
}

int fmt_tris_open_parts(struct bsq_ctx *ctx, const char *const *paths, uint32_t path_count,
                        const struct bsq_file *temp, struct fmt_tris_file **out)
{
    struct fmt_tris_file *all;
    *out = NULL;
    if (path_count == 1 && !temp)
        return fmt_tris_open(ctx, paths[0], out);
    if (path_count == 0)
        return fmt_tris_open_temp(ctx, temp, out);
    int status = bsq_calloc(ctx, "chunk files", 1, sizeof *all, &all);
    if (status < 0)
        return status;
    all->ctx = ctx;
    all->file = all->normals = (struct bsq_file)BSQ_FILE_CLOSED;
    BSQ_TRY(open_all(all, paths, path_count, temp));
    bsq_sort(all->parts, all->part_count, sizeof *all->parts, compare_parts);
    all->file.path = strdup(all->parts[0].file->file.path);
    if (!all->file.path)
        status = bsq_fail_errno(ctx, BSQ_ENOMEM, ENOMEM, "%s", paths[0]);
    else
        status = parts_join(all);
done:
    if (status < 0)
        fmt_tris_close(all);
    else
        *out = all;
    return status;
}

void fmt_tris_close_parts(struct fmt_tris_file *all)
{
    for (uint32_t i = 0; i < all->part_count; i++)
        fmt_tris_close(all->parts[i].file);
    bsq_free(all->ctx, all->parts);
}

/* ---- loading ---- */

/* Returns the part that has chunk number `index`. */
static const struct tris_part *find_part(const struct fmt_tris_file *all, uint64_t index)
{
    uint32_t low = 0, high = all->part_count;
    while (high - low > 1) {
        const uint32_t middle = low + (high - low) / 2;
        if (all->parts[middle].first_chunk <= index)
            low = middle;
        else
            high = middle;
    }
    return &all->parts[low];
}

/* Places the attributes that a part lacks after a loaded chunk, and returns the bytes of all. Fills
 * them in unless `chunk` is NULL: with white, and no material, as sorting does for vertices and
 * faces without. */
static uint64_t parts_add_attributes(const struct fmt_tris_file *all, const struct tris_part *part,
                                     uint64_t index, uint8_t *scratch, struct fmt_tris_chunk *chunk)
{
    const struct fmt_tris_chunk_info *info = &all->chunks[index];
    const uint32_t own = part->file->header.attributes | FMT_TRIS_SAMPLES;
    const uint32_t lacking = all->header.attributes & ~own;
    uint64_t end = bsq_align_up(fmt_tris_load_size(part->file, index - part->first_chunk), 8);
    for (int i = 0; i < TRIS_ATTRIBUTE_COUNT; i++) {
        const struct tris_attribute *attribute = &fmt_tris_attributes[i];
        const uint64_t bytes =
            tris_values_bytes(attribute, info->triangle_count, info->vertex_count);
        if (!(lacking & attribute->flag))
            continue;
        if (chunk)
            tris_set_values(attribute, chunk, memset(scratch + end, attribute->absent, bytes));
        end = bsq_align_up(end + bytes, 8);
    }
    return end;
}

uint64_t fmt_tris_part_load_size(const struct fmt_tris_file *all, uint64_t index)
{
    return parts_add_attributes(all, find_part(all, index), index, NULL, NULL);
}

/* Numbers materials, which lie in `scratch`, over all files. */
static void parts_number_materials(const struct tris_part *part, struct fmt_tris_chunk *chunk)
{
    uint32_t *materials = (uint32_t *)chunk->materials;
    for (uint32_t t = 0; materials && part->first_material > 0 && t < chunk->triangle_count; t++)
        materials[t] += materials[t] == UINT32_MAX ? 0 : part->first_material;
}

int fmt_tris_load_part(const struct fmt_tris_file *all, uint64_t index, void *scratch,
                       struct fmt_tris_chunk *out, bool *found)
{
    const struct tris_part *part = find_part(all, index);
    struct fmt_tris_file open = *part->file;
    const bool named = open.file.fd < 0;
    memset(out, 0, sizeof *out);
    int status;
    BSQ_TRY(named ? bsq_file_open(all->ctx, part->file->file.path, &open.file) : 0);
    BSQ_TRY(found ? fmt_tris_load_sample(&open, index - part->first_chunk, scratch, out, found)
                  : fmt_tris_load(&open, index - part->first_chunk, scratch, out));
    parts_number_materials(part, out);
    if (!found)
        parts_add_attributes(all, part, index, scratch, out);
done:
    if (named)
        bsq_file_close(all->ctx, &open.file);
    return status;
}
