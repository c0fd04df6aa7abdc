/* triangulate.c - see triangulate.h.
 *
 * Neighbours in the file are mostly neighbours in space, so consecutive triangles in one bucket are
 * noted as one span. triangulate_code.c then codes the spans of each bucket. */
#include "base/polygon.h"
#include "libvoxel/partition/triangulate.h"

/* Corners are prefetched this far ahead: files without order wait for memory otherwise. */
#define CORNERS_AHEAD 48

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
        t->runs_of_bucket, t->polygon, t->polygon_triangles, t->polygon_scratch, t->fan_buckets};
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
    if (t->plan->vertex_buckets)
        return bsq_grow(t->ctx, what, max_size, sizeof *t->fan_buckets, &t->fan_buckets,
                        &t->fan_capacity);
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

static int add_polygon(struct triangulator *t, const struct faces *faces, uint32_t first,
                       uint32_t size)
{
    int status = 0;
    for (uint32_t k = 0; k < size; k++) {
        const float *p = corner_position(t, faces, first + k);
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

/* ---- fans ----
 *
 * How a polygon is split depends on the positions of all its corners. If these are in a file, the
 * polygon goes as a fan around its first corner to every bucket that has a corner of it. When a
 * bucket is sorted it splits the polygon and keeps the triangles that are its own. */

/* Lists the buckets of a polygon's corners, each once; returns their number. */
static uint32_t list_buckets(struct triangulator *t, const struct faces *faces, uint32_t first,
                             uint32_t size)
{
    uint32_t count = 0;
    for (uint32_t k = 0; k < size; k++) {
        uint32_t bucket = bucket_of(t, faces, first + k), before = 0;
        while (before < count && t->fan_buckets[before] != bucket)
            before++;
        t->fan_buckets[before] = bucket;
        count += before == count;
    }
    return count;
}

/* A fan has one material, so either all of its corners or none must have texture coordinates. */
static bool is_textured_in_part(const struct faces *faces, uint32_t first, uint32_t size)
{
    const uint64_t *t = faces->indices[FMT_MESH_TEXCOORD];
    uint32_t lacking = 0;
    for (uint32_t k = 0; t && k < size; k++)
        lacking += t[first + k] == FMT_MESH_NONE;
    return lacking > 0 && lacking < size;
}

/* Copies in many buckets would multiply polygons of many corners. No surface has such polygons, and
 * twice the usual number of triangles always fits. */
static bool fans_are_too_many(const struct triangulator *t, const struct faces *faces,
                              uint64_t triangles)
{
    const struct fmt_mesh_block *block = faces->block;
    const uint64_t usual = 2 * (block->corner_count - 2 * block->face_count);
    const uint64_t each =
        sizeof *t->corners + coded_triangle_bytes(t->plan, FMT_MESH_KIND_COUNT) + 1;
    return triangles > usual && triangles > t->plan->fan_bytes / each;
}

static int refuse_polygon(const struct triangulator *t, const struct faces *faces, uint32_t size)
{
    const struct scan *scan = t->plan->scan;
    uint64_t bytes = 0;
    for (int i = 0; i < SCAN_STREAM_COUNT; i++)
        bytes += scan->streams[i].spill.bytes;
    return bsq_fail(t->ctx, BSQ_ENOMEM,
                    "%s: splitting a polygon of %u corners needs all vertices in memory, about "
                    "%llu MiB; it may use %llu MiB",
                    scan->paths[faces->block->file], size,
                    (unsigned long long)(vox_sort_memory_for(bytes, bsq_threads(t->ctx)) >> 20),
                    (unsigned long long)(bsq_memory_limit(t->ctx) >> 20));
}

static int add_fan(struct triangulator *t, const struct faces *faces, uint32_t first, uint32_t size)
{
    if (size > FAN_CORNERS || is_textured_in_part(faces, first, size))
        return refuse_polygon(t, faces, size);
    const uint32_t buckets = list_buckets(t, faces, first, size);
    const uint32_t material = faces->material[lacks_texcoord(faces, first, first + 1, first + 2)];
    const uint64_t triangles = t->triangles + (uint64_t)buckets * (size - 2);
    if (fans_are_too_many(t, faces, triangles))
        return refuse_polygon(t, faces, size);
    int status = reserve_triangles(t, triangles, (uint64_t)t->span_count + buckets);
    for (uint32_t i = 0; status == 0 && i < buckets; i++) {
        extend_spans(t, t->fan_buckets[i], material, size - 2);
        for (uint32_t k = 2; k < size; k++) {
            uint32_t *corners = t->corners[t->triangles++];
            corners[0] = first | (k > 2 ? CONTINUES_FAN : 0);
            corners[1] = first + k - 1;
            corners[2] = first + k;
        }
    }
    return status;
}

/* ---- blocks ---- */

static int add_face(struct triangulator *t, const struct faces *faces, uint32_t first,
                    uint32_t size)
{
    const bool fans = t->plan->vertex_buckets && faces->sizes;
    if (fans && size > 3)
        return add_fan(t, faces, first, size);
    /* Fans may have taken the capacity that was reserved for all faces. */
    int status = fans ? reserve_triangles(t, t->triangles + 1, (uint64_t)t->span_count + 1) : 0;
    if (status == 0 && size == 3)
        add_triangle(t, faces, first, first + 1, first + 2);
    else if (status == 0)
        status = add_polygon(t, faces, first, size);
    return status;
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
