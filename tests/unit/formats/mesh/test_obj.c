/* test_obj.c - the OBJ reader on every form of valid text, and its messages for invalid text. */
#include "tests/unit/formats/mesh/obj_fixture.h"
#include "tests/unit/test.h"

/* ---- spellings ---- */

TEST(test_vertices)
{
    struct obj_fixture f;
    obj_read_text(&f, "v 1 2 3\nv 4 5 6 0.5\n  v\t-1.5  +.5 1e2 0.25 0.5 0.75  \r\n"
                      "v 7 8 9 0 1 0 0.5 # green\nv \\\n 1 \\\r\n 2 3\nv 1 2 3");
    assert_int_equal(f.scan.totals.vertices, 6);
    const double positions[6][3] = {{1, 2, 3}, {4, 5, 6}, {-1.5, 0.5, 100},
                                    {7, 8, 9}, {1, 2, 3}, {1, 2, 3}};
    const float colors[6][3] = {{-1, -1, -1}, {-1, -1, -1}, {0.25f, 0.5f, 0.75f},
                                {0, 1, 0},    {-1, -1, -1}, {-1, -1, -1}};
    assert_memory_equal(f.scan.positions, positions, sizeof positions);
    assert_memory_equal(f.scan.colors, colors, sizeof colors);
    obj_close(&f);
}

TEST(test_texcoords_and_normals)
{
    struct obj_fixture f;
    obj_read_text(&f, "vt 0.25\nvt 0.5 0.75\nvt 1 -2 3\nvn 0 0 2\nvp 1 2\nvt\t3\t4\t# x\n");
    const double texcoords[4][2] = {{0.25, 0}, {0.5, 0.75}, {1, -2}, {3, 4}};
    const float normals[1][3] = {{0, 0, 2}};
    assert_int_equal(f.scan.totals.texcoords, 4);
    assert_memory_equal(f.scan.texcoords, texcoords, sizeof texcoords);
    assert_int_equal(f.scan.totals.normals, 1);
    assert_memory_equal(f.scan.normals, normals, sizeof normals);
    assert_int_equal(f.scan.totals.skipped_lines, 0);
    obj_close(&f);
}

TEST(test_face_forms)
{
    struct obj_fixture f;
    obj_read_text(&f, "f 1 2 3\nf 4/5 6/7 8/9\nf 1//2 3//4 5//6 7//8\nf 1/2/3 4/5/6 7/8/9\n"
                      "f 10 20/30 40//50 \\\n 60/70/80\n");
    assert_int_equal(f.scan.totals.faces, 5);
    const uint32_t sizes[5] = {3, 3, 4, 3, 4};
    assert_memory_equal(f.scan.sizes, sizes, sizeof sizes);
    obj_assert_corners(&f, 0, 17, 0, 1, 2, 3, 5, 7, 0, 2, 4, 6, 0, 3, 6, 9, 19, 39, 59);
    obj_assert_corners(&f, 1, 17, -1, -1, -1, 4, 6, 8, -1, -1, -1, -1, 1, 4, 7, -1, 29, -1, 69);
    obj_assert_corners(&f, 2, 17, -1, -1, -1, -1, -1, -1, 1, 3, 5, 7, 2, 5, 8, -1, -1, 49, 79);
    obj_close(&f);
}

TEST(test_relative_indices)
{
    struct obj_fixture f;
    obj_read_text(&f, "v 0 0 0\nv 1 0 0\nv 1 1 0\nvn 0 0 1\nvt 0 0\nf -3/-1/-1 -2/-1/-1 -1/1/1\n"
                      "v 2 2 2\nf -1 -2 1\n");
    obj_assert_corners(&f, 0, 6, 0, 1, 2, 3, 2, 0);
    obj_assert_corners(&f, 1, 6, 0, 0, 0, -1, -1, -1);
    obj_close(&f);
}

TEST(test_short_faces_and_unknown)
{
    struct obj_fixture f;
    obj_read_text(&f, "\xef\xbb\xbf# comment \\\nv 0 0 0\ng group\no object\ns off\nl 1 2\np 1\n"
                      "fancy statement\nf 1 1\nf\nf 1 2 3\nfo 1 2 3\ncurv2 1 2\nvc 1 2 3\n\n \t\n");
    assert_int_equal(f.scan.totals.vertices, 1);
    assert_int_equal(f.scan.totals.faces, 2);
    assert_int_equal(f.scan.totals.short_faces, 2);
    assert_int_equal(f.scan.totals.skipped_lines, 2);
    obj_close(&f);
}

