/* test_ply.c - the PLY reader on every kind of element and property, in all three encodings. */
#include "tests/unit/formats/mesh/obj_fixture.h"
#include "tests/unit/formats/mesh/ply_builder.h"
#include "tests/unit/test.h"

#define XYZ   "property float x\nproperty float y\nproperty float z\n"
#define FACES "property list uchar int vertex_indices\n"

/* Reads the built file and frees it. Fails the test if that fails. */
static void read_built(struct obj_fixture *f, struct ply_builder *b, const char *name)
{
    const char *path = test_bytes(name, b->bytes, b->size);
    obj_read_files(f, 2, 1, &path);
    if (f->status)
        print_message("%s\n", bsq_error(f->ctx));
    assert_int_equal(f->status, 0);
    ply_free(b);
}

/* Appends vertices (i, 2 i, -i). */
static void put_vertices(struct ply_builder *b, int count)
{
    for (int i = 0; i < count; i++) {
        ply_put(b, "fff", (double)i, 2.0 * i, -1.0 * i);
        ply_end(b);
    }
}

/* ---- vertices ---- */

TEST(test_vertex_properties)
{
    for (int encoding = 0; encoding < PLY_TEST_ENCODINGS; encoding++) {
        struct obj_fixture f;
        struct ply_builder b;
        ply_begin(&b, (enum ply_test_encoding)encoding,
                  "comment made by hand\nobj_info x\nelement vertex 3\n"
                  "property uchar red\nproperty double x\nproperty double y\nproperty double z\n"
                  "property float quality\nproperty uchar green\nproperty uchar blue\n"
                  "property uchar alpha\nproperty float nx\nproperty float ny\nproperty float nz\n"
                  "property float s\nproperty double t\n"
                  "element face 1\n" FACES);
        for (int i = 0; i < 3; i++) {
            ply_put(&b, "Cdddf", 10.0 * i, 4e6 + i + 0.1, -i - 0.25, 1e-3, 7.0);
            ply_put(&b, "CCCffffd", 1.0 + i, 255.0, 128.0, 0.0, 0.0, 2.0, 0.5, 0.1 * i);
            ply_end(&b);
        }
        ply_put(&b, "Ciii", 3.0, 0.0, 1.0, 2.0);
        ply_end(&b);
        read_built(&f, &b, "scan.ply");
        assert_int_equal(f.scan.totals.vertices, 3);
        for (int i = 0; i < 3; i++) {
            const double p[3] = {4e6 + i + 0.1, -i - 0.25, 1e-3}, uv[2] = {0.5, 0.1 * i};
            const float c[3] = {10.0f * (float)i, 1.0f + (float)i, 255}, n[3] = {0, 0, 2};
            assert_memory_equal(f.scan.positions[i], p, sizeof p);
            assert_memory_equal(f.scan.colors[i], c, sizeof c);
            assert_memory_equal(f.scan.normals[i], n, sizeof n);
            assert_memory_equal(f.scan.texcoords[i], uv, sizeof uv);
        }
        for (int kind = 0; kind < 3; kind++)
            obj_assert_corners(&f, kind, 3, 0, 1, 2);
        obj_close(&f);
    }
}

/* Colours of one vertex in a type; the largest and smallest values of what the reader gives. */
static void check_colors(const char *type, const char *letters, double high, float expected)
{
    for (int encoding = 0; encoding < PLY_TEST_ENCODINGS; encoding++) {
        struct obj_fixture f;
        struct ply_builder b;
        char header[300];
        snprintf(header, sizeof header,
                 "element vertex 1\n" XYZ "property %s diffuse_red\nproperty %s diffuse_green\n"
                 "property %s diffuse_blue\nelement face 1\n" FACES,
                 type, type, type);
        ply_begin(&b, (enum ply_test_encoding)encoding, header);
        ply_put(&b, "fff", 1.0, 2.0, 3.0);
        ply_put(&b, letters, high, 0.0, high);
        ply_end(&b);
        ply_put(&b, "Ciii", 3.0, 0.0, 0.0, 0.0);
        ply_end(&b);
        read_built(&f, &b, "scan.ply");
        assert_float_equal(f.scan.colors[0][0], expected, 1e-6);
        assert_float_equal(f.scan.colors[0][1], 0, 0);
        assert_float_equal(f.scan.colors[0][2], expected, 1e-6);
        obj_close(&f);
    }
}

