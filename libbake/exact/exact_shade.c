/* exact_shade.c - evaluates the normal and colour of a hit. */
#include "libbake/exact/exact_scene.h"

#include <string.h>

#include "base/geometry/vec.h"
#include "base/geometry/vertex_normal.h"
#include "base/srgb.h"
#include "libbake/kernel/bk_srgb.h"

/* A hit and its triangle. */
struct place {
    const struct exact_slot *slot;
    uint32_t triangle;
    const uint32_t *v;
    double w[3];       /* barycentric weights */
    double edge[2][3]; /* from the first corner */
    double cross[3];   /* product of the edges: twice the area vector */
};

static void shade_set_place(struct place *place, const struct exact_slot *slot, uint32_t triangle,
                            const struct bake_hit *hit)
{
    const struct fmt_tris_chunk *chunk = &slot->chunk;
    place->slot = slot;
    place->triangle = triangle;
    place->v = chunk->triangles[triangle];
    place->w[1] = (double)hit->normal[0];
    place->w[2] = (double)hit->normal[1];
    place->w[0] = 1.0 - place->w[1] - place->w[2];
    for (int e = 0; e < 2; e++)
        for (int k = 0; k < 3; k++)
            place->edge[e][k] = (double)chunk->positions[place->v[e + 1]][k] -
                                (double)chunk->positions[place->v[0]][k];
    bsq_crossd(place->edge[0], place->edge[1], place->cross);
}

/* ---- normals ---- */

/* Returns the crease at a vertex, or NULL. */
static const struct fmt_tris_crease *find_crease(const struct fmt_tris_normals *normals,
                                                 uint32_t vertex)
{
    uint32_t low = 0, high = normals->crease_count;
    while (low < high) {
        const uint32_t middle = low + (high - low) / 2;
        if (normals->creases[middle].vertex < vertex)
            low = middle + 1;
        else
            high = middle;
    }
    return low < normals->crease_count && normals->creases[low].vertex == vertex
               ? &normals->creases[low]
               : NULL;
}

/* Replaces the normal of the first side of a crease by that of the side that is closer to a
 * triangle, or by zero if both are too far away. */
static void choose_side(uint64_t second, const double cross[3], float n[3])
{
    float sides[2][3];
    double most = BSQ_FACET_COSINE * sqrt(bsq_dotd(cross, cross));
    memcpy(sides[0], n, sizeof sides[0]);
    bsq_vertex_normal_unpack(second, sides[1]);
    memset(n, 0, sizeof sides[0]);
    for (int i = 0; i < 2; i++) {
        const double side[3] = {(double)sides[i][0], (double)sides[i][1], (double)sides[i][2]};
        const double along = bsq_dotd(side, cross);
        if (along < most)
            continue;
        memcpy(n, sides[i], sizeof sides[i]);
        most = along;
    }
}

/* Adds the weighted unit normal of a corner: that of its vertex, or of one side of a crease, else
 * the triangle's. */
static void add_smooth(const struct place *place, int corner, double sum[3])
{
    const struct fmt_tris_normals *normals = &place->slot->normals;
    const uint32_t vertex = place->v[corner];
    const struct fmt_tris_crease *crease = find_crease(normals, vertex);
    float n[3];
    bsq_vertex_normal_unpack(normals->vertices[vertex], n);
    if (crease)
        choose_side(crease->second, place->cross, n);
    const bool any = n[0] != 0.0f || n[1] != 0.0f || n[2] != 0.0f;
    const double length = any ? 1 : sqrt(bsq_dotd(place->cross, place->cross));
    for (int k = 0; k < 3; k++)
        sum[k] += place->w[corner] * (any ? (double)n[k] : place->cross[k] / length);
}

static void shade_normal(const struct bake_exact *exact, const struct place *place, float out[3])
{
    const struct fmt_tris_chunk *chunk = &place->slot->chunk;
    double n[3] = {0, 0, 0};
    for (int i = 0; i < 3; i++) {
        if (chunk->normals) {
            const struct bsq_vec3 unit = bsq_oct_unpack(chunk->normals[place->v[i]]);
            n[0] += place->w[i] * (double)unit.x;
            n[1] += place->w[i] * (double)unit.y;
            n[2] += place->w[i] * (double)unit.z;
        } else if (exact->smooth) {
            add_smooth(place, i, n);
        }
    }
    double length = sqrt(bsq_dotd(n, n));
    if (!(length > 1e-6)) {
        memcpy(n, place->cross, sizeof n);
        length = sqrt(bsq_dotd(n, n));
    }
    for (int k = 0; k < 3; k++)
        out[k] = (float)(n[k] / length);
}

