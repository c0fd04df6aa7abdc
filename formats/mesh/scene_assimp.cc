// scene_assimp.cc - the program bisque-scene, which reads meshes of many formats by Assimp.
//
// scene_reader.c runs it: damaged files make Assimp crash, loop, or take any amount of memory. So
// it has limits of memory and time, and can open no file: what the file refers to is never read.
// The file is its standard input, and what scene_file.h describes its standard output.
#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <new>
#include <stdexcept>
#include <string>
#include <vector>

#include <sys/resource.h>
#include <unistd.h>

#include <assimp/Importer.hpp>
#include <assimp/config.h>
#include <assimp/material.h>
#include <assimp/postprocess.h>
#include <assimp/scene.h>

#include "formats/mesh/scene_file.h"

namespace
{

// ---- places of meshes ----

struct Matrix {
    double m[3][4];
};

Matrix multiply(const Matrix &a, const aiMatrix4x4 &b)
{
    Matrix out;
    for (unsigned i = 0; i < 3; i++)
        for (unsigned k = 0; k < 4; k++)
            out.m[i][k] = a.m[i][0] * double(b[0][k]) + a.m[i][1] * double(b[1][k]) +
                          a.m[i][2] * double(b[2][k]) + (k == 3 ? a.m[i][3] : 0);
    return out;
}

struct Place {
    const aiMesh *mesh;
    Matrix matrix;
    const aiNode *node;
};

// Returns how the axes and the unit of an FBX file become x to the right, y upwards, and metres, as
// Assimp does for other formats. Its factor counts in centimetres.
Matrix find_axes(const aiMetadata *data)
{
    static const char *const names[] = {"CoordAxis", "UpAxis", "FrontAxis"};
    Matrix out = {{{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 0}}}, turned = {};
    float unit = 0;
    int used = 0;
    for (int i = 0; data && i < 3; i++) {
        int32_t axis = 0, sign = 0;
        if (data->Get(names[i], axis) && data->Get(std::string(names[i]) + "Sign", sign) &&
            axis >= 0 && axis < 3 && (sign == 1 || sign == -1)) {
            turned.m[i][axis] = sign;
            used |= 1 << axis;
        }
    }
    if (used == 7)
        out = turned;
    if (data && data->Get("UnitScaleFactor", unit) && std::isfinite(unit) && unit > 0)
        for (auto &row : out.m)
            std::transform(row, row + 3, row,
                           [=](double value) { return value * double(unit) / 100; });
    return out;
}

// Returns the meshes, node by node.
std::vector<Place> find_places(const aiScene &scene)
{
    std::vector<Place> places;
    std::vector<std::pair<const aiNode *, Matrix>> stack;
    if (scene.mRootNode)
        stack.emplace_back(scene.mRootNode, find_axes(scene.mMetaData));
    while (!stack.empty()) {
        const aiNode *node = stack.back().first;
        const Matrix matrix = multiply(stack.back().second, node->mTransformation);
        stack.pop_back();
        for (unsigned i = 0; i < node->mNumMeshes; i++)
            if (node->mMeshes[i] < scene.mNumMeshes)
                places.push_back({scene.mMeshes[node->mMeshes[i]], matrix, node});
        for (unsigned i = node->mNumChildren; i-- > 0;)
            stack.emplace_back(node->mChildren[i], matrix);
    }
    return places;
}

// ---- writing ----

void put(FILE *to, const void *from, size_t size)
{
    if (size > 0)
        fwrite(from, size, 1, to);
}

void write_positions(FILE *to, const Place &place)
{
    const auto &m = place.matrix.m;
    for (unsigned v = 0; v < place.mesh->mNumVertices; v++) {
        const aiVector3D &p = place.mesh->mVertices[v];
        double position[3];
        for (int k = 0; k < 3; k++)
            position[k] =
                m[k][0] * double(p.x) + m[k][1] * double(p.y) + m[k][2] * double(p.z) + m[k][3];
        put(to, position, sizeof position);
    }
}

void write_texcoords(FILE *to, const Place &place)
{
    for (unsigned v = 0; v < place.mesh->mNumVertices; v++) {
        double texcoord[2] = {0, 0};
        for (unsigned k = 0; k < 2 && place.mesh->HasTextureCoords(0); k++)
            texcoord[k] = double(place.mesh->mTextureCoords[0][v][k]);
        put(to, texcoord, sizeof texcoord);
    }
}

void write_normals(FILE *to, const Place &place)
{
    double m[3][3];
    fmt_invert_for_normals(place.matrix.m, m);
    for (unsigned v = 0; v < place.mesh->mNumVertices; v++) {
        float normal[3] = {0, 0, 0};
        for (int k = 0; k < 3 && place.mesh->HasNormals(); k++) {
            const aiVector3D &n = place.mesh->mNormals[v];
            const double value =
                m[k][0] * double(n.x) + m[k][1] * double(n.y) + m[k][2] * double(n.z);
            normal[k] = std::fabs(value) < 3e38 ? float(value) : NAN;
        }
        put(to, normal, sizeof normal);
    }
}

// A mesh without colours has that of its material.
void write_colors(FILE *to, const Place &place, const std::vector<fmt_scene_material> &materials)
{
    const aiMesh &mesh = *place.mesh;
    const bool known =
        mesh.mMaterialIndex < materials.size() && materials[mesh.mMaterialIndex].has_diffuse;
    for (unsigned v = 0; v < mesh.mNumVertices; v++) {
        float color[3] = {1, 1, 1};
        if (mesh.HasVertexColors(0)) {
            const aiColor4D &c = mesh.mColors[0][v];
            color[0] = float(c.r), color[1] = float(c.g), color[2] = float(c.b);
        } else if (known) {
            std::copy_n(materials[mesh.mMaterialIndex].diffuse, 3, color);
        }
        put(to, color, sizeof color);
    }
}

// Polygons are turned round if the node mirrors.
void write_corners(FILE *to, const Place &place, uint64_t first_vertex)
{
    double unused[3][3];
    const bool mirrored = fmt_invert_for_normals(place.matrix.m, unused);
    for (unsigned f = 0; f < place.mesh->mNumFaces; f++) {
        const aiFace &face = place.mesh->mFaces[f];
        const unsigned size = face.mNumIndices;
        for (unsigned i = 0; i < size && size > 2; i++) {
            const uint64_t vertex = first_vertex + face.mIndices[mirrored && i > 0 ? size - i : i];
            put(to, &vertex, sizeof vertex);
        }
    }
}

void write_face_sizes(FILE *to, const Place &place)
{
    for (unsigned f = 0; f < place.mesh->mNumFaces; f++)
        if (place.mesh->mFaces[f].mNumIndices > 2)
            put(to, &place.mesh->mFaces[f].mNumIndices, sizeof(uint32_t));
}

// ---- describing ----

// What comes before the arrays in the file, and the names after them.
struct Tables {
    fmt_scene_head head;
    std::vector<fmt_scene_mesh> meshes;
    std::vector<fmt_scene_material> materials;
    std::string texts;

