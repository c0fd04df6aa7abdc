/* chunk_content.c - what voxelizing needs of a chunk: points in index space, groups, normals. */
#include "libvoxel/voxelize/cache/chunk_content.h"

#include <math.h>
#include <string.h>

#include "base/octahedral.h"
#include "libvoxel/voxelize/cache/scan_normals_check.h"

/* ---- layout ---- */

/* Returns the layout for a chunk, or for the largest one. load_bytes: what fmt_tris_load()
 * needs. */
static struct vox_chunk_layout lay_out(const struct fmt_tris_file *file, bool smooth,
                                       uint64_t load_bytes, uint32_t vertices, uint32_t triangles)
{
    bool normals = smooth || (fmt_tris_get_header(file)->attributes & FMT_TRIS_NORMALS);
    uint64_t groups = vox_group_count(triangles, VOX_GROUP_TRIANGLES);
    uint64_t vertex_groups = vox_group_count(vertices, VOX_GROUP_VERTICES);
    struct vox_chunk_layout to;
    to.points_at = bsq_align_up(load_bytes, BSQ_ALIGNMENT);
    to.normals_at = to.points_at + bsq_align_up(vertices * sizeof(double[4]), BSQ_ALIGNMENT);
    to.groups_at =
        to.normals_at + (normals ? bsq_align_up(vertices * sizeof(float[4]), BSQ_ALIGNMENT) : 0);
    to.vertex_groups_at =
        to.groups_at + bsq_align_up(groups * sizeof(struct vox_box), BSQ_ALIGNMENT);
    to.used_at = to.vertex_groups_at +
                 (smooth ? bsq_align_up(vertex_groups * sizeof(struct vox_box), BSQ_ALIGNMENT) : 0);
    to.inconsistent_at = to.used_at + bsq_align_up(vertex_groups * sizeof(bool), BSQ_ALIGNMENT);
    to.bytes = to.inconsistent_at + bsq_align_up(groups * sizeof(bool), BSQ_ALIGNMENT);
    return to;
}

/* Returns a layout as small as the chunk needs: memory that is not touched takes no pages. */
static struct vox_chunk_layout layout_of(const struct vox_chunk_source *from, uint32_t chunk)
{
    const struct fmt_tris_chunk_info *info = &fmt_tris_chunks(from->file)[chunk];
    return lay_out(from->file, from->smooth != NULL, fmt_tris_load_size(from->file, chunk),
                   info->vertex_count, info->triangle_count);
}

uint64_t vox_chunks_slot_bytes(const struct fmt_tris_file *file, bool smooth)
{
    const struct fmt_tris_header *header = fmt_tris_get_header(file);
    const struct fmt_tris_chunk_info *infos = fmt_tris_chunks(file);
    uint32_t vertices = 0, triangles = 0;
    for (uint64_t i = 0; i < header->chunk_count; i++) {
        vertices = infos[i].vertex_count > vertices ? infos[i].vertex_count : vertices;
        triangles = infos[i].triangle_count > triangles ? infos[i].triangle_count : triangles;
    }
    return lay_out(file, smooth, fmt_tris_load_size_max(file), vertices, triangles).bytes;
}

/* ---- the two steps ---- */

/* Computes the points of vertices from `begin` to `end`. */
static void place_vertices(const struct vox_transform *transform,
                           const struct fmt_tris_chunk *source, uint32_t begin, uint32_t end,
                           double (*points)[4])
{
    const struct vox_row_transform rows = vox_row_transform_of(transform);
    for (uint32_t v = begin; v < end; v++)
        row_store(vox_place(&rows, row_of_floats(source->positions[v])), points[v]);
}

/* Marks the groups of vertices that a group of triangles has. */
static void mark_used(const struct fmt_tris_chunk *source, uint32_t group, bool *used)
{
    uint32_t t = group * VOX_GROUP_TRIANGLES;
    const uint32_t end = vox_group_end(t, source->triangle_count, VOX_GROUP_TRIANGLES);
    for (; t < end; t++)
        for (int corner = 0; corner < 3; corner++)
            used[source->triangles[t][corner] / VOX_GROUP_VERTICES] = true;
}