TEST(test_line_ends)
{
    static const char *const texts[] = {
        "v 1 2 3\nusemtl a b\nf 1 2 3\n# c\ng x\nf 4 5 6\n",
        "v 1 2 3\r\nusemtl a b \r\nf 1 2 3\r\n# c\r\ng x\r\nf 4 5 6\r\n",
        "v 1 2 3\rusemtl a b\rf 1 2 3\r# c\rg x\rf 4 5 6\r",
        "v 1 2 3\rusemtl a b\rf 1 2 3\r# c\rg x\rf 4 5 6",
        "v 1 2 3\r\nusemtl a b\nf 1 2 3 \r# c\ng x\rf 4 5 6 \\\r\n"};
    for (size_t i = 0; i < sizeof texts / sizeof *texts; i++) {
        struct obj_fixture f;
        obj_read_text(&f, texts[i]);
        obj_assert_corners(&f, 0, 6, 0, 1, 2, 3, 4, 5);
        assert_int_equal(f.scan.totals.materials, 1);
        obj_assert_material(&f, 0, "a b");
        assert_int_equal(obj_line_of_face(&f, 1), 6);
        obj_close(&f);
    }
}

TEST(test_several_files)
{
    struct obj_fixture f;
    test_text("b.mtl", "newmtl m\nKd 0 0 1\n");
    test_text("a file.mtl", "newmtl m\nKd 1 0 0\n");
    const char *paths[2] = {
        test_text("a.obj", "mtllib a file.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nusemtl m\nf 1 2 3\n"),
        test_text("b.obj", "mtllib b.mtl missing.mtl\nf 1 2 -1\nv 0 0 0\nusemtl m\nf 1 -1 2\n")};
    obj_read_files(&f, 2, 2, paths);
    assert_int_equal(f.status, BSQ_EDATA); /* -1 before any vertex of this file */
    obj_close(&f);
    test_text("b.obj", "mtllib b.mtl missing.mtl\nv 0 0 0\nf 1 2 -1\nusemtl m\nv 1 1 1\n"
                       "f 1 -1 2\nusemtl\nf 1 1 1");
    obj_read_files(&f, 2, 2, paths);
    assert_int_equal(f.status, 0);
    obj_assert_corners(&f, 0, 12, 0, 1, 2, 3, 4, 3, 3, 4, 4, 3, 3, 3);
    assert_int_equal(f.scan.materials[0], 0);
    assert_int_equal(f.scan.materials[1], FMT_MESH_NO_MATERIAL);
    assert_int_equal(f.scan.materials[2], 1);
    assert_int_equal(f.scan.materials[3], FMT_MESH_NO_MATERIAL);
    struct fmt_materials materials;
    assert_int_equal(fmt_mesh_read_materials(f.reader, &materials), 0);
    assert_int_equal(materials.count, 2);
    assert_true(materials.list[0].color.value[0] == 1 && materials.list[0].color.value[2] == 0);
    assert_true(materials.list[1].color.value[0] == 0 && materials.list[1].color.value[2] == 1);
    fmt_materials_free(f.ctx, &materials);
    /* Reading again gives the same material numbers. */
    struct fmt_mesh_totals again;
    assert_int_equal(fmt_mesh_read(f.reader, NULL, NULL, &again), 0);
    assert_memory_equal(&again, &f.scan.totals, sizeof again);
    assert_int_equal(again.materials, 2);
    obj_close(&f);
}

/* Quadratic time would take minutes. Every seventh material has no description, and others have
 * two, of which the first counts. */
TEST(test_many_materials)
{
    enum { count = 50000 };
    struct obj_fixture f;
    struct fmt_materials materials;
    char *obj = malloc(64 + 32 * count), *mtl = malloc(64 * count), *to = mtl;
    for (int i = count; i-- > 0;)
        if (i % 7)
            to += sprintf(to, "newmtl m%d\nKd 0.%06d 0 0\nnewmtl m%d\nKd 1 1 1\n", i, i, i);
    test_text("many.mtl", mtl);
    to = obj + sprintf(obj, "mtllib many.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\n");
    for (int i = 0; i < count; i++)
        to += sprintf(to, "usemtl m%d\nf 1 2 3\n", i);
    const char *path = test_text("many.obj", obj);
    obj_read_files(&f, 2, 1, &path);
    assert_int_equal(f.status, 0);
    assert_int_equal(fmt_mesh_read_materials(f.reader, &materials), 0);
    assert_int_equal(materials.count, count);
    for (int i = 0; i < count; i++) {
        char name[32];
        sprintf(name, "m%d", i);
        assert_string_equal(materials.list[i].name, name);
        assert_int_equal(materials.list[i].color.has_value, i % 7 != 0);
        assert_true(materials.list[i].color.value[0] == (i % 7 ? (float)(i / 1e6) : 0.8f));
    }
    fmt_materials_free(f.ctx, &materials);
    obj_close(&f);
    free(obj);
    free(mtl);
}

