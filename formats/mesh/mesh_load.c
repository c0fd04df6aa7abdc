/* mesh_load.c - reads a small mesh whole: arrays of elements and triangles with checked indices.
 *
 * A face may refer to vertices that come after it, so polygons are kept as they are until all is
 * read. Then they are checked and split. */
#include <inttypes.h>
#include <math.h>
#include <string.h>
#include <xxhash.h>

#include "base/geometry/polygon.h"
#include "formats/mesh/mesh_reader.h"

/* Growing copies of the batches' arrays. A corner without index, UINT64_MAX, becomes UINT32_MAX
 * when it is cut to 32 bits. */
struct loader {
    struct bsq_ctx *ctx;
    struct fmt_mesh_reader *reader;
    struct fmt_mesh *mesh;
    uint64_t position_capacity, texcoord_capacity, normal_capacity;
    uint32_t *face_sizes;
    uint64_t face_capacity;
    uint32_t *corners[3]; /* vertices, texture coordinates, normals */
    uint64_t corner_capacity[3], corner_count;
    bool has_corners[3];
    uint64_t cut[3]; /* the first index of a kind that is too large for 32 bits; 0: none */
    struct fmt_mesh_loss lost_faces;   /* without a position */
    struct fmt_mesh_loss lost_normals; /* that do not exist */
    bool named;                        /* the names of materials and objects are wanted */
    uint64_t material_capacity;
    /* For one polygon. */
    double (*polygon)[3];
    uint32_t *triangles;
    void *scratch;
};

/* ---- collecting ---- */

/* Appends `count` elements of `size` bytes from `from` to the array at `array`, which holds `old`
 * elements. */
static int append(struct loader *loader, const char *what, void *array, uint64_t *capacity,
                  uint64_t old, const void *from, uint64_t count, uint64_t size)
{
    if (count == 0)
        return 0;
    int status = (bsq_grow)(loader->ctx, what, old + count, size, array, capacity);
    char *to;
    memcpy(&to, array, sizeof to);
    if (!status)
        memcpy(to + old * size, from, count * size);
    return status;
}

/* Appends the indices of one kind; `from` is NULL if no corner has one. */
static int append_corners(struct loader *loader, int kind, const uint64_t *from, uint64_t count)
{
    BSQ_PASS(bsq_grow(loader->ctx, "face corners", loader->corner_count + count, sizeof(uint32_t),
                      &loader->corners[kind], &loader->corner_capacity[kind]));
    uint32_t *to = loader->corners[kind] + loader->corner_count;
    loader->has_corners[kind] |= from != NULL;
    if (!from)
        memset(to, 0xff, count * sizeof *to);
    for (uint64_t i = 0; from && i < count; i++) {
        const bool cut = from[i] >= UINT32_MAX - 1 && from[i] != FMT_MESH_NONE;
        to[i] = cut ? UINT32_MAX - 1 : (uint32_t)from[i];
        if (cut && loader->cut[kind] == 0)
            loader->cut[kind] = from[i];
    }
    return 0;
}

/* Appends the numbers of the faces' materials. */
static int append_blocks(struct loader *loader, const struct fmt_mesh_batch *batch)
{
    struct fmt_mesh *mesh = loader->mesh;
    uint32_t material = batch->material_at_start;
    BSQ_PASS(BSQ_GROW(loader->ctx, "materials of faces", batch->face_base + batch->face_count,
                      &mesh->face_materials, &loader->material_capacity));
    uint64_t next = 0;
    for (uint64_t face = 0; face < batch->face_count; face++) {
        while (next < batch->material_change_count && batch->material_changes[next].face <= face)
            material = batch->material_changes[next++].material;
        mesh->face_materials[batch->face_base + face] = material;
    }
    return 0;
}

static int collect(void *arg, const struct fmt_mesh_batch *batch)
{
    struct loader *loader = arg;
    struct fmt_mesh *mesh = loader->mesh;
    if (batch->vertex_base + batch->vertex_count > UINT32_MAX - 1 ||
        batch->texcoord_base + batch->texcoord_count > UINT32_MAX - 1 ||
        batch->normal_base + batch->normal_count > UINT32_MAX - 1)
        return bsq_fail(loader->ctx, BSQ_EDATA,
                        "more than %u vertices in a mesh that is to be "
                        "held whole",
                        UINT32_MAX - 1);
    BSQ_PASS(append(loader, "vertices", &mesh->positions, &loader->position_capacity,
                    batch->vertex_base, batch->positions, batch->vertex_count,
                    sizeof *mesh->positions));
    BSQ_PASS(append(loader, "texture coordinates", &mesh->texcoords, &loader->texcoord_capacity,
                    batch->texcoord_base, batch->texcoords, batch->texcoord_count,
                    sizeof *mesh->texcoords));
    BSQ_PASS(append(loader, "normals", &mesh->normals, &loader->normal_capacity, batch->normal_base,
                    batch->normals, batch->normal_count, sizeof *mesh->normals));
    BSQ_PASS(append(loader, "faces", &loader->face_sizes, &loader->face_capacity, batch->face_base,
                    batch->face_sizes, batch->face_count, sizeof *loader->face_sizes));
    const uint64_t *corners[3] = {batch->corner_vertices, batch->corner_texcoords,
                                  batch->corner_normals};
    for (int kind = 0; kind < 3 && batch->corner_count; kind++)
        BSQ_PASS(append_corners(loader, kind, corners[kind], batch->corner_count));
    loader->corner_count += batch->corner_count;
    if (loader->named && batch->face_count > 0)
        BSQ_PASS(append_blocks(loader, batch));
    return 0;
}

