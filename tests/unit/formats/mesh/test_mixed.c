/* test_mixed.c - files of several formats as one scan: numbers of elements, faces and materials. */
#include "tests/unit/test.h"
#include "tests/unit/formats/mesh/obj_fixture.h"

#define OBJ_TEXT                                                                                   \
    "o %s\nusemtl red\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\n"                        \
    "f 1/1 2/2 3/3\nusemtl blue\nf -1//1 -2//1 -3\nvn 0 0 1\n"
static const char ply_text[] =
    "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
    "property float z\nproperty float s\nproperty float t\nelement face 2\n"
    "property list uchar int vertex_indices\nproperty uchar red\nproperty uchar green\n"
    "property uchar blue\nend_header\n5 0 0 0 0\n6 0 0 1 0\n5 1 0 0 1\n"
    "3 0 1 2 255 0 0\n3 2 1 0 0 255 0\n";
static const char stl_text[] = "solid a\nfacet normal 0 0 1\nouter loop\nvertex 7 0 0\n"
                               "vertex 8 0 0\nvertex 7 1 0\nendloop\nendfacet\nendsolid a\n";

enum { FILES = 4, FACES = 7 };

static void make_files(const char *paths[FILES])
{
    paths[0] = test_text("a.obj", OBJ_TEXT);
    paths[1] = test_text("b.ply", ply_text);
    paths[2] = test_text("c.stl", stl_text);
    paths[3] = test_text("d.obj", OBJ_TEXT);
}

/* Each face has the vertices that its own file gives it. */
TEST(test_elements)
{
    const char *paths[FILES];
    struct obj_fixture f;
    make_files(paths);
    obj_read_files(&f, 2, FILES, paths);
    assert_int_equal(f.status, 0);
    assert_int_equal(f.scan.totals.vertices, 12);
    assert_int_equal(f.scan.totals.texcoords, 9);
    assert_int_equal(f.scan.totals.normals, 2);
    assert_int_equal(f.scan.totals.faces, FACES);
    obj_assert_corners(&f, FMT_MESH_VERTEX, 21, 0, 1, 2, 2, 1, 0, 3, 4, 5, 5, 4, 3, 6, 7, 8, 9, 10,
                       11, 11, 10, 9);
    obj_assert_corners(&f, FMT_MESH_TEXCOORD, 21, 0, 1, 2, -1, -1, -1, 3, 4, 5, 5, 4, 3, -1, -1, -1,
                       6, 7, 8, -1, -1, -1);
    obj_assert_corners(&f, FMT_MESH_NORMAL, 21, -1, -1, -1, 0, 0, -1, -1, -1, -1, -1, -1, -1, -1,
                       -1, -1, -1, -1, -1, 1, 1, -1);
    assert_true(f.scan.positions[9][0] == 0.0 && f.scan.positions[6][0] == 7.0);
    obj_close(&f);
}

/* A material belongs to its file, also if another file has one of the same name. */
TEST(test_materials)
{
    static const char *const names[FACES] = {"red", "blue", "#ff0000", "#00ff00",
                                             "",    "red",  "blue"};
    const char *paths[FILES];
    struct obj_fixture f;
    make_files(paths);
    obj_read_files(&f, 2, FILES, paths);
    assert_int_equal(f.scan.totals.materials, 6);
    for (int i = 0; i < FACES; i++)
        if (i == 4)
            assert_int_equal(f.scan.materials[i], FMT_MESH_NO_MATERIAL);
        else
            obj_assert_material(&f, f.scan.materials[i], names[i]);
    assert_int_not_equal(f.scan.materials[0], f.scan.materials[5]);
    obj_close(&f);
}

static int compare_batch(void *arg, const struct fmt_mesh_batch *batch)
{
    const struct obj_scan **scan = arg;
    for (uint64_t i = 0, c = 3 * batch->face_base; i < batch->corner_count; i++)
        assert_int_equal(batch->corner_vertices[i], (*scan)->corners[FMT_MESH_VERTEX][c + i]);
    if (batch->face_count > 0)
        assert_int_equal(batch->material_change_count > 0 ? batch->material_changes[0].material
                                                          : batch->material_at_start,
                         (*scan)->materials[batch->face_base]);
    return 0;
}

/* Another reading gives the same numbers, and messages name a face of its own file. */
TEST(test_again)
{
    static const char *const places[FACES] = {"a.obj:9", "a.obj:11", "b.ply:18", "b.ply:19",
                                              "c.stl:2", "d.obj:9",  "d.obj:11"};
    const char *paths[FILES];
    struct obj_fixture f;
    make_files(paths);
    obj_read_files(&f, 1, FILES, paths);
    const struct obj_scan *scan = &f.scan;
    assert_int_equal(fmt_mesh_read(f.reader, compare_batch, &scan, NULL), 0);
    for (uint64_t face = 0; face < FACES; face++) {
        char *place;
        assert_int_equal(fmt_mesh_location_text(f.reader, face, &place), 0);
        assert_string_equal(place, places[face]);
        bsq_free(f.ctx, place);
    }
    assert_int_equal(fmt_mesh_fail_index(f.reader, 3, FMT_MESH_VERTEX, 3 + 9), BSQ_EDATA);
    assert_non_null(strstr(bsq_error(f.ctx), "b.ply:19: face refers to vertex 9 (counted from 0), "
                                             "file has 3"));
    obj_close(&f);
}

RUN_TESTS(NULL, NULL)
