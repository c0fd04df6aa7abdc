/* scan_materials.c - which attributes a scan keeps, and its table of materials.
 *
 * The table has the materials that faces use and that have a texture or a colour. Texture
 * coordinates are kept if some material has a texture. A textured material has a second entry
 * without texture, for triangles that lack texture coordinates. */
#include "formats/material/file_extent.h"
#include "base/context.h"
#include "formats/material/channels.h"
#include "formats/material/tile_files.h"
#include "libvoxel/read/scan.h"

#include <errno.h>
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

/* ---- the table ---- */

/* Returns the absolute path of a file, or of a texture of tiles, whose path is no file's; NULL with
 * errno set if there is none. */
static char *absolute_path(const char *path)
{
    if (!fmt_has_tiles(path))
        return realpath(path, NULL);
    const size_t folder = fmt_tile_folder(path);
    char *directory = folder > 0 ? strndup(path, folder) : strdup(".");
    char *real = directory ? realpath(directory, NULL) : NULL, *out = NULL;
    if (real && asprintf(&out, "%s/%s", strcmp(real, "/") == 0 ? "" : real, path + folder) < 0)
        out = NULL;
    free(directory);
    free(real);
    return out;
}

/* Returns in *out the absolute path of a texture, which the scan owns. A texture that is an extent
 * of a file keeps the end of its name. */
static int resolve_texture(struct scan *scan, const char *path, char **out)
{
    struct fmt_extent extent;
    const size_t length = fmt_extent_parse(path, &extent);
    const char *end = length > 0 ? path + length : "";
    char *own = strndup(path, length > 0 ? length : strlen(path));
    char *absolute = own ? absolute_path(own) : NULL;
    free(own);
    if (!absolute)
        return bsq_fail_errno(scan->ctx, BSQ_ENOINPUT, errno, "%s: texture", path);
    size_t size = strlen(absolute), end_size = strlen(end) + 1;
    int status = bsq_alloc(scan->ctx, "materials", size + end_size, 1, out);
    if (status == 0) {
        memcpy(*out, absolute, size);
        memcpy(*out + size, end, end_size);
    }
    free(absolute);
    return status;
}

/* Returns the texture that gives a material a channel: the image of the options or the material's
 * own texture; NULL: neither. */
static const char *channel_texture(const struct scan *scan, const struct fmt_material *from,
                                   uint32_t number)
{
    const struct vox_channel *wanted = &scan->channels[number];
    const struct fmt_material_channel *own = fmt_material_find_channel(from, wanted->name);
    if (scan_count(scan, SCAN_TEXCOORDS) == 0)
        return NULL;
    return wanted->texture_path ? wanted->texture_path : own ? own->texture_path : NULL;
}

/* Returns whether a texture gives a material one of the channels that are kept. */
static bool any_channel_texture(const struct scan *scan, const struct fmt_material *from)
{
    bool any = false;
    for (uint32_t c = 0; c < scan->channel_count; c++)
        any |= channel_texture(scan, from, c) != NULL;
    return any;
}

/* Returns whether a material gives a channel a value. A texture that cannot be used leaves the
 * usual value; a warning tells of it. A value of 0 everywhere tells nothing. */
static bool gives_value(const struct scan *scan, const struct fmt_material_channel *own)
{
    return own &&
           (own->has_value || ((own->texture_path || own->lost_texture) &&
                               own->channel->usual > 0 && scan_count(scan, SCAN_TEXCOORDS) > 0));
}

/* ---- which channels are kept ---- */

/* Returns whether faces use a material of the readers' list. */
static bool is_used(const struct scan *scan, uint32_t number)
{
    return number < scan->material_use_count && scan->material_uses[number].faces > 0;
}

/* Returns whether a material that faces use gives a channel a texture or a value. */
static bool any_gives(const struct scan *scan, const struct fmt_materials *found, uint32_t channel)
{
    bool any = false;
    for (uint32_t i = 0; i < found->count && !any; i++)
        any = is_used(scan, i) &&
              (channel_texture(scan, &found->list[i], channel) ||
               gives_value(
                   scan, fmt_material_find_channel(&found->list[i], scan->channels[channel].name)));
    return any;
}

