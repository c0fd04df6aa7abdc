/* test_preview.c - the preview's vertical axis, its views, and texels without a hit. */
#include "tests/unit/test.h"

#include "libbake/preview/preview_view.h"

/* ---- the vertical axis ---- */

/* A pyramid with a square base of side 2 in the plane of the other axes, and its apex in positive
 * direction of `axis`. Returns the number of triangles. */
static uint64_t make_pyramid(int axis, double height, double (*out)[3][3])
{
    static const double base[4][2] = {{-1, -1}, {-1, 1}, {1, 1}, {1, -1}};
    const int u = (axis + 1) % 3, v = (axis + 2) % 3;
    uint64_t count = 0;
    memset(out, 0, 6 * sizeof *out);
    for (int side = 0; side < 4; side++, count++)
        for (int c = 0; c < 2; c++) {
            const double *corner = base[(side + 1 - c) % 4];
            out[count][c][u] = corner[0];
            out[count][c][v] = corner[1];
            out[count][2][axis] = height;
        }
    for (int half = 0; half < 2; half++, count++)
        for (int c = 0; c < 3; c++) {
            const double *corner = base[c == 0 ? 0 : half + c];
            out[count][c][u] = corner[0];
            out[count][c][v] = corner[1];
        }
    return count;
}

static int up_axis_of(double (*positions)[3][3], uint64_t count, enum bake_up up)
{
    struct bake_lowmesh mesh = {.triangle_count = count, .positions = positions};
    for (int k = 0; k < 3; k++) {
        mesh.bounds_min[k] = INFINITY;
        mesh.bounds_max[k] = -INFINITY;
        for (uint64_t t = 0; t < count; t++)
            for (int c = 0; c < 3; c++) {
                mesh.bounds_min[k] = fmin(mesh.bounds_min[k], positions[t][c][k]);
                mesh.bounds_max[k] = fmax(mesh.bounds_max[k], positions[t][c][k]);
            }
    }
    const struct bake_options options = {.preview_up = up, .preview_from = -1};
    const struct bake_preview preview = {.mesh = &mesh, .options = &options};
    return bake_preview_up_axis(&preview);
}

TEST(test_mesh_stands_on_its_base)
{
    double pyramid[6][3][3];
    for (int axis = 1; axis < 3; axis++) {
        const uint64_t count = make_pyramid(axis, 2, pyramid);
        assert_int_equal(up_axis_of(pyramid, count, BAKE_UP_AUTO), axis);
        assert_int_equal(up_axis_of(pyramid, count, BAKE_UP_Y), 1);
        assert_int_equal(up_axis_of(pyramid, count, BAKE_UP_Z), 2);
        /* Without its base it stands on the hole. */
        assert_int_equal(up_axis_of(pyramid, 4, BAKE_UP_AUTO), axis);
    }
    /* A relief on the plane z = 0 hangs on a wall. */
    const uint64_t count = make_pyramid(2, 0.4, pyramid);
    assert_int_equal(up_axis_of(pyramid, count, BAKE_UP_AUTO), 1);
    /* It stands on x. */
    assert_int_equal(up_axis_of(pyramid, make_pyramid(0, 2, pyramid), BAKE_UP_AUTO), 1);
}

/* An animal may have a larger muzzle than feet, but its feet are farther apart. */
TEST(test_mesh_stands_on_its_legs)
{
    for (int axis = 1; axis < 3; axis++) {
        double legs[5][3][3];
        const int other = 3 - axis;
        for (int leg = 0; leg < 4; leg++)
            for (int c = 0; c < 3; c++) {
                legs[leg][c][0] = (leg & 1 ? 2 : -2) + 0.1 * (c == 1);
                legs[leg][c][other] = (leg & 2 ? 2 : -2) + 0.1 * (c == 2);
                legs[leg][c][axis] = 0;
            }
        /* A muzzle: a triangle of area 2 across the other axis. */
        for (int c = 0; c < 3; c++) {
            legs[4][c][0] = c - 1;
            legs[4][c][other] = -3;
            legs[4][c][axis] = c == 1 ? 4 : 2;
        }
        assert_int_equal(up_axis_of(legs, 5, BAKE_UP_AUTO), axis);
    }
}

/* ---- views ---- */

static double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