/* ---- errors ---- */

TEST(test_errors)
{
    static const struct {
        const char *text, *message;
    } cases[] = {
        {"v 0 0 0\nv 1 nano 0\n", "bad.obj:2: \"nano\" is not a number"},
        {"v 0 0 0\nv 1 --inf 0\n", "bad.obj:2: \"--inf\" is not a number"},
        {"v 0 0 1e999x\n", "bad.obj:1: \"1e999x\" is not a number"},
        {"v 0 1 .#QNAN0\n", "bad.obj:1: \".#QNAN0\" is not a number"},
        {"# 1\n#2 \\\n\nv 1,0 2,0 3,0\n", "bad.obj:4: \"1,0\" is not a number"},
        {"v 1\n", "bad.obj:1: a vertex of 1 numbers, expected 3, 4, 6 or 7"},
        {"v 1 2 3 4 5 6 7 8\n",
         "bad.obj:1: a vertex of more than 7 numbers, expected 3, 4, 6 or 7"},
        {"vn 1 2 3 4 5\n", "bad.obj:1: unexpected \"5\" at the end of the line"},
        {"v 0 0 0\nf 1 0 1\n", "bad.obj:2: face refers to vertex 0, indices begin with 1"},
        {"f 1 2 x\n", "bad.obj:1: \"x\" is not a face corner"},
        {"f 1 2 3/4/5/6\n", "bad.obj:1: \"3/4/5/6\" is not a face corner"},
        {"f 1 2 1234567890123456789\n", "bad.obj:1: \"1234567890123456789\" is not a face corner"},
        {"f 1 2.5 3\n", "bad.obj:1: \"2.5\" is not a face corner"},
        {"v 0 0 0\nv 0 0 0\nv 0 0 0\n# c\n\nf 1 2 3\nf 1 2 -5\n",
         "bad.obj:7: face refers to vertex -5, file has 3 so far"},
        {"v 0 0 0\nf 1 -1 -2\nv 0 0 x\n", "bad.obj:2: face refers to vertex -2, file has 1 so far"},
        {"v 0 0 \x01zzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzz\n",
         "bad.obj:1: \"\\x01zzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzzz...\" is not a number"},
        {"hello world\nhow are you\n",
         "bad.obj:1: not an OBJ file: \"hello world\" is no statement of that format"},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++)
        obj_expect_text_error(cases[i].text, cases[i].message);
    static const char zero[] = "v 0 0 0\ng a\0b\nv 1 2 3\n";
    obj_expect_error(zero, sizeof zero - 1, "bad.obj:2: not a text file (zero byte)");
    static const char binary[] = "\211ABC\r\n\x1a\n\0\0\0\rIHDR";
    obj_expect_error(binary, sizeof binary - 1, "bad.obj:3: not a text file (zero byte)");
    static const char utf16[] = "v\0 \0\x31\0";
    obj_expect_error(utf16, sizeof utf16 - 1, "bad.obj:1: not a text file (zero byte)");
}

TEST(test_other_kinds_of_files_are_named)
{
    static const struct {
        const char *bytes;
        size_t size;
        const char *message;
    } cases[] = {
        {"\x1f\x8b\x08\0", 4, "bad.obj: byte 4: truncated: the packed data end too early"},
        {"PK\x03\x04\x14\0", 6,
         "bad.obj: cannot read a ZIP archive: unpack it first; of 3MF or USDZ, export the mesh as "
         "OBJ"},
        {"LASF\1\2", 6, "bad.obj: cannot read a point cloud: make a mesh of it"},
        {"\xff\xfe\0\0v\0\0\0", 8,
         "bad.obj: cannot read text in UTF-16 or UTF-32: save it as UTF-8"},
        {"\0\0\xfe\xff", 4, "bad.obj: cannot read text in UTF-32: save it as UTF-8"},
        {"\xfe\xff\0v\0 \0?", 8, "bad.obj: cannot read text in UTF-16: save it as UTF-8"},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++)
        obj_expect_error(cases[i].bytes, cases[i].size, cases[i].message);
    /* The first bytes of a ZIP archive alone are text, but not a statement. */
    obj_expect_error("PK", 2, "bad.obj:1: not an OBJ file: \"PK\" is no statement of that format");
}

