/* polygon.c - ear clipping.
 *
 * The sign of one expression decides everything: the area of a triangle projected along the
 * polygon's normal, from differences of 3D positions. So there is no plane basis, and no precision
 * is lost if a polygon lies far from the origin. Only corners that are not strictly convex can lie
 * in an ear, so an ear is tested against the list of those. The list lives in the part of the
 * result that is not written yet. */
#include "base/polygon.h"

#include <stdbool.h>
#include <string.h>

struct vector {
    double x, y, z;
};

/* A polygon that is being clipped: corners linked in a ring. */
struct ring {
    const double (*positions)[3];
    struct vector normal; /* Newell's; its length does not matter */
    uint32_t *next, *previous;
    uint32_t *reflex; /* corners that are not strictly convex; the list ends at reflex_end */
    uint32_t *reflex_end;
    uint32_t size;
};

/* What counts as an ear. Simple polygons need only the first test; the others make every input end.
 */
enum leniency { PROPER_EAR, ZERO_AREA_TOO, ANY_CONVEX, ANYTHING };

/* Rounds without a proper ear after which a polygon is taken for self-intersecting. */
enum { patience_rounds = 8 };

static struct vector difference(const double *a, const double *b)
{
    return (struct vector){a[0] - b[0], a[1] - b[1], a[2] - b[2]};
}

static struct vector cross(struct vector a, struct vector b)
{
    return (struct vector){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

static double dot(struct vector a, struct vector b)
{
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

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
static double turn(const double (*positions)[3], struct vector normal, uint32_t a, uint32_t b,
                   uint32_t c)
{
    return dot(normal, cross(difference(positions[b], positions[a]),
                             difference(positions[c], positions[a])));
}

static double turn_at(const struct ring *ring, uint32_t corner)
{
    return turn(ring->positions, ring->normal, ring->previous[corner], corner, ring->next[corner]);
}

static void put(uint32_t *triangle, uint32_t a, uint32_t b, uint32_t c)
{
    triangle[0] = a;
    triangle[1] = b;
    triangle[2] = c;
}

static void make_fan(uint32_t n, uint32_t *triangles)
{
    for (uint32_t i = 0; i + 2 < n; i++)
        put(triangles + 3 * (uint64_t)i, 0, i + 1, i + 2);
}

/* Cuts a quad from corner 0, as a fan does; if corner 1 or 3 is reflex, from that corner. */
static void split_quad(const double (*positions)[3], uint32_t *triangles)
{
    struct vector normal = newell_normal(positions, 4);
    if (turn(positions, normal, 0, 1, 2) < 0 || turn(positions, normal, 2, 3, 0) < 0) {
        put(triangles, 1, 2, 3);
        put(triangles + 3, 1, 3, 0);
    } else {
        make_fan(4, triangles);
    }
}

/* ---- the ring ---- */

static void drop_reflex(struct ring *ring, uint32_t corner)
{
    for (uint32_t *r = ring->reflex; r < ring->reflex_end; r++)
        if (*r == corner) {
            *r = *ring->reflex++;
            return;
        }
}

/* Links all corners and lists those that are not strictly convex. The list ends where `triangles`
 * does: with m corners left it has at most m entries, and 3 (m - 2) places are unwritten. */
static void make_ring(struct ring *ring, uint32_t *triangles)
{
    uint32_t n = ring->size;
    for (uint32_t i = 0; i < n; i++) {
        ring->next[i] = i + 1 < n ? i + 1 : 0;
        ring->previous[i] = i ? i - 1 : n - 1;
    }
    ring->reflex = ring->reflex_end = triangles + 3 * (uint64_t)(n - 2);
    for (uint32_t i = n; i-- > 0;)
        if (!(turn_at(ring, i) > 0))
            *--ring->reflex = i;
}

/* Unlinks `corner`; its neighbours may become convex. */
static void clip(struct ring *ring, uint32_t corner)
{
    uint32_t sides[2] = {ring->previous[corner], ring->next[corner]};
    bool was_reflex[2];
    for (int i = 0; i < 2; i++)
        was_reflex[i] = !(turn_at(ring, sides[i]) > 0);
    if (!(turn_at(ring, corner) > 0))
        drop_reflex(ring, corner);
    ring->next[sides[0]] = sides[1];
    ring->previous[sides[1]] = sides[0];
    ring->size--;
    for (int i = 0; i < 2; i++)
        if (was_reflex[i] && turn_at(ring, sides[i]) > 0)
            drop_reflex(ring, sides[i]);
}
static bool is_same_place(const double *a, const double *b)
{
    return a[0] == b[0] && a[1] == b[1] && a[2] == b[2];
}

/* Returns true if another corner lies in the triangle at a convex corner, or on its border. Corners
 * at the position of one of the triangle's do not count: a polygon with holes has a bridge to each
 * hole, which it walks twice. */
static bool is_blocked(const struct ring *ring, uint32_t corner)
{
    const double *p[3] = {ring->positions[ring->previous[corner]], ring->positions[corner],
                          ring->positions[ring->next[corner]]};
    struct vector inward[3];
    for (int i = 0; i < 3; i++)
        inward[i] = cross(ring->normal, difference(p[(i + 1) % 3], p[i]));
    for (const uint32_t *r = ring->reflex; r < ring->reflex_end; r++) {
        const double *q = ring->positions[*r];
        if (dot(inward[2], difference(q, p[2])) < 0 || dot(inward[0], difference(q, p[0])) < 0 ||
            dot(inward[1], difference(q, p[1])) < 0)
            continue;
        if (!is_same_place(q, p[0]) && !is_same_place(q, p[1]) && !is_same_place(q, p[2]))
            return true;
    }
    return false;
}

static bool is_ear(const struct ring *ring, uint32_t corner, enum leniency leniency)
{
    if (leniency == ANYTHING)
        return true;
    double area = turn_at(ring, corner);
    if (!(area > 0))
        return area == 0 && leniency >= ZERO_AREA_TOO;
    return leniency == ANY_CONVEX || !is_blocked(ring, corner);
}

/* Going two corners on after each ear spreads the cuts and avoids needles. */
static void clip_ears(struct ring *ring, uint32_t *triangles)
{
    enum leniency leniency = PROPER_EAR;
    uint32_t corner = 0, misses = 0, failed_rounds = 0;
    while (ring->size > 3) {
        if (is_ear(ring, corner, leniency)) {
            uint32_t next = ring->next[corner];
            clip(ring, corner);
            put(triangles, ring->previous[corner], corner, next);
            triangles += 3;
            corner = ring->next[next];
            misses = 0;
            if (failed_rounds < patience_rounds)
                leniency = PROPER_EAR;
        } else {
            corner = ring->next[corner];
            if (++misses == ring->size) {
                leniency++;
                failed_rounds++;
                misses = 0;
            }
        }
    }
    put(triangles, ring->previous[corner], corner, ring->next[corner]);
}

void bsq_triangulate(const double (*positions)[3], uint32_t n, uint32_t *triangles,
                     uint32_t *scratch)
{
    if (n == 4) {
        split_quad(positions, triangles);
        return;
    }
    if (n == 3) {
        make_fan(n, triangles);
        return;
    }
    struct ring ring = {
        .positions = positions,
        .normal = newell_normal(positions, n),
        .next = scratch,
        .previous = scratch + n,
        .size = n,
    };
    make_ring(&ring, triangles);
    if (ring.reflex == ring.reflex_end || dot(ring.normal, ring.normal) == 0)
        make_fan(n, triangles);
    else
        clip_ears(&ring, triangles);
}
