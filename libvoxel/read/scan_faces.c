/* scan_faces.c - what faces say of the scan and of each of its files, and whether their indices are
 * in range.
 *
 * A corner whose texture coordinate or normal does not exist loses it. A face with a vertex that
 * has no position is left out. Files may lack faces or attributes that others have: a file without
 * faces among several may be a download that failed, so it is a loss. One without vertex colours is
 * white beside files with such colours, and its facets are flat beside files with normals. Users
 * learn of both, because they may not expect it. */
#include "base/context.h"
#include "libvoxel/read/scan.h"

#include <inttypes.h>
#include <string.h>

/* ---- what refers to nothing ---- */

static bool lacks_position(const struct scan_missing *missing, const uint64_t *corners,
                           uint32_t size)
{
    for (uint32_t i = 0; i < size; i++)
        if (scan_is_missing(missing, corners[i]))
            return true;
    return false;
}

/* Drops indices of one kind of a face that name nothing. The reader has counted indices of missing
 * elements. */
static void drop_indices(const struct scan *scan, enum fmt_mesh_kind kind, uint64_t *indices,
                         uint32_t size, uint64_t face, struct scan_face_check *check)
{
    const uint64_t end = scan_file_end(scan, check->faces.file, kind);
    for (uint32_t i = 0; i < size; i++) {
        if (indices[i] == FMT_MESH_NONE)
            continue;
        if (indices[i] >= end)
            fmt_mesh_add_loss(&check->lost[kind], 1, face);
        if (indices[i] >= end || scan_is_missing(&scan->missing[kind], indices[i]))
            indices[i] = FMT_MESH_NONE;
    }
}

/* Removes faces and indices whose elements do not exist, and counts them. Vertex indices are in
 * range. */
static void clean_faces(const struct scan *scan, struct scan_face_check *check)
{
    struct fmt_mesh_batch *b = &check->faces;
    uint64_t *const indices[FMT_MESH_KIND_COUNT] = {b->corner_vertices, b->corner_texcoords,
                                                    b->corner_normals};
    uint64_t corner = 0, faces = 0, corners = 0, change = 0;
    for (uint64_t f = 0; f < b->face_count; f++) {
        const uint32_t size = b->face_sizes[f];
        const uint64_t face = b->face_base + f, first = corner;
        corner += size;
        for (; change < b->material_change_count && b->material_changes[change].face <= f; change++)
            b->material_changes[change].face = faces;
        if (lacks_position(&scan->missing[FMT_MESH_VERTEX], indices[0] + first, size)) {
            fmt_mesh_add_loss(&check->lost[FMT_MESH_VERTEX], 1, face);
            continue;
        }
        for (int kind = 0; kind < FMT_MESH_KIND_COUNT; kind++) {
            if (indices[kind] && kind != FMT_MESH_VERTEX)
                drop_indices(scan, (enum fmt_mesh_kind)kind, indices[kind] + first, size, face,
                             check);
            if (indices[kind])
                memmove(indices[kind] + corners, indices[kind] + first, size * sizeof(uint64_t));
        }
        b->face_sizes[faces++] = size;
        corners += size;
    }
    b->face_count = faces;
    b->corner_count = corners;
    b->material_change_count = change;
}

/* ---- checking ---- */

static bool any_none(const uint64_t *indices, uint64_t count)
{
    bool any = false;
    for (uint64_t i = 0; i < count; i++)
        any |= indices[i] == FMT_MESH_NONE;
    return any;
}

static uint32_t largest_face(const struct fmt_mesh_batch *batch)
{
    uint32_t largest = 3;
    if (batch->corner_count == 3 * batch->face_count)
        return largest;
    for (uint64_t f = 0; f < batch->face_count; f++)
        largest = batch->face_sizes[f] > largest ? batch->face_sizes[f] : largest;
    return largest;
}

