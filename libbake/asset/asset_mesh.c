/* asset_mesh.c - turns the corners of the low-poly mesh into vertices and indices.
 *
 * Corners are sorted by the bytes of their values, so that equal ones become one vertex. */
#include "libbake/asset/asset_mesh.h"

#include <inttypes.h>
#include <math.h>
#include <string.h>

#include "base/sort_array.h"

struct corner {
    uint32_t vertex[sizeof(struct fmt_glb_vertex) / sizeof(uint32_t)]; /* the bits of its values */
    uint32_t number;
};

static int compare_corners(const void *a, const void *b)
{
    const struct corner *x = a, *y = b;
    const int order = memcmp(x->vertex, y->vertex, sizeof x->vertex);
    return order ? order : (x->number > y->number) - (x->number < y->number);
}

/* Replaces a direction of no length, where the mesh folds, by another one. */
static void replace_zero(float direction[3], const double instead[3])
{
    const float square =
        direction[0] * direction[0] + direction[1] * direction[1] + direction[2] * direction[2];
    const double length =
        sqrt(instead[0] * instead[0] + instead[1] * instead[1] + instead[2] * instead[2]);
    for (int k = 0; k < 3 && !(square > 0); k++)
        direction[k] = length > 0 ? (float)(instead[k] / length) : (float)(k == 2);
}

/* Sets a direction that is perpendicular to a normal. */
static void set_perpendicular(const float normal[3], double out[3])
{
    const int k = fabsf(normal[0]) < 0.7f ? 0 : 1; /* an axis that is not along the normal */
    const double n[3] = {(double)normal[0], (double)normal[1], (double)normal[2]};
    for (int i = 0; i < 3; i++)
        out[i] = (i == k) - n[i] * n[k];
}

static void set_vertex(const struct bake_lowmesh *mesh, uint64_t triangle, int i,
                       const double centre[3], struct fmt_glb_vertex *out)
{
    const double(*p)[3] = (const double(*)[3])mesh->positions[triangle];
    const float *uv = mesh->texcoords[triangle][i];
    double face[3], across[3];
    for (int k = 0; k < 3; k++) {
        const int a = (k + 1) % 3, b = (k + 2) % 3;
        face[k] =
            (p[1][a] - p[0][a]) * (p[2][b] - p[0][b]) - (p[1][b] - p[0][b]) * (p[2][a] - p[0][a]);
        out->position[k] = (float)(p[i][k] - centre[k]) + 0.0f; /* no -0 */
    }
    memcpy(out->normal, mesh->normals[triangle][i], sizeof out->normal);
    memcpy(out->tangent, mesh->tangents[triangle][i], sizeof out->tangent);
    replace_zero(out->normal, face);
    set_perpendicular(out->normal, across);
    replace_zero(out->tangent, across);
    out->texcoord[0] = uv[0];
    out->texcoord[1] = 1.0f - uv[1];
}

/* Returns whether a triangle of a tile is drawn with it. A triangle in several tiles has a copy in
 * each, of which the one with its middle is taken, if that has maps. */
static bool belongs(const struct bake_lowmesh *mesh, uint64_t triangle,
                    const struct bake_udim *udim, const struct bake_udim_tile *tile)
{
    const float(*uv)[2] = (const float(*)[2])mesh->texcoords[triangle];
    int away[2];
    for (int k = 0; k < 2; k++) {
        const float middle = (uv[0][k] + uv[1][k] + uv[2][k]) / 3;
        away[k] = middle < 0 ? -1 : middle > 1;
    }
    const int64_t number = (int64_t)tile->number + away[0] + 10 * (int64_t)away[1];
    bool other = false;
    for (uint32_t i = 0; i < udim->count && number != tile->number; i++)
        other |= udim->tiles[i].set == tile->set && udim->tiles[i].number == number;
    return !other;
}

/* Adds the primitive of a tile, unless it is empty. A tile of number 0 has what is in no tile.
 * corners: memory for all of its corners. */
