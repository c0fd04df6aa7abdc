/* polygon.c - ear clipping.
 *
 * The sign of one expression decides everything: the area of a triangle projected along the
 * polygon's normal, from differences of 3D positions. So there is no plane basis, and no precision
 * is lost if a polygon lies far from the origin. Only corners that are not strictly convex can lie
 * in an ear.
 *
 * Each corner is tested once, and again only if its triangle changed or if the corner that blocked
 * it, its witness, is gone. Sets of corners find the next candidate around the polygon. Corners
 * that may be witnesses are numbered along a line, so that only those beside a triangle are looked
 * at. */
#include "base/polygon.h"

#include <math.h>
#include <string.h>

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

#define NONE UINT32_MAX

/* ---- sets of numbers ----
 *
 * The next member of a set is found in logarithmic time. Level 0 has a bit for each number. A bit
 * of a higher level tells whether a word of the level below has any bit. */

enum { BIT_TREE_LEVELS = 6 }; /* 64^6 is above 2^32 */

struct bit_tree {
    uint64_t *levels[BIT_TREE_LEVELS];
    uint32_t height; /* levels in use */
};

/* Returns the 64-bit words that a set of numbers below `size` needs. */
static inline uint64_t bit_tree_words(uint32_t size)
{
    uint64_t words = 0, level = size;
    do {
        level = (level + 63) / 64;
        words += level;
    } while (level > 1);
    return words;
}

/* Makes an empty set in `words`. */
static inline void bit_tree_init(struct bit_tree *tree, uint64_t *words, uint32_t size)
{
    uint64_t level = size;
    memset(words, 0, bit_tree_words(size) * sizeof *words);
    tree->height = 0;
    do {
        level = (level + 63) / 64;
        tree->levels[tree->height++] = words;
        words += level;
    } while (level > 1);
}

static inline bool bit_tree_has(const struct bit_tree *tree, uint32_t number)
{
    return tree->levels[0][number / 64] >> number % 64 & 1;
}

static inline void bit_tree_add(struct bit_tree *tree, uint32_t number)
{
    for (uint32_t l = 0; l < tree->height; l++, number /= 64)
        tree->levels[l][number / 64] |= UINT64_C(1) << number % 64;
}

static inline void bit_tree_remove(struct bit_tree *tree, uint32_t number)
{
    for (uint32_t l = 0; l < tree->height; l++, number /= 64) {
        tree->levels[l][number / 64] &= ~(UINT64_C(1) << number % 64);
        if (tree->levels[l][number / 64] != 0)
            break;
    }
}

/* Returns the smallest member >= `from`, which is below the set's size; NONE if there is
 * none. */
static inline uint32_t bit_tree_next(const struct bit_tree *tree, uint32_t from)
{
    uint64_t rest = tree->levels[0][from / 64] >> from % 64;
    if (rest)
        return from + (uint32_t)__builtin_ctzll(rest);
    for (uint32_t l = 1; l < tree->height; l++) {
        from /= 64;
        /* The word that holds `from` was searched in the level below. */
        rest = tree->levels[l][from / 64] >> from % 64 >> 1;
        if (rest == 0)
            continue;
        from += 1 + (uint32_t)__builtin_ctzll(rest);
        while (l-- > 0)
            from = 64 * from + (uint32_t)__builtin_ctzll(tree->levels[l][from]);
        return from;
    }
    return NONE;
}

/* ---- the polygon ---- */

/* What counts as an ear. Simple polygons need only the first test; the others make every input end.
 */
enum leniency { PROPER_EAR, ZERO_AREA_TOO, ANY_CONVEX, ANYTHING };

/* Rounds without a proper ear after which a polygon is taken for self-intersecting. */
enum { patience_rounds = 8 };