TEST(test_views_go_around_the_vertical_axis)
{
    double pyramid[6][3][3];
    struct bake_lowmesh mesh = {.triangle_count = make_pyramid(1, 2, pyramid),
                                .positions = pyramid};
    const struct bake_surface surface = {.scan_max = {1, 1, 1}};
    const struct bake_preview preview = {.mesh = &mesh, .surface = &surface};
    for (int up = 1; up < 3; up++) {
        const double front[3] = {0, up == 1 ? 0 : -1, up == 1 ? 1 : 0};
        struct preview_view views[4];
        for (uint32_t i = 0; i < 4; i++) {
            bake_preview_view_set(&preview, 30 + 90 * i, 17, up, 64, &views[i]);
            const double *r = views[i].right, *u = views[i].up, *t = views[i].toward;
            assert_true(fabs(dot(r, u)) + fabs(dot(u, t)) + fabs(dot(t, r)) < 1e-12);
            assert_true(fabs(dot(r, r) - 1) + fabs(dot(u, u) - 1) + fabs(dot(t, t) - 1) < 1e-12);
            /* right x up = toward: nothing is mirrored. */
            const double cross[3] = {r[1] * u[2] - r[2] * u[1], r[2] * u[0] - r[0] * u[2],
                                     r[0] * u[1] - r[1] * u[0]};
            assert_true(dot(cross, t) > 0.999999);
            assert_true(u[up] > 0.9 && t[up] > 0.2 && r[up] == 0);
        }
        assert_true(dot(views[0].toward, front) > 0.7); /* the first shows the front */
        assert_true(fabs(dot(views[0].right, views[1].right)) < 1e-12);
        assert_true(dot(views[0].right, views[2].right) < -0.999999);
        assert_true(dot(views[1].right, views[3].right) < -0.999999);
    }
}

/* Returns the cosine of the angle between a view and a direction, in the coordinates of up axis 1.
 */
static double view_cosine(const struct bake_preview_views *views, uint32_t i, const double v[3])
{
    const double around = (views->from + i * views->step) * M_PI / 180,
                 high = views->above * M_PI / 180;
    const double toward[3] = {cos(high) * sin(around), sin(high), cos(high) * cos(around)};
    return dot(toward, v) / sqrt(dot(v, v));
}

TEST(test_views_show_the_front_of_an_open_mesh)
{
    double pyramid[6][3][3], triangle[1][3][3];
    struct bake_lowmesh mesh = {.triangle_count = make_pyramid(1, 2, pyramid),
                                .positions = pyramid};
    struct bake_options options = {.preview_views = 4, .preview_from = -1, .preview_above = -1};
    const struct bake_preview preview = {.mesh = &mesh, .options = &options};
    struct bake_preview_views views;
    bake_preview_place_views(&preview, 1, &views); /* it is closed */
    assert_true(views.from == 30 && views.above == 17 && views.step == 90);
    static const double fronts[][3] = {{0, 0, 1},  {1, 0, -1}, {-2, 1, 0},
                                       {1, -1, 1}, {0, 1, 0},  {0, -1, 0}};
    for (size_t f = 0; f < sizeof fronts / sizeof *fronts; f++)
        for (int up = 1; up < 3; up++) {
            const double *n = fronts[f];
            /* A triangle across the front: its corners are s, t and -s - t, with s x t along n. */
            const double s[3] = {n[1] - n[2], n[2] - n[0], n[0] - n[1]};
            for (int k = 0; k < 3; k++) {
                const int a = (k + 1) % 3, b = (k + 2) % 3, to = up == 1 ? k : k == 0 ? 0 : 3 - k;
                const double sign = up == 2 && k == 2 ? -1 : 1, t = n[a] * s[b] - n[b] * s[a];
                triangle[0][0][to] = sign * s[k];
                triangle[0][1][to] = sign * t;
                triangle[0][2][to] = sign * (-s[k] - t);
            }
            mesh = (struct bake_lowmesh){.triangle_count = 1, .positions = triangle};
            const bool level = n[0] != 0 || n[2] != 0;
            bake_preview_place_views(&preview, up, &views);
            assert_int_equal(views.step < 90, level); /* within 90 degrees around */
            for (uint32_t i = 0; i < 4; i++)
                assert_true(view_cosine(&views, i, n) > 0.5);
        }
    options.preview_from = 10;
    options.preview_above = 5;
    bake_preview_place_views(&preview, 1, &views);
    assert_true(views.from == 10 && views.above == 5 && views.step == 90);
}

