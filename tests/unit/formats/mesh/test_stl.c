/* test_stl.c - the STL reader on text and binary files, and wrong files. */
#include "tests/unit/test.h"
#include "tests/unit/formats/mesh/obj_fixture.h"

/* A binary file of `count` triangles. Corner k of triangle i is at (i, k, 0), but corner 0 is at
 * the origin. */
struct binary {
    unsigned char bytes[84 + 50 * 8 + 8];
    size_t size;
};

static void put_triangle(struct binary *b, const float corners[3][3], unsigned attribute)
{
    const float normal[3] = {NAN, NAN, NAN}; /* ignored */
    unsigned char *to = b->bytes + b->size;
    memcpy(to, normal, 12);
    memcpy(to + 12, corners, 36);
    to[48] = (unsigned char)attribute;
    to[49] = (unsigned char)(attribute >> 8);
    b->size += 50;
}

static struct binary make_binary(const char *header, unsigned count, const unsigned *attributes)
{
    struct binary b = {.size = 84};
    memcpy(b.bytes, header, strlen(header));
    b.bytes[80] = (unsigned char)count;
    for (unsigned i = 0; i < count; i++) {
        const float corners[3][3] = {{0, 0, 0}, {(float)i, 1, 0.5f}, {(float)i, 2, 0.5f}};
        put_triangle(&b, corners, attributes ? attributes[i] : 0);
    }
    return b;
}

static void read_bytes(struct obj_fixture *f, const void *bytes, size_t size)
{
    const char *path = test_bytes("scan.stl", bytes, size);
    obj_read_files(f, 2, 1, &path);
    if (f->status)
        print_message("%s\n", bsq_error(f->ctx));
    assert_int_equal(f->status, 0);
    assert_int_equal(f->scan.totals.bytes, size);
}

/* Equal vertices are one. The name at the start does not make a file text. */
TEST(test_binary)
{
    static const char *const headers[] = {"a scan", "solid scan", "solid\nfacet normal"};
    for (int i = 0; i < 3; i++) {
        struct obj_fixture f;
        struct binary b = make_binary(headers[i], 3, NULL);
        read_bytes(&f, b.bytes, b.size);
        assert_int_equal(f.scan.totals.faces, 3);
        assert_int_equal(f.scan.totals.vertices, 7);
        obj_assert_corners(&f, 0, 9, 0, 1, 2, 0, 3, 4, 0, 5, 6);
        const double last[3] = {2, 2, 0.5};
        assert_memory_equal(f.scan.positions[6], last, sizeof last);
        obj_close(&f);
    }
}

/* Returns the status of reading a file that no suffix tells. */
static int read_unnamed(const void *bytes, size_t size)
{
    struct obj_fixture f;
    const char *path = test_bytes("scan", bytes, size);
    obj_read_files(&f, 2, 1, &path);
    const int status = f.status;
    if (!status)
        assert_int_equal(f.scan.totals.faces, (size - 84) / 50);
    obj_close(&f);
    return status;
}

/* Without a suffix, binary files are known by their triangles, as they come through a pipe. */
TEST(test_without_suffix)
{
    struct binary few = make_binary("a scan", 3, NULL), many = make_binary("", 8, NULL);
    const size_t first_corner = 84 + 12;
    assert_int_equal(read_unnamed(few.bytes, few.size), 0);
    assert_int_equal(read_unnamed(many.bytes, many.size), 0);
    assert_int_equal(read_unnamed(few.bytes, few.size - 1), BSQ_EDATA);
    memcpy(few.bytes + first_corner, &(float){1e-30f}, 4);
    assert_int_equal(read_unnamed(few.bytes, few.size), BSQ_EDATA);
}

