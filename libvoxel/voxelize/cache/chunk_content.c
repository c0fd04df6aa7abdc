/* chunk_content.c - what voxelizing needs of a chunk: points in index space, groups, normals. */
#include "libvoxel/voxelize/cache/chunk_content.h"

#include <math.h>
#include <string.h>

#include "base/geometry/vec.h"

/* ---- layout ---- */

/* Returns the layout for a chunk, or for the largest one. load_bytes, made_bytes: what
 * fmt_tris_load() and fmt_tris_load_normals() need. */
static struct vox_chunk_layout content_lay_out(const struct fmt_tris_file *file, bool smooth,
                                               uint64_t load_bytes, uint64_t made_bytes,
                                               uint32_t vertices, uint32_t triangles)
{
    bool normals = smooth || (fmt_tris_get_header(file)->attributes & FMT_TRIS_NORMALS);
    uint64_t groups = vox_group_count(triangles, VOX_GROUP_TRIANGLES);
    struct vox_chunk_layout to;
    to.made_at = bsq_align_up(load_bytes, BSQ_ALIGNMENT);
    to.points_at = to.made_at + (smooth ? bsq_align_up(made_bytes, BSQ_ALIGNMENT) : 0);
    to.normals_at = to.points_at + bsq_align_up(vertices * sizeof(double[4]), BSQ_ALIGNMENT);
    to.groups_at =
        to.normals_at + (normals ? bsq_align_up(vertices * sizeof(float[4]), BSQ_ALIGNMENT) : 0);
    to.inconsistent_at =
        to.groups_at + bsq_align_up(groups * sizeof(struct vox_box), BSQ_ALIGNMENT);
    to.bytes = to.inconsistent_at + bsq_align_up(groups * sizeof(bool), BSQ_ALIGNMENT);
    return to;
}

/* Returns a layout as small as the chunk needs: memory that is not touched takes no pages. */
static struct vox_chunk_layout layout_of(const struct vox_chunk_source *from, uint32_t chunk)
{
    const struct fmt_tris_chunk_info *info = &fmt_tris_chunks(from->file)[chunk];
    return content_lay_out(from->file, from->smooth, fmt_tris_load_size(from->file, chunk),
                           fmt_tris_normals_size(info), info->vertex_count, info->triangle_count);
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
    return content_lay_out(file, smooth, fmt_tris_load_size_max(file),
                           fmt_tris_normals_size_max(file), vertices, triangles)
        .bytes;
}

/* ---- index space and groups ----
 *
 * Index space keeps the order of positions on each axis, so bounds are found among positions and
 * then placed. */

/* A voxel transform as rows. Loops keep it in registers: compilers load the members of the
 * transform again for each point, as the points might overwrite them. */
struct row_transform {
    struct row origin, start, size;
};

LANES_INLINE struct row_transform row_transform_of(const struct vox_transform *transform)
{
    const double *origin = transform->origin, *start = transform->start, h = transform->h;
    return (struct row_transform){row_of(origin[0], origin[1], origin[2], 0.0),
                                  row_of(start[0], start[1], start[2], 0.0), row_of(h, h, h, h)};
}

/* Returns vox_transform_coordinate() of three axes, and 0. position: three numbers and 0. */
LANES_INLINE struct row place(const struct row_transform *transform, struct row position)
{
    const struct row moved = row_sum(transform->origin, position);
    return row_quotient(row_difference(moved, transform->start), transform->size);
}

/* Bounds of positions. The fourth number is arbitrary: after three numbers of a position, the next
 * one in memory is read too. */
struct bounds {
    four_floats least, most;
};

LANES_INLINE void widen_bounds(struct bounds *bounds, const float *position)
{
    const four_floats p = four_floats_load(position);
    bounds->least = four_floats_min(p, bounds->least);
    bounds->most = four_floats_max(p, bounds->most);
}

LANES_INLINE struct bounds begin_at(const float *position)
{
    const four_floats p = four_floats_load(position);
    return (struct bounds){p, p};
}

LANES_INLINE four_ints cell_of(const struct row_transform *transform, four_floats position)
{
    float at[4];
    memcpy(at, &position, sizeof at);
    return row_floor(place(transform, row_of_floats(at)));
}

static struct vox_box box_of(const struct vox_transform *transform, const struct bounds *bounds)
{
    const int32_t *hi = transform->voxels.hi;
    const four_ints last = {hi[0], hi[1], hi[2], INT32_MAX};
    const struct row_transform rows = row_transform_of(transform);
    const four_ints low = four_min(cell_of(&rows, bounds->least), last),
                    high = four_min(cell_of(&rows, bounds->most), last);
    struct vox_box box;
    memcpy(box.lo, &low, sizeof box.lo);
    memcpy(box.hi, &high, sizeof box.hi);
    return box;
}

/* Returns the voxels of the bounds of triangles from `begin` to `end` > begin. Adds the squares of
 * their first edges, by axis. */
