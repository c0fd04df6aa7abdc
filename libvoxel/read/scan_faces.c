/* scan_faces.c - what a block's faces say of the scan, and whether their indices are in range.
 *
 * A block with something that refers to nothing is copied. A corner whose texture coordinate or
 * normal does not exist loses it. A face with a vertex that has no position is left out. */
#include "libvoxel/read/scan.h"

#include <math.h>
#include <string.h>

/* ---- missing elements ---- */

/* Makes the bits long enough for `count` elements. */
static int extend(struct bsq_ctx *ctx, struct scan_missing *missing, uint64_t count)
{
    const uint64_t words = count / 64 + 1;
    if (words <= missing->words)
        return 0;
    int status = bsq_grow(ctx, "elements that are missing", words, sizeof *missing->bits,
                          &missing->bits, &missing->capacity);
    if (status < 0)
        return status;
    memset(missing->bits + missing->words, 0, (words - missing->words) * sizeof *missing->bits);
    missing->words = words;
    return 0;
}

static void mark(struct scan_missing *missing, uint64_t index)
{
    missing->bits[index / 64] |= (uint64_t)1 << index % 64;
}

int vox_scan_note_missing(struct scan *scan, const struct fmt_mesh_block *block)
{
    struct scan_missing *vertices = &scan->missing[FMT_MESH_VERTEX];
    struct scan_missing *texcoords = &scan->missing[FMT_MESH_TEXCOORD];
    int status = 0;
    if (block->missing_positions > 0)
        status = extend(scan->ctx, vertices, block->vertex_base + block->vertex_count);
    if (status == 0 && block->missing_texcoords > 0)
        status = extend(scan->ctx, texcoords, block->texcoord_base + block->texcoord_count);
    if (status < 0)
        return status;
    for (uint64_t i = 0; block->missing_positions > 0 && i < block->vertex_count; i++)
        if (isnan(block->positions[i][0]))
            mark(vertices, block->vertex_base + i);
    for (uint64_t i = 0; block->missing_texcoords > 0 && i < block->texcoord_count; i++)
        if (isnan(block->texcoords[i][0]))
            mark(texcoords, block->texcoord_base + i);
    return 0;
}

static bool is_colored(const struct fmt_mesh_block *block, uint64_t vertex)
{
    return block->colors && scan_color_given(block->colors[vertex]);
}

int vox_scan_note_missing_colors(struct scan *scan, const struct fmt_mesh_block *block)
{
    const bool colored_before = scan->files[block->file].has_colors;
    const uint64_t base = block->vertex_base, end = base + block->vertex_count;
    /* The first colours of a file show that all vertices before them lack one. */
    uint64_t first = base, vertex = 0;
    if (block->color_white > 0.0f || (!block->colors && !colored_before))
        return 0;
    if (!colored_before)
        first = block->file > 0 ? scan->files[block->file - 1].ends[FMT_MESH_VERTEX] : 0;
    while (vertex < block->vertex_count && is_colored(block, vertex))
        vertex++;
    if (first == base && vertex == block->vertex_count)
        return 0;
    int status = extend(scan->ctx, &scan->missing_colors, end);
    for (uint64_t i = first; status == 0 && i < base; i++)
        mark(&scan->missing_colors, i);
    for (; status == 0 && vertex < block->vertex_count; vertex++)
        if (!is_colored(block, vertex))
            mark(&scan->missing_colors, base + vertex);
    return status;
}

uint64_t vox_scan_missing_memory(const struct scan *scan)
{
    uint64_t words = scan->missing_colors.capacity;
    for (int kind = 0; kind < FMT_MESH_KIND_COUNT; kind++)
        words += scan->missing[kind].capacity;
    return words * sizeof(uint64_t);
}

/* ---- copying ---- */

