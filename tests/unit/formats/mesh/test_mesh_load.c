/* test_mesh_load.c - fmt_mesh_load() on OBJ files. */
#include "tests/unit/formats/mesh/obj_fixture.h"
#include "tests/unit/test.h"

static void load_mesh(struct obj_fixture *f, struct fmt_mesh *mesh, const char *text)
{
    const char *path = test_text("mesh.obj", text);
    memset(f, 0, sizeof *f);
    f->ctx = test_context(0, 0);
    f->status = fmt_mesh_load(f->ctx, path, false, mesh);
}

TEST(test_mesh)
{
    struct obj_fixture f;
    struct fmt_mesh mesh;
    /* Faces come first. The quad is reflex at corner 2, so the cut starts there. */
    load_mesh(&f, &mesh,
              "f 1/1/1 2/2/1 3/3/2 4/4/1\nf 1 2 3\nv 0 0 0\nv 1 1 0\nv 4 0 0\nv 1 4 0\n"
              "vt 0 0\nvt .1 .1\nvt .2 .2\nvt .3 .3\nvn 0 0 3\nvn 0 0 0\n");
    assert_int_equal(f.status, 0);
    assert_int_equal(mesh.vertex_count, 4);
    assert_int_equal(mesh.triangle_count, 3);
    assert_int_equal(mesh.face_count, 2);
    const uint32_t triangles[3][3] = {{1, 2, 3}, {1, 3, 0}, {0, 1, 2}};
    assert_memory_equal(mesh.vertices, triangles, sizeof triangles);
    const uint32_t texcoords[3][3] = {{1, 2, 3}, {1, 3, 0}, {UINT32_MAX, UINT32_MAX, UINT32_MAX}};
    assert_memory_equal(mesh.corner_texcoords, texcoords, sizeof texcoords);
    const uint32_t normals[3][3] = {{0, 1, 0}, {0, 0, 0}, {UINT32_MAX, UINT32_MAX, UINT32_MAX}};
    assert_memory_equal(mesh.corner_normals, normals, sizeof normals);
    const uint64_t faces[3] = {0, 0, 1};
    assert_memory_equal(mesh.faces, faces, sizeof faces);
    assert_true(mesh.normals[0][2] == 1 && mesh.normals[1][2] == 0);
    fmt_mesh_free(f.ctx, &mesh);
    obj_close(&f);
}

TEST(test_mesh_errors)
{
    static const struct {
        const char *text, *message;
    } cases[] = {
        {"v 0 0 0\nv 0 0 1\nv 0 1 0\nf 1 2 3\nf 1 2 4\n",
         "mesh.obj:5: face refers to vertex 4, file has 3"},
        {"v 0 0 0\nf 1 1 1\nf 1 1 99999999999\n",
         "mesh.obj:3: face refers to vertex 99999999999, file has 1"},
        {"v 0 0 0\nf 1/1 1/1 1/1\n", "mesh.obj:2: face refers to texture coordinate 1, file has 0"},
        {"v 0 0 0\nvt 0 0\nf 1/1 1/0 1/1\n",
         "mesh.obj:3: face refers to a texture coordinate before the first one"},
        {"v 0 0 0\nv 1 0 nan\nf 1 1 1\nf 1 1 2\n",
         "mesh.obj:4: 1 of 2 faces have a vertex without a finite position, more than 1 %; this is "
         "the first"},
        {"v 0 0 0\nl 1 1\n", "mesh.obj: no faces, only points or lines"},
        {"v 0 0 0\nv 1 0 0\np 1 2\n", "mesh.obj: no faces, only points or lines"},
        {"v 0 0 0\nf 1 1\n", "mesh.obj: no faces"},
        {"", "mesh.obj: no faces"},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct obj_fixture f;
        struct fmt_mesh mesh;
        load_mesh(&f, &mesh, cases[i].text);
        assert_int_equal(f.status, BSQ_EDATA);
        assert_string_equal(bsq_error(f.ctx), cases[i].message);
        obj_close(&f);
    }
}

/* A normal that does not exist and texture coordinates that are not finite are missing, and a face
 * without a position is left out. */
TEST(test_missing_elements)
{
    struct obj_fixture f;
    struct fmt_mesh mesh;
    char text[2000] = "v 0 0 0\nv 1 0 0\nv inf 0 0\nvt 0 0\nvt nan 1\nvn 0 0 1\nvn 0 1\n"
                      "f 1/1/1 2/2/4294967296 1/1/2\nf 1 2 3 2\nf 2 1 2\n";
    for (int i = 0; i < 98; i++)
        strcat(text, "f 2 2 1\n");
    load_mesh(&f, &mesh, text);
    assert_int_equal(f.status, 0);
    assert_int_equal(mesh.face_count, 101);
    assert_int_equal(mesh.triangle_count, 100);
    const uint32_t texcoords[3] = {0, UINT32_MAX, 0}, normals[3] = {0, UINT32_MAX, 1};
    assert_memory_equal(mesh.corner_texcoords, texcoords, sizeof texcoords);
    assert_memory_equal(mesh.corner_normals, normals, sizeof normals);
    assert_true(mesh.normals[1][0] == 0 && mesh.normals[1][1] == 0);
    assert_int_equal(mesh.faces[0], 0);
    assert_int_equal(mesh.faces[1], 2);
    assert_int_equal(mesh.vertices[1][0], 1);
    fmt_mesh_free(f.ctx, &mesh);
    obj_close(&f);
}

RUN_TESTS(NULL, NULL)