LANES_INLINE struct vox_box triangle_box(const struct fmt_tris_chunk *chunk,
                                         const struct vox_transform *transform, uint32_t begin,
                                         uint32_t end, struct row *squares)
{
    struct bounds bounds = begin_at(chunk->positions[chunk->triangles[begin][0]]);
    for (uint32_t t = begin; t < end; t++) {
        const uint32_t *v = chunk->triangles[t];
        const float *a = chunk->positions[v[0]], *b = chunk->positions[v[1]];
        const struct row edge = row_difference(row_of_floats(b), row_of_floats(a));
        struct bounds own = begin_at(a);
        widen_bounds(&own, b);
        widen_bounds(&own, chunk->positions[v[2]]);
        bounds.least = four_floats_min(own.least, bounds.least);
        bounds.most = four_floats_max(own.most, bounds.most);
        *squares = row_sum(*squares, row_product(edge, edge));
    }
    return box_of(transform, &bounds);
}

double vox_triangle_groups(const struct fmt_tris_chunk *chunk,
                           const struct vox_transform *transform, struct vox_box *groups)
{
    struct row sum = row_of(0.0, 0.0, 0.0, 0.0);
    for (uint32_t begin = 0; begin < chunk->triangle_count; begin += VOX_GROUP_TRIANGLES)
        *groups++ =
            triangle_box(chunk, transform, begin,
                         vox_group_end(begin, chunk->triangle_count, VOX_GROUP_TRIANGLES), &sum);
    const double squares = row_number(sum, 0) + row_number(sum, 1) + row_number(sum, 2);
    return squares / (transform->h * transform->h) / (double)chunk->triangle_count;
}

/* ---- the scan's own normals ----
 *
 * Let an edge have the normals a and b at its ends. If curvature is constant, edge . (a + b) / 2 is
 * 0: the surface rises by the mean of its slopes. The values found instead on the three edges are
 * the coefficients of a Whitney form of degree 1 (Whitney, "Geometric Integration Theory", 1957).
 * As a vector in the triangle's plane, that form is the part of the normals that contradicts the
 * plane. Neither curvature nor the size of triangles counts as a contradiction.
 *
 * A record is a mean over its voxel, so contradictions are averaged over the area of a voxel's
 * face. Those that differ from triangle to triangle cancel there, such as rounding and noise. */

/* Square of the sine of half a degree, which is never too much: triangles as large as voxels err by
 * that even if their normals are right. */
#define INCONSISTENT_LEAST_SQUARE (0.0087 * 0.0087)
/* Share of the normals' mean squared turn over a voxel that may contradict. Planes pull the blended
 * normal by 1.3 times the contradiction. Without planes it errs by 0.83 times that square, in waves
 * with slopes of 20 degrees. At this share both errors are equal. */
#define INCONSISTENT_TURN_SHARE 0.64

/* Sums over triangles: area times contradiction, and area. */
struct contradiction {
    double vector[3], area;
};

/* Sums over edges. */
struct turn {
    double normals, lengths; /* squares of the differences of normals, and of points */
};

static void content_add_triangle(const struct vox_own_normals *of, const uint32_t v[3],
                                 struct contradiction *sum, struct turn *turn)
{
    double edge[3][3], rise[3], across[3];
    for (int i = 0; i < 3; i++) {
        const double *p = of->points[v[i]], *q = of->points[v[(i + 1) % 3]];
        const float *a = of->normals[v[i]], *b = of->normals[v[(i + 1) % 3]];
        rise[i] = 0.0;
        for (int k = 0; k < 3; k++) {
            double change = (double)(b[k] - a[k]);
            edge[i][k] = q[k] - p[k];
            rise[i] += edge[i][k] * 0.5 * (double)(a[k] + b[k]);
            turn->normals += change * change;
            turn->lengths += edge[i][k] * edge[i][k];
        }
    }
    for (int k = 0; k < 3; k++) {
        int l = (k + 1) % 3, m = (k + 2) % 3;
        across[k] = edge[0][l] * edge[1][m] - edge[0][m] * edge[1][l];
        /* The form at the centroid, rotated by a right angle. */
        sum->vector[k] += ((rise[1] - rise[2]) * edge[0][k] + (rise[2] - rise[0]) * edge[1][k] +
                           (rise[0] - rise[1]) * edge[2][k]) /
                          6.0;
    }
    sum->area += 0.5 * sqrt(across[0] * across[0] + across[1] * across[1] + across[2] * across[2]);
}

/* Returns the area times the square of the mean contradiction. */
static double square_of(const struct contradiction *sum)
{
    const double *v = sum->vector;
    return sum->area > 0.0 ? (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]) / sum->area : 0.0;
}

