/* triangulate.c - see triangulate.h.
 *
 * Neighbours in the file are mostly neighbours in space, so consecutive triangles in one bucket are
 * noted as one span. triangulate_code.c then codes the spans of each bucket. */
#include "base/polygon.h"
#include "libvoxel/partition/triangulate.h"

/* Corners are prefetched this far ahead: files without order wait for memory otherwise. */
#define CORNERS_AHEAD 48

/* Positions of a scan's file that were read last. Page n of the file is at n % PAGES. */
enum { PAGES = 256, PAGE_VERTICES = 64 };
struct position_pages {
    uint64_t ends[PAGES]; /* the number of the page after it; 0: there is none */
    float positions[PAGES][PAGE_VERTICES][3];
};

/* ---- memory ---- */

int vox_triangulator_init(struct triangulator *t, struct bsq_ctx *ctx,
                          const struct triangulation_plan *plan)
{
    uint64_t buckets = (uint64_t)1 << 3 * plan->levels;
    *t = (struct triangulator){.ctx = ctx, .plan = plan};
    int status = bsq_alloc(ctx, "faces", buckets, sizeof *t->runs_of_bucket, &t->runs_of_bucket);
    if (status == 0)
        memset(t->runs_of_bucket, 0xff, buckets * sizeof *t->runs_of_bucket);
    return status;
}

void vox_triangulator_free(struct triangulator *t)
{
    void *parts[] = {
        t->runs,           t->bytes,   t->corners,           t->spans,           t->sorted,
        t->runs_of_bucket, t->polygon, t->polygon_triangles, t->polygon_scratch, t->pages};
    for (size_t i = 0; t->ctx && i < sizeof parts / sizeof *parts; i++)
        bsq_free(t->ctx, parts[i]);
    memset(t, 0, sizeof *t);
}

static int reserve_triangles(struct triangulator *t, uint64_t triangles, uint64_t spans)
{
    int status =
        bsq_grow(t->ctx, "faces", triangles, sizeof *t->corners, &t->corners, &t->corner_capacity);
    if (status == 0)
        status = bsq_grow(t->ctx, "faces", spans, sizeof *t->spans, &t->spans, &t->span_capacity);
    return status;
}

static int reserve_polygon(struct triangulator *t, uint32_t max_size)
{
    const char *what = "faces";
    int status = 0;
    if (max_size <= 3)
        return 0;
    if (t->plan->vertex_buckets && !t->pages)
        BSQ_TRY(bsq_calloc(t->ctx, what, 1, sizeof *t->pages, &t->pages));
    BSQ_TRY(
        bsq_grow(t->ctx, what, max_size, sizeof *t->polygon, &t->polygon, &t->polygon_capacity[0]));
    BSQ_TRY(bsq_grow(t->ctx, what, max_size, 12, &t->polygon_triangles, &t->polygon_capacity[1]));
    status = bsq_grow(t->ctx, what, bsq_triangulate_scratch(max_size), 1, &t->polygon_scratch,
                      &t->polygon_capacity[2]);
done:
    return status;
}

/* ---- triangles ---- */

static inline const float *corner_position(const struct triangulator *t, const struct faces *faces,
                                           uint32_t corner)
{
    return stream_at(&t->plan->scan->streams[SCAN_POSITIONS],
                     faces->indices[FMT_MESH_VERTEX][corner], 12);
}

/* Returns the bucket of triangles with this first corner. */
static inline uint32_t bucket_of(const struct triangulator *t, const struct faces *faces,
                                 uint32_t corner)
{
    if (t->plan->vertex_buckets)
        return vertex_bucket(t->plan->vertex_buckets, faces->indices[FMT_MESH_VERTEX][corner]);
    return morton_cell(&t->plan->cube, t->plan->levels, corner_position(t, faces, corner));
}

/* Returns the address that bucket_of() reads. */
static inline const void *bucket_source(const struct triangulator *t, const struct faces *faces,
                                        uint32_t corner)
{
    if (t->plan->vertex_buckets)
        return vertex_bucket_place(t->plan->vertex_buckets,
                                   faces->indices[FMT_MESH_VERTEX][corner]);
    return corner_position(t, faces, corner);
}

static inline bool lacks_texcoord(const struct faces *faces, uint32_t a, uint32_t b, uint32_t c)
{
    const uint64_t *t = faces->indices[FMT_MESH_TEXCOORD];
    return !t || t[a] == FMT_MESH_NONE || t[b] == FMT_MESH_NONE || t[c] == FMT_MESH_NONE;
}

/* Notes that the next `count` triangles are in this bucket. */
static inline void extend_spans(struct triangulator *t, uint32_t bucket, uint32_t material,
                                uint32_t count)
{
    if (t->span_count == 0 || t->spans[t->span_count - 1].bucket != bucket ||
        t->spans[t->span_count - 1].material != material)
        t->spans[t->span_count++] = (struct triangle_span){
            .bucket = bucket, .first = (uint32_t)t->triangles, .material = material};
    t->spans[t->span_count - 1].count += count;
}

