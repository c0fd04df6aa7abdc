/* polygon.c - ear clipping (docs/decisions/0019-large-polygons.md).
 *
 * The sign of one expression decides everything: the area of a triangle projected along the
 * polygon's normal, from differences of 3D positions. So there is no plane basis, and no precision
 * is lost if a polygon lies far from the origin. Only corners that are not strictly convex can lie
 * in an ear.
 *
 * Each corner is tested once, and again only if its triangle changed or if the corner that blocked
 * it, its witness, is gone. */
#include "base/geometry/polygon.h"

/* Polygons of up to this many corners need no memory from the caller. */
enum { FEW_CORNERS = 64 };

struct vector {
    double x, y, z;
};

static inline struct vector difference(const double *a, const double *b)
{
    return (struct vector){a[0] - b[0], a[1] - b[1], a[2] - b[2]};
}

static inline struct vector cross(struct vector a, struct vector b)
{
    return (struct vector){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

static inline double dot(struct vector a, struct vector b)
{
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

/* A triangle as seen along the polygon's normal: corners, and normals of its edges. Edge i runs
 * from corner i to the next one; its normal points inwards. */
struct outline {
    const double *corners[3];
    struct vector inward[3];
};

static inline bool is_same_place(const double *a, const double *b)
{
    return a[0] == b[0] && a[1] == b[1] && a[2] == b[2];
}

/* Returns whether a position lies in the outline or on its border. Positions of the outline's
 * corners do not count: a polygon with holes has a bridge to each hole, which it walks twice. */
static inline bool outline_has(const struct outline *o, const double *q)
{
    for (int i = 0; i < 3; i++)
        if (dot(o->inward[i], difference(q, o->corners[i])) < 0)
            return false;
    return !is_same_place(q, o->corners[0]) && !is_same_place(q, o->corners[1]) &&
           !is_same_place(q, o->corners[2]);
}

/* ---- the polygon ---- */

/* What counts as an ear. Simple polygons need only the first test; the others make every input end.
 */
enum leniency { PROPER_EAR, ZERO_AREA_TOO, ANY_CONVEX, ANYTHING };

/* Rounds without a proper ear after which a polygon is taken for self-intersecting. */
enum { patience_rounds = 8 };

#define NONE UINT32_MAX

struct corner {
    uint32_t next, previous;
    uint32_t witness;  /* a blocker in the triangle here; NONE: none is known */
    bool convex, flat; /* the triangle's area is above 0, or equal to 0 */
    bool blocks;       /* was not convex at first, and still is not */
};

/* A polygon that is being clipped: corners linked in a ring. */
struct ring {
    const double (*positions)[3];
    struct vector normal; /* Newell's; its length does not matter */
    uint32_t size;        /* corners that are left */
    struct corner *corners;
    uint32_t *blockers, blocker_count; /* and some that block no more */
};

/* Returns the sum of the cross products of consecutive corners, relative to corner 0 for precision.
 */
static struct vector newell_normal(const double (*positions)[3], uint32_t n)
{
    struct vector sum = {0, 0, 0};
    struct vector a = difference(positions[1], positions[0]);
    for (uint32_t i = 2; i < n; i++) {
        struct vector b = difference(positions[i], positions[0]);
        struct vector c = cross(a, b);
        sum.x += c.x;
        sum.y += c.y;
        sum.z += c.z;
        a = b;
    }
    return sum;
}

/* Returns twice the area of triangle a b c seen along `normal`, times the length of `normal`. It is
 * positive if the triangle turns as the polygon does. */
static double polygon_turn(const double (*positions)[3], struct vector normal, uint32_t a,
                           uint32_t b, uint32_t c)
{
    return dot(normal, cross(difference(positions[b], positions[a]),
                             difference(positions[c], positions[a])));
}

static double turn_at(const struct ring *ring, uint32_t corner)
{
    const struct corner *c = &ring->corners[corner];
    return polygon_turn(ring->positions, ring->normal, c->previous, corner, c->next);
}

static void polygon_put(uint32_t *triangle, uint32_t a, uint32_t b, uint32_t c)
{
    triangle[0] = a;
    triangle[1] = b;
    triangle[2] = c;
}

static int polygon_make_fan(struct bsq_ctx *ctx, uint32_t n, uint32_t *triangles)
{
    for (uint32_t i = 0; i + 2 < n; i++) {
        polygon_put(triangles + 3 * (uint64_t)i, 0, i + 1, i + 2);
        BSQ_PASS(bsq_check_corner(ctx, i));
    }
    return 0;
}

/* Cuts a quad from corner 0, as a fan does; if corner 1 or 3 is reflex, from that corner. */
static void split_quad(const double (*positions)[3], uint32_t *triangles)
{
    struct vector normal = newell_normal(positions, 4);
    if (polygon_turn(positions, normal, 0, 1, 2) < 0 ||
        polygon_turn(positions, normal, 2, 3, 0) < 0) {
        polygon_put(triangles, 1, 2, 3);
        polygon_put(triangles + 3, 1, 3, 0);
    } else {
        polygon_put(triangles, 0, 1, 2);
        polygon_put(triangles + 3, 0, 2, 3);
    }
}

/* ---- ears ---- */

/* Returns a blocker that lies in the triangle at a convex corner, or NONE. */
static uint32_t find_witness(struct ring *ring, uint32_t corner)
{
    const uint32_t corners[3] = {ring->corners[corner].previous, corner,
                                 ring->corners[corner].next};
    struct outline o;
    for (int i = 0; i < 3; i++) {
        o.corners[i] = ring->positions[corners[i]];
        o.inward[i] =
            cross(ring->normal, difference(ring->positions[corners[(i + 1) % 3]], o.corners[i]));
    }
    for (uint32_t i = 0; i < ring->blocker_count;) {
        const uint32_t blocker = ring->blockers[i];
        if (!ring->corners[blocker].blocks)
            ring->blockers[i] = ring->blockers[--ring->blocker_count];
        else if (outline_has(&o, ring->positions[blocker]))
            return blocker;
        else
            i++;
    }
    return NONE;
}

static bool is_ear(struct ring *ring, uint32_t corner, enum leniency leniency)
{
    struct corner *c = &ring->corners[corner];
    if (leniency == ANYTHING || (c->flat && leniency != PROPER_EAR))
        return true;
    if (!c->convex || leniency == ANY_CONVEX)
        return c->convex;
    if (c->witness == NONE || !ring->corners[c->witness].blocks)
        c->witness = find_witness(ring, corner);
    return c->witness == NONE;
}

/* Notes the sign of the area at a corner whose neighbours are new. */
static void classify(struct ring *ring, uint32_t corner)
{
    struct corner *c = &ring->corners[corner];
    const double area = turn_at(ring, corner);
    c->witness = NONE;
    c->convex = area > 0;
    c->flat = area == 0;
    c->blocks = c->blocks && !c->convex;
}

/* Unlinks `corner`; its neighbours may become convex. */
static void clip(struct ring *ring, uint32_t corner)
{
    struct corner *c = &ring->corners[corner];
    c->blocks = false;
    ring->corners[c->previous].next = c->next;
    ring->corners[c->next].previous = c->previous;
    ring->size--;
    classify(ring, c->previous);
    classify(ring, c->next);
}

/* Going two corners on after each ear spreads the cuts and avoids needles. */
static int clip_ears(struct bsq_ctx *ctx, struct ring *ring, uint32_t *triangles)
{
    enum leniency leniency = PROPER_EAR;
    uint32_t ear = 0, failed_rounds = 0;
    while (ring->size > 3) {
        uint32_t left = ring->size;
        for (; left > 0 && !is_ear(ring, ear, leniency); left--) {
            ear = ring->corners[ear].next;
            if (left % 64 == 0)
                BSQ_PASS(bsq_check(ctx));
        }
        if (left == 0) {
            leniency++;
            failed_rounds++;
            continue;
        }
        const uint32_t next = ring->corners[ear].next;
        polygon_put(triangles, ring->corners[ear].previous, ear, next);
        triangles += 3;
        clip(ring, ear);
        ear = ring->corners[next].next;
        if (failed_rounds < patience_rounds)
            leniency = PROPER_EAR;
        if (ring->size % 64 == 0)
            BSQ_PASS(bsq_check(ctx));
    }
    polygon_put(triangles, ring->corners[ear].previous, ear, ring->corners[ear].next);
    return 0;
}

/* ---- all ---- */

/* Links all corners, and finds those that are not convex. */
static int make_ring(struct bsq_ctx *ctx, struct ring *ring)
{
    const uint32_t n = ring->size;
    for (uint32_t i = 0; i < n; i++)
        ring->corners[i] = (struct corner){
            .next = i + 1 < n ? i + 1 : 0, .previous = i ? i - 1 : n - 1, .blocks = true};
    for (uint32_t i = 0; i < n; i++) {
        classify(ring, i);
        if (ring->corners[i].blocks)
            ring->blockers[ring->blocker_count++] = i;
        BSQ_PASS(bsq_check_corner(ctx, i));
    }
    return 0;
}

uint64_t bsq_triangulate_scratch(uint32_t n)
{
    return n <= FEW_CORNERS ? 0 : n * (sizeof(struct corner) + sizeof(uint32_t));
}

int bsq_triangulate(struct bsq_ctx *ctx, const double (*positions)[3], uint32_t n,
                    uint32_t *triangles, void *scratch)
{
    struct corner few[FEW_CORNERS];
    uint32_t few_blockers[FEW_CORNERS];
    if (n == 4) {
        split_quad(positions, triangles);
        return 0;
    }
    if (n == 3)
        return polygon_make_fan(ctx, n, triangles);
    struct ring ring = {.positions = positions,
                        .normal = newell_normal(positions, n),
                        .size = n,
                        .corners = n <= FEW_CORNERS ? few : scratch};
    ring.blockers = n <= FEW_CORNERS ? few_blockers : (uint32_t *)(void *)(ring.corners + n);
    BSQ_PASS(make_ring(ctx, &ring));
    if (ring.blocker_count == 0 || dot(ring.normal, ring.normal) == 0)
        return polygon_make_fan(ctx, n, triangles);
    return clip_ears(ctx, &ring, triangles);
}