TEST(test_names_are_recognised)
{
    assert_true(fmt_mesh_recognise("a/scan.obj", "v 0 0 0\n", 8));
    assert_true(fmt_mesh_recognise("SCAN.OBJ", "", 0));
    assert_false(fmt_mesh_recognise("obj", "", 0));
    assert_true(fmt_mesh_recognise("scan.obj.gz", "\x1f\x8b", 2));
    assert_true(fmt_mesh_recognise("scan.PLY.ZST", "\x28\xb5\x2f\xfd", 4));
    assert_false(fmt_mesh_recognise("scan.gz", "\x1f\x8b", 2));
}

TEST(test_fail_index)
{
    struct obj_fixture f;
    const char *paths[2] = {test_text("one.obj", "v 0 0 0\nv 0 0 0\nv 0 0 0\nf 1 2 3\n"),
                            test_text("two.obj", "v 0 0 0\nvt 0 0\nf 1 1 1\n\nf 1/1 1/9 1/1\n")};
    obj_read_files(&f, 2, 2, paths);
    assert_int_equal(f.status, 0);
    assert_int_equal(f.scan.corners[1][7], 8);
    assert_int_equal(fmt_mesh_fail_index(f.reader, 2, FMT_MESH_TEXCOORD, 8), BSQ_EDATA);
    assert_string_equal(bsq_error(f.ctx),
                        "two.obj:5: face refers to texture coordinate 9, file has 1");
    bsq_clear_error(f.ctx);
    assert_int_equal(fmt_mesh_fail_index(f.reader, 2, FMT_MESH_VERTEX, 3 + 98), BSQ_EDATA);
    assert_string_equal(bsq_error(f.ctx), "two.obj:5: face refers to vertex 99, file has 1");
    obj_close(&f);
}

struct object_faces {
    uint32_t numbers[8];
    uint64_t count;
};

static int keep_numbers(void *arg, const struct fmt_mesh_batch *batch)
{
    struct object_faces *faces = arg;
    uint32_t number = batch->material_at_start;
    uint64_t change = 0;
    for (uint64_t i = 0; i < batch->face_count; i++) {
        for (; change < batch->material_change_count && batch->material_changes[change].face <= i;
             change++)
            number = batch->material_changes[change].material;
        faces->numbers[faces->count++] = number;
    }
    return 0;
}

/* With objects, a number is a material and an object; equal names in two files are one object. */
CONTEXT_TEST(test_objects, 2, 64 << 20)
{
    static const struct {
        const char *material, *object;
    } expected[] = {{"", "a b"}, {"m", "a b"}, {"m", "c"}, {"m", ""}, {"m", "a b"}};
    static const uint32_t numbers[] = {FMT_MESH_NO_MATERIAL, 0, 1, 2, 1, 3, 4};
    test_text("m.mtl", "newmtl m\nKd 1 0 0\n");
    const char *paths[] = {
        test_text("1.obj", "mtllib m.mtl\nf 1 1 1\no \"a b\" # x\nf 1 1 1\nusemtl m\nf 1 1 1\ng c\n"
                           "f 1 1 1\ng a b\nf 1 1 1\n"),
        test_text("2.obj", "usemtl m\nf 1 1 1\no a b\nf 1 1 1\n")};
    struct fmt_mesh_reader *reader;
    assert_int_equal(fmt_mesh_open(ctx, paths, 2, &reader), 0);
    fmt_mesh_use_objects(reader);
    for (int reading = 0; reading < 2; reading++) {
        struct object_faces faces = {.count = 0};
        struct fmt_mesh_totals totals;
        struct fmt_materials materials;
        assert_int_equal(fmt_mesh_read(reader, keep_numbers, &faces, &totals), 0);
        assert_int_equal(totals.materials, 5);
        assert_int_equal(faces.count, 7);
        assert_memory_equal(faces.numbers, numbers, sizeof numbers);
        assert_int_equal(fmt_mesh_read_materials(reader, &materials), 0);
        assert_int_equal(materials.count, 5);
        for (int i = 0; i < 5; i++) {
            assert_string_equal(materials.list[i].name, expected[i].material);
            assert_string_equal(materials.list[i].object, expected[i].object);
            assert_int_equal(materials.list[i].color.has_value, i == 1 || i == 2);
        }
        fmt_materials_free(ctx, &materials);
    }
    fmt_mesh_close(reader);
}

RUN_TESTS(NULL, NULL)
