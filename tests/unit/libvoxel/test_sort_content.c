/* Tests how sorting handles polygons, colours, positions far from zero, and materials. */
#include "sort_fixture.h"
#include "tests/unit/test.h"

#define FIXTURE_TEST(name) TEST_EACH(name, sort_set_up, sort_tear_down)

/* ---- polygons ---- */

static double total_area(const struct sorted_triangles *t)
{
    double area = 0;
    for (size_t i = 0; i < t->count; i++) {
        const struct sorted_corner *c = t->list[i].corners;
        double ux = (double)c[1].position[0] - c[0].position[0];
        double uy = (double)c[1].position[1] - c[0].position[1];
        double vx = (double)c[2].position[0] - c[0].position[0];
        double vy = (double)c[2].position[1] - c[0].position[1];
        double part = (ux * vy - uy * vx) / 2;
        assert_true(part > 0); /* no triangle is flipped */
        area += part;
    }
    return area;
}

FIXTURE_TEST(concave_polygons_keep_their_area)
{
    struct sort_fixture *f = *state;
    struct sorted_triangles got = {0};
    /* An L of area 3 and an arrow of area 1, between triangles. */
    expect_sorted(f, sort_text(f, "v 0 0 0\nv 2 0 0\nv 2 1 0\nv 1 1 0\nv 1 2 0\nv 0 2 0\n"
                                  "v 4 0 0\nv 6 0 0\nv 5 0.5 0\nv 5 2 0\n"
                                  "f 1 2 3\nf 1 2 3 4 5 6\nf 7 8 10\nf 7 9 8 10\n"));
    assert_int_equal(f->report.faces, 4);
    (void)got;
    read_sorted(f, &got, NULL);
    assert_int_equal(got.count + f->report.degenerate_triangles, 1 + 4 + 1 + 2);
    free(got.list);
}

/* One polygon fills a block of text. */
FIXTURE_TEST(a_polygon_of_any_size_is_split)
{
    struct sort_fixture *f = *state;
    struct sorted_triangles got = {0};
    const int n = 70000;
    FILE *file = fopen("scan.obj", "wb");
    for (int i = 0; i < n; i++)
        fprintf(file, "v %.7f %.7f 0\n", 10 * cos(2 * M_PI * i / n), 10 * sin(2 * M_PI * i / n));
    fputs("f 1 2 3\nf", file);
    for (int i = 0; i < n; i++)
        fprintf(file, " %d", i + 1);
    fputs("\nf 1 2 3\n", file);
    fclose(file);
    expect_sorted(f, sort_scan(f));
    assert_int_equal(f->report.triangles + f->report.degenerate_triangles, n - 2 + 2);
    read_sorted(f, &got, NULL);
    assert_true(fabs(total_area(&got) - M_PI * 100) < 1e-3);
    free(got.list);
}

/* ---- colours ---- */

static uint32_t color_at(const struct sorted_triangles *t, float x, float y)
{
    for (size_t i = 0; i < t->count; i++)
        for (int k = 0; k < 3; k++)
            if (t->list[i].corners[k].position[0] == x && t->list[i].corners[k].position[1] == y)
                return t->list[i].corners[k].color;
    fail_msg("no corner at %g %g", x, y);
    return 0;
}

FIXTURE_TEST(colors_are_of_zero_to_one_or_of_bytes)
{
    struct sort_fixture *f = *state;
    struct sorted_triangles got = {0};
    expect_sorted(f, sort_text(f, "v 0 0 0 0 0.5 1\nv 1 0 0 1 1 1\nv 0 1 0\nf 1 2 3\n"));
    read_sorted(f, &got, NULL);
    assert_int_equal(color_at(&got, 0, 0), 0xffff8000u);
    assert_int_equal(color_at(&got, 0, 1), 0xffffffffu); /* none given */
    assert_int_equal(f->warnings, 0);
    got.count = 0;
    expect_sorted(f, sort_text(f, "v 0 0 0 0 127 255\nv 1 0 0 1 300 3\nv 0 1 0 -5 0 0\nf 1 2 3\n"));
    read_sorted(f, &got, NULL);
    assert_int_equal(color_at(&got, 0, 0), 0xffff7f00u);
    assert_int_equal(color_at(&got, 1, 0), 0xff03ff01u);
    assert_int_equal(color_at(&got, 0, 1), 0xff000000u);
    assert_int_equal(f->warnings, 1);
    assert_non_null(strstr(f->warning, "2 vertices"));
    /* Values slightly above 1 are not taken for bytes. */
    got.count = 0;
    expect_sorted(f, sort_text(f, "v 0 0 0 0 0.5 1\nv 1 0 0 1 1.01 1\nv 0 1 0\nf 1 2 3\n"));
    read_sorted(f, &got, NULL);
    assert_int_equal(color_at(&got, 0, 0), 0xffff8000u);
    assert_int_equal(color_at(&got, 1, 0), 0xffffffffu);
    assert_int_equal(f->warnings, 2);
    assert_non_null(strstr(f->warning, "1 vertex"));
    free(got.list);
}

