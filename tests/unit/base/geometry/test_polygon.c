/* test_polygon.c - triangles cover their polygon, with its orientation, for any simple polygon. */
#include "base/geometry/polygon.h"
#include "tests/unit/sanitized.h"
#include "tests/unit/test.h"

enum { ROUNDS = TEST_SANITIZED ? 2000 : 20000 };
static uint64_t random_state; /* of test_random() */
SHARED_CONTEXT(ctx, 1)

/* Triangulates with scratch memory of exactly the size that is asked for. */
static void triangulate(const double (*positions)[3], uint32_t n, uint32_t *triangles)
{
    void *scratch = malloc(bsq_triangulate_scratch(n));
    assert_int_equal(bsq_triangulate(ctx, positions, n, triangles, scratch), 0);
    free(scratch);
}

static double random_unit(void)
{
    return (double)(test_random(&random_state) >> 11) * 0x1p-53;
}

/* A right-handed frame that places 2D polygons in space. */
struct frame {
    double origin[3], x[3], y[3], normal[3];
};

static void cross(const double a[3], const double b[3], double out[3])
{
    for (int i = 0; i < 3; i++)
        out[i] = a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3];
}

static double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static void random_direction(double out[3])
{
    double length;
    do {
        for (int i = 0; i < 3; i++)
            out[i] = 2 * random_unit() - 1;
        length = sqrt(dot(out, out));
    } while (length > 1 || length < 0.1);
    for (int i = 0; i < 3; i++)
        out[i] /= length;
}

static struct frame random_frame(double distance)
{
    struct frame f;
    double other[3];
    random_direction(f.normal);
    do
        random_direction(other);
    while (fabs(dot(other, f.normal)) > 0.9);
    cross(f.normal, other, f.x);
    double length = sqrt(dot(f.x, f.x));
    for (int i = 0; i < 3; i++)
        f.x[i] /= length;
    cross(f.normal, f.x, f.y);
    random_direction(f.origin);
    for (int i = 0; i < 3; i++)
        f.origin[i] *= distance;
    return f;
}

/* Triangulates a 2D polygon placed in `frame` and checks corners, orientation and areas. The area
 * comes from the 2D corners by the shoelace formula. */
static void check_polygon(const double (*corners)[2], uint32_t n, const struct frame *frame)
{
    double(*positions)[3] = malloc(n * sizeof *positions);
    uint32_t *triangles = malloc(3 * n * sizeof *triangles);
    uint32_t *used = calloc(n, sizeof *used);
    double area = 0, sum = 0, size = 0;
    for (uint32_t i = 0; i < n; i++) {
        const double *a = corners[i], *b = corners[(i + 1) % n];
        area += (a[0] * b[1] - a[1] * b[0]) / 2;
        size = fmax(size, fmax(fabs(a[0]), fabs(a[1])));
        for (int c = 0; c < 3; c++)
            positions[i][c] = frame->origin[c] + a[0] * frame->x[c] + a[1] * frame->y[c];
    }
    double side = area < 0 ? -1 : 1; /* triangles turn as their polygon does */
    double tolerance = 1e-9 * size * size * (1 + sqrt(dot(frame->origin, frame->origin)));
    memset(triangles, 0xff, 3 * n * sizeof *triangles);
    triangulate((const double(*)[3])positions, n, triangles);
    for (uint32_t t = 0; t < n - 2; t++) {
        double e[2][3], normal[3];
        for (int k = 0; k < 3; k++) {
            assert_in_range(triangles[3 * t + (uint32_t)k], 0, n - 1);
            used[triangles[3 * t + (uint32_t)k]]++;
        }
        for (int k = 0; k < 2; k++)
            for (int c = 0; c < 3; c++)
                e[k][c] = positions[triangles[3 * t + 1 + (uint32_t)k]][c] -
                          positions[triangles[3 * t]][c];
        cross(e[0], e[1], normal);
        double part = side * dot(normal, frame->normal) / 2;
        if (part < -tolerance)
            fail_msg("triangle %u of %u is turned over, area %g", t, n, part);
        sum += part;
    }
    if (fabs(sum - fabs(area)) > tolerance * n)
        fail_msg("polygon of %u: area %.17g, triangles %.17g", n, fabs(area), sum);
    for (uint32_t i = 0; i < n; i++)
        assert_true(used[i] > 0);
    free(positions);
    free(triangles);
    free(used);
}

