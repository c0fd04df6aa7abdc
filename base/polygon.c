/* polygon.c - ear clipping.
 *
 * The sign of one expression decides everything: the area of a triangle projected along the
 * polygon's normal, from differences of 3D positions. So there is no plane basis, and no precision
 * is lost if a polygon lies far from the origin. Only corners that are not strictly convex can lie
 * in an ear.
 *
 * Each corner is tested once, and again only if its triangle changed or if the corner that blocked
 * it, its witness, is gone. Sets of corners find the next candidate around the polygon, and an
 * index in space finds witnesses, so time is near n log n. */
#include "base/polygon.h"

#include <string.h>

#include "base/polygon_internal.h"

/* Up to this many corners are searched one by one; a set of them is one word. */
enum { FEW_CORNERS = 64 };

/* What counts as an ear. Simple polygons need only the first test; the others make every input end.
 */
enum leniency { PROPER_EAR, ZERO_AREA_TOO, ANY_CONVEX, ANYTHING };

/* Rounds without a proper ear after which a polygon is taken for self-intersecting. */
enum { patience_rounds = 8 };

#define NONE UINT32_MAX

/* A polygon that is being clipped: corners linked in a ring. */
struct ring {
    const double (*positions)[3];
    struct vector normal; /* Newell's; its length does not matter */
    uint32_t count, size; /* corners of the polygon, and those left */
    uint32_t *next, *previous;
    struct bit_tree convex, flat; /* corners with an area above 0, and equal to 0 */
    struct bit_tree open;         /* convex corners without a witness */
    struct bit_tree blockers;     /* corners that were not convex at first and still are not */
    struct corner_index index;    /* of `blockers`, unless corners are few */
    /* Corners that have a witness, in a list for each witness. */
    uint32_t *witness, *first_watcher, *next_watcher, *previous_watcher;
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

static int make_fan(struct bsq_ctx *ctx, uint32_t n, uint32_t *triangles)
{
    int status = 0;
    for (uint32_t i = 0; i + 2 < n && status == 0; i++) {
        put(triangles + 3 * (uint64_t)i, 0, i + 1, i + 2);
        status = bsq_check_corner(ctx, i);
    }
    return status;
}

/* Cuts a quad from corner 0, as a fan does; if corner 1 or 3 is reflex, from that corner. */
static void split_quad(const double (*positions)[3], uint32_t *triangles)
{
    struct vector normal = newell_normal(positions, 4);
    if (turn(positions, normal, 0, 1, 2) < 0 || turn(positions, normal, 2, 3, 0) < 0) {
        put(triangles, 1, 2, 3);
        put(triangles + 3, 1, 3, 0);
    } else {
        put(triangles, 0, 1, 2);
        put(triangles + 3, 0, 2, 3);
    }
}

/* ---- witnesses ---- */

static void watch(struct ring *ring, uint32_t corner, uint32_t witness)
{
    const uint32_t next = ring->first_watcher[witness];
    ring->witness[corner] = witness;
    ring->next_watcher[corner] = next;
    ring->previous_watcher[corner] = NONE;
    if (next != NONE)
        ring->previous_watcher[next] = corner;
    ring->first_watcher[witness] = corner;
}

static void unwatch(struct ring *ring, uint32_t corner)
{
    const uint32_t witness = ring->witness[corner];
    const uint32_t next = ring->next_watcher[corner], previous = ring->previous_watcher[corner];
    if (witness == NONE)
        return;
    ring->witness[corner] = NONE;
    if (next != NONE)
        ring->previous_watcher[next] = previous;
    if (previous != NONE)
        ring->next_watcher[previous] = next;
    else
        ring->first_watcher[witness] = next;
}

static void drop_blocker(struct ring *ring, uint32_t corner)
{
    bit_tree_remove(&ring->blockers, corner);
    if (ring->count > FEW_CORNERS)
        bsq_corner_index_remove(&ring->index, corner);
    for (uint32_t watcher; (watcher = ring->first_watcher[corner]) != NONE;) {
        unwatch(ring, watcher);
        bit_tree_add(&ring->open, watcher);
    }
}

/* Returns a blocker that lies in the triangle at a convex corner, or NONE. */
static uint32_t find_witness(const struct ring *ring, uint32_t corner)
{
    struct outline o = {.corners = {ring->positions[ring->previous[corner]],
                                    ring->positions[corner], ring->positions[ring->next[corner]]}};
    for (int i = 0; i < 3; i++)
        o.inward[i] = cross(ring->normal, difference(o.corners[(i + 1) % 3], o.corners[i]));
    if (ring->count > FEW_CORNERS)
        return bsq_corner_index_find(&ring->index, &o, corner + ring->size);
    for (uint64_t rest = ring->blockers.levels[0][0]; rest; rest &= rest - 1) {
        const uint32_t blocker = (uint32_t)__builtin_ctzll(rest);
        if (outline_has(&o, ring->positions[blocker]))
            return blocker;
    }
    return NONE;
}

/* ---- the ring ---- */

/* Notes the sign of the area at a corner. */
static void classify(struct ring *ring, uint32_t corner)
{
    const double area = turn_at(ring, corner);
    if (area > 0) {
        bit_tree_add(&ring->convex, corner);
        bit_tree_add(&ring->open, corner);
    } else if (area == 0) {
        bit_tree_add(&ring->flat, corner);
    }
}

static void forget(struct ring *ring, uint32_t corner)
{
    unwatch(ring, corner);
    bit_tree_remove(&ring->convex, corner);
    bit_tree_remove(&ring->flat, corner);
    bit_tree_remove(&ring->open, corner);
}

/* Unlinks `corner`; its neighbours may become convex. */
static void clip(struct ring *ring, uint32_t corner)
{
    const uint32_t sides[2] = {ring->previous[corner], ring->next[corner]};
    if (bit_tree_has(&ring->blockers, corner))
        drop_blocker(ring, corner);
    forget(ring, corner);
    ring->next[sides[0]] = sides[1];
    ring->previous[sides[1]] = sides[0];
    ring->size--;
    for (int i = 0; i < 2; i++) {
        forget(ring, sides[i]);
        classify(ring, sides[i]);
        if (bit_tree_has(&ring->convex, sides[i]) && bit_tree_has(&ring->blockers, sides[i]))
            drop_blocker(ring, sides[i]);
    }
}

/* Returns the member of a set that comes first on the way around from `from`, or NONE. */
static uint32_t next_around(const struct bit_tree *set, uint32_t from)
{
    const uint32_t next = bit_tree_next(set, from);
    return next != NONE ? next : bit_tree_next(set, 0);
}

/* Returns which of two corners comes first on the way around from `from`; each may be NONE. */
static uint32_t nearer(uint32_t a, uint32_t b, uint32_t from)
{
    const bool wraps_a = a < from, wraps_b = b < from;
    if (a == NONE || b == NONE)
        return a == NONE ? b : a;
    return wraps_a != wraps_b ? (wraps_a ? b : a) : a < b ? a : b;
}

/* Returns the next ear on the way around from `from`, or NONE. */
static uint32_t find_ear(struct ring *ring, uint32_t from, enum leniency leniency)
{
    if (leniency == ANYTHING)
        return from;
    const uint32_t flat = leniency == PROPER_EAR ? NONE : next_around(&ring->flat, from);
    if (leniency == ANY_CONVEX)
        return nearer(next_around(&ring->convex, from), flat, from);
    for (;;) {
        const uint32_t corner = nearer(next_around(&ring->open, from), flat, from);
        const uint32_t witness = corner == flat ? NONE : find_witness(ring, corner);
        if (witness == NONE)
            return corner;
        watch(ring, corner, witness);
        bit_tree_remove(&ring->open, corner);
    }
}

/* Going two corners on after each ear spreads the cuts and avoids needles. */
static int clip_ears(struct bsq_ctx *ctx, struct ring *ring, uint32_t *triangles)
{
    enum leniency leniency = PROPER_EAR;
    uint32_t corner = 0, failed_rounds = 0;
    int status = 0;
    while (ring->size > 3 && status == 0) {
        const uint32_t ear = find_ear(ring, corner, leniency);
        if (ear == NONE) {
            leniency++;
            failed_rounds++;
            continue;
        }
        const uint32_t next = ring->next[ear];
        put(triangles, ring->previous[ear], ear, next);
        triangles += 3;
        clip(ring, ear);
        corner = ring->next[next];
        if (failed_rounds < patience_rounds)
            leniency = PROPER_EAR;
        if (ring->size % 64 == 0)
            status = bsq_check(ctx);
    }
    put(triangles, ring->previous[corner], corner, ring->next[corner]);
    return status;
}

/* ---- all ---- */

uint64_t bsq_triangulate_scratch(uint32_t n)
{
    if (n <= FEW_CORNERS)
        return 0;
    return 4 * bit_tree_words(n) * sizeof(uint64_t) + 6 * (uint64_t)n * sizeof(uint32_t) +
           bsq_corner_index_bytes(n, n);
}

/* Places the arrays of a polygon's ring in `memory`; returns what follows them. */
static void *place_arrays(struct ring *ring, void *memory)
{
    const uint32_t n = ring->count;
    uint64_t *words = memory;
    struct bit_tree *sets[] = {&ring->convex, &ring->flat, &ring->open, &ring->blockers};
    uint32_t **arrays[] = {&ring->next,          &ring->previous,     &ring->witness,
                           &ring->first_watcher, &ring->next_watcher, &ring->previous_watcher};
    for (int i = 0; i < 4; i++, words += bit_tree_words(n))
        bit_tree_init(sets[i], words, n);
    uint32_t *numbers = (uint32_t *)words;
    for (int i = 0; i < 6; i++, numbers += n)
        *arrays[i] = numbers;
    return numbers;
}

/* Links all corners, finds the blockers and counts them. */
static int make_ring(struct bsq_ctx *ctx, struct ring *ring, uint32_t *blockers)
{
    const uint32_t n = ring->count;
    int status = 0;
    *blockers = 0;
    for (uint32_t i = 0; i < n; i++) {
        ring->next[i] = i + 1 < n ? i + 1 : 0;
        ring->previous[i] = i ? i - 1 : n - 1;
        ring->witness[i] = ring->first_watcher[i] = NONE;
    }
    for (uint32_t i = 0; i < n && status == 0; i++) {
        classify(ring, i);
        status = bsq_check_corner(ctx, i);
        if (bit_tree_has(&ring->convex, i))
            continue;
        bit_tree_add(&ring->blockers, i);
        ++*blockers;
    }
    return status;
}

static int fill_index(struct bsq_ctx *ctx, struct ring *ring, uint32_t blockers, void *memory)
{
    uint32_t at = 0;
    bsq_corner_index_init(&ring->index, ring->positions, blockers, ring->count, memory);
    for (uint32_t i = 0; i < blockers; i++, at++)
        ring->index.order[i] = at = bit_tree_next(&ring->blockers, at);
    return bsq_corner_index_fill(ctx, &ring->index, ring->normal);
}

static int triangulate(struct bsq_ctx *ctx, struct ring *ring, uint32_t *triangles, void *memory)
{
    void *rest = place_arrays(ring, memory);
    uint32_t blockers;
    int status = make_ring(ctx, ring, &blockers);
    if (status == 0 && (blockers == 0 || dot(ring->normal, ring->normal) == 0))
        return make_fan(ctx, ring->count, triangles);
    if (status == 0 && ring->count > FEW_CORNERS)
        status = fill_index(ctx, ring, blockers, rest);
    return status < 0 ? status : clip_ears(ctx, ring, triangles);
}

int bsq_triangulate(struct bsq_ctx *ctx, const double (*positions)[3], uint32_t n,
                    uint32_t *triangles, void *scratch)
{
    uint64_t few[4 + 3 * FEW_CORNERS]; /* four sets, and six numbers a corner */
    if (n == 4) {
        split_quad(positions, triangles);
        return 0;
    }
    if (n == 3)
        return make_fan(ctx, n, triangles);
    struct ring ring = {
        .positions = positions, .normal = newell_normal(positions, n), .count = n, .size = n};
    return triangulate(ctx, &ring, triangles, n <= FEW_CORNERS ? few : scratch);
}