TEST(test_color_types)
{
    check_colors("uchar", "CCC", 255, 255);
    check_colors("uint8", "CCC", 254, 254);
    check_colors("ushort", "SSS", 65535, 255);
    check_colors("uint16", "SSS", 257, 1);
    check_colors("float", "fff", 0.75, 0.75f);
    check_colors("double", "ddd", 1, 1);
    check_colors("int", "iii", 200, 200);
}

/* ---- faces ---- */

/* Indices of each integer type, and polygons. */
TEST(test_index_types)
{
    static const struct {
        const char *header, *letters;
    } types[] = {{"property list char char vertex_index\n", "cccc"},
                 {"property list uchar uchar vertex_indices\n", "CCCC"},
                 {"property list short short vertex_index\n", "ssss"},
                 {"property list ushort ushort vertex_indices\n", "SSSS"},
                 {"property list int int vertex_index\n", "iiii"},
                 {"property list uint uint vertex_indices\n", "IIII"},
                 {"property list uint8 int32 vertex_indices\n", "Ciii"},
                 {"property list long long vertex_index\n", "llll"},
                 {"property list ulong uint64 vertex_indices\n", "LLLL"}};
    for (int encoding = 0; encoding < PLY_TEST_ENCODINGS; encoding++)
        for (size_t i = 0; i < sizeof types / sizeof *types; i++) {
            struct obj_fixture f;
            struct ply_builder b;
            char header[300];
            const char list[] = {types[i].letters[0], 0}, item[] = {types[i].letters[1], 0};
            snprintf(header, sizeof header, "element vertex 5\n" XYZ "element face 4\n%s",
                     types[i].header);
            ply_begin(&b, (enum ply_test_encoding)encoding, header);
            put_vertices(&b, 5);
            ply_put(&b, types[i].letters, 3.0, 0.0, 1.0, 2.0);
            ply_end(&b);
            ply_put(&b, list, 5.0);
            for (int k = 0; k < 5; k++)
                ply_put(&b, item, 4.0 - k);
            ply_end(&b);
            ply_put(&b, list, 2.0); /* a face of two corners is none */
            ply_put(&b, item, 1.0);
            ply_put(&b, item, 1.0);
            ply_end(&b);
            ply_put(&b, types[i].letters, 3.0, 4.0, 3.0, 0.0);
            ply_end(&b);
            read_built(&f, &b, "scan.ply");
            assert_int_equal(f.scan.totals.faces, 3);
            assert_int_equal(f.scan.totals.short_faces, 1);
            obj_assert_corners(&f, 0, 11, 0, 1, 2, 4, 3, 2, 1, 0, 4, 3, 0);
            obj_assert_corners(&f, 1, 11, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1);
            obj_close(&f);
        }
}

/* Texture coordinates of corners, with textures by number. */
TEST(test_corner_texcoords)
{
    for (int encoding = 0; encoding < PLY_TEST_ENCODINGS; encoding++) {
        struct obj_fixture f;
        struct ply_builder b;
        struct fmt_materials materials;
        ply_begin(&b, (enum ply_test_encoding)encoding,
                  "comment TextureFile skin one.png\ncomment TextureFile two.jpg\n"
                  "element vertex 4\n" XYZ "element face 4\n" FACES
                  "property list uchar float texcoord\nproperty int texnumber\n");
        put_vertices(&b, 4);
        ply_put(&b, "CiiiCffffffi", 3.0, 0.0, 1.0, 2.0, 6.0, 0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 1.0);
        ply_end(&b);
        ply_put(&b, "CiiiCi", 3.0, 0.0, 1.0, 2.0, 0.0, -1.0); /* has none */
        ply_end(&b);
        ply_put(&b, "CiiiCffi", 3.0, 0.0, 1.0, 2.0, 2.0, 9.0, 9.0, 0.0); /* too few */
        ply_end(&b);
        ply_put(&b, "CiiiiCffffffffi", 4.0, 0.0, 1.0, 2.0, 3.0, 8.0, 2.0, 2.0, 3.0, 3.0, 4.0, 4.0,
                5.0, 5.0, 0.0);
        ply_end(&b);
        read_built(&f, &b, "scan.ply");
        assert_int_equal(f.scan.totals.texcoords, 7);
        obj_assert_corners(&f, 1, 13, 0, 1, 2, -1, -1, -1, -1, -1, -1, 3, 4, 5, 6);
        const double uv[7][2] = {{0, 0.25}, {0.5, 0.75}, {1, 1.25}, {2, 2}, {3, 3}, {4, 4}, {5, 5}};
        assert_memory_equal(f.scan.texcoords, uv, sizeof uv);
        const uint32_t numbers[4] = {1, FMT_MESH_NO_MATERIAL, 0, 0};
        assert_memory_equal(f.scan.materials, numbers, sizeof numbers);
        obj_assert_material(&f, 0, "skin one.png");
        assert_int_equal(fmt_mesh_read_materials(f.reader, &materials), 0);
        assert_int_equal(materials.count, 2);
        assert_non_null(strstr(materials.list[1].color.texture_path, "two.jpg"));
        fmt_materials_free(f.ctx, &materials);
        obj_close(&f);
    }
}