static const struct frame flat = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}};

/* Makes a polygon that is star-shaped about the origin, and so simple for any radii. */
static void random_star(double (*corners)[2], uint32_t n, double least_radius)
{
    for (uint32_t i = 0; i < n; i++) {
        double angle = (i + 0.8 * random_unit()) * 2 * 3.14159265358979 / n;
        double radius = least_radius + (1 - least_radius) * random_unit();
        corners[i][0] = radius * cos(angle);
        corners[i][1] = radius * sin(angle);
    }
}

static void reverse(double (*corners)[2], uint32_t n)
{
    for (uint32_t i = 0; i < n / 2; i++)
        for (int c = 0; c < 2; c++) {
            double swap = corners[i][c];
            corners[i][c] = corners[n - 1 - i][c];
            corners[n - 1 - i][c] = swap;
        }
}

TEST(test_random_stars)
{
    double corners[200][2];
    random_state = test_seed();
    for (int i = 0; i < ROUNDS; i++) {
        uint32_t n = 3 + (uint32_t)(random_unit() * (i % 50 ? 12 : 190));
        struct frame frame = random_frame(i % 3 ? 10 : 0);
        random_star(corners, n, n == 3 ? 0.5 : 0.05);
        if (n == 3) /* a triangle must contain the origin, or its orientation changes */
            corners[2][0] = corners[2][1] = 0;
        if (random_unit() < 0.5)
            reverse(corners, n);
        check_polygon((const double(*)[2])corners, n, &frame);
    }
}

TEST(test_far_from_origin)
{
    double corners[20][2];
    random_state = test_seed();
    for (int i = 0; i < 2000; i++) {
        struct frame frame = random_frame(500000);
        random_star(corners, 20, 0.2);
        check_polygon((const double(*)[2])corners, 20, &frame);
    }
}

TEST(test_known_shapes)
{
    static const double comb[][2] = {{0, 0}, {7, 0}, {7, 5}, {6, 5}, {6, 1}, {5, 1},
                                     {5, 5}, {4, 5}, {4, 1}, {3, 1}, {3, 5}, {2, 5},
                                     {2, 1}, {1, 1}, {1, 5}, {0, 5}};
    static const double collinear[][2] = {{0, 0}, {1, 0}, {2, 0}, {2, 1},
                                          {2, 2}, {1, 2}, {0, 2}, {0, 1}};
    /* A square with a square hole; the bridge from corner 0 is walked twice. */
    static const double hole[][2] = {{0, 0}, {9, 0}, {9, 9}, {0, 9}, {0, 0},
                                     {3, 3}, {3, 6}, {6, 6}, {6, 3}, {3, 3}};
    static const double spiral[][2] = {{0, 0}, {9, 0}, {9, 9}, {2, 9}, {2, 3}, {6, 3}, {6, 6},
                                       {5, 6}, {5, 4}, {3, 4}, {3, 8}, {8, 8}, {8, 1}, {0, 1}};
    static const double repeated[][2] = {{0, 0}, {0, 0}, {4, 0}, {4, 4}, {4, 4}, {2, 1}, {0, 4}};
    check_polygon(comb, 16, &flat);
    check_polygon(collinear, 8, &flat);
    check_polygon(hole, 10, &flat);
    check_polygon(spiral, 14, &flat);
    check_polygon(repeated, 7, &flat);
    random_state = test_seed();
    for (int i = 0; i < 500; i++) {
        struct frame frame = random_frame(1);
        check_polygon(comb, 16, &frame);
        check_polygon(spiral, 14, &frame);
    }
}

