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
 * code: the result decides whether a sliver is mirrored or flat.
 *
 * A corner is numbered 3 * triangle + i; the edge with the same number runs from that corner to the
 * next one of its triangle. Corners are welded with a hash table, and edges are paired with two
 * counting sorts: both are linear in the number of corners for any mesh, also with poles of many
 * triangles and edges that many triangles share. */
#include "libbake/lowpoly/mikkt.h"

#include <float.h>
#include <math.h>
#include <string.h>

#include "base/geometry/vec.h"

#define NONE UINT32_MAX

/* Loops over corners or triangles check for an interruption after this many iterations. */
enum { CORNERS_A_CHECK = 1 << 18 };

static uint32_t next_corner(uint32_t corner)
{
    return corner % 3 == 2 ? corner - 2 : corner + 1;
}
static uint32_t previous_corner(uint32_t corner)
{
    return corner % 3 == 0 ? corner + 2 : corner - 1;
}

/* Checks whether two corners coincide: the triangle then has no tangent and no place in the
 * topology. */
static bool is_degenerate(const struct mikkt_input *input, uint32_t triangle)
{
    const float(*p)[3] = input->positions + 3 * (uint64_t)triangle;
    for (int i = 0; i < 3; i++) {
        const float *a = p[i], *b = p[(i + 1) % 3];
        if (a[0] == b[0] && a[1] == b[1] && a[2] == b[2])
            return true;
    }
    return false;
}

/* ---- welding ---- */

static uint64_t mix_floats(uint64_t hash, const float *values, int count)
{
    for (int k = 0; k < count; k++) {
        float value = values[k] + 0.0f; /* -0 becomes 0 */
        uint32_t bits;
        memcpy(&bits, &value, sizeof(bits));
        hash = (hash ^ bits) * 0x9e3779b97f4a7c15u;
        hash ^= hash >> 32;
    }
    return hash;
}

static uint64_t hash_corner(const struct mikkt_input *input, uint32_t corner)
{
    uint64_t hash = mix_floats(1, input->positions[corner], 3);
    if (input->normals)
        hash = mix_floats(hash, input->normals[corner], 3);
    return input->texcoords ? mix_floats(hash, input->texcoords[corner], 2) : hash;
}

static bool equal_floats(const float *a, const float *b, int count)
{
    for (int k = 0; k < count; k++) {
        if (!(a[k] == b[k]))
            return false;
    }
    return true;
}

static bool equal_corners(const struct mikkt_input *input, uint32_t a, uint32_t b)
{
    return equal_floats(input->positions[a], input->positions[b], 3) &&
           (!input->normals || equal_floats(input->normals[a], input->normals[b], 3)) &&
           (!input->texcoords || equal_floats(input->texcoords[a], input->texcoords[b], 2));
}

int bake_mikkt_weld(struct bsq_ctx *ctx, const struct mikkt_input *input, uint32_t *vertices)
{
    uint32_t *table = NULL;
    uint64_t capacity = 16, steps = 0; /* a mesh can be made so that hashes collide */
    while (capacity < 2 * (uint64_t)input->corner_count)
        capacity *= 2;
    int status = BSQ_ALLOC(ctx, "vertex table", capacity, &table);
    if (status < 0)
        return status;
    memset(table, 0xff, capacity * sizeof(*table));
    for (uint32_t c = 0; c < input->corner_count && status == 0; c++) {
        uint64_t cell = hash_corner(input, c) & (capacity - 1);
        for (; table[cell] != NONE && !equal_corners(input, table[cell], c) && status == 0;
             cell = (cell + 1) & (capacity - 1))
            status = ++steps % CORNERS_A_CHECK == 0 ? bsq_check(ctx) : 0;
        if (table[cell] == NONE)
            table[cell] = c;
        vertices[c] = table[cell];
        if (status == 0 && ++steps % CORNERS_A_CHECK == 0)
            status = bsq_check(ctx);
    }
    bsq_free(ctx, table);
    return status;
}

/* ---- twins ---- */

struct edge_ends {
    uint32_t low, high; /* vertices, ordered by number */
};

static struct edge_ends ends_of(const uint32_t *vertices, uint32_t edge)
{
    uint32_t a = vertices[edge], b = vertices[next_corner(edge)];
    return a < b ? (struct edge_ends){a, b} : (struct edge_ends){b, a};
}