FIXTURE_TEST(colors_of_a_later_file_do_not_shift)
{
    struct sort_fixture *f = *state;
    const char *paths[2] = {"scan.obj", "more.obj"};
    struct sorted_triangles got = {0};
    test_text("scan.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
    test_text("more.obj", "v 5 0 0 1 0 0\nv 6 0 0 0 1 0\nv 5 1 0 0 0 1\nf 1 2 -1\n");
    expect_sorted(f, sort_files(f, paths, 2));
    assert_int_equal(f->report.triangles, 2);
    read_sorted(f, &got, NULL);
    assert_int_equal(color_at(&got, 0, 0), 0xffffffffu);
    assert_int_equal(color_at(&got, 5, 0), 0xff0000ffu);
    assert_int_equal(color_at(&got, 6, 0), 0xff00ff00u);
    assert_int_equal(color_at(&got, 5, 1), 0xffff0000u);
    free(got.list);
}

/* ---- places far from zero ---- */

FIXTURE_TEST(georeferenced_scans_keep_their_detail)
{
    struct sort_fixture *f = *state;
    struct sorted_triangles got = {0};
    struct fmt_tris_header header;
    static const double corners[3][3] = {{500000.123, 5400000.456, 112.001},
                                         {500000.124, 5400000.456, 112.002},
                                         {500001.123, 5400003.457, 113.003}};
    char text[512];
    int length = 0;
    for (int k = 0; k < 3; k++)
        length += snprintf(text + length, sizeof text - (size_t)length, "v %.3f %.3f %.3f\n",
                           corners[k][0], corners[k][1], corners[k][2]);
    snprintf(text + length, sizeof text - (size_t)length, "f 1 2 3\n");
    expect_sorted(f, sort_text(f, text));
    read_sorted(f, &got, &header);
    assert_int_equal(got.count, 1);
    for (int axis = 0; axis < 3; axis++) {
        assert_true(header.origin[axis] == f->report.origin[axis]);
        for (int k = 0; k < 3; k++) {
            double nearest = INFINITY;
            for (int j = 0; j < 3; j++)
                nearest = fmin(nearest, fabs(header.origin[axis] +
                                             (double)got.list[0].corners[j].position[axis] -
                                             corners[k][axis]));
            assert_true(nearest < 1e-5); /* the origin is 0 in z */
        }
    }
    assert_true(header.origin[0] == 500000.0); /* the scan's size is about 3 */
    assert_true(header.origin[2] == 0.0);
    free(got.list);
}

FIXTURE_TEST(ordinary_scans_have_no_origin)
{
    struct sort_fixture *f = *state;
    expect_sorted(f, sort_text(f, "v 9000 0 0\nv 9500 0 0\nv 9000 500 0\nf 1 2 3\n"));
    assert_true(f->report.origin[0] == 0.0); /* far from zero, but not for its size */
    expect_sorted(f, sort_text(f, "v 8000 0 0\nv 8001 0 0\nv 8000 1 0\nf 1 2 3\n"));
    assert_true(f->report.origin[0] == 0.0); /* near zero: may be a patch of a scan around it */
}

/* ---- materials ---- */

static void write_library(const char *text)
{
    test_text("scan.mtl", text);
}

static void write_texture(void)
{
    test_text("wall.png", "only its name matters here");
}

static const char materials_obj[] =
    "mtllib scan.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 5 0 0\nv 6 0 0\nv 5 1 0\n"
    "vt 0.25 0.75\nvt 0.5 0.5\n"
    "f 1 2 3\nusemtl wall\nf 1/1 2/2 3/1\nf 4 5 6\nusemtl red\nf 4/1 5/1 6/1\nf 4 5 6\n"
    "usemtl unknown\nf 1/1 2/1 3/1\n";

static unsigned count_material(const struct sorted_triangles *t, uint32_t material)
{
    unsigned count = 0;
    for (size_t i = 0; i < t->count; i++)
        count += t->list[i].material == material;
    return count;
}

FIXTURE_TEST(materials_come_from_the_library)
{
    struct sort_fixture *f = *state;
    struct sorted_triangles got = {0};
    struct fmt_tris_header header;
    struct fmt_tris_file *file;
    write_texture();
    write_library("newmtl red\nKd 1 0 0\nnewmtl wall\nKd 0.5 0.5 0.5\nmap_Kd wall.png\n"
                  "newmtl unused\nmap_Kd missing.png\n");
    expect_sorted(f, sort_text(f, materials_obj));
    assert_true(f->report.has_texcoords);
    read_sorted(f, &got, &header);
    assert_int_equal(header.attributes, FMT_TRIS_TEXCOORDS | FMT_TRIS_MATERIALS);
    assert_int_equal(header.material_count, 4);
    assert_int_equal(count_material(&got, 0), 1); /* wall with its texture */
    assert_int_equal(count_material(&got, 1), 1); /* wall without */
    assert_int_equal(count_material(&got, 2), 2); /* red */
    assert_int_equal(count_material(&got, 3), 2); /* before usemtl, and unknown */
    for (size_t i = 0; i < got.count; i++)
        if (got.list[i].material == 0)
            for (int k = 0; k < 3; k++) {
                const struct sorted_corner *c = &got.list[i].corners[k];
                assert_true(c->texcoord[0] == (c->position[0] == 1.0f ? 0.5f : 0.25f));
            }
    assert_int_equal(fmt_tris_open(f->ctx, "scan.tris", &file), 0);
    const struct fmt_tris_material *m = fmt_tris_get_header(file)->materials;
    assert_int_equal(m[0].texture_path[0], '/');
    assert_non_null(strstr(m[0].texture_path, "/wall.png"));
    assert_null(m[1].texture_path);
    assert_true(m[1].diffuse[0] == 0.5f);
    assert_true(m[2].diffuse[0] == 1.0f && m[2].diffuse[1] == 0.0f);
    assert_true(m[3].diffuse[0] == 1.0f && m[3].diffuse[1] == 1.0f); /* white */
    fmt_tris_close(file);
    free(got.list);
}

/* Scans often come without their images. Beside materials with colours, diffuse colours are kept.
 */
FIXTURE_TEST(a_missing_texture_leaves_the_diffuse_colour)
{
    struct sort_fixture *f = *state;
    struct sorted_triangles got = {0};
    struct fmt_tris_header header;
    write_library("newmtl wall\nKd 0.5 0.5 0.5\nmap_Kd gone.png\nnewmtl red\nKd 1 0 0\n");
    expect_sorted(f, sort_text(f, materials_obj));
    read_sorted(f, &got, &header);
    assert_int_equal(header.attributes, FMT_TRIS_MATERIALS);
    assert_int_equal(header.material_count, 3);
    assert_int_equal(count_material(&got, 0), 2);
    assert_int_equal(count_material(&got, 1), 2); /* red */
    assert_int_equal(count_material(&got, 2), 2); /* white */
    free(got.list);
}

/* The colour beside a texture that is missing is seldom that of the scan: without any other one,
 * the scan has none. */
FIXTURE_TEST(a_missing_texture_alone_leaves_no_colour)
{
    struct sort_fixture *f = *state;
    struct sorted_triangles got = {0};
    struct fmt_tris_header header;
    write_library("newmtl wall\nKd 0.5 0.5 0.5\nmap_Kd gone.png\n");
    expect_sorted(f, sort_text(f, materials_obj));
    read_sorted(f, &got, &header);
    assert_int_equal(header.attributes, 0);
    free(got.list);
}

FIXTURE_TEST(without_materials_texture_coordinates_go)
{
    struct sort_fixture *f = *state;
    struct fmt_tris_header header;
    expect_sorted(f, sort_text(f, "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1 2/1 3/1\n"));
    assert_false(f->report.has_texcoords);
    read_sorted(f, NULL, &header);
    assert_int_equal(header.attributes, 0);
}

FIXTURE_TEST(one_texture_can_be_given_for_all)
{
    struct sort_fixture *f = *state;
    char texture[32] = "wall.png";
    struct sorted_triangles got = {0};
    struct vox_sort_options options = sort_scan_obj();
    options.texture_path = texture;
    write_texture();
    test_text("scan.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0.5 0\nf 1/1 2/1 3/1\nusemtl a\n"
                          "f 1/1 3/1 2/1\nf 1 2 3\nf 1/1 2/1 3\n");
    expect_sorted(f, vox_sort(f->ctx, &options, &f->report));
    read_sorted(f, &got, NULL);
    assert_int_equal(count_material(&got, 0), 2);
    assert_int_equal(count_material(&got, 1), 2); /* without texture coordinates: white */
    free(got.list);
    strcpy(texture, "/nowhere/at all.png");
    assert_int_equal(vox_sort(f->ctx, &options, &f->report), BSQ_ENOINPUT);
    assert_non_null(strstr(bsq_error(f->ctx), texture));
}

/* A face of two corners is skipped, and its normals do not count, in one pass and in two. */
FIXTURE_TEST(normals_of_faces_left_out_do_not_count)
{
    struct sort_fixture *f = *state;
    struct vox_sort_options options = sort_scan_obj();
    test_text("scan.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 1\nf 1//1 2//1\nf 1 2 3\n");
    for (int two = 0; two < 2; two++) {
        struct sort_limits limits;
        vox_sort_limits_for(64 * MIB, 1, &limits);
        limits.two_passes = two;
        expect_sorted(f, vox_sort_with_limits(f->ctx, &options, &limits, &f->report));
        assert_int_equal(f->report.short_faces, 1);
        assert_false(f->report.has_normals);
    }
}

RUN_TESTS(NULL, NULL)