/* Drops optional channels that no material has. */
static int drop_optional(struct scan *scan, const struct fmt_materials *found)
{
    uint32_t count = 0;
    BSQ_PASS(BSQ_CALLOC(scan->ctx, "channels", scan->channel_count + UINT64_C(1),
                        &scan->found_optional));
    for (uint32_t c = 0; c < scan->channel_count; c++)
        if (!scan->channels[c].optional || any_gives(scan, found, c))
            scan->found_optional[count++] = scan->channels[c];
    scan->channels = scan->found_optional;
    scan->channel_count = count;
    return 0;
}

static bool is_kept(const struct scan *scan, const char *name)
{
    bool kept = false;
    for (uint32_t c = 0; c < scan->channel_count; c++)
        kept |= strcmp(scan->channels[c].name, name) == 0;
    return kept;
}

/* Returns whether a material says something of a channel beside what all materials are. */
static bool has_own_value(const struct fmt_material_channel *channel)
{
    const float value = channel->value[0];
    const bool grey =
        channel->channel->values == 1 || (value == channel->value[1] && value == channel->value[2]);
    return channel->has_value &&
           !(grey && (value == channel->channel->usual || value == channel->channel->gltf.usual));
}

/* Notes the channels of materials that the scan does not keep. Returns those with textures, as bits
 * by fmt_channel_at(). */
static uint32_t note_unkept(struct scan *scan, const struct fmt_materials *found)
{
    uint32_t textured = 0;
    for (uint32_t i = 0; i < found->count; i++)
        for (uint32_t c = 0; is_used(scan, i) && c < found->list[i].channel_count; c++) {
            const struct fmt_material_channel *channel = &found->list[i].channels[c];
            unsigned row = 0;
            while (fmt_channel_at(row) && fmt_channel_at(row) != channel->channel)
                row++;
            if (is_kept(scan, channel->channel->name))
                continue;
            textured |= channel->texture_path ? UINT32_C(1) << row : 0;
            scan->unkept |=
                channel->texture_path || has_own_value(channel) ? UINT32_C(1) << row : 0;
        }
    return textured;
}

/* Warns of textures of materials that are lost, unless the user has chosen what to keep. */
static int warn_of_unkept(struct scan *scan, const struct fmt_materials *found)
{
    const uint32_t textured = note_unkept(scan, found);
    char names[256] = "";
    for (unsigned i = 0; fmt_channel_at(i); i++)
        if (textured >> i & 1)
            snprintf(names + strlen(names), sizeof names - strlen(names), "%s%s",
                     names[0] ? ", " : "", fmt_channel_at(i)->name);
    return textured == 0 || !scan->tells_unkept
               ? 0
               : bsq_warn_loss(scan->ctx,
                               "%s: textures of materials are not kept: %s; --channels all keeps "
                               "them, --channels none says that they are not needed",
                               scan->paths[0], names);
}

/* Gives an entry of the table its channels. textured: whether its triangles have texture
 * coordinates. */
static int add_sources(struct scan *scan, const struct fmt_material *from, bool textured,
                       uint32_t number)
{
    struct fmt_tris_material *material = &scan->materials[number];
    if (scan->channel_count == 0)
        return 0;
    BSQ_PASS(BSQ_CALLOC(scan->ctx, "channels", scan->channel_count, &material->sources));
    for (uint32_t c = 0; c < scan->channel_count; c++) {
        struct fmt_tris_source *source = &material->sources[c];
        const struct fmt_material_channel *own =
            fmt_material_find_channel(from, scan->channels[c].name);
        const char *path = textured ? channel_texture(scan, from, c) : NULL;
        scan->found_channels[c] |= path || gives_value(scan, own);
        const struct fmt_channel *channel = fmt_channel_find(scan->channels[c].name);
        for (int k = 0; k < 3; k++)
            source->value[k] = own ? own->value[channel->values == 1 ? 0 : k] : channel->usual;
        if (path)
            BSQ_PASS(resolve_texture(scan, path, &source->texture_path));
        source->component = path ? channel->component : 0;
        if (path)
            source->value[0] = source->value[1] = source->value[2] = 1;
        if (own && path && path == own->texture_path) {
            source->uv = own->uv;
            source->component = own->component;
            memcpy(source->value, own->factor, sizeof source->value);
        }
        if (source->component == FMT_CHANNEL_CUTOUT)
            source->value[0] = source->value[1] = source->value[2] = from->cutoff;
    }
    return 0;
}

/* Adds an entry to the table of materials. path: of its texture, or NULL; color: whether `diffuse`
 * is a colour of the scan; name: NULL if materials have no names. */