/* ---- checking ---- */

static int fail_corner(struct loader *loader, uint64_t face, uint64_t corner, int kind)
{
    const uint64_t index = loader->corners[kind][corner];
    return fmt_mesh_fail_index(loader->reader, face, (enum fmt_mesh_kind)kind,
                               index == UINT32_MAX - 1 ? loader->cut[kind] : index);
}

/* Returns whether a polygon, whose corners begin at `first`, has a vertex without a position. */
static bool lacks_position(const struct loader *loader, uint64_t face, uint64_t first)
{
    for (uint32_t i = 0; i < loader->face_sizes[face]; i++)
        if (isnan(loader->mesh->positions[loader->corners[0][first + i]][0]))
            return true;
    return false;
}

/* Checks a corner. It loses a normal that does not exist, and texture coordinates that are not
 * finite. Texture coordinates that do not exist are an error, because maps depend on them. */
static int check_corner(struct loader *loader, const uint64_t totals[3], uint64_t face,
                        uint64_t corner)
{
    for (int kind = 0; kind < 3; kind++) {
        uint32_t *index = &loader->corners[kind][corner];
        const bool none = *index == UINT32_MAX && kind != 0;
        if (*index >= totals[kind] && !none) {
            if (kind != FMT_MESH_NORMAL)
                return fail_corner(loader, face, corner, kind);
            fmt_mesh_add_loss(&loader->lost_normals, 1, face);
            *index = UINT32_MAX;
        }
    }
    uint32_t *texcoord = &loader->corners[FMT_MESH_TEXCOORD][corner];
    if (*texcoord != UINT32_MAX && isnan(loader->mesh->texcoords[*texcoord][0]))
        *texcoord = UINT32_MAX;
    return 0;
}

/* Checks every index, in the order of the file. */
static int check_corners(struct loader *loader, const uint64_t totals[3])
{
    uint64_t corner = 0;
    for (uint64_t face = 0; face < loader->mesh->face_count; face++) {
        BSQ_PASS(face % 4096 == 0 ? bsq_check(loader->ctx) : 0);
        for (uint32_t i = 0; i < loader->face_sizes[face]; i++, corner++)
            BSQ_PASS(check_corner(loader, totals, face, corner));
    }
    return 0;
}

/* ---- splitting ---- */

static int allocate_triangles(struct loader *loader, uint32_t largest_face)
{
    struct bsq_ctx *ctx = loader->ctx;
    struct fmt_mesh *mesh = loader->mesh;
    const uint64_t count = loader->corner_count - 2 * mesh->face_count;
    BSQ_PASS(BSQ_ALLOC(ctx, "triangles", count, &mesh->vertices));
    if (loader->has_corners[1])
        BSQ_PASS(BSQ_ALLOC(ctx, "triangles", count, &mesh->corner_texcoords));
    if (loader->has_corners[2])
        BSQ_PASS(BSQ_ALLOC(ctx, "triangles", count, &mesh->corner_normals));
    BSQ_PASS(BSQ_ALLOC(ctx, "triangles", count, &mesh->faces));
    BSQ_PASS(BSQ_ALLOC(ctx, "a polygon", largest_face, &loader->polygon));
    BSQ_PASS(bsq_alloc(ctx, "a polygon", largest_face, 3 * sizeof *loader->triangles,
                       &loader->triangles));
    return bsq_alloc(ctx, "a polygon", bsq_triangulate_scratch(largest_face), 1, &loader->scratch);
}

/* Splits the polygon whose corners begin at `first` into triangles from number `triangle` on. */
static int split_face(struct loader *loader, uint64_t face, uint64_t first, uint64_t triangle)
{
    struct fmt_mesh *mesh = loader->mesh;
    uint32_t size = loader->face_sizes[face];
    uint32_t(*to[3])[3] = {mesh->vertices, mesh->corner_texcoords, mesh->corner_normals};
    for (uint32_t i = 0; i < size; i++)
        memcpy(loader->polygon[i], mesh->positions[loader->corners[0][first + i]],
               sizeof *loader->polygon);
    BSQ_PASS(bsq_triangulate(loader->ctx, (const double(*)[3])loader->polygon, size,
                             loader->triangles, loader->scratch));
    for (uint32_t t = 0; t < size - 2; t++) {
        mesh->faces[triangle + t] = face;
        for (int kind = 0; kind < 3; kind++)
            for (int i = 0; i < 3 && to[kind]; i++)
                to[kind][triangle + t][i] =
                    loader->corners[kind][first + loader->triangles[3 * t + i]];
    }
    return 0;
}

