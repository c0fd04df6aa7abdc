/* test_gltf_damage.c - the glTF reader's messages for wrong files, and damaged files. */
#include <sys/stat.h>

#include "tests/unit/formats/mesh/gltf_builder.h"
#include "tests/unit/test.h"

#define HEAD     "{'asset':{'version':'2.0'},"
#define BUFFER   HEAD "'buffers':[{'uri':'bad.bin','byteLength':36}],"
#define VIEW     BUFFER "'bufferViews':[{'buffer':0,'byteLength':36}],"
#define ACCESSOR VIEW "'accessors':[{'bufferView':0,'componentType':5126,'count':3,'type':'VEC3'}],"
#define MESH     ACCESSOR "'meshes':[{'primitives':[{'attributes':{'POSITION':0}}]}],"

static void put_triangle(struct ply_builder *b)
{
    gltf_begin(b);
    ply_put(b, "fffffffff", 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0);
}

TEST(test_messages)
{
    static const struct {
        const char *json, *message;
    } cases[] = {
        {"{'asset':{}}", "bad.gltf: not a glTF file: it has no asset.version"},
        {"{'asset':{'version':'1.0'}}", "bad.gltf: glTF version 1.0 is not read, only 2.0"},
        {"{'asset':{'version':'2.1','minVersion':'2.1'}}",
         "bad.gltf: glTF version 2.1 is not read, only 2.0"},
        {"['asset']", "bad.gltf: not a glTF file: its JSON is no object"},
        {HEAD "\n'a':}", "bad.gltf: JSON, line 2: unexpected token near '}'"},
        {HEAD "'extensionsRequired':['KHR_texture_transform','ABC_x','DEF_y']}",
         "bad.gltf: needs extensions that are not read: ABC_x, DEF_y"},
        {HEAD "'buffers':[{'uri':'bad.bin'}]}", "bad.gltf: buffers[0]: \"byteLength\" is missing"},
        {HEAD "'buffers':[{'uri':'bad.bin','byteLength':-1}]}",
         "bad.gltf: buffers[0]: \"byteLength\" is no whole number from 0 to 2305843009213693951"},
        {HEAD "'buffers':[{'uri':'bad.bin','byteLength':37}]}",
         "bad.gltf: buffers[0]: truncated: it should have 37 bytes, there are 36"},
        {HEAD "'buffers':[{'byteLength':1}]}",
         "bad.gltf: buffers[0]: truncated: it should have 1 bytes, there are 0"},
        {HEAD "'buffers':[{'uri':'https://a.example/b.bin','byteLength':1}]}",
         "bad.gltf: buffers[0]: its URI \"https://a.example/b.bin\" names no file"},
        {HEAD "'buffers':[{'uri':'data:text/plain,abc','byteLength':1}]}",
         "bad.gltf: buffers[0]: its URI \"data:text/plain,abc\" names no file"},
        {HEAD "'buffers':[{'uri':'data:;base64,AAAA','byteLength':4}]}",
         "bad.gltf: buffers[0]: truncated: it should have 4 bytes, there are 3"},
        {HEAD "'buffers':[{'uri':'data:#9+99999','byteLength':4}]}",
         "bad.gltf: buffers[0]: its data URI is outside of the file"},
        {BUFFER "'bufferViews':[{'buffer':1,'byteLength':1}]}",
         "bad.gltf: bufferViews[0]: \"buffer\" refers to buffers[1], the file has 1"},
        {BUFFER "'bufferViews':[{'buffer':0,'byteLength':30,'byteOffset':7}]}",
         "bad.gltf: bufferViews[0]: bytes 7 to 37 are outside of buffers[0], which has 36"},
        {BUFFER "'bufferViews':[{'buffer':0,'byteLength':30,'byteStride':253}]}",
         "bad.gltf: bufferViews[0]: \"byteStride\" is no whole number from 0 to 252"},
        {VIEW "'accessors':[{'bufferView':0,'componentType':5126,'count':4,'type':'VEC3'}]}",
         "bad.gltf: accessors[0]: 4 elements of 12 bytes are too many for bufferViews[0], which has "
         "36 bytes"},
        {VIEW "'accessors':[{'bufferView':0,'componentType':5126,'count':2305843009213693951,"
              "'type':'VEC3'}]}",
         "bad.gltf: accessors[0]: 2305843009213693951 elements of 12 bytes are too many for "
         "bufferViews[0], which has 36 bytes"},
        {VIEW "'accessors':[{'bufferView':0,'byteOffset':40,'componentType':5126,'count':1,"
              "'type':'VEC3'}]}",
         "bad.gltf: accessors[0]: 1 elements of 12 bytes are too many for bufferViews[0], which has "
         "36 bytes"},
        {VIEW "'accessors':[{'componentType':5126,'count':100000000,'type':'VEC3'}],"
              "'meshes':[{'primitives':[{'attributes':{'POSITION':0}}]}]}",
         "bad.gltf: meshes[0]: accessors[0] has 100000000 elements without data, which are too "
         "many"},
        {VIEW "'accessors':[{'bufferView':0,'componentType':5124,'count':1,'type':'VEC3'}]}",
         "bad.gltf: accessors[0]: unknown componentType 5124"},
        {VIEW "'accessors':[{'bufferView':0,'componentType':5126,'count':1,'type':'VEC5'}]}",
         "bad.gltf: accessors[0]: unknown type \"VEC5\""},
        {VIEW "'accessors':[{'componentType':5126,'count':5,'type':'VEC3','sparse':{'count':2,"
              "'indices':{'bufferView':0,'componentType':5121},'values':{'bufferView':0}}}],"
              "'meshes':[{'primitives':[{'attributes':{'POSITION':0}}]}]}",
         "bad.gltf: meshes[0]: accessors[0] is sparse, which is not read: save the file by Blender "
         "or gltfpack"},
        {ACCESSOR "'meshes':[{'primitives':[{'attributes':{'POSITION':1}}]}]}",
         "bad.gltf: meshes[0]: \"POSITION\" refers to accessors[1], the file has 1"},
        {ACCESSOR "'meshes':[{'primitives':[{'attributes':{'POSITION':0,'TEXCOORD_0':0}}]}]}",
         "bad.gltf: meshes[0]: TEXCOORD_0 has another number of components"},
        {ACCESSOR "'meshes':[{'primitives':[{'attributes':{'POSITION':0},'mode':7}]}]}",
         "bad.gltf: meshes[0]: \"mode\" is no whole number from 0 to 6"},
        {ACCESSOR "'meshes':[{'primitives':[{'attributes':{'POSITION':0},'indices':0}]}]}",
         "bad.gltf: meshes[0]: its indices are no unsigned integers"},
        {MESH "'nodes':[{'mesh':1}]}",
         "bad.gltf: nodes[0]: \"mesh\" refers to meshes[1], the file has 1"},
        {MESH "'nodes':[{'mesh':0,'scale':[1,2]}]}",
         "bad.gltf: nodes[0]: \"scale\" is no list of 3 numbers"},
        {MESH "'scenes':[{'nodes':[0]}],'nodes':[{'children':[1]},{'children':[0]}]}",
         "bad.gltf: nodes[1]: nodes[0] occurs twice in the hierarchy"},
        {MESH "'scenes':[{'nodes':[0]}],'nodes':[{'children':[0]}]}",
         "bad.gltf: nodes[0]: nodes[0] occurs twice in the hierarchy"},
        {MESH "'scenes':[{'nodes':[0,1]}],'nodes':[{'children':[2]},{'children':[2]},{'mesh':0}]}",
         "bad.gltf: nodes[1]: nodes[2] occurs twice in the hierarchy"},
        {MESH "'scenes':[{'nodes':[0.0]}],'nodes':[{'mesh':0.0,'children':[0.0]}]}",
         "bad.gltf: nodes[0]: nodes[0] occurs twice in the hierarchy"},
        {MESH "'scenes':[{'nodes':[7]}],'nodes':[{'mesh':0}]}",
         "bad.gltf: scenes[0]: refers to a node that does not exist"},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct ply_builder b;
        put_triangle(&b);
        gltf_expect_error(gltf_write("bad", cases[i].json, &b), cases[i].message);
        ply_free(&b);
    }
}