/* Sorts edge numbers by their higher or lower vertex with a stable counting sort. from NULL: all
 * edges in order. starts: scratch memory of count + 1 entries; vertices are numbered by corners. */
static void sort_edges(uint32_t count, const uint32_t *vertices, bool by_high, const uint32_t *from,
                       uint32_t *to, uint32_t *starts)
{
    memset(starts, 0, ((size_t)count + 1) * sizeof(*starts));
    for (uint32_t e = 0; e < count; e++) {
        struct edge_ends ends = ends_of(vertices, e);
        starts[(by_high ? ends.high : ends.low) + 1]++;
    }
    for (uint32_t v = 0; v < count; v++)
        starts[v + 1] += starts[v];
    for (uint32_t n = 0; n < count; n++) {
        uint32_t e = from ? from[n] : n;
        struct edge_ends ends = ends_of(vertices, e);
        to[starts[by_high ? ends.high : ends.low]++] = e;
    }
}

/* Pairs edges that all connect the same two vertices. Each edge is paired with the first unpaired
 * one of the opposite direction. Unpaired edges all have the same direction, so one cursor does. */
static void pair_edges(const uint32_t *edges, uint32_t count, const uint32_t *vertices,
                       uint32_t *twins)
{
    uint32_t unpaired = 0;
    for (uint32_t n = 0; n < count; n++) {
        while (unpaired < n && twins[edges[unpaired]] != NONE)
            unpaired++;
        if (unpaired < n && vertices[edges[unpaired]] != vertices[edges[n]]) {
            twins[edges[unpaired]] = edges[n];
            twins[edges[n]] = edges[unpaired];
        }
    }
}

static void pair_sorted(const struct mikkt_input *input, const uint32_t *vertices, uint32_t *order,
                        uint32_t *twins)
{
    uint32_t kept = 0;
    for (uint32_t n = 0; n < input->corner_count; n++) {
        if (!is_degenerate(input, order[n] / 3))
            order[kept++] = order[n];
    }
    for (uint32_t begin = 0, end; begin < kept; begin = end) {
        struct edge_ends ends = ends_of(vertices, order[begin]);
        for (end = begin + 1; end < kept; end++) {
            struct edge_ends other = ends_of(vertices, order[end]);
            if (other.low != ends.low || other.high != ends.high)
                break;
        }
        pair_edges(order + begin, end - begin, vertices, twins);
    }
}

/* Sets twins[edge] to the edge between the same two vertices in the opposite direction, or to
 * NONE. If more than two triangles meet at an edge, pairs are made in the order of edge
 * numbers. Degenerate triangles get no twins. Errors: BSQ_ENOMEM, BSQ_EINTR. */
static int find_twins(struct bsq_ctx *ctx, const struct mikkt_input *input,
                      const uint32_t *vertices, uint32_t *twins)
{
    const uint32_t corner_count = input->corner_count;
    uint32_t *by_high = NULL, *by_both = NULL, *starts = NULL;
    int status = 0;
    BSQ_TRY(BSQ_ALLOC(ctx, "edge order", corner_count, &by_high));
    BSQ_TRY(BSQ_ALLOC(ctx, "edge order", corner_count, &by_both));
    BSQ_TRY(BSQ_ALLOC(ctx, "edge order", (uint64_t)corner_count + 1, &starts));
    sort_edges(corner_count, vertices, true, NULL, by_high, starts);
    BSQ_TRY(bsq_check(ctx));
    sort_edges(corner_count, vertices, false, by_high, by_both, starts);
    BSQ_TRY(bsq_check(ctx));
    memset(twins, 0xff, (size_t)corner_count * sizeof(*twins));
    pair_sorted(input, vertices, by_both, twins);
done:
    BSQ_FREE(ctx, starts, by_both, by_high);
    return status;
}