    // Returns the place of a name.
    uint64_t enter(const aiString &name)
    {
        const uint64_t at = texts.size();
        texts.append(name.C_Str(), std::strlen(name.C_Str()) + 1);
        return at;
    }
};

// Returns the name of a node or, if it has none, of its mesh.
const aiString &name_of(const Place &place)
{
    const char *name = place.node->mName.C_Str(), *made_up = "$ColladaAutoName$";
    const bool named = *name != 0 && std::strncmp(name, made_up, std::strlen(made_up)) != 0;
    return named ? place.node->mName : place.mesh->mName;
}

// Copies the diffuse colour, unless importers made the material up for meshes without one.
void copy_diffuse(const aiMaterial &from, fmt_scene_material *to)
{
    const std::string name = from.GetName().C_Str();
    aiColor3D color;
    std::fill_n(to->diffuse, 3, 0.8F);
    to->has_diffuse = name != AI_DEFAULT_MATERIAL_NAME && name != "%%%DEFAULT" &&
                      from.Get(AI_MATKEY_COLOR_DIFFUSE, color) == aiReturn_SUCCESS &&
                      std::isfinite(color.r) && std::isfinite(color.g) && std::isfinite(color.b);
    for (unsigned k = 0; k < 3 && to->has_diffuse; k++)
        to->diffuse[k] = float(color[k]);
}

// Describes the diffuse texture, and how it moves texture coordinates.
void copy_texture(const aiMaterial &from, fmt_scene_material *to, Tables *out)
{
    aiString name;
    aiUVTransform transform;
    unsigned type = aiTextureType_DIFFUSE, set = 0;
    to->texture = UINT64_MAX;
    if (from.GetTextureCount(aiTextureType_DIFFUSE) == 0)
        type = aiTextureType_BASE_COLOR;
    if (from.Get(AI_MATKEY_TEXTURE(type, 0), name) != aiReturn_SUCCESS || name.length == 0)
        return;
    if (name.data[0] == '*') { // the number of an embedded texture
        out->head.inner_textures++;
        return;
    }
    from.Get(AI_MATKEY_UVWSRC(type, 0), set);
    from.Get(AI_MATKEY_UVTRANSFORM(type, 0), transform);
    const aiVector2D &scale = transform.mScaling, &offset = transform.mTranslation;
    if (std::isfinite(scale.x) && std::isfinite(scale.y) && std::isfinite(offset.x) &&
        std::isfinite(offset.y))
        to->uv = {scale.x != 1 || scale.y != 1 || offset.x != 0 || offset.y != 0,
                  {float(scale.x), float(scale.y)},
                  {float(offset.x), float(offset.y)},
                  {BSQ_WRAP_REPEAT, BSQ_WRAP_REPEAT},
                  false};
    out->head.turned_textures += set != 0 || transform.mRotation != 0;
    to->texture = out->enter(name);
}

// Counts a mesh, and checks its indices.
void count_mesh(const aiMesh &mesh, Tables *out)
{
    fmt_scene_head *head = &out->head;
    const bool textured = mesh.mMaterialIndex < out->materials.size() &&
                          out->materials[mesh.mMaterialIndex].texture != UINT64_MAX;
    head->vertex_count += mesh.mNumVertices;
    head->has_colors |= mesh.HasVertexColors(0);
    head->hidden_colors += mesh.HasVertexColors(0) && textured && mesh.HasTextureCoords(0);
    for (unsigned f = 0; f < mesh.mNumFaces; f++) {
        const aiFace &face = mesh.mFaces[f];
        const bool whole = face.mNumIndices > 2;
        head->face_count += whole;
        head->short_faces += !whole;
        head->corner_count += whole ? face.mNumIndices : 0;
        for (unsigned i = 0; i < face.mNumIndices && whole; i++)
            if (face.mIndices[i] >= mesh.mNumVertices)
                throw std::runtime_error("a face refers to a vertex that does not exist");
    }
}

Tables describe(const aiScene &scene, const std::vector<Place> &places)
{
    Tables out = {};
    fmt_scene_head *head = &out.head;
    std::strncpy(head->stamp, fmt_program_stamp, sizeof head->stamp - 1);
    for (unsigned i = 0; i < scene.mNumMaterials; i++) {
        fmt_scene_material material = {};
        copy_diffuse(*scene.mMaterials[i], &material);
        material.name = out.enter(scene.mMaterials[i]->GetName());
        copy_texture(*scene.mMaterials[i], &material, &out);
        out.materials.push_back(material);
    }
    for (const Place &place : places) {
        out.meshes.push_back({head->vertex_count, head->face_count, head->corner_count,
                              out.enter(name_of(place)), place.mesh->mMaterialIndex,
                              place.mesh->HasNormals(), place.mesh->HasTextureCoords(0), 0});
        count_mesh(*place.mesh, &out);
    }
    out.texts += '\0';
    out.meshes.push_back({head->vertex_count, head->face_count, head->corner_count,
                          out.texts.size() - 1, 0, 0, 0, 0});
    head->mesh_count = places.size();
    head->material_count = out.materials.size();
    head->text_bytes = out.texts.size();
    return out;
}

void write_scene(const aiScene &scene, bool has_tangents, uint64_t memory_bytes, FILE *to)
{
    const std::vector<Place> places = find_places(scene);
    Tables t = describe(scene, places);
    t.head.memory_bytes = memory_bytes;
    t.head.has_tangents = has_tangents;
    put(to, &t.head, sizeof t.head);
    put(to, t.meshes.data(), t.meshes.size() * sizeof t.meshes[0]);
    put(to, t.materials.data(), t.materials.size() * sizeof t.materials[0]);
    for (const Place &place : places)
        write_positions(to, place);
    for (const Place &place : places)
        write_texcoords(to, place);
    for (size_t i = 0; i < places.size(); i++)
        write_corners(to, places[i], t.meshes[i].first_vertex);
    for (const Place &place : places)
        write_normals(to, place);
    for (const Place &place : places)
        if (t.head.has_colors)
            write_colors(to, place, t.materials);
    for (const Place &place : places)
        write_face_sizes(to, place);
    put(to, t.texts.data(), t.texts.size());
}

// ---- reading ----

// Removes the tangents of all meshes, which nothing uses: the validation refuses a mesh that has
// tangents but no bitangents. Returns whether there were any.
bool drop_tangents(const aiScene &scene)
{
    bool any = false;
    for (unsigned i = 0; i < scene.mNumMeshes; i++) {
        aiMesh *mesh = scene.mMeshes[i];
        if (!mesh)
            continue;
        any |= mesh->mTangents != nullptr;
        delete[] mesh->mTangents;
        delete[] mesh->mBitangents;
        mesh->mTangents = mesh->mBitangents = nullptr;
    }
    return any;
}

// Returns the memory that the process has taken at most, in bytes.
uint64_t peak_memory()
{
    struct rusage usage;
    getrusage(RUSAGE_SELF, &usage);
    return uint64_t(usage.ru_maxrss) * 1024;
}

// Reads a file whose format `suffix` tells, and writes its scene. Throws what is wrong.
void convert(const void *file, size_t size, const char *suffix, FILE *to)
{
    const uint64_t before = peak_memory();
    Assimp::Importer importer;
    importer.SetPropertyBool(AI_CONFIG_IMPORT_FBX_READ_ANIMATIONS, false);
    importer.SetPropertyBool(AI_CONFIG_IMPORT_FBX_READ_CAMERAS, false);
    importer.SetPropertyBool(AI_CONFIG_IMPORT_FBX_READ_LIGHTS, false);
    importer.SetPropertyBool(AI_CONFIG_IMPORT_COLLADA_USE_COLLADA_NAMES, true);
    // Versions after 5.2.5 would turn the scene; find_axes() does.
    importer.SetPropertyBool("AI_CONFIG_IMPORT_FBX_IGNORE_UP_DIRECTION", true);
    const aiScene *scene = importer.ReadFileFromMemory(file, size, 0, suffix);
    bool has_tangents = false;
    if (scene) {
        has_tangents = drop_tangents(*scene);
        scene = importer.ApplyPostProcessing(aiProcess_ValidateDataStructure);
    }
    if (!scene)
        throw std::runtime_error(importer.GetErrorString());
    write_scene(*scene, has_tangents, peak_memory() - before, to);
}

} // namespace

// Arguments: the suffix of the format, bytes of memory, seconds of a processor. Ends without
// destructors, which need time, and may crash for damaged scenes.
int main(int argument_count, char **arguments)
{
    fmt_program_input file;
    fmt_program_begin(argument_count, arguments, 1, 0, 0, &file);
    std::set_new_handler([] { _exit(-BSQ_ENOMEM); });
    try {
        convert(file.bytes, file.size, arguments[1], stdout);
    } catch (const std::exception &error) {
        const std::string text = std::string("cannot be read: ") + error.what();
        fmt_program_refuse(BSQ_EDATA, text.substr(0, 196).c_str());
    }
    _exit(fflush(stdout) == 0 && !ferror(stdout) ? 0 : -BSQ_EIO);
}
