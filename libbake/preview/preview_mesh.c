/* preview_mesh.c - renders the low-poly mesh. A z-buffer holds triangle numbers and is shaded
 * afterwards, so that the panels with and without maps share it. */
#include "libbake/preview/preview_view.h"

/* Texture coordinates this far outside a tile still belong to it: those at its border. */
#define TILE_RIM 0.01f

/* Projects a corner onto the panel: x and y in samples, depth growing towards the camera. */
static void project(const struct preview_view *view, const double p[3], double out[3])
{
    double v[3];
    for (int k = 0; k < 3; ++k)
        v[k] = p[k] - view->centre[k];
    double right = v[0] * view->right[0] + v[1] * view->right[1] + v[2] * view->right[2];
    double up = v[0] * view->up[0] + v[1] * view->up[1] + v[2] * view->up[2];
    out[0] = 0.5 * view->samples + view->scale * right;
    out[1] = 0.5 * view->samples - view->scale * up;
    out[2] = v[0] * view->toward[0] + v[1] * view->toward[1] + v[2] * view->toward[2];
}

static void project_triangle(const struct bake_preview *preview, const struct preview_view *view,
                             uint64_t triangle, double out[3][3])
{
    for (int c = 0; c < 3; ++c)
        project(view, preview->mesh->positions[triangle][c], out[c]);
}

/* Returns twice the signed area of a, b and the point; its sign says on which side the point is. */
static double edge(const double a[3], const double b[3], double x, double y)
{
    return (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0]);
}

/* Computes the barycentric weights of a point of the panel. */
static void weights_at(double (*p)[3], double x, double y, double weights[3])
{
    double area = edge(p[0], p[1], p[2][0], p[2][1]);
    weights[0] = edge(p[1], p[2], x, y) / area;
    weights[1] = edge(p[2], p[0], x, y) / area;
    weights[2] = 1.0 - weights[0] - weights[1];
}

static uint32_t clamp_sample(double v, double limit)
{
    return v > 0 ? (v < limit ? (uint32_t)v : (uint32_t)limit) : 0;
}

static void draw_triangle(double (*p)[3], uint32_t triangle, uint32_t samples, uint32_t first_row,
                          struct preview_band *band)
{
    double area = edge(p[0], p[1], p[2][0], p[2][1]);
    if (area == 0.0)
        return;
    double left = fmin(p[0][0], fmin(p[1][0], p[2][0]));
    double right = fmax(p[0][0], fmax(p[1][0], p[2][0]));
    double top = fmin(p[0][1], fmin(p[1][1], p[2][1])) - first_row;
    double bottom = fmax(p[0][1], fmax(p[1][1], p[2][1])) - first_row;
    uint32_t x0 = clamp_sample(left - 0.5, samples);
    uint32_t x1 = clamp_sample(right + 1.0, samples);
    uint32_t y0 = clamp_sample(top - 0.5, PREVIEW_BAND * PREVIEW_GRID);
    uint32_t y1 = clamp_sample(bottom + 1.0, PREVIEW_BAND * PREVIEW_GRID);
    for (uint32_t y = y0; y < y1; ++y)
        for (uint32_t x = x0; x < x1; ++x) {
            double w[3];
            weights_at(p, x + 0.5, first_row + y + 0.5, w);
            if (w[0] < 0 || w[1] < 0 || w[2] < 0)
                continue;
            size_t i = (size_t)y * samples + x;
            float depth = (float)(w[0] * p[0][2] + w[1] * p[1][2] + w[2] * p[2][2]);
            if (band->triangle[i] == UINT32_MAX || depth > band->depth[i]) {
                band->depth[i] = depth;
                band->triangle[i] = triangle;
            }
        }
}

void bake_preview_mesh_band(const struct bake_preview *preview, const struct preview_view *view,
                            uint32_t first_row, struct preview_band *band)
{
    double p[3][3];
    for (size_t i = 0; i < (size_t)PREVIEW_BAND * PREVIEW_GRID * view->samples; ++i)
        band->triangle[i] = UINT32_MAX;
    for (uint64_t t = 0; t < preview->mesh->triangle_count; ++t) {
        project_triangle(preview, view, t, p);
        draw_triangle(p, (uint32_t)t, view->samples, first_row, band);
    }
}

/* ---- shading ---- */

static struct bsq_vec3 blend(float (*corners)[3], const float weights[3])
{
    float v[3];
    for (int k = 0; k < 3; ++k)
        v[k] = weights[0] * corners[0][k] + weights[1] * corners[1][k] + weights[2] * corners[2][k];
    return bsq_load3(v);
}

/* Returns the tile whose range of triangles has this one; NULL: none. */
static const struct bake_preview_tile *preview_mesh_tile_of(const struct bake_preview *preview,
                                                            uint32_t triangle)
{
    uint32_t low = 0, high = preview->tile_count;
    while (low < high) {
        const uint32_t middle = low + (high - low) / 2;
        const struct bake_udim_tile *udim = &preview->tiles[middle].udim;
        if (triangle >= udim->first && triangle < udim->first + udim->count)
            return &preview->tiles[middle];
        if (triangle < udim->first)
            high = middle;
        else
            low = middle + 1;
    }
    return NULL;
}

