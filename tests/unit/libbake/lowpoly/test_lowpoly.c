/* test_lowpoly.c - loading of the low-poly mesh: attributes of the file, attributes that are filled
 * in, and messages. */
#include <float.h>

#include "libbake/lowpoly/lowpoly.h"
#include "tests/unit/test.h"

struct fixture {
    struct bsq_ctx *ctx;
    FILE *file;
    struct bake_lowmesh mesh;
    enum bake_rays rays;
    enum bake_low_normals normals;
    struct bake_options options;
};

static int set_up(void **state)
{
    struct fixture *f = calloc(1, sizeof(*f));
    if (f == NULL || bsq_ctx_create(&(struct bsq_ctx_options){.threads = 1}, &f->ctx) < 0)
        return -1;
    bake_defaults(&f->options);
    f->file = fopen("low.obj", "w");
    *state = f;
    return f->file ? 0 : -1;
}

static int tear_down(void **state)
{
    struct fixture *f = *state;
    bake_lowmesh_free(f->ctx, &f->mesh);
    if (bsq_memory_used(f->ctx) > 0)
        return -1;
    bsq_ctx_destroy(f->ctx);
    free(f);
    return 0;
}
#define FIXTURE_TEST(name) STATE_TEST(name, struct fixture, set_up, tear_down)

static int load_file(struct fixture *f, const char *path)
{
    f->options.mesh_path = path;
    f->options.rays = f->rays;
    f->options.low_normals = f->normals;
    return bake_lowmesh_load(f->ctx, &f->options, &f->mesh);
}

static void load(struct fixture *f)
{
    assert_int_equal(fclose(f->file), 0);
    if (load_file(f, "low.obj") < 0)
        fail_msg("%s", bsq_error(f->ctx));
}

static void load_text(struct fixture *f, const char *text)
{
    fputs(text, f->file);
    load(f);
}

/* Expects loading to fail with the path followed by `message`. */
static void fail_text(struct fixture *f, const char *text, const char *message)
{
    char expected[256];

    fputs(text, f->file);
    assert_int_equal(fclose(f->file), 0);
    assert_int_equal(load_file(f, "low.obj"), BSQ_EDATA);
    snprintf(expected, sizeof expected, "low.obj%s", message);
    assert_string_equal(bsq_error(f->ctx), expected);
    assert_null(f->mesh.positions);
    assert_int_equal(bsq_memory_used(f->ctx), 0);
}

static void assert_vector(const float *v, float x, float y, float z)
{
    if (!(fabsf(v[0] - x) < 1e-5f && fabsf(v[1] - y) < 1e-5f && fabsf(v[2] - z) < 1e-5f))
        fail_msg("(%g %g %g), expected (%g %g %g)", v[0], v[1], v[2], x, y, z);
}

/* Writes a unit sphere of quads with triangles at its poles, without normals. The texture has a
 * seam where longitude wraps, the positions have none. */
static void write_sphere(FILE *file, const double centre[3], int columns, int rows)
{
    for (int y = 0; y <= rows; y++) {
        for (int x = 0; x < columns; x++) {
            double a = 2 * M_PI * x / columns, b = M_PI * y / rows - M_PI / 2;
            if ((y > 0 && y < rows) || x == 0)
                fprintf(file, "v %.12f %.12f %.12f\n", centre[0] + cos(a) * cos(b),
                        centre[1] + sin(a) * cos(b), centre[2] + sin(b));
        }
    }
    for (int y = 0; y <= rows; y++) {
        for (int x = 0; x <= columns; x++)
            fprintf(file, "vt %.9f %.9f\n", (double)x / columns, (double)y / rows);
    }
    for (int y = 0; y < rows; y++) {
        for (int x = 0; x < columns; x++) {
            int south = 2 + (y - 1) * columns, north = south + columns, next = (x + 1) % columns;
            int vt = 1 + y * (columns + 1) + x, above = vt + columns + 1;
            if (y == 0)
                fprintf(file, "f 1/%d %d/%d %d/%d\n", vt, north + next, above + 1, north + x,
                        above);
            else if (y == rows - 1)
                fprintf(file, "f %d/%d %d/%d %d/%d\n", south + x, vt, south + next, vt + 1, north,
                        above);
            else
                fprintf(file, "f %d/%d %d/%d %d/%d %d/%d\n", south + x, vt, south + next, vt + 1,
                        north + next, above + 1, north + x, above);
        }
    }
}

