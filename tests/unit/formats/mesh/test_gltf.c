/* test_gltf.c - the glTF reader on every kind of element, node and buffer. */
#include "tests/unit/formats/mesh/gltf_builder.h"
#include "tests/unit/test.h"

#define HEAD              "{'asset':{'version':'2.0'},"
#define FILE_BUFFER(NAME) "'buffers':[{'uri':'" NAME ".bin','byteLength':$BYTES}],"
/* A scene with one node that has mesh 0. */
#define SCENE "'scenes':[{'nodes':[0]}],'nodes':[{'mesh':0}]"

/* cmocka compares floats only. */
static void assert_near(double value, double expected, double tolerance)
{
    if (!(fabs(value - expected) <= tolerance))
        fail_msg("%.17g is not %.17g", value, expected);
}

/* Keeps the material number of the only face of each batch. */
static int keep_material(void *arg, const struct fmt_mesh_batch *block)
{
    uint32_t **to = arg;
    if (block->face_count > 0)
        *(*to)++ = block->material_changes[0].material;
    return 0;
}

/* Appends vertices (i, 2 i, -i) as floats. */
static void put_vertices(struct ply_builder *b, int count)
{
    for (int i = 0; i < count; i++)
        ply_put(b, "fff", (double)i, 2.0 * i, -1.0 * i);
}

static void assert_vertices(const struct obj_fixture *f, uint64_t count)
{
    assert_int_equal(f->scan.totals.vertices, count);
    for (uint64_t i = 0; i < count; i++) {
        const double p[3] = {(double)i, 2.0 * (double)i, -1.0 * (double)i};
        for (int k = 0; k < 3; k++)
            assert_near(f->scan.positions[i][k], p[k], 0);
    }
}

/* ---- faces ---- */

TEST(test_index_types)
{
    static const struct {
        int code;
        const char *letters;
        int bytes;
    } types[] = {{5121, "CCCCCC", 1}, {5123, "SSSSSS", 2}, {5125, "IIIIII", 4}};
    for (size_t i = 0; i < sizeof types / sizeof *types; i++) {
        struct obj_fixture f;
        struct ply_builder b;
        char json[1000];
        gltf_begin(&b);
        put_vertices(&b, 4);
        ply_put(&b, types[i].letters, 0.0, 1.0, 2.0, 3.0, 2.0, 1.0);
        snprintf(json, sizeof json,
                 HEAD FILE_BUFFER("scan") SCENE
                 ",'bufferViews':[{'buffer':0,'byteLength':48},"
                 "{'buffer':0,'byteOffset':48,'byteLength':%d}],"
                 "'accessors':[{'bufferView':0,'componentType':5126,'count':4,'type':'VEC3'},"
                 "{'bufferView':1,'componentType':%d,'count':6,'type':'SCALAR'}],"
                 "'meshes':[{'primitives':[{'attributes':{'POSITION':0},'indices':1}]}]}",
                 6 * types[i].bytes, types[i].code);
        gltf_read(&f, gltf_write("scan", json, &b));
        assert_vertices(&f, 4);
        obj_assert_corners(&f, FMT_MESH_VERTEX, 6, 0, 1, 2, 3, 2, 1);
        obj_assert_corners(&f, FMT_MESH_NORMAL, 6, -1, -1, -1, -1, -1, -1);
        assert_int_equal(f.scan.materials[0], FMT_MESH_NO_MATERIAL);
        obj_close(&f);
        ply_free(&b);
    }
}

#define POSITIONS(COUNT)                                                                           \
    "'bufferViews':[{'buffer':0,'byteLength':$BYTES}],"                                            \
    "'accessors':[{'bufferView':0,'componentType':5126,'count':" COUNT ",'type':'VEC3'}],"

/* Reads six vertices without indices in a mode. */
static void read_mode(struct obj_fixture *f, const char *node, int mode)
{
    struct ply_builder b;
    char json[1000];
    gltf_begin(&b);
    put_vertices(&b, 6);
    snprintf(json, sizeof json,
             HEAD FILE_BUFFER("scan") "'scenes':[{'nodes':[0]}],'nodes':[{'mesh':0%s}]," POSITIONS(
                 "6") "'meshes':[{'primitives':[{'attributes':{'POSITION':0},'mode':%d}]}]}",
             node, mode);
    gltf_read(f, gltf_write("scan", json, &b));
    ply_free(&b);
}

