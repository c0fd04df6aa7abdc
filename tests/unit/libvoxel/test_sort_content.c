/* Tests how sorting handles polygons, colours, positions far from zero, and materials. */
#include "sort_fixture.h"
#include "tests/unit/test.h"

#define FIXTURE_TEST(name) STATE_TEST(name, struct sort_fixture, sort_set_up, sort_tear_down)

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

FIXTURE_TEST(colors_of_a_later_file_do_not_shift)
{
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

/* Also if the colours are in temporary files, of which only used ones are read. */
FIXTURE_TEST(colors_of_each_file_have_its_scale)
{
    const char *paths[2] = {"scan.obj", "more.obj"};
    test_text("scan.obj", "v 9 9 9 0 0 0\nv 8 9 9 1 1 1\nv 9 8 9 1 0 1\nv 8 8 9 0 0 1\n"
                          "v 0 0 0 1 0 0\nv 1 0 0 0.2 0 0\nv 0 1 0 1.5 0 0.6\nf 5 6 7\n");
    test_text("more.obj", "v 5 0 0 1 0 0\nv 6 0 0 51 0 0.4\nv 5 1 0 300 0 153\nf 1 2 3\n");
    for (int in_files = 0; in_files < 2; in_files++) {
        struct sorted_triangles got = {0};
        struct sort_limits limits;
        struct vox_sort_options options = sort_scan_obj();
        options.scan_paths = paths;
        options.scan_count = 2;
        vox_sort_limits_for(128 * MIB, 2, &limits);
        limits.stream_bytes = in_files ? 0 : limits.stream_bytes;
        bsq_forget_files(f->ctx);
        expect_sorted(f, vox_sort_with_limits(f->ctx, &options, &limits, &f->report));
        assert_string_equal(f->warning,
                            "scan.obj: colours out of range were clamped at 2 vertices");
        read_sorted(f, &got, NULL);
        assert_int_equal(color_at(&got, 0, 0), 0xff0000ffu);
        assert_int_equal(color_at(&got, 1, 0), 0xff000033u);
        assert_int_equal(color_at(&got, 0, 1), 0xff9900ffu);
        assert_int_equal(color_at(&got, 5, 0), 0xff000001u);
        assert_int_equal(color_at(&got, 6, 0), 0xff000033u);
        assert_int_equal(color_at(&got, 5, 1), 0xff9900ffu);
        free(got.list);
    }
}

/* ---- places far from zero ---- */

FIXTURE_TEST(ordinary_scans_have_no_origin)
{
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
    struct sorted_triangles got = {0};
    struct fmt_tris_header header;
    struct fmt_tris_file *file;
    sort_write_image();
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

/* A face of two corners is skipped, and its normals do not count, in one pass and in two. */
FIXTURE_TEST(normals_of_faces_left_out_do_not_count)
{
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
