/* face_check.c - what a block's faces say of the scan, and whether their indices are in range. */
#include "libvoxel/read/scan.h"

static bool any_none(const uint64_t *indices, uint64_t count)
{
    bool any = false;
    for (uint64_t i = 0; i < count; i++)
        any |= indices[i] == FMT_MESH_NONE;
    return any;
}

static bool any_index(const uint64_t *indices, uint64_t count)
{
    for (uint64_t i = 0; i < count; i++)
        if (indices[i] != FMT_MESH_NONE)
            return true;
    return false;
}

static uint32_t largest_face(const struct fmt_mesh_block *block)
{
    uint32_t largest = 3;
    if (block->corner_count == 3 * block->face_count)
        return largest;
    for (uint64_t f = 0; f < block->face_count; f++)
        largest = block->face_sizes[f] > largest ? block->face_sizes[f] : largest;
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

/* Returns whether some index of this kind names nothing. */
static bool any_lost(const struct scan *scan, uint32_t file, enum fmt_mesh_kind kind,
                     const uint64_t *indices, uint64_t count)
{
    const uint64_t end = scan_file_end(scan, file, kind);
    return indices &&
           (!fmt_mesh_all_below(indices, count, end) || any_missing(scan, kind, indices, count));
}

int vox_scan_check_faces(const struct scan *scan, const struct fmt_mesh_block *block,
                         struct scan_clean_faces *clean, struct scan_face_check *out)
{
    const uint64_t vertices = scan_file_end(scan, block->file, FMT_MESH_VERTEX);
    const uint64_t all = block->corner_count;
    *out = (struct scan_face_check){.block = block, .max_size = 3};
    struct scan_bad_index *bad = &out->bad_index;
    bad->found = !fmt_mesh_check_vertices(block, vertices, &bad->face, &bad->index);
    if (bad->found)
        return 0;
    if (any_missing(scan, FMT_MESH_VERTEX, block->corner_vertices, all) ||
        any_lost(scan, block->file, FMT_MESH_TEXCOORD, block->corner_texcoords, all) ||
        any_lost(scan, block->file, FMT_MESH_NORMAL, block->corner_normals, all)) {
        int status = vox_scan_clean_faces(scan, block, clean, out);
        if (status < 0)
            return status;
        out->block = block = &clean->block;
    }
    const uint64_t *texcoords = block->corner_texcoords, *normals = block->corner_normals;
    out->max_size = largest_face(block);
    out->lacks_texcoord = !texcoords || any_none(texcoords, block->corner_count);
    out->has_texcoords = texcoords && any_index(texcoords, block->corner_count);
    out->has_normals = normals && any_index(normals, block->corner_count);
    return 0;
}

static void add_loss(struct scan_loss *to, const struct scan_loss *loss)
{
    to->face = to->count > 0 ? to->face : loss->face;
    to->count += loss->count;
}

int vox_scan_note_faces(struct scan *scan, const struct scan_face_check *check)
{
    if (scan->bad_index.found)
        return 0;
    scan->bad_index = check->bad_index;
    for (int kind = 0; kind < FMT_MESH_KIND_COUNT; kind++)
        add_loss(&scan->lost[kind], &check->lost[kind]);
    scan->lacks_texcoord |= check->lacks_texcoord;
    scan->has_normals |= check->has_normals;
    scan->max_face_size =
        check->max_size > scan->max_face_size ? check->max_size : scan->max_face_size;
    return vox_scan_note_file_faces(scan, check);
}
