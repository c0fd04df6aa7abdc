/* face_check.c - what a block's faces say of the scan, and whether their indices are in range. */
#include "libvoxel/read/scan.h"

/* Checks that no index but "none" is `end` or more. Indices and ends are below 2^62, so the sign of
 * the difference tells; "none" wraps to `end`. */
static bool all_below(const uint64_t *indices, uint64_t count, uint64_t end)
{
    uint64_t differences = 0;
    for (uint64_t i = 0; i < count; i++)
        differences |= end - 1 - indices[i];
    return differences >> 63 == 0;
}

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

/* Finds the first vertex index that is not below `end`; there is one. */
static struct scan_bad_index find_bad_index(const struct fmt_mesh_block *block, uint64_t end)
{
    uint64_t f = 0, first = 0, corner = 0;
    while (block->corner_vertices[corner] < end)
        corner++;
    for (; first + block->face_sizes[f] <= corner; f++)
        first += block->face_sizes[f];
    return (struct scan_bad_index){true, FMT_MESH_VERTEX, block->face_base + f,
                                   block->corner_vertices[corner]};
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
    return indices && (!all_below(indices, count, end) || any_missing(scan, kind, indices, count));
}

int vox_scan_check_faces(const struct scan *scan, const struct fmt_mesh_block *block,
                         struct scan_clean_faces *clean, struct scan_face_check *out)
{
    const uint64_t vertices = scan_file_end(scan, block->file, FMT_MESH_VERTEX);
    const uint64_t all = block->corner_count;
    *out = (struct scan_face_check){.block = block, .max_size = 3};
    if (!all_below(block->corner_vertices, all, vertices)) {
        out->bad_index = find_bad_index(block, vertices);
        return 0;
    }
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