static int add_primitive(struct bsq_ctx *ctx, const struct bake_lowmesh *mesh,
                         const struct bake_udim *udim, const struct bake_udim_tile *tile,
                         struct corner *corners, struct bake_asset_mesh *out)
{
    const bool plain = tile->number == 0;
    struct fmt_glb_vertex *vertices = out->vertices + out->vertex_count;
    uint32_t *indices = out->indices + out->index_count;
    struct fmt_glb_primitive primitive = {.vertices = vertices, .indices = indices, .plain = plain};
    uint32_t corner_count = 0;
    for (uint64_t t = tile->first; t < tile->first + tile->count; t++)
        for (int i = 0; i < 3 && (plain || belongs(mesh, t, udim, tile)); i++, corner_count++) {
            struct fmt_glb_vertex vertex;
            set_vertex(mesh, t, i, out->centre, &vertex);
            memcpy(corners[corner_count].vertex, &vertex, sizeof vertex);
            corners[corner_count].number = corner_count;
        }
    if (corner_count == 0)
        return 0;
    bsq_sort(corners, corner_count, sizeof *corners, compare_corners);
    for (uint32_t i = 0; i < corner_count; i++) {
        const uint32_t *vertex = corners[i].vertex;
        if (i == 0 || memcmp(vertex, corners[i - 1].vertex, sizeof corners->vertex) != 0)
            memcpy(&vertices[primitive.vertex_count++], vertex, sizeof corners->vertex);
        indices[corners[i].number] = primitive.vertex_count - 1;
    }
    primitive.index_count = corner_count;
    out->vertex_count += primitive.vertex_count;
    out->index_count += primitive.index_count;
    out->list[out->count++] =
        primitive; /* NOLINT(clang-analyzer-core.NullDereference): has space */
    return bsq_check(ctx);
}

int bake_asset_mesh_create(struct bsq_ctx *ctx, const struct bake_lowmesh *mesh,
                           const struct bake_udim *udim, struct bake_asset_mesh *out)
{
    const struct bake_udim_tile *last = &udim->tiles[udim->count - 1];
    const uint64_t corners = 3 * mesh->triangle_count, placed = last->first + last->count;
    const struct bake_udim_tile rest = {.first = placed, .count = mesh->triangle_count - placed};
    struct corner *sorted = NULL;
    int status;
    if (corners >= UINT32_MAX)
        return bsq_fail(ctx, BSQ_EDATA,
                        "%" PRIu64
                        " triangles are too many for a GLB file, which has 32-bit indices",
                        mesh->triangle_count);
    for (int k = 0; k < 3; k++)
        out->centre[k] = 0.5 * (mesh->bounds_min[k] + mesh->bounds_max[k]);
    BSQ_TRY(bsq_calloc(ctx, "primitives of a GLB file", udim->count + UINT64_C(1),
                       sizeof *out->list, &out->list));
    BSQ_TRY(bsq_alloc(ctx, "primitives of a GLB file", udim->count + UINT64_C(1),
                      sizeof *out->tiles, &out->tiles));
    BSQ_TRY(
        bsq_alloc(ctx, "vertices of a GLB file", corners, sizeof *out->vertices, &out->vertices));
    BSQ_TRY(bsq_alloc(ctx, "indices of a GLB file", corners, sizeof *out->indices, &out->indices));
    BSQ_TRY(bsq_alloc(ctx, "corners of a GLB file", corners, sizeof *sorted, &sorted));
    for (uint32_t i = 0; i < udim->count; i++) {
        out->tiles[out->count] = i;
        BSQ_TRY(add_primitive(ctx, mesh, udim, &udim->tiles[i], sorted, out));
    }
    status = add_primitive(ctx, mesh, udim, &rest, sorted, out);
done:
    bsq_free(ctx, sorted);
    return status;
}

void bake_asset_mesh_free(struct bsq_ctx *ctx, struct bake_asset_mesh *mesh)
{
    bsq_free(ctx, mesh->list);
    bsq_free(ctx, mesh->tiles);
    bsq_free(ctx, mesh->vertices);
    bsq_free(ctx, mesh->indices);
}