/* Colours of faces are materials, in order of appearance. */
TEST(test_face_colors)
{
    static const double colors[5][3] = {
        {255, 0, 0}, {255, 0, 0}, {0, 0, 255}, {255, 0, 0}, {1, 2, 3}};
    for (int encoding = 0; encoding < PLY_TEST_ENCODINGS; encoding++) {
        struct obj_fixture f;
        struct ply_builder b;
        ply_begin(&b, (enum ply_test_encoding)encoding,
                  "element vertex 3\n" XYZ "element face 5\nproperty uchar red\n" FACES
                  "property uchar green\nproperty uchar blue\nproperty uchar alpha\n");
        put_vertices(&b, 3);
        for (int i = 0; i < 5; i++) {
            ply_put(&b, "CCiiiCCC", colors[i][0], 3.0, 0.0, 1.0, 2.0, colors[i][1], colors[i][2],
                    255.0);
            ply_end(&b);
        }
        read_built(&f, &b, "scan.ply");
        const uint32_t numbers[5] = {0, 0, 1, 0, 2};
        assert_memory_equal(f.scan.materials, numbers, sizeof numbers);
        assert_int_equal(f.scan.totals.materials, 3);
        obj_assert_material(&f, 0, "#ff0000");
        obj_assert_material(&f, 2, "#010203");
        assert_int_equal(fmt_mesh_read(f.reader, NULL, NULL, NULL), 0); /* the same numbers */
        obj_assert_material(&f, 1, "#0000ff");
        obj_close(&f);
    }
}

/* Vertices and corners both with texture coordinates: those of corners count. */
TEST(test_texcoords_of_vertices_and_corners)
{
    for (int encoding = 0; encoding < PLY_TEST_ENCODINGS; encoding++) {
        struct obj_fixture f;
        struct ply_builder b;
        ply_begin(&b, (enum ply_test_encoding)encoding,
                  "element vertex 3\n" XYZ "property float s\nproperty float t\n"
                  "element face 1\n" FACES "property list uchar float texcoord\n");
        for (int i = 0; i < 3; i++) {
            ply_put(&b, "fffff", (double)i, 2.0 * i, 0.0, 0.75, 0.75);
            ply_end(&b);
        }
        ply_put(&b, "CiiiCffffff", 3.0, 0.0, 1.0, 2.0, 6.0, 0.0, 0.0, 0.5, 0.0, 0.0, 0.5);
        ply_end(&b);
        read_built(&f, &b, "both.ply");
        const double uv[3][2] = {{0, 0}, {0.5, 0}, {0, 0.5}};
        assert_int_equal(f.scan.totals.texcoords, 3);
        assert_memory_equal(f.scan.texcoords, uv, sizeof uv);
        obj_assert_corners(&f, 1, 3, 0, 1, 2);
        obj_close(&f);
    }
}

/* Blank lines between elements take no memory, however many they are. */
TEST(test_blank_lines)
{
    enum { BLANK_LINES = 4 << 20 };
    static const char start[] = "ply\nformat ascii 1.0\nelement vertex 3\n" XYZ
                                "element face 1\nproperty list uchar int vertex_indices\n"
                                "end_header\n0 0 0\n1 0 0\n";
    struct obj_fixture f;
    char *text = malloc(BLANK_LINES + 1000);
    assert_non_null(text);
    size_t size = (size_t)sprintf(text, "%s", start);
    memset(text + size, '\n', BLANK_LINES / 2);
    memset(text + size + BLANK_LINES / 2, ' ', BLANK_LINES / 2);
    size += BLANK_LINES;
    size += (size_t)sprintf(text + size, "0 1 0\n\n3 0 1 2\n");
    const char *path = test_bytes("blank.ply", text, size);
    obj_read_files(&f, 2, 1, &path);
    assert_int_equal(f.status, 0);
    assert_int_equal(f.scan.totals.vertices, 3);
    assert_int_equal(f.scan.totals.bytes, size);
    obj_assert_corners(&f, 0, 3, 0, 1, 2);
    assert_int_equal(obj_line_of_face(&f, 0), 14 + BLANK_LINES / 2);
    assert_true(bsq_memory_high(f.ctx) < BLANK_LINES / 2);
    obj_close(&f);
    free(text);
}