/* Adds the scan's normal map to a unit normal. Not inlined: GCC 12 would join the conversions of
 * two of the normal's numbers to float, in shade_normal(), and back, without rounding them. */
static __attribute__((noinline)) int shade_add_normal_map(const struct bake_exact *exact,
                                                          const struct place *place,
                                                          const struct fmt_shading_footprint *at,
                                                          float normal[3])
{
    const float(*texcoords)[2] = place->slot->chunk.texcoords;
    double n[3] = {(double)normal[0], (double)normal[1], (double)normal[2]}, uv[2][2];
    float texel[3];
    int status = fmt_shade_attribute(&exact->shading, FMT_SHADING_NORMAL_MAP, at, texel);
    for (int e = 0; e < 2; e++)
        for (int k = 0; k < 2; k++)
            uv[e][k] = (double)texcoords[place->v[e + 1]][k] - (double)texcoords[place->v[0]][k];
    if (status == 0 &&
        bsq_normal_map_apply((const double(*)[3])place->edge, (const double(*)[2])uv, texel, n))
        for (int k = 0; k < 3; k++)
            normal[k] = (float)n[k];
    return status;
}

/* Sets the side of the triangle that the ray met, and whether that is the scan's back. */
static void set_side(const struct bake_exact *exact, const struct place *place,
                     const struct bake_ray_batch *batch, uint64_t ray)
{
    struct bake_hit *hit = &batch->hits[ray];
    const float *d = batch->rays[ray].direction;
    const double direction[3] = {(double)d[0], (double)d[1], (double)d[2]};
    const bool along = bsq_dotd(place->cross, direction) > 0;
    const double scale =
        (along == batch->facing_origin ? -1 : 1) / sqrt(bsq_dotd(place->cross, place->cross));
    for (int k = 0; k < 3; k++)
        hit->facet[k] = (float)(place->cross[k] * scale);
    hit->reversed =
        exact->two_sided && (along == batch->facing_origin) !=
                                bake_exact_wound_backwards(&place->slot->chunk, place->triangle);
}

/* ---- colours ---- */

/* Computes the width of a ray's footprint in texture space: the steps along the map's rows and
 * columns are projected along the ray onto the plane of the triangle. */
static void footprint(const struct place *place, const struct bake_ray *ray,
                      const struct bake_footprint *step, const float (*uv)[2], double width[2])
{
    /* At grazing angles the projected steps would grow without limit. */
    const double flattest = 0.25;
    const double square = bsq_dotd(place->cross, place->cross), length = sqrt(square);
    const double d[3] = {(double)ray->direction[0], (double)ray->direction[1],
                         (double)ray->direction[2]};
    double slope = bsq_dotd(place->cross, d);
    if (fabs(slope) < flattest * length)
        slope = copysign(flattest * length, slope);
    width[0] = width[1] = 0;
    for (int s = 0; s < 2; s++) {
        double on[3], first[3], second[3];
        for (int k = 0; k < 3; k++)
            on[k] = (double)step->step[s][k];
        const double along = bsq_dotd(place->cross, on) / slope;
        for (int k = 0; k < 3; k++)
            on[k] -= along * d[k];
        bsq_crossd(on, place->edge[1], first);
        bsq_crossd(place->edge[0], on, second);
        const double b1 = bsq_dotd(first, place->cross) / square,
                     b2 = bsq_dotd(second, place->cross) / square;
        for (int k = 0; k < 2; k++) {
            const double moved = b1 * ((double)uv[1][k] - (double)uv[0][k]) +
                                 b2 * ((double)uv[2][k] - (double)uv[0][k]);
            width[k] += moved * moved;
        }
    }
    width[0] = sqrt(width[0]);
    width[1] = sqrt(width[1]);
}

/* Finds where a hit lies on the textures of its triangle. Without texture coordinates, that is
 * their origin. */