/* Wrong values in buffers. */
TEST(test_values)
{
    struct ply_builder b;
    put_triangle(&b);
    b.bytes[2] = (char)0x80; /* infinity */
    b.bytes[3] = 0x7f;
    struct obj_fixture f;
    gltf_read(&f, gltf_write("bad", MESH "'nodes':[{'mesh':0}]}", &b));
    for (int k = 0; k < 3; k++)
        assert_true(isnan(f.scan.positions[0][k]) && isfinite(f.scan.positions[1][k]));
    obj_close(&f);
    gltf_read(&f, gltf_write("bad",
                             MESH "'nodes':[{'mesh':0,'scale':[1,1,1e300],'children':[1]},"
                                  "{'mesh':0,'translation':[0,0,1e300]}]}",
                             &b));
    assert_true(isnan(f.scan.positions[3][0]) && isnan(f.scan.positions[4][2]));
    obj_close(&f);
    b.bytes[2] = b.bytes[3] = 0;
    b.bytes[0] = 1;
    b.bytes[1] = 7;
    gltf_expect_error(gltf_write("bad",
                                 VIEW "'accessors':[{'bufferView':0,'componentType':5126,'count':3,"
                                      "'type':'VEC3'},{'bufferView':0,'componentType':5121,"
                                      "'count':3,'type':'SCALAR'}],'meshes':[{'primitives':[{"
                                      "'attributes':{'POSITION':0},'indices':1}]}]}",
                                 &b),
                      "bad.gltf: meshes[0], primitive 0: triangle 0 refers to vertex 7, there are "
                      "3");
    ply_free(&b);
    gltf_expect_error(gltf_write("bad",
                                 HEAD "'buffers':[{'byteLength':36,'uri':'data:;base64,"
                                      "AAAAAAAAAAAAA*AAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAA'}],"
                                      "'bufferViews':[{'buffer':0,'byteLength':36}],"
                                      "'accessors':[{'bufferView':0,'componentType':5126,"
                                      "'count':3,'type':'VEC3'}],"
                                      "'meshes':[{'primitives':[{'attributes':{'POSITION':0}}]}]}",
                                 NULL),
                      "bad.gltf: byte 87: malformed base64");
    gltf_expect_error(gltf_write("bad",
                                 HEAD "'buffers':[{'byteLength':36,'uri':'data:;base64,"
                                      "AAAAAAAAAAAAA\\/AAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAA'}],"
                                      "'bufferViews':[{'buffer':0,'byteLength':36}],"
                                      "'accessors':[{'bufferView':0,'componentType':5126,"
                                      "'count':3,'type':'VEC3'}],"
                                      "'meshes':[{'primitives':[{'attributes':{'POSITION':0}}]}]}",
                                 NULL),
                      "bad.gltf: byte 87: escapes in base64 are not read");
}