/* Computes the points of all vertices whose triangles may touch regions that are made. The normals
 * of a file are judged by chunks as a whole, which need all points. */
static void place_points(const struct vox_chunk_source *from, struct vox_chunk_content *content)
{
    struct vox_chunk *chunk = &content->chunk;
    const struct fmt_tris_chunk *source = &chunk->source;
    double(*points)[4] = (double(*)[4])(void *)(content->memory + content->layout.points_at);
    bool *used = (bool *)(content->memory + content->layout.used_at);
    const uint32_t vertices = source->vertex_count;
    const bool all = !from->filter || source->normals;
    content->empty = from->filter != NULL;
    memset(used, all, vox_group_count(vertices, VOX_GROUP_VERTICES) * sizeof *used);
    for (uint32_t g = 0; from->filter && g < chunk->group_count; g++) {
        if (!vox_is_wanted(from->filter, &chunk->groups[g]))
            continue;
        content->empty = false;
        mark_used(source, g, used);
    }
    chunk->points = (const double(*)[4])points;
    for (uint32_t v = 0; v < vertices && !content->empty; v += VOX_GROUP_VERTICES)
        if (used[v / VOX_GROUP_VERTICES])
            place_vertices(from->transform, source, v,
                           vox_group_end(v, vertices, VOX_GROUP_VERTICES), points);
}

static void unpack_normals(const struct fmt_tris_chunk *source, float (*normals)[4])
{
    for (uint32_t v = 0; v < source->vertex_count; v++) {
        struct bsq_vec3 n = bsq_oct_unpack(source->normals[v]);
        normals[v][0] = n.x;
        normals[v][1] = n.y;
        normals[v][2] = n.z;
        normals[v][3] = 0.0f;
    }
}

/* Mean square of an edge, in voxels, above which a chunk gets smooth vertex normals
 * (docs/decisions/0021-when-voxels-need-planes-or-normals.md). */
#define COARSE_EDGE_SQUARE 0.5
/* Above this mean square the scan's own normals are trusted more than its facets' planes, even if
 * the two contradict each other. */
#define LARGE_EDGE_SQUARE 4.0
/* Above this mean square smooth normals blend well without planes if fragments would be lifted
 * far. */
#define WIDE_EDGE_SQUARE 6.0

/* Facet-noise weight of records per square of an edge in voxels (docs/decisions/0021): of facets
 * without vertex normals, and of triangles with smooth ones. */
#define NOISE_OF_FACETS   2.7
#define NOISE_OF_VERTICES 0.4

/* Returns the mean square of the triangles' first edges, in voxels of size h. */
static double mean_edge_square(const struct fmt_tris_chunk *source, double h)
{
    struct row sums = row_of(0.0, 0.0, 0.0, 0.0);
    for (uint32_t t = 0; t < source->triangle_count; t++) {
        const uint32_t *v = source->triangles[t];
        struct row edge = row_difference(row_of_floats(source->positions[v[1]]),
                                         row_of_floats(source->positions[v[0]]));
        sums = row_sum(sums, row_product(edge, edge));
    }
    return (row_number(sums, 0) + row_number(sums, 1) + row_number(sums, 2)) / (h * h) /
           (double)source->triangle_count;
}

static void widen(struct vox_box *box, const struct vox_box *by)
{
    for (int a = 0; a < 3; a++) {
        box->lo[a] = by->lo[a] < box->lo[a] ? by->lo[a] : box->lo[a];
        box->hi[a] = by->hi[a] > box->hi[a] ? by->hi[a] : box->hi[a];
    }
}

/* Returns whether a box is wider than a region. */
static bool is_wide(const struct vox_box *box)
{
    bool wide = false;
    for (int a = 0; a < 3; a++)
        wide |= box->hi[a] - box->lo[a] >= VOX_REGION_SIZE;
    return wide;
}

/* Widens `needed` by the triangles of a group that may touch regions that are made. A group that
 * reaches across a jump of the curve is wide, but its triangles are not. */
