/* test_lenient.c - what mesh files have without meaning: numbers that are not finite, attributes
 * that do not exist, names in other spellings. It is missing, and a warning names the first place.
 */
#include "formats/mesh/mesh_text.h"
#include "formats/mesh/obj_number.h"
#include "tests/unit/test.h"
#include "tests/unit/formats/mesh/obj_fixture.h"
#include "tests/unit/formats/mesh/ply_builder.h"

/* ---- words ---- */

TEST(test_words)
{
    static const char *const words[] = {
        "nan",     "NaN",         "-nan(ind)", "+NAN(0x7f)", "inf",      "-Infinity", "1.#IND",
        "-1.#IND", "1.#QNAN0000", "1.#INF",    "1e999",      "-1.5e400", ".5e+309",   "1.#J"};
    static const char *const others[] = {"nano",  "in",    "-",  "",    "1",      "-1.5e3",
                                         "x",     "--nan", "#",  ".#Q", "1e999x", "1e",
                                         "infin", "1,0",   "+.", "."};
    for (size_t i = 0; i < sizeof words / sizeof *words; i++) {
        char text[128] = "";
        snprintf(text, sizeof text, "%s \n", words[i]);
        assert_ptr_equal(fmt_obj_not_finite(text), text + strlen(words[i]));
    }
    for (size_t i = 0; i < sizeof others / sizeof *others; i++) {
        char text[128] = "";
        snprintf(text, sizeof text, "%s \n", others[i]);
        assert_null(fmt_obj_not_finite(text));
    }
}

/* ---- OBJ ---- */

TEST(test_numbers)
{
    struct obj_fixture f;
    obj_read_text(&f,
                  "v 1 2\nv 1 2 # c\nv 1 2 3 4 5\nv nan 2 3 1 1 1\nv 1 2 -inf\nv 1 2 3 0 nan 1\n"
                  "v 1 2 3 1 1 1 nan\nvt nan 1\nvt 1 1e999\nvt 1 2 nan\nvt\nvn 1 2\nvn 1 2 nan\n"
                  "vn 1 2 3 4\nvn 1 2 3 nan\n");
    const double positions[7][2] = {{2, 0}, {2, 0}, {2, 3}, {NAN, NAN}, {NAN, NAN}, {2, 3}, {2, 3}};
    assert_int_equal(f.scan.totals.vertices, 7);
    for (int i = 0; i < 7; i++)
        for (int c = 0; c < 2; c++)
            assert_true(f.scan.positions[i][1 + c] == positions[i][c] ||
                        (isnan(positions[i][c]) && isnan(f.scan.positions[i][1 + c])));
    assert_true(isnan(f.scan.positions[3][0]) && isnan(f.scan.positions[4][0]));
    assert_true(f.scan.colors[5][0] == -1 && f.scan.colors[6][0] == 1);
    assert_int_equal(f.scan.totals.texcoords, 4);
    for (int i = 0; i < 4; i++)
        assert_true(i == 2 ? f.scan.texcoords[i][1] == 2 : isnan(f.scan.texcoords[i][0]));
    const float normals[4][3] = {{0, 0, 0}, {0, 0, 0}, {1, 2, 3}, {1, 2, 3}};
    assert_memory_equal(f.scan.normals, normals, sizeof normals);
    obj_close(&f);
    mesh_expect_warnings(
        "scan.obj", 2,
        "scan.obj:4: vertices without a finite position: 2; this is the first\n"
        "scan.obj:8: texture coordinates without finite numbers: 3; this is the first\n"
        "scan.obj:12: normals without three finite numbers: 2; this is the first\n"
        "scan.obj:6: vertices with a colour that is not finite: 1; this is the first\n"
        "scan.obj:1: vertices of 2 or 5 numbers, read as x y 0 or x y z: 3; this is the "
        "first\n");
}