TEST(test_text_facets)
{
    struct obj_fixture f;
    const char *text = "solid one facet of many\r\n facet normal nan 0 1\n  outer loop\n"
                       "   vertex 0 0 0\n   vertex 1 0 0\n   vertex 0 1e0 0\n  endloop\n endfacet\n"
                       "endsolid one\n\n"
                       "SOLID\nFACET NORMAL 0 0 1 OUTER LOOP VERTEX 1 0 0 VERTEX 1 1 0\n"
                       "VERTEX 0.5 1 0 VERTEX 0 1 0 ENDLOOP ENDFACET\n"
                       "facet\nouter loop\nvertex 1 1 1\nvertex 2 2 2\nendloop\nendfacet\nendsolid";
    const char *path = test_text("text.dat", text); /* its content tells */
    obj_read_files(&f, 2, 1, &path);
    assert_int_equal(f.status, 0);
    assert_int_equal(f.scan.totals.faces, 2);
    assert_int_equal(f.scan.totals.short_faces, 1);
    assert_int_equal(f.scan.totals.bytes, strlen(text));
    obj_assert_corners(&f, 0, 7, 0, 1, 2, 1, 3, 4, 2);
    const double corner[3] = {0.5, 1, 0};
    assert_memory_equal(f.scan.positions[4], corner, sizeof corner);
    assert_int_equal(obj_line_of_face(&f, 0), 2);
    assert_int_equal(obj_line_of_face(&f, 1), 12);
    obj_close(&f);
}

enum { TRIANGLES = 20000 };

/* Many parts give what one part gives, apart from vertices that are equal across parts. */
static void check_many(const void *bytes, size_t size, uint64_t line)
{
    struct obj_fixture f;
    read_bytes(&f, bytes, size);
    assert_true(f.scan.batches > 2);
    assert_int_equal(f.scan.totals.faces, TRIANGLES);
    assert_in_range(f.scan.totals.vertices, 2 * TRIANGLES + 1, 2 * TRIANGLES + 100);
    for (int i = 0; i < TRIANGLES; i++) {
        const double *p = f.scan.positions[f.scan.corners[0][3 * i + 1]];
        assert_true(p[0] == i + 1 && p[1] == 0 && p[2] == 0);
    }
    assert_int_equal(obj_line_of_face(&f, 15000), line);
    obj_close(&f);
}

TEST(test_large_binary)
{
    unsigned char *binary = calloc(1, 84 + 50 * TRIANGLES);
    const uint32_t count = TRIANGLES;
    assert_non_null(binary);
    memcpy(binary + 80, &count, 4);
    for (int i = 0; i < TRIANGLES; i++) {
        const float corners[9] = {(float)i, 0, 0, (float)i + 1, 0, 0, (float)i, 1, 0};
        memcpy(binary + 84 + 50 * i + 12, corners, 36);
    }
    check_many(binary, 84 + 50 * TRIANGLES, 0);
    free(binary);
}

/* Statements may share one line, also that of the name. Such a text is cut like any other. */
TEST(test_large_text)
{
    static const struct {
        const char *start, *facet, *end;
        uint64_t line;
    } texts[] = {
        {"solid many\n",
         "facet normal 0 0 1\nouter loop\nvertex %d 0 0\nvertex %d 0 0\nvertex %d 1 0\nendloop\n"
         "endfacet\n",
         "endsolid many\n", 2 + 7 * 15000},
#define ONE_LINE                                                                                   \
    "facet  normal 0 0 1 outer loop vertex %d 0 0 vertex %d 0 0 vertex %d 1 0 endloop endfacet\t", \
        "endsolid one endfacet"
        {"solid a facet of many ", ONE_LINE, 1},
        {"solid\n", ONE_LINE, 2},
        {"solid ", ONE_LINE, 1}};
    char *text = malloc(TRIANGLES * 160 + 100);
    assert_non_null(text);
    for (size_t n = 0; n < sizeof texts / sizeof *texts; n++) {
        size_t size = (size_t)sprintf(text, "%s", texts[n].start);
        for (int i = 0; i < TRIANGLES; i++)
            size += (size_t)sprintf(text + size, texts[n].facet, i, i + 1, i);
        size += (size_t)sprintf(text + size, "%s", texts[n].end);
        check_many(text, size, texts[n].line);
    }
    free(text);
}

/* Blank lines between facets take no memory, however many they are. */
TEST(test_blank_lines)
{
    enum { BLANK_LINES = 4 << 20 };
    static const char facet[] = "facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\n"
                                "vertex 0 1 0\nendloop\nendfacet";
    struct obj_fixture f;
    char *text = malloc(BLANK_LINES + 1000);
    assert_non_null(text);
    size_t size = (size_t)sprintf(text, "solid\n%s", facet);
    memset(text + size, '\n', BLANK_LINES);
    size += BLANK_LINES;
    size += (size_t)sprintf(text + size, "%s\nendsolid\n", facet);
    read_bytes(&f, text, size);
    assert_int_equal(f.scan.totals.faces, 2);
    assert_int_equal(obj_line_of_face(&f, 1), 8 + BLANK_LINES);
    assert_true(bsq_memory_high(f.ctx) < BLANK_LINES);
    obj_close(&f);
    free(text);
}