/* Compares normals with the radial direction. A row of the sphere spans 5.6 degrees. */
FIXTURE_TEST(test_missing_normals_are_smooth)
{
    const double centre[3] = {3, -2, 7};
    write_sphere(f->file, centre, 64, 32);
    load(f);
    assert_int_equal(f->mesh.triangle_count, 2 * 64 * 30 + 2 * 64);
    for (uint64_t t = 0; t < f->mesh.triangle_count; t++) {
        for (int i = 0; i < 3; i++) {
            double dot = 0;
            for (int k = 0; k < 3; k++)
                dot += (f->mesh.positions[t][i][k] - centre[k]) * f->mesh.normals[t][i][k];
            assert_true(dot > cos(M_PI / 180)); /* within a degree, seam and poles included */
        }
    }
    for (int k = 0; k < 3; k++) {
        assert_float_equal(f->mesh.bounds_min[k], centre[k] - 1, 1e-9);
        assert_float_equal(f->mesh.bounds_max[k], centre[k] + 1, 1e-9);
    }
}

/* On a sphere, tangents point along the circles of latitude, and rows of v go north. */
FIXTURE_TEST(test_tangents_of_a_sphere)
{
    const double centre[3] = {0, 0, 0};
    write_sphere(f->file, centre, 64, 32);
    load(f);
    for (uint64_t t = 0; t < f->mesh.triangle_count; t++) {
        for (int i = 0; i < 3; i++) {
            const double *p = f->mesh.positions[t][i];
            const float *tangent = f->mesh.tangents[t][i];
            double radius = hypot(p[0], p[1]);
            if (radius < 0.2)
                continue; /* longitude has no direction at the poles */
            assert_true((tangent[1] * p[0] - tangent[0] * p[1]) / radius > cos(5 * M_PI / 180));
            assert_float_equal(tangent[3], 1, 0);
        }
    }
}

/* At 5,000,000 m, neighbouring floats are 0.5 m apart: half of the sphere's radius. */
FIXTURE_TEST(test_tangents_far_from_the_origin)
{
    const double centre[3] = {5000000, 400000, 300};
    write_sphere(f->file, centre, 64, 32);
    load(f);
    for (uint64_t t = 0; t < f->mesh.triangle_count; t++) {
        for (int i = 0; i < 3; i++) {
            double x = f->mesh.positions[t][i][0] - centre[0];
            double y = f->mesh.positions[t][i][1] - centre[1];
            const float *tangent = f->mesh.tangents[t][i];
            if (hypot(x, y) > 0.2)
                assert_true((tangent[1] * x - tangent[0] * y) / hypot(x, y) > cos(5 * M_PI / 180));
        }
    }
}

/* Two triangles share vertices 1 and 2: one of area 3 that faces z, one of area 1 that faces -y. At
 * vertex 1 both have right angles, at vertex 2 those of legs 3 to 2 and 1 to 2. */
FIXTURE_TEST(test_missing_normals_by_weight)
{
    static const struct {
        enum bake_low_normals kind;
        double at[2][2]; /* y and z at vertices 1 and 2 of the first triangle, of any length */
    } cases[] = {{BAKE_LOW_AUTO, {{-1, 1}, {-0.4636476, 0.9827937}}},
                 {BAKE_LOW_ANGLE, {{-1, 1}, {-0.4636476, 0.9827937}}},
                 {BAKE_LOW_SMOOTH, {{-1, 3}, {-1, 3}}},
                 {BAKE_LOW_FLAT, {{0, 1}, {0, 1}}}};
    fputs("v 0 0 0\nv 2 0 0\nv 0 3 0\nv 0 0 1\nvt 0 0\nvt 1 0\nvt 0 1\n"
          "f 1/1 2/2 3/3\nf 1/1 2/2 4/3\n",
          f->file);
    fflush(f->file);
    for (size_t c = 0; c < sizeof cases / sizeof *cases; c++) {
        f->normals = cases[c].kind;
        assert_int_equal(load_file(f, "low.obj"), 0);
        for (int v = 0; v < 2; v++) {
            const double *yz = cases[c].at[v], length = hypot(yz[0], yz[1]);
            assert_vector(f->mesh.normals[0][v], 0, (float)(yz[0] / length),
                          (float)(yz[1] / length));
        }
        assert_vector(f->mesh.normals[0][2], 0, 0, 1);
        assert_vector(f->mesh.normals[1][2], 0, -1, 0);
        bake_lowmesh_free(f->ctx, &f->mesh);
    }
    fclose(f->file);
}