static inline void add_triangle(struct triangulator *t, const struct faces *faces, uint32_t a,
                                uint32_t b, uint32_t c)
{
    extend_spans(t, bucket_of(t, faces, a), faces->material[lacks_texcoord(faces, a, b, c)], 1);
    uint32_t *corners = t->corners[t->triangles++];
    corners[0] = a;
    corners[1] = b;
    corners[2] = c;
}

/* ---- polygons ---- */

/* Finds the position of a corner, if positions are in a file. *out: until the next call. Neighbours
 * in the mesh are mostly neighbours in the file, so pages of it are kept. */
static int read_position(struct triangulator *t, const struct faces *faces, uint32_t corner,
                         const float **out)
{
    const struct attribute_stream *stream = &t->plan->scan->streams[SCAN_POSITIONS];
    const uint64_t vertex = faces->indices[FMT_MESH_VERTEX][corner], page = vertex / PAGE_VERTICES;
    const uint64_t first = page * PAGE_VERTICES, left = stream_count(stream) - first;
    float(*positions)[3] = t->pages->positions[page % PAGES];
    uint64_t *end = &t->pages->ends[page % PAGES];
    int status = 0;
    if (*end != page + 1) {
        *end = 0;
        BSQ_TRY(vox_spill_read(&stream->spill, first * sizeof *positions,
                               (left < PAGE_VERTICES ? left : PAGE_VERTICES) * sizeof *positions,
                               positions));
        *end = page + 1;
    }
    *out = positions[vertex % PAGE_VERTICES];
done:
    return status;
}

static int add_polygon(struct triangulator *t, const struct faces *faces, uint32_t first,
                       uint32_t size)
{
    int status = 0;
    for (uint32_t k = 0; k < size; k++) {
        const float *p;
        if (t->pages)
            BSQ_TRY(read_position(t, faces, first + k, &p));
        else
            p = corner_position(t, faces, first + k);
        for (int axis = 0; axis < 3; axis++)
            t->polygon[k][axis] = p[axis];
        BSQ_TRY(bsq_check_corner(t->ctx, k));
    }
    const uint32_t *v = t->polygon_triangles;
    BSQ_TRY(bsq_triangulate(t->ctx, (const double(*)[3])t->polygon, size, t->polygon_triangles,
                            t->polygon_scratch));
    for (uint32_t i = 0; i < size - 2; i++, v += 3) {
        add_triangle(t, faces, first + v[0], first + v[1], first + v[2]);
        BSQ_TRY(bsq_check_corner(t->ctx, i));
    }
done:
    return status;
}

/* ---- blocks ---- */

static int add_face(struct triangulator *t, const struct faces *faces, uint32_t first,
                    uint32_t size)
{
    if (size > 3)
        return add_polygon(t, faces, first, size);
    add_triangle(t, faces, first, first + 1, first + 2);
    return 0;
}

static void set_material(struct faces *faces, uint32_t usemtl)
{
    faces->material[0] = run_material(usemtl, false);
    faces->material[1] = run_material(usemtl, true);
}

static int add_faces(struct triangulator *t, struct faces *faces)
{
    const struct fmt_mesh_block *block = faces->block;
    const uint32_t corner_count = (uint32_t)block->corner_count;
    uint32_t corner = 0;
    uint64_t change = 0;
    t->triangles = 0;
    t->span_count = 0;
    set_material(faces, block->material_at_start);
    for (uint64_t f = 0; f < block->face_count; f++) {
        uint32_t size = faces->sizes ? faces->sizes[f] : 3;
        while (change < block->material_change_count && block->material_changes[change].face <= f)
            set_material(faces, block->material_changes[change++].material);
        for (uint32_t k = corner + CORNERS_AHEAD;
             k < corner + CORNERS_AHEAD + size && k < corner_count; k += faces->sizes ? 1 : 3)
            __builtin_prefetch(bucket_source(t, faces, k));
        int status = add_face(t, faces, corner, size);
        if (status < 0)
            return status;
        corner += size;
    }
    return 0;
}

int vox_triangulate_block(struct triangulator *t, const struct fmt_mesh_block *block,
                          uint32_t max_size)
{
    struct faces faces = {
        .block = block,
        .sizes = max_size > 3 ? block->face_sizes : NULL,
        .indices = {block->corner_vertices, block->corner_texcoords, block->corner_normals}};
    const uint64_t triangles = block->corner_count - 2 * block->face_count;
    bool plain;
    int status = vox_triangulate_plain(t, &faces, &plain);
    if (status < 0 || plain)
        return status;
    BSQ_TRY(reserve_triangles(t, triangles, triangles));
    BSQ_TRY(reserve_polygon(t, max_size));
    BSQ_TRY(add_faces(t, &faces));
    status = vox_triangulate_code_spans(t, &faces);
done:
    return status;
}
