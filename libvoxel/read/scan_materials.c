/* scan_materials.c - which attributes a scan keeps, and its table of materials.
 *
 * The table has the materials that faces use and that have a texture or a colour. Texture
 * coordinates are kept if some material has a texture. A textured material has a second entry
 * without texture, for triangles that lack texture coordinates. */
#include "base/file_part.h"
#include "base/job_files.h"
#include "base/loss.h"
#include "libvoxel/read/scan.h"

#include <errno.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

/* Returns in *out the absolute path of a texture, which the scan owns. A texture that is a part of
 * a file keeps the end of its name. */
static int resolve_texture(struct scan *scan, const char *path, char **out)
{
    struct bsq_part part;
    const size_t length = bsq_part_parse(path, &part);
    const char *end = length > 0 ? path + length : "";
    char *own = strndup(path, length > 0 ? length : strlen(path));
    char *absolute = own ? realpath(own, NULL) : NULL;
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

static uint32_t add_material(struct scan *scan, char *texture_path, const float diffuse[3])
{
    struct fmt_tris_material *material = &scan->materials[scan->material_count];
    material->texture_path = texture_path;
    memcpy(material->diffuse, diffuse, sizeof material->diffuse);
    return scan->material_count++;
}

static int allocate_tables(struct scan *scan, uint32_t usemtl_count)
{
    scan->usemtl_count = usemtl_count;
    uint64_t entries = 2 * ((uint64_t)usemtl_count + 1);
    int status =
        bsq_alloc(scan->ctx, "materials", entries, sizeof *scan->material_map, &scan->material_map);
    if (status == 0)
        status =
            bsq_calloc(scan->ctx, "materials", entries, sizeof *scan->materials, &scan->materials);
    if (status == 0)
        memset(scan->material_map, 0xff, entries * sizeof *scan->material_map);
    return status;
}

/* Uses one image for all triangles with texture coordinates. */
static int use_single_texture(struct scan *scan, const char *texture_path)
{
    static const float white[3] = {1.0f, 1.0f, 1.0f};
    char *path = NULL;
    int status = bsq_note_input(scan->ctx, texture_path, "the texture");
    if (status == 0)
        status = resolve_texture(scan, texture_path, &path);
    if (status < 0)
        return status;
    uint32_t material = add_material(scan, path, white);
    for (uint32_t i = 0; i <= scan->usemtl_count; i++)
        scan->material_map[2 * i] = material;
    return 0;
}

static int add_own_material(struct scan *scan, const struct scan_textures *textures,
                            const struct fmt_material *from, uint32_t usemtl)
{
    uint32_t *map = &scan->material_map[2 * usemtl];
    const bool textured = from->texture_path && scan_count(scan, SCAN_TEXCOORDS) > 0 &&
                          vox_textures_have(textures, from->texture_path);
    if (textured) {
        char *path = NULL;
        int status = resolve_texture(scan, from->texture_path, &path);
        if (status < 0)
            return status;
        map[0] = add_material(scan, path, from->diffuse);
    }
    if (from->has_diffuse && (!textured || scan->lacks_texcoord))
        map[1] = add_material(scan, NULL, from->diffuse);
    if (!textured)
        map[0] = map[1];
    return 0;
}

static int use_own_materials(struct scan *scan, struct fmt_mesh_reader *reader,
                             struct scan_textures *textures)
{
    struct fmt_materials found = {0};
    int status = fmt_mesh_read_materials(reader, &found);
    if (status == 0 && scan_count(scan, SCAN_TEXCOORDS) > 0)
        status = vox_textures_check(scan->ctx, &found, textures);
    for (uint32_t i = 0; status == 0 && i < scan->usemtl_count; i++) {
        status = bsq_check(scan->ctx);
        if (status == 0)
            status = add_own_material(scan, textures, &found.list[i], i);
    }
    fmt_materials_free(scan->ctx, &found);
    return status;
}

int vox_scan_find_materials(struct scan *scan, struct fmt_mesh_reader *reader,
                            const char *texture_path, struct scan_textures *textures)
{
    int status = allocate_tables(scan, scan->totals.materials);
    if (status < 0)
        return status;
    if (!texture_path)
        status = use_own_materials(scan, reader, textures);
    else if (scan_count(scan, SCAN_TEXCOORDS) > 0)
        status = use_single_texture(scan, texture_path);
    else
        status = bsq_warn_loss(scan->ctx, "%s: no texture coordinates, %s is not used",
                               scan->paths[0], texture_path);
    scan->attributes = (scan->has_colors ? FMT_TRIS_COLORS : 0) |
                       (scan->has_normals ? FMT_TRIS_NORMALS : 0) |
                       (scan->material_count > 0 ? FMT_TRIS_MATERIALS : 0);
    for (uint32_t i = 0; i < scan->material_count; i++)
        if (scan->materials[i].texture_path)
            scan->attributes |= FMT_TRIS_TEXCOORDS;
    return status;
}