/* Each word of BAKE_TURNS is another turn, and no mirror. */
TEST(test_turns)
{
    double turns[24][3][3];
    unsigned count = 1;
    for (const char *at = BAKE_TURNS; *at; at++)
        count += *at == ' ';
    assert_int_equal(count, 24);
    for (unsigned t = 0; t < count; t++) {
        double(*m)[3] = turns[t], cross[3];
        bake_turn_matrix(t, m);
        for (int k = 0; k < 3; k++)
            cross[k] =
                m[0][(k + 1) % 3] * m[1][(k + 2) % 3] - m[0][(k + 2) % 3] * m[1][(k + 1) % 3];
        for (int k = 0; k < 3; k++)
            assert_true(cross[k] == m[2][k]);
        for (unsigned u = 0; u < t; u++)
            assert_memory_not_equal(turns[u], m, sizeof turns[u]);
    }
}

/* A mesh and its normals: scaled, then turned so that z points upwards, then shifted. */
FIXTURE_TEST(test_placement)
{
    f->options.low_scale = 2;
    f->options.low_turn = 1;
    f->options.low_x = 10;
    f->options.low_y = 20;
    f->options.low_z = 30;
    load_text(f, "v 1 2 3\nv 2 2 3\nv 1 2 4\nvt 0 0\nvt 1 0\nvt 0 1\nvn 0 1 0\n"
                 "f 1/1/1 2/2/1 3/3/1\n");
    assert_true(f->mesh.positions[0][0][0] == 12 && f->mesh.positions[0][0][1] == 14 &&
                f->mesh.positions[0][0][2] == 34);
    assert_true(f->mesh.bounds_min[1] == 12 && f->mesh.bounds_max[0] == 14);
    assert_vector(f->mesh.normals[0][0], 0, 0, 1);
}

FIXTURE_TEST(test_attributes_of_the_file)
{
    load_text(f, "v 0 0 0\nv 1 0 0\nv 1 1 0.25\nv 0 1 0\nvt 0.5 0.25\nvt 1 0.25\nvt 1 1\nvt 0.5 1\n"
                 "vn 0 0 5\nvn 3 0 4\nf 1/1/1 2/2/2 3/3/1 4/4/1\n");
    assert_int_equal(f->mesh.triangle_count, 2);
    for (int t = 0; t < 2; t++) {
        for (int i = 0; i < 3; i++) {
            const double *p = f->mesh.positions[t][i];
            const float *uv = f->mesh.texcoords[t][i];
            assert_float_equal(uv[0], 0.5 + 0.5 * p[0], 0);
            assert_float_equal(uv[1], 0.25 + 0.75 * p[1], 0);
            if (p[0] == 1 && p[1] == 0)
                assert_vector(f->mesh.normals[t][i], 0.6f, 0, 0.8f);
            else
                assert_vector(f->mesh.normals[t][i], 0, 0, 1);
        }
    }
}

/* A zero normal is replaced by the face's normal; a corner without one gets the smooth normal. */
FIXTURE_TEST(test_zero_and_partly_missing_normals)
{
    load_text(f, "v 0 0 0\nv 0 1 0\nv 0 0 1\nv 1 0 0\nvt 0 0\nvt 1 0\nvt 0 1\nvn 0 0 0\nvn 0 1 0\n"
                 "f 1/1/1 2/2/2 3/3/1\nf 1/1 4/2 2/3\n");
    assert_vector(f->mesh.normals[0][0], 1, 0, 0);
    assert_vector(f->mesh.normals[0][1], 0, 1, 0);
    assert_vector(f->mesh.normals[0][2], 1, 0, 0);
    assert_vector(f->mesh.normals[1][0], sqrtf(0.5f), 0, sqrtf(0.5f));
    assert_vector(f->mesh.normals[1][1], 0, 0, 1);
}

FIXTURE_TEST(test_degenerate_triangle_has_a_unit_normal)
{
    load_text(f, "v 0 0 0\nv 1 0 0\nv 2 0 0\nvt 0 0\nvt 1 0\nvt 0 1\nvn 0 0 0\n"
                 "f 1/1 2/2 3/3\nf 1/1/1 2/2/1 3/3/1\n");
    for (int t = 0; t < 2; t++) {
        for (int i = 0; i < 3; i++) {
            const float *n = f->mesh.normals[t][i];
            assert_float_equal(n[0] * n[0] + n[1] * n[1] + n[2] * n[2], 1, 1e-6);
        }
    }
}

