/* directions.c - see lowpoly_internal.h. */
#include "libbake/lowpoly/lowpoly_internal.h"

#include <math.h>
#include <string.h>

#include "base/geometry/vec.h"
#include "libbake/lowpoly/mikkt.h"

enum { CORNERS_A_CHECK = 1 << 14 };

/* Below this share of the weights' sum, normals cancel each other. */
#define LEAST_SUM 0x1p-10

/* Normals that turn by more than 60 degrees along an edge belong to a corner of the model, not to a
 * round surface. */
#define LEAST_COSINE 0.5

/* Rays start this many rises of the surface outside of the mesh: triangles are not quite as round
 * as their edges, and low-poly meshes do not touch the scan with every vertex. */
#define RISES 1.5

/* Returns the angle of a triangle at corner i, 0 to pi; 0 if an edge there has no length. */
static double corner_angle(const float (*p)[3], int i)
{
    const struct bsq_vec3 at = bsq_load3(p[i]);
    const struct bsq_vec3 a = bsq_unit3(bsq_sub3(bsq_load3(p[(i + 1) % 3]), at));
    const struct bsq_vec3 b = bsq_unit3(bsq_sub3(bsq_load3(p[(i + 2) % 3]), at));
    return atan2((double)bsq_length3(bsq_cross3(a, b)), (double)bsq_dot3(a, b));
}

/* ---- smooth ---- */

/* The corners in one place; stored with the first of them. */
struct shared_corner {
    double sum[3], weights;
    bool normals_differ;
};

static void add_corner(struct shared_corner *shared, const float normal[3],
                       const float first_normal[3], double weight)
{
    for (int k = 0; k < 3; k++) {
        shared->sum[k] += weight * (double)normal[k];
        shared->normals_differ |= normal[k] != first_normal[k];
    }
    shared->weights += weight;
}

static void choose_direction(const struct shared_corner *shared, const float normal[3],
                             float out[3])
{
    const double *s = shared->sum;
    const double length = sqrt(s[0] * s[0] + s[1] * s[1] + s[2] * s[2]);
    memcpy(out, normal, 3 * sizeof *out);
    if (shared->normals_differ && length > LEAST_SUM * shared->weights)
        for (int k = 0; k < 3; k++)
            out[k] = (float)(s[k] / length);
}

static double corner_weight(bool by_area, const float (*p)[3], int i)
{
    if (!by_area)
        return corner_angle(p, i);
    const struct bsq_vec3 at = bsq_load3(p[0]);
    return (double)bsq_length3(
        bsq_cross3(bsq_sub3(bsq_load3(p[1]), at), bsq_sub3(bsq_load3(p[2]), at)));
}

int bake_mean_normals(struct bsq_ctx *ctx, bool by_area, uint32_t corners,
                      const float (*positions)[3], const float (*normals)[3],
                      const uint32_t *firsts, float (*out)[3])
{
    struct shared_corner *shared;
    int status = BSQ_CALLOC(ctx, "corners in one place", corners, &shared);
    for (uint32_t c = 0; c < corners && status == 0; c++) {
        const uint32_t triangle = c / 3 * 3;
        add_corner(&shared[firsts[c]], normals[c], normals[firsts[c]],
                   corner_weight(by_area, positions + triangle, (int)(c - triangle)));
        if (c % CORNERS_A_CHECK == 0)
            status = bsq_check(ctx);
    }
    for (uint32_t c = 0; c < corners && status == 0; c++)
        choose_direction(&shared[firsts[c]], normals[c], out[c]);
    bsq_free(ctx, shared);
    return status;
}

/* ---- reaches ---- */

/* Returns how far a round surface with these unit normals at the ends of an edge rises over the
 * edge: the height of a circle's arc over its chord, or in the direction along the axis of a
 * cylinder nothing. 0 if the surface sinks below the edge. */
static double rise_over(const float a[3], const float b[3], const float normal_a[3],
                        const float normal_b[3])
{
    const struct bsq_vec3 edge = bsq_sub3(bsq_load3(b), bsq_load3(a));
    const struct bsq_vec3 turn = bsq_sub3(bsq_load3(normal_b), bsq_load3(normal_a));
    const double cosine = (double)bsq_dot3(bsq_load3(normal_a), bsq_load3(normal_b));
    const double bend = (double)bsq_dot3(turn, edge);
    if (!(cosine >= LEAST_COSINE && bend > 0))
        return 0;
    /* A chord of angle 2 x and radius r has bend 4 r sin(x)^2 and height r (1 - cos(x)). */
    return bend / (4 * (1 + sqrt((1 + cosine) / 2)));
}

/* Sets where rays start. Neighbours share the highest rise, so that reaches are continuous. rises:
 * zeros, of the surface over the triangles in a place; stored with the first corner there. */
static void set_reaches(uint64_t count, const float (*positions)[3][3],
                        const float (*normals)[3][3], const uint32_t *firsts, double *rises,
                        float (*out)[3])
{
    for (uint64_t t = 0; t < count; t++) {
        double rise = 0;
        for (int i = 0, j = 2; i < 3; j = i++)
            rise = fmax(rise,
                        rise_over(positions[t][j], positions[t][i], normals[t][j], normals[t][i]));
        for (int i = 0; i < 3; i++)
            rises[firsts[3 * t + i]] = fmax(rises[firsts[3 * t + i]], rise);
    }
    for (uint64_t c = 0; c < 3 * count; c++)
        out[c / 3][c % 3] = (float)(RISES * rises[firsts[c]]);
}