/* The first line counts from the start of the file, whatever thread parses its batch. */
TEST(test_first_line_in_a_late_batch)
{
    enum { LINES = 200000 };
    char *text = malloc(LINES * 10 + 1), *to = text;
    for (int i = 0; i < LINES; i++)
        to += sprintf(to, i == 150000 || i == 190000 ? "v 1 n\x61n 3\n" : "v 1 2 %d\n", i % 10);
    const char *path = test_text("late.obj", text);
    for (unsigned threads = 1; threads < 5; threads++)
        mesh_expect_warnings(path, threads,
                             "late.obj:150001: vertices without a finite position: 2; this is the "
                             "first\n");
    free(text);
}

/* Indices of attributes before the first one are kept apart from all others. */
TEST(test_attributes_before_the_first)
{
    struct obj_fixture f;
    obj_read_text(&f, "v 0 0 0\nvt 0 0\nvn 0 0 1\nf 1/0/-2 1/-2/1 1/1/0\n");
    for (int i = 0; i < 3; i++) {
        assert_true(i == 2 ? f.scan.corners[1][i] == 0 : f.scan.corners[1][i] == FMT_MESH_BEFORE);
        assert_true(i == 1 ? f.scan.corners[2][i] == 0 : f.scan.corners[2][i] == FMT_MESH_BEFORE);
    }
    obj_close(&f);
}

/* Files may be named with quotes and other capitals. Names of materials are exact. */
TEST(test_names_of_files)
{
    struct obj_fixture f;
    struct fmt_materials m;
    test_text("My Lib.mtl",
              "newmtl Wood\nKd 1 0 0\nmap_Kd \"Tex A.png\"\nnewmtl wall #2\nKd 0 1 0\n");
    test_text("tex a.PNG", "an image");
    obj_read_text(&f, "mtllib \"my lib.mtl\"\nv 0 0 0\nusemtl Wood\nf 1 1 1\n"
                      "usemtl wall #2\nf 1 1 1\nusemtl wood\nf 1 1 1\n");
    assert_int_equal(fmt_mesh_read_materials(f.reader, &m), 0);
    const float expected[3][3] = {{1, 0, 0}, {0, 1, 0}, {0.8f, 0.8f, 0.8f}};
    assert_int_equal(m.count, 3);
    for (int i = 0; i < 3; i++)
        assert_memory_equal(m.list[i].color.value, expected[i], sizeof expected[i]);
    assert_string_equal(m.list[0].color.texture_path, "tex a.PNG");
    assert_false(m.list[2].color.has_value);
    fmt_materials_free(f.ctx, &m);
    obj_close(&f);
}

/* Names are output without comments and quotes. */
TEST(test_tidy_names)
{
    static const char *const cases[][2] = {
        {"", ""},           {"a", "a"},         {"a # x", "a"},         {"a\t#", "a"},
        {"a #x", "a #x"},   {"a# x", "a# x"},   {"wall #3", "wall #3"}, {"# 5", "# 5"},
        {"\"a b\"", "a b"}, {"\"a\" # x", "a"}, {"\"a\" b", "\"a\" b"}, {"\"", "\""},
        {"\"\"", ""},       {"\"a # x", "\"a"}, {"a  #\t# y", "a"}};
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        char text[20];
        strcpy(text, cases[i][0]);
        fmt_mesh_tidy_name(text);
        assert_string_equal(text, cases[i][1]);
    }
    struct obj_fixture f;
    obj_read_text(&f, "v 0 0 0\nusemtl m\nf 1 1 1\nusemtl \"m\" # left\nf 1 1 1\n");
    obj_assert_material(&f, 0, "m");
    obj_assert_material(&f, 1, "m");
    obj_close(&f);
}

/* A library whose name has blanks is one name in messages. */
TEST(test_missing_libraries)
{
    struct obj_fixture f;
    struct fmt_materials materials;
    obj_read_text(&f, "mtllib no such lib.mtl # c\nv 0 0 0\nusemtl m\nf 1 1 1\n");
    bsq_set_strict(f.ctx, true);
    assert_int_equal(fmt_mesh_read_materials(f.reader, &materials), BSQ_EDATA);
    assert_non_null(strstr(bsq_error(f.ctx), ":1: no such lib.mtl: No such file"));
    obj_close(&f);
}