/* The reflex corner of an arrowhead must be on the cut, whichever corner it is. */
TEST(test_arrowhead)
{
    static const double arrow[4][3] = {{0, 0, 0}, {4, 3, 0}, {1, 3, 0}, {0, 6, 0}};
    for (uint32_t first = 0; first < 4; first++) {
        double quad[4][3];
        uint32_t triangles[6], reflex = (2 + 4 - first) % 4, tip = (reflex + 2) % 4;
        for (uint32_t i = 0; i < 4; i++)
            memcpy(quad[i], arrow[(first + i) % 4], sizeof quad[i]);
        triangulate((const double(*)[3])quad, 4, triangles);
        for (int t = 0; t < 2; t++) {
            bool has_reflex = false, has_tip = false;
            for (int k = 0; k < 3; k++) {
                has_reflex |= triangles[3 * t + k] == reflex;
                has_tip |= triangles[3 * t + k] == tip;
            }
            assert_true(has_reflex && has_tip);
        }
    }
}

TEST(test_convex_quad_is_cut_at_its_first_corner)
{
    static const double quad[4][3] = {{0, 0, 5}, {1, 0, 5}, {1, 1, 5}, {0, 1, 5}};
    static const uint32_t expected[6] = {0, 1, 2, 0, 2, 3};
    uint32_t triangles[6];
    triangulate(quad, 4, triangles);
    assert_memory_equal(triangles, expected, sizeof expected);
}

/* Corners are at one position if their coordinates are equal; 0 and -0 are. */
TEST(test_sign_of_zero_changes_nothing)
{
    random_state = test_seed();
    for (int i = 0; i < ROUNDS; i++) {
        double plain[8][3] = {{0}}, negative[8][3];
        uint32_t expected[18], triangles[18];
        for (uint32_t k = 0; k < 8; k++) {
            for (int c = 0; c < 2; c++)
                plain[k][c] = floor(3 * random_unit()) - 1;
            for (int c = 0; c < 3; c++)
                negative[k][c] = plain[k][c] == 0 && random_unit() < 0.5 ? -0.0 : plain[k][c];
        }
        triangulate((const double(*)[3])plain, 8, expected);
        triangulate((const double(*)[3])negative, 8, triangles);
        assert_memory_equal(triangles, expected, sizeof expected);
    }
}

/* Degenerate input still gives n - 2 triangles of valid corners. */
TEST(test_degenerate)
{
    enum { most = 40 };
    double positions[most][3];
    uint32_t triangles[3 * most];
    random_state = test_seed();
    for (int i = 0; i < ROUNDS; i++) {
        uint32_t n = 3 + (uint32_t)(random_unit() * (most - 3));
        int kind = i % 5; /* a point, a line, few points, crossing edges, areas that overflow */
        for (uint32_t k = 0; k < n; k++)
            for (int c = 0; c < 3; c++)
                positions[k][c] = kind == 0   ? 3
                                  : kind == 1 ? (double)((k * 7) % n) * (c + 1)
                                  : kind == 2 ? floor(3 * random_unit())
                                  : kind == 4 ? random_unit() * 1e200
                                              : random_unit();
        memset(triangles, 0xff, sizeof triangles);
        triangulate((const double(*)[3])positions, n, triangles);
        for (uint32_t k = 0; k < 3 * (n - 2); k++)
            assert_in_range(triangles[k], 0, n - 1);
        assert_int_equal(triangles[3 * (n - 2)], UINT32_MAX);
    }
}

/* ---- large polygons ---- */

enum { LARGE = 10000, MEDIUM = 4800 };
static double large[LARGE][2];

static void place(uint32_t i, double x, double y)
{
    large[i][0] = x;
    large[i][1] = y;
}

/* Checks both orientations, flat and tilted. */
static void check_large(uint32_t n)
{
    random_state = 1;
    const struct frame tilted = random_frame(1);
    check_polygon((const double(*)[2])large, n, &flat);
    reverse(large, n);
    check_polygon((const double(*)[2])large, n, &tilted);
}