static bool any_missing(const struct scan *scan, enum fmt_mesh_kind kind, const uint64_t *indices,
                        uint64_t count)
{
    bool any = false;
    for (uint64_t i = 0; scan->missing[kind].words > 0 && i < count; i++)
        any |= scan_is_missing(&scan->missing[kind], indices[i]);
    return any;
}

/* Counts the faces with a vertex that has no colour. */
static uint64_t count_colorless(const struct scan *scan, const struct fmt_mesh_batch *batch)
{
    uint64_t count = 0, corner = 0;
    for (uint64_t f = 0; scan->missing_colors.words > 0 && f < batch->face_count; f++) {
        bool any = false;
        for (uint32_t k = 0; k < batch->face_sizes[f]; k++)
            any |= scan_is_missing(&scan->missing_colors, batch->corner_vertices[corner++]);
        count += any;
    }
    return count;
}

/* Returns whether some index of this kind names nothing. */
static bool any_lost(const struct scan *scan, uint32_t file, enum fmt_mesh_kind kind,
                     const uint64_t *indices, uint64_t count)
{
    const uint64_t end = scan_file_end(scan, file, kind);
    return indices &&
           (!fmt_mesh_all_below(indices, count, end) || any_missing(scan, kind, indices, count));
}

void vox_scan_check_faces(const struct scan *scan, const struct fmt_mesh_batch *batch,
                          struct scan_face_check *out)
{
    const uint64_t vertices = scan_file_end(scan, batch->file, FMT_MESH_VERTEX);
    const uint64_t all = batch->corner_count;
    const uint64_t *texcoords = batch->corner_texcoords, *normals = batch->corner_normals;
    *out = (struct scan_face_check){.faces = *batch, .max_size = 3};
    struct scan_bad_index *bad = &out->bad_index;
    bad->found = !fmt_mesh_check_vertices(batch, vertices, &bad->face, &bad->index);
    if (bad->found)
        return;
    if (any_missing(scan, FMT_MESH_VERTEX, batch->corner_vertices, all) ||
        any_lost(scan, batch->file, FMT_MESH_TEXCOORD, texcoords, all) ||
        any_lost(scan, batch->file, FMT_MESH_NORMAL, normals, all))
        clean_faces(scan, out);
    const struct fmt_mesh_batch *faces = &out->faces;
    out->max_size = largest_face(faces);
    out->colorless = count_colorless(scan, faces);
    out->lacks_texcoord = !texcoords || any_none(texcoords, faces->corner_count);
    out->has_texcoords = fmt_mesh_any_index(texcoords, faces->corner_count);
    out->has_normals = fmt_mesh_any_index(normals, faces->corner_count);
}

/* ---- what faces of each file have ---- */

/* Sets *out to the entry of a material, or to the entry of faces without one. */
static int enter_material(struct scan *scan, uint32_t material, struct scan_material_use **out)
{
    const uint64_t before = scan->material_use_count, count = (uint64_t)material + 1;
    *out = &scan->without_material;
    if (material == FMT_MESH_NO_MATERIAL)
        return 0;
    if (count > before)
        BSQ_PASS(BSQ_GROW(scan->ctx, "materials", count, &scan->material_uses,
                          &scan->material_use_capacity));
    for (uint64_t i = before; i < count; i++)
        scan->material_uses[i] = (struct scan_material_use){.file = UINT32_MAX};
    scan->material_use_count = count > before ? count : before;
    *out = &scan->material_uses[material];
    return 0;
}

/* Notes which file uses a material, and counts its faces, and those without texture coordinates. */
static int note_material(struct scan *scan, uint32_t material, uint32_t file, uint64_t faces,
                         uint64_t bare_faces)
{
    struct scan_material_use *use;
    BSQ_PASS(enter_material(scan, material, &use));
    use->file = file;
    use->faces += faces;
    use->bare_faces += bare_faces;
    return 0;
}

/* Counts the faces from `begin` to `end` with a corner that has no texture coordinate. *corner: the
 * first one of these faces; becomes the one after them. */
