/* scan_textures.c - finds out which textures of materials can be used, before a scan is read.
 *
 * Users should learn of a damaged texture before hours of work. A texture that cannot be used is a
 * warning, and its material goes without it. */
#include "base/file_extent.h"
#include "base/job_files.h"
#include "base/context.h"
#include "base/sort_array.h"
#include "base/text.h"
#include "base/tile_files.h"
#include "formats/texture/texture.h"
#include "libvoxel/read/scan.h"

#include <inttypes.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

/* A texture of a material that is to be checked. */
struct candidate {
    const struct fmt_material *material;
    const char *path, *place; /* as in struct fmt_material_channel */
    uint64_t others;          /* further materials that name it */
    bool good;
};

static int compare_candidates(const void *a, const void *b)
{
    const struct candidate *c = a, *d = b;
    const int order = strcmp(c->path, d->path);
    return order ? order : (c->material > d->material) - (c->material < d->material);
}

static int compare_textures(const void *a, const void *b)
{
    return strcmp(((const struct scan_texture *)a)->path, ((const struct scan_texture *)b)->path);
}

static const struct scan_texture *find(const struct scan_textures *textures, const char *path)
{
    const struct scan_texture key = {.path = (char *)path};
    return textures->count > 0 ? bsearch(&key, textures->list, textures->count,
                                         sizeof *textures->list, compare_textures)
                               : NULL;
}

bool vox_textures_have(const struct scan_textures *textures, const char *path)
{
    const struct scan_texture *texture = find(textures, path);
    return texture && texture->good;
}

/* ---- checking ---- */

/* Warns that materials have no texture. `problem` names it and says why. */
static int warn_bad(struct bsq_ctx *ctx, struct candidate *candidate, const char *path,
                    const char *problem)
{
    const char *place = candidate->place ? candidate->place : "";
    const char *colon = candidate->place ? ": " : "", *name = candidate->material->name;
    candidate->good = false;
    if (candidate->others > 0)
        return bsq_warn_loss(ctx,
                             "%s%s%s%s: materials that go without it, such as \"%s\": %" PRIu64,
                             place, colon, path, problem, name, candidate->others + 1);
    return bsq_warn_loss(ctx, "%s%s%s%s: material \"%s\" goes without it", place, colon, path,
                         problem, name);
}

/* Checks that there is a tile of a texture. */
static int check_tiles(struct bsq_ctx *ctx, struct candidate *candidate)
{
    struct bsq_tile_files tiles = {0};
    int status = bsq_tile_files_find(ctx, candidate->path, &tiles);
    if (status == 0 && tiles.count == 0)
        status = warn_bad(ctx, candidate, candidate->path, ": no tile of this texture exists");
    bsq_tile_files_free(ctx, &tiles);
    return status;
}

/* Checks what the file system says of the texture. */
static int check_file(struct bsq_ctx *ctx, struct candidate *candidate)
{
    struct bsq_extent extent;
    struct stat info;
    const char *path = candidate->path;
    candidate->good = true;
    if (bsq_extent_parse(path, &extent) > 0)
        return 0;
    if (bsq_has_tiles(path))
        return check_tiles(ctx, candidate);
    if (stat(path, &info))
        return warn_bad(ctx, candidate, path, ": no such texture");
    if (!S_ISREG(info.st_mode))
        return warn_bad(ctx, candidate, path, ": not a regular file");
    if (info.st_size == 0)
        return warn_bad(ctx, candidate, path, ": an empty file");
    return access(path, R_OK) ? warn_bad(ctx, candidate, path, ": not readable") : 0;
}

static void source_of(const void *list, uint64_t index, struct fmt_texture_source *out)
{
    const struct candidate *candidate = (const struct candidate *)list + index;
    out->path = candidate->good ? candidate->path : NULL;
}

/* Decodes all good candidates, and warns of those that are damaged. One without a material must be
 * good. */
static int decode_all(struct bsq_ctx *ctx, struct candidate *list, uint64_t count)
{
    struct fmt_textures *textures = NULL;
    int status;
    BSQ_TRY(fmt_textures_open_each(ctx, count, source_of, list, 0, &textures));
    if (textures)
        BSQ_TRY(fmt_textures_tell_damage(textures));
    for (uint64_t i = 0; i < count; i++) {
        const char *text = NULL;
        const int damage = list[i].good ? fmt_texture_problem(textures, (uint32_t)i, &text) : 0;
        if (damage == BSQ_EDATA && list[i].material)
            BSQ_TRY(warn_bad(ctx, &list[i], text, ""));
        else if (damage < 0)
            BSQ_TRY(bsq_fail(ctx, damage, "%s", text));
    }
done:
    fmt_textures_close(textures);
    return status;
}

/* ---- the list ---- */

static int add_checked(struct bsq_ctx *ctx, struct scan_textures *textures,
                       const struct candidate *list, uint64_t count)
{
    int status = bsq_grow(ctx, "textures", textures->count + count, sizeof *textures->list,
                          &textures->list, &textures->capacity);
    for (uint64_t i = 0; i < count && !status; i++) {
        struct scan_texture *to = &textures->list[textures->count];
        to->good = list[i].good;
        status = bsq_text_copy(ctx, list[i].path, &to->path);
        textures->count += status == 0;
    }
    bsq_sort(textures->list, textures->count, sizeof *textures->list, compare_textures);
    return status;
}

