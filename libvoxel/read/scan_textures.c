/* scan_textures.c - finds out which textures of materials can be used, before a scan is read.
 *
 * Users should learn of a damaged texture before hours of work. A texture that cannot be used is a
 * warning, and its material goes without it. */
#include "formats/material/file_extent.h"
#include "base/context.h"
#include "formats/material/tile_files.h"
#include "formats/texture/texture.h"
#include "libvoxel/read/scan.h"

#include <inttypes.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

/* Returns the entry of a texture that was entered. */
static const struct scan_texture *find(const struct scan_textures *textures, const char *path)
{
    return &textures->list[bsq_texts_find(&textures->paths, path)];
}

/* Enters a texture that a material names, or the options: NULL. place: see struct scan_texture. */
static int enter(struct bsq_ctx *ctx, struct scan_textures *textures, const char *path,
                 const struct fmt_material *material, const char *place)
{
    uint64_t number;
    BSQ_PASS(bsq_texts_add(ctx, &textures->tally, &textures->paths, path, &number));
    BSQ_PASS(bsq_tally_grow(ctx, &textures->tally, textures->paths.count, sizeof *textures->list,
                            &textures->list, &textures->capacity));
    struct scan_texture *texture = &textures->list[number];
    if (number == textures->count)
        textures->list[textures->count++] =
            (struct scan_texture){.first = material, .latest = material, .place = place};
    texture->others += texture->latest != material;
    texture->latest = material;
    return 0;
}

/* ---- checking ---- */

/* Warns that materials have no texture. `problem` names it and says why. */
static int warn_bad(struct bsq_ctx *ctx, struct scan_texture *texture, const char *path,
                    const char *problem)
{
    const char *place = texture->place ? texture->place : "";
    const char *colon = texture->place ? ": " : "", *name = texture->first->name;
    texture->good = false;
    if (texture->others > 0)
        return bsq_warn_loss(ctx,
                             "%s%s%s%s: materials that go without it, such as \"%s\": %" PRIu64,
                             place, colon, path, problem, name, texture->others + 1);
    return bsq_warn_loss(ctx, "%s%s%s%s: material \"%s\" goes without it", place, colon, path,
                         problem, name);
}

/* Checks that there is a tile of a texture. */
static int check_tiles(struct bsq_ctx *ctx, const char *path, struct scan_texture *texture)
{
    struct fmt_tile_files tiles = {0};
    int status = fmt_tile_files_find(ctx, path, &tiles);
    if (status == 0 && tiles.count == 0)
        status = warn_bad(ctx, texture, path, ": no tile of this texture exists");
    fmt_tile_files_free(ctx, &tiles);
    return status;
}

/* Checks what the file system says of the texture. That of the options was noted as an input. */
static int check_file(struct bsq_ctx *ctx, const char *path, struct scan_texture *texture)
{
    struct fmt_extent extent;
    struct stat info;
    texture->good = true;
    if (!texture->first || fmt_extent_parse(path, &extent) > 0)
        return 0;
    if (fmt_has_tiles(path))
        return check_tiles(ctx, path, texture);
    if (stat(path, &info))
        return warn_bad(ctx, texture, path, ": no such texture");
    if (!S_ISREG(info.st_mode))
        return warn_bad(ctx, texture, path, ": not a regular file");
    if (info.st_size == 0)
        return warn_bad(ctx, texture, path, ": an empty file");
    return access(path, R_OK) ? warn_bad(ctx, texture, path, ": not readable") : 0;
}

static void source_of(const void *arg, uint64_t number, struct fmt_texture_source *out)
{
    const struct scan_textures *textures = arg;
    number += textures->checked;
    out->path = textures->list[number].good ? textures->paths.list[number] : NULL;
}

/* Decodes a texture's image, which was opened as number `image`. Warns if it is damaged. One that
 * the options name must be good. */