/* ---- ray directions ---- */

/* Two squares of a cube that meet in a hard edge, with normals of their own and a UV seam. The
 * second one is split the other way, and its vertices are written again. */
static const char hard_edge[] =
    "v 0 0 1\nv 1 0 1\nv 1 1 1\nv 0 1 1\n"
    "v 1 0 1\nv 1 0 0\nv 1 1 0\nv 1 1 1\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
    "vn 0 0 1\nvn 1 0 0\n"
    "f 1/1/1 2/2/1 3/3/1\nf 1/1/1 3/3/1 4/4/1\n"
    "f 5/1/2 6/2/2 8/4/2\nf 6/2/2 7/3/2 8/4/2\n";

FIXTURE_TEST(test_directions_are_smooth_over_hard_edges)
{
    const float half = (float)sqrt(0.5);
    load_text(f, hard_edge);
    assert_vector(f->mesh.directions[0][0], 0, 0, 1);
    assert_vector(f->mesh.directions[0][1], half, 0, half);
    assert_vector(f->mesh.directions[1][1], half, 0, half);
    assert_vector(f->mesh.directions[2][0], half, 0, half);
    assert_vector(f->mesh.directions[3][2], half, 0, half);
    assert_vector(f->mesh.directions[2][1], 1, 0, 0);
    assert_vector(f->mesh.normals[2][0], 1, 0, 0); /* tangent space keeps the mesh's own */
    assert_true(f->mesh.cage_distance == 0);
}

FIXTURE_TEST(test_directions_of_the_mesh_and_of_faces)
{
    f->rays = BAKE_RAYS_MESH;
    load_text(f, hard_edge);
    assert_memory_equal(f->mesh.directions, f->mesh.normals, 4 * sizeof *f->mesh.normals);
    bake_lowmesh_free(f->ctx, &f->mesh);
    f->rays = BAKE_RAYS_FACE;
    bsq_forget_files(f->ctx);
    assert_non_null(f->file = fopen("low.obj", "w"));
    load_text(f, "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nvn 1 0 0\n"
                 "f 1/1/1 2/2/1 3/3/1\nf 1/1/1 2/2/1 2/2/1\n");
    for (int i = 0; i < 3; i++) {
        assert_vector(f->mesh.directions[0][i], 0, 0, 1);
        assert_vector(f->mesh.directions[1][i], 1, 0, 0); /* no area */
    }
}

/* Checks that all corners of the loaded triangles have a reach, and unloads them. */
static void check_reaches(struct fixture *f, const char *text, double expected)
{
    bsq_forget_files(f->ctx);
    assert_non_null(f->file = fopen("low.obj", "w"));
    load_text(f, text);
    for (uint64_t t = 0; t < f->mesh.triangle_count; t++)
        for (int i = 0; i < 3; i++)
            assert_float_equal(f->mesh.reaches[t][i], expected, 1e-6);
    bake_lowmesh_free(f->ctx, &f->mesh);
}

/* An eighth of a cylinder of radius 1 and length 9 rises by 1 - cos(22.5 degrees) over its chord,
 * whatever the length of the diagonal; a dent rises over nothing, and the edges of a box are no
 * round surface. */
FIXTURE_TEST(test_reaches_cover_arcs)
{
    static const char strip[] = "v 0.38268343 0.92387953 0\nv -0.38268343 0.92387953 0\n"
                                "v -0.38268343 0.92387953 9\nv 0.38268343 0.92387953 9\n"
                                "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n";
    static const char faces[] = "f 1/1/1 2/2/2 3/3/2\nf 1/1/1 3/3/2 4/4/1\n";
    char text[400];
    load_text(f, hard_edge);
    snprintf(text, sizeof text, "%svn 0.38268343 0.92387953 0\nvn -0.38268343 0.92387953 0\n%s",
             strip, faces);
    bake_lowmesh_free(f->ctx, &f->mesh);
    check_reaches(f, text, 1.5 * (1 - cos(0.39269908)));
    snprintf(text, sizeof text, "%svn -0.38268343 0.92387953 0\nvn 0.38268343 0.92387953 0\n%s",
             strip, faces);
    check_reaches(f, text, 0);
    snprintf(text, sizeof text, "%svn 0.6 0.8 0\nvn -0.6 0.8 0\n%s", strip, faces);
    check_reaches(f, text, 0); /* 73.7 degrees */
    check_reaches(f, hard_edge, 0);
}

