/* test_ply_damage.c - the PLY reader's messages for wrong files, and files cut at every length. */
#include "tests/unit/test.h"
#include "tests/unit/formats/mesh/obj_fixture.h"
#include "tests/unit/formats/mesh/ply_builder.h"

#define XYZ   "property float x\nproperty float y\nproperty float z\n"
#define FACES "property list uchar int vertex_indices\n"
#define TEXT  "ply\nformat ascii 1.0\n"
#define SMALL TEXT "element vertex 1\n" XYZ "element face 1\n" FACES "end_header\n"

TEST(test_headers)
{
    static const struct {
        const char *text, *message;
    } cases[] = {
        {"ply\n", "bad.ply:2: the header has no end"},
        {"ply\nformat ascii 1.0", "bad.ply:2: the header has no end"},
        {"ply\nformat text 1.0\n", "bad.ply:2: unknown format \"text\""},
        {"ply\nformat ascii 2.0\n", "bad.ply:2: unknown version \"2.0\""},
        {"ply\nelement vertex 3\nend_header\n", "bad.ply: the header has no format"},
        {TEXT "elephant\n", "bad.ply:3: unknown statement \"elephant\""},
        {TEXT "element vertex many\n", "bad.ply:3: not a number of elements: \"many\""},
        {TEXT "element vertex -1\n", "bad.ply:3: not a number of elements: \"-1\""},
        {TEXT "element vertex 18446744073709551616\n",
         "bad.ply:3: not a number of elements: \"18446744073709551616\""},
        {TEXT "property float x\n", "bad.ply:3: a property before any element: \"float\""},
        {TEXT "element vertex 1\nproperty half x\n", "bad.ply:4: unknown type \"half\""},
        {TEXT "element face 1\nproperty list float int v\n",
         "bad.ply:4: not a type of list lengths: \"float\""},
        {TEXT "element face 1\nproperty list uchar\n", "bad.ply:4: unknown type \"\""},
        {TEXT "comment \001\n", "bad.ply:3: a control character in the header"},
        {TEXT "end_header\n", "bad.ply: the header has no vertices with x, y and z"},
        {TEXT "element vertex 0\nproperty float x\nproperty float y\nend_header\n",
         "bad.ply: the header has no vertices with x, y and z"},
        {TEXT "element vertex 1\n" XYZ "element vertex 1\n" XYZ "end_header\n0 0 0\n0 0 0\n",
         "bad.ply: the header has two elements \"vertex\""},
        {TEXT "element vertex 1\n" XYZ "end_header\n0 0 0\n",
         "bad.ply: a point cloud of 1 points without faces; make a mesh of it"},
        {TEXT "element vertex 1\n" XYZ "element face 0\n" FACES "end_header\n0 0 0\n",
         "bad.ply: a point cloud of 1 points without faces; make a mesh of it"},
        {TEXT "element vertex 1\n" XYZ "element face 1\nproperty list uchar float vertex_index\n"
              "end_header\n0 0 0\n3 0 0 0\n",
         "bad.ply: faces without a list \"vertex_indices\" of integers"},
        {TEXT "element vertex 1\n" XYZ "element tristrips 1\nproperty list int int vertex_indices\n"
              "end_header\n0 0 0\n3 0 0 0\n",
         "bad.ply: strips of triangles (\"tristrips\"), which are not read; save the mesh with "
         "faces, as MeshLab does"},
        {TEXT "element vertex 3\n" XYZ "element face 1\n" FACES "end_header\n0 0 0\n0 0 0\n",
         "bad.ply: truncated: the header counts 3 elements \"vertex\" of at least 6 bytes, but "
         "12 bytes are left"},
        {TEXT "element vertex 1\n" XYZ "element face 18446744073709551615\n" FACES
              "end_header\n0 0 0\n",
         "bad.ply: truncated: the header counts 18446744073709551615 elements \"face\" of at least "
         "2 bytes, but 0 bytes are left"},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++)
        ply_expect_error(cases[i].text, strlen(cases[i].text), cases[i].message);
}