/* A polygon that is being clipped: corners linked in a ring. */
struct ring {
    const double (*positions)[3];
    struct vector normal; /* Newell's; its length does not matter */
    uint32_t count, size; /* corners of the polygon, and those left */
    uint32_t *next, *previous;
    struct bit_tree convex, flat; /* corners with an area above 0, and equal to 0 */
    struct bit_tree open;         /* convex corners without a witness */
    /* Corners that were not convex at first and still are not, by their numbers. They are numbered
     * along a line in the polygon's plane, which is cut into as many equal sections. */
    struct bit_tree blockers;
    uint32_t *number_of, *corner_of; /* of each corner, NONE: it blocks nothing; of each number */
    uint32_t sections, *starts;      /* the first number of each section, and the end */
    struct vector line;
    double low, scale; /* where the line begins; sections a unit */
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
    bit_tree_remove(&ring->blockers, ring->number_of[corner]);
    ring->number_of[corner] = NONE;
    for (uint32_t watcher; (watcher = ring->first_watcher[corner]) != NONE;) {
        unwatch(ring, watcher);
        bit_tree_add(&ring->open, watcher);
    }
}

/* Returns where a corner lies along the line. */
static double along(const struct ring *ring, uint32_t corner)
{
    return dot(ring->line, difference(ring->positions[corner], ring->positions[0]));
}

static uint32_t section_at(const struct ring *ring, double place)
{
    const double section = (place - ring->low) * ring->scale, last = ring->sections - 1;
    return section > 0 ? (uint32_t)(section < last ? section : last) : 0;
}

/* Returns a blocker that lies in the triangle at a convex corner, or NONE. Looks at one more
 * section on each side, because of rounding. */
