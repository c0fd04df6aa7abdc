// scene_check.cc - makes scenes of Assimp's structures from bytes, writes them as the program
// bisque-scene does, and reads what it wrote.
//
// Assimp's own importers are not fuzzed: some never end for damaged files (docs/decisions/0031).
// What they may hand over is tested here, and more than their validation lets through.
#include "tests/fuzz/scene_check.h"

#include <memory>

// Its functions have no other door than the program, which takes files.
#define main scene_main
#include "formats/mesh/scene_assimp.cc"
#undef main

extern "C" {
#include "formats/mesh/mesh_reader.h"
}
#include "tests/fuzz/fuzz_file.h"

namespace
{

// The input; zeros follow after its end.
struct Bytes {
    const uint8_t *data;
    size_t size;

    // Returns a number from 0 to limit - 1; 0 if limit is 0.
    unsigned below(unsigned limit)
    {
        const unsigned value = size > 0 ? *data : 0;
        data += size > 0;
        size -= size > 0;
        return limit > 0 ? value % limit : 0;
    }
    // Returns a number of any size, or one that is not finite.
    float number()
    {
        static const float special[] = {NAN, INFINITY, -INFINITY, 3e38F, 1e-40F, 0, -1, 1};
        const unsigned kind = below(4);
        return kind == 0 ? special[below(8)] : float(int(below(256)) - 128) / float(1U << 3 * kind);
    }
    aiVector3D vector()
    {
        const float x = number(), y = number();
        return aiVector3D(x, y, number());
    }
    aiString name()
    {
        const char text[] = {char(below(256)), char(below(256)), 0};
        return aiString(text);
    }
};

aiVector3D *make_vectors(Bytes &bytes, unsigned count)
{
    auto *list = new aiVector3D[count];
    for (unsigned i = 0; i < count; i++)
        list[i] = bytes.vector();
    return list;
}

aiMesh *make_mesh(Bytes &bytes)
{
    auto *mesh = new aiMesh;
    const unsigned arrays = bytes.below(8);
    mesh->mNumVertices = bytes.below(12);
    mesh->mVertices = make_vectors(bytes, mesh->mNumVertices);
    if (arrays & 1)
        mesh->mNormals = make_vectors(bytes, mesh->mNumVertices);
    if (arrays & 2)
        mesh->mTextureCoords[0] = make_vectors(bytes, mesh->mNumVertices);
    if (bytes.below(4) == 1) {
        mesh->mColors[0] = new aiColor4D[mesh->mNumVertices];
        for (unsigned i = 0; i < mesh->mNumVertices; i++)
            mesh->mColors[0][i] = aiColor4D(bytes.number(), bytes.number(), bytes.number(), 1);
    }
    if (arrays & 4) {
        mesh->mTangents = make_vectors(bytes, mesh->mNumVertices);
        mesh->mBitangents = make_vectors(bytes, mesh->mNumVertices);
    }
    mesh->mMaterialIndex = bytes.below(4);
    mesh->mNumFaces = bytes.below(8);
    mesh->mFaces = new aiFace[mesh->mNumFaces];
    for (unsigned f = 0; f < mesh->mNumFaces; f++) {
        aiFace &face = mesh->mFaces[f];
        face.mNumIndices = bytes.below(7);
        face.mIndices = new unsigned[face.mNumIndices];
        for (unsigned i = 0; i < face.mNumIndices; i++) // one beyond the last is wrong
            face.mIndices[i] = bytes.below(mesh->mNumVertices + (bytes.below(64) == 63));
    }
    return mesh;
}

// depth: of nodes below this one.
aiNode *make_node(Bytes &bytes, unsigned depth)
{
    auto *node = new aiNode;
    node->mName = bytes.name();
    for (unsigned i = 0; i < 12 && bytes.below(4) > 0; i++)
        node->mTransformation[i / 4][i % 4] = bytes.number();
    node->mNumMeshes = bytes.below(3);
    node->mMeshes = new unsigned[node->mNumMeshes];
    for (unsigned i = 0; i < node->mNumMeshes; i++)
        node->mMeshes[i] = bytes.below(4);
    const unsigned children = depth > 0 ? bytes.below(3) : 0;
    node->mChildren = new aiNode *[children];
    for (; node->mNumChildren < children; node->mNumChildren++)
        node->mChildren[node->mNumChildren] = make_node(bytes, depth - 1);
    return node;
}

std::unique_ptr<aiScene> make_scene(Bytes &bytes)
{
    std::unique_ptr<aiScene> scene(new aiScene);
    const unsigned meshes = bytes.below(4), materials = bytes.below(4);
    scene->mMeshes = new aiMesh *[meshes];
    for (; scene->mNumMeshes < meshes; scene->mNumMeshes++)
        scene->mMeshes[scene->mNumMeshes] = make_mesh(bytes);
    scene->mMaterials = new aiMaterial *[materials];
    for (; scene->mNumMaterials < materials; scene->mNumMaterials++) {
        auto *material = new aiMaterial;
        const aiString name = bytes.name();
        material->AddProperty(&name, AI_MATKEY_NAME);
        const unsigned kinds = bytes.below(4);
        const aiColor3D color(bytes.number(), 0.5F, 0);
        const aiString texture = bytes.name();
        if (kinds & 1)
            material->AddProperty(&color, 1, AI_MATKEY_COLOR_DIFFUSE);
        if (kinds & 2)
            material->AddProperty(&texture, AI_MATKEY_TEXTURE(aiTextureType_DIFFUSE, 0));
        scene->mMaterials[scene->mNumMaterials] = material;
    }
    scene->mRootNode = bytes.below(16) > 0 ? make_node(bytes, 3) : nullptr;
    return scene;
}

// What was written.
struct Written {
    const char *bytes;
    uint64_t size;
};

int read_written(void *user, void *to, uint64_t count, uint64_t offset)
{
    const auto *from = static_cast<const Written *>(user);
    require(offset <= from->size && count <= from->size - offset, "bytes that are not there");
    memcpy(to, from->bytes + offset, count);
    return 0;
}

// Checks that the meshes can be read, and that no face is lost. `faces` and `vertices` are those of
// the scene.
int check_meshes(struct bsq_ctx *ctx, const Written &meshes, uint64_t vertices, uint64_t faces)
{
    const bsq_source source = {sizeof source, meshes.size, read_written,
                               const_cast<Written *>(&meshes)};
    const bsq_source *const sources = &source;
    const char *const path = "meshes.obj";
    fmt_mesh_inputs inputs = {};
    inputs.paths = &path;
    inputs.sources = &sources;
    inputs.path_count = 1;
    fmt_mesh_reader *reader = nullptr;
    fmt_mesh_totals totals = {};
    int status = fmt_mesh_open_inputs(ctx, &inputs, &reader);
    if (!status)
        status = fmt_mesh_read(reader, nullptr, nullptr, &totals);
    require(status != BSQ_EDATA, "meshes that were written cannot be read");
    require(status || (totals.vertices == vertices && totals.faces + totals.short_faces == faces),
            "vertices or faces are lost");
    fmt_mesh_close(reader);
    return status;
}

} // namespace

extern "C" int fuzz_scene(struct bsq_ctx *ctx, const uint8_t *data, size_t size)
{
    Bytes bytes = {data, size};
    const std::unique_ptr<aiScene> made = make_scene(bytes);
    char *file = nullptr;
    size_t file_size = 0;
    uint64_t vertices = 0, faces = 0;
    FILE *to = open_memstream(&file, &file_size);
    int status = 0;
    try {
        write_scene(*made, false, 0, to);
    } catch (const std::exception &error) {
        status = bsq_fail(ctx, BSQ_EDATA, "%s", error.what());
    }
    fclose(to);
    for (const Place &place : find_places(*made)) {
        vertices += place.mesh->mNumVertices;
        faces += place.mesh->mNumFaces;
    }
    if (status == 0) {
        fmt_scene_head head = {};
        require(file_size >= sizeof head, "a file without its head");
        memcpy(&head, file, sizeof head);
        require(head.material_bytes <= file_size - sizeof head, "materials beyond the file");
        const uint64_t before = sizeof head + head.material_bytes;
        status = check_meshes(ctx, {file + before, file_size - before}, vertices, faces);
    }
    free(file);
    return status;
}