/* ---- tangents ---- */

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
    const struct bsq_vec3 p = bsq_load3(s->input.positions[c]);
    const struct bsq_vec3 d1 = bsq_sub3(bsq_load3(s->input.positions[c + 1]), p);
    const struct bsq_vec3 d2 = bsq_sub3(bsq_load3(s->input.positions[c + 2]), p);
    const float u1 = uv[1][0] - uv[0][0], v1 = uv[1][1] - uv[0][1];
    const float u2 = uv[2][0] - uv[0][0], v2 = uv[2][1] - uv[0][1];
    const float area = u1 * v2 - v1 * u2;
    const struct bsq_vec3 along_u = bsq_sub3(bsq_scale3(d1, v2), bsq_scale3(d2, v1));
    const struct bsq_vec3 along_v = bsq_sub3(bsq_scale3(d2, u1), bsq_scale3(d1, u2));
    uint8_t flags = area > 0 ? FLAG_UPRIGHT : 0;
    if (!not_zero(area) || !not_zero(bsq_length3(along_u) / fabsf(area)) ||
        !not_zero(bsq_length3(along_v) / fabsf(area)))
        flags |= FLAG_FLAT;
    if (is_degenerate(&s->input, triangle))
        flags |= FLAG_DEGENERATE;
    s->flags[triangle] = flags;
    s->tangents[triangle] = bsq_unit3(bsq_scale3(along_u, area > 0 ? 1.0f : -1.0f));
}

/* ---- fans ---- */

/* Each returns the corner at the same vertex in the next triangle of the fan on one side, or
 * NONE. */
static uint32_t step_left(const struct tangents *s, uint32_t corner)
{
    uint32_t twin = s->twins[corner];
    return twin == NONE ? NONE : next_corner(twin);
}
static uint32_t step_right(const struct tangents *s, uint32_t corner)
{
    return s->twins[previous_corner(corner)];
}

/* Adds a corner to a fan if it belongs to none and its triangle has the fan's winding. Returns
 * whether it did. */
static bool mikkt_join(struct tangents *s, uint32_t corner, uint8_t upright)
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
    const struct bsq_vec3 normal = bsq_load3(s->input.normals[corner]);
    const struct bsq_vec3 p = bsq_load3(s->input.positions[corner]);
    const struct bsq_vec3 a = bsq_load3(s->input.positions[previous_corner(corner)]);
    const struct bsq_vec3 b = bsq_load3(s->input.positions[next_corner(corner)]);
    const float cosine =
        bsq_dot3(project_unit(bsq_sub3(a, p), normal), project_unit(bsq_sub3(b, p), normal));
    const float angle = acosf(fminf(1.0f, fmaxf(-1.0f, cosine)));
    return bsq_scale3(project_unit(s->tangents[corner / 3], normal), angle);
}

/* Collects the fan of a corner that belongs to none yet, and gives its mean tangent to all of the
 * fan's corners. */
static void mikkt_make_fan(struct tangents *s, uint32_t seed)
{
    const uint8_t upright = s->flags[seed / 3] & FLAG_UPRIGHT;
    uint32_t first = seed, size = 1;
    struct bsq_vec3 sum = {0, 0, 0};
    mikkt_join(s, seed, upright);
    for (uint32_t c = step_left(s, seed); c != NONE && mikkt_join(s, c, upright); size++) {
        first = c;
        c = step_left(s, c);
    }
    for (uint32_t c = step_right(s, seed); c != NONE && mikkt_join(s, c, upright); size++)
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
            mikkt_make_fan(s, c);
        if (c % CORNERS_A_CHECK == 0)
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
        if (*donor == NONE && !(s->flags[c / 3] & FLAG_DEGENERATE))
            *donor = c;
    }
    for (uint32_t c = 0; c < count; c++) {
        uint32_t donor = donors[s->vertices[c]];
        if (donor != NONE && (s->flags[c / 3] & FLAG_DEGENERATE))
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
        if (t % CORNERS_A_CHECK == 0)
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
    BSQ_TRY(BSQ_ALLOC(ctx, "welded vertices", corners, &s.vertices));
    BSQ_TRY(BSQ_ALLOC(ctx, "edge twins", corners, &s.twins));
    BSQ_TRY(BSQ_ALLOC(ctx, "triangle flags", count, &s.flags));
    BSQ_TRY(BSQ_ALLOC(ctx, "triangle tangents", count, &s.tangents));
    BSQ_TRY(bake_mikkt_weld(ctx, &s.input, s.vertices));
    BSQ_TRY(find_twins(ctx, &s.input, s.vertices, s.twins));
    BSQ_TRY(compute(ctx, &s));
done:
    BSQ_FREE(ctx, s.tangents, s.flags, s.twins, s.vertices);
    return status;
}