static int hash_faces(struct loader *loader)
{
    struct fmt_mesh *mesh = loader->mesh;
    uint64_t corner = 0;
    BSQ_PASS(BSQ_ALLOC(loader->ctx, "faces", mesh->face_count, &mesh->face_keys));
    for (uint64_t face = 0; face < mesh->face_count; face++) {
        const uint32_t size = loader->face_sizes[face];
        mesh->face_keys[face] = XXH3_64bits(loader->corners[0] + corner, size * sizeof(uint32_t));
        corner += size;
    }
    return 0;
}

static int make_triangles(struct loader *loader)
{
    uint32_t largest = 3;
    uint64_t corner = 0, triangle = 0;
    for (uint64_t face = 0; face < loader->mesh->face_count; face++)
        if (loader->face_sizes[face] > largest)
            largest = loader->face_sizes[face];
    BSQ_PASS(allocate_triangles(loader, largest));
    for (uint64_t face = 0; face < loader->mesh->face_count; face++) {
        if (lacks_position(loader, face, corner)) {
            fmt_mesh_add_loss(&loader->lost_faces, 1, face);
        } else {
            BSQ_PASS(split_face(loader, face, corner, triangle));
            triangle += loader->face_sizes[face] - 2;
        }
        corner += loader->face_sizes[face];
        if (face % 4096 == 0)
            BSQ_PASS(bsq_check(loader->ctx));
    }
    loader->mesh->triangle_count = triangle;
    return 0;
}

static void normalise(struct fmt_mesh *mesh)
{
    for (uint64_t i = 0; i < mesh->normal_count; i++) {
        float *n = mesh->normals[i];
        double length = sqrt((double)n[0] * n[0] + (double)n[1] * n[1] + (double)n[2] * n[2]);
        double scale = length > 0 && isfinite(length) ? 1 / length : 0;
        for (int c = 0; c < 3; c++)
            n[c] = scale > 0 ? (float)(n[c] * scale) : 0;
    }
}

static int load(struct loader *loader, const char *path)
{
    struct fmt_mesh *mesh = loader->mesh;
    struct fmt_mesh_totals totals;
    BSQ_PASS(fmt_mesh_open(loader->ctx, &path, 1, &loader->reader));
    if (loader->named)
        fmt_mesh_use_objects(loader->reader);
    BSQ_PASS(fmt_mesh_read(loader->reader, collect, loader, &totals));
    mesh->vertex_count = totals.vertices;
    mesh->texcoord_count = totals.texcoords;
    mesh->normal_count = totals.normals;
    mesh->face_count = totals.faces;
    mesh->has_tangents = totals.has_tangents;
    mesh->uneven_scale = totals.uneven_scale;
    mesh->split_vertices = totals.split_vertices;
    mesh->flat_normals = totals.flat_normals;
    if (totals.faces == 0)
        return fmt_mesh_fail_no_faces(loader->ctx, path, &totals);
    const uint64_t counts[3] = {totals.vertices, totals.texcoords, totals.normals};
    BSQ_PASS(check_corners(loader, counts));
    BSQ_PASS(
        fmt_mesh_report_loss(loader->reader, FMT_MESH_NORMAL, &loader->lost_normals, totals.faces));
    BSQ_PASS(hash_faces(loader));
    BSQ_PASS(make_triangles(loader));
    BSQ_PASS(
        fmt_mesh_report_loss(loader->reader, FMT_MESH_VERTEX, &loader->lost_faces, totals.faces));
    normalise(mesh);
    if (loader->named)
        return fmt_mesh_read_materials(loader->reader, &mesh->materials);
    return 0;
}

int fmt_mesh_load(struct bsq_ctx *ctx, const char *path, bool named, struct fmt_mesh *out)
{
    struct loader loader = {.ctx = ctx, .mesh = out, .named = named};
    memset(out, 0, sizeof *out);
    int status = load(&loader, path);
    fmt_mesh_close(loader.reader);
    bsq_free(ctx, loader.face_sizes);
    for (int kind = 0; kind < 3; kind++)
        bsq_free(ctx, loader.corners[kind]);
    BSQ_FREE(ctx, loader.polygon, loader.triangles, loader.scratch);
    if (status)
        fmt_mesh_free(ctx, out);
    return status;
}

void fmt_mesh_free(struct bsq_ctx *ctx, struct fmt_mesh *mesh)
{
    fmt_materials_free(ctx, &mesh->materials);
    BSQ_FREE(ctx, mesh->face_materials, mesh->positions, mesh->texcoords, mesh->normals,
             mesh->vertices, mesh->corner_texcoords, mesh->corner_normals, mesh->faces,
             mesh->face_keys);
    memset(mesh, 0, sizeof *mesh);
}