/* ---- all kinds ---- */

static void face_directions(const float (*p)[3], const float (*normals)[3], float (*out)[3])
{
    const struct bsq_vec3 n = bsq_unit3(bsq_cross3(bsq_sub3(bsq_load3(p[1]), bsq_load3(p[0])),
                                                   bsq_sub3(bsq_load3(p[2]), bsq_load3(p[0]))));
    const bool flat = bsq_dot3(n, n) == 0;
    for (int i = 0; i < 3; i++)
        memcpy(out[i], flat ? normals[i] : (const float[3]){n.x, n.y, n.z}, sizeof *out);
}

int bake_ray_directions(struct bsq_ctx *ctx, enum bake_rays rays, uint64_t count,
                        const float (*positions)[3][3], const float (*normals)[3][3],
                        float (*out)[3][3], float (*reaches)[3])
{
    const uint32_t corners = (uint32_t)(3 * count);
    const struct mikkt_input input = {.corner_count = corners,
                                      .positions = (const float(*)[3])positions};
    uint32_t *firsts = NULL;
    double *rises = NULL;
    int status = 0;
    BSQ_TRY(BSQ_ALLOC(ctx, "corners in one place", corners, &firsts));
    BSQ_TRY(BSQ_CALLOC(ctx, "corners in one place", corners, &rises));
    BSQ_TRY(bake_mikkt_weld(ctx, &input, firsts));
    memcpy(out, normals, count * sizeof *out);
    if (rays == BAKE_RAYS_SMOOTH)
        BSQ_TRY(bake_mean_normals(ctx, false, corners, positions[0], normals[0], firsts, out[0]));
    for (uint64_t t = 0; t < count && rays == BAKE_RAYS_FACE; t++)
        face_directions(positions[t], normals[t], out[t]);
    set_reaches(count, positions, normals, firsts, rises, reaches);
    status = bsq_check(ctx);
done:
    BSQ_FREE(ctx, rises, firsts);
    return status;
}

/* ---- cages ---- */

/* Checks that two meshes have the same faces, corner by corner. */
static int check_topology(struct bsq_ctx *ctx, const char *path, const struct fmt_mesh *mesh,
                          const char *cage_path, const struct fmt_mesh *cage)
{
    for (uint64_t f = 0; f < mesh->face_count && f < cage->face_count; f++)
        if (mesh->face_keys[f] != cage->face_keys[f])
            return fmt_mesh_fail_face(ctx, cage_path, f,
                                      "has other vertices than the same face of the low-poly mesh");
    if (mesh->vertex_count != cage->vertex_count || mesh->face_count != cage->face_count)
        return bsq_fail(ctx, BSQ_EDATA,
                        "%s: a cage needs the vertices and faces of %s: %llu vertices and %llu "
                        "faces, not %llu and %llu",
                        cage_path, path, (unsigned long long)mesh->vertex_count,
                        (unsigned long long)mesh->face_count,
                        (unsigned long long)cage->vertex_count,
                        (unsigned long long)cage->face_count);
    return 0;
}

/* Returns how far from the mesh the cage is at least, so that rays have a direction where the two
 * touch. */
static float least_distance(const struct bake_lowmesh *mesh)
{
    double size = 0;
    for (int k = 0; k < 3; k++)
        size = fmax(size, mesh->bounds_max[k] - mesh->bounds_min[k]);
    return (float)(1e-6 * size);
}

int bake_cage_directions(struct bsq_ctx *ctx, const struct bake_options *options, const char *path,
                         const struct fmt_mesh *mesh, struct bake_lowmesh *out)
{
    struct fmt_mesh cage;
    const float least = least_distance(out);
    double longest = 0;
    BSQ_PASS(fmt_mesh_load(ctx, options->cage_path, false, &cage));
    bake_transform_mesh(options, &cage);
    int status = check_topology(ctx, path, mesh, options->cage_path, &cage);
    memset(out->reaches, 0, mesh->triangle_count * sizeof *out->reaches);
    for (uint64_t t = 0; t < mesh->triangle_count && status == 0; t++)
        for (int i = 0; i < 3; i++) {
            const uint32_t v = mesh->vertices[t][i];
            double square = 0;
            for (int k = 0; k < 3; k++) {
                const double way = cage.positions[v][k] - mesh->positions[v][k];
                out->directions[t][i][k] = (float)way;
                square += way * way;
            }
            longest = fmax(longest, sqrt(square));
            for (int k = 0; k < 3 && square == 0; k++)
                out->directions[t][i][k] = least * out->normals[t][i][k];
        }
    out->cage_distance = fmax(longest, (double)least);
    fmt_mesh_free(ctx, &cage);
    return status;
}

void bake_extrude(double distance, struct bake_lowmesh *mesh)
{
    for (uint64_t t = 0; t < mesh->triangle_count; t++)
        for (int i = 0; i < 3; i++) {
            for (int k = 0; k < 3; k++)
                mesh->directions[t][i][k] *= (float)distance;
            mesh->reaches[t][i] = 0;
        }
    mesh->cage_distance = distance;
}
