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
    to.inconsistent_at =
        to.vertex_groups_at +
        (smooth ? bsq_align_up(vertex_groups * sizeof(struct vox_box), BSQ_ALIGNMENT) : 0);
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

/* Computes the points of all vertices. */
static void place_points(const struct vox_transform *transform, struct vox_chunk_content *content)
{
    const struct vox_row_transform rows = vox_row_transform_of(transform);
    const struct fmt_tris_chunk *source = &content->chunk.source;
    double(*points)[4] = (double(*)[4])(void *)(content->memory + content->layout.points_at);
    for (uint32_t v = 0; v < source->vertex_count; v++)
        row_store(vox_place(&rows, row_of_floats(source->positions[v])), points[v]);
    content->chunk.points = (const double(*)[4])points;
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

/* Makes the normals of vertices. */
static int make_normals(const struct vox_chunk_source *from, const struct vox_smooth_lender *lender,
                        uint32_t number, const struct vox_chunk_content *content,
                        float (*normals)[4])
{
    const struct vox_chunk *chunk = &content->chunk;
    const struct vox_smooth_chunk smooth = {
        .index = number, .decoded = {&chunk->source, chunk->groups, content->vertex_groups}};
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
    place_points(from->transform, content);
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