static bool is_wanted(const struct scan_textures *textures, const char *channel)
{
    bool wanted = false;
    for (uint32_t c = 0; c < textures->channel_count; c++)
        wanted |=
            !textures->channels[c].texture_path && strcmp(textures->channels[c].name, channel) == 0;
    return wanted;
}

/* Lists the textures of a material that matter: at most one more than it has channels. */
static uint64_t list_textures(const struct scan_textures *textures,
                              const struct fmt_material *material, struct candidate *out)
{
    uint64_t count = 0;
    for (uint32_t c = 0; c <= material->channel_count; c++) {
        const struct fmt_material_channel *channel =
            c == 0 ? &material->color : &material->channels[c - 1];
        const bool wanted =
            c == 0 ? !textures->only_channels : is_wanted(textures, channel->channel->name);
        if (channel->texture_path && wanted)
            out[count++] = (struct candidate){.material = material,
                                              .path = channel->texture_path,
                                              .place = channel->texture_place};
    }
    return count;
}

/* Keeps each new texture once, with the first material that names it and the number of others. */
static uint64_t keep_new(const struct scan_textures *textures, struct candidate *list, uint64_t all)
{
    uint64_t count = 0;
    bsq_sort(list, all, sizeof *list, compare_candidates);
    for (uint64_t i = 0; i < all; i++)
        if (count > 0 && strcmp(list[count - 1].path, list[i].path) == 0)
            list[count - 1].others += list[i].material != list[i - 1].material;
        else if (!find(textures, list[i].path))
            list[count++] = list[i];
    return count;
}

/* Notes the textures that other files name as inputs of the job. */
static int note_textures(struct bsq_ctx *ctx, const struct candidate *list, uint64_t count)
{
    int status = 0;
    for (uint64_t i = 0; i < count && !status; i++)
        if (list[i].place)
            status =
                bsq_note_texture(ctx, list[i].path, "the texture that %s names", list[i].place);
    return status;
}

/* Lists the textures of all materials. Free *list. */
static int list_candidates(struct bsq_ctx *ctx, const struct scan_textures *textures,
                           const struct fmt_materials *materials, struct candidate **list,
                           uint64_t *count)
{
    uint64_t most = 0;
    for (uint32_t i = 0; i < materials->count; i++)
        most += UINT64_C(1) + materials->list[i].channel_count;
    int status = bsq_calloc(ctx, "textures", most + 1, sizeof **list, list);
    *count = 0;
    for (uint32_t i = 0; i < materials->count && !status; i++)
        *count += list_textures(textures, &materials->list[i], *list + *count);
    return status;
}

int vox_textures_check(struct bsq_ctx *ctx, const struct fmt_materials *materials,
                       bool has_texcoords, struct scan_textures *textures)
{
    struct candidate *list = NULL;
    uint64_t count = 0;
    int status;
    BSQ_TRY(list_candidates(ctx, textures, materials, &list, &count));
    BSQ_TRY(note_textures(ctx, list, count));
    count = has_texcoords ? keep_new(textures, list, count) : 0;
    for (uint64_t i = 0; i < count; i++) {
        BSQ_TRY(bsq_check(ctx));
        BSQ_TRY(check_file(ctx, &list[i]));
    }
    if (textures->decode && count > 0)
        BSQ_TRY(decode_all(ctx, list, count));
    if (count > 0)
        status = add_checked(ctx, textures, list, count);
done:
    bsq_free(ctx, list);
    return status;
}

/* Checks a texture that the options name, which must be good. */
static int check_given(struct bsq_ctx *ctx, const char *path, const struct scan_textures *textures)
{
    int status = bsq_note_texture(ctx, path, "the texture");
    return !status && textures->decode
               ? decode_all(ctx, &(struct candidate){.path = path, .good = true}, 1)
               : status;
}

/* Returns what of a channel of a material cannot be used, or NULL. */
static const char *loss_of(const struct fmt_material *material, const char *channel)
{
    const struct fmt_material_channel *own = fmt_material_find_channel(material, channel);
    return own ? own->loss : NULL;
}

/* Warns, once for each channel that is kept, of what readers cannot use of it. */
static int warn_losses(struct bsq_ctx *ctx, const struct fmt_materials *materials,
                       const struct scan_textures *textures)
{
    int status = 0;
    for (uint32_t c = 0; c < textures->channel_count && !status; c++) {
        const char *name = textures->channels[c].name;
        const struct fmt_material *first = NULL;
        uint64_t count = 0;
        for (uint32_t i = 0; i < materials->count && is_wanted(textures, name); i++)
            if (loss_of(&materials->list[i], name)) {
                first = first ? first : &materials->list[i];
                count++;
            }
        if (first)
            status = bsq_warn_loss(ctx, "material \"%s\": %s: %s%s", first->name, name,
                                   loss_of(first, name),
                                   count > 1 ? " (the same or similar for other materials)" : "");
    }
    return status;
}