static int note_image(struct bsq_ctx *ctx, const struct fmt_textures *images, uint32_t image,
                      struct scan_texture *texture)
{
    const char *text = NULL;
    const int damage = texture->good ? fmt_texture_problem(images, image, &text) : 0;
    if (damage == BSQ_EDATA && texture->first)
        return warn_bad(ctx, texture, text, "");
    if (damage < 0)
        return bsq_fail(ctx, damage, "%s", text);
    texture->alpha = texture->good && fmt_texture_has_alpha(images, image);
    return 0;
}

/* Checks the textures that were entered since the last time, and decodes them. */
static int check_new(struct bsq_ctx *ctx, struct scan_textures *textures)
{
    struct fmt_textures *images = NULL;
    const uint64_t first = textures->checked, count = textures->count - first;
    int status = 0;
    for (uint64_t i = first; i < textures->count; i++) {
        BSQ_TRY(bsq_check(ctx));
        BSQ_TRY(check_file(ctx, textures->paths.list[i], &textures->list[i]));
    }
    BSQ_TRY(fmt_textures_open(ctx, count, source_of, textures, 0, &images));
    if (images)
        BSQ_TRY(fmt_textures_tell_damage(images));
    for (uint64_t i = 0; i < count && images; i++)
        BSQ_TRY(note_image(ctx, images, (uint32_t)i, &textures->list[first + i]));
    textures->checked = textures->count;
done:
    fmt_textures_close(images);
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

/* Returns channel `number` of a material, the first of which is its colour, if it has a texture
 * that matters; else NULL. */
static struct fmt_material_channel *textured_channel(const struct scan_textures *textures,
                                                     struct fmt_material *material, uint32_t number)
{
    struct fmt_material_channel *channel =
        number == 0 ? &material->color : &material->channels[number - 1];
    const bool matters =
        number == 0 ? !textures->only_channels : is_wanted(textures, channel->channel->name);
    return channel->texture_path && matters ? channel : NULL;
}

/* Enters the textures of a material, and notes those that other files name as inputs of the job. */
static int enter_material(struct bsq_ctx *ctx, struct fmt_material *material, bool has_texcoords,
                          struct scan_textures *textures)
{
    for (uint32_t c = 0; c <= material->channel_count; c++) {
        const struct fmt_material_channel *channel = textured_channel(textures, material, c);
        if (channel && channel->texture_place)
            BSQ_PASS(fmt_note_texture(ctx, channel->texture_path, "the texture that %s names",
                                      channel->texture_place));
        if (channel && has_texcoords)
            BSQ_PASS(enter(ctx, textures, channel->texture_path, material, channel->texture_place));
    }
    return 0;
}

/* Takes the textures that cannot be used from a material. */
static void drop_bad(struct bsq_ctx *ctx, const struct scan_textures *textures,
                     struct fmt_material *material)
{
    for (uint32_t c = 0; c <= material->channel_count; c++) {
        struct fmt_material_channel *channel = textured_channel(textures, material, c);
        if (!channel || find(textures, channel->texture_path)->good)
            continue;
        bsq_free(ctx, channel->texture_path);
        channel->texture_path = NULL;
        channel->lost_texture = true;
    }
}

int vox_textures_check(struct bsq_ctx *ctx, struct fmt_materials *materials, bool has_texcoords,
                       struct scan_textures *textures)
{
    for (uint32_t i = 0; i < materials->count; i++)
        BSQ_PASS(enter_material(ctx, &materials->list[i], has_texcoords, textures));
    BSQ_PASS(check_new(ctx, textures));
    for (uint32_t i = 0; i < materials->count && has_texcoords; i++)
        drop_bad(ctx, textures, &materials->list[i]);
    return 0;
}

int vox_textures_check_image(struct bsq_ctx *ctx, const char *path, struct scan_textures *textures)
{
    BSQ_PASS(fmt_note_texture(ctx, path, "the texture"));
    BSQ_PASS(enter(ctx, textures, path, NULL, NULL));
    return check_new(ctx, textures);
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
    for (uint32_t c = 0; c < textures->channel_count; c++) {
        const char *name = textures->channels[c].name;
        const struct fmt_material *first = NULL;
        uint64_t count = 0;
        for (uint32_t i = 0; i < materials->count && is_wanted(textures, name); i++)
            if (loss_of(&materials->list[i], name)) {
                first = first ? first : &materials->list[i];
                count++;
            }
        if (first)
            BSQ_PASS(bsq_warn_loss(ctx, "material \"%s\": %s: %s%s", first->name, name,
                                   loss_of(first, name),
                                   count > 1 ? " (the same or similar for other materials)" : ""));
    }
    return 0;
}

int vox_textures_preview(struct bsq_ctx *ctx, struct fmt_mesh_reader *reader,
                         const char *texture_path, bool has_texcoords,
                         struct scan_textures *textures)
{
    struct fmt_materials materials = {0};
    int status = 0;
    if (texture_path && has_texcoords)
        BSQ_TRY(vox_textures_check_image(ctx, texture_path, textures));
    for (uint32_t c = 0; c < textures->channel_count && has_texcoords; c++)
        if (textures->channels[c].texture_path)
            BSQ_TRY(vox_textures_check_image(ctx, textures->channels[c].texture_path, textures));
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
static const struct fmt_channel *wanted_channel(const struct scan *scan)
{
    for (uint32_t c = 0; c < scan->channel_count; c++) {
        const struct fmt_channel *channel = fmt_channel_find(scan->channels[c].name);
        if (channel->component == FMT_CHANNEL_ALPHA && !scan->channels[c].texture_path)
            return channel;
    }
    return NULL;
}

/* Makes the alpha of a texture a channel of the material, unless that has another texture of it.
 * Sets *lost to the material if it also has a value, which is not multiplied. */
static int add_alpha(struct bsq_ctx *ctx, const struct fmt_channel *channel, const char *path,
                     const struct fmt_uv *uv, struct fmt_material *material,
                     const struct fmt_material **lost)
{
    struct fmt_material_channel *entry;
    int status = fmt_material_enter_channel(ctx, material, channel, &entry);
    if (status < 0 || entry->texture_path)
        return status;
    BSQ_PASS(bsq_text_copy(ctx, path, &entry->texture_path));
    if (entry->has_value && entry->value[0] != entry->factor[0] && !material->cutout)
        *lost = material;
    entry->component = material->cutout ? FMT_CHANNEL_CUTOUT : FMT_CHANNEL_ALPHA;
    entry->uv = *uv;
    return 0;
}

int vox_textures_use_alpha(struct scan *scan, const struct scan_textures *textures,
                           const char *path, struct fmt_materials *materials)
{
    static const struct fmt_uv unmoved = {0};
    const struct fmt_channel *channel = wanted_channel(scan);
    const struct fmt_material *lost = NULL;
    for (uint32_t i = 0; i < materials->count && channel && scan_count(scan, SCAN_TEXCOORDS) > 0;
         i++) {
        struct fmt_material *material = &materials->list[i];
        const char *own = material->opaque ? NULL : material->color.texture_path;
        const char *texture = path ? path : own;
        if (texture && find(textures, texture)->alpha)
            BSQ_PASS(add_alpha(scan->ctx, channel, texture, path ? &unmoved : &material->color.uv,
                               material, &lost));
    }
    if (lost)
        return bsq_warn_loss(scan->ctx,
                             "material \"%s\": %s: its value is not used, but the alpha of its "
                             "texture",
                             lost->name, channel->name);
    return 0;
}

void vox_textures_free(struct bsq_ctx *ctx, struct scan_textures *textures)
{
    bsq_texts_free(&textures->paths);
    free(textures->list);
    bsq_tally_release(ctx, &textures->tally);
    *textures = (struct scan_textures){0};
}