static int add_material(struct scan *scan, const char *path, const float diffuse[3], bool color,
                        const char *name, uint32_t *number)
{
    struct fmt_tris_material *material = &scan->materials[scan->material_count];
    memcpy(material->diffuse, diffuse, sizeof material->diffuse);
    material->colorless = !color;
    *number = scan->material_count++; /* so that what was allocated is freed after a failure */
    if (path)
        BSQ_PASS(resolve_texture(scan, path, &material->texture_path));
    return bsq_text_copy(scan->ctx, name, &material->name);
}

static int allocate_tables(struct scan *scan)
{
    const uint64_t entries = 2 * ((uint64_t)scan->usemtl_count + 1);
    BSQ_PASS(BSQ_ALLOC(scan->ctx, "materials", entries, &scan->material_map));
    memset(scan->material_map, 0xff, entries * sizeof *scan->material_map);
    BSQ_PASS(BSQ_CALLOC(scan->ctx, "a table of materials and of colours of faces", entries,
                        &scan->materials));
    return BSQ_CALLOC(scan->ctx, "channels", scan->channel_count + UINT64_C(1),
                      &scan->found_channels);
}

/* Returns whether ids are names of materials or objects. */
static bool by_name(const struct scan *scan)
{
    return scan->ids == FMT_IDS_MATERIAL || scan->ids == FMT_IDS_OBJECT;
}

/* Returns the name that ids tell a material by, or NULL. */
static const char *name_of(const struct scan *scan, const struct fmt_material *from)
{
    const char *name = scan->ids == FMT_IDS_OBJECT ? from->object : from->name;
    return !by_name(scan) ? NULL : name ? name : "";
}

/* Returns whether each material has entries of its own, whatever its colour. */
static bool keeps_materials(const struct scan *scan)
{
    return by_name(scan) || scan->channel_count > 0;
}

/* Returns whether the table has a colour or a texture of it. */
static bool has_colored_material(const struct scan *scan)
{
    bool any = false;
    for (uint32_t i = 0; i < scan->material_count; i++)
        any |= !scan->materials[i].colorless;
    return any;
}

/* Makes faces without a colour white if other faces have colours of materials. */
static int whiten_colorless(struct scan *scan)
{
    static const float white[3] = {1.0f, 1.0f, 1.0f};
    uint32_t shared = UINT32_MAX; /* an entry that is added when it is needed first */
    if (scan->has_colors || !has_colored_material(scan))
        return 0;
    for (uint64_t i = 0; i < 2 * ((uint64_t)scan->usemtl_count + 1); i++) {
        static const struct scan_material_use none = {0};
        const struct scan_material_use *use = i / 2 == scan->usemtl_count ? &scan->without_material
                                              : i / 2 < scan->material_use_count
                                                  ? &scan->material_uses[i / 2]
                                                  : &none;
        uint32_t *entry = &scan->material_map[i];
        if ((i % 2 == 0 ? use->faces : use->bare_faces) == 0)
            continue;
        if (*entry == UINT32_MAX && shared == UINT32_MAX)
            BSQ_PASS(add_material(scan, NULL, white, true, by_name(scan) ? "" : NULL, &shared));
        if (*entry == UINT32_MAX)
            *entry = shared;
        struct fmt_tris_material *material = &scan->materials[*entry];
        if (material->colorless)
            memcpy(material->diffuse, white, sizeof white);
        material->colorless = false;
    }
    return 0;
}

/* Returns whether some materials name textures of their colour, no such texture can be used, and no
 * other material has a colour. What these materials say of their colour is mostly a factor of the
 * texture, such as white, so the scan has no colours then. */
static bool colors_are_lost(const struct scan *scan, const struct fmt_materials *found)
{
    bool lost = false, others = false;
    for (uint32_t i = 0; i < found->count; i++) {
        const struct fmt_material_channel *color = &found->list[i].color;
        if (!is_used(scan, i))
            continue;
        lost |= color->lost_texture;
        others |= color->texture_path || (!color->lost_texture && color->has_value);
    }
    return lost && !others;
}

/* Adds the entries of a material: one for triangles with texture coordinates if a texture needs
 * them, and one for all others. */