static int reserve(struct bsq_ctx *ctx, const struct fmt_mesh_block *block,
                   const uint64_t *const indices[FMT_MESH_KIND_COUNT],
                   struct scan_clean_faces *clean)
{
    int status = bsq_grow(ctx, "faces", block->face_count, sizeof *clean->sizes, &clean->sizes,
                          &clean->size_capacity);
    for (int kind = 0; status == 0 && kind < FMT_MESH_KIND_COUNT; kind++)
        if (indices[kind])
            status = bsq_grow(ctx, "faces", block->corner_count, sizeof *clean->corners[kind],
                              &clean->corners[kind], &clean->corner_capacity[kind]);
    if (status == 0 && block->material_change_count > 0)
        status = bsq_grow(ctx, "faces", block->material_change_count, sizeof *clean->changes,
                          &clean->changes, &clean->change_capacity);
    return status;
}

static void count_loss(struct scan_loss *loss, uint64_t face)
{
    if (!loss->count++)
        loss->face = face;
}

static bool lacks_position(const struct scan_missing *missing, const uint64_t *corners,
                           uint32_t size)
{
    for (uint32_t i = 0; i < size; i++)
        if (scan_is_missing(missing, corners[i]))
            return true;
    return false;
}

/* Copies the indices of one kind of a face, and drops indices that name nothing. The reader has
 * counted indices of missing elements. */
static void copy_indices(const struct scan *scan, const uint64_t *from, uint32_t size, int kind,
                         uint64_t face, uint64_t *to, struct scan_face_check *check)
{
    const uint64_t end = scan_file_end(scan, check->block->file, (enum fmt_mesh_kind)kind);
    for (uint32_t i = 0; i < size; i++) {
        to[i] = from[i];
        if (from[i] == FMT_MESH_NONE)
            continue;
        if (from[i] >= end)
            count_loss(&check->lost[kind], face);
        if (from[i] >= end || scan_is_missing(&scan->missing[kind], from[i]))
            to[i] = FMT_MESH_NONE;
    }
}

/* Makes the copy, and counts what it lacks in *check. Vertex indices are in range. */
static int clean_faces(const struct scan *scan, const struct fmt_mesh_block *block,
                       struct scan_clean_faces *clean, struct scan_face_check *check)
{
    const uint64_t *const indices[FMT_MESH_KIND_COUNT] = {
        block->corner_vertices, block->corner_texcoords, block->corner_normals};
    int status = reserve(scan->ctx, block, indices, clean);
    if (status < 0)
        return status;
    uint64_t corner = 0, faces = 0, corners = 0, change = 0;
    for (uint64_t f = 0; f < block->face_count; corner += block->face_sizes[f++]) {
        const uint32_t size = block->face_sizes[f];
        const uint64_t face = block->face_base + f;
        for (; change < block->material_change_count && block->material_changes[change].face <= f;
             change++)
            clean->changes[change] = (struct fmt_mesh_material_change){
                .face = faces, .material = block->material_changes[change].material};
        if (lacks_position(&scan->missing[FMT_MESH_VERTEX], indices[0] + corner, size)) {
            count_loss(&check->lost[FMT_MESH_VERTEX], face);
            continue;
        }
        memcpy(clean->corners[0] + corners, indices[0] + corner, size * sizeof(uint64_t));
        for (int kind = FMT_MESH_TEXCOORD; kind <= FMT_MESH_NORMAL; kind++)
            if (indices[kind])
                copy_indices(scan, indices[kind] + corner, size, kind, face,
                             clean->corners[kind] + corners, check);
        clean->sizes[faces++] = size;
        corners += size;
    }
    clean->block = *block;
    clean->block.face_count = faces;
    clean->block.corner_count = corners;
    clean->block.face_sizes = clean->sizes;
    clean->block.corner_vertices = clean->corners[0];
    clean->block.corner_texcoords = indices[1] ? clean->corners[1] : NULL;
    clean->block.corner_normals = indices[2] ? clean->corners[2] : NULL;
    clean->block.material_changes = clean->changes;
    clean->block.material_change_count = change;
    return 0;
}

void vox_scan_clean_free(struct bsq_ctx *ctx, struct scan_clean_faces *clean)
{
    bsq_free(ctx, clean->sizes);
    for (int kind = 0; kind < FMT_MESH_KIND_COUNT; kind++)
        bsq_free(ctx, clean->corners[kind]);
    bsq_free(ctx, clean->changes);
    memset(clean, 0, sizeof *clean);
}

/* ---- checking ---- */

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
        int status = clean_faces(scan, block, clean, out);
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