/* A backslash at the end of a name does not continue the line: no face may get lost. */
TEST(test_names_that_end_in_a_backslash)
{
    static const char *const statements[] = {
        "usemtl C:\\m\\", "usemtl C:\\m\\\r", "o C:\\a\\",       "g\\",
        "mtllib C:\\",    "call C:\\b\\",     "unknown C:\\c\\", "usemtl\\"};
    for (size_t i = 0; i < sizeof statements / sizeof *statements; i++)
        for (int more = 0; more < 2; more++) {
            char text[200];
            struct obj_fixture f;
            snprintf(text, sizeof text, "v 0 0 0\n%s\nf 1 1 1\nf 1 \\\n1 1\n", statements[i]);
            if (more)
                strcat(text, "usemtl \\\n a \\\nb\nl 1\\\n1\nf 1 1 1\n");
            obj_read_text(&f, text);
            assert_int_equal(f.scan.totals.faces, 2 + more);
            if (i < 2)
                obj_assert_material(&f, 0, "C:\\m\\");
            assert_int_equal(obj_line_of_face(&f, 0), 3);
            obj_close(&f);
        }
}

/* ---- PLY and STL ---- */

TEST(test_ply)
{
    for (int encoding = 0; encoding < PLY_TEST_ENCODINGS; encoding++) {
        struct ply_builder b;
        struct obj_fixture f;
        ply_begin(&b, encoding,
                  "element vertex 4\nproperty float x\nproperty float y\nproperty double z\n"
                  "property float s\nproperty float t\n"
                  "element face 1\nproperty list uchar int vertex_indices\n");
        for (int i = 0; i < 4; i++) {
            ply_put(&b, "ffdff", 0.0, 1.0, i == 2 ? NAN : i, 0.5, i == 1 ? INFINITY : 0.0);
            ply_end(&b);
        }
        ply_put(&b, "Ciii", 3.0, 0.0, 1.0, 3.0);
        ply_end(&b);
        const char *path = test_bytes("odd.ply", b.bytes, b.size);
        obj_read_files(&f, 2, 1, &path);
        assert_int_equal(f.status, 0);
        for (int i = 0; i < 4; i++) {
            assert_int_equal(isnan(f.scan.positions[i][0]), i == 2);
            assert_int_equal(isnan(f.scan.texcoords[i][0]), i == 1);
        }
        obj_close(&f);
        mesh_expect_warnings(
            path, 2,
            "odd.ply: 1 positions are not finite or incomplete and were left out\n"
            "odd.ply: 1 texture coordinates are not finite or incomplete and were left "
            "out\n");
        ply_free(&b);
    }
}

TEST(test_stl)
{
    char binary[84 + 2 * 50] = "a scan";
    const float corners[2][3][3] = {{{0, 0, 0}, {1, 0, NAN}, {0, 1, 0}},
                                    {{0, 0, 0}, {INFINITY, 0, 1}, {1, 1, 1}}};
    binary[80] = 2;
    for (int i = 0; i < 2; i++)
        memcpy(binary + 84 + 50 * i + 12, corners[i], sizeof corners[i]);
    const char *paths[2] = {
        test_bytes("odd.stl", binary, sizeof binary),
        test_text("text.stl", "solid\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\n"
                              "vertex 1 nan 0\nvertex 0 1 0\nendloop\nendfacet\nfacet\nouter loop\n"
                              "vertex 0 0 0\nvertex 1.#IND 0 0\nvertex 1 1 1\nendloop\nendfacet\n"
                              "endsolid\n")};
    for (int i = 0; i < 2; i++) {
        struct obj_fixture f;
        obj_read_files(&f, 1, 1, &paths[i]);
        assert_int_equal(f.status, 0);
        assert_int_equal(f.scan.totals.faces, 2);
        for (int face = 0; face < 2; face++)
            assert_true(isnan(f.scan.positions[f.scan.corners[0][3 * face + 1]][0]));
        obj_close(&f);
    }
}

RUN_TESTS(NULL, NULL)