TEST(test_text_elements)
{
    static const struct {
        const char *text, *message;
    } cases[] = {
        {SMALL "0 0 x\n3 0 0 0\n", "bad.ply:10: \"x\" is not a number"},
        {SMALL "\n0 0\n3 0 0 0\n",
         "bad.ply:11: the line ends before a number; each element must be a line"},
        {SMALL "0 0 nano\n3 0 0 0\n", "bad.ply:10: \"nano\" is not a number"},
        {SMALL "0 0 0 4\n3 0 0 0\n",
         "bad.ply:10: \"4\" is not expected: each element must be a line"},
        {SMALL "0 0 0\n\n", "bad.ply:12: truncated: the file ends after 0 of 1 elements \"face\""},
        {SMALL "0 0 0\n3 0 0    \n",
         "bad.ply:11: the line ends before an integer; each element must be a line"},
        {SMALL "0 0 0\n3 0 0", "bad.ply:11: a list of 3 numbers is longer than the text"},
        {SMALL "0 0 0\n3 0 0.5 0\n", "bad.ply:11: \"0.5\" is not an integer"},
        {SMALL "0 0 0\n3 0 0 -2\n", "bad.ply:11: face refers to vertex -2"},
        {SMALL "0 0 0\n-3 0 0 0\n", "bad.ply:11: a list of -3 numbers"},
        {SMALL "0 0 0\n9999999 0 0 0\n",
         "bad.ply:11: a list of 9999999 numbers is longer than the text"},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++)
        ply_expect_error(cases[i].text, strlen(cases[i].text), cases[i].message);
}

/* Ends a binary file that has 4 vertices with a face. */
static void expect_binary_error(const char *header, const char *letters, double a, double b,
                                double c, const char *message)
{
    struct ply_builder file;
    char text[200];
    ply_begin(&file, PLY_TEST_LITTLE, header);
    for (int i = 0; i < 4; i++)
        ply_put(&file, "fff", 0.0, 1.0, 0.0);
    ply_put(&file, letters, a, b, c);
    snprintf(text, sizeof text, message, (unsigned long long)file.header_size + 48,
             (unsigned long long)file.size);
    ply_expect_error(file.bytes, file.size, text);
    ply_free(&file);
}

TEST(test_binary)
{
    static const char header[] = "element vertex 4\n" XYZ "element face 1\n" FACES;
    static const char shorts[] =
        "element vertex 4\n" XYZ "element face 1\nproperty list char int vertex_index\n";
    expect_binary_error(
        header, "Cii", 3, 1, 2,
        "bad.ply: byte %2$llu: truncated: the file ends after 0 of 1 elements \"face\"");
    expect_binary_error(header, "Cii", 2, 1, -7, "bad.ply: byte %1$llu: face refers to vertex -7");
    expect_binary_error(shorts, "cii", -1, 1, 7, "bad.ply: byte %1$llu: a list of -1 numbers");
}

/* An index beyond the vertices, in each encoding: the reader finds the face again. */
TEST(test_index_out_of_range)
{
    for (int encoding = 0; encoding < PLY_TEST_ENCODINGS; encoding++) {
        struct obj_fixture f;
        struct ply_builder b;
        char message[160];
        ply_begin(&b, (enum ply_test_encoding)encoding,
                  "element vertex 3\n" XYZ "element face 3\n" FACES);
        for (int i = 0; i < 3; i++, ply_end(&b))
            ply_put(&b, "fff", 0.0, 0.0, 0.0);
        ply_put(&b, "Cii", 2.0, 0.0, 1.0);
        ply_end(&b);
        ply_put(&b, "Ciii", 3.0, 0.0, 1.0, 2.0);
        ply_end(&b);
        snprintf(message, sizeof message,
                 "%zu: face refers to vertex 3 (counted from 0), file has 3",
                 encoding == PLY_TEST_ASCII ? 15 : b.size);
        ply_put(&b, "Ciii", 3.0, 0.0, 1.0, 3.0);
        ply_end(&b);
        const char *path = test_bytes("bad.ply", b.bytes, b.size);
        struct fmt_mesh mesh;
        struct bsq_ctx *ctx = test_context(2, 64 << 20);
        assert_int_equal(fmt_mesh_load(ctx, path, false, &mesh), BSQ_EDATA);
        assert_string_equal(bsq_error(ctx) + strlen(path) + (encoding == PLY_TEST_ASCII ? 1 : 7),
                            message);
        test_context_end(ctx);
        obj_read_files(&f, 2, 1, &path);
        assert_int_equal(f.status, 0);
        obj_close(&f);
        ply_free(&b);
    }
}

/* Indices beyond 2^31 among plain triangles, signed and not. */
TEST(test_large_indices)
{
    for (int is_signed = 0; is_signed < 2; is_signed++) {
        struct obj_fixture f;
        struct ply_builder b;
        ply_begin(&b, PLY_TEST_LITTLE,
                  is_signed ? "element vertex 3\n" XYZ "element face 3\n" FACES
                            : "element vertex 3\n" XYZ
                              "element face 3\nproperty list uchar uint vertex_indices\n");
        for (int i = 0; i < 9; i++)
            ply_put(&b, "f", 0.0);
        ply_put(&b, "CiiiCIIICiii", 3.0, 0.0, 1.0, 2.0, 3.0, 0.0, is_signed ? -2.0 : 4294967294.0,
                2.0, 3.0, 2.0, 1.0, 0.0);
        const char *path = test_bytes("bad.ply", b.bytes, b.size);
        obj_read_files(&f, 1, 1, &path);
        if (is_signed) {
            assert_int_equal(f.status, BSQ_EDATA);
            assert_non_null(strstr(bsq_error(f.ctx), ": face refers to vertex -2"));
        } else {
            assert_int_equal(f.status, 0);
            assert_int_equal(f.scan.totals.faces, 3);
            assert_int_equal(f.scan.corners[0][4], 4294967294u);
            assert_int_equal(f.scan.corners[0][8], 0);
        }
        obj_close(&f);
        ply_free(&b);
    }
}