/* VisCAM and SolidView set the highest bit of a triangle's attribute if it has a colour; Magics and
 * MeshLab name a colour in the header. */
TEST(test_colors_are_told)
{
    const unsigned one[2] = {0, 0x8000 | 31}, none[2] = {31, 0x7fff};
    const struct binary files[] = {make_binary("a scan", 2, none), make_binary("a scan", 2, one),
                                   make_binary("a COLOR=\012\024\036\377,MATERIAL=", 2, none)};
    for (int i = 0; i < 3; i++)
        mesh_expect_warnings(test_bytes("scan.stl", files[i].bytes, files[i].size), 2,
                             i == 0 ? ""
                                    : "scan.stl: colours of STL files are not read: those of PLY "
                                      "are\n");
}

/* ---- wrong files ---- */

static void expect_error(const void *bytes, size_t size, const char *message)
{
    const char *path = test_bytes("bad.stl", bytes, size);
    struct obj_fixture f;
    obj_read_files(&f, 2, 1, &path);
    assert_int_equal(f.status, BSQ_EDATA);
    assert_string_equal(bsq_error(f.ctx), message);
    obj_close(&f);
}

TEST(test_wrong_text)
{
#define START "solid\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\n"
    static const struct {
        const char *text, *message;
    } cases[] = {
        {START "vertex 0 0 x\n", "bad.stl:5: \"x\" is not a number"},
        {START "vertex 0 0 info\n", "bad.stl:5: \"info\" is not a number"},
        {START "vertex 0 0", "bad.stl:5: truncated: the file ends within a facet"},
        {START "vertex 0 0 1\n", "bad.stl:6: truncated: the file ends within a facet"},
        {START "vortex 0 0 1\n", "bad.stl:5: \"vortex\" is not a word of STL files"},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++)
        expect_error(cases[i].text, strlen(cases[i].text), cases[i].message);
}

TEST(test_wrong_binary)
{
    struct binary b = make_binary("a scan", 3, NULL);
    expect_error(b.bytes, 83, "bad.stl: truncated: 83 bytes are no STL file");
    expect_error(b.bytes, b.size - 1,
                 "bad.stl: truncated: the header counts 3 triangles, the file has 2");
    put_triangle(&b, (const float[3][3]){{0, 0, 0}, {1, 0, 0}, {0, 1, 0}}, 0);
    memset(b.bytes + 80, 0xff, 4);
    expect_error(b.bytes, b.size,
                 "bad.stl: truncated: the header counts 4294967295 triangles, the file has 4");
}

/* Every length of both kinds: an error in one line, or all triangles that the file still has. */
TEST(test_every_length)
{
    struct binary b = make_binary("a scan", 3, NULL);
    const char *text = START "vertex 1 0 0\nvertex 1 1 0\nendloop\nendfacet\nendsolid\n";
    for (size_t size = 0; size <= b.size; size++) {
        struct obj_fixture f;
        const char *path = test_bytes("cut.stl", b.bytes, size);
        obj_read_files(&f, 1, 1, &path);
        assert_int_equal(f.status, size == b.size ? 0 : BSQ_EDATA);
        obj_close(&f);
    }
    for (size_t size = 5; size <= strlen(text); size++) {
        struct obj_fixture f;
        const char *path = test_bytes("cut.stl", text, size);
        obj_read_files(&f, 1, 1, &path);
        if (size >= strlen(text) - 1)
            assert_int_equal(f.status, 0);
        if (f.status == 0)
            assert_int_equal(f.scan.totals.faces, strstr(text, "endloop") + 7 - text <= (long)size);
        else
            assert_int_equal(f.status, BSQ_EDATA);
        obj_close(&f);
    }
}

TEST(test_warnings)
{
    struct binary b = make_binary("a scan", 3, NULL);
    const char *text = START "vertex 1 0 0\nvertex 1 1 0\nendloop\nendfacet\n";
    mesh_expect_warnings(test_bytes("odd.stl", b.bytes, b.size + 8), 1,
                         "odd.stl: 8 bytes after the last triangle not read\n");
    mesh_expect_warnings(test_text("odd.stl", text), 1,
                         "odd.stl: \"endsolid\" is missing: the file may be incomplete\n");
}

RUN_TESTS(NULL, NULL)