TEST(test_modes)
{
    struct obj_fixture f;
    read_mode(&f, "", 4);
    obj_assert_corners(&f, FMT_MESH_VERTEX, 6, 0, 1, 2, 3, 4, 5);
    obj_close(&f);
    read_mode(&f, "", 5);
    obj_assert_corners(&f, FMT_MESH_VERTEX, 12, 0, 1, 2, 1, 3, 2, 2, 3, 4, 3, 5, 4);
    obj_close(&f);
    read_mode(&f, "", 6);
    obj_assert_corners(&f, FMT_MESH_VERTEX, 12, 1, 2, 0, 2, 3, 0, 3, 4, 0, 4, 5, 0);
    obj_close(&f);
    for (int mode = 0; mode < 4; mode++) { /* points and lines */
        read_mode(&f, "", mode);
        assert_int_equal(f.scan.totals.faces, 0);
        obj_close(&f);
    }
}

/* A node that mirrors turns triangles round, so that their front stays outside. */
TEST(test_mirrored)
{
    struct obj_fixture f;
    read_mode(&f, ",'scale':[1,-1,1]", 4);
    obj_assert_corners(&f, FMT_MESH_VERTEX, 6, 0, 2, 1, 3, 5, 4);
    assert_near(f.scan.positions[1][1], -2, 0);
    obj_close(&f);
    read_mode(&f, ",'scale':[-1,-1,1]", 5);
    obj_assert_corners(&f, FMT_MESH_VERTEX, 12, 0, 1, 2, 1, 3, 2, 2, 3, 4, 3, 5, 4);
    obj_close(&f);
}

/* Strips and fans with indices, also long ones, in parts. Triangles without area connect them. */
TEST(test_long_strips)
{
    enum { COUNT = 50000 };
    for (int mode = 5; mode < 7; mode++) {
        struct obj_fixture f;
        struct ply_builder b;
        char json[1000];
        gltf_begin(&b);
        put_vertices(&b, 3);
        ply_put(&b, "I", 2.0);
        for (int i = 1; i < COUNT; i++)
            ply_put(&b, "I", i == 30000 ? (double)((i - 1) % 2) : (double)(i % 2));
        snprintf(json, sizeof json,
                 HEAD FILE_BUFFER("scan") SCENE
                 ",'bufferViews':[{'buffer':0,'byteLength':36},"
                 "{'buffer':0,'byteOffset':36,'byteLength':%d}],"
                 "'accessors':[{'bufferView':0,'componentType':5126,'count':3,'type':'VEC3'},"
                 "{'bufferView':1,'componentType':5125,'count':%d,'type':'SCALAR'}],"
                 "'meshes':[{'primitives':[{'attributes':{'POSITION':0},'indices':1,'mode':%d}]}]}",
                 4 * COUNT, COUNT, mode);
        gltf_read(&f, gltf_write("scan", json, &b));
        /* Entries are 2 1 0 1 0 1 ...; of a strip only the first triangle has three vertices. */
        assert_int_equal(f.scan.totals.faces, mode == 5 ? 1 : COUNT - 4);
        if (mode == 5)
            obj_assert_corners(&f, FMT_MESH_VERTEX, 3, 2, 1, 0);
        for (uint64_t i = 0; i < f.scan.totals.faces && mode == 6; i++)
            assert_int_equal(f.scan.corners[FMT_MESH_VERTEX][3 * i + 2], 2);
        obj_close(&f);
        ply_free(&b);
    }
}

/* ---- attributes ---- */