/* ---- files ---- */

/* Unknown elements and lists are skipped; faces may come before vertices. */
TEST(test_order_and_unknown)
{
    for (int encoding = 0; encoding < PLY_TEST_ENCODINGS; encoding++) {
        struct obj_fixture f;
        struct ply_builder b;
        struct fmt_mesh_hints hints;
        ply_begin(&b, (enum ply_test_encoding)encoding,
                  "element camera 2\nproperty float view_px\nproperty short n\n"
                  "element face 2\nproperty list uchar float weights\n" FACES "property int flags\n"
                  "element none 5\nelement edge 1\nproperty list uchar int v\nproperty int a\n"
                  "element vertex 3\n" XYZ "property list uchar int neighbours\n"
                  "element last 1\nproperty uchar c\n");
        for (int i = 0; i < 2; i++, ply_end(&b))
            ply_put(&b, "fs", 1.5, -3.0);
        for (int i = 0; i < 2; i++, ply_end(&b))
            ply_put(&b, "CffCiiii", 2.0, 0.5, 0.5, 3.0, 0.0 + i, 1.0, 2.0 - i, 9.0);
        ply_put(&b, "Ciii", 2.0, 7.0, 8.0, 9.0);
        ply_end(&b);
        for (int i = 0; i < 3; i++, ply_end(&b))
            ply_put(&b, "fffCi", (double)i, 2.0, 3.0, 1.0, 5.0);
        ply_put(&b, "C", 1.0);
        ply_end(&b);
        read_built(&f, &b, "scan.ply");
        obj_assert_corners(&f, 0, 6, 0, 1, 2, 1, 1, 1);
        const double last[3] = {2, 2, 3};
        assert_memory_equal(f.scan.positions[2], last, sizeof last);
        assert_int_equal(fmt_mesh_look(f.reader, &hints), 0);
        assert_false(hints.faces_come_last);
        obj_close(&f);
    }
}

TEST(test_line_ends)
{
    static const char *const ends[] = {"\n", "\r\n", "\r"};
    static const char *const lines[] = {"ply",
                                        "format ascii 1.0",
                                        "element vertex 3",
                                        "property float x",
                                        "property float y",
                                        "property\tfloat  z ",
                                        "element face 1",
                                        "property list uchar int vertex_index",
                                        "end_header",
                                        "0 0 0",
                                        "\t1 0.5 1e2 ",
                                        "",
                                        "2 2 2",
                                        "  3 0 1 2",
                                        " "};
    for (int i = 0; i < 3; i++) {
        struct obj_fixture f;
        char text[400] = "";
        for (size_t k = 0; k < sizeof lines / sizeof *lines; k++) {
            strcat(text, lines[k]);
            strcat(text, ends[i]);
        }
        obj_read_text(&f, text);
        assert_int_equal(f.scan.totals.vertices, 3);
        assert_int_equal(f.scan.totals.bytes, strlen(text));
        obj_assert_corners(&f, 0, 3, 0, 1, 2);
        assert_int_equal(obj_line_of_face(&f, 0), 14);
        obj_close(&f);
    }
}

/* A binary body may begin with any byte, also with one that looks like a line end. Lines of the
 * header may end in "\r", while the body has a "\n". */
TEST(test_body_that_begins_with_a_line_end)
{
    for (int old = 0; old < 2; old++) {
        struct obj_fixture f;
        struct ply_builder b;
        ply_begin(
            &b, PLY_TEST_LITTLE,
            "element vertex 1\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n" XYZ
            "element face 1\n" FACES);
        ply_put(&b, "CCCfffCiii", 10.0, 13.0, 10.0, 1.0, 2.0, 3.0, 3.0, 0.0, 0.0, 0.0);
        for (uint64_t i = 0; i < b.header_size; i++)
            b.bytes[i] = old && b.bytes[i] == '\n' ? '\r' : b.bytes[i];
        read_built(&f, &b, "scan.ply");
        const float color[3] = {10, 13, 10};
        assert_memory_equal(f.scan.colors[0], color, sizeof color);
        obj_close(&f);
    }
}

RUN_TESTS(NULL, NULL)
