/* scan_files.c - what each file of a scan has, and warnings of faces and attributes that some files
 * lack.
 *
 * A file without faces among several may be a download that failed, so it is a loss.
 * A file without vertex colours is white beside files with such colours, and its facets are flat
 * beside files with normals. Users learn of both, because they may not expect it. */
#include "base/loss.h"
#include "libvoxel/read/scan.h"

#include <string.h>

void vox_scan_enter_file(struct scan *scan, uint32_t number)
{
    for (; scan->file_count <= number; scan->file_count++)
        if (scan->file_count > 0)
            memcpy(scan->files[scan->file_count].ends, scan->files[scan->file_count - 1].ends,
                   sizeof scan->files->ends);
}

/* Sets *out to the entry of a material, or to the entry of faces without one. */
static int enter_material(struct scan *scan, uint32_t material, struct scan_material_use **out)
{
    const uint64_t before = scan->material_use_count, count = (uint64_t)material + 1;
    *out = &scan->without_material;
    if (material == FMT_MESH_NO_MATERIAL)
        return 0;
    int status = 0;
    if (count > before)
        status = bsq_grow(scan->ctx, "materials", count, sizeof *scan->material_uses,
                          &scan->material_uses, &scan->material_use_capacity);
    if (status < 0)
        return status;
    for (uint64_t i = before; i < count; i++)
        scan->material_uses[i] = (struct scan_material_use){.file = UINT32_MAX};
    scan->material_use_count = count > before ? count : before;
    *out = &scan->material_uses[material];
    return 0;
}

/* Notes which file uses a material, and counts its faces, and its faces without texture
 * coordinates.
 */
static int note_material(struct scan *scan, uint32_t material, uint32_t file, uint64_t faces,
                         uint64_t bare_faces)
{
    struct scan_material_use *use;
    int status = enter_material(scan, material, &use);
    if (status < 0)
        return status;
    use->file = file;
    use->faces += faces;
    use->bare_faces += bare_faces;
    return 0;
}

/* Counts the faces from `begin` to `end` with a corner that has no texture coordinate. *corner: the
 * first one of these faces; becomes the one after them. */
static uint64_t count_bare(const struct fmt_mesh_block *block, uint64_t begin, uint64_t end,
                           uint64_t *corner)
{
    uint64_t count = 0;
    if (!block->corner_texcoords)
        return end - begin;
    for (uint64_t f = begin; f < end; f++) {
        bool bare = false;
        for (uint32_t k = 0; k < block->face_sizes[f]; k++)
            bare |= block->corner_texcoords[(*corner)++] == FMT_MESH_NONE;
        count += bare;
    }
    return count;
}

int vox_scan_note_file_faces(struct scan *scan, const struct scan_face_check *check)
{
    const struct fmt_mesh_block *block = check->block;
    /* A file with faces has elements too: otherwise all its indices are out of range. */
    struct scan_file *file = &scan->files[block->file];
    file->has_faces = true;
    file->has_normals |= check->has_normals;
    file->has_texcoords |= check->has_texcoords;
    const struct fmt_mesh_material_change *changes = block->material_changes;
    const uint64_t change_count = block->material_change_count;
    uint32_t material = block->material_at_start;
    uint64_t begin = 0, corner = 0;
    int status = 0;
    for (uint64_t i = 0; i <= change_count && status == 0; i++) {
        const uint64_t end = i < change_count ? changes[i].face : block->face_count;
        const uint64_t bare = check->lacks_texcoord ? count_bare(block, begin, end, &corner) : 0;
        status = note_material(scan, material, block->file, end - begin, bare);
        material = i < change_count ? changes[i].material : material;
        begin = end;
    }
    return status;
}

/* ---- comparing ---- */

/* Files that lack something, and the first of them. */
struct lacking {
    uint64_t count;
    uint32_t first;
};

static void add(struct lacking *lacking, uint64_t file)
{
    if (lacking->count++ == 0)
        lacking->first = (uint32_t)file;
}

/* Warns of `lacking` files, unless there are none. loss: data of the scan is not used. */
static int warn(const struct scan *scan, const struct lacking *lacking, bool loss, const char *what)
{
    const char *path = scan->paths[lacking->first];
    if (lacking->count == 0)
        return 0;
    if (loss)
        return bsq_warn_loss(scan->ctx, "%s: %s; files like this: %llu", path, what,
                             (unsigned long long)lacking->count);
    bsq_warn(scan->ctx, "%s: %s; files like this: %llu", path, what,
             (unsigned long long)lacking->count);
    return 0;
}

/* Warns of colours. Files are white if they have none of their own. */
static int compare_colors(const struct scan *scan)
{
    struct lacking materials = {0}, vertices = {0}, paint = {0};
    for (uint64_t i = 0; i < scan->file_count; i++) {
        const struct scan_file *file = &scan->files[i];
        const bool own = file->has_colors || file->paint == SCAN_PAINT_USED;
        if (file->paint != SCAN_PAINT_NONE && !scan->totals.unread_colors && !file->has_colors &&
            (!scan->has_colors || file->paint == SCAN_PAINT_LOST))
            add(&paint, i);
        if (!scan->has_colors || own || !file->has_faces)
            continue;
        add(file->has_material_colors ? &materials : &vertices, i);
    }
    int status;
    BSQ_TRY(
        warn(scan, &paint, true,
             "ZBrush's polypaint is not used beside files without it: export a texture of it, or "
             "vertex colours"));
    BSQ_TRY(warn(scan, &materials, true,
                 "colours of materials are not used, because other files of the scan have vertex "
                 "colours"));
    status =
        warn(scan, &vertices, false,
             "no vertex colours, so what has no texture is white; other files of the scan have "
             "vertex colours");
done:
    return status;
}

/* Warns of files without faces, which add nothing to the scan. */
static int report_faceless(const struct scan *scan)
{
    struct lacking bytes = {0}, points = {0}, faces = {0};
    for (uint64_t i = 0; i < scan->file_count; i++) {
        const struct scan_file *file = &scan->files[i];
        const uint64_t before = i > 0 ? file[-1].ends[FMT_MESH_VERTEX] : 0;
        if (!file->has_faces)
            add(file->bytes == 0                       ? &bytes
                : file->ends[FMT_MESH_VERTEX] > before ? &points
                                                       : &faces,
                i);
    }
    int status;
    BSQ_TRY(warn(scan, &bytes, true, "an empty file, it adds nothing to the scan"));
    BSQ_TRY(warn(scan, &points, true, "no faces, only vertices; it adds nothing to the scan"));
    status = warn(scan, &faces, true, "no faces; it adds nothing to the scan");
done:
    return status;
}

int vox_scan_compare_files(struct scan *scan, const char *texture_path)
{
    struct lacking normals = {0}, texcoords = {0};
    if (scan->file_count < 2)
        return 0;
    for (uint64_t i = 0; i < scan->file_count; i++) {
        const struct scan_file *file = &scan->files[i];
        if (file->has_faces && scan->has_normals && !file->has_normals)
            add(&normals, i);
        if (file->has_faces && texture_path && scan_count(scan, SCAN_TEXCOORDS) > 0 &&
            !file->has_texcoords)
            add(&texcoords, i);
    }
    int status;
    BSQ_TRY(report_faceless(scan));
    BSQ_TRY(compare_colors(scan));
    BSQ_TRY(warn(scan, &texcoords, true, "no texture coordinates, --texture is not used"));
    status = warn(scan, &normals, false,
                  "no normals, so its facets stay flat; other files of the scan have normals");
done:
    return status;
}