/* Normals that agree stay as they are, to the bit; so do those that cancel. */
FIXTURE_TEST(test_directions_keep_smooth_and_opposite_normals)
{
    const double centre[3] = {0};
    write_sphere(f->file, centre, 12, 7);
    load(f);
    assert_memory_equal(f->mesh.directions, f->mesh.normals,
                        f->mesh.triangle_count * sizeof *f->mesh.normals);
    bake_lowmesh_free(f->ctx, &f->mesh);
    bsq_forget_files(f->ctx);
    assert_non_null(f->file = fopen("low.obj", "w"));
    load_text(f, "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nvn 0 0 1\nvn 0 0 -1\n"
                 "f 1/1/1 2/2/1 3/3/1\nf 1/1/2 3/3/2 2/2/2\n");
    assert_vector(f->mesh.directions[0][0], 0, 0, 1);
    assert_vector(f->mesh.directions[1][0], 0, 0, -1);
}

/* Loads the hard edge with a cage of this text. */
static int load_with_cage(struct fixture *f, const char *text)
{
    test_text("cage.obj", text);
    bsq_forget_files(f->ctx);
    assert_non_null(f->file = freopen("low.obj", "w", f->file));
    fputs(hard_edge, f->file);
    fflush(f->file);
    f->options.mesh_path = "low.obj";
    f->options.cage_path = "cage.obj";
    int status = bake_lowmesh_load(f->ctx, &f->options, &f->mesh);
    return status;
}

#define CAGE_VERTICES "v 0 0 2\nv 2 0 2\nv 2 1 2\nv 0 1 2\nv 2 0 2\nv 4 0 0\nv 2 1 0\nv 2 1 2\n"
#define CAGE_FACES    "f 1 2 3\nf 1 3 4\nf 5 6 8\n"

FIXTURE_TEST(test_cage)
{
    assert_int_equal(load_with_cage(f, CAGE_VERTICES CAGE_FACES "f 6 7 8\n"), 0);
    assert_vector(f->mesh.directions[0][0], 0, 0, 1);
    assert_vector(f->mesh.directions[0][1], 1, 0, 1);
    assert_vector(f->mesh.directions[2][1], 3, 0, 0);
    assert_true(f->mesh.cage_distance == 3);
    assert_int_equal(fclose(f->file), 0);
}

FIXTURE_TEST(test_cages_of_other_meshes)
{
    assert_int_equal(load_with_cage(f, CAGE_VERTICES "f 1 2 3\nf 1 4 3\nf 5 6 8\nf 6 7 8\n"),
                     BSQ_EDATA);
    assert_non_null(strstr(bsq_error(f->ctx), "cage.obj:10: face has other vertices than the same "
                                              "face of the low-poly mesh"));
    bsq_clear_error(f->ctx);
    assert_int_equal(load_with_cage(f, CAGE_VERTICES CAGE_FACES), BSQ_EDATA);
    assert_non_null(strstr(bsq_error(f->ctx), "8 vertices and 4 faces, not 8 and 3"));
    assert_int_equal(fclose(f->file), 0);
}

FIXTURE_TEST(test_no_texture_coordinates)
{
    fail_text(f, "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
              ": no texture coordinates: the low-poly mesh has to be unwrapped");
}

FIXTURE_TEST(test_a_face_without_texture_coordinates)
{
    fail_text(f,
              "# comment\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\n"
              "f 1/1 2/2 3/3 4/3\n\nf 1/1 2/2 3\nf 1 2 3\n",
              ":11: face has no texture coordinates");
}

FIXTURE_TEST(test_missing_file)
{
    fclose(f->file);
    assert_int_equal(load_file(f, "/nonexistent/low.obj"), BSQ_ENOINPUT);
    assert_null(f->mesh.positions);
}

/* They used to become infinite. */
FIXTURE_TEST(test_texture_coordinates_beyond_float_are_the_largest_float)
{
    load_text(f, "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 6e38 -1e300\nvt .5 .5\nvt -1 2\nf 1/1 2/2 3/3\n");
    assert_true(f->mesh.texcoords[0][0][0] == FLT_MAX);
    assert_true(f->mesh.texcoords[0][0][1] == -FLT_MAX);
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 4; k++)
            assert_true(isfinite(f->mesh.tangents[0][i][k]));
}

RUN_TESTS(NULL, NULL)