/* All attributes of three vertices, interleaved in one view, in types of KHR_mesh_quantization. */
TEST(test_attributes)
{
    struct obj_fixture f;
    struct ply_builder b;
    gltf_begin(&b);
    for (int i = 0; i < 3; i++) {
        ply_put(&b, "sssS", 100.0 * i, -32768.0, 7.0, 0.0);    /* position, padding */
        ply_put(&b, "cccC", 127.0, -128.0, 0.0, 0.0);          /* normal, padding */
        ply_put(&b, "SS", 65535.0 * (i % 2), 65535.0 / 5 * i); /* texture coordinate */
        ply_put(&b, "CCCC", 255.0 * (i != 1), 0.0, 55.0, 9.0); /* colour */
    }
    gltf_read(
        &f,
        gltf_write(
            "scan",
            HEAD FILE_BUFFER("scan") SCENE
            ",'extensionsRequired':['KHR_mesh_quantization'],"
            "'bufferViews':[{'buffer':0,'byteLength':$BYTES,'byteStride':20}],"
            "'materials':[{'name':'stone','pbrMetallicRoughness':{"
            "'baseColorFactor':[0.5,1,1,0.3]}}],"
            "'accessors':["
            "{'bufferView':0,'componentType':5122,'count':3,'type':'VEC3'},"
            "{'bufferView':0,'byteOffset':8,'componentType':5120,'normalized':true,'count':3,"
            "'type':'VEC3'},"
            "{'bufferView':0,'byteOffset':12,'componentType':5123,'normalized':true,'count':3,"
            "'type':'VEC2'},"
            "{'bufferView':0,'byteOffset':16,'componentType':5121,'normalized':true,'count':3.0,"
            "'type':'VEC4'}],"
            "'meshes':[{'primitives':[{'attributes':{'POSITION':0,'NORMAL':1,'TEXCOORD_0':2,"
            "'COLOR_0':3,'TANGENT':0},'material':0}]}]}",
            &b));
    assert_true(f.scan.totals.has_tangents);
    for (int i = 0; i < 3; i++) {
        const double p[3] = {100.0 * i, -32768, 7};
        const float n[3] = {1, -1, 0};
        for (int k = 0; k < 3; k++) {
            assert_near(f.scan.positions[i][k], p[k], 0);
            assert_near(f.scan.normals[i][k], n[k], 0);
        }
        assert_near(f.scan.texcoords[i][0], i % 2, 0);
        assert_near(f.scan.texcoords[i][1], 1 - 0.2 * i, 1e-12);
        /* sRGB of 0.5 and of 55 / 255, by the formula of IEC 61966-2-1. */
        assert_near(f.scan.colors[i][0], i == 1 ? 0 : 1.055 * pow(0.5, 1 / 2.4) - 0.055, 1e-6);
        assert_near(f.scan.colors[i][1], 0, 0);
        assert_near(f.scan.colors[i][2], 1.055 * pow(55 / 255.0, 1 / 2.4) - 0.055, 1e-6);
    }
    obj_assert_material(&f, f.scan.materials[0], "stone");
    for (int kind = 0; kind < 3; kind++)
        obj_assert_corners(&f, kind, 3, 0, 1, 2);
    obj_close(&f);
    ply_free(&b);
}

/* Colours of all types, with and without alpha; a second mesh without colours is white. */
TEST(test_color_types)
{
    static const struct {
        int code, components;
        const char *letters;
        double white;
    } types[] = {{5126, 3, "fff", 1},    {5126, 4, "ffff", 1},    {5121, 3, "CCC", 255},
                 {5121, 4, "CCCC", 255}, {5123, 3, "SSS", 65535}, {5123, 4, "SSSS", 65535}};
    for (size_t i = 0; i < sizeof types / sizeof *types; i++) {
        struct obj_fixture f;
        struct ply_builder b;
        char json[1200];
        gltf_begin(&b);
        put_vertices(&b, 3);
        for (int v = 0; v < 3; v++)
            ply_put(&b, types[i].letters, types[i].white, 0.0, types[i].white, 0.0);
        snprintf(
            json, sizeof json,
            HEAD FILE_BUFFER(
                "scan") "'nodes':[{'mesh':0},{'mesh':1}],"
                        "'bufferViews':[{'buffer':0,'byteLength':$BYTES}],"
                        "'accessors':[{'bufferView':0,'componentType':5126,'count':3,'type':'VEC3'},"
                        "{'bufferView':0,'byteOffset':36,'componentType':%d,'count':3,'type':'VEC%d'}],"
                        "'meshes':[{'primitives':[{'attributes':{'POSITION':0,'COLOR_0':1}}]},"
                        "{'primitives':[{'attributes':{'POSITION':0}}]}]}",
            types[i].code, types[i].components);
        gltf_read(&f, gltf_write("scan", json, &b));
        assert_int_equal(f.scan.totals.vertices, 6);
        for (int v = 0; v < 6; v++)
            for (int k = 0; k < 3; k++)
                assert_near(f.scan.colors[v][k], k != 1 || v > 2, 0);
        obj_close(&f);
        ply_free(&b);
    }
}