static void add_needed(const struct vox_chunk_source *from, const struct vox_chunk *chunk,
                       uint32_t group, struct vox_box *needed)
{
    const struct vox_box_filter *filter = from->filter;
    const struct vox_box *box = &chunk->groups[group];
    uint32_t t = group * VOX_GROUP_TRIANGLES;
    const uint32_t end = vox_group_end(t, chunk->source.triangle_count, VOX_GROUP_TRIANGLES);
    if (!vox_is_wanted(filter, box))
        return;
    if (!is_wide(box)) {
        widen(needed, box);
        return;
    }
    for (; t < end; t++) {
        const struct vox_box of_triangle =
            vox_triangle_box(&chunk->source, from->transform, t, t + 1);
        if (vox_is_wanted(filter, &of_triangle))
            widen(needed, &of_triangle);
    }
}

/* Returns whether a box is part of another one. */
static bool is_within(const struct vox_box *box, const struct vox_box *other)
{
    bool within = true;
    for (int a = 0; a < 3; a++)
        within &= other->lo[a] <= box->lo[a] && box->hi[a] <= other->hi[a];
    return within;
}

/* Widens the bounds by those vertices of a group that lie in a box. Only groups across its borders
 * need the voxels of their vertices. */
static void bound_group(const struct vox_chunk_source *from,
                        const struct vox_chunk_content *content, uint32_t group,
                        const struct vox_box *box, struct vox_bounds *bounds)
{
    const struct fmt_tris_chunk *source = &content->chunk.source;
    const uint32_t begin = group * VOX_GROUP_VERTICES;
    const uint32_t end = vox_group_end(begin, source->vertex_count, VOX_GROUP_VERTICES);
    if (is_within(&content->vertex_groups[group], box)) {
        for (uint32_t v = begin; v < end; v++)
            vox_widen_bounds(bounds, source->positions[v]);
        return;
    }
    const four_ints lo = {box->lo[0], box->lo[1], box->lo[2], INT32_MIN};
    const four_ints hi = {box->hi[0], box->hi[1], box->hi[2], INT32_MAX};
    const struct vox_row_transform rows = vox_row_transform_of(from->transform);
    for (uint32_t v = begin; v < end; v++) {
        const struct row point = vox_place(&rows, row_of_floats(source->positions[v]));
        const four_ints cell = vox_cell(point, content->chunk.last_cell);
        if (!four_any((cell < lo) | (cell > hi)))
            vox_widen_bounds(bounds, source->positions[v]);
    }
}

/* Sets the voxels of all triangles that may touch regions that are made, and the bounds of the
 * vertices there. Returns false if there are none. */
static bool find_needed(const struct vox_chunk_source *from,
                        const struct vox_chunk_content *content, struct vox_box *needed,
                        float min[3], float max[3])
{
    const struct vox_chunk *chunk = &content->chunk;
    const uint32_t groups = vox_group_count(chunk->source.vertex_count, VOX_GROUP_VERTICES);
    struct vox_bounds bounds = {{INFINITY, INFINITY, INFINITY}, {-INFINITY, -INFINITY, -INFINITY}};
    *needed =
        (struct vox_box){{INT32_MAX, INT32_MAX, INT32_MAX}, {INT32_MIN, INT32_MIN, INT32_MIN}};
    for (uint32_t g = 0; g < chunk->group_count; g++)
        add_needed(from, chunk, g, needed);
    if (needed->lo[0] > needed->hi[0])
        return false;
    for (uint32_t g = 0; g < groups; g++)
        if (vox_boxes_meet(&content->vertex_groups[g], needed))
            bound_group(from, content, g, needed, &bounds);
    memcpy(min, &bounds.least, 3 * sizeof *min);
    memcpy(max, &bounds.most, 3 * sizeof *max);
    return true;
}