/* A file with everything, cut at each length: an error in one line, or the whole mesh. */
TEST(test_every_length)
{
    for (int encoding = 0; encoding < PLY_TEST_ENCODINGS; encoding++) {
        struct ply_builder b;
        ply_begin(&b, (enum ply_test_encoding)encoding,
                  "comment TextureFile a.png\nelement vertex 3\n" XYZ
                  "property uchar red\nproperty uchar green\nproperty uchar blue\n"
                  "element thing 2\nproperty list char short l\n"
                  "element face 2\n" FACES "property list uchar float texcoord\n");
        for (int i = 0; i < 3; i++, ply_end(&b))
            ply_put(&b, "fffCCC", 1.0, 2.0, 3.0, 4.0, 5.0, 6.0);
        for (int i = 0; i < 2; i++, ply_end(&b))
            ply_put(&b, "css", 2.0, 1.0, 2.0);
        for (int i = 0; i < 2; i++, ply_end(&b))
            ply_put(&b, "CiiiCffffff", 3.0, 0.0, 1.0, 2.0, 6.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0);
        /* Text may lack its last line end and digits; then it is whole but for them. */
        const size_t whole = encoding == PLY_TEST_ASCII ? b.size - 2 : b.size;
        for (size_t size = 0; size <= b.size; size++) {
            struct obj_fixture f;
            const char *path = test_bytes("cut.ply", b.bytes, size);
            obj_read_files(&f, 1, 1, &path);
            if (size < whole) {
                assert_int_equal(f.status, BSQ_EDATA);
                assert_null(strchr(bsq_error(f.ctx), '\n'));
            } else {
                assert_int_equal(f.status, 0);
                assert_int_equal(f.scan.totals.faces, 2);
                assert_int_equal(f.scan.totals.bytes, size);
            }
            obj_close(&f);
        }
        ply_free(&b);
    }
}

/* A header line may be long, but must fit the budget. */
TEST(test_long_header_line)
{
    static const char start[] = TEXT "comment ";
    static const char rest[] =
        "\nelement vertex 1\n" XYZ "element face 1\n" FACES "end_header\n0 0 0\n3 0 0 0\n";
    const size_t blanks = (size_t)40 << 20;
    char *text = malloc(sizeof start + blanks + sizeof rest);
    assert_non_null(text);
    memcpy(text, start, sizeof start - 1);
    memset(text + sizeof start - 1, 'x', blanks);
    memcpy(text + sizeof start - 1 + blanks, rest, sizeof rest - 1);
    const char *path = test_bytes("long.ply", text, sizeof start + blanks + sizeof rest - 2);
    struct bsq_ctx *ctx = test_context(1, (uint64_t)200 << 20);
    struct fmt_mesh mesh;
    assert_int_equal(fmt_mesh_load(ctx, path, false, &mesh), 0);
    fmt_mesh_free(ctx, &mesh);
    test_context_end(ctx);
    ctx = test_context(1, (uint64_t)32 << 20);
    assert_int_equal(fmt_mesh_load(ctx, path, false, &mesh), BSQ_ENOMEM);
    test_context_end(ctx);
    free(text);
}

/* What is not read is said once, also if the file is read twice. */
TEST(test_warnings)
{
    test_text("odd.ply", TEXT
              "element vertex 3\n" XYZ "property float quality\nproperty int flags\n"
              "property float nx\nproperty float ny\nproperty float nz\nelement face 1\n" FACES
              "property uchar weight\nelement camera 2\nproperty float a\nend_header\n"
              "0 0 0 1 2 0 0 1\n0 0 1 1 2 0 0 1e99\n0 1 0 1 2 0 0 1\n3 0 1 2 7\n5\n6\n\n rest\n");
    mesh_expect_warnings("odd.ply", 1,
                         "odd.ply: 7 bytes after the last element not read\n"
                         "odd.ply: 2 properties of \"vertex\" not read: quality, flags\n"
                         "odd.ply: 1 property of \"face\" not read: weight\n"
                         "odd.ply: 2 elements \"camera\" not read\n"
                         "odd.ply: 1 normals are not finite or incomplete and were left out\n");
}

RUN_TESTS(NULL, NULL)