static struct fmt_shading_footprint texture_footprint(const struct bake_exact *exact,
                                                      const struct place *place,
                                                      const struct bake_ray_batch *batch,
                                                      uint64_t ray)
{
    const struct fmt_tris_chunk *chunk = &place->slot->chunk;
    struct fmt_shading_footprint out = {
        .material = fmt_shading_material(&exact->shading, chunk, place->triangle)};
    double width[2] = {0, 0}, at[2] = {0, 0};
    float uv[3][2];
    if (!chunk->texcoords || !exact->shading.textures)
        return out;
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 2; k++) {
            uv[i][k] = chunk->texcoords[place->v[i]][k];
            at[k] += place->w[i] * (double)uv[i][k];
        }
    if (batch->footprints)
        footprint(place, &batch->rays[ray], &batch->footprint_table[batch->footprints[ray]],
                  (const float(*)[2])uv, width);
    for (int k = 0; k < 2; k++) {
        out.at[k] = (float)at[k];
        out.width[k] = (float)width[k];
    }
    return out;
}

/* Returns component k of a vertex's colour, in linear light. */
static double vertex_light(const struct fmt_tris_chunk *chunk, uint32_t vertex, int k)
{
    const uint32_t color = chunk->colors[vertex];
    return chunk->fine_colors
               ? bsq_srgb_to_linear(fmt_tris_fine_color(color, chunk->fine_colors[vertex], k))
               : (double)bk_srgb[color >> 8 * k & 255];
}

/* Evaluates the colour, in this order of precedence: texture, vertex colours, colour of the
 * material. Vertex colours may multiply the texture. Black if the scan has none of them. */
static int shade_color(const struct bake_exact *exact, const struct place *place,
                       const struct fmt_shading_footprint *at, float out[3])
{
    const struct fmt_tris_chunk *chunk = &place->slot->chunk;
    const bool textured = fmt_shading_is_textured(&exact->shading, FMT_SHADING_COLOR, at->material);
    const int status =
        textured ? fmt_shade_attribute(&exact->shading, FMT_SHADING_COLOR, at, out) : 0;
    if (status < 0 ||
        (textured && !(chunk->colors && fmt_shading_is_tinted(&exact->shading, at->material))))
        return status;
    const double *diffuse = fmt_shading_diffuse(&exact->shading, at->material);
    double sum[3] = {0, 0, 0};
    for (int i = 0; chunk->colors && i < 3; i++)
        for (int k = 0; k < 3; k++)
            sum[k] += place->w[i] * vertex_light(chunk, place->v[i], k);
    for (int k = 0; k < 3; k++)
        out[k] = (float)(textured                    ? (double)out[k] * sum[k]
                         : !chunk->colors && diffuse ? diffuse[k]
                                                     : sum[k]);
    return 0;
}

int bake_exact_shade(const struct bake_exact *exact, const struct exact_slot *slot,
                     const struct bake_ray_batch *batch, uint64_t ray)
{
    const struct fmt_shading *shading = &exact->shading;
    struct bake_hit *hit = &batch->hits[ray];
    struct place place;
    shade_set_place(&place, slot,
                    (uint32_t)(hit->triangle - exact->chunks[slot->number].first_triangle), hit);
    shade_normal(exact, &place, hit->normal);
    const struct fmt_shading_footprint at = texture_footprint(exact, &place, batch, ray);
    if (slot->chunk.texcoords &&
        fmt_shading_is_textured(shading, FMT_SHADING_NORMAL_MAP, at.material))
        BSQ_PASS(shade_add_normal_map(exact, &place, &at, hit->normal));
    set_side(exact, &place, batch, ray);
    for (int k = 0; hit->reversed && k < 3; k++)
        hit->normal[k] = -hit->normal[k];
    hit->id = shading->ids ? fmt_shade_id(shading, &slot->chunk, place.triangle, place.w) : 0;
    for (uint32_t a = FMT_SHADING_CHANNELS; batch->channels && a < shading->attribute_count; a++)
        BSQ_PASS(fmt_shade_attribute(shading, a, &at,
                                     batch->channels + ray * exact_transfer_floats(exact) +
                                         (a - FMT_SHADING_CHANNELS) * BK_TRANSFER_VALUES));
    if (shading->diffuse)
        return shade_color(exact, &place, &at, hit->color);
    return 0;
}
