/* mikkt.c - computes tangents from fans of triangles.
 *
 * The triangles around a vertex form fans: neighbours across shared edges whose texture coordinates
 * have the same winding. The tangent of a fan is the weighted mean of its triangles' tangents. Each
 * is projected into the plane of the vertex normal, and its weight is the angle of its corner. A
 * shader agrees with the map only if three kinds of triangle are treated as in the convention's
 * reference code:
 *  - A triangle without area in texture space has no tangent. It joins the first fan that reaches
 *    it, takes that fan's winding, and connects the fan with the triangles on its other side.
 *  - A triangle with two coincident corners joins no fan. It takes the tangents of its vertices
 *    after all fans are done.
 *  - A triangle that no fan reaches keeps the default tangent, (1, 0, 0) with negative sign.
 *
 * A triangle has two edges at a vertex, so a fan is a path or a cycle. It is found by walking in
 * both directions. Values that are tested against zero are computed in float, as in the reference
 * code: the result decides whether a sliver is mirrored or flat. */
#include "libbake/lowpoly/mikkt.h"

#include <float.h>
#include <math.h>
#include <string.h>

#include "base/vec.h"

enum {
    FLAG_DEGENERATE = 1, /* two corners coincide */
    FLAG_FLAT = 2,       /* no area in texture space */
    FLAG_UPRIGHT = 4,    /* texture space is not mirrored */
    FLAG_JOINED = 8,     /* corner 0 belongs to a fan; corner i: FLAG_JOINED << i */
    FLAG_JOINED_ANY = FLAG_JOINED * 7
};

struct tangents {
    struct mikkt_input input;
    uint32_t *vertices;
    uint32_t *twins;
    uint8_t *flags;            /* per triangle */
    struct bsq_vec3 *tangents; /* per triangle, unit, in its own plane */
    float (*out)[4];
};

static struct bsq_vec3 load3(const float v[3])
{
    return bsq_v3(v[0], v[1], v[2]);
}

static bool not_zero(float x)
{
    return fabsf(x) > FLT_MIN;
}

/* Projects v into the plane of `normal` and returns it as a unit vector. */
static struct bsq_vec3 project_unit(struct bsq_vec3 v, struct bsq_vec3 normal)
{
    return bsq_unit3(bsq_sub3(v, bsq_scale3(normal, bsq_dot3(normal, v))));
}

/* ---- triangles ---- */

/* Sets a triangle's flags, and its tangent: the derivative of the position along u, as a unit
 * vector. */
static void init_triangle(struct tangents *s, uint32_t triangle)
{
    const uint64_t c = 3 * (uint64_t)triangle;
    const float(*uv)[2] = s->input.texcoords + c;
    const struct bsq_vec3 p = load3(s->input.positions[c]);
    const struct bsq_vec3 d1 = bsq_sub3(load3(s->input.positions[c + 1]), p);
    const struct bsq_vec3 d2 = bsq_sub3(load3(s->input.positions[c + 2]), p);
    const float u1 = uv[1][0] - uv[0][0], v1 = uv[1][1] - uv[0][1];
    const float u2 = uv[2][0] - uv[0][0], v2 = uv[2][1] - uv[0][1];
    const float area = u1 * v2 - v1 * u2;
    const struct bsq_vec3 along_u = bsq_sub3(bsq_scale3(d1, v2), bsq_scale3(d2, v1));
    const struct bsq_vec3 along_v = bsq_sub3(bsq_scale3(d2, u1), bsq_scale3(d1, u2));
    uint8_t flags = area > 0 ? FLAG_UPRIGHT : 0;

    if (!not_zero(area) || !not_zero(bsq_length3(along_u) / fabsf(area)) ||
        !not_zero(bsq_length3(along_v) / fabsf(area)))
        flags |= FLAG_FLAT;
    if (mikkt_is_degenerate(&s->input, triangle))
        flags |= FLAG_DEGENERATE;
    s->flags[triangle] = flags;
    s->tangents[triangle] = bsq_unit3(bsq_scale3(along_u, area > 0 ? 1.0f : -1.0f));
}

/* ---- fans ---- */

/* Each returns the corner at the same vertex in the next triangle of the fan on one side, or
 * MIKKT_NONE. */
static uint32_t step_left(const struct tangents *s, uint32_t corner)
{
    uint32_t twin = s->twins[corner];
    return twin == MIKKT_NONE ? MIKKT_NONE : mikkt_next(twin);
}
static uint32_t step_right(const struct tangents *s, uint32_t corner)
{
    return s->twins[mikkt_previous(corner)];
}

/* Adds a corner to a fan if it belongs to none and its triangle has the fan's winding. Returns
 * whether it did. */
static bool join(struct tangents *s, uint32_t corner, uint8_t upright)
{
    uint8_t *flags = &s->flags[corner / 3];

    if (*flags & (FLAG_JOINED << corner % 3))
        return false;
    if ((*flags & FLAG_FLAT) && !(*flags & FLAG_JOINED_ANY))
        *flags = (uint8_t)((*flags & ~FLAG_UPRIGHT) | upright);
    if ((*flags & FLAG_UPRIGHT) != upright)
        return false;
    *flags |= (uint8_t)(FLAG_JOINED << corner % 3);
    return true;
}

/* Returns the tangent of a triangle at one of its corners, weighted by the angle of the corner in
 * the plane of the vertex normal. */