/* A strip that winds around the origin: out along one side, back along the other one. Triangles
 * that overlap would have areas of more than the strip. */
TEST(test_large_spiral)
{
    for (uint32_t i = 0; i < LARGE; i++) {
        uint32_t along = i < LARGE / 2 ? i : LARGE - 1 - i;
        double angle = along * 0.0157, radius = 1 + along / 400.0 + (i < LARGE / 2 ? 0.4 : 0);
        place(i, radius * cos(angle), radius * sin(angle));
    }
    check_large(LARGE);
}

/* The same with four corners a turn, so that triangles span the whole spiral. */
TEST(test_large_square_spiral)
{
    static const double x[4] = {1, -1, -1, 1}, y[4] = {1, 1, -1, -1};
    for (uint32_t i = 0; i < LARGE; i++) {
        uint32_t along = i < LARGE / 2 ? i : LARGE - 1 - i;
        double radius = 1 + along / 4 + 0.25 * (along % 4) + (i < LARGE / 2 ? 0.1 : 0);
        place(i, radius * x[along % 4], radius * y[along % 4]);
    }
    check_large(LARGE);
}

TEST(test_large_star)
{
    random_state = test_seed();
    random_star(large, MEDIUM, 0.05);
    check_large(MEDIUM);
}

/* Teeth of equal height have many corners in one line. */
TEST(test_large_comb)
{
    for (uint32_t i = 0; i < MEDIUM - 2; i++)
        place(i, i / 2, (i / 2 % 2 ? 1.0 : 9.0) + i % 2);
    place(MEDIUM - 2, MEDIUM / 2, -1);
    place(MEDIUM - 1, -1, -1);
    check_large(MEDIUM);
}

/* Corners in one line along all sides of a square. */
TEST(test_large_collinear)
{
    const uint32_t side = MEDIUM / 4;
    for (uint32_t i = 0; i < MEDIUM; i++) {
        double t = i % side;
        place(i,
              i < side       ? t
              : i < 2 * side ? side
              : i < 3 * side ? side - t
                             : 0,
              i < side       ? 0
              : i < 2 * side ? t
              : i < 3 * side ? side
                             : side - t);
    }
    check_large(MEDIUM);
}

/* Square holes in a square. A bridge that is walked twice leads from the left side to each hole, or
 * from each hole to the next. */
TEST(test_large_with_holes)
{
    enum { holes = 1000 };
    uint32_t n = 0;
    place(n++, 0, 0);
    place(n++, 9, 0);
    place(n++, 9, 3 * holes);
    place(n++, 0, 3 * holes);
    for (uint32_t h = holes; h-- > 0;) {
        double y = 3 * h;
        place(n++, 0, y + 1); /* on the left side */
        place(n++, 3, y + 1);
        place(n++, 3, y + 2);
        place(n++, 6, y + 2);
        place(n++, 6, y + 1);
        place(n++, 3, y + 1);
        place(n++, 0, y + 1);
    }
    check_large(n);
}

/* Each corner comes three times. */
TEST(test_large_with_repeated_corners)
{
    static double corners[MEDIUM / 3][2];
    random_state = test_seed();
    random_star(corners, MEDIUM / 3, 0.3);
    for (uint32_t i = 0; i < MEDIUM / 3 * 3; i++)
        place(i, corners[i / 3][0], corners[i / 3][1]);
    check_large(MEDIUM / 3 * 3);
}

/* Random walks that keep to their own column on the way up and down are simple polygons with
 * neither symmetry nor order. */
TEST(test_random_simple_polygons)
{
    random_state = test_seed();
    for (int i = 0; i < 2000; i++) {
        uint32_t n = 5 + (uint32_t)(300 * random_unit()), half = n / 2;
        struct frame frame = random_frame(1);
        for (uint32_t k = 0; k < n; k++) {
            double middle = 3 * sin(k < half ? k * 0.9 : (n - 1 - k) * 0.9);
            double y = k < half ? k : n - 1 - k;
            place(k, middle + (k < half ? 0.01 + 3 * random_unit() : -0.01 - 3 * random_unit()), y);
        }
        if (i % 2)
            reverse(large, n);
        check_polygon((const double(*)[2])large, n, &frame);
    }
}