bool vox_own_normals_inconsistent(const struct vox_own_normals *of, uint32_t begin, uint32_t end)
{
    struct contradiction sum = {.area = 0.0};
    struct turn turn = {.normals = 0.0};
    double squares = 0.0, area = 0.0;
    for (uint32_t t = begin; t < end; t++) {
        content_add_triangle(of, of->triangles[t], &sum, &turn);
        if (sum.area < 1.0 && t + 1 < end)
            continue;
        squares += square_of(&sum);
        area += sum.area;
        sum = (struct contradiction){.area = 0.0};
    }
    double limit = INCONSISTENT_TURN_SHARE * turn.normals / fmax(turn.lengths, 1e-300);
    return squares > area * fmax(limit * limit, INCONSISTENT_LEAST_SQUARE);
}

/* ---- making a chunk ready ---- */

/* Computes the points of all vertices. */
static void place_points(const struct vox_transform *transform, const struct fmt_tris_chunk *source,
                         double (*points)[4])
{
    const struct row_transform rows = row_transform_of(transform);
    for (uint32_t v = 0; v < source->vertex_count; v++)
        row_store(place(&rows, row_of_floats(source->positions[v])), points[v]);
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
 * (docs/decisions/0009-when-vertex-normals-count.md). */
#define COARSE_EDGE_SQUARE 0.5
/* Above this mean square the scan's own normals are trusted more than its facets' planes, even if
 * the two contradict each other. */
#define LARGE_EDGE_SQUARE 4.0
/* Above this mean square smooth normals blend well without planes if fragments would be lifted
 * far. */
#define WIDE_EDGE_SQUARE 6.0
/* Facet-noise weight of records per square of an edge in voxels (docs/decisions/0009): of facets
 * without vertex normals, and of triangles with smooth ones. */
#define NOISE_OF_FACETS   2.7
#define NOISE_OF_VERTICES 0.4

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

/* Computes the voxels of groups, and the size of triangles. */
static void find_groups(const struct vox_chunk_source *from, struct vox_chunk_content *content)
{
    struct vox_chunk *chunk = &content->chunk;
    struct vox_box *groups =
        (struct vox_box *)(void *)(content->memory + content->layout.groups_at);
    memcpy(chunk->last_cell, from->transform->voxels.hi, sizeof from->transform->voxels.hi);
    content->mean_square = vox_triangle_groups(&chunk->source, from->transform, groups);
    chunk->groups = groups;
    chunk->group_count = vox_group_count(chunk->source.triangle_count, VOX_GROUP_TRIANGLES);
}

/* Loads the normals that were made for the chunk. */
static int take_made_normals(const struct vox_chunk_source *from, uint32_t number,
                             struct vox_chunk_content *content, float (*normals)[4],
                             double (*points)[4])
{
    struct fmt_tris_normals made;
    BSQ_PASS(fmt_tris_load_normals(from->file, number, content->memory + content->layout.made_at,
                                   &made));
    for (uint32_t v = 0; v < content->chunk.source.vertex_count; v++) {
        bsq_vertex_normal_unpack(made.vertices[v], normals[v]);
        normals[v][3] = (float)((double)bsq_vertex_rise(made.vertices[v]) / from->transform->h);
    }
    for (uint32_t i = 0; i < made.crease_count; i++)
        points[made.creases[i].vertex][3] = (i + 1.0) * VOX_CREASE_UNIT;
    if (made.crease_count > 0)
        content->chunk.creases = made.creases;
    return 0;
}

/* Places vertices in index space, and makes normals and what depends on them. */
static int content_finish(const struct vox_chunk_source *from, uint32_t number,
                          struct vox_chunk_content *content)
{
    struct vox_chunk *chunk = &content->chunk;
    const struct fmt_tris_chunk *source = &chunk->source;
    float(*normals)[4] = (float(*)[4])(void *)(content->memory + content->layout.normals_at);
    double(*points)[4] = (double(*)[4])(void *)(content->memory + content->layout.points_at);
    int status = 0;
    place_points(from->transform, source, points);
    chunk->coarse = content->mean_square > COARSE_EDGE_SQUARE;
    chunk->wide = source->normals || content->mean_square > WIDE_EDGE_SQUARE;
    chunk->normals = (const float(*)[4])normals;
    chunk->points = (const double(*)[4])points;
    chunk->creases = NULL;
    chunk->h = from->transform->h;
    chunk->inconsistent = NULL;
    chunk->noise_share = 0.0;
    if (from->smooth)
        chunk->noise_share = chunk->coarse ? NOISE_OF_VERTICES : NOISE_OF_FACETS;
    if (source->normals) {
        unpack_normals(source, normals);
        find_inconsistent(content->mean_square > LARGE_EDGE_SQUARE, content);
    } else if (from->smooth && chunk->coarse) {
        status = take_made_normals(from, number, content, normals, points);
    } else {
        chunk->normals = NULL;
    }
    return status;
}

int vox_chunk_make(const struct vox_chunk_source *from, uint32_t number,
                   struct vox_chunk_content *content)
{
    content->layout = layout_of(from, number);
    BSQ_PASS(fmt_tris_load(from->file, number, content->memory, &content->chunk.source));
    find_groups(from, content);
    return content_finish(from, number, content);
}
