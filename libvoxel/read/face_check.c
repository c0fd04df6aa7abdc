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

/* Finds the first index that is not below its end; there is one. */
static struct scan_bad_index find_bad_index(const struct fmt_mesh_block *block,
                                            const uint64_t *const indices[FMT_MESH_KIND_COUNT],
                                            const uint64_t ends[FMT_MESH_KIND_COUNT])
{
    uint64_t corner = 0;
    for (uint64_t f = 0; f < block->face_count; f++)
        for (uint64_t end = corner + block->face_sizes[f]; corner < end; corner++)
            for (int kind = 0; kind < FMT_MESH_KIND_COUNT; kind++) {
                uint64_t index = indices[kind] ? indices[kind][corner] : FMT_MESH_NONE;
                if (index != FMT_MESH_NONE && index >= ends[kind])
                    return (struct scan_bad_index){true, (enum fmt_mesh_kind)kind,
                                                   block->face_base + f, index};
            }
    return (struct scan_bad_index){0};
}

void vox_scan_check_faces(const struct scan *scan, const struct fmt_mesh_block *block,
                          struct scan_face_check *out)
{
    const uint64_t *const indices[FMT_MESH_KIND_COUNT] = {
        block->corner_vertices, block->corner_texcoords, block->corner_normals};
    const uint64_t count = block->corner_count;
    uint64_t ends[FMT_MESH_KIND_COUNT];
    bool in_range = true;
    for (int kind = 0; kind < FMT_MESH_KIND_COUNT; kind++) {
        ends[kind] = scan_count(scan, scan_stream_of(kind));
        in_range &= !indices[kind] || all_below(indices[kind], count, ends[kind]);
    }
    *out = (struct scan_face_check){.max_size = largest_face(block),
                                    .lacks_texcoord = !indices[FMT_MESH_TEXCOORD] ||
                                                      any_none(indices[FMT_MESH_TEXCOORD], count),
                                    .has_normals = indices[FMT_MESH_NORMAL] &&
                                                   any_index(indices[FMT_MESH_NORMAL], count)};
    if (!in_range)
        out->bad_index = find_bad_index(block, indices, ends);
}

void vox_scan_note_faces(struct scan *scan, const struct scan_face_check *check)
{
    if (scan->bad_index.found)
        return;
    scan->bad_index = check->bad_index;
    scan->lacks_texcoord |= check->lacks_texcoord;
    scan->has_normals |= check->has_normals;
    scan->max_face_size =
        check->max_size > scan->max_face_size ? check->max_size : scan->max_face_size;
}