/* ---- nodes ---- */

/* Nodes in a chain and instances: a translation of a rotation of a scale, and a matrix. */
TEST(test_nodes)
{
    struct obj_fixture f;
    struct ply_builder b;
    gltf_begin(&b);
    ply_put(&b, "fffffffff", 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0);
    gltf_read(&f,
              gltf_write(
                  "scan",
                  HEAD FILE_BUFFER("scan") POSITIONS(
                      "3") "'scene':1,'scenes':[{'nodes':[1]},{'nodes':[2,0]}],'nodes':["
                           "{'translation':[4000000.125,0,0],'children':[3,1]},"
                           "{'mesh':0,'name':'a','matrix':[0,2,0,0,-3,0,0,0,0,0,4,0,5,6,7,1]},"
                           "{'mesh':0},"
                           "{'mesh':0,'translation':[0,0,1],'rotation':[0,0,0.70710678,0.70710678],"
                           "'scale':[2,3,4]},{'mesh':0}],"
                           "'meshes':[{'primitives':[{'attributes':{'POSITION':0,'NORMAL':0}}]}]}",
                  &b));
    static const double expected[9][3] = {{1, 0, 0},
                                          {0, 1, 0},
                                          {0, 0, 1},
                                          {4000000.125, 2, 1},
                                          {4000000.125 - 3, 0, 1},
                                          {4000000.125, 0, 5},
                                          {4000005.125, 8, 7},
                                          {4000005.125 - 3, 6, 7},
                                          {4000005.125, 6, 11}};
    assert_int_equal(f.scan.totals.vertices, 9);
    obj_assert_corners(&f, FMT_MESH_VERTEX, 9, 0, 1, 2, 3, 4, 5, 6, 7, 8);
    obj_assert_corners(&f, FMT_MESH_NORMAL, 9, 0, 1, 2, 3, 4, 5, 6, 7, 8);
    for (int i = 0; i < 9; i++)
        for (int k = 0; k < 3; k++)
            assert_near(f.scan.positions[i][k], expected[i][k], 1e-6);
    /* Normals keep right angles: those of axes stay on axes. */
    static const float axes[3][3] = {{0, 1, 0}, {-1, 0, 0}, {0, 0, 1}};
    for (int i = 3; i < 9; i++)
        for (int k = 0; k < 3; k++) {
            const float *n = f.scan.normals[i];
            const float length = sqrtf(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
            assert_near(n[k] / length, axes[i % 3][k], 1e-6);
        }
    obj_close(&f);
    ply_free(&b);
}

/* A slanted surface keeps its normal at a right angle when a node scales one axis; also when that
 * mirrors. */
TEST(test_scaled_normals)
{
    static const char *const scales[] = {"[5,1,1]", "[-5,1,1]"};
    for (int i = 0; i < 2; i++) {
        struct obj_fixture f;
        struct ply_builder b;
        char json[1000];
        gltf_begin(&b);
        ply_put(&b, "fffffffff", 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0);
        for (int v = 0; v < 3; v++)
            ply_put(&b, "fff", 1.0, 1.0, 1.0);
        snprintf(
            json, sizeof json,
            HEAD FILE_BUFFER(
                "scan") "'nodes':[{'mesh':0,'scale':%s}],"
                        "'bufferViews':[{'buffer':0,'byteLength':$BYTES}],"
                        "'accessors':[{'bufferView':0,'componentType':5126,'count':3,'type':'VEC3'},"
                        "{'bufferView':0,'byteOffset':36,'componentType':5126,'count':3,'type':'VEC3'}],"
                        "'meshes':[{'primitives':[{'attributes':{'POSITION':0,'NORMAL':1}}]}]}",
            scales[i]);
        gltf_read(&f, gltf_write("scan", json, &b));
        const double(*p)[3] = (const double(*)[3])f.scan.positions;
        const uint64_t *c = f.scan.corners[FMT_MESH_VERTEX];
        double e[2][3], dot = 0;
        for (int k = 0; k < 3; k++) {
            e[0][k] = p[c[1]][k] - p[c[0]][k];
            e[1][k] = p[c[2]][k] - p[c[0]][k];
        }
        const double cross[3] = {e[0][1] * e[1][2] - e[0][2] * e[1][1],
                                 e[0][2] * e[1][0] - e[0][0] * e[1][2],
                                 e[0][0] * e[1][1] - e[0][1] * e[1][0]};
        const float *n = f.scan.normals[0];
        double lengths[2] = {0, 0};
        for (int k = 0; k < 3; k++) {
            dot += cross[k] * (double)n[k];
            lengths[0] += cross[k] * cross[k];
            lengths[1] += (double)n[k] * (double)n[k];
        }
        assert_near(dot / sqrt(lengths[0] * lengths[1]), 1, 1e-6);
        obj_close(&f);
        ply_free(&b);
    }
}

/* ---- files ---- */

#define MESH "'meshes':[{'primitives':[{'attributes':{'POSITION':0}}]}]}"

/* A buffer in a GLB file, in a file with odd characters in its name, and in a data URI. */
TEST(test_buffers)
{
    static const char base64[] =
        HEAD "'buffers':[{'byteLength':37,'uri':'data:application/octet-stream;base64,"
             /* one byte, then (0, 0, 0), (1, 2, -1), (2, 4, -2) */
             "/wAAAAAAAAAAAAAAAAAAgD8AAABAAACAvwAAAEAAAIBAAAAAwA=='}],"
             "'bufferViews':[{'buffer':0,'byteOffset':1,'byteLength':36}],"
             "'accessors':[{'bufferView':0,'componentType':5126,'count':3,'type':'VEC3'}]," MESH;
    struct obj_fixture f;
    struct ply_builder b;
    gltf_begin(&b);
    put_vertices(&b, 3);
    gltf_read(
        &f, gltf_write_glb("scan", HEAD "'buffers':[{'byteLength':36}]," POSITIONS("3") MESH, &b));
    assert_vertices(&f, 3);
    obj_close(&f);
    test_bytes("a b#1.bin", b.bytes, b.size);
    gltf_read(&f, gltf_write("scan",
                             HEAD "'buffers':[{'byteLength':36,'uri':'a%20b%231.bin'}],"
                                  "'bufferViews':[{'buffer':0,'byteLength':36}],"
                                  "'accessors':[{'bufferView':0,'componentType':5126,'count':3,"
                                  "'type':'VEC3'}]," MESH,
                             NULL));
    assert_vertices(&f, 3);
    obj_close(&f);
    gltf_read(&f, gltf_write("scan", base64, NULL));
    assert_vertices(&f, 3);
    obj_close(&f);
    ply_free(&b);
}

/* A texture beside the file, in a data URI and in a view, with a transform; its coordinates are set
 * 1 of the file. */
TEST(test_textures)
{
    static const char *const images[] = {"'uri':'wall%20a.png'",
                                         "'uri':'data:image/png;base64,iVBORw0='",
                                         "'bufferView':1,'mimeType':'image/png'"};
    for (int i = 0; i < 3; i++) {
        struct obj_fixture f;
        struct ply_builder b;
        struct fmt_materials materials;
        char json[1600];
        gltf_begin(&b);
        put_vertices(&b, 3);
        ply_put(&b, "ffffff", 0.0, 0.0, 0.25, 0.5, 1.0, 1.0);
        test_text("wall a.png", "no image");
        snprintf(json, sizeof json,
                 HEAD FILE_BUFFER("scan") SCENE
                 ",'bufferViews':[{'buffer':0,'byteLength':60},{'buffer':0,'byteOffset':8,"
                 "'byteLength':5}],"
                 "'accessors':[{'bufferView':0,'componentType':5126,'count':3,'type':'VEC3'},"
                 "{'bufferView':0,'byteOffset':36,'componentType':5126,'count':3,'type':'VEC2'}],"
                 "'images':[{%s}],'textures':[{},{'source':0}],"
                 "'materials':[{'name':'a','pbrMetallicRoughness':{'baseColorFactor':[1,0.5,0,1]},"
                 "'emissiveFactor':[1,0.5,0],'extensions':{'KHR_materials_emissive_strength':{"
                 "'emissiveStrength':4}}},"
                 "{'name':'b','pbrMetallicRoughness':{'baseColorTexture':{'index':1,'texCoord':4,"
                 "'extensions':{'KHR_texture_transform':{'offset':[0.5,0.125],'scale':[2,3],"
                 "'rotation':1.5707963267948966,'texCoord':1}}}}}],"
                 "'meshes':[{'primitives':[{'attributes':{'POSITION':0,'TEXCOORD_1':1},"
                 "'material':1}]}]}",
                 images[i]);
        gltf_read(&f, gltf_write("scan", json, &b));
        assert_int_equal(fmt_mesh_read_materials(f.reader, &materials), 0);
        assert_int_equal(materials.count, 2);
        assert_true(materials.list[0].color.has_value && !materials.list[1].color.has_value);
        assert_near(materials.list[0].color.value[1], 1.055 * pow(0.5, 1 / 2.4) - 0.055, 1e-6);
        const struct fmt_material_channel *emission =
            fmt_material_find_channel(&materials.list[0], "emission");
        assert_true(emission->value[0] == 4 && emission->value[1] == 2 && emission->value[2] == 0);
        static const char *const names[] = {"wall a.png",
                                            "scan.gltf#base64=", "scan.bin#bytes=8+5"};
        assert_non_null(strstr(materials.list[1].color.texture_path, names[i]));
        fmt_materials_free(f.ctx, &materials);
        obj_assert_material(&f, f.scan.materials[0], "b");
        /* u' = 3 v + 0.5 and v' = -2 u + 0.125, and v upwards. */
        const double expected[3][2] = {{0.5, 0.875}, {2, 1.375}, {3.5, 2.875}};
        for (int v = 0; v < 3; v++)
            for (int k = 0; k < 2; k++)
                assert_near(f.scan.texcoords[v][k], expected[v][k], 1e-6);
        obj_close(&f);
        ply_free(&b);
    }
}

/* An object is a node with a mesh: it has the node's name, or else the mesh's. */
TEST(test_objects)
{
    static const char *const objects[] = {"left", "left", "wheel", "wheel", "right", ""};
    static const char *const materials[] = {"a", "", "a", "", "a", ""};
    struct ply_builder b;
    gltf_begin(&b);
    put_vertices(&b, 3);
    const char *path = gltf_write(
        "scan",
        HEAD FILE_BUFFER(
            "scan") "'scenes':[{'nodes':[0,1,2,3]}],'materials':[{'name':'a'}],"
                    "'nodes':[{'mesh':0,'name':'left'},{'mesh':0},{'mesh':1,'name':'right'},{'mesh':2}],"
                    "'bufferViews':[{'buffer':0,'byteLength':$BYTES}],"
                    "'accessors':[{'bufferView':0,'componentType':5126,'count':3,'type':'VEC3'}],"
                    "'meshes':[{'name':'wheel','primitives':[{'attributes':{'POSITION':0},'material':0},"
                    "{'attributes':{'POSITION':0}}]},"
                    "{'name':'x','primitives':[{'attributes':{'POSITION':0},'material':0}]},"
                    "{'primitives':[{'attributes':{'POSITION':0}}]}]}",
        &b);
    struct bsq_ctx_options options = {.threads = 2, .memory_bytes = 64 << 20};
    struct fmt_mesh_reader *reader;
    struct fmt_mesh_totals totals;
    struct fmt_materials parts;
    struct bsq_ctx *ctx;
    uint32_t numbers[8], *end = numbers;
    assert_int_equal(bsq_ctx_create(&options, &ctx), 0);
    assert_int_equal(fmt_mesh_open(ctx, &path, 1, &reader), 0);
    fmt_mesh_use_objects(reader);
    assert_int_equal(fmt_mesh_read(reader, keep_material, &end, &totals), 0);
    assert_int_equal(end - numbers, 6);
    assert_int_equal(fmt_mesh_read_materials(reader, &parts), 0);
    assert_int_equal(parts.count, totals.materials);
    for (int i = 0; i < 6; i++) {
        assert_string_equal(parts.list[numbers[i]].object, objects[i]);
        assert_string_equal(parts.list[numbers[i]].name, materials[i]);
    }
    fmt_materials_free(ctx, &parts);
    fmt_mesh_close(reader);
    test_context_end(ctx);
    ply_free(&b);
}

RUN_TESTS(NULL, NULL)