/* Returns the tile of a set with this number; NULL: none. */
static const struct bake_preview_tile *tile_numbered(const struct bake_preview *preview,
                                                     uint32_t set, uint32_t number)
{
    for (uint32_t i = 0; i < preview->tile_count; ++i)
        if (preview->tiles[i].udim.set == set && preview->tiles[i].udim.number == number)
            return &preview->tiles[i];
    return NULL;
}

/* Finds the tile that a point of a triangle lies in, and its place there. A triangle in several
 * tiles has a copy for each, of which any may be drawn. Returns NULL if no tile was baked there. */
static const struct bake_preview_tile *
tile_at(const struct bake_preview *preview, uint32_t triangle, const float weights[3], float at[2])
{
    const struct bake_preview_tile *tile = preview_mesh_tile_of(preview, triangle);
    float(*uv)[2] = preview->mesh->texcoords[triangle];
    int away[2];
    for (int k = 0; k < 2; ++k) {
        at[k] = weights[0] * uv[0][k] + weights[1] * uv[1][k] + weights[2] * uv[2][k];
        const float whole = floorf(at[k]);
        away[k] =
            at[k] < -TILE_RIM || at[k] > 1 + TILE_RIM ? (int)fminf(fmaxf(whole, -999), 999) : 0;
        at[k] -= (float)away[k];
    }
    if (!tile || (away[0] == 0 && away[1] == 0))
        return tile;
    const int column = (int)bake_udim_column(tile->udim.number) + away[0];
    const int row = (int)bake_udim_row(tile->udim.number) + away[1];
    return column < 0 || column > 9 || row < 0
               ? NULL
               : tile_numbered(preview, tile->udim.set,
                               BAKE_FIRST_TILE + (uint32_t)(column + 10 * row));
}

/* Applies the normal map as a MikkTSpace shader does: N and T are interpolated, not normalised. */
static struct bsq_vec3 mapped_normal(const struct bake_preview *preview, uint32_t triangle,
                                     const float weights[3], const struct bake_thumbnail *map,
                                     const float at[2])
{
    const struct bake_lowmesh *mesh = preview->mesh;
    float encoded[3];
    bake_thumbnail_sample(map, at[0], at[1], encoded);
    struct bsq_vec3 m = bsq_v3(2 * encoded[0] - 1, 2 * encoded[1] - 1, 2 * encoded[2] - 1);
    if (preview->options->normal_space == BAKE_OBJECT_SPACE)
        return bsq_unit3(m);
    if (preview->options->green_down)
        m.y = -m.y;
    struct bsq_vec3 normal = blend(mesh->normals[triangle], weights);
    float tangents[3][3];
    for (int c = 0; c < 3; ++c)
        for (int k = 0; k < 3; ++k)
            tangents[c][k] = mesh->tangents[triangle][c][k];
    struct bsq_vec3 tangent = blend(tangents, weights);
    struct bsq_vec3 bitangent =
        bsq_scale3(bsq_cross3(normal, tangent), mesh->tangents[triangle][0][3]);
    return bsq_unit3(bsq_add3(bsq_add3(bsq_scale3(tangent, m.x), bsq_scale3(bitangent, m.y)),
                              bsq_scale3(normal, m.z)));
}

/* Blends the albedo to red by the share of texels without a hit. */
static struct bsq_vec3 mark_missed(const struct bake_thumbnail *missed, const float at[2],
                                   struct bsq_vec3 albedo)
{
    float shares[3];
    bake_thumbnail_sample(missed, at[0], at[1], shares);
    if (!(shares[0] > 0.0f))
        return albedo;
    const float red = shares[0] / (shares[0] + shares[1]);
    return bsq_add3(bsq_scale3(albedo, 1.0f - red), bsq_scale3(bsq_v3(1.0f, 0.01f, 0.01f), red));
}

void bake_preview_mesh_sample(const struct bake_preview *preview, const struct preview_view *view,
                              uint32_t triangle, double x, double y, struct bsq_vec3 *plain,
                              struct bsq_vec3 *mapped)
{
    const struct bake_lowmesh *mesh = preview->mesh;
    double p[3][3], w[3];
    project_triangle(preview, view, triangle, p);
    weights_at(p, x, y, w);
    const float weights[3] = {(float)w[0], (float)w[1], (float)w[2]};
    struct bsq_vec3 normal = bsq_unit3(blend(mesh->normals[triangle], weights));
    struct bsq_vec3 albedo = bake_preview_grey();
    const bool back = edge(p[0], p[1], p[2][0], p[2][1]) > 0; /* y points downwards */
    float at[2];
    if (back)
        normal = bake_preview_turn_normal(view, normal);
    *plain = *mapped = bake_preview_shade(view, normal, albedo);
    const struct bake_preview_tile *tile = tile_at(preview, triangle, weights, at);
    if (!tile)
        return;
    if (tile->normal->texels)
        normal = mapped_normal(preview, triangle, weights, tile->normal, at);
    if (back)
        normal = bake_preview_turn_normal(view, normal);
    if (tile->color->texels) {
        float color[3];
        bake_thumbnail_sample(tile->color, at[0], at[1], color);
        albedo = bsq_load3(color);
    }
    if (tile->missed->texels)
        albedo = mark_missed(tile->missed, at, albedo);
    *mapped = bake_preview_shade(view, normal, albedo);
}