/* Buffers that are no regular files. */
TEST(test_buffer_files)
{
    static const char *const names[] = {"missing", "folder"};
    assert_int_equal(mkdir("folder.bin", 0777), 0);
    for (size_t i = 0; i < sizeof names / sizeof *names; i++) {
        struct obj_fixture f;
        char json[200];
        snprintf(json, sizeof json, HEAD "'buffers':[{'uri':'%s.bin','byteLength':36}]}", names[i]);
        const char *path = gltf_write("bad", json, NULL);
        obj_read_files(&f, 1, 1, &path);
        assert_int_equal(f.status, BSQ_ENOINPUT);
        assert_non_null(strstr(bsq_error(f.ctx), names[i]));
        obj_close(&f);
    }
}

/* Accessors that no mesh uses may be sparse. */
TEST(test_sparse_matrices)
{
    struct obj_fixture f;
    struct ply_builder b;
    put_triangle(&b);
    gltf_read(&f, gltf_write("bad",
                             VIEW "'accessors':[{'bufferView':0,'componentType':5126,'count':3,"
                                  "'type':'VEC3'},{'componentType':5126,'count':3,'type':'MAT4',"
                                  "'sparse':{'count':2,'indices':{'bufferView':0,"
                                  "'componentType':5121},'values':{'bufferView':0}}}],"
                                  "'meshes':[{'primitives':[{'attributes':{'POSITION':0}}]}]}",
                             &b));
    assert_int_equal(f.scan.totals.faces, 1);
    obj_close(&f);
    ply_free(&b);
}

/* A hierarchy as deep as there are nodes needs no deep recursion. */
TEST(test_deep_hierarchy)
{
    enum { DEPTH = 30000 };
    struct obj_fixture f;
    struct ply_builder b;
    char *json = NULL;
    size_t size;
    FILE *out = open_memstream(&json, &size);
    assert_non_null(out);
    fputs(MESH "'scenes':[{'nodes':[0]}],'nodes':[", out);
    for (int i = 1; i < DEPTH; i++)
        fprintf(out, "{'children':[%d],'translation':[1,0,0]},", i);
    fputs("{'mesh':0}]}", out);
    fclose(out);
    put_triangle(&b);
    gltf_read(&f, gltf_write("bad", json, &b));
    assert_true(f.scan.positions[0][0] == DEPTH - 1);
    obj_close(&f);
    ply_free(&b);
    free(json);
}