static int add_entries(struct scan *scan, const struct fmt_material *from, uint32_t map[2])
{
    const char *name = name_of(scan, from);
    const bool colored = from->color.texture_path && scan_count(scan, SCAN_TEXCOORDS) > 0;
    const bool textured = colored || any_channel_texture(scan, from);
    const bool names_texture = from->color.texture_path || from->color.lost_texture;
    const bool has_color = from->color.has_value && !(names_texture && scan->lost_colors);
    const bool plain = has_color || name || scan->channel_count > 0;
    if (textured)
        BSQ_PASS(add_material(scan, colored ? from->color.texture_path : NULL, from->color.value,
                              colored || has_color, name, &map[0]));
    if (textured)
        BSQ_PASS(add_sources(scan, from, true, map[0]));
    if (colored)
        scan->materials[map[0]].uv = from->color.uv;
    if (colored)
        scan->materials[map[0]].tinted = from->tinted;
    if (plain && (!textured || scan->lacks_texcoord)) {
        BSQ_PASS(add_material(scan, NULL, from->color.value, has_color, name, &map[1]));
        BSQ_PASS(add_sources(scan, from, false, map[1]));
    }
    if (!textured)
        map[0] = map[1];
    return 0;
}

/* Adds the entries of all materials. The last of `found` is what faces without a material have.
 * image: the texture of all of them, or NULL. With an image, materials without names and channels
 * share an entry. */
static int add_all(struct scan *scan, const struct fmt_materials *found, const char *image)
{
    for (uint32_t i = 0; i <= scan->usemtl_count; i++) {
        const uint32_t last = found->count - 1;
        uint32_t *map = &scan->material_map[2 * (uint64_t)i];
        struct fmt_material from = found->list[i < last ? i : last];
        if (image) {
            from.color =
                (struct fmt_material_channel){.texture_path = (char *)image, .value = {1, 1, 1}};
            from.tinted = false;
        }
        BSQ_PASS(bsq_check(scan->ctx));
        if (image && i > 0 && !keeps_materials(scan))
            map[0] = scan->material_map[0];
        else if (image || i < scan->usemtl_count || scan->channel_count > 0)
            BSQ_PASS(add_entries(scan, &from, map));
    }
    return 0;
}

/* Warns of faces that lose the colour of their texture, as they have no texture coordinates. Vertex
 * colours stand in for it. vox_scan_compare_files() warns of an image for several files. */
static int warn_of_bare_faces(const struct scan *scan, const struct fmt_materials *found,
                              const char *image)
{
    uint64_t count = image ? scan->without_material.bare_faces : 0;
    const char *example = image;
    for (uint64_t i = 0; i < scan->material_use_count; i++) {
        const char *own =
            !image && i < scan->usemtl_count ? found->list[i].color.texture_path : NULL;
        if (scan->material_uses[i].bare_faces == 0 || (!image && !own))
            continue;
        count += scan->material_uses[i].bare_faces;
        example = image ? image : own;
    }
    if (count == 0 || scan->has_colors || (image && scan->file_count > 1))
        return 0;
    return bsq_warn_loss(scan->ctx,
                         "%s: faces without texture coordinates: %" PRIu64
                         "; their texture, such as %s, is not used",
                         scan->paths[0], count, example);
}

/* Makes the table of materials. image: the texture of all faces; NULL: materials have their own. */
static int use_materials(struct scan *scan, struct fmt_mesh_reader *reader, const char *image,
                         struct scan_textures *textures)
{
    const bool has_texcoords = scan_count(scan, SCAN_TEXCOORDS) > 0;
    struct fmt_materials found = {0};
    struct fmt_material *rest;
    int status = 0;
    if (image)
        BSQ_TRY(vox_textures_check_image(scan->ctx, image, textures));
    if (!image || keeps_materials(scan))
        BSQ_TRY(fmt_mesh_read_materials(reader, &found));
    BSQ_TRY(fmt_materials_add(scan->ctx, &found, &rest)); /* of faces without a material */
    if (!image || scan->channel_count > 0)
        BSQ_TRY(vox_textures_check(scan->ctx, &found, has_texcoords, textures));
    BSQ_TRY(vox_textures_use_alpha(scan, textures, image, &found));
    BSQ_TRY(drop_optional(scan, &found));
    BSQ_TRY(warn_of_unkept(scan, &found));
    scan->lost_colors = !image && colors_are_lost(scan, &found);
    for (uint32_t i = 0; i < found.count; i++)
        scan->double_sided |= is_used(scan, i) && found.list[i].double_sided;
    BSQ_TRY(allocate_tables(scan));
    BSQ_TRY(add_all(scan, &found, image));
    status = warn_of_bare_faces(scan, &found, image);
done:
    fmt_materials_free(scan->ctx, &found);
    return status;
}