/* Makes the normals of vertices in regions that are made. */
static int make_normals(const struct vox_chunk_source *from, const struct vox_smooth_lender *lender,
                        uint32_t number, const struct vox_chunk_content *content,
                        float (*normals)[4])
{
    const struct vox_chunk *chunk = &content->chunk;
    const struct fmt_tris_chunk_info *info = &fmt_tris_chunks(from->file)[number];
    struct vox_smooth_chunk smooth = {
        .index = number, .decoded = {&chunk->source, chunk->groups, content->vertex_groups}};
    struct vox_box needed;
    memcpy(smooth.min, info->bounds_min, sizeof smooth.min);
    memcpy(smooth.max, info->bounds_max, sizeof smooth.max);
    if (from->filter) {
        if (!find_needed(from, content, &needed, smooth.min, smooth.max))
            return 0;
        smooth.needed = &needed;
    }
    return vox_smooth_normals(from->smooth, lender, &smooth, from->transform, normals);
}

/* Marks the groups whose normals are inconsistent with their triangles. large: marks all. */
static void find_inconsistent(bool large, struct vox_chunk_content *content)
{
    struct vox_chunk *chunk = &content->chunk;
    const struct vox_own_normals own = {chunk->source.triangles, chunk->points, chunk->normals};
    bool *inconsistent = (bool *)(content->memory + content->layout.inconsistent_at), any = false;
    for (uint32_t g = 0; g < chunk->group_count; g++) {
        uint32_t begin = g * VOX_GROUP_TRIANGLES;
        uint32_t end = vox_group_end(begin, chunk->source.triangle_count, VOX_GROUP_TRIANGLES);
        inconsistent[g] = large || vox_own_normals_inconsistent(&own, begin, end);
        any |= inconsistent[g];
    }
    chunk->inconsistent = any ? inconsistent : NULL;
}

/* Computes the voxels of groups. */
static void find_groups(const struct vox_chunk_source *from, struct vox_chunk_content *content)
{
    struct vox_chunk *chunk = &content->chunk;
    const struct fmt_tris_chunk *source = &chunk->source;
    struct vox_box *groups =
        (struct vox_box *)(void *)(content->memory + content->layout.groups_at);
    struct vox_box *vertex_groups =
        (struct vox_box *)(void *)(content->memory + content->layout.vertex_groups_at);
    memcpy(chunk->last_cell, from->transform->voxels.hi, sizeof from->transform->voxels.hi);
    vox_triangle_groups(source, from->transform, groups);
    chunk->groups = groups;
    chunk->group_count = vox_group_count(source->triangle_count, VOX_GROUP_TRIANGLES);
    if (from->smooth)
        vox_vertex_groups(source, from->transform, vertex_groups);
    content->vertex_groups = vertex_groups;
}

int vox_chunk_read(const struct vox_chunk_source *from, uint32_t number,
                   struct vox_chunk_content *content)
{
    content->layout = layout_of(from, number);
    int status = fmt_tris_load(from->file, number, content->memory, &content->chunk.source);
    if (status == 0)
        find_groups(from, content);
    return status;
}

int vox_chunk_finish(const struct vox_chunk_source *from, const struct vox_smooth_lender *lender,
                     uint32_t number, struct vox_chunk_content *content)
{
    struct vox_chunk *chunk = &content->chunk;
    const struct fmt_tris_chunk *source = &chunk->source;
    float(*normals)[4] = (float(*)[4])(void *)(content->memory + content->layout.normals_at);
    int status = 0;
    place_points(from, content);
    if (content->empty)
        return 0;
    double square = mean_edge_square(source, from->transform->h);
    chunk->coarse = square > COARSE_EDGE_SQUARE;
    chunk->wide = source->normals || square > WIDE_EDGE_SQUARE;
    chunk->normals = (const float(*)[4])normals;
    chunk->inconsistent = NULL;
    chunk->noise_share = 0.0;
    if (from->smooth && !source->normals)
        chunk->noise_share = chunk->coarse ? NOISE_OF_VERTICES : NOISE_OF_FACETS;
    if (source->normals) {
        unpack_normals(source, normals);
        find_inconsistent(square > LARGE_EDGE_SQUARE, content);
    } else if (from->smooth && chunk->coarse) {
        status = make_normals(from, lender, number, content, normals);
    } else {
        chunk->normals = NULL;
    }
    return status;
}