static uint64_t count_bare(const struct fmt_mesh_batch *batch, uint64_t begin, uint64_t end,
                           uint64_t *corner)
{
    uint64_t count = 0;
    if (!batch->corner_texcoords)
        return end - begin;
    for (uint64_t f = begin; f < end; f++) {
        bool bare = false;
        for (uint32_t k = 0; k < batch->face_sizes[f]; k++)
            bare |= batch->corner_texcoords[(*corner)++] == FMT_MESH_NONE;
        count += bare;
    }
    return count;
}

/* Notes what faces of a file have, whose elements have been noted. */
static int note_file_faces(struct scan *scan, const struct scan_face_check *check)
{
    const struct fmt_mesh_batch *batch = &check->faces;
    /* A file with faces has elements too: otherwise all its indices are out of range. */
    struct scan_file *file = &scan->files[batch->file];
    file->has_faces = true;
    file->colorless_faces += check->colorless;
    file->has_normals |= check->has_normals;
    file->has_texcoords |= check->has_texcoords;
    const struct fmt_mesh_material_change *changes = batch->material_changes;
    const uint64_t change_count = batch->material_change_count;
    uint32_t material = batch->material_at_start;
    uint64_t begin = 0, corner = 0;
    for (uint64_t i = 0; i <= change_count; i++) {
        const uint64_t end = i < change_count ? changes[i].face : batch->face_count;
        const uint64_t bare = check->lacks_texcoord ? count_bare(batch, begin, end, &corner) : 0;
        BSQ_PASS(note_material(scan, material, batch->file, end - begin, bare));
        material = i < change_count ? changes[i].material : material;
        begin = end;
    }
    return 0;
}

int vox_scan_note_faces(struct scan *scan, const struct scan_face_check *check)
{
    if (scan->bad_index.found)
        return 0;
    scan->bad_index = check->bad_index;
    for (int kind = 0; kind < FMT_MESH_KIND_COUNT; kind++)
        fmt_mesh_add_loss(&scan->lost[kind], check->lost[kind].count, check->lost[kind].face);
    scan->lacks_texcoord |= check->lacks_texcoord;
    scan->has_normals |= check->has_normals;
    return note_file_faces(scan, check);
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
    BSQ_PASS(
        warn(scan, &paint, true,
             "ZBrush's polypaint is not used beside files without it: export a texture of it, or "
             "vertex colours"));
    BSQ_PASS(warn(scan, &materials, true,
                  "colours of materials are not used, because other files of the scan have vertex "
                  "colours"));
    return warn(scan, &vertices, false,
                "no vertex colours, so what has no texture is white; other files of the scan have "
                "vertex colours");
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
    BSQ_PASS(warn(scan, &bytes, true, "an empty file, it adds nothing to the scan"));
    BSQ_PASS(warn(scan, &points, true, "no faces, only vertices; it adds nothing to the scan"));
    return warn(scan, &faces, true, "no faces; it adds nothing to the scan");
}

int vox_scan_warn_colorless(const struct scan *scan)
{
    uint64_t count = 0, first = 0; /* faces; a file */
    for (uint64_t i = 0; i < scan->file_count; i++) {
        if (!scan->files[i].has_colors || !scan->files[i].has_material_colors)
            continue;
        first = count > 0 ? first : i;
        count += scan->files[i].colorless_faces;
    }
    return count == 0
               ? 0
               : bsq_warn_loss(scan->ctx,
                               "%s: faces at vertices without a colour: %" PRIu64
                               "; these are white, and colours of materials are not used, because "
                               "other vertices have colours",
                               scan->paths[first], count);
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
    BSQ_PASS(report_faceless(scan));
    BSQ_PASS(compare_colors(scan));
    BSQ_PASS(warn(scan, &texcoords, true, "no texture coordinates, --texture is not used"));
    return warn(scan, &normals, false,
                "no normals, so its facets stay flat; other files of the scan have normals");
}