/* No two triangles of a small polygon overlap: random points lie in as many triangles as they
 * should, by the even-odd rule. */
TEST(test_triangles_do_not_overlap)
{
    double corners[100][2], positions[100][3];
    uint32_t triangles[300];
    random_state = test_seed();
    for (int i = 0; i < 200; i++) {
        const uint32_t n = 5 + (uint32_t)(95 * random_unit());
        random_star(corners, n, 0.05);
        for (uint32_t k = 0; k < n; k++) {
            memcpy(positions[k], corners[k], sizeof corners[k]);
            positions[k][2] = 0;
        }
        triangulate((const double(*)[3])positions, n, triangles);
        for (int point = 0; point < 100; point++) {
            const double x = 2 * random_unit() - 1, y = 2 * random_unit() - 1;
            uint32_t covers = 0, crossings = 0;
            for (uint32_t k = 0; k < n; k++) {
                const double *a = corners[k], *b = corners[(k + 1) % n];
                if ((a[1] > y) != (b[1] > y))
                    crossings += x < a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0]);
            }
            for (uint32_t t = 0; t < n - 2; t++) {
                int inside = 0;
                for (int k = 0; k < 3; k++) {
                    const double *a = corners[triangles[3 * t + (uint32_t)k]];
                    const double *b = corners[triangles[3 * t + (uint32_t)(k + 1) % 3]];
                    inside += (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0]) > 0;
                }
                covers += inside == 3;
            }
            assert_int_equal(covers, crossings % 2);
        }
    }
}

/* Self-intersecting polygons of any size end, with triangles of valid corners. */
TEST(test_large_degenerate)
{
    static double positions[MEDIUM][3];
    uint32_t *triangles = malloc(3 * MEDIUM * sizeof *triangles);
    random_state = test_seed();
    for (int kind = 0; kind < 4; kind++) { /* crossing edges, few points, a line, one point */
        for (uint32_t i = 0; i < MEDIUM; i++)
            for (int c = 0; c < 3; c++)
                positions[i][c] = kind == 0   ? random_unit()
                                  : kind == 1 ? floor(3 * random_unit())
                                  : kind == 2 ? (double)(i * 7919 % MEDIUM)
                                              : 3;
        memset(triangles, 0xff, 3 * MEDIUM * sizeof *triangles);
        triangulate((const double(*)[3])positions, MEDIUM, triangles);
        for (uint32_t i = 0; i < 3 * (MEDIUM - 2); i++)
            assert_in_range(triangles[i], 0, MEDIUM - 1);
        assert_int_equal(triangles[3 * (MEDIUM - 2)], UINT32_MAX);
    }
    free(triangles);
}

/* Polygons that need no search: on a line, and convex. */
TEST(test_interruption_of_a_fan)
{
    enum { SIZE = 1 << 17 };
    double(*positions)[3] = malloc(SIZE * sizeof *positions);
    uint32_t *triangles = malloc(3 * SIZE * sizeof *triangles);
    void *scratch = malloc(bsq_triangulate_scratch(SIZE));
    for (int kind = 0; kind < 2; kind++) {
        for (int i = 0; i < SIZE; i++) {
            positions[i][0] = i;
            positions[i][1] = kind * (double)i * i;
            positions[i][2] = 0;
        }
        bsq_interrupt(ctx);
        assert_int_equal(
            bsq_triangulate(ctx, (const double(*)[3])positions, SIZE, triangles, scratch),
            BSQ_EINTR);
        bsq_clear_interruption(ctx);
        bsq_clear_error(ctx);
    }
    free(positions);
    free(triangles);
    free(scratch);
}

RUN_TESTS(open_ctx, close_ctx)