/* Reads a file in a context with a budget in MiB. Whatever happens, all memory is returned. */
static int read_within(const char *path, uint64_t mib)
{
    struct fmt_mesh_reader *reader = NULL;
    struct fmt_mesh mesh;
    struct bsq_ctx *ctx = test_context(1, mib << 20);
    int status = fmt_mesh_open(ctx, &path, 1, &reader);
    if (!status)
        status = fmt_mesh_read(reader, NULL, NULL, NULL);
    fmt_mesh_close(reader);
    if (!status)
        status = fmt_mesh_load(ctx, path, false, &mesh);
    if (!status)
        fmt_mesh_free(ctx, &mesh);
    assert_int_equal(bsq_memory_used(ctx), 0);
    assert_true(bsq_memory_high(ctx) <= mib << 20);
    assert_true(status == 0 || (bsq_error(ctx)[0] && !strchr(bsq_error(ctx), '\n')));
    bsq_ctx_destroy(ctx);
    return status;
}

/* JSON that takes much memory for its length is refused before. */
TEST(test_memory)
{
    enum { COUNT = 400000 };
    char *json = malloc(3 * COUNT + 100);
    assert_non_null(json);
    char *end = json + sprintf(json, HEAD "'a':[");
    for (int i = 0; i < COUNT; i++)
        end += sprintf(end, "{},");
    sprintf(end, "0]}");
    assert_int_equal(read_within(gltf_write("bad", json, NULL), 16), BSQ_ENOMEM);
    memset(json, '[', 100000);
    json[100000] = '\0';
    const char *path = test_text("deep.gltf", json);
    assert_int_equal(read_within(path, 256), BSQ_EDATA);
    free(json);
}

static void assert_handled(int status)
{
    assert_true(status == 0 || status == BSQ_EDATA || status == BSQ_ENOINPUT ||
                status == BSQ_ENOMEM);
}

/* A GLB file with all kinds of tables, cut off and damaged at many places. */
TEST(test_damage)
{
    static const char json[] = HEAD
        "'scene':0,'scenes':[{'nodes':[0]}],'nodes':[{'children':[1]},{'mesh':0,"
        "'rotation':[0,0,0,1]}],'buffers':[{'byteLength':$BYTES}],"
        "'bufferViews':[{'buffer':0,'byteLength':36,'byteStride':12},{'buffer':0,'byteOffset':36,"
        "'byteLength':3}],'accessors':[{'bufferView':0,'componentType':5126,'count':3,"
        "'type':'VEC3'},{'bufferView':1,'componentType':5121,"
        "'count':3,'type':'SCALAR'}],'images':[{'uri':'data:;base64,AAAA'}],"
        "'textures':[{'source':0}],'materials':[{'name':'m','pbrMetallicRoughness':{"
        "'baseColorFactor':[1,0,0,1],'baseColorTexture':{'index':0,'extensions':{"
        "'KHR_texture_transform':{'rotation':1}}}}}],'meshes':[{'primitives':[{'attributes':{"
        "'POSITION':0,'NORMAL':0,'COLOR_0':0},'indices':1,'material':0}]}]}";
    struct ply_builder b;
    size_t size;
    put_triangle(&b);
    ply_put(&b, "CCC", 0.0, 1.0, 2.0);
    char *file = gltf_make_glb(json, &b, &size);
    assert_int_equal(read_within(test_bytes("bad.glb", file, size), 64), 0);
    for (size_t length = 0; length < size; length += length < 32 ? 1 : 7) {
        char *copy = malloc(length + 1); /* of its exact size, for the sanitizer */
        memcpy(copy, file, length);
        assert_int_equal(read_within(test_bytes("bad.glb", copy, length), 64), BSQ_EDATA);
        free(copy);
    }
    for (size_t i = 0; i < size; i += i < 32 ? 1 : 3) {
        static const char masks[] = {1, 4, 16, (char)128};
        const char before = file[i];
        file[i] = (char)(before ^ masks[i % sizeof masks]);
        assert_handled(read_within(test_bytes("bad.glb", file, size), 64));
        file[i] = before;
    }
    free(file);
    ply_free(&b);
}

RUN_TESTS(NULL, NULL)