static uint32_t find_witness(const struct ring *ring, uint32_t corner)
{
    const uint32_t corners[3] = {ring->previous[corner], corner, ring->next[corner]};
    struct outline o;
    uint32_t first = ring->sections - 1, last = 0;
    for (int i = 0; i < 3; i++) {
        const uint32_t section = section_at(ring, along(ring, corners[i]));
        first = section < first ? section : first;
        last = section > last ? section : last;
        o.corners[i] = ring->positions[corners[i]];
        o.inward[i] =
            cross(ring->normal, difference(ring->positions[corners[(i + 1) % 3]], o.corners[i]));
    }
    first -= first > 0;
    last += last + 1 < ring->sections;
    const uint32_t end = ring->starts[last + 1];
    uint32_t at = ring->starts[first];
    while (at < end && (at = bit_tree_next(&ring->blockers, at)) < end) {
        if (outline_has(&o, ring->positions[ring->corner_of[at]]))
            return ring->corner_of[at];
        at++;
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
    if (ring->number_of[corner] != NONE)
        drop_blocker(ring, corner);
    forget(ring, corner);
    ring->next[sides[0]] = sides[1];
    ring->previous[sides[1]] = sides[0];
    ring->size--;
    for (int i = 0; i < 2; i++) {
        forget(ring, sides[i]);
        classify(ring, sides[i]);
        if (bit_tree_has(&ring->convex, sides[i]) && ring->number_of[sides[i]] != NONE)
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

enum { SETS = 4, ARRAYS = 9 };

/* Returns the 64-bit words that the sets and arrays of a ring need. */
static uint64_t ring_words(uint32_t n)
{
    return SETS * bit_tree_words(n) + (ARRAYS * (uint64_t)n + 2) / 2;
}

uint64_t bsq_triangulate_scratch(uint32_t n)
{
    return n <= FEW_CORNERS ? 0 : ring_words(n) * sizeof(uint64_t);
}

/* Places the sets and arrays of a polygon's ring in `words`. */
static void place_arrays(struct ring *ring, uint64_t *words)
{
    const uint32_t n = ring->count;
    struct bit_tree *sets[SETS] = {&ring->convex, &ring->flat, &ring->open, &ring->blockers};
    uint32_t **arrays[ARRAYS] = {&ring->next,          &ring->previous,     &ring->witness,
                                 &ring->first_watcher, &ring->next_watcher, &ring->previous_watcher,
                                 &ring->number_of,     &ring->corner_of,    &ring->starts};
    for (int i = 0; i < SETS; i++, words += bit_tree_words(n))
        bit_tree_init(sets[i], words, n);
    uint32_t *numbers = (uint32_t *)words;
    for (int i = 0; i < ARRAYS; i++, numbers += n)
        *arrays[i] = numbers;
}

/* Links all corners and classifies them. Sets *blockers to the number of those that are not convex.
 */
static int make_ring(struct bsq_ctx *ctx, struct ring *ring, uint32_t *blockers)
{
    const uint32_t n = ring->count;
    int status = 0;
    *blockers = 0;
    for (uint32_t i = 0; i < n; i++) {
        ring->next[i] = i + 1 < n ? i + 1 : 0;
        ring->previous[i] = i ? i - 1 : n - 1;
        ring->witness[i] = ring->first_watcher[i] = ring->number_of[i] = NONE;
    }
    for (uint32_t i = 0; i < n && status == 0; i++) {
        classify(ring, i);
        *blockers += !bit_tree_has(&ring->convex, i);
        status = bsq_check_corner(ctx, i);
    }
    return status;
}

/* Lays the line at a right angle to the normal and to `from`. Returns how far corners lie apart
 * along it. */
static double lay_line(struct ring *ring, struct vector from)
{
    double low = INFINITY, high = -INFINITY;
    ring->line = cross(ring->normal, from);
    for (uint32_t i = 0; i < ring->count; i++) {
        low = fmin(low, along(ring, i));
        high = fmax(high, along(ring, i));
    }
    ring->low = low;
    ring->scale = high > low ? ring->sections / (high - low) : 0;
    return high - low;
}

/* Numbers `count` blockers along the longer one of two lines, section by section. */
static int number_blockers(struct bsq_ctx *ctx, struct ring *ring, uint32_t count)
{
    const struct vector n = ring->normal;
    const bool x = fabs(n.x) <= fabs(n.y) && fabs(n.x) <= fabs(n.z), y = fabs(n.y) <= fabs(n.z);
    const struct vector axis = {x, !x && y, !x && !y};
    const double size = sqrt(dot(n, n));
    ring->sections = count;
    const double length = lay_line(ring, axis);
    const struct vector across = {ring->line.x / size, ring->line.y / size, ring->line.z / size};
    if (lay_line(ring, across) < length)
        lay_line(ring, axis);
    int status = bsq_check(ctx);
    memset(ring->starts, 0, (count + UINT64_C(1)) * sizeof *ring->starts);
    for (uint32_t i = 0; i < ring->count; i++)
        ring->starts[section_at(ring, along(ring, i))] += !bit_tree_has(&ring->convex, i);
    for (uint32_t section = 0; section < count; section++)
        ring->starts[section + 1] += ring->starts[section];
    for (uint32_t i = ring->count; i-- > 0 && status == 0;) {
        status = bsq_check_corner(ctx, i);
        if (bit_tree_has(&ring->convex, i))
            continue;
        ring->number_of[i] = --ring->starts[section_at(ring, along(ring, i))];
        ring->corner_of[ring->number_of[i]] = i;
        bit_tree_add(&ring->blockers, ring->number_of[i]);
    }
    return status;
}

static int triangulate(struct bsq_ctx *ctx, struct ring *ring, uint32_t *triangles, void *memory)
{
    uint32_t blockers;
    place_arrays(ring, memory);
    int status = make_ring(ctx, ring, &blockers);
    if (status == 0 && (blockers == 0 || dot(ring->normal, ring->normal) == 0))
        return make_fan(ctx, ring->count, triangles);
    if (status == 0)
        status = number_blockers(ctx, ring, blockers);
    return status < 0 ? status : clip_ears(ctx, ring, triangles);
}

int bsq_triangulate(struct bsq_ctx *ctx, const double (*positions)[3], uint32_t n,
                    uint32_t *triangles, void *scratch)
{
    uint64_t few[SETS + (ARRAYS * FEW_CORNERS + 2) / 2]; /* ring_words() */
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