/* Checks that the scan has what its ids are to tell apart. */
static int check_ids(const struct scan *scan)
{
    if (scan->ids == FMT_IDS_COLOR && !scan->has_colors)
        return bsq_fail(scan->ctx, BSQ_EDATA,
                        "%s: no vertex colours: ids need materials or objects", scan->paths[0]);
    return 0;
}

static void warn_without_names(const struct scan *scan)
{
    bool any = !by_name(scan);
    for (uint32_t i = 0; i < scan->material_count; i++)
        any |= scan->materials[i].name && scan->materials[i].name[0];
    if (!any)
        bsq_warn(scan->ctx, "%s: no faces with %s: all have the same id", scan->paths[0],
                 scan->ids == FMT_IDS_OBJECT ? "objects or groups" : "materials");
}

const char *vox_scan_find_texture(const struct scan *scan, bool in_tiles)
{
    for (uint32_t i = 0; i < scan->material_count; i++) {
        const struct fmt_tris_material *material = &scan->materials[i];
        for (uint32_t c = 0; c <= scan->channel_count; c++) {
            const char *path =
                c == 0 ? material->texture_path : material->sources[c - 1].texture_path;
            if (path && (!in_tiles || fmt_has_tiles(path)))
                return path;
        }
    }
    return NULL;
}

/* Warns of channels that no material has, which are the same everywhere: other parts of the scan
 * may have them. Refuses those that materials cannot have. */
static int check_channels(const struct scan *scan)
{
    for (uint32_t c = 0; c < scan->channel_count; c++) {
        const struct vox_channel *channel = &scan->channels[c];
        if (scan->found_channels[c])
            continue;
        if (channel->texture_path)
            return bsq_fail(scan->ctx, BSQ_EDATA,
                            "%s: no texture coordinates for the channel %s of %s", scan->paths[0],
                            channel->name, channel->texture_path);
        const struct fmt_channel *row = fmt_channel_find(channel->name);
        if (row->name[0] == '\0')
            return bsq_fail(scan->ctx, BSQ_EDATA,
                            "%s: materials have no channel %s: give its image, as %s=FILE",
                            scan->paths[0], channel->name, channel->name);
        bsq_warn(scan->ctx,
                 "%s: no material has a value or a texture of %s, so it is %g everywhere",
                 scan->paths[0], channel->name, (double)row->usual);
    }
    return 0;
}

/* Notes which files have colours of materials. */
static void note_material_colors(struct scan *scan)
{
    for (uint64_t i = 0; i < scan->material_use_count && i < scan->usemtl_count; i++) {
        const struct scan_material_use *use = &scan->material_uses[i];
        const uint32_t entry = use->faces > 0 ? scan->material_map[2 * i] : UINT32_MAX;
        if (entry != UINT32_MAX && !scan->materials[entry].texture_path &&
            !scan->materials[entry].colorless)
            scan->files[use->file].has_material_colors = true;
    }
}

int vox_scan_find_materials(struct scan *scan, struct fmt_mesh_reader *reader,
                            const char *texture_path, struct scan_textures *textures,
                            enum fmt_ids ids)
{
    scan->ids = ids;
    BSQ_PASS(check_ids(scan));
    scan->usemtl_count = scan->totals.materials;
    if (texture_path && scan_count(scan, SCAN_TEXCOORDS) == 0) {
        BSQ_PASS(drop_optional(scan, &(struct fmt_materials){0}));
        BSQ_PASS(allocate_tables(scan));
        BSQ_PASS(bsq_warn_loss(scan->ctx, "%s: no texture coordinates, %s is not used",
                               scan->paths[0], texture_path));
    } else {
        BSQ_PASS(use_materials(scan, reader, texture_path, textures));
    }
    BSQ_PASS(whiten_colorless(scan));
    note_material_colors(scan);
    warn_without_names(scan);
    BSQ_PASS(check_channels(scan));
    scan->attributes = (scan->has_colors ? FMT_TRIS_COLORS : 0) |
                       (scan_count(scan, SCAN_FINE_COLORS) > 0 ? FMT_TRIS_FINE_COLORS : 0) |
                       (scan->has_normals ? FMT_TRIS_NORMALS : 0) |
                       (scan->material_count > 0 ? FMT_TRIS_MATERIALS : 0);
    if (vox_scan_find_texture(scan, false))
        scan->attributes |= FMT_TRIS_TEXCOORDS;
    return 0;
}