int vox_textures_preview(struct bsq_ctx *ctx, struct fmt_mesh_reader *reader,
                         const char *texture_path, bool has_texcoords,
                         struct scan_textures *textures)
{
    struct fmt_materials materials = {0};
    int status = 0;
    if (texture_path && has_texcoords)
        BSQ_TRY(check_given(ctx, texture_path, textures));
    for (uint32_t c = 0; c < textures->channel_count && has_texcoords; c++)
        if (textures->channels[c].texture_path)
            BSQ_TRY(check_given(ctx, textures->channels[c].texture_path, textures));
    if (!textures->only_channels || textures->channel_count > 0)
        BSQ_TRY(fmt_mesh_preview_materials(reader, &materials));
    BSQ_TRY(warn_losses(ctx, &materials, textures));
    status = vox_textures_check(ctx, &materials, has_texcoords, textures);
done:
    fmt_materials_free(ctx, &materials);
    return status;
}

/* ---- alpha channels of colour textures as opacity ---- */

/* Returns the channel that the alpha of a colour texture gives, if the scan keeps it and no image
 * of the options gives it; else NULL. */
static const struct bsq_channel *wanted_channel(const struct scan *scan)
{
    for (uint32_t c = 0; c < scan->channel_count; c++) {
        const struct bsq_channel *channel = bsq_channel_find(scan->channels[c].name);
        if (channel->component == BSQ_CHANNEL_ALPHA && !scan->channels[c].texture_path)
            return channel;
    }
    return NULL;
}

/* Makes the alpha of a texture a channel of the material, unless that has another texture of it,
 * which is good. Sets *lost to the material if it also has a value, which is not multiplied. */
static int add_alpha(struct bsq_ctx *ctx, const struct scan_textures *textures,
                     const struct bsq_channel *channel, const char *path, const struct bsq_uv *uv,
                     struct fmt_material *material, const struct fmt_material **lost)
{
    struct fmt_material_channel *entry;
    int status = fmt_material_enter_channel(ctx, material, channel, &entry);
    if (status < 0 || (entry->texture_path && vox_textures_have(textures, entry->texture_path)))
        return status;
    bsq_free(ctx, entry->texture_path);
    bsq_free(ctx, entry->texture_place);
    entry->texture_place = NULL;
    status = bsq_text_copy(ctx, path, &entry->texture_path);
    if (status < 0)
        return status;
    if (entry->has_value && entry->value[0] != entry->factor[0] && !material->cutout)
        *lost = material;
    entry->component = material->cutout ? BSQ_CHANNEL_CUTOUT : BSQ_CHANNEL_ALPHA;
    entry->uv = *uv;
    return 0;
}

/* Returns the texture whose alpha a material may have, or NULL. path: of all materials, or NULL. */
static const char *color_texture(const struct scan_textures *textures, const char *path,
                                 const struct fmt_material *material)
{
    if (path)
        return path;
    return material->color.texture_path && !material->opaque &&
                   vox_textures_have(textures, material->color.texture_path)
               ? material->color.texture_path
               : NULL;
}

/* The colour textures of materials. */
struct color_textures {
    const struct scan_textures *textures;
    const char *path;
    const struct fmt_materials *materials;
};

static void color_source_of(const void *arg, uint64_t material, struct fmt_texture_source *out)
{
    const struct color_textures *colors = arg;
    out->path = color_texture(colors->textures, colors->path, &colors->materials->list[material]);
}

int vox_textures_use_alpha(struct scan *scan, const struct scan_textures *textures,
                           const char *path, struct fmt_materials *materials)
{
    static const struct bsq_uv unmoved = {0};
    const struct bsq_channel *channel = wanted_channel(scan);
    const struct fmt_material *lost = NULL;
    struct fmt_textures *images;
    if (!channel || scan_count(scan, SCAN_TEXCOORDS) == 0)
        return 0;
    int status =
        fmt_textures_open_each(scan->ctx, materials->count, color_source_of,
                               &(struct color_textures){textures, path, materials}, 0, &images);
    for (uint32_t i = 0; i < materials->count && status == 0 && images; i++) {
        struct fmt_material *material = &materials->list[i];
        const char *texture = color_texture(textures, path, material), *text;
        if (texture && (status = fmt_texture_problem(images, i, &text)) < 0)
            bsq_fail(scan->ctx, status, "%s", text);
        else if (texture && fmt_texture_has_alpha(images, i))
            status = add_alpha(scan->ctx, textures, channel, texture,
                               path ? &unmoved : &material->color.uv, material, &lost);
    }
    fmt_textures_close(images);
    if (status == 0 && lost)
        status = bsq_warn_loss(scan->ctx,
                               "material \"%s\": %s: its value is not used, but the alpha of its "
                               "texture",
                               lost->name, channel->name);
    return status;
}

void vox_textures_free(struct bsq_ctx *ctx, struct scan_textures *textures)
{
    for (uint64_t i = 0; i < textures->count; i++)
        bsq_free(ctx, textures->list[i].path);
    bsq_free(ctx, textures->list);
    *textures = (struct scan_textures){0};
}