static struct bsq_vec3 weighted_tangent(const struct tangents *s, uint32_t corner)
{
    const struct bsq_vec3 normal = load3(s->input.normals[corner]);
    const struct bsq_vec3 p = load3(s->input.positions[corner]);
    const struct bsq_vec3 a = load3(s->input.positions[mikkt_previous(corner)]);
    const struct bsq_vec3 b = load3(s->input.positions[mikkt_next(corner)]);
    const float cosine =
        bsq_dot3(project_unit(bsq_sub3(a, p), normal), project_unit(bsq_sub3(b, p), normal));
    const float angle = acosf(fminf(1.0f, fmaxf(-1.0f, cosine)));

    return bsq_scale3(project_unit(s->tangents[corner / 3], normal), angle);
}

/* Collects the fan of a corner that belongs to none yet, and gives its mean tangent to all of the
 * fan's corners. */
static void make_fan(struct tangents *s, uint32_t seed)
{
    const uint8_t upright = s->flags[seed / 3] & FLAG_UPRIGHT;
    uint32_t first = seed, size = 1;
    struct bsq_vec3 sum = {0, 0, 0};

    join(s, seed, upright);
    for (uint32_t c = step_left(s, seed); c != MIKKT_NONE && join(s, c, upright); size++) {
        first = c;
        c = step_left(s, c);
    }
    for (uint32_t c = step_right(s, seed); c != MIKKT_NONE && join(s, c, upright); size++)
        c = step_right(s, c);

    for (uint32_t n = 0, c = first; n < size; n++, c = step_right(s, c)) {
        if (!(s->flags[c / 3] & FLAG_FLAT))
            sum = bsq_add3(sum, weighted_tangent(s, c));
    }
    sum = bsq_unit3(sum);
    for (uint32_t n = 0, c = first; n < size; n++, c = step_right(s, c)) {
        s->out[c][0] = sum.x;
        s->out[c][1] = sum.y;
        s->out[c][2] = sum.z;
        s->out[c][3] = upright ? 1.0f : -1.0f;
    }
}

static int make_fans(struct bsq_ctx *ctx, struct tangents *s)
{
    int status = 0;
    for (uint32_t c = 0; c < s->input.corner_count && status == 0; c++) {
        uint8_t flags = s->flags[c / 3];
        if (!(flags & (FLAG_DEGENERATE | FLAG_FLAT | (FLAG_JOINED << c % 3))))
            make_fan(s, c);
        if (c % MIKKT_CORNERS_A_CHECK == 0)
            status = bsq_check(ctx);
    }
    return status;
}

/* ---- triangles with coincident corners ---- */

/* Gives the corners of degenerate triangles the tangent of the first other corner at the same
 * vertex. donors: scratch memory, one entry per corner. */
static void fill_degenerate(struct tangents *s, uint32_t *donors)
{
    const uint32_t count = s->input.corner_count;

    memset(donors, 0xff, (size_t)count * sizeof(*donors));
    for (uint32_t c = 0; c < count; c++) {
        uint32_t *donor = &donors[s->vertices[c]];
        if (*donor == MIKKT_NONE && !(s->flags[c / 3] & FLAG_DEGENERATE))
            *donor = c;
    }
    for (uint32_t c = 0; c < count; c++) {
        uint32_t donor = donors[s->vertices[c]];
        if (donor != MIKKT_NONE && (s->flags[c / 3] & FLAG_DEGENERATE))
            memcpy(s->out[c], s->out[donor], sizeof(s->out[c]));
    }
}

/* ---- all ---- */

static int compute(struct bsq_ctx *ctx, struct tangents *s)
{
    static const float unreached[4] = {1, 0, 0, -1};

    int status = bsq_check(ctx);
    for (uint32_t t = 0; t < s->input.corner_count / 3 && status == 0; t++) {
        init_triangle(s, t);
        if (t % MIKKT_CORNERS_A_CHECK == 0)
            status = bsq_check(ctx);
    }
    for (uint32_t c = 0; c < s->input.corner_count; c++)
        memcpy(s->out[c], unreached, sizeof(unreached));
    if (status == 0)
        status = make_fans(ctx, s);
    if (status == 0)
        fill_degenerate(s, s->twins); /* twins are no longer needed */
    return status;
}

int bake_mikkt(struct bsq_ctx *ctx, uint64_t count, const float (*positions)[3][3],
               const float (*normals)[3][3], const float (*texcoords)[3][2], float (*out)[3][4])
{
    if (count >= UINT32_MAX / 3)
        return bsq_fail(ctx, BSQ_EDATA, "low-poly mesh has %llu triangles, %u are supported",
                        (unsigned long long)count, UINT32_MAX / 3 - 1);
    if (count == 0)
        return 0;
    struct tangents s = {.input = {.corner_count = (uint32_t)(3 * count),
                                   .positions = positions[0],
                                   .normals = normals[0],
                                   .texcoords = texcoords[0]},
                         .out = out[0]};
    const uint64_t corners = s.input.corner_count;
    int status = 0;
    BSQ_TRY(bsq_alloc(ctx, "welded vertices", corners, sizeof(*s.vertices), &s.vertices));
    BSQ_TRY(bsq_alloc(ctx, "edge twins", corners, sizeof(*s.twins), &s.twins));
    BSQ_TRY(bsq_alloc(ctx, "triangle flags", count, sizeof(*s.flags), &s.flags));
    BSQ_TRY(bsq_alloc(ctx, "triangle tangents", count, sizeof(*s.tangents), &s.tangents));
    BSQ_TRY(bake_mikkt_weld(ctx, &s.input, s.vertices));
    BSQ_TRY(bake_mikkt_find_twins(ctx, &s.input, s.vertices, s.twins));
    BSQ_TRY(compute(ctx, &s));
done:
    bsq_free(ctx, s.tangents);
    bsq_free(ctx, s.flags);
    bsq_free(ctx, s.twins);
    bsq_free(ctx, s.vertices);
    return status;
}