/* ---- misses ---- */

CONTEXT_TEST(test_misses_are_averaged, 2, 0)
{
    enum { WIDTH = 8, HEIGHT = 130, CHANNELS = 2 };
    struct bake_image *image;
    const struct bake_image_options options = {.width = WIDTH,
                                               .height = HEIGHT,
                                               .channels = CHANNELS,
                                               .memory_bytes = UINT64_MAX,
                                               .beside = "."};
    assert_int_equal(bake_image_create(ctx, &options, &image), 0);
    /* The rows from 64 on have one missed texel in each block of 2 x 2, and one outside. */
    float texels[HEIGHT][WIDTH][CHANNELS];
    for (int y = 0; y < HEIGHT; y++)
        for (int x = 0; x < WIDTH; x++) {
            texels[y][x][0] = 0.25f;
            texels[y][x][1] = NAN;
            if (y >= 64 && y % 2 == 0)
                texels[y][x][0] = x % 2 == 0 ? BAKE_MISSED : BAKE_OUTSIDE;
        }
    assert_int_equal(bake_image_write(image, 0, 0, WIDTH, HEIGHT, texels[0][0]), 0);
    struct bake_thumbnail missed = {0};
    assert_int_equal(bake_thumbnail_of_missed(ctx, image, HEIGHT / 2, &missed), 0);
    assert_int_equal(missed.width, WIDTH / 2);
    assert_int_equal(missed.height, HEIGHT / 2);
    for (uint32_t i = 0; i < missed.width * missed.height; i++) {
        const bool lower = i >= 32 * missed.width;
        assert_true(missed.texels[i][0] == (lower ? 0.25f : 0.0f));
        assert_true(missed.texels[i][1] == (lower ? 0.5f : 1.0f));
    }
    bake_thumbnail_free(ctx, &missed);
    bake_image_free(image);
}

/* Returns the light that the middle of a triangle sends to a camera `from` degrees around it. */
static struct bsq_vec3 shade_middle(const struct bake_thumbnail *missed, double from)
{
    double positions[1][3][3] = {{{-1, -1, 0}, {1, -1, 0}, {0, 1, 0}}};
    float normals[1][3][3] = {{{0, 0, 1}, {0, 0, 1}, {0, 0, 1}}};
    float texcoords[1][3][2] = {{{0, 0}, {1, 0}, {0.5f, 1}}};
    struct bake_lowmesh mesh = {
        .triangle_count = 1, .positions = positions, .normals = normals, .texcoords = texcoords};
    const struct bake_thumbnail none = {0};
    const struct bake_preview_tile tile = {
        {.number = BAKE_FIRST_TILE, .first = 0, .count = 1}, &none, &none, missed};
    const struct bake_surface surface = {.scan_max = {1, 1, 1}};
    const struct bake_options options = {.preview_views = 1};
    const struct bake_preview preview = {
        .mesh = &mesh, .surface = &surface, .tiles = &tile, .tile_count = 1, .options = &options};
    struct preview_view view;
    bake_preview_view_set(&preview, from, 0, 1, 64, &view);
    struct bsq_vec3 plain, mapped;
    bake_preview_mesh_sample(&preview, &view, 0, 64, 64, &plain, &mapped);
    return mapped;
}

TEST(test_misses_are_red)
{
    float texels[1][3] = {{0, 1, 0}};
    struct bake_thumbnail missed = {1, 1, 1, 1, 1, texels};
    const struct bsq_vec3 hit = shade_middle(&missed, 0);
    assert_true(hit.x == hit.y && hit.y == hit.z && hit.x > 0.1f);
    texels[0][0] = 0.5f;
    texels[0][1] = 0.0f; /* the other half is outside the chart */
    const struct bsq_vec3 miss = shade_middle(&missed, 0);
    assert_true(miss.x > 0.1f && miss.y < 0.2f * miss.x && miss.z == miss.y);
}

/* Its back is lit as its front is. */
TEST(test_backs_are_lit)
{
    float texels[1][3] = {{0, 1, 0}};
    struct bake_thumbnail missed = {1, 1, 1, 1, 1, texels};
    const struct bsq_vec3 front = shade_middle(&missed, 0), back = shade_middle(&missed, 180);
    assert_true(fabsf(front.x - back.x) < 1e-5f && front.x > 0.1f);
}

/* ---- where camera rays start ---- */

RUN_TESTS(NULL, NULL)
